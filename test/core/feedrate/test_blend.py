# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Blends of corners: never farther than allowed, smooth, nearly as flat as an arc."""

import numpy as np
import pytest
from paths.reference_segments import (
    arc,
    curvatures,
    distances,
    jumps,
    line,
    nurbs,
    polyline,
    random_segment,
    reference_path,
)

from fuzzycnc_ros.core.feedrate.path.reference_path import EASING

TURNS = [1e-5, 0.02, 0.09, 0.11, 0.4, 0.6, np.pi / 3, np.pi / 2, 1.7, 2 * np.pi / 3, 2.6]


def corner(turn, before=0.1, after=0.1):
    along = np.array([np.cos(turn), np.sin(turn), 0.0])
    points = np.array([[0.0, 0.0, 0.0], [before, 0.0, 0.0], [before, 0.0, 0.0] + after * along])
    return polyline(points)


def off_lines(path, segments):
    """Largest distance of control points of blends from the lines that own them: a bound."""
    found = 0.0
    for index, segment in enumerate(segments):
        start, end = np.array(segment.start), np.array(segment.end)
        edge = end - start
        control = path.geometry.coefficient[path.blend & (path.owner == index)].reshape(-1, 3)
        share = np.clip((control - start) @ edge / (edge @ edge), 0.0, 1.0)
        away = np.linalg.norm(control - start - share[:, np.newaxis] * edge, axis=1)
        found = max(found, away.max(initial=0.0))
    return found


@pytest.mark.parametrize('turn', TURNS)
def test_blend_of_long_lines_uses_the_tolerance_and_no_more(turn):
    segments = corner(turn)
    path = reference_path(segments, blend=1e-5)
    np.testing.assert_array_equal(path.stop, [True] + [False] * (len(path.stop) - 2) + [True])
    assert path.blend.any()
    bound = off_lines(path, segments)
    assert bound <= 1e-5 * (1.0 + 1e-9)
    if turn > 0.01:  # else half of the lines is too short
        assert bound >= 0.999 * 1e-5


@pytest.mark.parametrize('turn', TURNS)
@pytest.mark.parametrize(('size', 'share'), [(0.1, 1.06), (1e-5, 1.28)])
def test_peak_of_the_curvature_is_near_that_of_an_arc(turn, size, share):
    segments = corner(turn, size, size)
    path = reference_path(segments, blend=1e-5)
    place = np.linspace(0.0, path.geometry.length, 20001)
    peak = max(curvatures(path.geometry, place).max(), path.curvature.max())
    # The arc with the same distance, or the one that begins in the middle of the lines.
    ideal = max((1.0 - np.cos(turn / 2)) / 1e-5, np.tan(turn / 2) / (0.5 * size))
    assert peak <= share * ideal or (turn < 0.01 and peak <= 1.28 * ideal)
    assert peak >= ideal * (1.0 - 1e-6)


@pytest.mark.parametrize('turn', TURNS)
def test_nodes_see_the_curvature(turn):
    for size in (0.1, 1e-5):
        path = reference_path(corner(turn, size, size), blend=1e-5)
        assert_nodes_see_the_curvature(path, 1.05)


def assert_nodes_see_the_curvature(path, share):
    node = path.geometry.node
    inner = np.linspace(0.02, 0.98, 25)
    place = node[:-1, np.newaxis] + np.diff(node)[:, np.newaxis] * inner
    found = curvatures(path.geometry, place.ravel()).reshape(place.shape).max(axis=1)
    ends = np.maximum(path.curvature[:-1], path.curvature[1:])
    slack = 2e-5 / np.diff(node)  # a turn without meaning
    assert (found <= share * ends + slack).all()


def test_between_curves_blends_keep_their_distance():
    widest = 0.0
    for seed in range(16):
        rng = np.random.default_rng([seed, 41])
        tolerance = 10.0 ** rng.uniform(-6.0, -4.0)
        first = random_segment(rng, (0.0, 0.0, 0.0), 1)
        segments = [first, random_segment(rng, first.end, 2)]
        path = reference_path(segments, blend=tolerance)
        away = distances(path, segments)
        sagging = 1e-8  # of the lines that stand for the curves
        if path.blend.any():
            assert away[path.blend].max() <= tolerance + sagging
            widest = max(widest, away[path.blend].max() / tolerance)
        assert away[~path.blend].max() <= EASING + 1e-7
    assert widest > 0.9


