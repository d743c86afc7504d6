# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.feedrate.path.curves import CURVES, SHEET_SCALES, butterfly, infinity
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve

seeds = st.integers(0, 10_000)


def random_curve(seed, degree=None, dimension=None, clamped=None):
    """Return a curve of random degree and dimension, some knots repeated, clamped or not."""
    rng = np.random.default_rng(seed)
    degree = int(rng.integers(1, 6)) if degree is None else degree
    dimension = int(rng.integers(2, 4)) if dimension is None else dimension
    clamped = bool(rng.integers(2)) if clamped is None else clamped
    points = degree + int(rng.integers(1, 9))
    inner = np.sort(rng.uniform(0.1, 0.9, points - degree - 1))
    if degree > 1 and len(inner) > 2:
        inner[1] = inner[0]
    end = np.zeros(degree + 1), np.ones(degree + 1)
    if not clamped:
        end = np.sort(rng.uniform(-0.5, 0.0, degree + 1)), np.sort(rng.uniform(1, 2, degree + 1))
    return NurbsCurve(
        control=rng.uniform(-0.1, 0.1, (points, dimension)),
        weight=rng.uniform(0.3, 3.0, points),
        knot=np.concatenate([end[0], inner, end[1]]),
        degree=degree,
    )


def quarter_circle(radius=0.01):
    control = radius * np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return NurbsCurve(control, [1.0, np.sqrt(0.5), 1.0], [0, 0, 0, 1, 1, 1], degree=2)


def cox_de_boor(curve, u):
    """Return C(u) by the recursion of Cox and de Boor: 0/0 := 0, the last span closed."""
    knot, count = curve.knot, len(curve.control)
    last = np.flatnonzero(np.diff(knot[: count + 1]) > 0.0)[-1]
    basis = [
        float(knot[i] <= u < knot[i + 1] or (i == last and u == knot[i + 1]))
        for i in range(len(knot) - 1)
    ]
    for p in range(1, curve.degree + 1):
        basis = [
            (knot[i + p] > knot[i] and (u - knot[i]) / (knot[i + p] - knot[i])) * basis[i]
            + (knot[i + p + 1] > knot[i + 1])
            * (knot[i + p + 1] - u)
            / max(knot[i + p + 1] - knot[i + 1], 1e-300)
            * basis[i + 1]
            for i in range(len(basis) - 1)
        ]
    share = np.array(basis) * curve.weight
    return share @ curve.control / share.sum()


def smooth_intervals(curve):
    """Return pairs of parameters between which all derivatives are continuous."""
    edge = np.unique(np.clip(curve.knot, *curve.domain))
    return list(pairwise(edge))


@settings(deadline=None, max_examples=60)
@given(seed=seeds)
def test_points_are_those_of_the_cox_de_boor_recursion(seed):
    curve = random_curve(seed)
    inner = np.random.default_rng(seed).uniform(*curve.domain, 5)
    knots = curve.knot[(curve.knot >= curve.domain[0]) & (curve.knot <= curve.domain[1])]
    for u in np.concatenate([inner, knots]):
        assert curve.point(u) == pytest.approx(cox_de_boor(curve, u), abs=1e-14)


@settings(deadline=None, max_examples=40)
@given(seed=seeds)
def test_each_derivative_integrates_to_the_one_below(seed):
    curve = random_curve(seed)
    node, weight = np.polynomial.legendre.leggauss(60)
    for low, high in smooth_intervals(curve):
        half = 0.5 * (high - low)
        # Just inside: at a knot the derivative is that of the span that begins there.
        ends = np.array([low, np.nextafter(high, low)])
        u = low + half * (node + 1.0)
        below = curve.point(ends)
        for order in (1, 2, 3):
            integral = half * weight @ curve.derivative(u, order)
            size = np.abs(curve.derivative(u, order)).max() * half + np.abs(below).max()
            assert integral == pytest.approx(below[1] - below[0], abs=1e-9 * size)
            below = curve.derivative(ends, order)


@settings(deadline=None, max_examples=40)
@given(seed=seeds)
def test_curvature_is_that_of_the_cross_product(seed):
    curve = random_curve(seed, dimension=3)
    u = np.random.default_rng(seed).uniform(*curve.domain, 20)
    first, second = curve.derivative(u, 1), curve.derivative(u, 2)
    speed = np.linalg.norm(first, axis=1)
    expected = np.linalg.norm(np.cross(first, second), axis=1) / speed**3
    assert curve.curvature(u) == pytest.approx(expected, rel=1e-6, abs=1e-7)


@settings(deadline=None, max_examples=30)
@given(seed=seeds, factor=st.floats(0.1, 10.0))
def test_scaled_turned_shifted_and_reweighted_curves_have_the_same_shape(seed, factor):
    curve = random_curve(seed, dimension=3)
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    other = NurbsCurve(
        factor * curve.control @ turn + 0.7, 5.0 * curve.weight, curve.knot, curve.degree
    )
    u = np.linspace(*curve.domain, 11)
    assert other.length == pytest.approx(factor * curve.length, rel=1e-10)
    assert other.curvature(u) * factor == pytest.approx(curve.curvature(u), rel=1e-6, abs=1e-6)
    assert other.point(u) == pytest.approx(factor * curve.point(u) @ turn + 0.7, abs=1e-12)


