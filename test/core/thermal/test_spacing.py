# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Readings at any spacing become samples: none is lost that could be kept, and a gap stays one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.thermal.spacing import (
    BRIDGED_MAX,
    block_means,
    sample_interval,
    usual_step,
)


def times(*steps, repeated):
    return np.concatenate([[0.0], np.cumsum(np.tile(steps, repeated))])


def grid_of(time, interval):
    """Return points in a block and blocks, as an import chooses them."""
    block = max(1, round(interval / float(np.median(np.diff(time)))))
    return block, int(time[-1] / (interval / block) + 1.0) // block


@st.composite
def patterns(draw):
    """Return times of readings: steps that repeat, each a little off."""
    steps = draw(st.lists(st.floats(0.5, 120.0), min_size=1, max_size=6))
    time = times(*steps, repeated=draw(st.integers(15, 40)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    jitter = draw(st.floats(0.0, 0.4)) * float(np.diff(time).min())
    return time + np.concatenate([[0.0], rng.uniform(0.0, jitter, len(time) - 1)])


@pytest.mark.parametrize(
    ('steps', 'expected'),
    [
        ((15.0,), 15.0),
        ((4.0, 4.0, 53.0), 61.0),
        ((10.0, 40.0), 50.0),
        ((1.0,) * 59 + (241.0,), 300),
    ],
)
def test_the_interval_of_samples_is_the_time_from_burst_to_burst(steps, expected):
    assert sample_interval(times(*steps, repeated=40)) == pytest.approx(expected)


def test_a_gap_is_no_spacing_of_readings():
    time = np.concatenate([15.0 * np.arange(100), 36000.0 + 15.0 * np.arange(100)])
    assert sample_interval(time) == usual_step(time, 45.0) == 15.0
    hours = (3600.0 * np.arange(24)[:, np.newaxis] + 10.0 * np.arange(60)).ravel()
    assert sample_interval(hours) == 10.0


@pytest.mark.parametrize('steps', [(4.0, 4.0, 53.0), (10.0, 40.0), (1.0, 1.0, 1.0, 57.0)])
def test_readings_in_bursts_give_a_sample_a_minute(steps):
    time = times(*steps, repeated=60)
    values = np.column_stack([20.0 + 1e-3 * time, np.full(len(time), 21.0)])
    block, count = grid_of(time, 60.0)
    means = block_means(time, values, 60.0, block, count)
    assert count >= time[-1] // 60.0
    # The middle of a block lies half of its points before its stamp.
    middle = 60.0 * (np.arange(count) + 0.5) - 30.0 / block
    np.testing.assert_allclose(means[:, 0], 20.0 + 1e-3 * middle, atol=1e-3)
    np.testing.assert_allclose(means[:, 1], 21.0, rtol=1e-12)


def test_one_missing_reading_leaves_its_block():
    time = 15.0 * np.arange(120)
    values = np.column_stack([20.0 + 0.01 * time, np.full(120, 21.0)])
    values[41, 0] = np.nan  # one of the four of block 10
    values[60:64, 1] = np.nan  # all of block 15
    means = block_means(time, values, 60.0, 4, 30)
    np.testing.assert_allclose(means[:, 0], 20.0 + 0.01 * (60.0 * np.arange(30) + 22.5))
    assert np.flatnonzero(np.isnan(means[:, 1])).tolist() == [15]


def test_a_sensor_that_reads_less_often_keeps_what_it_read():
    time = 15.0 * np.arange(240)
    values = np.full((240, 1), np.nan)
    values[::20, 0] = np.arange(12)  # every five minutes
    means = block_means(time, values, 60.0, 4, 60)
    assert np.flatnonzero(np.isfinite(means[:, 0])).tolist() == list(range(0, 60, 5))
    np.testing.assert_array_equal(means[::5, 0], np.arange(12))


def check_blocks(time, interval, gone):
    """Check one pattern; `gone` says which readings are missing."""
    block, count = grid_of(time, interval)
    values = np.where(gone, np.nan, 20.0)[:, np.newaxis]
    means = block_means(time, values, interval, block, count)[:, 0]
    assert not (np.abs(means[np.isfinite(means)] - 20.0) > 1e-9).any()
    place = np.rint(time / (interval / block)).astype(int) // block
    with_reading = np.unique(place[~gone])
    with_reading = with_reading[with_reading < count]
    assert np.isfinite(means[with_reading]).all()
    marked = np.setdiff1d(np.arange(count)[np.isin(np.arange(count), place)], with_reading)
    assert np.isnan(means[marked]).all()


@settings(max_examples=40, deadline=None)
@given(patterns(), st.floats(0.3, 8.0), st.integers(0, 2**32 - 1), st.floats(0.0, 0.9))
def test_a_block_with_a_reading_is_a_sample(time, intervals, seed, share):
    gone = np.random.default_rng(seed).random(len(time)) < share
    check_blocks(time, intervals * float(np.median(np.diff(time))), gone)


@settings(max_examples=40, deadline=None)
@given(patterns())
def test_the_named_interval_leaves_no_sample_out(time):
    interval = sample_interval(time)
    block, count = grid_of(time, interval)
    means = block_means(time, np.ones((len(time), 1)), interval, block, count)
    assert np.isfinite(means).all()


@settings(max_examples=40, deadline=None)
@given(patterns(), st.floats(0.5, 8.0), st.floats(1.5, 50.0))
def test_a_gap_stays_a_gap(time, intervals, length):
    interval = intervals * float(np.median(np.diff(time)))
    longest = BRIDGED_MAX * max(interval, float(np.diff(time).max()))
    half = len(time) // 2
    begin, end = time[half - 1], time[half - 1] + length * longest
    gapped = np.concatenate([time[:half], end + time[half:] - time[half]])
    block, count = grid_of(gapped, interval)
    means = block_means(gapped, np.ones((len(time), 1)), interval, block, count)[:, 0]
    stamp = interval / block * (block * np.arange(1, count + 1) - 1.0)
    inside = (stamp - interval > begin) & (stamp + interval / block < end)
    assert np.isnan(means[inside]).all()
