# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Backward-forward pass: below the desired speed, within the acceleration, no slower than that."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits, reachable_speed


def schedule(seed, n):
    """Uneven points with repeats, speeds in steps, some of them zero."""
    rng = np.random.default_rng(seed)
    place = np.cumsum(rng.uniform(0.0, 2e-4, n) * (rng.random(n) > 0.05))
    speed = rng.uniform(0.0, 0.3, n // 20 + 1).repeat(20)[:n]
    return place, speed, rng.random(n) < 0.01


def plain(place, speed, most, start, end, stop):
    """Return the pass as two loops over points."""
    square = np.where(stop, 0.0, speed**2)
    square[0] = min(square[0], start**2)
    square[-1] = min(square[-1], end**2)
    rise = 2.0 * np.broadcast_to(most, len(place) - 1) * np.diff(place)
    for k in range(len(place) - 2, -1, -1):
        square[k] = min(square[k], square[k + 1] + rise[k])
    for k in range(len(place) - 1):
        square[k + 1] = min(square[k + 1], square[k] + rise[k])
    return np.sqrt(square)


@pytest.mark.parametrize('n', [1, 2, 50, 4096, 4097, 20000])
def test_agrees_with_loops_over_points(n):
    place, speed, stop = schedule(n, n)
    for most in (1.5, np.random.default_rng(n).uniform(0.5, 3.0, n - 1)):
        found = reachable_speed(place, speed, most, start=0.02, end=0.3, stop=stop)
        expected = plain(place, speed, most, 0.02, 0.3, stop)
        np.testing.assert_allclose(found**2, expected**2, rtol=0.0, atol=1e-14)


def test_no_points_give_no_speeds():
    assert reachable_speed([], [], 1.0).shape == (0,)


@given(st.integers(0, 2**32 - 1), st.integers(2, 300), st.floats(0.1, 10.0))
def test_laws(seed, n, most):
    place, speed, stop = schedule(seed, n)
    found = reachable_speed(place, speed, most, stop=stop)
    assert (found <= speed).all()
    assert (found >= 0.0).all()
    assert found[0] == found[-1] == 0.0
    assert (found[stop] == 0.0).all()
    rise = np.abs(np.diff(found**2))
    assert (rise <= 2.0 * most * np.diff(place) + 1e-14).all()
    back = reachable_speed(place[-1] - place[::-1], speed[::-1], most, stop=stop[::-1])[::-1]
    np.testing.assert_allclose(back**2, found**2, rtol=0.0, atol=1e-13)
    faster = reachable_speed(place, speed, 2.0 * most, stop=stop)
    assert (faster >= found - 1e-7).all()


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        (([0.0, 1.0], [1.0], 1.0), r'found \(2,\), \(1,\)'),
        (([0.0, 1.0], [1.0, 1.0], [1.0, 1.0]), r'shape \(n - 1,\)'),
        (([0.0, 1.0, 0.5], [1.0] * 3, 1.0), 'steps of arc_length: .* found -0.5 at 1'),
        (([0.0, np.nan], [1.0, 1.0], 1.0), 'arc_length: expected finite'),
        (([0.0, 1.0], [1.0, -1.0], 1.0), 'speed: .* found -1.0 at 1'),
        (([0.0, 1.0], [1.0, np.inf], 1.0), 'speed: .* found inf at 1'),
        (([0.0, 1.0], [1.0, 1.0], 0.0), 'acceleration: .* found 0.0'),
    ],
)
def test_bad_input_is_refused(arguments, text):
    with pytest.raises(ValueError, match=text):
        reachable_speed(*arguments)


def test_bad_speeds_at_the_ends_are_refused():
    for name in ('start', 'end'):
        with pytest.raises(ValueError, match=f'{name}: expected a speed'):
            reachable_speed([0.0, 1.0], [1.0, 1.0], 1.0, **{name: -0.1})


@pytest.mark.parametrize(
    ('limits', 'text'),
    [
        ({'path_velocity': 0.0, 'path_acceleration': 1.0}, 'path_velocity: .* found 0.0'),
        ({'path_velocity': 1.0, 'path_acceleration': -1.0}, 'path_acceleration: .* -1.0'),
        ({'path_velocity': 1.0, 'acceleration': (1.0, np.nan)}, 'acceleration: .* nan'),
        ({'path_velocity': 1.0}, r'expected a limit of acceleration \[m/s\^2\], but found none'),
        ({'path_acceleration': 1.0}, 'expected a limit of velocity'),
    ],
)
def test_bad_limits_are_refused(limits, text):
    with pytest.raises(ValueError, match=text):
        MotionLimits(**limits)


def test_limits_of_axes_must_fit_the_path():
    limits = MotionLimits(path_velocity=1.0, acceleration=(1.0, 2.0))
    np.testing.assert_array_equal(limits.table(2)[1], [np.inf, 1.0, 2.0])
    with pytest.raises(ValueError, match='acceleration: expected 3 limits, one per axis'):
        limits.table(3)