def test_position_tangent_and_curvature_go_on():
    for seed in range(16):
        rng = np.random.default_rng([seed, 42])
        first = random_segment(rng, (0.0, 0.0, 0.0), 1)
        path = reference_path([first, random_segment(rng, first.end, 2)], blend=2e-5)
        coefficient = path.geometry.coefficient
        np.testing.assert_array_equal(coefficient[1:, 0], coefficient[:-1, 5])
        turn, jump = jumps(path.geometry)
        smooth = ~path.stop[1:-1]
        assert turn[smooth].max() < 1e-9
        shorter = np.minimum(*(np.diff(path.geometry.node)[k] for k in (slice(1), slice(1))))
        assert (jump[smooth] < 1e-4 * path.curvature[1:-1][smooth] + 1e-9 / shorter).all()
        assert_nodes_see_the_curvature(path, 1.06)
        # The parameter is the arc length.
        speed = np.linalg.norm(path.geometry.derivative(1)[:, 0], axis=1)
        np.testing.assert_allclose(speed, 1.0, rtol=0.0, atol=1e-9)
        inner = path.geometry.evaluate(np.linspace(0.0, path.geometry.length, 5000), 1)
        np.testing.assert_allclose(np.linalg.norm(inner, axis=1), 1.0, rtol=0.0, atol=2e-3)


def test_short_lines_give_half_of_each():
    angle = np.arange(20) * 0.3
    points = 1e-4 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    path = reference_path(polyline(points), blend=1e-3)
    size = np.linalg.norm(points[1] - points[0])
    middle = 0.5 * (points[1:] + points[:-1])
    assert path.blend[1:-1].all()
    assert not path.blend[[0, -1]].any()
    nodes = np.concatenate([path.geometry.coefficient[:, 0], points[-1:]])
    for point in middle:
        assert np.linalg.norm(nodes - point, axis=1).min() < 1e-12 * size + 1e-17
    assert off_lines(path, polyline(points)) < 1e-4


def test_a_blend_takes_no_more_than_half_of_its_neighbours():
    points = [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.02, 1e-5, 0.0], [0.05, 1e-5, 0.0]]
    path = reference_path(polyline(points), blend=1e-3)
    begin = path.geometry.coefficient[:, 0]
    first, second = np.flatnonzero(path.blend & ~np.append(False, path.blend[:-1]))[0], None
    np.testing.assert_allclose(begin[first], [0.02 - 5e-6, 0.0, 0.0], atol=1e-15)
    second = np.flatnonzero(path.owner == 1)
    assert path.blend[second].all()
    inside = begin[second[len(second) // 2]]
    np.testing.assert_allclose(inside, [0.02, 5e-6, 0.0], atol=1e-15)


def test_halves_of_a_blend_belong_to_their_segments():
    segments = [line((0, 0, 0), (1, 0, 0), 7, feed=0.1), line((1, 0, 0), (1, 1, 0), 8, feed=0.2)]
    path = reference_path(segments, blend=1e-5)
    owner = path.owner[path.blend]
    assert owner.tolist() == [0] * (len(owner) // 2) + [1] * (len(owner) // 2)
    np.testing.assert_array_equal(path.feed, np.where(path.owner == 0, 0.1, 0.2))
    corner_at = path.geometry.coefficient[path.blend][len(owner) // 2, 0]
    assert corner_at[0] - 1.0 == pytest.approx(-corner_at[1])


@pytest.mark.parametrize('degrees', [151.0, 170.0, 180.0])
def test_a_reversal_stays_a_stop(degrees):
    path = reference_path(corner(np.radians(degrees)), blend=1e-5)
    assert path.stop.sum() == 3
    assert not path.blend.any()


def test_rounded_numbers_of_an_arc_are_blended_without_leaving_it():
    """A line meets an arc at a milliradian, as coordinates with three decimals make it."""
    start = (0.05, 0.0, 0.0)
    segments = [line((0, 0, 0), start, 1), arc(start, 0.02, 1e-3, 2.0, number=2)]
    assert reference_path(segments).stop.sum() == 3
    path = reference_path(segments, blend=1e-5)
    assert path.stop.sum() == 2
    assert distances(path, segments).max() <= 1e-5 + 1e-8
    assert path.curvature.max() < 1.5 / 0.02


def test_corner_at_the_ends_of_curves():
    first = nurbs([[0, 0, 0], [0.01, 0.0, 0], [0.02, 0.01, 0], [0.02, 0.02, 0.01]])
    second = nurbs([[0.02, 0.02, 0.01], [0.0, 0.03, 0.01], [0.0, 0.04, 0.0]], 2, number=2)
    path = reference_path([first, second], blend=1e-5)
    assert path.stop.sum() == 2
    assert path.blend.any()
    away = distances(path, [first, second])
    assert 0.9e-5 < away.max() <= 1e-5 + 1e-8
