# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Planning while the path arrives: limits kept through changes, holds and tails; on the path."""

from dataclasses import replace

import numpy as np
import pytest
from paths.path_parts import straight_lines
from paths.random_paths import KINDS, arc, random_limits, random_path
from paths.reference_parts import reference_parts

from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.trajectory import MotionSamples, limit_motion
from fuzzycnc_ros.core.feedrate.schedule.feeds import FeedPlan, desired_feed
from fuzzycnc_ros.core.feedrate.schedule.planner import Planner, PlannerSettings
from fuzzycnc_ros.core.feedrate.schedule.scheduler import ConstantFeed, ConstantNormalAcceleration
from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import ToleranceFeed
from fuzzycnc_ros.papers.feedrate import FuzzyScheduler

PLAIN = MotionLimits(path_velocity=0.2, path_acceleration=2.0)
SMOOTH = MotionLimits(path_velocity=0.2, path_acceleration=2.0, path_jerk=40.0)
CORNER = straight_lines([[0.0, 0.0], [0.1, 0.0], [0.1, 0.2]])
FAST = ConstantNormalAcceleration(feed_max=0.2, normal_acceleration=1.0)
STANDARD = PlannerSettings(scheduler=FAST, limits=PLAIN)


def planner_of(geometry, settings=STANDARD, **path):
    """Return a planner that has the whole path."""
    planner = Planner(settings, geometry.axes)
    for part in reference_parts(geometry, 20, **path):
        planner.push(part)
    planner.finish()
    return planner


def rest_of(planner):
    """Return all further samples."""
    found = []
    while not planner.exhausted:
        found.append(planner.take(1000))
    return MotionSamples.join(found, 2)


def largest_of(one, two):
    """Return the larger limits of two of the same kind."""
    found = {}
    for name in ('velocity', 'acceleration', 'jerk'):
        pair = [getattr(limits, f'path_{name}') for limits in (one, two)]
        found[f'path_{name}'] = max(pair)
        if getattr(one, name) is not None:
            found[name] = tuple(np.maximum(getattr(one, name), getattr(two, name)))
    return MotionLimits(**found)


def used(samples, limits, period):
    """Return the largest share of a limit that differences of samples use."""
    velocity, acceleration, jerk = limits.table(samples.position.shape[1])
    pairs = [(samples.velocity, velocity[1:]), (samples.speed, velocity[0])]
    for k, (bound, along) in enumerate(
        [(velocity[1:], None), (acceleration[1:], acceleration[0]), (jerk[1:], jerk[0])], start=1
    ):
        pairs.append((np.diff(samples.position, k, axis=0) / period**k, bound))
        if along is not None:
            pairs.append((np.diff(samples.speed, k - 1) / period ** (k - 1), along))
    # No step in velocity
    pairs.append((np.diff(samples.velocity, axis=0) / period, acceleration[1:]))
    return max(float(np.abs(values / bound).max(initial=0.0)) for values, bound in pairs)


def on_path(samples, geometry):
    """Return how far samples are from the path at their arc length [m]."""
    return float(np.abs(samples.position - geometry.evaluate(samples.arc_length)).max())


def eventful(seed, kind, axes, jerk):
    """Run a path with changes and tails at random moments; check all of it."""
    rng = np.random.default_rng([seed, KINDS.index(kind), axes, jerk])
    geometry = random_path(rng, kind, axes)
    limits = allowed = random_limits(rng, axes, jerk)
    fastest = rng.uniform(0.05, 0.5)
    period = max(1e-3, limit_motion(geometry, fastest, limits).duration / 1500)

    def scheduler():
        bend = 10.0 ** rng.uniform(-1.0, 1.0)
        return ConstantNormalAcceleration(feed_max=fastest, normal_acceleration=bend)

    settle = 0.01 * rng.integers(0, 2)
    planner = Planner(PlannerSettings(scheduler(), limits, period=period, settle=settle), axes)
    parts = reference_parts(geometry, int(rng.choice([1, 3, 50])))
    found, changes = [], 0
    while not planner.exhausted:
        count = int(rng.integers(1, 200))
        while planner.known < (planner.taken + count - 1) * period and not planner.finished:
            if parts:
                planner.push(parts.pop(0))
            else:
                planner.finish()
        found.append(planner.take(count))
        tail = planner.tail()
        together = MotionSamples.join([*found[-3:], tail], axes)
        assert used(together, allowed, period) <= 1.001
        assert on_path(tail, geometry) <= 1e-9
        np.testing.assert_array_equal(tail.velocity[-1], 0.0)
        if rng.random() < 0.3 and changes < 6 and not planner.exhausted:
            changes += 1
            override = 1.0 if planner.held or changes == 6 else rng.choice([0.0, 0.2, 1.0, 2.0])
            new = random_limits(rng, axes, jerk) if rng.random() < 0.5 else limits
            allowed, limits = largest_of(allowed, new), new
            planner.change(
                replace(
                    planner.settings, scheduler=scheduler(), limits=new, override=float(override)
                )
            )
    samples = MotionSamples.join(found, axes)
    assert used(samples, allowed, period) <= 1.001
    assert on_path(samples, geometry) <= 1e-9
    assert (np.diff(samples.arc_length) >= -1e-12).all()
    np.testing.assert_allclose(
        samples.position[-1], geometry.coefficient[-1, -1], rtol=0.0, atol=1e-11
    )
    np.testing.assert_array_equal(samples.velocity[[0, -1]], 0.0)
    return changes


