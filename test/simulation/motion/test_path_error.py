# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Contour error while the machine moves: exact figures, batches, crossings, slow motion."""

from itertools import pairwise

import numpy as np
import pytest

from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.motion.contour import PathError
from fuzzycnc_ros.simulation.motion.contouring_axes import ContouringAxes

CONFIG = ContouringConfig()
PERIOD = CONFIG.interpolation_period


def measured(commanded, actual, batch=100, delay=CONFIG.delay):
    """Return error and nearest place of samples that are taken in batches."""
    step = np.linalg.norm(np.diff(commanded, axis=0), axis=1)
    way = np.append(0.0, np.cumsum(step))
    path = PathError(PERIOD, delay)
    found = []
    for row in range(len(commanded)):
        path.add(commanded[row], way[row], actual[row])
        if path.pending == batch:
            found.append(path.take())
    found.append(path.take())
    assert path.pending == 0
    return tuple(
        np.concatenate([getattr(item, name) for item in found])
        for name in ('distance', 'arc_length')
    )


def circle(radius, speed, turns=1.5):
    """Return positions on a circle, period by period."""
    angle = np.arange(0.0, 2.0 * np.pi * turns, speed * PERIOD / radius)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def test_impossible_settings_are_refused():
    for period, delay in ((0.0, 0.1), (1e-3, -1.0), (np.nan, 0.0)):
        with pytest.raises(ValueError, match='expected a positive period'):
            PathError(period, delay)


def test_nothing_gives_nothing():
    found = PathError(PERIOD, 0.0).take()
    assert len(found.distance) == len(found.arc_length) == 0


@pytest.mark.parametrize('batch', [1, 7, 100, 10_000])
def test_axes_on_a_smaller_circle_are_that_much_off(batch):
    commanded = circle(0.02, 0.1)
    lag = round(CONFIG.delay / PERIOD)
    actual = np.concatenate([np.repeat(commanded[:1], lag, axis=0), 0.99 * commanded[:-lag]])
    error, place = measured(commanded, actual, batch)
    # to the chords of 0.1 mm: R (1 - cos(a / 2)) = 62.5 nm nearer at most
    np.testing.assert_allclose(error[lag:], 2e-4, rtol=0, atol=6.3e-8)
    step = 2.0 * 0.02 * np.sin(0.5 * 0.1 * PERIOD / 0.02)
    expected = step * np.arange(len(commanded) - lag)
    np.testing.assert_allclose(place[lag:], expected, rtol=0, atol=1e-6)


def test_an_own_branch_is_measured_where_the_path_crosses_itself():
    """Out along X and back along a line that crosses at the axes' place 40 mm later."""
    corner = np.array([[0.0, 0.0], [0.04, 0.0], [0.04, 0.02], [0.02, 0.02], [0.02, -0.02]])
    legs = [
        a + np.multiply.outer(np.linspace(0.0, 1.0, 300, endpoint=False), b - a)
        for a, b in pairwise(corner)
    ]
    commanded = np.concatenate([*legs, corner[-1:]])
    actual = commanded + np.array([1e-4, 0.0])  # beside the last leg, which crosses the first one
    error, _ = measured(commanded, actual, delay=0.0)
    crossing = np.flatnonzero(np.abs(commanded[900:, 1]) < 5e-5) + 900
    np.testing.assert_allclose(error[crossing], 1e-4, rtol=1e-9)


def test_slow_motion_keeps_little_of_the_path():
    speed = 2e-5
    way = speed * PERIOD * np.arange(30_000)
    commanded = np.column_stack([way, np.zeros_like(way)])
    path = PathError(PERIOD, CONFIG.delay)
    for place in commanded:
        path.add(place, place[0], place + np.array([0.0, 3e-6]))
        if path.pending == 1000:
            np.testing.assert_allclose(path.take().distance, 3e-6, rtol=1e-6)
    assert len(path._vertex) <= way[-1] / 5e-7 + 2
    assert len(path._way) <= CONFIG.delay / PERIOD + 2


def test_memory_is_that_of_the_window():
    commanded = circle(0.02, 0.2, turns=10.0)
    path = PathError(PERIOD, CONFIG.delay)
    for row, place in enumerate(commanded):
        path.add(place, 2e-4 * row, place)
        if path.pending == 100:
            path.take()
    assert 0.2 * PERIOD * len(path._vertex) < 0.05


def test_standing_still_measures_the_distance_to_the_place():
    commanded = np.tile([0.1, 0.2, 0.3], (250, 1))
    error, place = measured(commanded, commanded + np.array([3e-6, 0.0, 4e-6]))
    np.testing.assert_allclose(error, 5e-6, rtol=1e-9)
    np.testing.assert_array_equal(place, 0.0)


def test_batches_do_not_matter():
    time = PERIOD * np.arange(2500)
    commanded = np.column_stack(
        [0.03 * np.sin(3.0 * time), 0.02 * np.sin(6.0 * time), 1e-3 * time]
    )
    actual = ContouringAxes(commanded[0]).follow(commanded)
    whole, place = measured(commanded, actual, 2500)
    for batch in (13, 100, 1000):
        error, where = measured(commanded, actual, batch)
        np.testing.assert_allclose(error, whole, rtol=0, atol=1e-9)
        np.testing.assert_allclose(where, place, rtol=0, atol=1e-6)
