# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Drift alarm: the sums, when it is raised, that it stays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.thermal.probing import ALLOWANCE, CUSUM_LIMIT, DriftAlarm, drift_deviation


def test_refusals():
    with pytest.raises(ValueError, match='expected 1 or more channels'):
        DriftAlarm(0)
    with pytest.raises(ValueError, match='limit above 0'):
        DriftAlarm(1, 0.0)
    alarm = DriftAlarm(2)
    with pytest.raises(ValueError, match='residual: expected 2 numbers or NaN'):
        alarm.update([1.0])
    with pytest.raises(ValueError, match='residual: expected 2 numbers or NaN'):
        alarm.update([np.inf, 0.0])
    with pytest.raises(ValueError, match='state: expected 10 numbers'):
        alarm.state = np.zeros(3)
    assert not alarm.sums.any()


def test_sums_are_those_of_page():
    alarm = DriftAlarm(1)
    for value, high, low in ((2.0, 0.5, 0.0), (3.0, 2.0, 0.0), (0.0, 0.5, 0.0), (-3.0, 0.0, 1.5)):
        alarm.update([value])
        np.testing.assert_allclose(alarm.sums[:, 0], [high, low])


@given(st.lists(st.floats(-ALLOWANCE, ALLOWANCE), max_size=200))
def test_what_the_model_allows_never_raises_it(residuals):
    alarm = DriftAlarm(1)
    for value in residuals:
        assert not alarm.update([value]).any()


@given(st.floats(-1e6, 1e6))
def test_one_probe_alone_never_raises_it(value):
    assert not DriftAlarm(1).update([value]).any()


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_either_side_raises_it_and_it_stays(sign):
    alarm = DriftAlarm(2)
    raised = [alarm.update([sign * 3.0, 0.2]).tolist() for _ in range(4)]
    assert raised == [[False, False], [False, False], [True, False], [True, False]]
    assert alarm.mean[0] == pytest.approx(sign * 3.0)
    assert alarm.probes.tolist() == [4, 0]
    for _ in range(20):
        assert alarm.update([0.0, 0.0])[0]


def test_what_was_not_probed_does_not_count():
    alarm = DriftAlarm(1)
    alarm.update([3.0])
    before = alarm.state
    alarm.update([np.nan])
    np.testing.assert_array_equal(alarm.state, before)


def test_state_resumes():
    alarm, other = DriftAlarm(2), DriftAlarm(2)
    for _ in range(2):
        alarm.update([3.5, -1.0])
    other.state = alarm.state
    assert other.update([3.0, 0.0]).tolist() == alarm.update([3.0, 0.0]).tolist() == [True, False]
    assert other.sums[0, 0] > CUSUM_LIMIT


def test_far_from_the_training_a_probe_may_miss_by_more():
    residual, noise = np.array([0.6e-6]), np.array([0.8e-6])
    np.testing.assert_allclose(drift_deviation(residual, 0.3, noise), 1e-6)
    assert drift_deviation(residual, 2.0, noise)[0] == pytest.approx(np.hypot(2.1e-6, 0.8e-6))
