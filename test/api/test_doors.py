# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Doors for Python: data in, a model, a motion, a controller or a picture out."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fuzzycnc_ros
from fuzzycnc_ros import feedrate, servo, soft, thermal
from fuzzycnc_ros.cli.soft.command import train
from fuzzycnc_ros.core.feedrate.path.curves import infinity
from fuzzycnc_ros.core.servo.profile import Reference
from fuzzycnc_ros.machine_file.reader import built_in_path
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet
from fuzzycnc_ros.simulation.thermal.duties import record_runs
from fuzzycnc_ros.studies.soft.foam_records import COLUMNS


@pytest.fixture(scope='module')
def runs():
    return list(record_runs(['T1', 'T2']).values())


@pytest.fixture(scope='module')
def model(runs):
    return thermal.train(runs[:1], candidates=['lag_ridge'])


def test_doors_are_loaded_when_they_are_used():
    script = (
        'import sys, fuzzycnc_ros; print(len([n for n in sys.modules if "fuzzycnc_ros." in n]));'
        'print(fuzzycnc_ros.feedrate.schedule.__name__, "thermal" in dir(fuzzycnc_ros))'
    )
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    assert done.stdout.split('\n')[:2] == ['0', 'schedule True']
    with pytest.raises(AttributeError, match='no attribute'):
        fuzzycnc_ros.nothing  # noqa: B018


def test_csv_and_bag_give_one_run(runs, tmp_path):
    run = runs[0]
    lines = [','.join(('time', *run.sensor[:3], *run.channel))]
    for row in range(0, len(run.time), 2):
        values = (run.time[row], *run.temperature[row, :3], *(1e6 * run.displacement[row]))
        lines.append(','.join(f'{value:.6g}' for value in values))
    file = tmp_path / 'monday.csv'
    file.write_text('\n'.join(lines) + '\n')
    channels = [f'{name}={axis}:um' for name, axis in zip(run.channel, run.axis, strict=True)]
    read = thermal.read_run(file, temperatures=run.sensor[:3], displacements=channels)
    assert (read.name, read.sensor, read.channel) == ('monday', run.sensor[:3], run.channel)
    np.testing.assert_allclose(read.displacement, run.displacement[::2], atol=1e-9)
    with pytest.raises(ValueError, match=r"'t'"):
        thermal.read_run(file, time='t', temperatures=['*'])


def test_a_table_has_quantities_and_names(runs):
    table = thermal.to_dataframe(runs[0])
    assert table.shape == (len(runs[0].time), len(runs[0].sensor) + len(runs[0].channel) + 1)
    np.testing.assert_array_equal(table['displacement']['Y'], runs[0].displacement[:, 0])


def test_what_a_model_leaves_is_less_than_without(model, runs):
    left = thermal.residual(model, runs[1])
    assert np.sqrt(np.nanmean(left**2)) < 0.5 * np.sqrt(np.nanmean(runs[1].displacement ** 2))


def test_pictures_are_drawn_on_given_axes(model, runs):
    pyplot = pytest.importorskip('matplotlib.pyplot', reason='matplotlib is not installed')
    figure, (above, below) = pyplot.subplots(2)
    assert thermal.plot_run(runs[1], above, sensors=runs[1].sensor[:2]) is above
    assert thermal.plot_residual(model, runs[1], below) is below
    assert [line.get_label() for line in above.lines] == list(runs[1].channel)
    assert len(figure.axes) == 3
    drawn = below.lines[-1].get_ydata()
    np.testing.assert_allclose(drawn, 1e6 * thermal.residual(model, runs[1])[:, -1])
    pyplot.close(figure)


def test_each_run_is_held_out_once(runs):
    found = thermal.compare(runs, ['lag_ridge'])
    assert [item.evaluation.run for item in found] == [run.name for run in runs]


def test_points_curve_and_geometry_give_the_same_motion():
    curve, limits = infinity(), feedrate.MotionLimits(path_velocity=0.2, path_acceleration=1.5)
    options = {'tolerance': 50e-6, 'machine_constant': 2.15e-4, 'limits': limits}
    by_curve = feedrate.schedule(curve, **options)
    points = curve.sample(2000, even=True)
    by_points = feedrate.schedule(points, **options)
    by_geometry = feedrate.schedule(feedrate.PathGeometry.from_samples(points), **options)
    assert by_points.duration == pytest.approx(by_curve.duration, rel=5e-3)
    assert by_geometry.duration == by_points.duration
    tighter = feedrate.schedule(curve, **{**options, 'tolerance': 10e-6})
    assert tighter.duration > 1.5 * by_curve.duration


