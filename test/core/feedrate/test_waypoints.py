# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Curves through timed waypoints, and ways to rest on them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.feedrate.motion.waypoints import SampledCurve, WaypointCurve

PERIOD = 1e-3


def waypoints(seed, *, speeds=False, bends=False, count=5):
    """Return times, points and what else there is, from rest to rest."""
    rng = np.random.default_rng(seed)
    time = np.append(0.0, np.cumsum(rng.uniform(0.03, 0.5, count - 1)))
    found = [time, rng.normal(size=(count, 2)) * 0.01]
    for wanted, scale in ((speeds, 0.02), (bends, 0.5)):
        if wanted:
            values = scale * rng.normal(size=(count, 2))
            values[[0, -1]] = 0.0
            found.append(values)
    return found


@pytest.mark.parametrize('given_values', [{}, {'speeds': True}, {'speeds': True, 'bends': True}])
def test_curve_passes_what_is_given_and_derivatives_are_its_own(given_values):
    time, position, *others = waypoints(1, **given_values)
    curve = WaypointCurve(time, position, *others)
    found = curve.at(time)
    for given_array, array in zip([position, *others], found, strict=False):
        np.testing.assert_allclose(array, given_array, rtol=0.0, atol=1e-12)
    inner = np.linspace(0.001, curve.duration - 0.001, 50)
    inner = inner[np.abs(inner[:, None] - time).min(axis=1) > 1e-5]
    step = 1e-6
    for number in (0, 1):
        slope = (curve.at(inner + step)[number] - curve.at(inner - step)[number]) / (2.0 * step)
        np.testing.assert_allclose(curve.at(inner)[number + 1], slope, rtol=1e-6, atol=1e-7)
    assert curve.piece(time).tolist() == [0, 1, 2, 3, 3]


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_points_alone_are_never_passed_beyond(seed):
    time, position = waypoints(seed, count=4)
    curve = WaypointCurve(time, position)
    for number in range(len(time) - 1):
        inner, _, _ = curve.at(np.linspace(time[number], time[number + 1], 40, endpoint=False))
        low, high = np.sort(position[number : number + 2], axis=0)
        assert (inner >= low - 1e-12).all()
        assert (inner <= high + 1e-12).all()


def test_samples_end_at_the_last_point_whatever_the_period():
    curve = WaypointCurve(np.array([0.0, 0.0105]), np.array([[0.0], [1e-5]]))
    sampled = SampledCurve(curve, PERIOD)
    samples = sampled.samples
    assert len(sampled) == len(samples.position) == 12
    assert samples.position[-1, 0] == pytest.approx(1e-5, abs=1e-18)
    assert samples.arc_length[-1] == pytest.approx(1e-5, rel=1e-9)
    assert sampled.time(11) == pytest.approx(curve.duration, rel=1e-12)
    assert sampled.time(50) == sampled.time(11)
    mean = np.diff(samples.position[:, 0]) / PERIOD
    middle = 0.5 * (samples.velocity[1:, 0] + samples.velocity[:-1, 0])
    assert np.abs(mean - middle).max() < 0.02 * samples.velocity.max()


@given(seed=st.integers(0, 10_000), share=st.floats(0.0, 1.0))
@settings(max_examples=25, deadline=None)
def test_way_to_rest_stays_on_the_curve_within_the_acceleration(seed, share):
    sampled = SampledCurve(WaypointCurve(*waypoints(seed, speeds=True)), PERIOD)
    every = sampled.samples
    most = np.abs(np.diff(every.velocity, axis=0)).max() / PERIOD
    sample = round(share * (len(sampled) - 2))
    rest = sampled.rest_after(sample, most)
    before = slice(max(0, sample - 1), sample + 1)
    place = np.vstack([every.position[before], rest.position, rest.position[-1:]])
    speed = np.vstack([every.velocity[sample], rest.velocity])
    for values in (np.diff(place, axis=0) / PERIOD, speed):
        assert np.abs(np.diff(values, axis=0)).max() <= 1.006 * most * PERIOD
    assert not rest.velocity[-1].any()
    assert (np.diff(rest.arc_length) >= 0.0).all()
    # where the way is, the curve is too, up to half a step of it
    near = np.linalg.norm(rest.position[:, None] - every.position, axis=2).min(axis=1)
    step = np.linalg.norm(np.diff(every.position, axis=0), axis=1).max()
    assert near.max() <= 0.51 * step


def test_brake_is_as_short_as_the_acceleration_allows():
    """Steady motion at 0.1 m/s: v / a to rest, with what sampling takes."""
    time = np.array([0.0, 0.2, 1.2, 1.4])
    position = np.array([[0.0], [0.01], [0.11], [0.12]])
    speed = np.array([[0.0], [0.1], [0.1], [0.0]])
    sampled = SampledCurve(WaypointCurve(time, position, speed), PERIOD)
    rest = sampled.rest_after(500, 2.0)
    assert 50 <= len(rest.position) <= 56
    assert rest.position[-1, 0] - sampled.samples.position[500, 0] < 0.0028
    # where the curve brakes as hard itself, it is followed as it is
    slow = sampled.rest_after(1250, 0.5)
    np.testing.assert_array_equal(slow.position[-1], sampled.samples.position[-1])
