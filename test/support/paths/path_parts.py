# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Paths of straight lines, and of parts in a row, for tests of feedrates."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.feedrate.path.path_geometry import (
    SMOOTH_TURN,
    PathGeometry,
    hermite,
    turn_angles,
)


def straight_lines(points: ArrayLike) -> PathGeometry:
    """Return the lines through points, shape (n, d), repeated ones left out; turns are stops."""
    point = np.array(points, dtype=float)
    point = point[np.append(True, np.linalg.norm(np.diff(point, axis=0), axis=1) > 0.0)]
    edge = np.diff(point, axis=0)
    share = np.linspace(0.0, 1.0, 6)[:, np.newaxis]
    coefficient = point[:-1, np.newaxis] + share * edge[:, np.newaxis]
    coefficient[:, -1] = point[1:]  # exactly, not by a sum
    stop = np.zeros(len(point), bool)
    stop[1:-1] = turn_angles(edge[:-1], edge[1:]) > SMOOTH_TURN
    node = np.append(0.0, np.cumsum(np.linalg.norm(edge, axis=1)))
    return PathGeometry(coefficient, node, stop)


def joined_path(parts: Sequence[PathGeometry], easing: float = 1e-6) -> PathGeometry:
    """Return one path of smooth parts, each of which begins where the one before ends.

    A turn between two is a stop.  Where only the curvature jumps, as from a line to an arc, it
    goes over within a short piece on each side, which moves the path by at most `easing` [m].
    """
    along, bend = (
        np.array([part.evaluate([0.0, part.length], order) for part in parts]) for order in (1, 2)
    )
    corner = turn_angles(along[:-1, 1], along[1:, 0]) > SMOOTH_TURN
    jump = np.linalg.norm(bend[1:, 0] - bend[:-1, 1], axis=1)
    eased = ~corner & (jump > 1e-9)
    mean = 0.5 * (bend[:-1, 1] + bend[1:, 0])[eased]
    bend[:-1, 1][eased] = bend[1:, 0][eased] = mean
    piece = np.full(len(jump) + 2, np.inf)
    # u^2 (1 - u)^3 / 2, the quintic of half the jump, is at most 0.0173.
    piece[1:-1][eased] = np.sqrt(easing / (0.5 * 0.0173 * jump[eased]))
    coefficient, length, stop = [], [], [np.zeros(1, bool)]
    for number, part in enumerate(parts):
        node = _cut(part.node, *piece[number : number + 2])
        point, tangent, curvature = (part.evaluate(node, order) for order in range(3))
        curvature[[0, -1]] = bend[number]
        coefficient.append(hermite(point, tangent, curvature, np.diff(node)))
        length.append(np.diff(node))
        stop.append(np.zeros(len(node) - 1, bool))
    for before, turns in zip(stop[1:], corner, strict=False):
        before[-1] = turns
    return PathGeometry(
        np.concatenate(coefficient),
        np.append(0.0, np.cumsum(np.concatenate(length))),
        np.concatenate(stop),
    )


def _cut(node: np.ndarray, head: float, tail: float) -> np.ndarray:
    """Return nodes whose first and last piece are no longer than `head` and `tail` [m]."""
    inner = node[:-1].tolist()
    if head < node[1]:
        inner.insert(1, head)
    if tail < node[-1] - node[-2]:
        inner.append(max(node[-1] - tail, 0.5 * (node[-1] + inner[-1])))
    return np.array([*inner, node[-1]])