def test_a_schedule_keeps_the_tolerance_where_the_feed_is_chosen():
    """C curvature v^2 is the contour error that the feed leaves."""
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    circle = 0.01 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    circle[-1] = circle[0]
    limits = feedrate.MotionLimits(velocity=(0.5, 0.5), acceleration=(20.0, 20.0))
    motion = feedrate.schedule(circle, tolerance=30e-6, machine_constant=2e-4, limits=limits)
    error = 2e-4 * 100.0 * motion.speed.max() ** 2
    assert 27e-6 < error <= 30e-6
    with pytest.raises(ValueError, match='repeated points'):
        feedrate.schedule([(0, 0), (0, 0), (1, 1)], tolerance=1e-5, machine_constant=1e-4,
                          limits=limits)  # fmt: skip


def test_a_closed_path_of_points_is_smooth_where_it_closes():
    turn = np.linspace(0.0, 2.0 * np.pi, 60)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    circle[-1] = circle[0]
    path = feedrate.PathGeometry.from_samples(circle)
    ends = np.array([0.0, path.length])
    assert path.length == pytest.approx(2.0 * np.pi, rel=1e-5)
    np.testing.assert_allclose(*path.evaluate(ends, 1), atol=1e-9)
    np.testing.assert_allclose(*path.evaluate(ends, 2), atol=1e-6)


def test_an_axis_of_a_machine_file_arrives():
    axis = servo.read_axis('lathe', 'X')
    run = servo.position(servo.controller(axis), servo.simulated_axis(axis), 1e-3, 0.5)
    assert run.position[-1] == pytest.approx(1e-3, abs=2e-5)
    with pytest.raises(ValueError, match='expected one of X'):
        servo.read_axis('lathe', 'Q')


def moved_for(duration=0.01, to=1e-3):
    axis = servo.read_axis('lathe', 'X')
    return servo.position(servo.controller(axis), servo.simulated_axis(axis), to, duration)


@pytest.mark.parametrize('to', [10.0, -0.251, np.array([0.0, 0.1, 0.3, 0.1])])
def test_an_axis_is_not_sent_beyond_its_travel(to):
    if isinstance(to, np.ndarray):
        to = Reference(to, 0.0 * to, 0.0 * to, 1e-3)
    with pytest.raises(ValueError, match=r'reference: expected positions from -0.25 to 0.25 m'):
        moved_for(to=to)


def test_a_setting_is_a_number():
    with pytest.raises(ValueError, match=r"settings: expected bandwidth from .* found 'fast'"):
        servo.controller(servo.read_axis('lathe', 'X'), 'pid', bandwidth='fast')


@pytest.mark.parametrize('duration', [0.0, 1e-4, -1.0, np.nan, np.inf, 5e5])
def test_a_move_takes_a_time(duration):
    with pytest.raises(ValueError, match=r'duration: expected 0\.001 s, one period, to 3600 s'):
        moved_for(duration)


DUTY = np.repeat([0.3, -0.3, 0.1, -0.1], 300)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'duty': 100.0 * DUTY}, 'duty: expected shares of the full drive, -1 to 1, but found 30'),
        ({'duty': DUTY[1:]}, 'position: expected one for each command'),
        ({'period': 0.0}, 'period: expected more than 0 s but found 0.0 s'),
        ({'period': -1e-3}, 'period: expected more than 0 s'),
        ({'position': np.full(1200, np.nan)}, 'position: expected finite .* nan at sample 0'),
        ({'force': 0.0}, 'force: expected a number above 0 N'),
    ],
)
def test_a_recording_that_cannot_be_one_is_refused(changes, message):
    known = {'duty': DUTY, 'position': 1e-6 * np.cumsum(DUTY), 'period': 1e-3}
    with pytest.raises(ValueError, match=message):
        servo.identify(**{**known, **changes})


def test_positions_in_millimetres_are_doubted(monkeypatch):
    monkeypatch.setattr(
        servo, 'identify_axis', lambda recordings, force: SimpleNamespace(data='data')
    )
    speed = 0.1 * np.sign(DUTY)  # 0.1 m/s
    assert servo.identify(DUTY, 1e-3 * np.cumsum(speed), 1e-3) == 'data'
    with pytest.warns(UserWarning, match='position: expected metres, at most 10 m/s'):
        servo.identify(DUTY, np.cumsum(speed), 1e-3)


