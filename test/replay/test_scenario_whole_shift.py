# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A shift with everything on, in one process; the same figures from its bag."""

import numpy as np
import pytest
from kept import kept

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.components.machine.machine_operator import PART_PROGRAM
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration
from fuzzycnc_ros.studies.shift.whole_shift import (
    TICK,
    TOLERANCE,
    ShiftSettings,
    WholeShiftError,
    check_program,
    judged_shift,
    run_whole_shift,
)
from fuzzycnc_ros.studies.shift.whole_shift_log import ShiftLogs
from fuzzycnc_ros.studies.shift.whole_shift_page import job_table

pytestmark = pytest.mark.slow

SETTINGS = ShiftSettings(
    jobs=('1200:path:trident', '1800:move:X:0.01,Z:-0.005', '2400:path:infinity'), duration=3000.0
)


@kept
def model_of_the_mill():
    period = {'simulated_machine': {'tick_period': TICK}}
    return train_model(record_calibration(parameters=period).runs).to_json()


@pytest.fixture(scope='module')
def model():
    """Text of a thermal model."""
    return model_of_the_mill()


@pytest.fixture(scope='module')
def shift(model, tmp_path_factory):
    """A part of a shift and its bag."""
    bag = tmp_path_factory.mktemp('shift') / 'bag'
    with PublishedBag(bag) as sink:
        return run_whole_shift(model, SETTINGS, sink=sink), bag


@pytest.mark.replay
def test_everything_keeps_its_bounds(shift):
    after, _ = shift
    assert after.thermal_max <= 5e-6
    assert 0.0 < after.contour_max <= TOLERANCE
    assert after.positioning_max <= 2e-6
    assert [job.name for job in after.jobs] == ['trident', 'X:0.01,Z:-0.005', 'infinity']
    assert all(path.finished for path in after.paths)
    for job in after.jobs:
        assert job.error == job.left + job.own
        assert np.isnan(job.contour) != np.isnan(job.positioning)


@pytest.mark.replay
def test_compensation_is_what_makes_the_difference(shift, model):
    after, _ = shift
    before = run_whole_shift(model, SETTINGS, compensated=False)
    assert before.thermal_max > 2.0 * after.thermal_max
    for old, new in zip(before.jobs, after.jobs, strict=True):
        assert old.left == old.thermal == new.thermal
        assert new.left < 0.5 * old.left
    table = job_table(before, after)
    assert len(table.rows) == 3
    assert table.rows[1][0] == 'X:0.01,Z:-0.005'


@pytest.mark.replay
def test_bag_and_second_run_are_the_same(shift, model, tmp_path):
    after, bag = shift
    again = judged_shift(ShiftLogs.from_bag(bag), load_model(model), SETTINGS)
    assert [job.error for job in again.jobs] == [job.error for job in after.jobs]
    with PublishedBag(tmp_path / 'again') as sink:
        run_whole_shift(model, SETTINGS, sink=sink)
    assert topic_hashes(tmp_path / 'again') == topic_hashes(bag)


@pytest.mark.replay
def test_a_job_that_is_not_done_is_an_error_that_says_why(model):
    beyond = ShiftSettings(jobs=('60:move:X:0.29',), duration=120.0)
    with pytest.raises(WholeShiftError, match='move 1: expected X within 10 µm of 290 mm'):
        run_whole_shift(model, beyond)


CURVES = """\
G21 G17 G90 G94
G0 Z5
G0 X-20 Y-20
G1 Z-1 F2000
(corners of 90, 27 and 63 deg)
G1 X20 F8000
G1 X20 Y0
G1 X-15 Y0
G1 X20 Y20
G1 X-20 Y20
G1 X-20 Y-20
G0 Z5
(arcs of 5, 1 and 0.5 mm)
G0 X-20 Y0
G1 Z-1 F2000
G3 X-10 Y0 I5 J0 F9000
G2 X-8 Y0 I1 J0
G3 X-7 Y0 I0.5 J0
G1 X5
(a spline with weights)
G5.2 X15 Y15 P1 L3
X25 Y-5 P1
X30 Y15 P2
X20 Y30 P1
G5.3
G0 Z5
M2
"""
"""What the jobs of a shift do not have: sharp corners, tight arcs at full feed, a spline."""


@pytest.mark.replay
def test_another_program_keeps_its_tolerance(model):
    check_program(CURVES)
    settings = ShiftSettings(jobs=('60:program',), program=CURVES, duration=600.0, seed=1)
    after = run_whole_shift(model, settings)
    assert after.paths[0].finished
    assert 0.0 < after.contour_max <= TOLERANCE


@pytest.mark.parametrize(
    ('program', 'message'),
    [
        ('', 'line 1: expected a part program but found no word in it'),
        ('(nothing)\nM2\n', 'expected at least one that moves but found none'),
        ('G21 G90\nG0 X1\nG0 X5\n', 'expected moves with feed .* but found rapids alone'),
        ('G21 G90\nG0 X1\nG1 X20\n', r'line 3: expected a feed above 0 \(F\)'),
        ('G21 G90\nG1 X500 F3000\n', 'line 2: expected X within its travel of -300 to 300 mm but'),
        ('G20 G90\nG1 Y-12 F100\n', 'line 2: expected Y within its travel.*found -304.8 mm'),
        ('G21 G90\nG1 X290 F3000\nG3 Y60 J30\n', 'line 3: .*found 320 mm; move the zero'),
        ('G21 G90\nG1 X1 F3000\nG81 X2 Z-1 R1\n', 'line 3: expected a motion whose place'),
        ('G21 G90\nG1 X250 F60\n', 'at most 120 s at its own feeds but found 250 s'),
        ('\0\0G1', 'is this a binary file'),
    ],
)
def test_a_program_that_cannot_be_cut_is_refused_before_anything_runs(program, message):
    with pytest.raises(ValueError, match=message):
        check_program(program)


def test_programs_that_can_be_cut():
    check_program(PART_PROGRAM)
    check_program('G20 G90\nG1 X2 F100\n')