@pytest.mark.parametrize('jerk', [False, True])
@pytest.mark.parametrize('kind', KINDS)
def test_limits_hold_through_changes_and_tails(kind, jerk):
    assert eventful(0, kind, 2 + jerk, jerk) >= 1


@pytest.mark.slow
@pytest.mark.parametrize('jerk', [False, True])
@pytest.mark.parametrize('kind', KINDS)
def test_limits_hold_on_many_paths(kind, jerk):
    for seed in range(2, 12):
        for axes in (2, 3):
            eventful(seed, kind, axes, jerk)


@pytest.mark.parametrize('limits', [PLAIN, SMOOTH])
def test_without_changes_the_motion_is_that_of_the_whole_path(limits):
    geometry = random_path(np.random.default_rng(1), 'spline', 2)
    settings = replace(STANDARD, limits=limits, scheduler=ConstantFeed(feed_max=0.15))
    planner = planner_of(geometry, settings)
    window = None if limits is PLAIN else np.sqrt(2.0 * 0.15 / 40.0)
    expected = limit_motion(geometry, 0.15, limits, feed_max=0.15, window=window).sample(1e-3)
    found = rest_of(planner)
    for name in ('position', 'velocity', 'arc_length', 'speed'):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=0.0, atol=1e-9
        )


@pytest.mark.parametrize('limits', [PLAIN, SMOOTH])
def test_feed_hold_rests_on_the_path_until_it_is_over(limits):
    settings = replace(STANDARD, limits=limits)
    planner = planner_of(CORNER, settings)
    before = planner.take(300)
    planner.change(replace(settings, override=0.0))
    assert planner.held
    assert planner.known == np.inf
    held = planner.take(5000)
    stopping = int(np.argmax(held.speed == 0.0))
    # From 0.2 m/s, at 2 m/s^2 and with the window, 0.1 s each
    assert stopping <= (0.1 if limits is PLAIN else 0.2) / 1e-3 + 1
    np.testing.assert_array_equal(held.velocity[stopping:], 0.0)
    assert (held.position[stopping:] == held.position[stopping]).all()
    planner.change(settings)
    assert not planner.held
    samples = MotionSamples.join([before, held, rest_of(planner)], 2)
    assert used(samples, limits, 1e-3) <= 1.001
    assert on_path(samples, CORNER) <= 1e-9
    np.testing.assert_allclose(samples.position[-1], CORNER.coefficient[-1, -1], atol=1e-12)


def test_hold_from_the_start_and_at_the_end():
    planner = planner_of(CORNER, replace(STANDARD, override=0.0))
    np.testing.assert_array_equal(planner.take(100).position, np.zeros((100, 2)))
    planner.change(STANDARD)
    while planner.take(100).arc_length[-1] < 0.299:
        pass
    planner.change(replace(STANDARD, override=0.0))
    planner.take(1000)
    planner.change(STANDARD)
    last = rest_of(planner)
    assert planner.exhausted
    if len(last):
        np.testing.assert_allclose(last.position[-1], [0.1, 0.2], atol=1e-12)
    assert len(planner.take(5)) == 0


