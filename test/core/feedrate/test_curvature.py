# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.feedrate.path.sampled_path import (
    CORNER_ANGLE,
    arc_length,
    arc_stencil,
    curvature,
    turning_angle,
)

seeds = st.integers(0, 10_000)


def random_path(seed, dimension, points=30):
    """Return a random walk with steps from 0.1 to 1 mm."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(points - 1, dimension))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    step = rng.uniform(1e-4, 1e-3, (points - 1, 1)) * direction
    return np.concatenate([np.zeros((1, dimension)), np.cumsum(step, axis=0)])


def circle(n, radius=0.02, turn=2 * np.pi):
    angle = np.linspace(0.0, turn, n)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def fitted(before, at, after):
    """Return turn and curvature from quadratics fitted by solving for their coefficients."""
    t = np.array([-np.linalg.norm(at - before), 0.0, np.linalg.norm(after - at)])
    _, a2, a3 = np.linalg.solve(np.vander(t, increasing=True), np.array([before, at, after]))
    square = (a3 @ a3) * (a2 @ a2) - (a3 @ a2) ** 2
    value = 2.0 * np.sqrt(max(square, 0.0)) / np.linalg.norm(a2) ** 3
    back, forth = (at - before) / -t[0], (after - at) / t[2]
    angle = np.arccos(np.clip(back @ forth, -1.0, 1.0))
    return angle, (max(value, 2 * angle / (t[2] - t[0])) if angle > CORNER_ANGLE else value)


@settings(deadline=None, max_examples=60)
@given(seed=seeds, dimension=st.integers(2, 5), closed=st.booleans())
def test_closed_form_is_the_fit_of_parabolas(seed, dimension, closed):
    path = random_path(seed, dimension)
    ring = np.concatenate([path[-1:], path, path[:1]]) if closed else path
    expected = np.array([fitted(*ring[k : k + 3]) for k in range(len(ring) - 2)])
    found = curvature(path, closed=closed), turning_angle(path, closed=closed)
    inner = slice(None) if closed else slice(1, -1)
    assert found[0][inner] == pytest.approx(expected[:, 1], rel=1e-6)
    assert found[1][inner] == pytest.approx(expected[:, 0], abs=1e-7)
    if not closed:
        assert found[0][[0, -1]].tolist() == found[0][[1, -2]].tolist()
        assert found[1][[0, -1]].tolist() == [0.0, 0.0]


@settings(deadline=None, max_examples=40)
@given(seed=seeds, factor=st.floats(1e-3, 1e3), dimension=st.integers(2, 3))
def test_turned_shifted_scaled_and_reversed_paths_have_the_same_shape(seed, factor, dimension):
    path = random_path(seed, dimension)
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(dimension, dimension)))[0]
    value = curvature(path)
    assert factor * curvature(factor * path @ turn + 0.3) == pytest.approx(value, rel=1e-5)
    assert curvature(path[::-1])[::-1] == pytest.approx(value, rel=1e-9)
    flat = np.column_stack([path, np.zeros(len(path))])
    assert curvature(flat) == pytest.approx(value, rel=1e-12)


def test_circle_and_line():
    assert curvature(circle(2001)) == pytest.approx(50.0, rel=1e-5)
    line = np.outer(np.random.default_rng(0).uniform(size=50).cumsum(), [0.3, -0.4, 1.2])
    assert curvature(line) == pytest.approx(0.0, abs=1e-9)
    assert curvature([[0.0, 1.0], [2.0, 3.0]]).tolist() == [0.0, 0.0]


def test_paths_longer_than_a_block_are_seamless():
    path = random_path(1, 3, points=30_000)
    value = curvature(path)
    for begin in (8_100, 16_300, 24_500):
        part = curvature(path[begin : begin + 200])
        assert value[begin + 1 : begin + 199].tolist() == part[1:-1].tolist()


@settings(deadline=None, max_examples=60)
@given(seed=seeds, closed=st.booleans(), near=st.sampled_from([0.0, 1e-20]))
def test_duplicate_points_share_the_value_of_the_one_they_are_on(seed, closed, near):
    rng = np.random.default_rng(seed)
    path = random_path(seed, 2, points=12)
    times = rng.integers(1, 4, len(path))
    doubled = np.repeat(path, times, axis=0)
    doubled += near * rng.uniform(-1.0, 1.0, doubled.shape)
    for function in (curvature, turning_angle):
        expected = np.repeat(function(path, closed=closed), times)
        assert function(doubled, closed=closed) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_creeping_points_are_thinned_to_the_resolution():
    line = np.column_stack([1e-7 * np.arange(1001), np.zeros(1001)])
    noise = 0.4e-6 * np.random.default_rng(0).uniform(-1.0, 1.0, line.shape)
    assert curvature(line + noise, stencil=0.0).max() > 1e6
    # Points 0.1 um apart with 0.5 um of rounding have no direction; farther ones do.
    assert curvature(line + noise, rounding=0.5e-6).max() < 1e5


@pytest.mark.parametrize('again', [False, True])
def test_closed_path_has_no_seam_with_its_first_point_repeated_or_not(again):
    ring = circle(101)
    ring = ring if again else ring[:-1]
    value = curvature(ring, closed=True)
    assert value == pytest.approx(value[7], rel=1e-9)
    assert turning_angle(ring, closed=True) == pytest.approx(2 * np.pi / 100, rel=1e-9)
    wedge = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.01]])
    angles = turning_angle(np.concatenate([wedge, wedge[: int(again)]]), closed=True)
    assert angles[:3] == pytest.approx(np.array([0.5, 0.75, 0.75]) * np.pi)
    assert angles[3:].tolist() == angles[: int(again)].tolist()


@pytest.mark.parametrize('legs', [(2.0, 1.0), (1.0, 1.0), (1e-3, 7.0), (1.0, 1.0 + 1e-9)])
@pytest.mark.parametrize('direction', [(1.0, 0.0), (0.6, 0.8), (1 / 3, 0.1)])
def test_reversal_is_at_least_as_sharp_as_half_a_turn(legs, direction):
    along = np.array([0.0, legs[0], legs[0] - legs[1]])
    path = np.outer(along, direction)
    size = np.linalg.norm(direction)
    value = curvature(path)
    assert np.isfinite(value).all()
    assert value[1] * size >= 2 * np.pi / sum(legs) * (1.0 - 1e-6)
    assert turning_angle(path)[1] == pytest.approx(np.pi, abs=1e-6)


def test_there_and_back_closed_is_two_reversals():
    path = np.array([[0.0, 0.0], [0.001, 0.0]])
    assert curvature(path, closed=True) == pytest.approx(np.pi / 0.001)
    assert turning_angle(path, closed=True) == pytest.approx(np.pi)


def test_far_from_the_origin_only_the_rounding_of_the_coordinates_counts():
    path = circle(200)
    far = path + 1e3  # rounded to 1e-13 m, on steps of 0.6 mm: 4 r / h^2
    assert curvature(far) == pytest.approx(curvature(path), abs=8 * 1.2e-13 / 0.63e-3**2)


def test_stencil_takes_the_rounding_out_and_leaves_corners_in():
    path = circle(5001, radius=0.05)  # steps of 0.06 mm
    rounded = path.round(6)
    plain = np.abs(curvature(rounded) - 20.0)
    mended = np.abs(curvature(rounded, rounding=0.5e-6) - 20.0)
    assert np.quantile(plain, 0.95) > 100.0
    assert mended.max() < 20.0  # the error that arc_stencil allows
    side = np.linspace(0.0, 0.01, 500)[:, np.newaxis]
    corner = np.concatenate([side * [1.0, 0.0], [0.01, 0.0] + side[1:] * [0.0, 1.0]]).round(6)
    value = curvature(corner, rounding=0.5e-6)
    assert value.argmax() == 499
    # A right angle between legs of 20 um, of which 0.5 um of rounding explain little.
    assert value[499] > 0.8 * 0.5 * np.pi / 20e-6
    assert value[:480].max() < 20.0
    assert value[520:].max() < 20.0


@pytest.mark.parametrize('closed', [False, True])
def test_stencil_shorter_than_the_steps_changes_nothing(closed):
    path = circle(60, turn=6.0)
    expected = curvature(path, closed=closed)
    assert curvature(path, closed=closed, stencil=1e-4) == pytest.approx(expected, rel=1e-9)


def test_stencil_longer_than_the_path_and_folds_inside_it():
    path = circle(50, turn=0.5)
    assert curvature(path, stencil=1.0) == pytest.approx(50.0, rel=0.05)
    assert curvature(path, stencil=1.0, closed=True).min() > 0.0
    there_and_back = np.array([0, 1, 2, 3, 4, 3, 2, 1, 0])[:, np.newaxis] * [1e-4, 0.0]
    value = curvature(there_and_back, stencil=4e-4)
    assert np.isfinite(value).all()
    assert value[4] >= np.pi / 1e-4 * (1.0 - 1e-9)
    assert value.min() >= np.pi / 4e-4 * (1.0 - 1e-9)  # half a turn within the stencil


@pytest.mark.parametrize(
    ('points', 'words'),
    [
        ([[0.0, 0.0]], r'2 or more points, shape \(n, d\), but found \(1, 2\)'),
        ([0.0, 1.0], r'but found \(2,\)'),
        (np.zeros((3, 0)), r'but found \(3, 0\)'),
        ([[0.0, 0.0], [1.0, np.nan], [2.0, 0.0]], r'finite coordinates .*nan.* at point 1'),
        ([[0.0, 0.0], [1.0, 0.0], [np.inf, 0.0]], 'at point 2'),
        ([[1.0, 2.0]] * 3, '2 distinct points'),
    ],
)
@pytest.mark.parametrize('function', [curvature, turning_angle])
def test_what_is_no_path_is_refused(function, points, words):
    with pytest.raises(ValueError, match=words):
        function(points)


@pytest.mark.parametrize('value', [-1e-6, np.nan, np.inf])
def test_rounding_and_stencil_are_checked(value):
    path = circle(10)
    with pytest.raises(ValueError, match='rounding of 0 m or more'):
        curvature(path, rounding=value)
    with pytest.raises(ValueError, match='stencil of 0 m or more'):
        curvature(path, stencil=value)
    with pytest.raises(ValueError, match='rounding of 0 m or more'):
        arc_stencil(value)
    with pytest.raises(ValueError, match='positive error'):
        arc_stencil(1e-6, value)


def test_arc_length_starts_at_zero_and_refuses_gaps():
    assert arc_length(circle(10_001))[[0, -1]] == pytest.approx([0.0, 0.04 * np.pi], rel=1e-6)
    with pytest.raises(ValueError, match='at point 1'):
        arc_length([[0.0, 0.0], [np.nan, 0.0]])
