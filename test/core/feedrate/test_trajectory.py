# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories: never above a limit, on the path, at rest at corners, nearly as fast as can be."""

import numpy as np
import pytest
from paths.path_parts import joined_path, straight_lines
from paths.random_paths import KINDS, random_limits, random_path, used

from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.stream import range_minimum
from fuzzycnc_ros.core.feedrate.motion.trajectory import limit_motion

SQUARE = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
PLAIN = MotionLimits(path_velocity=0.2, path_acceleration=2.0)
SMOOTH = MotionLimits(path_velocity=0.2, path_acceleration=2.0, path_jerk=40.0)


@pytest.mark.slow
@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('axes', [2, 3])
def test_no_sample_exceeds_a_limit(kind, axes):
    for seed in range(50):
        rng = np.random.default_rng([KINDS.index(kind), axes, seed])
        geometry = random_path(rng, kind, axes)
        speed = rng.uniform(0.01, 0.5, len(geometry.node))
        for jerk in (False, True):
            limits = random_limits(rng, axes, jerk)
            found = limit_motion(geometry, speed, limits)
            period = max(1e-3, found.duration / 2000)
            assert used(found, limits, period) <= 1.001, (seed, jerk)
            last = found.sample(period)
            np.testing.assert_allclose(
                last.position[-1], geometry.coefficient[-1, -1], rtol=0.0, atol=1e-12
            )
            assert last.speed[0] == 0.0
            assert last.speed[-1] <= 1e-9
            assert (np.diff(last.arc_length) >= -1e-12).all()


@pytest.mark.parametrize('limits', [PLAIN, SMOOTH])
def test_follows_desired_speeds_and_stops_at_corners(limits):
    geometry = joined_path([straight_lines(SQUARE[k : k + 2]) for k in range(3)]).split(
        np.array([5, 5, 5])
    )
    assert geometry.stop.sum() == 2
    wanted = np.random.default_rng(0).uniform(0.03, 0.3, 16)
    found = limit_motion(geometry, wanted, limits)
    motion = found.sample(1e-4)
    allowed = np.sqrt(np.interp(motion.arc_length, geometry.node, wanted**2))
    assert (motion.speed <= allowed * (1.0 + 1e-9)).all()
    np.testing.assert_allclose(found.speed_at(geometry.node)[[0, 5, 10, 15]], 0.0, atol=1e-6)
    for corner in SQUARE:
        distance = np.linalg.norm(motion.position - corner, axis=1)
        assert distance.min() < 2.0 * 1e-4**2
    # Never off the path: one coordinate is always that of a side.
    x, y = motion.position.T
    off = np.minimum(np.minimum(np.abs(y), np.abs(x - 0.1)), np.abs(y - 0.1))
    assert off.max() < 1e-12


def test_line_takes_the_time_of_the_closed_form():
    geometry = straight_lines([[0.0, 0.0, 1.0], [0.3, 0.4, 1.0]])
    found = limit_motion(geometry, 0.2, PLAIN)
    assert 2.6 <= found.duration <= 1.01 * 2.6  # 0.5 m at 0.2 m/s and 0.1 s of speeding up
    short = straight_lines([[0.0, 0.0], [1e-4, 0.0]])
    assert limit_motion(short, 0.2, PLAIN).duration == pytest.approx(2.0 * np.sqrt(5e-5))
    # With jerk, the average over tau adds tau, and a = j tau / 2 = 1 m/s^2 for speeding up.
    smooth = limit_motion(geometry, 0.2, SMOOTH, window=0.05)
    assert 2.75 <= smooth.duration <= 1.01 * 2.75


def test_axes_alone_limit_the_speed_of_a_diagonal():
    geometry = straight_lines([[0.0, 0.0], [0.3, 0.4]])
    limits = MotionLimits(velocity=(0.06, 0.2), acceleration=(1.0, 0.8))
    motion = limit_motion(geometry, 5.0, limits).sample(1e-3)
    assert motion.speed.max() == pytest.approx(0.1)
    assert np.abs(motion.acceleration[:, 1]).max() == pytest.approx(0.8)


def test_override_before_the_limits_keeps_them():
    rng = np.random.default_rng(5)
    geometry = random_path(rng, 'spline', 2)
    durations = []
    for override in (0.5, 1.0, 3.0):
        found = limit_motion(geometry, 0.05 * override, SMOOTH)
        assert used(found, SMOOTH, 1e-3) <= 1.001
        durations.append(found.duration)
    assert durations == sorted(durations, reverse=True)


def test_a_longer_time_of_averaging_lowers_the_jerk_only():
    geometry = random_path(np.random.default_rng(6), 'spline', 3)
    for window in (0.005, 0.02, 0.1):
        found = limit_motion(geometry, 0.1, SMOOTH, window=window)
        assert found.window == window
        assert used(found, SMOOTH, 1e-3) <= 1.001
    best = limit_motion(geometry, 0.1, SMOOTH)
    assert best.duration <= 1.05 * min(
        limit_motion(geometry, 0.1, SMOOTH, window=window).duration
        for window in (0.005, 0.02, 0.1)
    )


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        ({'speed': 0.0}, 'speed: expected more than 0 m/s, but found 0.0 at node 0'),
        ({'speed': [0.1, np.nan]}, 'found nan at node 1'),
        ({'window': 0.0}, 'window: expected a positive number of s'),
        ({'limits': MotionLimits(path_velocity=1.0, acceleration=(1.0,) * 3)}, 'expected 2'),
    ],
)
def test_bad_input_is_refused(change, text):
    geometry = straight_lines([[0.0, 0.0], [0.1, 0.0]])
    with pytest.raises(ValueError, match=text):
        limit_motion(**({'geometry': geometry, 'speed': 0.1, 'limits': SMOOTH} | change))
    with pytest.raises(ValueError, match='period: expected a positive number of s'):
        limit_motion(geometry, 0.1, PLAIN).sample(0.0)


def test_range_minimum_agrees_with_loops():
    rng = np.random.default_rng(7)
    values = rng.normal(size=300)
    low = rng.integers(0, 300, 500)
    high = low + 1 + (rng.random(500) * (300 - low)).astype(int)
    expected = [values[a:b].min() for a, b in zip(low, high, strict=True)]
    np.testing.assert_array_equal(range_minimum(values, low, high), expected)