def test_circle_is_exact():
    curve = quarter_circle()
    u = np.linspace(0.0, 1.0, 101)
    assert np.linalg.norm(curve.point(u), axis=1) == pytest.approx(0.01, rel=1e-15)
    assert curve.curvature(u) == pytest.approx(100.0, rel=1e-13)
    assert curve.length == pytest.approx(0.005 * np.pi, rel=1e-13)
    angle = np.arctan2(*curve.point(u).T[::-1])
    assert curve.arc_length(u) == pytest.approx(0.01 * angle, abs=1e-16)


def test_far_from_the_origin_the_curvature_keeps_its_digits():
    near = infinity()
    far = NurbsCurve(near.control + 1e3, near.weight, near.knot, near.degree)
    u = np.linspace(0.0, 1.0, 501)
    # The control points themselves are rounded to 1e-13 m there, in which kappa is ill posed.
    assert far.curvature(u) == pytest.approx(near.curvature(u), abs=1e-7 * 230.0)


def test_shapes_follow_the_parameters_and_both_ends_are_control_points():
    curve = butterfly()
    assert curve.point(0.3).shape == (2,)
    assert curve.derivative(np.zeros((3, 4)), 2).shape == (3, 4, 2)
    assert curve.curvature(np.zeros((3, 4))).shape == (3, 4)
    assert curve.point([]).shape == (0, 2)
    assert curve.dimension == 2
    ends = curve.sample(2)
    assert ends == pytest.approx(curve.control[[0, -1]], abs=1e-16)


def test_derivatives_above_the_degree_of_a_plain_spline_vanish():
    curve = infinity()
    assert np.abs(curve.derivative([0.1, 0.5, 1.0], 4)).max() == pytest.approx(0.0, abs=1e-9)
    assert np.abs(curve.derivative([0.1, 0.5, 1.0], 3)).min() > 0.1


@settings(deadline=None, max_examples=30)
@given(seed=seeds)
def test_arc_length_adds_up_and_its_inverse_returns(seed):
    curve = random_curve(seed)
    u = np.sort(np.random.default_rng(seed).uniform(*curve.domain, 30))
    length = curve.arc_length(u)
    assert np.all(np.diff(length) > 0.0)
    assert curve.arc_length(curve.domain) == pytest.approx([0.0, curve.length], abs=1e-12)
    chord = np.linalg.norm(np.diff(curve.point(u), axis=0), axis=1)
    assert np.all(np.diff(length) >= chord * (1.0 - 1e-9))
    assert curve.arc_length(curve.parameter(length)) == pytest.approx(length, abs=1e-12)


def test_length_is_the_limit_of_the_polygon():
    for name, make in CURVES.items():
        curve = make(SHEET_SCALES[name])
        polygon = [
            np.linalg.norm(np.diff(curve.sample(n), axis=0), axis=1).sum()
            for n in (100_001, 200_001)
        ]
        # The error of a polygon falls with the square of its step: extrapolate it away.
        assert curve.length == pytest.approx((4 * polygon[1] - polygon[0]) / 3, rel=1e-9)


def test_even_samples_are_at_equal_lengths():
    curve = butterfly()
    points = curve.sample(2001, even=True)
    assert points[[0, -1]] == pytest.approx(curve.control[[0, -1]], abs=1e-16)
    u = curve.parameter(np.linspace(0.0, curve.length, 2001))
    assert points == pytest.approx(curve.point(u), abs=1e-15)
    assert np.diff(curve.arc_length(u)) == pytest.approx(curve.length / 2000, abs=1e-12)


def test_cusp_has_a_length_and_infinite_curvature():
    # x = t^2, y = t^3 between -1 and 1, as a cubic: length of the semicubical parabola.
    control = np.array([[1.0, -1.0], [-1.0 / 3, 1.0], [-1.0 / 3, -1.0], [1.0, 1.0]])
    curve = NurbsCurve(control, np.ones(4), [0, 0, 0, 0, 1, 1, 1, 1])
    assert curve.length == pytest.approx(2 * (13 * np.sqrt(13) - 8) / 27, rel=1e-10)
    assert curve.curvature(0.5) == np.inf
    assert np.isfinite(curve.curvature([0.0, 0.4999, 0.5001, 1.0])).all()
    assert curve.arc_length(0.5) == pytest.approx(0.5 * curve.length, rel=1e-10)
    assert curve.parameter(0.5 * curve.length) == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize('doubled', [2, 3])
