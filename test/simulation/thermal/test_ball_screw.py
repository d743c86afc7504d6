# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Ball screw: check values of another one-dimensional simulation, stretch, scale, refusals."""

from functools import cache

import numpy as np
import pytest

from fuzzycnc_ros.simulation.thermal.ball_screw import (
    SCREW_SENSORS,
    BallScrew,
    BallScrewConfig,
    Stroke,
)
from fuzzycnc_ros.simulation.thermal.mill import MILL_STEP

MINUTES = (10, 30, 60, 120, 150, 180)
LONG, SHORT = (0.15, 0.55), (0.45, 0.55)
# Error at 0.1, 0.35 and 0.6 m, slope of the line, largest distance from it [um, um/m].
CHECKED = {
    LONG: (
        [5, 9, 10, 10, 3, 1],
        [38, 66, 75, 77, 24, 8],
        [70, 124, 140, 143, 46, 15],
        [145, 253, 286, 291, 92, 30],
        [3.9, 6.0, 6.5, 6.6, 1.8, 0.6],
    ),
    SHORT: (
        [3, 4, 5, 5, 2, 1],
        [7, 21, 27, 28, 18, 7],
        [65, 112, 127, 129, 42, 14],
        [119, 216, 246, 251, 86, 28],
        [16, 22, 23, 23, 3.6, 0.8],
    ),
}
BARE = {
    'bearing_position': 0.0,
    'direction': 1.0,
    'nut_length': 0.0,
    'nut_conductance': 0.0,
    'coupling_conductance': 0.0,
    'housing_capacity': 1e12,
}
"""The screw of the check values: housings at the temperature of the shop, nothing but bearings."""

TRAVEL = np.linspace(0.1, 0.6, 51)


