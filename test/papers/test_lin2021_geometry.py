# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Check values of the curves and their curvature [lin2021]."""

import json

import numpy as np
import pytest

from fuzzycnc_ros.core.feedrate.path.curves import CURVES, SHEET_SCALES, butterfly
from fuzzycnc_ros.core.feedrate.path.sampled_path import curvature

pytestmark = pytest.mark.paper

MM = 1e3  # of metres
GRID = np.linspace(0.0, 1.0, 200_000)


@pytest.mark.parametrize(
    ('name', 'length', 'extent', 'sharpest', 'scaled_length', 'scaled_sharpest'),
    [
        ('infinity', 475.162, (106.75, 127.44), 0.2304, 308.86, 0.354),
        ('trident', 97.991, (25.84, 32.00), 3.539, 225.38, 1.539),
        ('butterfly', 382.860, (97.16, 58.88), 43.25, 335.00, 49.4),
    ],
)
def test_size_and_curvature_of_the_curves(
    name, length, extent, sharpest, scaled_length, scaled_sharpest
):
    curve, scaled = CURVES[name](1.0), CURVES[name](SHEET_SCALES[name])
    assert MM * curve.length == pytest.approx(length, abs=0.001)
    assert MM * np.ptp(curve.point(GRID), axis=0) == pytest.approx(extent, abs=0.005)
    assert curve.curvature(GRID).max() / MM == pytest.approx(sharpest, rel=2e-4)
    assert MM * scaled.length == pytest.approx(scaled_length, abs=0.005)
    assert scaled.curvature(GRID).max() / MM == pytest.approx(scaled_sharpest, rel=1.5e-3)


def test_symmetry_of_the_butterfly():
    curve = butterfly()
    point, middle = MM * curve.control, 54.493
    assert curve.weight.tolist() == curve.weight[::-1].tolist()
    assert np.abs(curve.knot + curve.knot[::-1] - 1.0).max() == pytest.approx(2e-4, rel=0.01)
    apart = point - ([2 * middle, 0.0] + [-1.0, 1.0] * point[::-1])
    distance = np.linalg.norm(apart, axis=1)
    assert distance.argmax() in (9, 41)
    assert distance.max() == pytest.approx(0.246, abs=0.001)
    assert distance[8] == pytest.approx(0.116, abs=0.001)
    assert np.linalg.norm(point[-1] - point[0]) == pytest.approx(0.001, rel=1e-6)
    assert GRID[curve.curvature(GRID).argmax()] == pytest.approx(0.25635, abs=5e-6)


def test_butterfly_is_the_published_table(data):
    table = json.loads((data / 'butterfly-nurbs' / 'butterfly.json').read_text())
    curve = butterfly()
    assert (table['degree'], table['unit']) == (curve.degree, 'mm')
    assert MM * curve.control == pytest.approx(np.array(table['control_points']), rel=1e-15)
    assert curve.weight.tolist() == table['weights']
    assert curve.knot.tolist() == table['knots']


@pytest.mark.parametrize(
    ('n', 'sharpest'), [(500, 42), (1000, 46), (2000, 40), (5000, 47), (20_000, 49)]
)
def test_samples_miss_the_narrow_peak_of_the_butterfly(n, sharpest):
    sampled = butterfly(SHEET_SCALES['butterfly']).sample(n)
    assert round(curvature(sampled).max() / MM) == sharpest


@pytest.mark.parametrize('name', CURVES)
def test_three_points_give_the_exact_curvature(name):
    curve = CURVES[name](1.0)
    exact = curve.curvature(np.linspace(0.0, 1.0, 2000))
    error = np.abs(curvature(curve.sample(2000)) - exact)
    assert np.median(error) <= 1e-6 * exact.max()


@pytest.mark.parametrize(
    ('name', 'plain', 'plain_sharpest', 'stencil'),
    [('infinity', 0.15, 0.83, 0.014), ('trident', 0.71, 6.06, 0.018)],
)
def test_rounded_coordinates_need_the_arc_stencil(name, plain, plain_sharpest, stencil):
    curve = CURVES[name](SHEET_SCALES[name])
    rounded = curve.sample(2000).round(6)  # three decimals of a millimetre
    exact = curve.curvature(np.linspace(0.0, 1.0, 2000))

    def p95(value):
        return np.quantile(np.abs(value - exact), 0.95) / MM

    value = curvature(rounded)
    assert p95(value) == pytest.approx(plain, abs=0.005)
    assert value.max() / MM == pytest.approx(plain_sharpest, abs=0.005)
    value = curvature(rounded, rounding=0.5e-6, stencil=0.3e-3)
    # The trident's is 0.0197; outer points of either side's samples instead of the polyline's
    # give 0.0195 to 0.0234, so the prototype's 0.018 is not had from [lin2021] eq. (9).
    assert p95(value) == pytest.approx(stencil, rel=0.1)
    assert p95(curvature(rounded, rounding=0.5e-6)) <= 1.25 * stencil


def test_stencil_keeps_the_peak_of_the_butterfly():
    rounded = butterfly(SHEET_SCALES['butterfly']).sample(2000).round(6)
    # A prototype had it flattened from 40 to 6.5 1/mm; eq. (9) over 0.3 mm, where the path turns
    # by some 130 degrees, is as steep as at the samples.
    value = curvature(rounded, rounding=0.5e-6, stencil=0.3e-3)
    assert value.max() / MM == pytest.approx(40.0, rel=0.02)
