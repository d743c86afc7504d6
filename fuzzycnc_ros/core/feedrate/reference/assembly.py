# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Pieces of a reference path: shapes between their junctions, and the junctions, in order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.path_geometry import CORNER_ANGLE, hermite, turn_angles
from fuzzycnc_ros.core.feedrate.path.sampled_path import REVERSAL_ANGLE
from fuzzycnc_ros.core.feedrate.reference.blend import (
    EASING_PIECES,
    Rounding,
    corner_reach,
    ease_reach,
    pieces_of,
    rounded,
)
from fuzzycnc_ros.core.feedrate.reference.curve_nodes import TURN
from fuzzycnc_ros.core.feedrate.reference.shapes import ARC, CURVE, LINE, Shapes

_JUMP = 1e-9
"""Jumps of the curvature up to this are rounding [1/m]."""
_LEAST = 1e-9
"""Roundings that reach less far are none: they would have no digits left [m]."""
_END = 5e-4
"""Distance of the first node inside a line from its end [m]; each next one is 4 times farther.

Schedulers know a path by its nodes alone, and speeds run straight from node to node: without
these a long line would be slow all along because of what is at its ends."""
_STEPS = 6


@dataclass(frozen=True)
class Pieces:
    """Pieces in order, m of them, and m + 1 nodes; see `ReferencePath`.

    `head` is how far the last junction reaches into the last shape [m].
    """

    coefficient: Array
    length: Array
    curvature: Array
    owner: NDArray[np.intp]
    blend: NDArray[np.bool_]
    feed: Array
    stop: NDArray[np.bool_]
    rest: Array
    head: float


@dataclass(frozen=True)
class _Group:
    """Pieces of one kind, k of them: where they belong, and what they are."""

    position: NDArray[np.intp]
    coefficient: Array
    length: Array
    curvature: Array  # (k, 2)
    shape: NDArray[np.intp]
    blend: bool


def assemble(shapes: Shapes, head: float, blend: float, easing: float, *, last: bool) -> Pieces:
    """Return the pieces of shapes and of all junctions between them.

    Parameters
    ----------
    shapes : Shapes
        n of them.
    head : float
        How much of the first one belongs to the junction before it [m].
    blend, easing : float
        Largest distances of blends and of eased jumps of the curvature from the path [m].
    last : bool
        Whether the last shape is the end of the path; else nothing of it but its junction with
        the one before is returned.
    """
    joint = np.arange(len(shapes) - 1)
    before = shapes.frame(joint, shapes.length[:-1])
    after = shapes.frame(joint + 1, np.zeros(len(joint)))
    turn = turn_angles(before.tangent, after.tangent)
    halt = shapes.halt[1:] | (shapes.rapid[1:] != shapes.rapid[:-1])
    corner = turn > CORNER_ANGLE
    blended = corner & ~halt & (blend > 0.0) & (turn <= REVERSAL_ANGLE)
    jump = np.linalg.norm(after.bend - before.bend, axis=1)
    eased = ~corner & ~halt & (jump > _JUMP)
    reach = np.zeros(len(joint))
    straight = (shapes.kind[:-1] == LINE) & (shapes.kind[1:] == LINE)
    count = np.where(blended, pieces_of(turn, straight), 0)
    count[eased] = EASING_PIECES
    for pieces in np.unique(count[blended]).tolist():
        rows = np.flatnonzero(blended & (count == pieces))
        reach[rows] = corner_reach(shapes, rows, turn[rows], blend, pieces)
    rows = np.flatnonzero(eased)
    reach[rows] = ease_reach(shapes, rows, easing)
    count[reach <= _LEAST] = 0
    reach[count == 0] = 0.0
    stop = halt | (corner & (count == 0))

    low, high = np.append(head, reach), shapes.length - np.append(reach, 0.0)
    if not last:
        high[-1] = low[-1]
    size = _sizes(shapes, low, high)
    first = np.append(0, np.cumsum(size + np.append(count, 0)))
    groups = [_bodies(shapes, low, high, size, first)]
    for pieces in np.unique(count[count > 0]).tolist():
        for chosen, kink in ((blended, True), (eased, False)):
            rows = np.flatnonzero(chosen & (count == pieces))
            if len(rows):
                made = rounded(shapes, rows, turn[rows], reach[rows], pieces)
                groups.append(_junctions(made, rows, first[rows] + size[rows], kink))
    total = int(first[-1])
    coefficient, length = np.empty((total, 6, 3)), np.empty(total)
    shape, kinked = np.empty(total, dtype=np.intp), np.zeros(total, bool)
    curvature = np.zeros(total + 1)
    for group in groups:
        at = group.position
        coefficient[at], length[at] = group.coefficient, group.length
        shape[at], kinked[at] = group.shape, group.blend
        for side in (0, 1):
            curvature[at + side] = np.maximum(curvature[at + side], group.curvature[:, side])
    # Where the next shape goes on, which may be yet to come, the node sees it too.
    meeting = first[1:-1]
    onward = shapes.frame(joint + 1, reach).curvature
    curvature[meeting] = np.maximum(curvature[meeting], onward)
    stops, rest = np.zeros(total + 1, bool), np.zeros(total + 1)
    stops[meeting], rest[meeting] = stop, shapes.rest[1:]
    return Pieces(
        coefficient,
        length,
        curvature,
        shapes.owner[shape],
        kinked,
        shapes.feed[shape],
        stops,
        rest,
        float(low[-1]),
    )


