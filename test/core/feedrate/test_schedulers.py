# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Schedulers of the feed: bounds, refusals, special paths, comparators, parts of paths."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.schedule.program_run import stream_ratio
from fuzzycnc_ros.core.feedrate.schedule.scheduler import ConstantFeed, ConstantNormalAcceleration
from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import ToleranceFeed
from fuzzycnc_ros.papers.feedrate import (
    RATIO_SETS,
    ChordErrorFeed,
    FuzzyScheduler,
    JerkLimitedFeed,
    LookAheadFeed,
    chord_error_feed,
    published_feed_rules,
)

FEED = 0.1
SCHEDULERS = [
    ConstantFeed(feed_max=FEED),
    ConstantNormalAcceleration(feed_max=FEED, normal_acceleration=0.2),
    ChordErrorFeed(feed_max=FEED),
    LookAheadFeed(feed_max=FEED),
    JerkLimitedFeed(feed_max=FEED),
    FuzzyScheduler(feed_max=FEED),
    FuzzyScheduler(feed_max=FEED, vvlf='VLF', average=15, smoothing='causal'),
    FuzzyScheduler(feed_max=FEED, smoothing='erode', normalisation='path', window_both=True),
    FuzzyScheduler(feed_max=FEED, window_length=1e-3, exact=True),
    ToleranceFeed(feed_max=FEED, tolerance=1e-5, machine_constant=2e-4),
    ToleranceFeed(feed_max=FEED, tolerance=1e-5, machine_constant=2e-4, guard_step=0.0),
    ToleranceFeed(feed_max=FEED, tolerance=1e-5, machine_constant=2e-4, approach_time=0.0),
]
ALL = pytest.mark.parametrize('scheduler', SCHEDULERS, ids=repr)


def wiggle(count=400, seed=0):
    """Curvature of a path between straight and 50 um of radius, with unequal steps."""
    rng = np.random.default_rng(seed)
    arc_length = np.cumsum(rng.uniform(2e-5, 2e-4, count))
    return SampledPath(arc_length, 10.0 ** rng.uniform(-3.0, 4.3, count))


@ALL
@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 60), st.booleans())
def test_feed_stays_between_least_and_largest(scheduler, seed, count, closed):
    path = wiggle(count, seed)
    path = replace(path, lap=path.arc_length[-1] + 1e-4 if closed else None)
    feed = scheduler.feed(path)
    assert feed.shape == (count,)
    assert np.all((feed >= scheduler.feed_min) & (feed <= FEED))


@ALL
@pytest.mark.parametrize('back', [0.01, 0.004], ids=['equal legs', 'unequal legs'])
def test_reversal_has_the_least_feed(scheduler, back):
    out = np.linspace(0.0, 0.01, 51)
    way = np.concatenate([out, 0.01 - np.linspace(0.0, back, 51)[1:]])
    feed = scheduler.feed(np.column_stack([way, np.zeros(101)]))
    assert feed[50] == pytest.approx(scheduler.feed_min, rel=1e-12)
    if not isinstance(scheduler, LookAheadFeed | JerkLimitedFeed):  # these brake for it
        assert feed[0] == pytest.approx(FEED, rel=1e-9)


@ALL
def test_straight_line_has_full_feed_and_duplicates_share_theirs(scheduler):
    line = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [3.0, 3.0, 0.0]])
    assert scheduler.feed(line) == pytest.approx(np.full(4, FEED))
    assert scheduler.feed(line[:2] + 1e3) == pytest.approx(np.full(2, FEED))


@ALL
def test_ratio_is_the_feed_over_the_largest(scheduler):
    path = wiggle()
    np.testing.assert_allclose(
        FEED * scheduler.ratio(path.curvature, path.arc_length), scheduler.feed(path)
    )


@ALL
def test_equal_schedulers_are_made_by_their_text(scheduler):
    assert eval(repr(scheduler)) == scheduler