def test_a_hold_at_a_stop_keeps_the_rest_of_its_dwell():
    planner = planner_of(CORNER, rest=1.0)
    arrive = int(np.argmax(rest_of(planner_of(CORNER, rest=1.0)).arc_length == 0.1))
    planner.take(arrive + 100)
    for _ in range(3):  # changes and a hold within the dwell start it anew never
        planner.change(replace(STANDARD, override=0.0))
        planner.take(100)
        planner.change(STANDARD)
        planner.take(100)
    rests = MotionSamples.join([planner.take(600)], 2).arc_length
    leave = arrive + 700 + int(np.argmax(rests > 0.1))
    assert leave - arrive == pytest.approx(1000, abs=2)


@pytest.mark.parametrize('limits', [PLAIN, SMOOTH])
def test_tail_leads_to_rest_without_a_step(limits):
    planner = planner_of(CORNER, replace(STANDARD, limits=limits))
    start = planner.tail()
    assert len(start) == 1
    np.testing.assert_array_equal(start.velocity, 0.0)
    while not planner.exhausted:
        taken = planner.take(40)
        tail = planner.tail()
        assert used(MotionSamples.join([taken, tail], 2), limits, 1e-3) <= 1.001
        np.testing.assert_array_equal(tail.velocity[-1], 0.0)
        # As fast as can be: 0.1 s of braking, as long again for the window, a period each
        assert len(tail) <= (102 if limits is PLAIN else 203)
        assert on_path(tail, CORNER) <= 1e-9


def test_tails_do_not_change_the_planner():
    one, two = planner_of(CORNER), planner_of(CORNER)
    found = []
    while not one.exhausted:
        found.append(one.take(100))
        one.tail()
    expected = rest_of(two)
    position = MotionSamples.join(found, 2).position
    np.testing.assert_allclose(position, expected.position, rtol=0.0, atol=1e-15)


def test_lowered_feed_brakes_with_the_larger_acceleration():
    line = straight_lines([[0.0, 0.0], [1.0, 0.0]])
    for acceleration in (0.5, 8.0):
        planner = planner_of(line)
        planner.take(1000)
        slow = MotionLimits(path_velocity=0.05, path_acceleration=acceleration)
        planner.change(replace(STANDARD, limits=slow))
        speed = planner.take(500).speed
        assert speed[-1] == pytest.approx(0.05)
        reached = int(np.argmax(speed <= 0.05 * (1.0 + 1e-9)))
        assert reached == pytest.approx(150.0 / max(acceleration, 2.0), abs=3.0)


def test_override_scales_feeds():
    programmed = np.array([0.1, np.inf])
    absolute, relative = FAST, FuzzyScheduler(feed_max=0.2)
    assert not absolute.relative
    assert relative.relative
    assert ConstantFeed(feed_max=1.0).relative
    for scheduler, override, expected in (
        (absolute, 1.0, [0.1, 0.16]),
        (absolute, 0.5, [0.05, 0.08]),
        (absolute, 1.5, [0.15, 0.16]),
        (absolute, 0.0, [0.0, 0.0]),
        (relative, 1.0, [0.08, 0.16]),
        (relative, 0.5, [0.04, 0.08]),
        (relative, 1.5, [0.12, 0.24]),
    ):
        found = desired_feed(scheduler, 0.16, programmed, override)
        np.testing.assert_allclose(found, expected)


