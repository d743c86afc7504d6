# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Time against contour error of scheduling methods: paths, curves, what cannot be reached."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.schedule.scheduler import ConstantFeed
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.motion.contouring import simulate_contouring
from fuzzycnc_ros.studies.page.document import to_document
from fuzzycnc_ros.studies.pareto import pareto as module
from fuzzycnc_ros.studies.pareto.pareto import ERRORS, KNOBS, pareto_of
from fuzzycnc_ros.studies.pareto.pareto_page import pareto_document, pareto_lines, pareto_table
from fuzzycnc_ros.studies.pareto.pareto_path import (
    CURVES,
    LENGTH_MAX,
    POINTS,
    curve_path,
    program_path,
    table_path,
)

PROGRAM = """G21 G90 G17
G0 X0 Y0 Z0
G1 X20 F600
G0 Z1
G0 X0 Y0
G1 Z0
G1 X10
G3 X10 Y10 I0 J5
G1 X0
G5.2 X3 Y14 P1 L3
X8 Y14 P1
X12 Y10 P1
G5.3
M30
"""


def ellipse(wide=12.0, high=5.0, count=400):
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    rows = np.column_stack([wide * np.cos(angle), high * np.sin(angle)])
    return 'x,y\n' + ''.join(f'{x:.6f},{y:.6f}\n' for x, y in rows)


@pytest.fixture(scope='module')
def found():
    told = []
    result = pareto_of(
        table_path(ellipse()), progress=lambda text, done, total: told.append((done, total))
    )
    return result, told


def test_every_method_has_a_falling_curve_through_the_compared_errors(found):
    pareto, _ = found
    assert tuple(pareto.methods) == tuple(KNOBS)
    for name, method in pareto.methods.items():
        assert len(method.points) >= 8, name
        for before, after in pairwise(method.points):
            assert before.error < after.error
            assert before.duration > after.duration, name
        for error in ERRORS:
            at = [p for p in method.points if p.duration == method.at_error[error]]
            assert len(at) == 1
            assert 0.99 * error <= at[0].error <= error * (1.0 + 1e-9), name
        assert not method.reasons
    # the curves reach from half of the least error to twice the largest
    points = pareto.methods['log_fuzzy'].points
    assert points[0].error == pytest.approx(0.5 * ERRORS[0], rel=0.1)
    assert points[-1].error == pytest.approx(2.0 * ERRORS[-1], rel=0.1)


def test_order_of_the_methods(found):
    pareto, _ = found
    for error in ERRORS:
        time = {name: method.at_error[error] for name, method in pareto.methods.items()}
        assert time['constant'] > time['log_fuzzy']
        assert time['fuzzy'] > time['log_fuzzy'] >= 0.98 * time['refined']
        # the chord error of a period is proportional to the normal acceleration
        assert time['chord_error'] == pytest.approx(time['normal_acceleration'], rel=0.01)
        assert min(time.values()) > pareto.limits.duration


def test_points_are_what_the_machine_does(found):
    pareto, _ = found
    path = table_path(ellipse())
    feed = ConstantFeed(feed_max=0.2).feed(path.sampled)
    run = simulate_contouring(path.contour, path.arc_length, feed)
    assert (pareto.limits.error, pareto.limits.duration) == (run.error_max, run.duration)


def test_progress_ends_when_all_is_done(found):
    told = found[1]
    assert [done for done, _ in told] == list(range(1, told[0][1] + 1))


def test_document_holds_what_was_measured(found):
    pareto, _ = found
    document = to_document(pareto_document(pareto))
    assert list(document) == ['methods', 'equal_error']
    assert list(document['methods']) == list(KNOBS)
    assert list(document['equal_error']) == ['0.01', '0.05', '0.1']
    first = pareto.methods['fuzzy'].points[0]
    assert document['methods']['fuzzy'][0] == {
        'error_mm': 1e3 * first.error,
        'time_s': first.duration,
    }
    assert document['equal_error']['0.05']['fuzzy'] == pareto.methods['fuzzy'].at_error[5e-5]


