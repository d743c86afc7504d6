# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reference paths of programs: exact geometry, stops where they belong, the same in any parts."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from paths.path_parts import straight_lines
from paths.reference_segments import (
    arc,
    curvatures,
    distances,
    dwell,
    in_space,
    jumps,
    line,
    nurbs,
    polyline,
    random_program,
    reference_path,
)
from tiers import rest_slow

from fuzzycnc_ros.core.feedrate.path.curves import CURVES, SHEET_SCALES
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.core.feedrate.path.reference_path import (
    EASING,
    PathBuilder,
    ReferencePath,
)

L_SHAPE = [[0, 0, 0], [0.0004, 0, 0], [0.001, 0, 0], [0.001, 0.001, 0], [0.001, 0.001, 0.001]]


def parts_of(segments, flags, size, blend):
    builder = PathBuilder(blend=blend)
    parts = []
    for begin in range(0, len(segments), size):
        chosen = slice(begin, begin + size)
        parts.append(builder.push(segments[chosen], flags[chosen]))
    parts.append(builder.finish())
    assert builder.finish() is None
    return [part for part in parts if part is not None]


def assert_same(path, whole):
    np.testing.assert_array_equal(path.stop, whole.stop)
    np.testing.assert_array_equal(path.blend, whole.blend)
    np.testing.assert_array_equal(path.owner, whole.owner)
    np.testing.assert_array_equal(path.feed, whole.feed)
    np.testing.assert_array_equal(path.geometry.stop, whole.geometry.stop)
    np.testing.assert_allclose(path.rest, whole.rest, rtol=1e-14)
    np.testing.assert_allclose(path.curvature, whole.curvature, rtol=1e-12)
    for name in ('coefficient', 'node'):
        found, expected = getattr(path.geometry, name), getattr(whole.geometry, name)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize('blend', [0.0, 1e-5, 1e-3])
@pytest.mark.parametrize('seed', rest_slow(range(2), 0))
def test_parts_are_the_whole(seed, blend):
    segments, flags = random_program(np.random.default_rng([seed, 51]), 20)
    whole = reference_path(segments, blend=blend, exact_stop=flags)
    for size in (1, 7, 100):
        parts = parts_of(segments, flags, size, blend)
        for before, after in pairwise(parts):
            end, begin = before.geometry.coefficient[-1, 5], after.geometry.coefficient[0, 0]
            np.testing.assert_array_equal(end, begin)
            assert before.place + before.geometry.length == pytest.approx(after.place, abs=1e-14)
            assert before.curvature[-1] == after.curvature[0]
            assert before.stop[-1] == after.stop[0]
            assert before.rest[-1] == after.rest[0]
            assert not before.geometry.stop[[0, -1]].any()
        assert_same(ReferencePath.join(parts), whole)


@pytest.mark.parametrize('seed', range(3))
def test_without_blends_the_path_is_the_program(seed):
    segments, flags = random_program(np.random.default_rng([seed, 52]), 20)
    path = reference_path(segments, exact_stop=flags)
    assert distances(path, segments).max() <= EASING + 1e-7
    assert not path.blend.any()
    turn, jump = jumps(path.geometry)
    smooth = ~path.stop[1:-1]
    assert turn[smooth].max() <= 1e-6
    assert (jump[smooth] <= 1e-3 * path.curvature[1:-1][smooth] + 1e-6).all()
    length = sum(segment.length for segment in segments)
    assert path.geometry.length == pytest.approx(length, rel=1e-4)
    assert path.stop[[0, -1]].all()
    assert set(path.owner) == {k for k, one in enumerate(segments) if one.length > 0.0}


def test_lines_are_exact_and_corners_stop():
    path = reference_path(polyline(L_SHAPE))
    np.testing.assert_array_equal(path.stop, [True, False, True, True, True])
    np.testing.assert_allclose(path.geometry.node, [0.0, 0.0004, 0.001, 0.002, 0.003])
    np.testing.assert_array_equal(path.curvature, np.zeros(5))
    twin = straight_lines(L_SHAPE)
    np.testing.assert_allclose(path.geometry.coefficient, twin.coefficient, atol=1e-18)
    np.testing.assert_array_equal(path.geometry.stop, twin.stop)


def test_long_lines_have_nodes_near_their_ends():
    """So that a slow end does not slow down the line: speeds run straight between nodes."""
    path = reference_path([line((0, 0, 0), (0.1, 0, 0))])
    node = path.geometry.node
    assert node[1] == pytest.approx(5e-4)
    assert node[-1] - node[-2] == pytest.approx(5e-4)
    assert len(node) < 12
    np.testing.assert_allclose(np.diff(path.geometry.coefficient[:, :, 1:]), 0.0)