@pytest.mark.parametrize('scheduler', [s for s in SCHEDULERS if 'path' not in repr(s)], ids=repr)
def test_closed_path_gives_the_same_wherever_it_starts(scheduler):
    angle = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    lap = np.column_stack([0.02 * np.cos(angle), 0.002 * np.sin(angle)])
    feed = scheduler.feed(SampledPath.from_points(lap, closed=True))
    turned = scheduler.feed(SampledPath.from_points(np.roll(lap, 70, axis=0), closed=True))
    ringed = SampledPath.from_points(np.concatenate([lap, lap[:1]]), closed=True)
    again = scheduler.feed(ringed)
    np.testing.assert_allclose(again[:-1], feed, rtol=1e-9)
    assert again[-1] == again[0]
    if not isinstance(scheduler, LookAheadFeed | JerkLimitedFeed):  # their pass has two ends
        np.testing.assert_allclose(np.roll(turned, -70), feed, rtol=1e-9)


@pytest.mark.parametrize(
    ('arc_length', 'curvature', 'message'),
    [
        ([], [], 'one point or more, but found none'),
        ([0.0, 1.0], [1.0], 'curvature: expected 2 values.*found 1'),
        ([0.0, 1.0, 1.0], [0.0, 0.0, 0.0], 'increasing arc lengths.*found 1.0 at point 2'),
        ([0.0, 1.0, 2.0], [0.0, -3.0, 0.0], 'absolute value; found -3.0 at point 1'),
        ([0.0, 1.0, 2.0], [0.0, 0.0, math.nan], 'finite numbers; found nan at point 2'),
        ([0.0, 1.0, math.inf], [0.0, 0.0, 0.0], 'finite numbers; found inf at point 2'),
        ([[0.0, 1.0]], [[0.0, 0.0]], r'one row of numbers, but found shape \(1, 2\)'),
    ],
)
def test_wrong_paths_are_refused(arc_length, curvature, message):
    with pytest.raises(ValueError, match=message):
        ConstantFeed(feed_max=FEED).ratio(np.array(curvature), np.array(arc_length))


def test_lap_that_repeats_the_first_point_is_refused():
    with pytest.raises(ValueError, match=r'lap: expected a length above.*repeats the first'):
        SampledPath([0.0, 1.0], [0.0, 0.0], lap=1.0)


LOG = SCHEDULERS[-1]


@pytest.mark.parametrize(
    ('scheduler', 'change', 'message'),
    [
        (SCHEDULERS[0], {'feed_max': 0.0}, 'feed_max: expected a positive number, but found 0.0'),
        (SCHEDULERS[0], {'feed_max': math.nan}, 'feed_max: expected a positive number'),
        (SCHEDULERS[0], {'feed_min': 1.0}, 'feed_min: expected at most feed_max'),
        (SCHEDULERS[1], {'normal_acceleration': -1.0}, 'normal_acceleration: expected a positive'),
        (SCHEDULERS[2], {'period': 0.0}, 'period: expected a positive number'),
        (SCHEDULERS[3], {'path_acceleration': 0.0}, 'path_acceleration: expected a positive'),
        (SCHEDULERS[4], {'jerk': 0.0}, 'jerk: expected a positive number'),
        (SCHEDULERS[4], {'erosion': 0}, 'erosion: expected a whole number of points'),
        (SCHEDULERS[5], {'vvlf': 'VVLF'}, "vvlf: expected one of VLF, .*found 'VVLF'"),
        (SCHEDULERS[5], {'window': 0}, 'window: expected a whole number of points'),
        (SCHEDULERS[5], {'average': 2.5}, 'average: expected a whole number of points'),
        (SCHEDULERS[5], {'window_length': 0.0}, 'window_length: expected a positive number'),
        (SCHEDULERS[5], {'smoothing': 'none'}, 'smoothing: expected one of average, causal'),
        (SCHEDULERS[5], {'ratio_centres': (0.1, 1.0)}, 'one centre for each of VLF.*found 2'),
        (SCHEDULERS[5], {'ratio_centres': (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0)}, 'above 0 and at'),
        (LOG, {'tolerance': 0.0}, 'tolerance: expected a positive number, but found 0.0'),
        (LOG, {'tolerance': -1e-5}, 'tolerance: expected a positive number'),
        (LOG, {'margin': 0.9}, 'margin: expected a number from 1.0'),
        (LOG, {'guard_step': 2.0}, 'guard_step: expected a number from 0.0 to 1.0'),
        (LOG, {'guard_length': math.nan}, 'guard_length: expected a number from 0.0'),
        (LOG, {'curvature_max': 0.0}, 'curvature_max: expected a positive number'),
    ],
)
def test_wrong_parameters_are_refused(scheduler, change, message):
    with pytest.raises(ValueError, match=message):
        replace(scheduler, **change)


