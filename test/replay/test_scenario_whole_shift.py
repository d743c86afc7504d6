# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A shift with everything on, in one process; the same figures from its bag."""

import numpy as np
import pytest

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.core.thermal import load_model, train_model
from fuzzycnc_ros.report.shift_page import job_table
from fuzzycnc_ros.scenario import PublishedBag, record_calibration
from fuzzycnc_ros.scenario.whole_shift import (
    TICK,
    TOLERANCE,
    ShiftSettings,
    WholeShiftError,
    judged_shift,
    run_whole_shift,
)
from fuzzycnc_ros.scenario.whole_shift_log import ShiftLogs

SETTINGS = ShiftSettings(
    jobs=('1200:path:trident', '1800:move:X:0.01,Z:-0.005', '2400:path:infinity'), duration=3000.0
)


@pytest.fixture(scope='module')
def model():
    """Text of a thermal model."""
    period = {'simulated_machine': {'tick_period': TICK}}
    return train_model(record_calibration(parameters=period).runs).to_json()


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
    with pytest.raises(WholeShiftError, match='move 1: expected X within 10 um of 290 mm'):
        run_whole_shift(model, beyond)