@pytest.mark.parametrize('changes', [{'seed': -1}, {'generations': 0}, {'population': 0}])
def test_a_search_has_generations_and_candidates(changes):
    with pytest.raises(ValueError, match=f'{next(iter(changes))}: expected . or more'):
        servo.tune(servo.read_axis('lathe', 'X'), **changes)


@pytest.mark.parametrize('name', ['', 'spindle nose', '1X'])
def test_an_axis_is_written_under_a_name_that_is_read(name, tmp_path):
    with pytest.raises(ValueError, match='name: expected one such as X'):
        servo.save_axis(servo.read_axis('lathe', 'X'), tmp_path / 'mine.yaml', name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    'changes',
    [{'samples': 0}, {'samples': -4}, {'samples': 10**9}, {'machine_constant': 200.0}],
)
def test_a_schedule_has_bounds(changes):
    limits = feedrate.MotionLimits(path_velocity=0.2, path_acceleration=1.5)
    known = {'tolerance': 20e-6, 'machine_constant': 2e-4, 'limits': limits}
    with pytest.raises(ValueError, match=f'{next(iter(changes))}: expected'):
        feedrate.schedule([(0.0, 0.0), (0.01, 0.0)], **{**known, **changes})


@pytest.mark.parametrize(
    ('limits', 'name'),
    [
        ({'path_velocity': 200.0, 'path_acceleration': 1.5}, 'velocity'),
        ({'path_velocity': 0.2, 'acceleration': (1.5, 2e4)}, 'acceleration'),
    ],
)
def test_limits_in_millimetres_are_doubted(limits, name):
    with pytest.warns(UserWarning, match=f'{name}: expected m/s.*divide by 1000'):
        feedrate.schedule(
            [(0.0, 0.0), (0.01, 0.001), (0.02, 0.0)], tolerance=20e-6, machine_constant=2e-4,
            limits=feedrate.MotionLimits(**limits), samples=9,
        )  # fmt: skip


def test_a_sheet_that_the_model_does_not_know_is_doubted():
    model = soft.train(*foam_samples(0), method='ridge')
    line = soft.Primitive((0.02, 0.06), (0.12, 0.06), depth=0.006, step=0.003)
    with pytest.warns(UserWarning, match='there is no compensation; depth, step and thickness'):
        found = soft.compensate([line], model, soft.SheetMaterial(20.0))
    assert not found.offset.any()
    line = soft.Primitive((20.0, 60.0), (120.0, 60.0), depth=0.006, step=0.003)
    with pytest.warns(UserWarning, match='pattern: expected metres, at most 20 m, but found 100'):
        soft.compensate([line], model, soft.SheetMaterial(0.02))


def test_a_pattern_is_compensated_by_a_trained_model():
    model = soft.train(*foam_samples(0), method='ridge')
    line = soft.Primitive((0.02, 0.06), (0.12, 0.06), depth=0.006, step=0.003)
    found = soft.compensate([line], model, soft.SheetMaterial(0.02, size=(0.2, 0.12)))
    assert np.abs(found.offset).max() > 1e-4
    with pytest.raises(ValueError, match='clamped area'):
        soft.compensate([line], model, soft.SheetMaterial(0.02, size=(0.05, 0.12)))


def test_samples_in_other_units_are_refused_or_doubted():
    x, s = foam_samples(0)
    metres = x * [1.0, 1e-3, 1.0, 1e-3, 1e-3]
    with pytest.raises(ValueError, match=r'x: depth_mm: expected millimetres .* multiply by 1000'):
        soft.train(metres, s)
    radians = x * [np.pi / 180.0, 1.0, 1.0, 1.0, 1.0]
    with pytest.warns(UserWarning, match='multiply them by 57.29578 if they are radians'):
        soft.train(radians, s, method='ridge')
    with pytest.warns(UserWarning, match='multiply by 1000 if they are metres'):
        soft.train(x, 1e-3 * s, method='ridge')
    inches = x / [1.0, 25.4, 1.0, 25.4, 25.4]
    with pytest.warns(UserWarning, match='multiply all lengths by 25.4 if they are inches'):
        soft.train(inches, s / 25.4, method='ridge')
    with pytest.raises(ValueError, match='one group for each of 265 rows'):
        soft.train(x, s[:100])


