# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Motion of a path that arrives in parts: that of the whole, with bounded memory."""

import numpy as np
import pytest
from paths.path_parts import straight_lines
from paths.random_paths import KINDS, arc, random_limits, random_path
from paths.reference_parts import reference_parts
from tiers import rest_slow

from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.stream import MotionStream, default_window
from fuzzycnc_ros.core.feedrate.motion.trajectory import PathMotion, limit_motion

PLAIN = MotionLimits(path_velocity=0.2, path_acceleration=2.0)
SMOOTH = MotionLimits(path_velocity=0.2, path_acceleration=2.0, path_jerk=40.0)
CORNER = straight_lines([[0.0, 0.0], [0.1, 0.0], [0.1, 0.2]])


def streamed(geometry, speed, stream, chunk, **path):
    """Return all motion parts of a path that arrives in parts of `chunk` pieces."""
    found = []
    for k, part in enumerate(reference_parts(geometry, chunk, **path)):
        found += stream.push(part, speed[k * chunk : (k + 1) * chunk + 1])
    return found + stream.finish()


def trajectory_of(parts, window):
    """Return motion parts as one trajectory."""
    return PathMotion.at_rest(parts[0].pieces, window).extended(parts)


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('jerk', rest_slow([False, True], 1))
def test_parts_give_the_motion_of_the_whole(kind, jerk):
    for axes in (2, 3):
        rng = np.random.default_rng([KINDS.index(kind), axes])
        geometry = random_path(rng, kind, axes)
        speed = rng.uniform(0.01, 0.5, len(geometry.node))
        limits = random_limits(rng, axes, jerk)
        window = default_window(limits, axes, 0.5) or None
        whole = limit_motion(geometry, speed, limits, window=window, feed_max=0.5)
        period = whole.duration / 500.5
        expected = whole.sample(period)
        for chunk in (1, 3, 50, 10**6):
            stream = MotionStream(limits, axes, feed_max=0.5)
            assert stream.window == (window or 0.0)
            parts = streamed(geometry, speed, stream, chunk)
            found = trajectory_of(parts, stream.window)
            np.testing.assert_allclose(found.arc_length, whole.arc_length, rtol=0.0, atol=1e-12)
            np.testing.assert_allclose(found.speed, whole.speed, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(found.time, whole.time, rtol=1e-9, atol=1e-9)
            samples = found.sample(period)
            for name in ('position', 'velocity', 'arc_length'):
                np.testing.assert_allclose(
                    getattr(samples, name), getattr(expected, name), rtol=0.0, atol=1e-9
                )
            at = 0.0
            for part in parts:
                assert part.place == pytest.approx(at, abs=1e-12)
                at += part.geometry.length


@pytest.mark.parametrize('limits', [PLAIN, SMOOTH])
def test_what_waits_does_not_grow_with_the_path(limits):
    circle = arc(0.05, 2.0 * np.pi, 2, 400)
    stream, waiting = MotionStream(limits, 2, feed_max=0.2), []
    for lap in range(12):
        place = lap * circle.length
        for part in reference_parts(circle, 50, place=place, last=False):
            stream.push(part, np.full(51, 0.2)[: len(part.stop)])
            waiting.append(len(stream.waiting))
    # 0.2 m/s stop within 10 mm, the window takes 20 mm; that is 39 pieces, or parts of pieces.
    assert max(waiting) <= 70
    assert max(waiting[-20:]) <= max(waiting[:20])
    stream.finish()
    assert len(stream.waiting) == 0


@pytest.mark.parametrize('limits', [PLAIN, SMOOTH])
def test_stops_rest_for_dwell_settling_and_window(limits):
    speed = np.full(3, 0.2)
    times = []
    for more in ({}, {'settle': 0.25}):
        stream = MotionStream(limits, 2, feed_max=0.2, **more)
        parts = streamed(CORNER, speed, stream, 1, rest=0.5 if more else 0.0)
        motion = trajectory_of(parts, stream.window)
        times.append(motion.duration)
        rests = np.diff(motion.time)[np.diff(motion.arc_length) == 0.0]
        expected = stream.window + (0.75 if more else 0.0)
        np.testing.assert_allclose(rests, [expected] if expected else [])
    assert times[1] - times[0] == pytest.approx(0.75)


def test_rests_at_the_ends_are_kept():
    part = reference_parts(CORNER.part(0, 1), 1)[0]
    part.rest[:] = [0.25, 0.5]
    stream = MotionStream(PLAIN, 2, feed_max=0.2)
    found = stream.push(part, np.full(2, 0.2)) + stream.finish()
    motion = trajectory_of(found, 0.0)
    plain = limit_motion(CORNER.part(0, 1), 0.2, PLAIN)
    assert motion.duration == pytest.approx(plain.duration + 0.75)
    np.testing.assert_allclose(motion.along([0.2, motion.duration - 0.4])[0], [0.0, 0.1])


def test_desired_speeds_may_jump_at_nodes():
    line = straight_lines([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]])
    ends = np.array([[0.05, 0.05], [0.15, 0.15]])
    whole = limit_motion(line, ends, PLAIN, feed_max=0.15)
    np.testing.assert_allclose(whole.speed_at([0.05, 0.15]), [0.05, 0.15])
    stream = MotionStream(PLAIN, 2, feed_max=0.15)
    found = stream.push(reference_parts(line, 2)[0], ends) + stream.finish()
    np.testing.assert_allclose(trajectory_of(found, 0.0).speed, whole.speed, rtol=0.0, atol=1e-9)


