# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Share of the approach to a bend in the contour error, and what the scheduler makes of it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.schedule.program_run import stream_ratio
from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import (
    SHARE_MAX,
    SHARE_MIN,
    ToleranceFeed,
    approach_share,
)

SCHEDULER = ToleranceFeed(feed_max=0.1, tolerance=1e-5, machine_constant=2e-4, curvature_max=2e4)


def straight(arc_length, lap=None):
    return SampledPath(arc_length, np.zeros(len(arc_length)), lap)


def test_share_is_the_mean_of_both_speeds_over_that_at_the_point():
    arc = np.linspace(0.0, 1.0, 1001)
    speed = 0.3 - 0.2 * arc
    share = approach_share(straight(arc), speed, 0.5, 1.0)
    # the speed changes by -0.2/s times the way of half a second
    assert share[500] == pytest.approx(1.0 + 0.5 * 0.2 * 0.5, abs=1e-12)
    rising = approach_share(straight(arc), speed[::-1].copy(), 0.5, 1.0)
    assert rising[500] == pytest.approx(1.0 - 0.5 * 0.2 * 0.5, abs=1e-12)
    # before the first point the speed is that of the first point
    assert share[0] == rising[0] == 1.0


@given(st.integers(0, 1000), st.floats(0.0, 10.0), st.floats(0.0, 1.0))
def test_share_is_bounded_and_one_at_constant_speed(seed, time, length):
    rng = np.random.default_rng(seed)
    arc = np.cumsum(rng.uniform(1e-6, 0.1, 50))
    lap = arc[-1] + 0.01 if seed % 2 else None
    share = approach_share(straight(arc, lap), rng.uniform(1e-3, 1.0, 50), time, length)
    assert np.all((share >= SHARE_MIN) & (share <= SHARE_MAX))
    same = approach_share(straight(arc, lap), np.full(50, 0.2), time, length)
    np.testing.assert_allclose(same, 1.0, rtol=0.0, atol=1e-15)


def test_share_of_a_closed_path_looks_across_its_start():
    arc = np.linspace(0.0, 1.0, 100, endpoint=False)
    speed = 0.2 + 0.1 * np.sin(2.0 * np.pi * arc)
    whole = approach_share(straight(arc, 1.0), speed, 1.0, 1.0)
    turned = approach_share(straight(arc, 1.0), np.roll(speed, 37), 1.0, 1.0)
    np.testing.assert_allclose(turned, np.roll(whole, 37), rtol=0.0, atol=1e-12)


def test_feed_is_lower_before_a_bend_than_after():
    arc = np.linspace(0.0, 0.04, 801)
    # the same curvature at equal ways before and after the sharpest place
    path = SampledPath(arc, 500.0 * np.exp(-(((arc - 0.02) / 0.004) ** 2)))
    ratio = SCHEDULER.bounded_ratio(path)
    even = replace(SCHEDULER, approach_time=0.0).bounded_ratio(path)
    np.testing.assert_allclose(even, even[::-1], rtol=1e-9)
    curved = even < 0.9
    before = curved & (arc < 0.0195)
    after = curved & (arc > 0.021)
    assert np.all(ratio[before] < even[before])
    assert np.all(ratio[after] > even[after])


def test_time_follows_the_machine_constant_unless_it_is_given():
    arc = np.linspace(0.0, 0.04, 801)
    path = SampledPath(arc, 500.0 * np.exp(-(((arc - 0.02) / 0.004) ** 2)))
    given_time = replace(SCHEDULER, approach_time=1.9 * np.sqrt(2e-4))
    np.testing.assert_allclose(given_time.bounded_ratio(path), SCHEDULER.bounded_ratio(path))


@given(st.floats(-3.0, 4.0))
def test_feed_is_the_root_law(decade):
    path = SampledPath([0.0, 1.0], np.full(2, 10.0**decade))
    full = 0.1**2 * 2e-4 * SCHEDULER.margin / 1e-5
    law = min(1.0, (full * 10.0**decade) ** -0.5)
    assert SCHEDULER.bounded_ratio(path)[0] == pytest.approx(law, rel=1e-12)


@pytest.mark.parametrize(
    'choices',
    [{}, {'approach_time': 0.2}, {'approach_time': 0.0, 'guard_step': 0.0}],
    ids=str,
)
@given(st.lists(st.integers(1, 90), min_size=1, max_size=20), st.integers(0, 100))
def test_parts_give_what_the_whole_path_gives(choices, sizes, seed):
    scheduler = replace(SCHEDULER, **choices)
    rng = np.random.default_rng(seed)
    arc = np.cumsum(10.0 ** rng.uniform(-6.0, -2.0, sum(sizes)))
    path = SampledPath(arc, 10.0 ** rng.uniform(-3.0, 4.3, sum(sizes)))
    parts = (
        SampledPath(arc[a:b], path.curvature[a:b]) for a, b in pairwise(np.cumsum([0, *sizes]))
    )
    ratio = np.concatenate(list(stream_ratio(scheduler, parts)))
    np.testing.assert_allclose(ratio, scheduler.bounded_ratio(path), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'approach_time': -1.0}, 'approach_time: expected a number from 0.0'),
        ({'approach_time': float('nan')}, 'approach_time: expected a number from 0.0'),
    ],
)
def test_wrong_parameters_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(SCHEDULER, **change)
