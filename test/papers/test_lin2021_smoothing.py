# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Moving averages, erosion and the acceleration pass over feeds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fuzzycnc_ros.papers.feedrate import (
    averaged_points,
    erode,
    erode_average,
    limit_acceleration,
    moving_average,
)

FEEDS = arrays(np.float64, st.integers(1, 40), elements=st.floats(0.0, 1.0))
LENGTHS = st.integers(1, 50)


def window(count, i, before, after, closed):
    places = np.arange(i - before, i + after + 1)
    return places % count if closed else places[(places >= 0) & (places < count)]


@given(FEEDS, LENGTHS, st.booleans(), st.booleans())
def test_average_is_the_mean_of_the_points_present(feeds, length, causal, closed):
    before, after = averaged_points(length, causal)
    assert before + after + 1 == length
    expected = [
        feeds[window(len(feeds), i, before, after, closed)].mean() for i in range(len(feeds))
    ]
    found = moving_average(feeds, length, causal=causal, closed=closed)
    np.testing.assert_allclose(found, expected, atol=1e-14)


@given(FEEDS, LENGTHS, st.booleans())
def test_erosion_mirrors_the_window_of_the_average(feeds, length, closed):
    before, after = averaged_points(length)
    expected = [
        feeds[window(len(feeds), i, after, before, closed)].min() for i in range(len(feeds))
    ]
    np.testing.assert_array_equal(erode(feeds, length, closed=closed), expected)


@given(FEEDS, LENGTHS, st.booleans())
def test_erode_and_average_never_raises_a_feed(feeds, length, closed):
    assert np.all(erode_average(feeds, length, closed=closed) <= feeds + 1e-15)


@given(FEEDS)
def test_one_point_leaves_the_feed(feeds):
    np.testing.assert_array_equal(moving_average(feeds, 1), feeds)
    np.testing.assert_array_equal(erode_average(feeds, 1), feeds)


@given(FEEDS, st.integers(0, 1000))
def test_acceleration_pass_is_the_largest_that_keeps_the_limit(feeds, seed):
    place = np.cumsum(np.random.default_rng(seed).uniform(0.01, 0.1, len(feeds)))
    found = limit_acceleration(feeds, place, 0.5)
    apart = np.abs(place[:, np.newaxis] - place)
    expected = np.sqrt((feeds**2 + 2.0 * 0.5 * apart).min(axis=1))
    np.testing.assert_allclose(found, expected, atol=1e-7)
    assert np.all(found <= feeds)


@pytest.mark.parametrize('function', [moving_average, erode, erode_average])
def test_no_points_are_refused(function):
    with pytest.raises(ValueError, match=r'length: expected at least 1 point.*found 0'):
        function(np.ones(3), 0)
