# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples, true_compensation
from fuzzycnc_ros.simulation.soft.foam_sheet import FoamSheet, FoamStitching

SHEET = FoamSheet(15e-3)
LINE = np.column_stack([np.linspace(0.06, 0.12, 21), np.full(21, 0.05)])


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'thickness': 0.0}, 'thickness: expected more than 0 mm but found 0'),
        ({'thickness': np.nan}, 'thickness: expected more than 0 mm but found nan'),
        ({'size': (0.2, -0.1)}, 'size Y: expected more than 0 mm but found -100'),
        ({'young_modulus': np.inf}, 'young_modulus: expected more than 0 MPa but found inf'),
        ({'poisson_ratio': 0.5}, 'poisson_ratio: expected 0 to less than 0.5 but found 0.5'),
        ({'friction': -0.1}, 'friction: expected 0 or more but found -0.1'),
    ],
)
def test_sheets_out_of_range_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        FoamSheet(**{'thickness': 15e-3, **change})


@pytest.mark.parametrize('depth', [0.0, -1e-3, np.nan, np.inf])
def test_a_depth_must_be_positive_and_leaves_the_run_as_it_was(depth):
    run, twin = FoamStitching(SHEET, LINE[0]), FoamStitching(SHEET, LINE[0])
    run.step(LINE[1], 6e-3)
    twin.step(LINE[1], 6e-3)
    with pytest.raises(ValueError, match='depth: expected more than 0 mm'):
        run.step(LINE[2], depth)
    np.testing.assert_array_equal(run.step(LINE[2], 6e-3), twin.step(LINE[2], 6e-3))


@pytest.mark.parametrize('point', [(np.nan, 0.0), (0.0, np.inf), (0.0,), (0.0, 0.0, 0.0)])
def test_points_must_be_finite_and_plane(point):
    with pytest.raises(ValueError, match='point: expected two finite coordinates'):
        FoamStitching(SHEET, point)
    run = FoamStitching(SHEET, LINE[0])
    with pytest.raises(ValueError, match='point: expected two finite coordinates'):
        run.step(point, 6e-3)


def test_the_first_point_is_stitched_as_commanded_and_the_drift_grows():
    stitched = SHEET.stitch(LINE, 6e-3)
    np.testing.assert_array_equal(stitched[0], LINE[0])
    drift = np.hypot(*(LINE - stitched).T)
    assert np.all(np.diff(drift[:15]) > 0.0)


def test_a_path_is_its_steps():
    rng, twin = np.random.default_rng(4), np.random.default_rng(4)
    turns = np.arange(20) % 3 - 1
    whole = SHEET.stitch(LINE, 6e-3, turns, rng)
    run = FoamStitching(SHEET, LINE[0], twin)
    steps = [run.stitched, *(run.step(p, 6e-3, t) for p, t in zip(LINE[1:], turns, strict=True))]
    np.testing.assert_array_equal(whole, steps)


def test_noise_is_that_of_one_draw_for_all_points():
    drawn = np.random.default_rng(8).normal(0.0, 3e-5, LINE.shape)
    noisy = SHEET.stitch(LINE, 6e-3, rng=np.random.default_rng(8))
    np.testing.assert_allclose(noisy - SHEET.stitch(LINE, 6e-3), drawn, rtol=0, atol=1e-15)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.0, 6.28), st.integers(-1, 1))
def test_the_opposite_direction_drags_the_opposite_way(angle, turn):
    """On a path through the centre and back out, where the sheet is the same."""
    along = np.array([np.cos(angle), np.sin(angle)])
    points = np.outer(np.linspace(-0.02, 0.02, 14), along)
    centre = np.array([0.1, 0.06])
    there = SHEET.stitch(centre + points, 6e-3, turn) - (centre + points)
    back = SHEET.stitch(centre - points, 6e-3, turn) - (centre - points)
    np.testing.assert_allclose(there, -back, atol=1e-15)


def test_stiffness_cancels_and_friction_scales():
    once = LINE - SHEET.stitch(LINE, 6e-3)
    stiff = FoamSheet(15e-3, young_modulus=1e6)
    np.testing.assert_allclose(LINE - stiff.stitch(LINE, 6e-3), once, atol=1e-12)
    rough = FoamSheet(15e-3, friction=2 * SHEET.friction)
    np.testing.assert_allclose(LINE - rough.stitch(LINE, 6e-3), 2 * once, atol=1e-12)


def test_a_foot_beyond_the_sheet_is_as_on_its_edge_and_through_it_as_at_most():
    outside = SHEET.compliance([-0.01, 0.05], 6e-3)
    np.testing.assert_array_equal(outside, SHEET.compliance([0.0, 0.05], 6e-3))
    assert SHEET.normal_force(14e-3) == SHEET.normal_force(12e-3)


def test_a_stitch_in_place_locks_more_and_moves_nothing():
    run = FoamStitching(SHEET, LINE[0])
    for point in LINE[1:]:
        last = run.step(point, 6e-3)
    again = run.step(LINE[-1], 6e-3)
    assert again[0] < last[0]  # the elastic drag is locked once more
    assert np.isfinite(again).all()


@pytest.mark.parametrize(
    ('row', 'message'),
    [
        ([0, 6, 3, 3, 15], r'type: expected 1 \(arc\) or 2 \(line\) but found 3'),
        ([0, 6, 2, 0, 15], 'step: expected more than 0 mm and at most the 50 mm'),
        ([0, 6, 1, 61, 15], 'step: expected more than 0 mm and at most the 30 mm'),
        ([0, 0, 2, 3, 15], 'depth: expected more than 0 mm'),
        ([0, 6, 2, 3, 0], 'thickness: expected more than 0 mm'),
        ([np.nan, 6, 2, 3, 15], 'x: expected finite rows'),
        ([0, 6, 2, 3], r'x: expected finite rows .* found shape \(1, 4\)'),
    ],
)
def test_rows_that_cannot_be_stitched_are_refused(row, message):
    with pytest.raises(ValueError, match=message):
        true_compensation([row])


def test_samples_keep_their_processes_and_lose_their_noise():
    x, s = foam_samples(3)
    assert x.shape == (265, 5)
    assert s.shape == (265, 2)
    truth = true_compensation(x)
    assert np.sqrt(np.mean((s - truth) ** 2)) == pytest.approx(0.2, abs=0.1)
    again = foam_samples(3)
    np.testing.assert_array_equal(s, again.s)
    rough = foam_samples(3, friction=1.25)
    np.testing.assert_array_equal(rough.x, x)
    np.testing.assert_allclose(true_compensation(x, 1.25), 1.25 * truth)
    assert len(true_compensation(np.empty((0, 5)))) == 0
