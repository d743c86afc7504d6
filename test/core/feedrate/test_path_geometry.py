# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reference paths: through the points, smooth between corners, true bounds, cut without change."""

import numpy as np
import pytest
from paths.path_parts import joined_path
from paths.random_paths import KINDS, arc, line_arc_line, random_path

from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry


def test_samples_of_an_arc_give_the_arc():
    path = arc(0.02, 3.0, 3, 40)
    place = np.linspace(0.0, path.length, 1000)
    np.testing.assert_allclose(path.length, 0.06)
    x, y, z = path.evaluate(place).T
    np.testing.assert_allclose(np.hypot(x, y), 0.02, rtol=1e-7)
    np.testing.assert_array_equal(z, 0.0)
    np.testing.assert_allclose(np.linalg.norm(path.evaluate(place, 1), axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(path.evaluate(place, 2), axis=1), 50.0, rtol=1e-3)
    # Without arc lengths, those of the circle through neighbours are the same.
    points, along, bend = (path.evaluate(path.node, k) for k in range(3))
    twin = PathGeometry.from_samples(points, along, bend)
    np.testing.assert_allclose(twin.node, path.node, rtol=1e-9)


@pytest.mark.parametrize('kind', KINDS)
def test_bounds_hold_and_cutting_changes_nothing(kind):
    for seed in range(5):
        rng = np.random.default_rng([seed, 9])
        path = random_path(rng, kind, 3)
        fine = path.split(rng.integers(1, 9, len(path.coefficient)))
        place = np.sort(rng.uniform(0.0, path.length, 3000))
        index = np.searchsorted(path.node, place, 'right') - 1
        for order, bound in enumerate(path.bounds(), start=1):
            size = np.abs(path.evaluate(place, order))
            slack = 1e-9 * np.abs(path.derivative(order)).max()
            assert (size <= bound[index, 1:] + slack).all()
        assert fine.stop.sum() == path.stop.sum()
        np.testing.assert_allclose(
            fine.evaluate(place), path.evaluate(place), rtol=0.0, atol=1e-12
        )


def test_tangent_joins_are_smooth_and_stay_within_the_easing():
    for seed in range(10):
        parts = line_arc_line(np.random.default_rng(seed), 2)
        for easing in (1e-7, 1e-5):
            path = joined_path(parts, easing)
            assert not path.stop.any()
            seams = path.node[1:-1]
            for order in (1, 2):
                found = path.derivative(order)
                scale = np.abs(found).max()
                np.testing.assert_allclose(found[1:, 0], found[:-1, -1], atol=1e-6 * scale)
            radius = np.linalg.norm(parts[1].coefficient[0, 0])
            first, last = parts[0].length, parts[0].length + parts[1].length
            on_arc = np.linspace(first, last, 2000)
            off = np.abs(np.linalg.norm(path.evaluate(on_arc), axis=1) - radius)
            assert off.max() <= 1.01 * easing
            assert len(seams) >= len(parts[1].coefficient) + 1


@pytest.mark.parametrize(
    ('points', 'text'),
    [
        ([[0.0, 0.0]], r'points: expected shape \(n, 2\) or \(n, 3\)'),
        ([[0.0, 0.0, 0.0, 0.0]] * 3, r'found \(3, 4\)'),
        ([[0.0, 0.0], [np.nan, 0.0]], 'found .* in row 1'),
    ],
)
def test_bad_points_are_refused(points, text):
    with pytest.raises(ValueError, match=text):
        PathGeometry.from_samples(points, points, points)


def test_bad_samples_are_refused():
    line = np.array([[0.0, 0.0], [0.1, 0.0]])
    along, bend = np.array([[1.0, 0.0]] * 2), np.zeros((2, 2))
    for arguments, text in (
        ((line, along[:, :1], bend), 'tangent: expected shape'),
        ((line, along, np.zeros((3, 2))), 'of one shape'),
        ((line, 0.0 * along, bend), '2 zero tangents'),
        ((line[[0, 0]], along, bend), '1 repeated points'),
        ((line, along, bend, [0.0, 0.0]), 'arc_length: expected 2 increasing'),
    ):
        with pytest.raises(ValueError, match=text):
            PathGeometry.from_samples(*arguments)