def test_a_door_trains_what_the_command_trains(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    x, s = (part[::3].round(4) for part in foam_samples(2))
    rows = [','.join(map(str, row)) for row in np.column_stack([x, s]).tolist()]
    (tmp_path / 's.csv').write_text('\n'.join([','.join(COLUMNS), *rows]) + '\n')
    train([Path('s.csv')], Path('m.json'), baselines=False, json_file=Path('j.json'))
    if json.loads(Path('j.json').read_text())['outliers']:
        with pytest.warns(UserWarning, match='contradict the others'):
            model = soft.train(x, s, random_state=0)
    else:
        model = soft.train(x, s, random_state=0)
    soft.save_model(model, 'mine.json')
    assert Path('mine.json').read_text() == Path('m.json').read_text()


def test_noise_gives_no_correction_and_a_warning():
    x = foam_samples(0).x[::4]
    noise = np.random.default_rng(0).normal(0.0, 1.0, (len(x), 2))
    with pytest.warns(UserWarning, match='no correction: held-out samples show no deformation'):
        model = soft.train(x, noise)
    assert not model.corrects
    points = np.column_stack([np.arange(0.02, 0.14, 0.003), np.full(40, 0.05)])
    stitched = points + np.random.default_rng(1).normal(0.0, 1e-4, points.shape)
    with pytest.warns(UserWarning, match='no correction: held-out stitches show'):
        found = soft.learn(points, stitched, soft.SheetMaterial(0.015))
    assert not found.offset.any()


@pytest.mark.parametrize(
    ('points', 'stitched', 'message'),
    [
        (1e3, 1e3, 'found them 3e.03 mm apart; are lengths millimetres, or metres'),
        (1.0, 1e3, 'run 0: point 39: expected a stitch within 50 mm of its place'),
    ],
)
def test_runs_in_other_units_are_refused(points, stitched, message):
    course = np.column_stack([np.arange(0.02, 0.14, 0.003), np.full(40, 0.05)])
    with pytest.raises(ValueError, match=message):
        soft.learn(points * course, stitched * course, soft.SheetMaterial(0.015))


def test_millimetres_are_doubted_by_schedule():
    limits = feedrate.MotionLimits(path_velocity=0.2, path_acceleration=1.5)
    options = {'machine_constant': 2e-4, 'limits': limits}
    points = np.array([(0.0, 0.0), (10.0, 4.0), (20.0, 0.0), (30.0, -4.0), (40.0, 0.0)])
    with pytest.warns(UserWarning, match=r'path: expected metres.* found 40 m; divide by 1000'):
        feedrate.schedule(points, tolerance=20e-6, **options)
    with pytest.warns(UserWarning, match=r'tolerance: expected metres.* found 0.02 m'):
        feedrate.schedule(1e-3 * points, tolerance=0.02, **options)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'period': None}, r'expected period, the control period \[s\], but found none in Slide'),
        ({'position': None}, r'expected position, the true position \[m\], but found none'),
        ({'measure': None}, r'expected measure, a method that returns the measured position'),
        ({'drive': None}, r'expected drive, a method that holds a duty, -1 to 1, for one period'),
        ({'position': lambda self: 0.0}, r'position to be .*; make it a property'),
        ({'measure': 0.0}, r'expected measure to be a method that .* but found 0.0 in Slide'),
        ({'measure': lambda self: None}, r'expected measure\(\) to return a position .* None'),
    ],
)
def test_an_axis_of_ones_own_is_told_what_it_lacks(changes, message):
    members = {
        'period': 1e-3, 'position': 0.0, 'measure': lambda self: 0.0,
        'drive': lambda self, duty: None, **changes,
    }  # fmt: skip
    kept = {key: value for key, value in members.items() if value is not None}
    controller = servo.controller(servo.read_axis('lathe', 'X'), 'pid')
    with pytest.raises(TypeError, match=message):
        servo.position(controller, type('Slide', (), kept)(), 1e-3, 0.5)


def test_an_axis_is_identified_tuned_and_written(tmp_path):
    plant = servo.simulated_axis(servo.read_axis('ballscrew', 'X'))
    rng = np.random.default_rng(0)
    duty = 0.5 * np.repeat(rng.uniform(-1.0, 1.0, 40), 50)
    places = []
    for value in duty:
        places.append(plant.measure())
        plant.drive(value)
    axis = servo.identify(duty, places, plant.period)
    tuned = servo.tune(axis, generations=1, population=1)
    assert tuned.controller in servo.AXIS_CONTROLLERS
    servo.save_axis(tuned, tmp_path / 'mine.yaml', 'X')
    again = servo.read_axis(tmp_path / 'mine.yaml', 'X')
    assert (again.controller, again.settings) == (tuned.controller, pytest.approx(tuned.settings))