def test_chord_error_is_the_sagitta_of_a_step():
    curvature, error, period = np.array([10.0, 1e3, 1e5]), 1e-6, 1e-3
    half_chord = 0.5 * period * chord_error_feed(curvature, error, period)
    radius = 1.0 / curvature
    np.testing.assert_allclose(radius - np.sqrt(radius**2 - half_chord**2), error, rtol=1e-6)
    # A step cannot leave more than the radius: half a turn.
    assert chord_error_feed(np.array([1e7]), error, period) == pytest.approx(2e-7 / period)


def test_chord_error_as_knob_is_constant_normal_acceleration():
    path = wiggle()
    error, period = 1e-7, 1e-3
    chord = ChordErrorFeed(feed_max=FEED, chord_error=error).feed(path)
    normal = ConstantNormalAcceleration(
        feed_max=FEED, normal_acceleration=8.0 * error / period**2
    ).feed(path)
    np.testing.assert_allclose(chord, normal, rtol=1e-3)


def test_look_ahead_keeps_both_accelerations():
    path = wiggle()
    feed = LookAheadFeed(feed_max=FEED, normal_acceleration=0.5, path_acceleration=0.8).feed(path)
    assert np.all(path.curvature * feed**2 <= 0.5 * (1.0 + 1e-9))
    along = np.abs(np.diff(feed**2)) / (2.0 * np.diff(path.arc_length))
    assert along.max() <= 0.8 * (1.0 + 1e-9)


def test_rules_name_their_sets_and_only_two_depend_on_the_misprint():
    low, high = published_feed_rules('VLF'), published_feed_rules('TF')
    assert {name for row in low for name in row} == set(RATIO_SETS)
    changed = [(i, j) for i in range(6) for j in range(5) if low[i][j] != high[i][j]]
    assert changed == [(0, 4), (1, 4)]


def test_erosion_never_raises_the_feed_where_the_plain_average_does():
    path = wiggle()
    bare = FuzzyScheduler(feed_max=FEED, average=1).feed(path)
    assert np.all(
        FuzzyScheduler(feed_max=FEED, average=31, smoothing='erode').feed(path)
        <= bare * (1 + 1e-12)
    )
    assert np.any(FuzzyScheduler(feed_max=FEED, average=31).feed(path) > bare)


def test_window_in_arc_length_does_not_depend_on_the_sampling():
    arc_length = np.linspace(0.0, 0.02, 401)
    bump = 2500.0 * np.exp(-(((arc_length - 0.01) / 1e-3) ** 2))
    scheduler = FuzzyScheduler(feed_max=FEED, window_length=2e-3, average=1)
    fine, coarse = (scheduler.ratio(bump[::step], arc_length[::step]) for step in (1, 4))
    np.testing.assert_allclose(fine[::4], coarse, atol=1e-12)


