# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline

from fuzzycnc_ros.simulation.motion import contour as contour_module
from fuzzycnc_ros.simulation.motion.contour import Contour


def spline(seed, dimensions, points=7):
    """Smooth random curve over the parameters 0 to 1."""
    corner = np.random.default_rng(seed).uniform(-0.05, 0.05, (points, dimensions))
    return make_interp_spline(np.linspace(0.0, 1.0, points), corner, k=3)


def eight(part):
    turn = 2.0 * np.pi * np.asarray(part)
    return np.column_stack([0.05 * np.sin(turn), 0.03 * np.sin(2.0 * turn)])


def in_window(vertices, arc, place, low, high):
    """Shortest distance to the segments between two arc lengths, one by one."""
    best, where = np.inf, np.nan
    for i in range(len(vertices) - 1):
        if arc[i] < low or arc[i + 1] > high:
            continue
        step = vertices[i + 1] - vertices[i]
        part = min(max(np.dot(place - vertices[i], step) / np.dot(step, step), 0.0), 1.0)
        gap = np.linalg.norm(place - vertices[i] - part * step)
        if gap < best:
            best, where = gap, arc[i] + part * (arc[i + 1] - arc[i])
    return best, where


@pytest.mark.parametrize('dimensions', [2, 3])
@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from([1e-5, 1e-3, 2e-2]))
@settings(max_examples=10, deadline=None)
def test_the_search_finds_what_looking_at_every_segment_finds(dimensions, seed, spread):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(-0.05, 0.05, (12, dimensions))
    contour = Contour.polyline(corner, vertices=300)
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corner, axis=0), axis=1)))
    # cut where the contour cuts itself, so that the windows hold the same segments
    arc = np.union1d(length, np.linspace(0.0, length[-1], 300))
    arc = arc[np.append(True, np.diff(arc) > 1e-12)]
    at = rng.uniform(0.0, contour.length, 30)
    place = contour.position(at) + rng.normal(0.0, spread, (30, dimensions))
    found = contour.distance(place, at, 0.011)
    vertices = contour.position(arc)
    for i in range(30):
        gap, _ = in_window(vertices, arc, place[i], at[i] - 0.011, at[i] + 0.011)
        assert found.distance[i] == pytest.approx(gap, rel=1e-9, abs=1e-14)
        # the place that is named has the distance that is named
        away = np.linalg.norm(place[i] - contour.position(found.arc_length[i : i + 1]))
        assert away == pytest.approx(found.distance[i], rel=1e-9, abs=1e-14)


def test_memory_bound_of_the_search_changes_nothing(monkeypatch):
    rng = np.random.default_rng(4)
    contour = Contour.curve(spline(4, 2), vertices=2001)
    at = rng.uniform(0.0, contour.length, 200)
    place = contour.position(at) + rng.normal(0.0, 0.02, (200, 2))
    whole = contour.distance(place, at, 0.01)
    monkeypatch.setattr(contour_module, '_BLOCK', 50)
    parts = contour.distance(place, at, 0.01)
    np.testing.assert_array_equal(parts.distance, whole.distance)
    np.testing.assert_array_equal(parts.arc_length, whole.arc_length)


def test_a_crossing_is_measured_on_the_own_branch():
    contour = Contour.curve(eight)
    middle = 0.5 * contour.length
    # on the first branch 1 mm before the crossing the tool stands exactly on the second
    own = contour.position([middle - 1e-3])
    other = contour.position(contour.length - np.linspace(0.0, 2e-3, 2001))
    place = other[[np.linalg.norm(other - own, axis=1).argmin()]]
    own_gap = contour.distance(place, [middle - 1e-3], 5e-3).distance[0]
    assert contour.distance(place, [contour.length], 5e-3).distance[0] < 1e-8
    assert own_gap > 1e-4