@cache
def errors_of(stroke: tuple[float, float], mounting: str = 'fixed_free') -> np.ndarray:
    """Run for two hours and rest for one; return the errors over the travel, shape (6, 51) [m]."""
    screw = BallScrew(BallScrewConfig(mounting=mounting, **BARE), 20.0)
    found = []
    for step in range(1, 60 * max(MINUTES) // MILL_STEP + 1):
        running = step * MILL_STEP <= 7200
        screw.advance(20.0, Stroke(*stroke, 0.25 if running else 0.0))
        if step * MILL_STEP in [60 * minute for minute in MINUTES]:
            found.append(screw.error(TRAVEL))
    return np.array(found)


def lines_of(error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    slope, offset = np.polynomial.polynomial.polyfit(TRAVEL, error.T, 1)[::-1]
    left = error - offset[:, None] - slope[:, None] * TRAVEL
    return slope, np.abs(left).max(axis=1)


@pytest.mark.parametrize('stroke', [LONG, SHORT])
def test_check_values_of_another_simulation(stroke):
    error = 1e6 * errors_of(stroke)
    slope, bend = lines_of(error)
    found = [error[:, 0], error[:, 25], error[:, 50], slope, bend]
    for checked, values in zip(CHECKED[stroke], found, strict=True):
        np.testing.assert_array_less(
            np.abs(values - checked), np.maximum(0.03 * np.array(checked), 1.0)
        )


def test_stretch_holds_the_ends_until_it_is_used_up():
    free, held = errors_of(LONG), errors_of(LONG, 'fixed_fixed')
    used_up = free - 30e-6 * TRAVEL
    np.testing.assert_allclose(held[:5], used_up[:5], rtol=0.0, atol=1e-12)
    # After an hour of rest the screw as a whole has grown by less than its stretch.
    assert np.abs(held[5]).max() < 2e-6 < np.abs(free[5]).max()


def test_cooled_below_the_start_a_stretched_screw_keeps_its_length():
    screw = BallScrew(BallScrewConfig(mounting='fixed_fixed'), 20.0)
    free = BallScrew(BallScrewConfig(), 20.0)
    for _ in range(720):
        screw.advance(10.0, Stroke(-0.4, 0.0, 0.0))
        free.advance(10.0, Stroke(-0.4, 0.0, 0.0))
    far = np.array([-0.6])
    assert abs(screw.error(far)[0]) < 1e-12
    assert free.error(far)[0] > 40e-6


def test_a_lost_stretch_leaves_the_screw_shorter_by_it():
    screw = BallScrew(BallScrewConfig(mounting='fixed_fixed', direction=1.0), 20.0)
    place = np.array([0.1, 0.6])
    assert not screw.error(place).any()
    screw.stretched = False
    np.testing.assert_allclose(screw.error(place), [0.0, -15e-6], rtol=0.0, atol=1e-18)


def test_direction_and_place_of_the_fixed_bearing_turn_the_error_over():
    place = np.array([0.1, 0.35, 0.6])
    forward = BallScrew(BallScrewConfig(bearing_position=0.0, direction=1.0), 20.0)
    back = BallScrew(BallScrewConfig(bearing_position=0.1, direction=-1.0), 20.0)
    for _ in range(200):
        forward.advance(20.0, Stroke(0.15, 0.55, 0.25))
        back.advance(20.0, Stroke(-0.45, -0.05, 0.25))
    np.testing.assert_allclose(back.error(0.1 - place), -forward.error(place), rtol=0, atol=1e-16)


def test_with_a_linear_scale_only_the_scale_is_left():
    scale = BallScrew(BallScrewConfig(mounting='linear_scale', scale_fixed_at=-0.2), 20.0)
    screw = BallScrew(BallScrewConfig(), 20.0)
    for _ in range(720):
        scale.advance(20.0, Stroke(-0.45, -0.05, 0.25))
        screw.advance(20.0, Stroke(-0.45, -0.05, 0.25))
    place = np.array([-0.5, -0.2, 0.0])
    table = scale.temperatures()[SCREW_SENSORS.index('table')]
    np.testing.assert_allclose(scale.error(place), 8e-6 * (table - 20.0) * (place + 0.2))
    assert np.ptp(scale.error(place)) < 0.1 * np.ptp(screw.error(place))


def test_everything_gets_warm_and_the_nut_most():
    screw = BallScrew(BallScrewConfig(), 20.0)
    for _ in range(720):
        screw.advance(20.0, Stroke(-0.45, -0.05, 0.25))
    bearing, far, nut, table = screw.temperatures()
    assert 20.1 < far < bearing < nut < 40.0
    assert 20.1 < table < nut


def test_stroke_goes_back_and_forth():
    stroke = Stroke(-0.4, 0.0, 0.1)
    found = [round(stroke.position(t), 9) for t in (0.0, 1.0, 4.0, 6.0, 8.0, 9.0)]
    assert found == [0.0, -0.1, -0.4, -0.2, 0.0, -0.1]
    assert Stroke(-0.4, -0.1, 0.0).position(5.0) == -0.1


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        ({'mounting': 'glued'}, 'mounting: expected one of fixed_free'),
        ({'direction': 0.5}, 'direction: expected 1 or -1 but found 0.5'),
        ({'length': 0.01}, 'length: expected 0.1 to 10 m'),
        ({'diameter': 0.005}, 'diameter: expected a heat capacity'),
        ({'nut_capacity': 10.0}, 'nut_capacity: expected a heat capacity'),
        ({'nut_friction': -1.0}, 'nut_friction: expected 0 or more'),
        ({'expansion': float('nan')}, 'expansion: expected a finite number'),
    ],
)
def test_a_screw_that_cannot_be_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        BallScrewConfig(**given)


@pytest.mark.parametrize('given', [(0.0, -0.1, 0.1), (0.0, 0.1, -0.1), (0.0, 0.1, float('nan'))])
def test_a_stroke_that_cannot_be_is_refused(given):
    with pytest.raises(ValueError, match='expected'):
        Stroke(*given)