def test_feed_of_a_tolerance_goes_on_falling_beyond_the_given_curvature():
    scheduler = ToleranceFeed(
        feed_max=FEED, tolerance=1e-5, machine_constant=2e-4, curvature_max=1e3
    )
    ratio = [scheduler.ratio(np.full(2, x), np.array([0.0, 1.0]))[0] for x in (1e3, 4e3, 1.6e4)]
    assert ratio[1] / ratio[0] == pytest.approx(0.5, rel=1e-9)
    assert ratio[2] / ratio[1] == pytest.approx(0.5, rel=1e-9)


def test_guard_covers_what_lies_between_samples_and_near_peaks():
    arc_length = np.linspace(0.0, 1e-3, 101)
    curvature = np.full(101, 100.0)
    curvature[50] = 1e4
    path = SampledPath(arc_length, curvature)
    scheduler = ToleranceFeed(
        feed_max=FEED, tolerance=1e-5, machine_constant=2e-4, guard_length=3.5e-5
    )
    wide = scheduler.guarded(path)
    assert np.flatnonzero(wide == 1e4).tolist() == list(range(47, 54))
    step = replace(scheduler, guard_time=0.0).guarded(path)
    assert step[[48, 49, 50, 51, 52]] == pytest.approx([1e2, 1e3, 1e4, 1e3, 1e2])
    slow = replace(scheduler, guard_time=0.0, guard_step=0.0).guarded(path)
    np.testing.assert_array_equal(slow, curvature)
    # At the peak the feed is sqrt(1e-5 / 2e-4 / 1e4) m/s: 11 um in 5 ms.
    short = replace(scheduler, guard_time=0.005, guard_step=0.0).guarded(path)
    assert np.flatnonzero(short == 1e4).tolist() == [49, 50, 51]


STREAMED = [
    SCHEDULERS[0],
    SCHEDULERS[1],
    SCHEDULERS[5],
    SCHEDULERS[6],
    SCHEDULERS[8],
    FuzzyScheduler(feed_max=FEED, smoothing='erode', average=8, window_both=True),
    replace(SCHEDULERS[10], curvature_max=2e4, guard_length=5e-4),
    replace(SCHEDULERS[9], curvature_max=2e4),
]


@pytest.mark.parametrize('scheduler', STREAMED, ids=repr)
@settings(max_examples=30)
@given(st.lists(st.integers(1, 90), min_size=1, max_size=40), st.integers(0, 100))
def test_parts_give_what_the_whole_path_gives(scheduler, sizes, seed):
    path = wiggle(sum(sizes), seed)
    path = replace(path, reversal=np.random.default_rng(seed).random(sum(sizes)) < 0.01)
    edges = np.cumsum([0, *sizes])
    parts = (
        SampledPath(path.arc_length[a:b], path.curvature[a:b], reversal=path.reversal[a:b])
        for a, b in pairwise(edges)
    )
    ratio = np.concatenate(list(stream_ratio(scheduler, parts)))
    np.testing.assert_allclose(ratio, scheduler.bounded_ratio(path), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    'scheduler', [SCHEDULERS[3], SCHEDULERS[4], SCHEDULERS[7], SCHEDULERS[9]], ids=repr
)
def test_schedulers_that_need_the_whole_path_say_so(scheduler):
    with pytest.raises(ValueError, match='scheduler: expected one that can take a path in parts'):
        next(stream_ratio(scheduler, iter([wiggle()])))


def test_parts_that_do_not_follow_each_other_are_refused():
    with pytest.raises(ValueError, match='arc_length: expected increasing'):
        list(stream_ratio(SCHEDULERS[5], [wiggle(), wiggle()]))


def test_waiting_points_are_bounded_by_the_reach():
    scheduler = SCHEDULERS[5]
    path = wiggle(4000)
    parts = (
        SampledPath(path.arc_length[a : a + 10], path.curvature[a : a + 10])
        for a in range(0, 4000, 10)
    )
    out = 0
    for count, ratio in enumerate(stream_ratio(scheduler, parts), start=1):
        out += len(ratio)
        assert out >= min(10 * count, 4000) - scheduler.reach.points_ahead