def test_no_path_gives_no_motion():
    assert MotionStream(PLAIN, 2, feed_max=0.2).finish() == []


def test_window_is_chosen_from_the_limits():
    assert default_window(PLAIN, 2, 0.2) == 0.0
    assert default_window(SMOOTH, 2, 0.2) == pytest.approx(2.0 * 2.0 / 40.0)
    assert default_window(SMOOTH, 2, 0.05) == pytest.approx(np.sqrt(2.0 * 0.05 / 40.0))


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'feed_max': 0.0}, 'feed_max: expected a positive number of m/s, but found 0.0'),
        ({'settle': -1.0}, 'settle: expected 0 s or more, but found -1.0'),
        ({'window': np.inf}, 'window: expected a positive number of s, but found inf'),
        ({'axes': 3, 'limits': MotionLimits(velocity=(1.0,), acceleration=(1.0,))}, 'expected 3'),
    ],
)
def test_bad_settings_are_refused(change, text):
    with pytest.raises(ValueError, match=text):
        MotionStream(**({'limits': PLAIN, 'axes': 2, 'feed_max': 0.2} | change))


def test_bad_parts_are_refused_and_leave_the_stream_as_it_was():
    first, second = reference_parts(CORNER, 1)
    stream = MotionStream(PLAIN, 2, feed_max=0.2)
    found = stream.push(first, np.full(2, 0.2))
    for part, speed, text in (
        (first, 0.1, 'expected it to go on at 0.1 m, where the last part ended, but found 0.0 m'),
        (second, 0.3, 'expected at most feed_max, 0.2 m/s, but found 0.3'),
        (second, 0.0, 'expected more than 0 m/s, but found 0.0 at node 0'),
        (second, [0.1] * 3, r'expected shape \(2,\), one at each node, or \(1, 2\)'),
        (reference_parts(arc(0.1, 1.0, 3, 9), 8)[0], 0.1, 'expected 2 axes, but found 3'),
    ):
        with pytest.raises(ValueError, match=text):
            stream.push(part, speed)
    found += stream.push(second, np.full(2, 0.2)) + stream.finish()
    whole = limit_motion(CORNER, 0.2, PLAIN)
    np.testing.assert_allclose(trajectory_of(found, 0.0).speed, whole.speed, atol=1e-12)
    assert stream.finish() == []
    with pytest.raises(ValueError, match='it has been finished'):
        stream.push(second, 0.1)