def test_table_marks_the_best_but_not_the_bound(found):
    table = pareto_table(found[0], KNOBS)
    names = [row[0] for row in table.rows]
    assert {(names.index('log_fuzzy'), column) for column in (2, 3, 4)} == table.strong
    assert any('less time than fuzzy' in line for line in pareto_lines(found[0]))


def test_error_that_full_feed_does_not_reach_is_null_with_its_reason():
    path = table_path(ellipse(wide=20.0, high=19.0))
    pareto = pareto_of(path, errors=(1e-3,), methods=('constant', 'log_fuzzy', 'refined'))
    assert pareto.limits.error < 1e-3
    for method in pareto.methods.values():
        assert method.at_error == {1e-3: None}
        assert method.reasons == {1e-3: 'leaves less at full feed'}
    assert pareto_document(pareto)['equal_error'] == {
        '1': {'constant': None, 'log_fuzzy': None, 'refined': None}
    }
    assert [row[2] for row in pareto_table(pareto, KNOBS).rows] == ['-'] * 3
    assert 'refined at 1 mm: leaves less at full feed' in pareto_lines(pareto)


def test_schedule_that_takes_too_long_is_null_with_its_reason(monkeypatch):
    monkeypatch.setattr(module, 'DURATION_MAX', 3.0)
    pareto = pareto_of(
        table_path(ellipse()), errors=(1e-5,), methods=('constant', 'normal_acceleration')
    )
    assert pareto.methods['constant'].at_error == {1e-5: None}
    assert pareto.methods['constant'].reasons == {1e-5: 'would take more than 3 s'}
    assert pareto.methods['normal_acceleration'].at_error[1e-5] < 3.0


def test_machine_and_parameters_count():
    path = table_path(ellipse())
    plain = pareto_of(path, errors=(5e-5,), methods=('fuzzy',))
    slow = pareto_of(
        path, machine=ContouringConfig(position_gain=20.0), errors=(5e-5,), methods=('fuzzy',)
    )
    # four times the machine constant: half the feed
    ratio = slow.methods['fuzzy'].at_error[5e-5] / plain.methods['fuzzy'].at_error[5e-5]
    assert 1.8 < ratio < 2.4
    config = FeedrateSchedulerConfig(fuzzy_curvature_centres=(0.0, 50.0, 100.0, 150.0, 200.0, 3e3))
    tuned = pareto_of(path, config, errors=(5e-5,), methods=('fuzzy',))
    assert tuned.methods['fuzzy'].at_error[5e-5] < plain.methods['fuzzy'].at_error[5e-5]


@pytest.mark.parametrize('name', CURVES)
def test_curves_have_the_size_of_the_figures(name):
    path = curve_path(name)
    length = {'infinity': 308.86, 'trident': 225.38, 'butterfly': 335.00}[name]
    assert 1e3 * path.contour.length == pytest.approx(length, abs=0.01)
    assert len(path.arc_length) == len(path.sampled.curvature) == POINTS


def test_first_run_that_bends_is_taken():
    path = program_path(read_program(PROGRAM))
    # the straight line to X20 is run 1
    assert path.name.startswith('run 2 of 2, lines 6 to 12, ')
    curve = program_path(read_program(PROGRAM), 2)
    assert curve.contour.length == path.contour.length
    assert path.arc_length[0] == 0.0
    assert path.arc_length[-1] == pytest.approx(path.contour.length, rel=1e-12)
    assert np.all(np.diff(path.arc_length) > 0.0)
    # inside the arc, half a turn of 5 mm of radius after 11 mm
    inside = (path.arc_length > 0.0115) & (path.arc_length < 0.0260)
    assert path.sampled.curvature[inside] == pytest.approx(200.0, rel=0.02)
    place = path.contour.position([0.0, 0.011 + 2.5e-3 * np.pi])
    assert place == pytest.approx(np.array([[0.0, 0.0, 1e-3], [15e-3, 5e-3, 0.0]]), abs=2e-8)