def test_a_thermal_model_is_saved_and_read(model, runs, tmp_path):
    thermal.save_model(model, tmp_path / 'mill.json')
    again = thermal.load_model(tmp_path / 'mill.json')
    np.testing.assert_array_equal(again.predict(runs[1]), model.predict(runs[1]))


def test_the_page_runs_as_it_stands(tmp_path, monkeypatch, root):
    """Every block of docs/tutorials/python.md, in a copy of the examples."""
    pytest.importorskip('matplotlib', reason='matplotlib is not installed')
    shutil.copytree(root / 'examples', tmp_path, dirs_exist_ok=True, symlinks=True)
    monkeypatch.chdir(tmp_path)
    assert thermal.read_run('mill_warm_up').channel  # of the text, and no link out of the folder
    (tmp_path / 'mill.yaml').write_text(built_in_path('lathe').read_text())
    x, s = foam_samples(0)
    rows = 0.02 + 0.1 * np.linspace(0.0, 1.0, 34)
    straight = np.column_stack([rows, np.full(34, 0.06)])
    stitched = FoamSheet(0.02, (0.2, 0.12)).stitch(straight, 0.006)
    names = {
        'points': infinity().sample(200, even=True),
        'x': x[::4],
        's': s[::4],
        'stitched': stitched,
    }
    blocks = re.findall(
        r'^```python\n(.*?)^```',
        (root / 'docs' / 'tutorials' / 'python.md').read_text(),
        re.M | re.S,
    )
    assert len(blocks) == 7
    for block in blocks:
        exec(compile(block, 'docs/tutorials/python.md', 'exec'), names)
        if 'wednesday' in names and 'judged' not in names:  # another block has a model too
            names['judged'] = thermal.evaluate(names['model'], names['wednesday'])
    assert (tmp_path / 'wednesday.png').stat().st_size > 10_000
    left = names['judged'].rms
    assert (left['default'] < 0.3 * left['uncompensated']).all()
    assert names['samples'].position.shape[1] == 2
    assert abs(names['duty']) <= 1.0
    assert names['mine'].position[-1] == pytest.approx(1e-3, abs=1e-4)
    assert names['again'].offset[-1] == pytest.approx(0.7 * (straight - stitched)[-1], abs=1e-4)
    assert type(soft.read_model('foam.json')) is soft.DeformationModel


@pytest.mark.parametrize(
    ('points', 'order'),
    [
        ([(0, 0), (0, 0), (0, 0), (4, 0), (8, 3)], 3),
        ([(0, 0), (4, 0), (8, 3), (8, 3), (8, 3), (8, 3), (12, 0)], 4),
        ([(0, 0), (4, 0), (8, 3), (8, 3), (8, 3)], 3),
        ([(0, 0), (4, 0), (0, 0)], 3),
        ([(0, 0, 1), (4, 0, 2), (4, 0, 2), (4, 0, 2), (8, 0, 1)], 3),
    ],
)
def test_a_curve_that_stands_still_or_turns_back_has_a_motion(points, order):
    control, count = 1e-3 * np.array(points), len(points)
    inner = range(1, count - order + 1)
    knot = [0] * order + [*inner] + [count - order + 1] * order
    curve = feedrate.NurbsCurve(control, np.ones(count), knot, order - 1)
    limits = feedrate.MotionLimits(path_velocity=0.2, path_acceleration=1.5)
    motion = feedrate.schedule(curve, tolerance=1e-5, machine_constant=2e-4, limits=limits)
    position = motion.sample(1e-3).position
    assert position.shape[1] == control.shape[1]
    assert np.isfinite(position).all()
    assert motion.duration >= 2.0 * (curve.length / 1.5) ** 0.5 * (1.0 - 1e-6)


def test_what_has_no_way_on_is_refused_by_its_name():
    limits = feedrate.MotionLimits(path_velocity=0.2, path_acceleration=1.5)
    options = {'tolerance': 1e-5, 'machine_constant': 2e-4, 'limits': limits}
    with pytest.raises(ValueError, match='straight back on itself at point 1'):
        feedrate.schedule([(0.0, 0.0), (0.01, 0.0), (0.0, 0.0)], **options)
    point = feedrate.NurbsCurve([(0.0, 0.0)] * 3, np.ones(3), [0, 0, 0, 1, 1, 1], 2)
    with pytest.raises(ValueError, match='path: expected a curve with a length'):
        feedrate.schedule(point, **options)
