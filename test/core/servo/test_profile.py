# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Jerk-limited point-to-point profiles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.servo.profile import ProfileLimits, Reference, point_to_point

PLACE = st.floats(-0.3, 0.3)
LIMITS = st.builds(
    ProfileLimits,
    velocity=st.floats(0.01, 0.5),
    acceleration=st.floats(0.1, 10.0),
    jerk=st.floats(1.0, 500.0),
)


def course(profile, samples=4001):
    time = np.linspace(0.0, profile.duration, samples)
    return time, *profile.at(time)


@given(PLACE, PLACE, LIMITS)
def test_from_rest_it_keeps_the_limits_and_ends_at_rest_on_target(start, target, limits):
    profile = point_to_point(start, target, limits)
    _, position, velocity, acceleration = course(profile)
    assert position[0] == pytest.approx(start, abs=1e-12)
    assert position[-1] == target
    assert velocity[-1] == acceleration[-1] == 0.0
    assert np.abs(velocity).max() <= limits.velocity * (1.0 + 1e-9)
    assert np.abs(acceleration).max() <= limits.acceleration * (1.0 + 1e-9)
    assert np.abs(profile.jerk).max() <= limits.jerk * (1.0 + 1e-9)
    # it never turns round nor passes the target
    assert ((position - target) * np.sign(start - target) >= -1e-12).all()


@given(PLACE, PLACE, LIMITS, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_from_motion_it_is_continuous_and_ends_at_rest_on_target(
    start, target, limits, speed, push
):
    velocity, acceleration = speed * limits.velocity, push * limits.acceleration
    profile = point_to_point(start, target, limits, velocity=velocity, acceleration=acceleration)
    first = [part[0] for part in profile.at(np.array([0.0]))]
    assert first == pytest.approx([start, velocity, acceleration], abs=1e-9)
    before = [part[0] for part in profile.at(np.array([profile.duration * (1.0 - 1e-12)]))]
    assert before == pytest.approx([target, 0.0, 0.0], abs=1e-6 * (1.0 + limits.acceleration))
    # the velocity that is left when the acceleration has come down may be above the limit
    high = limits.velocity + acceleration**2 / (2.0 * limits.jerk)
    _, _, speeds, rises = course(profile)
    assert np.abs(speeds).max() <= high * (1.0 + 1e-9)
    assert np.abs(rises).max() <= limits.acceleration * (1.0 + 1e-9)


def test_derivatives_fit_each_other():
    profile = point_to_point(0.01, -0.12, velocity=0.1, acceleration=-0.7)
    time, position, velocity, acceleration = course(profile, 200_001)
    step = time[1]
    assert np.gradient(position, step)[1:-1] == pytest.approx(velocity[1:-1], abs=1e-6)
    assert np.gradient(velocity, step)[1:-1] == pytest.approx(acceleration[1:-1], abs=1e-3)


def test_from_rest_it_is_the_seven_phases_of_the_textbook():
    limits = ProfileLimits(velocity=0.2, acceleration=1.5, jerk=30.0)
    profile = point_to_point(0.0, 0.17, limits)
    # way / velocity + velocity / acceleration + acceleration / jerk
    assert profile.duration == pytest.approx(0.17 / 0.2 + 0.2 / 1.5 + 1.5 / 30.0)
    assert len(profile.jerk) == 7
    short = point_to_point(0.0, 1e-4, limits)
    assert short.duration == pytest.approx(4.0 * (1e-4 / (2.0 * 30.0)) ** (1.0 / 3.0))


def test_no_way_takes_no_time():
    profile = point_to_point(0.1, 0.1)
    assert profile.duration == 0.0
    assert [float(part) for part in profile.at(1.0)] == [0.1, 0.0, 0.0]


def test_samples_end_at_rest_on_target_and_are_padded():
    reference = point_to_point(0.0, 0.05).sample(1e-3)
    assert reference.position[-1] == 0.05
    assert reference.velocity[-1] == reference.acceleration[-1] == 0.0
    position, velocity, _ = reference.over(1.0)
    assert len(position) == 1000
    assert position[-1] == 0.05
    assert velocity[-1] == 0.0
    assert len(reference.over(0.1)[0]) == 100


@pytest.mark.parametrize(
    ('call', 'message'),
    [
        (lambda: ProfileLimits(jerk=0.0), 'jerk: expected a positive number'),
        (lambda: point_to_point(float('nan'), 1.0), 'start: expected a finite number'),
        (lambda: point_to_point(0.0, 1.0, acceleration=float('inf')), 'acceleration: expected'),
        (lambda: point_to_point(0.0, 1.0).sample(0.0), 'period: expected a positive'),
        (lambda: Reference(np.zeros(2), np.zeros(2), np.zeros(3), 1e-3), 'one position, velocity'),
        (lambda: Reference(np.zeros(0), np.zeros(0), np.zeros(0), 1e-3), 'one position, velocity'),
        (lambda: Reference(np.full(1, np.nan), np.zeros(1), np.zeros(1), 1e-3), 'finite numbers'),
    ],
)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=message):
        call()
