# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.feedrate.path.windows import arc_window_maximum, window_maximum

values = st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=25).map(np.array)
counts = st.integers(0, 40)
lengths = st.floats(0.0, 5.0)


@settings(deadline=None, max_examples=150)
@given(value=values, ahead=counts, behind=counts, closed=st.booleans())
def test_window_in_points_is_the_maximum_of_each_slice(value, ahead, behind, closed):
    n = len(value)
    for i, found in enumerate(window_maximum(value, ahead, behind, closed=closed)):
        index = np.arange(i - behind, i + ahead + 1)
        index = index % n if closed else index[(index >= 0) & (index < n)]
        assert found == value[index].max()


@settings(deadline=None, max_examples=150)
@given(
    value=values,
    ahead=lengths,
    behind=lengths,
    gap=st.none() | st.floats(0.0, 1.0),
    seed=st.integers(0, 99),
)
def test_window_in_arc_length_is_the_maximum_within_reach(value, ahead, behind, gap, seed):
    rng = np.random.default_rng(seed)
    # Some steps are 0: points in one place see each other both ways.
    arc = np.cumsum(rng.choice([0.0, 1.0], len(value)) * rng.uniform(0.0, 1.0, len(value)))
    period = None if gap is None else arc[-1] - arc[0] + gap
    found = arc_window_maximum(value, arc, ahead, behind, period=period)
    for i, largest in enumerate(found):
        apart = arc - arc[i]
        if period is not None:
            apart = np.concatenate([apart - period, apart, apart + period])
        inside = (apart >= -behind * (1 + 1e-9)) & (apart <= ahead * (1 + 1e-9))
        around = value if period is None else np.tile(value, 3)
        assert largest == around[inside].max()


def test_published_window_counts_the_point_itself():
    value = np.zeros(100)
    value[50] = 1.0
    assert np.flatnonzero(window_maximum(value, ahead=29)).tolist() == list(range(21, 51))
    assert np.flatnonzero(window_maximum(value, 3, 2)).tolist() == list(range(47, 53))
    assert np.flatnonzero(window_maximum(value, 60, closed=True)).tolist() == [
        *range(51),
        *range(90, 100),
    ]


@pytest.mark.parametrize(('ahead', 'behind'), [(29, 7), (9_000, 500), (0, 30_000)])
def test_both_windows_agree_on_equal_steps(ahead, behind):
    n, step = 20_000, 1e-4  # whose multiples are rounded
    value = np.random.default_rng(0).uniform(size=n)
    arc = step * np.arange(n)
    for period in (None, n * step):
        closed = period is not None
        found = arc_window_maximum(value, arc, ahead * step, behind * step, period=period)
        assert found.tolist() == window_maximum(value, ahead, behind, closed=closed).tolist()


def test_infinite_values_and_lengths_are_taken_as_they_are():
    assert window_maximum([-np.inf, 1.0, np.inf], 1).tolist() == [1.0, np.inf, np.inf]
    assert arc_window_maximum([1.0, 3.0, 2.0], [0, 1, 2], np.inf).tolist() == [3.0, 3.0, 2.0]
    assert arc_window_maximum([1.0, 3.0, 2.0], [0, 1, 2], np.inf, period=3.0).tolist() == [3.0] * 3


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (([], 1), r'shape \(n,\), n >= 1'),
        (([[1.0]], 1), r'shape \(n,\), n >= 1'),
        (([1.0, np.nan], 1), 'NaN at index 1'),
        (([1.0], -1), 'ahead as an integer of 0 or more but found -1'),
        (([1.0], 1.5), 'ahead as an integer of 0 or more but found 1.5'),
        (([1.0], 1, -2), 'behind as an integer of 0 or more but found -2'),
    ],
)
def test_what_is_no_window_in_points_is_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        window_maximum(*arguments)


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (([1.0, np.nan], [0.0, 1.0], 1.0), 'NaN at index 1'),
        (([1.0, 2.0], [0.0], 1.0), r'arc_length of shape \(2,\) but found \(1,\)'),
        (([1.0, 2.0], [1.0, 0.0], 1.0), 'never to fall'),
        (([1.0, 2.0], [0.0, np.nan], 1.0), 'finite'),
        (([1.0, 2.0], [0.0, 1.0], -1.0), 'ahead of 0 m or more but found -1.0'),
        (([1.0, 2.0], [0.0, 1.0], 1.0, np.nan), 'behind of 0 m or more but found nan'),
    ],
)
def test_what_is_no_window_in_arc_length_is_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        arc_window_maximum(*arguments)


@pytest.mark.parametrize('period', [0.5, np.nan, np.inf])
def test_period_shorter_than_the_path_is_refused(period):
    with pytest.raises(ValueError, match='period of at least the length of the path, 1 m'):
        arc_window_maximum([1.0, 2.0], [0.0, 1.0], 1.0, period=period)