@pytest.mark.parametrize('plane', [17, 18, 19])
@pytest.mark.parametrize('rise', [0.0, 0.004])
def test_arcs_are_arcs(plane, rise):
    segment = arc((0.01, 0.02, 0.03), 0.02, 0.4, -5.0, plane=plane, rise=rise)
    path = reference_path([segment])
    axes = list(segment.axes)
    place = np.linspace(0.0, path.geometry.length, 3001)
    x, y, z = path.geometry.evaluate(place)[:, axes].T
    radius = np.hypot(x - segment.centre[0], y - segment.centre[1])
    np.testing.assert_allclose(radius, 0.02, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(np.diff(z), rise / 3000, atol=1e-11)
    assert path.geometry.length == pytest.approx(math.hypot(0.1, rise), rel=1e-12)
    np.testing.assert_allclose(path.curvature, segment.curvatures(1)[0], rtol=1e-12)
    np.testing.assert_allclose(curvatures(path.geometry, place), path.curvature[0], rtol=1e-5)
    assert (np.diff(path.geometry.node) * path.curvature[0] <= 0.1001).all()


def test_an_arc_whose_radius_changes_meets_both_ends():
    segment = arc((0, 0, 0), 0.002, 0.0, 3.0, change=2e-6)
    path = reference_path([segment])
    np.testing.assert_array_equal(path.geometry.coefficient[0, 0], segment.start)
    np.testing.assert_array_equal(path.geometry.coefficient[-1, 5], segment.end)
    assert path.geometry.length == pytest.approx(segment.length, rel=1e-6)
    assert distances(path, [segment]).max() < 1e-9
    speed = np.linalg.norm(path.geometry.evaluate(path.geometry.node, 1), axis=1)
    np.testing.assert_allclose(speed, 1.0, rtol=1e-9)


@pytest.mark.parametrize('name', CURVES)
def test_curves_of_the_literature_are_met(name):
    curve = CURVES[name](SHEET_SCALES[name])
    segment = in_space(curve)
    path = reference_path([segment])
    geometry = path.geometry
    assert geometry.length == pytest.approx(curve.length, rel=1e-11)
    place = np.linspace(0.0, min(geometry.length, curve.length), 20001)
    at = curve.parameter(place)
    away = geometry.evaluate(place)[:, :2] - curve.point(at)
    assert np.linalg.norm(away, axis=1).max() < 1e-9
    node = curve.parameter(np.minimum(geometry.node, curve.length))
    np.testing.assert_allclose(path.curvature, curve.curvature(node), rtol=1e-9, atol=1e-9)
    step = np.diff(geometry.node)
    ends = np.maximum(path.curvature[1:], path.curvature[:-1])
    assert (step * ends <= 0.101).all()
    piece = np.clip(np.searchsorted(geometry.node, place, 'right') - 1, 0, len(step) - 1)
    assert (curve.curvature(at) <= 1.03 * ends[piece] + 1e-4 / step[piece]).all()
    assert not path.stop[1:-1].any()


def test_a_curve_of_degree_one_is_a_polyline():
    points = np.array(L_SHAPE, dtype=float)
    path = reference_path([nurbs(points, 1)])
    twin = reference_path(polyline(points))
    assert path.stop.sum() == twin.stop.sum() == 4
    assert path.geometry.length == pytest.approx(twin.geometry.length)
    assert (path.owner == 0).all()
    blended = reference_path([nurbs(points, 1)], blend=1e-5)
    assert blended.stop.sum() == 2
    assert blended.blend.any()


def test_jumps_of_the_curvature_inside_a_curve_are_eased():
    control = [[0, 0, 0], [0.01, 0, 0], [0.02, 0.01, 0], [0.02, 0.02, 0], [0.03, 0.02, 0.01]]
    segment = nurbs(control, 2)
    path = reference_path([segment])
    turn, jump = jumps(path.geometry)
    assert turn.max() < 1e-9
    assert (jump <= 1e-6 * path.curvature[1:-1] + 1e-6).all()
    assert distances(path, [segment]).max() <= EASING + 1e-8


def test_a_curve_that_starts_at_rest():
    """A doubled control point: the derivative vanishes there."""
    for control in (
        [[0, 0, 0], [0, 0, 0], [0.01, 0, 0], [0.02, 0, 0.01]],
        [[0, 0, 0], [0.01, 0.01, 0], [0.02, 0, 0.01], [0.02, 0, 0.01]],
    ):
        path = reference_path([nurbs(control)])
        assert np.isfinite(path.geometry.coefficient).all()
        assert np.isfinite(path.curvature).all()
        assert path.stop.sum() == 2


def test_tangent_junctions_are_no_corners_and_are_eased():
    first = line((0, 0, 0), (0.02, 0, 0), 1)
    second = arc(first.end, 0.01, 0.0, 1.5, number=2)
    third = arc(second.end, 0.005, 1.5, -1.0, number=3)
    segments = [first, second, third]
    path = reference_path(segments)
    assert path.stop.sum() == 2
    turn, jump = jumps(path.geometry)
    assert turn.max() < 1e-8
    assert (jump <= 1e-6 * path.curvature[1:-1] + 1e-6).all()
    away = distances(path, segments)
    assert 0.5 * EASING < away.max() <= EASING
    assert path.curvature.max() == pytest.approx(200.0, rel=0.1)
    # An easing of a line and an arc keeps within the smaller of both distances.
    assert distances(reference_path(segments, blend=1e-7), segments).max() <= 1e-7


def test_rapids_dwells_and_flags_stop():
    points = [[k / 100, 0, 0] for k in range(7)]
    one, two, three, four, five, six = polyline(points, feed=0.02)
    segments = [
        dwell(points[0], 0.5),
        one,
        line(points[1], points[2], rapid=True),
        three,
        dwell(points[3], 1.0),
        dwell(points[3], 0.25),
        four,
        line(points[4], points[4]),
        five,
        six,
        dwell(points[6], 2.0),
    ]
    flags = [False] * 7 + [True] + [False] * 3
    assert two.length > 0.0
    for blend in (0.0, 1e-4):
        path = reference_path(segments, exact_stop=flags, blend=blend)
        at = path.arc_length[path.stop]
        np.testing.assert_allclose(at, [0.0, 0.01, 0.02, 0.03, 0.04, 0.06], atol=1e-15)
        assert path.rest[path.stop].tolist() == [0.5, 0.0, 0.0, 1.25, 0.0, 2.0]
        assert not path.rest[~path.stop].any()
        assert list(dict.fromkeys(path.owner.tolist())) == [1, 2, 3, 6, 8, 9]
        assert np.isinf(path.feed[path.owner == 2]).all()
        assert (path.feed[path.owner != 2] == 0.02).all()


def test_a_flag_wins_over_a_blend():
    segments = polyline(L_SHAPE)
    path = reference_path(segments, blend=1e-5, exact_stop=[False, False, True, False])
    assert path.stop.sum() == 3
    stop = path.geometry.evaluate(path.geometry.node[np.flatnonzero(path.stop)[1:2]])[0]
    np.testing.assert_array_equal(stop, L_SHAPE[3])


def test_gaps_within_the_digits_are_closed():
    step = 1e-3 / 3.0
    segments = [
        line((0, 0, 0), (step, 0, 0), 1),
        arc((step + 5e-10, 0, 0), 0.001, 0.0, 1.0, number=2),
    ]
    control = np.array([[0, 4e-10, 0], [0, 0.01, 0], [0.01, 0.01, 0]]) + segments[1].end
    segments.append(nurbs(control, 2, number=3))
    path = reference_path(segments)
    coefficient = path.geometry.coefficient
    np.testing.assert_array_equal(coefficient[1:, 0], coefficient[:-1, 5])
    assert np.isfinite(path.curvature).all()


def test_memory_of_a_builder_does_not_grow():
    builder = PathBuilder(blend=1e-5)
    points = np.cumsum(np.random.default_rng(5).normal(size=(2001, 3)), axis=0) * 1e-3
    segments = polyline(points)
    for begin in range(0, 2000, 100):
        builder.push(segments[begin : begin + 100])
        assert len(builder._kept) == 1


def test_misuse_is_refused_and_changes_nothing():
    segments = polyline(L_SHAPE)
    far = line((0.5, 0, 0), (0.6, 0, 0), 42)
    builder = PathBuilder(blend=1e-5)
    first = builder.push(segments[:2])
    for wrong, flags, text in (
        ([far], None, r'gap of 499 mm between line 2 and line 42'),
        ([segments[2], far], None, r'between line 3 and line 42'),
        ([replace(segments[2], end=(0.0, math.nan, 0.0))], None, 'line 3: expected finite'),
        ([dwell(L_SHAPE[2], math.nan, 9)], None, 'line 9: expected a dwell of 0 s or more'),
        ([dwell(L_SHAPE[2], -1.0, 9)], None, 'found -1'),
        (segments[2:], [True], 'exact_stop: expected 2 flags'),
        ([replace(arc(L_SHAPE[2], 0.001, 0.0, 1.0, number=8), sweep=1.1)], None, 'line 8: .* arc'),
    ):
        with pytest.raises(ValueError, match=text):
            builder.push(wrong, flags)
    parts = [first, builder.push(segments[2:]), builder.finish()]
    assert_same(ReferencePath.join(parts), reference_path(segments, blend=1e-5))
    with pytest.raises(ValueError, match='after finish'):
        builder.push(segments)


def test_paths_without_motion_and_wrong_numbers_are_refused():
    for segments in ([], [dwell((0, 0, 0), 1.0)], [line((0, 0, 0), (0, 0, 0))]):
        with pytest.raises(ValueError, match='segments that move, but found none'):
            reference_path(segments)
    for blend in (-1e-6, math.nan, math.inf):
        with pytest.raises(ValueError, match='blend: expected'):
            PathBuilder(blend=blend)
    curve = NurbsCurve([[0, 0], [1, 0], [1, 1]], [1, 1, 1], [0, 0, 0, 1, 1, 1], 2)
    flat = replace(nurbs(np.eye(3), 2), curve=curve)
    with pytest.raises(ValueError, match='X, Y and Z'):
        reference_path([flat])
    with pytest.raises(ValueError, match='parts: expected at least one'):
        ReferencePath.join([])
    one = reference_path(polyline(L_SHAPE))
    with pytest.raises(ValueError, match='begin where the one before ends'):
        ReferencePath.join([one, one])
