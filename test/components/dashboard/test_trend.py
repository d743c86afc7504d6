# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Where an offset is going, and when a machine will be stable."""

import numpy as np
import pytest

from fuzzycnc_ros.components.dashboard.trend import STABLE_WITHIN, Trend
from fuzzycnc_ros.runtime.records import SECOND


def trend_of(values, interval=10):
    trend = Trend()
    for number, value in enumerate(values):
        trend.add(SECOND * (1000 + number * interval), float(value))
    return trend


def test_the_rate_is_the_slope_of_the_last_minutes():
    trend = trend_of(np.concatenate([np.zeros(100), 2e-9 * 10 * np.arange(30)]))
    assert trend.rate == pytest.approx(2e-9)
    assert trend.arrow == 'up'
    assert trend_of(-2e-8 * np.arange(30)).arrow == 'down'
    assert trend_of(np.full(30, 5e-6)).arrow == 'steady'


def test_one_sample_has_no_rate():
    assert Trend().rate is None
    assert trend_of([1e-6]).rate is None
    assert trend_of([1e-6]).arrow == 'steady'
    assert Trend().stable_in is None


@pytest.mark.parametrize('tau', [1200.0, 2400.0])
@pytest.mark.parametrize('end', [30e-6, -18e-6])
def test_an_exponential_approach_tells_its_end(tau, end):
    time = np.arange(0.0, 5400.0, 10.0)
    noise = 5e-8 * np.random.default_rng(1).standard_normal(len(time))
    trend = trend_of(end * (1.0 - np.exp(-time / tau)) + noise)
    left = abs(end) * np.exp(-time[-1] / tau)
    true = max(0.0, tau * np.log(left / STABLE_WITHIN))
    assert trend.stable_in == pytest.approx(true, abs=0.2 * tau)


def test_what_is_stable_is_so_now():
    assert trend_of(np.full(400, 12e-6)).stable_in == 0.0


@pytest.mark.parametrize(
    'values',
    [
        2e-8 * np.arange(400),  # a straight line ends nowhere
        1e-6 * np.exp(np.arange(400) / 150.0),  # it runs away
        10e-6 * np.sin(np.arange(400) / 15.0),
        5e-6 * np.random.default_rng(2).standard_normal(400),
        np.linspace(0.0, 1e-5, 20),  # too short
    ],
)
def test_what_is_no_approach_tells_nothing(values):
    assert trend_of(values).stable_in is None


def test_nonsense_is_left_out_and_a_clock_that_goes_back_begins_anew():
    trend = trend_of(1e-7 * np.arange(50))
    before = trend.rate
    trend.add(SECOND * 1500, float('nan'))
    trend.add(SECOND * 1490, 1.0)  # the newest again
    assert trend.rate == before
    trend.add(SECOND * 10, 1e-6)
    assert trend.rate is None
    assert trend.stable_in is None