@pytest.mark.parametrize(
    'scheduler',
    [
        FuzzyScheduler(feed_max=0.2, window=9),
        FuzzyScheduler(feed_max=0.2, window_length=2e-3, smoothing='erode'),
        ToleranceFeed(feed_max=0.2, tolerance=1e-5, machine_constant=2.15e-4, curvature_max=1e4),
    ],
)
@pytest.mark.parametrize('chunk', [1, 7, 1000])
def test_feeds_of_parts_are_those_of_the_whole(scheduler, chunk):
    geometry = random_path(np.random.default_rng(3), 'spline', 2)
    parts = reference_parts(geometry, chunk)
    feeds = FeedPlan(scheduler)
    for part in parts:
        feeds.append(part)
    feeds.finish()
    whole = reference_parts(geometry, 10**6)[0]
    expected = scheduler.feed_max * scheduler.ratio(whole.curvature, geometry.node)
    place, curvature, feed, owner = feeds.at_nodes(0.0, geometry.length)
    np.testing.assert_allclose(feed, expected, rtol=1e-12)
    np.testing.assert_allclose(curvature, whole.curvature, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(place, geometry.node, rtol=0.0, atol=1e-12)
    assert owner.tolist() == [*range(len(place) - 1), len(place) - 2]


def test_schedule_tells_feed_and_speed_at_nodes():
    circle = arc(0.05, 2.0 * np.pi, 2, 100)
    for limits in (PLAIN, SMOOTH):
        planner = planner_of(circle, replace(STANDARD, limits=limits, override=0.5))
        samples = planner.take(1500)
        found = planner.schedule(samples.arc_length[0], samples.arc_length[-1])
        assert len(found.arc_length) > 30
        np.testing.assert_allclose(found.curvature, 20.0, rtol=1e-3)
        np.testing.assert_allclose(found.feed, 0.1, rtol=1e-9)
        expected = np.interp(found.arc_length, samples.arc_length, samples.speed)
        np.testing.assert_allclose(found.speed[1:], expected[1:], atol=2e-3)
        np.testing.assert_array_equal(found.owner, np.arange(len(found.owner)))


def test_what_is_kept_does_not_grow_with_the_path():
    circle = arc(0.02, 2.0 * np.pi, 2, 200)
    kept = []
    planner = Planner(replace(STANDARD, limits=SMOOTH), 2)
    for lap in range(40):
        for part in reference_parts(circle, 50, place=lap * circle.length, last=False):
            planner.push(part)
            while planner.known > (planner.taken + 50) * 1e-3:
                planner.take(50)
            kept.append(planner.kept)
    assert max(kept[80:]) <= 1.02 * max(kept[:80])
    planner.finish()


def test_bad_changes_are_refused_and_change_nothing():
    planner, twin = planner_of(CORNER), planner_of(CORNER)
    for one in (planner, twin):
        one.take(100)
    for change, text in (
        ({'period': 2e-3}, 'period: expected 0.001 s as before, but found 0.002 s'),
        ({'window': 0.1}, 'window: expected 0.0 s as before, but found 0.1 s'),
        ({'limits': SMOOTH}, 'limits: expected none of jerk, as before'),
        (
            {'limits': MotionLimits(velocity=(1.0,) * 3, acceleration=(1.0,) * 3)},
            'expected 2 limits, one per axis, but found 3',
        ),
    ):
        with pytest.raises(ValueError, match=text):
            planner.change(replace(STANDARD, **change))
    np.testing.assert_array_equal(rest_of(planner).position, rest_of(twin).position)


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'override': -0.1}, 'override: expected 0 or more, but found -0.1'),
        ({'settle': np.nan}, 'settle: expected 0 s or more, but found nan'),
        ({'period': 0.0}, 'period: expected a positive number of s, but found 0.0'),
        ({'window': -1.0}, 'window: expected a positive number of s, but found -1.0'),
        (
            {'scheduler': ToleranceFeed(feed_max=0.2, tolerance=1e-5, machine_constant=2.15e-4)},
            'which needs all of it; fix what it takes from the path, such as curvature_max',
        ),
    ],
)
def test_bad_settings_are_refused(change, text):
    with pytest.raises(ValueError, match=text):
        replace(STANDARD, **change)


def test_bad_parts_and_counts_are_refused():
    planner = Planner(STANDARD, 2)
    assert planner.known == -np.inf
    assert len(planner.tail()) == 0
    with pytest.raises(ValueError, match='push more of the path first'):
        planner.take(1)
    first, second = reference_parts(CORNER, 1)
    planner.push(first)
    for part, text in (
        (first, 'expected it to go on at 0.1 m'),
        (reference_parts(arc(0.1, 1.0, 3, 9), 8)[0], 'expected 2 axes, but found 3'),
    ):
        with pytest.raises(ValueError, match=text):
            planner.push(part)
    with pytest.raises(ValueError, match='count: expected 1 or more, but found 0'):
        planner.take(0)
    with pytest.raises(ValueError, match='push more of the path first'):
        planner.take(10**6)
    planner.push(second)
    planner.finish()
    with pytest.raises(ValueError, match='it has been finished'):
        planner.push(second)
    whole = rest_of(planner)
    np.testing.assert_array_equal(whole.position, rest_of(planner_of(CORNER)).position)