@pytest.mark.parametrize('run', [1, 3])
def test_run_that_cannot_be_taken_is_refused(run):
    with pytest.raises(
        ValueError, match=rf'--run: expected a run that bends, of 2 .* 2, .* {run}'
    ):
        program_path(read_program(PROGRAM), run)


def test_program_of_straight_runs_is_refused():
    with pytest.raises(ValueError, match='expected a run that bends but found 1 straight ones'):
        program_path(read_program('G1 X10 F600\nX20\n'))


def test_long_run_is_cut():
    turns = ''.join('G2 X0 Y0 I50\n' for _ in range(5))
    path = program_path(read_program(f'G0 X0 Y0\nF600\n{turns}'))
    assert path.contour.length == pytest.approx(LENGTH_MAX, rel=1e-3)
    assert 'its first ' in path.name
    assert 'of 1570.8 mm' in path.name


def test_far_away_points_cost_no_memory():
    path = table_path('x,y\n0,0\n10,0\n10,1e5\n0,1e5\n')
    assert path.contour.length == pytest.approx(LENGTH_MAX, rel=1e-3)
    assert 'of 100020.0 mm' in path.name
    assert len(path.arc_length) <= 2 * POINTS
    far = read_program('G0 X0 Y0\nG2 X10 Y0 I5 F600\nG1 X900000\n')
    with pytest.raises(
        ValueError, match=r'line 3: expected segments of at most 20 m but found 899.99 m'
    ):
        program_path(far)
    behind = 'G0 X0 Y0\nF600\n' + 'G2 X0 Y0 I50\n' * 5 + 'G1 X900000\n'
    assert program_path(read_program(behind)).contour.length == pytest.approx(0.5, rel=1e-3)


def test_table_keeps_its_corners():
    path = table_path('x,y,z\n0,0,0\n20,0,0\n20,20,0\n20,20,5\n')
    assert path.contour.length == pytest.approx(0.045, rel=1e-12)
    for corner in (0.02, 0.04):
        assert np.abs(path.arc_length - corner).min() < 1e-12
    sharp = path.sampled.curvature > 1.0
    assert 2 <= sharp.sum() <= 100  # next to the corners only
    assert table_path('\ufeffX, Y\n0,0\n1,0\n\n1,1\n').contour.length == pytest.approx(2e-3)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'a table of points but it is empty'),
        ('a,b\n0,0\n', "line 1: expected the columns x,y or x,y,z, in mm, but found 'a,b'"),
        ('x,y\n0,0\n1,one\n', 'line 3: expected numbers, but: .*one'),
        ('x,y\n0,0\n1,nan\n', 'line 3: expected 2 finite numbers'),
        ('x,y\n0,0\n1,2,3\n', 'line 3: expected 2 finite numbers'),
        ('x,y\n0,0\n1,1\n', 'three points or more but found 2'),
        ('x,y\n0,0\n1,1\n2,2\n', 'path that bends but found 3 different ones'),
        ('x,y\n1,1\n1,1\n1,1\n', 'path that bends but found 1 different ones'),
        ('x,y\n0,0\n1e308,0\n0,1e308\n', 'line 3: expected places within 1000 m'),
        ('x,y\n"0,0\n', 'line 2: expected numbers'),
        ('x,y\n0\r,0\n', 'line 2: expected a CSV table, but: new-line character'),
    ],
)
def test_wrong_table_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        table_path(text)


def test_methods_that_take_the_same_time_as_shown_are_marked_alike():
    def method(time):
        return SimpleNamespace(at_error={1e-5: time})

    pareto = SimpleNamespace(
        path='a path',
        errors=(1e-5,),
        methods={
            'constant': method(3.0),
            'fuzzy': method(2.0041),
            'log_fuzzy': method(1.9962),
            'refined': method(1.5),
        },
    )
    table = pareto_table(pareto, KNOBS)
    assert table.strong == {(1, 2), (2, 2)}
    assert 'bound' in table.strong_means