def test_doubled_end_point_of_a_straight_and_of_a_bent_curve(doubled):
    line = np.array([[0.0, 0.0]] * doubled + [[0.01, 0.02], [0.03, 0.06], [0.04, 0.08]])
    bent = line + np.array([0.0, 0.01]) * (np.arange(len(line)) == len(line) - 2)[:, np.newaxis]
    knot = np.concatenate([np.zeros(4), np.linspace(0, 1, len(line) - 2)[1:-1], np.ones(4)])
    weight = np.linspace(1.0, 2.0, len(line))
    straight = NurbsCurve(line, weight, knot)
    assert straight.curvature(0.0) == 0.0
    assert straight.curvature(np.linspace(0.01, 1.0, 50)) == pytest.approx(0.0, abs=1e-6)
    value = NurbsCurve(bent, weight, knot).curvature([0.0, 1e-5, 1e-3])
    if doubled == 2:
        assert value[0] == np.inf
        assert value[1] == pytest.approx(100.0 * value[2], rel=0.02)  # as 1/u
    else:  # three equal points leave the first span straight
        assert value[0] == 0.0


def test_arrays_are_copies_that_cannot_be_written():
    control = np.array([[0.0, 0.0], [1.0, 1.0]])
    curve = NurbsCurve(control, [1, 1], [0, 0, 1, 1], degree=1)
    control[0] = 9.0
    assert curve.point(0.0) == pytest.approx([0.0, 0.0])
    for array in (curve.control, curve.weight, curve.knot):
        with pytest.raises(ValueError, match='read-only'):
            array[0] = 1.0


LINE = {'control': [[0, 0], [1, 0], [2, 1]], 'weight': [1, 1, 1], 'knot': [0, 0, 0.5, 1, 1]}
CORNERS = {'control': np.eye(6, 2), 'weight': np.ones(6)}


@pytest.mark.parametrize(
    ('changed', 'words'),
    [
        ({'control': [[0, 0], [1, np.nan], [2, 1]]}, r'finite.*control.*nan.*\(1, 1\)'),
        ({'control': [[0], [1], [2]]}, r'\(n, 2\) or \(n, 3\)'),
        ({'control': [0, 1, 2]}, r'\(n, 2\) or \(n, 3\)'),
        ({'control': [[0, 0], [1]]}, 'numbers in control'),
        ({'control': [[0, 0]], 'weight': [1], 'knot': [0, 1, 2]}, 'more than 1 control points'),
        ({'weight': [1, 1]}, 'one weight per control point'),
        ({'weight': [0, 0, 0]}, 'positive weights but found 0 at index 0'),
        ({'weight': [1, -0.5, 1]}, 'positive weights but found -0.5 at index 1'),
        ({'weight': [1, np.inf, 1]}, 'finite numbers in weight'),
        ({'knot': [0, 0, 1, 1]}, 'expected 5 knots'),
        ({'knot': [0, 0, 0.5, 1, 1, 1]}, 'expected 5 knots'),
        ({'knot': [0, 0, 2, 1, 1]}, 'never fall but found 1 after 2 at index 3'),
        ({'knot': [0, 0, np.nan, 1, 1]}, 'finite numbers in knot'),
        ({'knot': [0, 0, 0, 1, 1]}, 'knot 0 at most 2 times .* found it 3 times'),
        ({'knot': [0, 1, 1, 1, 1]}, 'domain with length'),
        ({**CORNERS, 'knot': [0, 0, 0, 1, 1, 1, 2, 2, 2], 'degree': 2}, 'knot 1 at most 2 times'),
        ({'degree': 0}, 'degree that is an integer of 1 or more but found 0'),
        ({'degree': 1.5}, 'found 1.5'),
    ],
)
def test_what_is_no_curve_is_refused(changed, words):
    with pytest.raises(ValueError, match=words):
        NurbsCurve(**{**LINE, 'degree': 1, **changed})


def test_corner_at_a_full_knot_is_allowed():
    curve = NurbsCurve(**LINE, degree=1)
    assert curve.point(0.5) == pytest.approx([1.0, 0.0])
    assert curve.derivative(0.5) == pytest.approx([2.0, 2.0])  # of the span that begins there
    assert curve.length == pytest.approx(1.0 + np.sqrt(2.0))


@pytest.mark.parametrize('u', [-0.1, 1.1, np.nan, np.inf, [0.5, np.nan]])
@pytest.mark.parametrize('method', ['point', 'derivative', 'curvature', 'arc_length'])
def test_parameters_outside_the_domain_are_refused(method, u):
    with pytest.raises(ValueError, match='parameters from 0 to 1'):
        getattr(infinity(), method)(u)


@pytest.mark.parametrize('length', [-0.01, 0.5, np.nan])
def test_lengths_outside_the_curve_are_refused(length):
    with pytest.raises(ValueError, match=r'arc lengths from 0 to 0\.475'):
        infinity().parameter(length)


def test_order_and_number_of_samples_are_checked():
    with pytest.raises(ValueError, match='order of 1'):
        infinity().derivative(0.5, 0)
    with pytest.raises(ValueError, match='n = 1'):
        infinity().sample(1)


@pytest.mark.parametrize('scale', [0.0, -1.0, np.nan])
@pytest.mark.parametrize('make', CURVES.values())
def test_curves_of_no_size_are_refused(make, scale):
    with pytest.raises(ValueError, match='positive scale'):
        make(scale)
