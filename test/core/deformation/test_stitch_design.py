# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Designs: runs between jumps and cuts, lengths of moved stitches, gaps between neighbours."""

import numpy as np
import pytest

from fuzzycnc_ros.core.deformation.stitch_design import (
    Design,
    Move,
    PlacedRun,
    StitchLengths,
    neighbour_gaps,
    placed_design,
    run_path,
    stitches_along,
)

S, J, C, P = Move.STITCH, Move.JUMP, Move.CUT, Move.PAUSE
ROW = np.column_stack([np.arange(6) * 3e-3, np.zeros(6)])
LIMITS = StitchLengths(1e-4, 12.1e-3, 7e-3, 0.3e-3)


def design(*moves):
    points = np.column_stack([np.arange(len(moves)) * 3e-3, np.zeros(len(moves))])
    return Design(points, np.array(moves))


def test_jumps_and_cuts_end_a_run_and_stops_do_not():
    found = design(J, S, S, P, S, C, S, J, J, S, S).runs()
    assert [run.tolist() for run in found] == [[1, 2, 4], [6], [9, 10]]


def test_a_run_without_a_step_that_moves_has_no_path():
    assert run_path(ROW[:1], 6e-3, None) is None
    assert run_path(ROW[[2, 2, 2]], 6e-3, None) is None
    assert run_path(ROW[[0, 1, 2, 2]], 6e-3, None).step.tolist() == [3e-3] * 3


def test_what_has_no_offset_stays_exactly_and_jumps_stay_whatever_the_offset():
    plan = design(J, S, S, S, J, S)
    plan.points[:] += 1.234567e-5  # off the grid of the file
    offset = np.full_like(plan.points, 1e-3)
    offset[2] = 0.0
    placed = placed_design(plan, offset, LIMITS)
    same = (placed.points == plan.points).all(axis=1)
    assert same.tolist() == [True, False, True, False, True, False]
    moved = placed.points[~same] / LIMITS.unit
    np.testing.assert_allclose(moved, np.round(moved), atol=1e-9)


@pytest.mark.parametrize(
    ('stretched', 'limits', 'parts'),
    [
        (9e-3, StitchLengths(1e-4, 12.1e-3), 1),
        (13e-3, StitchLengths(1e-4, 12.1e-3), 2),
        (25e-3, StitchLengths(1e-4, 12.1e-3), 3),
        (9e-3, StitchLengths(1e-4, 12.1e-3, longest=5e-3), 2),
    ],
)
def test_stitches_that_get_too_long_are_split(stretched, limits, parts):
    plan = design(S, S, S)
    offset = np.zeros_like(plan.points)
    offset[1:, 0] = stretched - 3e-3
    placed = placed_design(plan, offset, limits)
    (run,) = placed.runs()
    steps = np.hypot(*np.diff(run, axis=0).T)
    assert len(run) == 2 + parts
    assert placed.split == (parts > 1)
    assert steps.max() <= min(limits.longest, limits.along_axis) + 1e-9


def test_a_stitch_that_was_planned_too_long_is_the_writers_affair():
    plan = Design(np.array([[0.0, 0.0], [0.03, 0.0]]), np.array([S, S]))
    placed = placed_design(plan, np.array([[0.0, 0.0], [1e-3, 0.0]]), LIMITS)
    assert placed.split == 1  # by the longest stitch of the machine
    only = placed_design(plan, np.array([[0.0, 0.0], [1e-3, 0.0]]), StitchLengths(1e-4, 12.1e-3))
    assert only.split == 0


def test_stitches_that_get_too_short_are_merged_but_never_the_ends():
    plan = design(S, S, S, S)
    offset = np.zeros_like(plan.points)
    offset[1, 0] = -2.9e-3
    offset[3, 0] = -2.9e-3
    placed = placed_design(plan, offset, LIMITS)
    assert placed.merged.tolist() == [False, True, False, False]
    assert placed.runs()[0][[0, -1]].tolist() == placed.points[[0, 3]].tolist()


def test_lock_stitches_of_the_plan_are_not_merged():
    plan = Design(np.array([[0.0, 0.0], [1e-4, 0.0], [0.0, 0.0], [3e-3, 0.0]]), np.full(4, S))
    placed = placed_design(plan, np.full((4, 2), 1e-3), LIMITS)
    assert not placed.merged.any()


def test_stitches_along_a_path_lie_at_its_ends_and_corners():
    turn = np.linspace(0.0, np.pi, 200)
    arc = 0.01 * np.column_stack([np.cos(turn), np.sin(turn)])
    line = np.concatenate([[[0.01, -0.02]], arc, [[-0.01, -0.02]]])
    found = stitches_along(line, 3e-3)
    radius = np.hypot(*found.T)[found[:, 1] >= 0.0]
    np.testing.assert_allclose(radius, 0.01, atol=2e-5)
    assert found[[0, -1]].tolist() == [[0.01, -0.02], [-0.01, -0.02]]
    corner = stitches_along([[0.0, 0.0], [5e-3, 0.0], [5e-3, 0.0], [5e-3, 9e-3]], 3e-3)
    assert [5e-3, 0.0] in corner.tolist()


def test_gaps_open_where_neighbours_move_apart():
    fill, border = ROW, np.add(ROW, [0.0, 0.5e-3])
    off = np.zeros_like(ROW)
    shrunk = off.copy()
    shrunk[3] = [0.0, 1e-3]  # without compensation this stitch of the fill lies 1 mm lower
    runs = [PlacedRun(fill, fill + shrunk, shrunk), PlacedRun(border, border, off)]
    (gap,) = neighbour_gaps(runs)
    assert gap.runs == (0, 1)
    assert gap.place == pytest.approx((9e-3, 0.0)) or gap.place == pytest.approx((9e-3, 0.5e-3))
    assert [gap.planned, gap.before, gap.after] == pytest.approx([0.5e-3, 1.5e-3, 0.5e-3])
    far = PlacedRun(np.add(border, [0.0, 0.05]), border, off)
    assert neighbour_gaps([runs[0], far]) == []
    assert neighbour_gaps(runs[:1]) == []