def test_distance_to_a_circle_is_the_error_of_the_radius():
    def circle(part):
        turn = 2.0 * np.pi * np.asarray(part)
        return 0.02 * np.column_stack([np.cos(turn), np.sin(turn)])

    contour = Contour.curve(circle)
    assert contour.length == pytest.approx(2.0 * np.pi * 0.02, rel=1e-8)
    part = np.linspace(0.0, 1.0, 101)
    for scale in (0.99, 1.0, 1.01):
        found = contour.distance(scale * circle(part), contour.arc_length(part), 2e-3)
        np.testing.assert_allclose(found.distance, abs(scale - 1.0) * 0.02, atol=1e-9)
        np.testing.assert_allclose(found.arc_length, contour.arc_length(part), atol=1e-7)


def test_a_polyline_keeps_its_corners():
    square = Contour.polyline([[0, 0], [0, 0], [1, 0], [1, 1], [1, 1]], vertices=7)
    assert square.length == 2.0
    np.testing.assert_array_equal(square.position([-1.0, 0.25, 1.0, 3.0])[2], [1.0, 0.0])
    found = square.distance([[1.3, -0.4]], [1.0], 0.5)
    assert found.distance[0] == pytest.approx(0.5, abs=1e-15)
    assert found.arc_length[0] == pytest.approx(1.0, abs=1e-15)


def test_outside_of_the_path_its_ends_count():
    line = Contour.polyline([[0.0, 0.0], [1.0, 0.0]], vertices=11)
    found = line.distance([[-0.3, 0.4], [1.3, 0.4]], [-5.0, 5.0], 0.2)
    np.testing.assert_allclose(found.distance, [0.5, 0.5], rtol=1e-14)
    np.testing.assert_allclose(found.arc_length, [0.0, 1.0], atol=1e-14)


def test_arc_length_is_that_of_the_curve_not_of_its_samples():
    curve = spline(11, 3)
    part = np.linspace(0.0, 1.0, 400_001)
    exact = np.linalg.norm(np.diff(curve(part), axis=0), axis=1).sum()
    contour = Contour.curve(curve)
    assert contour.length == pytest.approx(exact, rel=1e-8)
    at = np.linspace(0.0, contour.length, 500)
    # equal steps of arc length are equal steps of the way
    step = np.linalg.norm(np.diff(contour.position(at), axis=0), axis=1)
    assert step.max() < 1.0001 * at[1]
    np.testing.assert_allclose(
        contour.position(contour.arc_length([0.0, 0.3, 1.0])), curve([0.0, 0.3, 1.0]), atol=1e-9
    )


def test_refusals():
    with pytest.raises(ValueError, match='parameter: expected two or more increasing'):
        Contour(eight, [0.0, 0.0, 1.0])
    with pytest.raises(ValueError, match='vertices: expected 2 or more but found 1'):
        Contour.curve(eight, vertices=1)
    with pytest.raises(ValueError, match='expected a path with a length'):
        Contour.curve(lambda part: np.zeros((len(part), 2)))
    for points in ([[0.0, 0.0]], [[1.0, 1.0], [1.0, 1.0]]):
        with pytest.raises(ValueError, match='two or more different points'):
            Contour.polyline(points)
    with pytest.raises(ValueError, match=r'expected the shape \(2, 2\) or \(2, 3\)'):
        Contour.polyline([0.0, 1.0])
    with pytest.raises(ValueError, match='finite'):
        Contour.polyline([[0.0, np.nan], [1.0, 0.0]])


@pytest.mark.parametrize(
    ('points', 'arc', 'reach', 'words'),
    [
        ([[0.0, 0.0, 0.0]], [0.0], 1.0, r'expected the shape \(1, 2\) but found \(1, 3\)'),
        ([[0.0, 0.0]], [0.0, 1.0], 1.0, r'expected the shape \(2, 2\)'),
        ([[0.0, np.inf]], [0.0], 1.0, 'finite'),
        ([[0.0, 0.0]], [np.nan], 1.0, 'finite'),
        ([[0.0, 0.0]], [0.0], 0.0, 'reach: expected more than 0 m but found 0.0 m'),
        ([[0.0, 0.0]], [0.0], np.nan, 'reach'),
    ],
)
def test_distances_refuse_what_is_no_sample(points, arc, reach, words):
    with pytest.raises(ValueError, match=words):
        Contour.curve(eight, vertices=101).distance(points, arc, reach)
