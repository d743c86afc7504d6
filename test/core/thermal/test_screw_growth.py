# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Growth of usual ball screws: steady state, symmetry, steps, and where the nut runs."""

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.learning import Basis
from fuzzycnc_ros.core.thermal.places import AxisSpan
from fuzzycnc_ros.core.thermal.screw_growth import (
    CONVECTION,
    CONVECTION_RISE,
    END_LOSS,
    FRICTION,
    GROWTH_KINDS,
    LOSS_FACTORS,
    NUT_LOSS,
    SCREW_DIAMETER,
    SOURCES,
    ScrewGrowth,
)

SCREW = ScrewGrowth(AxisSpan('Y', -0.5, 0.0))
LENGTH = 0.7


def stroke(speed, low, high):
    """Return the motion of an axis that goes back and forth."""
    middle, reach = 0.5 * (low + high), 0.5 * (high - low)
    return speed * np.array([1.0, speed, middle, middle * middle + reach * reach / 3.0])


def warm(motion, interval, samples):
    """Return the state after samples with the same motion."""
    state = np.zeros(SCREW.STATES)
    for _ in range(samples):
        state = SCREW.step(state, interval, motion)
    return state


def grown(state):
    """Return the growths: below and above the middle, slope, bend; factors; sources [m]."""
    return SCREW.growths(state).reshape(GROWTH_KINDS, len(LOSS_FACTORS), SOURCES)


def test_at_rest_in_the_end_all_heat_is_lost():
    speed = 0.2
    state = warm(stroke(speed, -0.6, 0.1), 60.0, 3000).reshape(-1, len(LOSS_FACTORS), SOURCES)
    rise = state[:, :, 0]  # by friction of the nut, which runs along the whole screw
    surface = np.pi * SCREW_DIAMETER * LENGTH / len(rise) * (CONVECTION + CONVECTION_RISE * speed)
    lost = (surface + NUT_LOSS / len(rise)) * rise.sum(axis=0) + END_LOSS * (rise[0] + rise[-1])
    np.testing.assert_allclose(lost * LOSS_FACTORS, FRICTION[0] * speed, rtol=1e-6)


def test_a_stroke_in_the_middle_warms_both_halves_alike_and_bends_nothing():
    below, above, slope, bend = grown(warm(stroke(0.2, -0.4, -0.1), 60.0, 60))[:, :, 0]
    np.testing.assert_allclose(below, above, rtol=1e-9)
    np.testing.assert_allclose(slope, below, rtol=1e-9)
    np.testing.assert_allclose(bend, 0.0, atol=1e-15)


def test_a_short_stroke_above_the_middle_grows_that_half():
    below, above, slope, bend = grown(warm(stroke(0.2, -0.15, -0.05), 60.0, 60))[:, :, 0]
    assert (above > 3.0 * below).all()
    np.testing.assert_allclose(slope, 0.5 * (above + below))
    np.testing.assert_allclose(bend, 0.5 * (below - above))


def test_an_axis_that_moved_nobody_knows_where_moved_everywhere():
    known = warm(stroke(0.2, -0.6, 0.1), 60.0, 30)
    unknown = warm(np.array([0.2, 0.04, np.nan, np.nan]), 60.0, 30)
    np.testing.assert_allclose(unknown, known, rtol=1e-12)


@pytest.mark.parametrize('place', [-3.0, -0.6, 0.1, 5.0])
def test_no_place_and_no_speed_makes_it_lose_or_gain_without_bounds(place):
    state = warm(stroke(2.0, place, place), 20.0, 2000)
    assert np.isfinite(state).all()
    assert state.min() >= 0.0
    after = SCREW.step(state, 20.0, np.zeros(4))
    assert after.max() < state.max()


def test_long_samples_say_the_same_as_short_ones():
    motion = stroke(0.2, -0.4, -0.1)
    long, short = grown(warm(motion, 60.0, 30)), grown(warm(motion, 1.0, 1800))
    np.testing.assert_allclose(long[:3], short[:3], rtol=0.03)


def test_an_error_has_no_part_in_the_screw_of_another_axis():
    screws = tuple(ScrewGrowth(AxisSpan(axis, -0.5, 0.0)) for axis in 'YZ')
    basis = Basis(2, True, 60.0, (900.0,), screws)
    moved = np.stack([np.zeros(4), stroke(0.2, -0.4, -0.1)])
    features, _ = basis.step(np.ones(2), 100.0, basis.initial_state(), moved)
    own, other = (features * basis.seen_by(axis) for axis in 'ZY')
    np.testing.assert_array_equal(own, features)
    assert (
        np.count_nonzero(features) - np.count_nonzero(other)
        >= 3 * len(LOSS_FACTORS) * GROWTH_KINDS // 2
    )
    np.testing.assert_array_equal(basis.seen_by('X')[:4], 1.0)
