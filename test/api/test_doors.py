# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Doors for Python: data in, a model, a motion, a controller or a picture out."""

import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

import fuzzycnc_ros
from fuzzycnc_ros import feedrate, servo, soft, thermal
from fuzzycnc_ros.core.feedrate.path.curves import infinity
from fuzzycnc_ros.machine_file.reader import built_in_path
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.simulation.thermal.duties import record_runs


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


def test_a_pattern_is_compensated_by_a_trained_model():
    model = soft.train(*foam_samples(0), random_state=0)
    line = soft.Primitive((0.02, 0.06), (0.12, 0.06), depth=0.006, step=0.003)
    found = soft.compensate([line], model, soft.SheetMaterial(0.02, size=(0.2, 0.12)))
    assert np.abs(found.offset).max() > 1e-4
    with pytest.raises(ValueError, match='clamped area'):
        soft.compensate([line], model, soft.SheetMaterial(0.02, size=(0.05, 0.12)))


def test_the_page_runs_as_it_stands(tmp_path, monkeypatch, root):
    """Every block of docs/tutorials/python.md, in a copy of the examples."""
    pytest.importorskip('matplotlib', reason='matplotlib is not installed')
    shutil.copytree(root / 'examples', tmp_path, dirs_exist_ok=True, symlinks=True)
    monkeypatch.chdir(tmp_path)
    assert thermal.read_run('mill_warm_up').channel  # of the text, and no link out of the folder
    (tmp_path / 'mill.yaml').write_text(built_in_path('lathe').read_text())
    x, s = foam_samples(0)
    names = {'points': infinity().sample(200, even=True), 'x': x, 's': s}
    blocks = re.findall(
        r'^```python\n(.*?)^```',
        (root / 'docs' / 'tutorials' / 'python.md').read_text(),
        re.M | re.S,
    )
    assert len(blocks) == 4
    for block in blocks:
        exec(compile(block, 'docs/tutorials/python.md', 'exec'), names)
        if 'wednesday' in names and 'judged' not in names:  # another block has a model too
            names['judged'] = thermal.evaluate(names['model'], names['wednesday'])
    assert (tmp_path / 'wednesday.png').stat().st_size > 10_000
    left = names['judged'].rms
    assert (left['default'] < 0.3 * left['uncompensated']).all()
    assert names['samples'].position.shape[1] == 2
    assert abs(names['duty']) <= 1.0


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