def _sizes(shapes: Shapes, low: Array, high: Array) -> NDArray[np.intp]:
    """Return the number of pieces of each shape between its junctions, shape (n,)."""
    span = high - low
    steps = np.floor(np.log2(np.maximum(span, 1e-12) / (4.0 * _END)) / 2.0) + 1.0
    found = 1.0 + 2.0 * np.clip(steps, 0.0, _STEPS)
    arcs = shapes.kind == ARC
    turn = np.abs(shapes.arc[arcs, 8]) * span[arcs] / shapes.length[arcs]
    found[arcs] = np.maximum(np.ceil(turn / TURN - 1e-9), 1.0)
    for k in np.flatnonzero(shapes.kind == CURVE).tolist():
        found[k] = len(_inside(shapes.curve[k].place, low[k], high[k])) + 1
    found[span <= 1e-12 * shapes.length] = 0.0
    return found.astype(np.intp)


def _inside(node: Array, low: float, high: float) -> Array:
    """Return the nodes between two places that are not next to one of them."""
    first, last = np.searchsorted(node, low, 'right'), np.searchsorted(node, high, 'left')
    found = node[first:last]
    if not len(found):
        return found
    apart = 0.1 * np.diff(np.concatenate([node[first - 1 : last], node[last : last + 1]]))
    keep = (found - low > apart[: len(found)]) & (high - found > apart[1:])
    return np.asarray(found[keep])


def _bodies(
    shapes: Shapes, low: Array, high: Array, size: NDArray[np.intp], first: NDArray[np.intp]
) -> _Group:
    """Return the pieces of the shapes between their junctions."""
    nodes = np.where(size > 0, size + 1, 0)
    row = np.repeat(np.arange(len(size)), nodes)
    step = np.arange(len(row)) - np.append(0, np.cumsum(nodes))[row]
    left = size[row] - step
    begin, end = low[row], high[row]
    place = begin + (end - begin) * (step / size[row])
    graded = (shapes.kind[row] == LINE) & (size[row] > 1)
    near = np.minimum(step, left)
    distance = np.where(near > 0, _END * 4.0 ** (near - 1.0), 0.0)
    place = np.where(graded, np.where(step <= left, begin + distance, end - distance), place)
    place = np.where(left == 0, end, place)
    for k in np.flatnonzero((shapes.kind == CURVE) & (size > 1)).tolist():
        inner = np.flatnonzero((row == k) & (step > 0) & (left > 0))
        place[inner] = _inside(shapes.curve[k].place, low[k], high[k])
    frame = shapes.frame(row, place)
    whole = left[:-1] > 0  # from the last node of one shape to the next there is no piece
    length = np.where(whole, np.diff(place), 1.0)
    if not len(row):
        return _Group(row, np.empty((0, 6, 3)), np.empty(0), np.empty((0, 2)), row, False)
    piece = hermite(frame.point, frame.tangent, frame.bend, length)[whole]
    bent = frame.curvature
    owner = row[:-1][whole]
    return _Group(
        first[owner] + step[:-1][whole],
        piece,
        length[whole],
        np.stack([bent[:-1], bent[1:]], axis=1)[whole],
        owner,
        False,
    )


def _junctions(
    made: Rounding, index: NDArray[np.intp], first: NDArray[np.intp], kink: bool
) -> _Group:
    """Return the pieces of junctions behind shapes `index`, from positions `first` on."""
    count = made.length.shape[1]
    step = np.arange(count)
    return _Group(
        (first[:, np.newaxis] + step).ravel(),
        made.coefficient.reshape(-1, 6, 3),
        made.length.ravel(),
        np.stack([made.curvature[:, :-1], made.curvature[:, 1:]], axis=2).reshape(-1, 2),
        (index[:, np.newaxis] + (step >= count // 2)).ravel(),
        kink,
    )
