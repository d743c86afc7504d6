# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reference path of a program: quintic pieces, corners blended or stopped at, as a stream.

Each piece and each junction depends on a segment and its neighbours alone, so that a path that
arrives in parts is the same as the whole.

Corners are blended, and jumps of the curvature eased.  Let T0 and T1 be the directions before and
after a corner, K0 and K1 the curvature vectors, l the reach to either side and p(s) the programmed
path at distance s from the corner.  The blend is

    q(t) = p(s(t)) + l (T1 - T0) g(t) + l^2 (K1 - K0) e(s(t) / l),    0 <= t <= 1,
    s(t) = l (f(1 - t) - f(t)),   g(t) = min(f(t), f(1 - t))

with f a quintic that falls from 1 to 0 and has three zeros at t = 1.  Between lines this is the
quintic whose control points lie on them.  For any curves the corrections vanish to the second
derivative at both ends, and the jumps of p' and p'' in the middle are cancelled.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array, dot_products, vector_lengths
from fuzzycnc_ros.core.feedrate.gcode.segments import DwellSegment, NurbsSegment, Segment
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.core.feedrate.path.path_geometry import (
    SMOOTH_TURN,
    PathGeometry,
    bernstein,
    hermite,
    turn_angles,
)
from fuzzycnc_ros.core.feedrate.path.sampled_path import REVERSAL_ANGLE
from fuzzycnc_ros.core.feedrate.path.shapes import (
    ARC,
    CURVE,
    LINE,
    TURN,
    Frame,
    Shapes,
    make_shapes,
)

_TINY = 0.1
"""Turn of a corner up to which its blend has two pieces [rad]."""
_FEW = 0.5
"""The same for four pieces [rad]."""
_EIGHT = 1.6
"""The same for eight pieces [rad]."""
_EASING_PIECES = 6
"""Pieces of an eased jump of the curvature."""

_SHARES = {
    2: np.array([0.0, 0.5, 1.0]),
    4: np.array([0.0, 0.18, 0.5, 0.82, 1.0]),
    6: np.linspace(0.0, 1.0, 7),
    8: np.linspace(0.0, 1.0, 9),
    12: np.linspace(0.0, 1.0, 13),
}
"""Nodes of a blend, by its pieces."""

_UNIFORM = (0.4, 0.8)
"""Control points that make s(t) linear."""
_TWO_PIECES = (0.411, 0.7225)
"""Those whose two pieces through start, middle and end have the flattest curvature."""

_BEND = 0.4
"""A blend reaches no farther than the path turns by this [rad]."""
_EASE = np.array([0.2 / 3.0, -0.25, 0.35, -0.65 / 3.0, 0.05])
"""e(u) from u^1 on, for u > 0; odd.  Its second derivative, -1/2 at 0, overshoots by 0.041."""
_EASE_MOST = 0.006
"""Bound of e."""
_ROOM = 1.0 - 1e-3
"""Share of the tolerance that blends beside curves use; the rest covers the curve's own pieces."""
_ROUNDS = 60
_CLEAR = 0.999
"""Reaches above this share of half a shape, but below it, would leave a sliver of it."""

_NODE, _WEIGHT = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True)
class _Rounding:
    """Pieces of k junctions, n each.

    Attributes
    ----------
    coefficient : array, shape (k, n, 6, 3)
        Bernstein coefficients [m].
    length : array, shape (k, n)
        Their lengths [m].
    curvature : array, shape (k, n + 1)
        At the nodes [1/m].
    node : array, shape (k, n + 1, 3)
        Nodes [m].
    place : array, shape (k, n + 1)
        Signed distances s along the programmed path, from the junction [m].
    """

    coefficient: Array
    length: Array
    curvature: Array
    node: Array
    place: Array


def _pieces_of(turn: Array, straight: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the number of pieces of corners, by their turn [rad] and whether between lines."""
    found = np.where(turn <= _EIGHT, 8, 12)
    found = np.where(turn <= np.where(straight, _FEW, 0.0), 4, found)
    return np.asarray(np.where(turn <= _TINY, np.where(straight, 2, 6), found), dtype=np.intp)


def _control_shares(turn: Array, pieces: int) -> tuple[Array, Array]:
    """Return how far along each side the second and third control point lie, each (k,).

    The curvature is the flatter the nearer the second one is to the first, and rises the steeper.
    The values keep the largest one within a few per cent of the least possible for a deviation.
    """
    if pieces in (2, 6):
        first, second = _TWO_PIECES if pieces == 2 else _UNIFORM
        return np.full(len(turn), first), np.full(len(turn), second)
    square = turn * turn
    return 0.28 - 0.02 * square, 0.72 - 0.034 * square - 0.003 * (square * square)


def _line_reach(turn: Array, tolerance: float, pieces: int) -> Array:
    """Return the reach at which blends of lines are `tolerance` from them [m], shape (k,)."""
    first, second = _control_shares(turn, pieces)
    middle = (1.0 + 5.0 * (1.0 - first) + 10.0 * (1.0 - second)) / 32.0
    return np.asarray((1.0 - 1e-9) * tolerance / (middle * portable.sin(turn)))


def _corner_reach(
    shapes: Shapes, index: NDArray[np.intp], turn: Array, tolerance: float, pieces: int
) -> Array:
    """Return how far blends reach to either side of corners [m].

    Parameters
    ----------
    shapes : Shapes
        The path.
    index : array, shape (k,)
        Shapes before the corners.
    turn : array, shape (k,)
        Turns [rad], up to 150 degrees.
    tolerance : float
        Largest distance of a blend from the path [m].
    pieces : int
        Pieces of each blend.

    Returns
    -------
    array, shape (k,)
        At most half of the shorter shape, and so that the blend keeps the tolerance: between
        lines by its largest distance, in the middle; beside curves by the control points of its
        difference from the path beside it, within which it lies.
    """
    limit = 0.5 * np.minimum(shapes.length[index], shapes.length[index + 1])
    reach = _whole_halves(np.minimum(_line_reach(turn, tolerance, pieces), limit), shapes, index)
    bent = np.flatnonzero((shapes.kind[index] != LINE) | (shapes.kind[index + 1] != LINE))
    if not len(bent):
        return reach
    found = np.minimum(reach[bent], _bend_limit(shapes, index[bent]))
    jump = _jump(shapes, index[bent])
    found = np.minimum(found, np.sqrt(2.0 * tolerance / (_EASE_MOST * jump + 1e-30)))
    todo = np.arange(len(bent))
    for _ in range(_ROUNDS):
        at = index[bent[todo]]
        made = _rounded(shapes, at, turn[bent[todo]], found[todo], pieces)
        share = _distance_bound(shapes, at, made) / (_ROOM * tolerance)
        over = share > 1.0
        if not over.any():
            break
        todo, share = todo[over], share[over]
        found[todo] *= np.clip(0.998 / share, 0.3, 0.998)
    else:
        found[todo] = 0.0
    reach[bent] = _whole_halves(found, shapes, index[bent])
    return reach


def _ease_reach(shapes: Shapes, index: NDArray[np.intp], easing: float) -> Array:
    """Return how far jumps of the curvature are eased to either side [m], shape (k,).

    At most half of each shape, and so that the path moves by no more than `easing` [m].
    """
    limit = 0.5 * np.minimum(shapes.length[index], shapes.length[index + 1])
    found = np.sqrt(easing / (_EASE_MOST * _jump(shapes, index)))
    found = np.minimum(np.minimum(found, limit), _bend_limit(shapes, index))
    return _whole_halves(found, shapes, index)


def _rounded(
    shapes: Shapes, index: NDArray[np.intp], turn: Array, reach: Array, pieces: int
) -> _Rounding:
    """Return the pieces of roundings that reach by `reach` (k,) [m] to either side."""
    share = _SHARES[pieces]
    first, second = _control_shares(turn, pieces)
    height = np.zeros((len(index), 6))
    height[:, 0], height[:, 1], height[:, 2] = 1.0, 1.0 - first, 1.0 - second
    size = reach[:, np.newaxis]
    one, slope, bow = (size * values for values in _bernstein_values(height, share))
    other, other_slope, other_bow = (
        size * values for values in _bernstein_values(height, 1 - share)
    )
    place, rate, gain = other - one, -other_slope - slope, other_bow - bow
    ahead = np.broadcast_to(share > 0.5, place.shape)
    part = [
        np.where(ahead, *values)[..., np.newaxis]
        for values in ((one, other), (slope, -other_slope), (bow, other_bow))
    ]
    base = _beside(shapes, index, place, ahead)
    before = shapes.frame(index, shapes.length[index])
    after = shapes.frame(index + 1, np.zeros(len(index)))
    kink = (after.tangent - before.tangent)[:, np.newaxis]
    ease = [
        values[..., np.newaxis] * (after.bend - before.bend)[:, np.newaxis]
        for values in _ease(place, size)
    ]
    rate, gain = rate[..., np.newaxis], gain[..., np.newaxis]
    point = base.point + kink * part[0] + ease[0]
    velocity = (base.tangent + ease[1]) * rate + kink * part[1]
    bend = (base.bend + ease[2]) * (rate * rate) + (base.tangent + ease[1]) * gain + kink * part[2]
    speed = vector_lengths(velocity)[..., np.newaxis]
    tangent = velocity / speed
    bend = (bend - dot_products(bend, tangent)[..., np.newaxis] * tangent) / (speed * speed)
    for at in (0, -1):  # where the path goes on, to the last digit
        point[:, at], tangent[:, at] = base.point[:, at], base.tangent[:, at]
        bend[:, at] = base.bend[:, at]
    coefficient, length = _pieces(point, tangent, bend)
    return _Rounding(coefficient, length, vector_lengths(bend), point, place)


def _pieces(point: Array, tangent: Array, bend: Array) -> tuple[Array, Array]:
    """Return quintics through nodes (k, n + 1, 3), and their lengths (k, n)."""
    chord = vector_lengths(np.diff(point, axis=1))
    curvature = vector_lengths(bend)
    half = np.minimum(0.25 * chord * (curvature[:, :-1] + curvature[:, 1:]), 1.0)
    length = chord * (1.0 + half * half / 6.0)
    weight = bernstein(4, 0.5 * (1.0 + _NODE))
    for _ in range(2):  # the length of a quintic hardly depends on the one it is made with
        coefficient = _between(point, tangent, bend, length)
        velocity = 5.0 * np.einsum('gb,knbd->kngd', weight, np.diff(coefficient, axis=2))
        length = portable.matmul(0.5 * vector_lengths(velocity), _WEIGHT)
    return _between(point, tangent, bend, length), length


def _between(point: Array, tangent: Array, bend: Array, length: Array) -> Array:
    """Return quintics between nodes in rows (k, n + 1, 3), shape (k, n, 6, 3)."""
    rows, nodes, _ = point.shape
    # All rows in one go; the pieces from one row to the next are dropped.
    span = np.concatenate([length, np.ones((rows, 1))], axis=1).ravel()[:-1]
    found = hermite(point.reshape(-1, 3), tangent.reshape(-1, 3), bend.reshape(-1, 3), span)
    found = np.concatenate([found, found[-1:]]).reshape(rows, nodes, 6, 3)
    return np.asarray(found[:, :-1])


def _distance_bound(shapes: Shapes, index: NDArray[np.intp], made: _Rounding) -> Array:
    """Return bounds on the distance of roundings from the path beside them [m], shape (k,)."""
    middle = made.coefficient.shape[1] // 2
    found = np.zeros(len(index))
    for side, columns in ((0, slice(0, middle + 1)), (1, slice(middle, None))):
        node, place = made.node[:, columns], made.place[:, columns]
        ahead = np.full(place.shape, bool(side))
        for _ in range(2):  # towards the nearest points of the path, on this side
            base = _beside(shapes, index, place, ahead)
            place = place + dot_products(node - base.point, base.tangent)
            place = np.maximum(place, 0.0) if side else np.minimum(place, 0.0)
            place = np.maximum.accumulate(place, axis=1)
        base = _beside(shapes, index, place, ahead)
        path = _between(base.point, base.tangent, base.bend, np.diff(place, axis=1))
        pieces = slice(0, middle) if side == 0 else slice(middle, None)
        # Beside a cusp the bend has no bound: what no number holds is beyond each tolerance.
        with np.errstate(over='ignore'):
            away = vector_lengths(made.coefficient[:, pieces] - path)
        found = np.maximum(found, away.max(axis=(1, 2)))
    return found


def _beside(
    shapes: Shapes, index: NDArray[np.intp], place: Array, ahead: NDArray[np.bool_]
) -> Frame:
    """Return the path at distances `place` (k, n) from junctions, on the sides that are said."""
    row = np.broadcast_to(index[:, np.newaxis], place.shape) + ahead
    along = np.where(ahead, place, shapes.length[row] + place).ravel()
    found = shapes.frame(row.ravel(), np.clip(along, 0.0, shapes.length[row].ravel()))
    return Frame(
        *(values.reshape(*place.shape, 3) for values in (found.point, found.tangent, found.bend))
    )


def _whole_halves(reach: Array, shapes: Shapes, index: NDArray[np.intp]) -> Array:
    """Return reaches that leave no sliver of a shape: half of it, or clearly less."""
    half = 0.5 * np.stack([shapes.length[index], shapes.length[index + 1]])
    sliver = (reach > _CLEAR * half) & (reach < half * (1.0 - 1e-12))
    return np.where(sliver.any(axis=0), _CLEAR * half.min(axis=0), reach)


def _bend_limit(shapes: Shapes, index: NDArray[np.intp]) -> Array:
    """Return how far the path may be taken as hardly bent on both sides [m], shape (k,)."""
    found = np.full(len(index), np.inf)
    for row, back in ((index, True), (index + 1, False)):
        length = shapes.length[row]
        for share in (0.0, 0.25, 0.5):
            place = length * (1.0 - share) if back else length * share
            curvature = shapes.frame(row, place).curvature
            found = np.minimum(found, _BEND / np.maximum(curvature, 1e-30))
        for k in np.flatnonzero(shapes.kind[row] == CURVE).tolist():
            # No farther than a few nodes of the curve: between them it is known to be calm.
            node = shapes.curve[row[k]].place
            few = min(4, len(node) - 1)
            found[k] = min(found[k], node[-1] - node[-1 - few] if back else node[few])
    return found


def _jump(shapes: Shapes, index: NDArray[np.intp]) -> Array:
    """Return the jumps of the curvature vector at junctions [1/m], shape (k,)."""
    before = shapes.frame(index, shapes.length[index])
    after = shapes.frame(index + 1, np.zeros(len(index)))
    return np.asarray(vector_lengths(after.bend - before.bend))


def _ease(place: Array, reach: Array) -> tuple[Array, Array, Array]:
    """Return l^2 e(s / l) and its first two derivatives by s, each (k, n)."""
    share = np.minimum(np.abs(place) / reach, 1.0)
    powers = range(1, 6)
    of_share, of_reach = portable.whole_powers(share, 5), portable.whole_powers(reach, 2)
    found = []
    factor = _EASE
    for order in range(3):
        term = [c * of_share[..., max(p - order, 0)] for c, p in zip(factor, powers, strict=True)]
        found.append(np.sum(term, axis=0) * of_reach[..., 2 - order])
        factor = factor * np.array([max(p - order, 0) for p in powers])
    sign = np.where(place > 0.0, 1.0, -1.0)
    return found[0] * sign, found[1], found[2] * sign


def _bernstein_values(coefficient: Array, share: Array) -> list[Array]:
    """Return polynomials (k, 6) and their first two derivatives at shares (n,), each (k, n)."""
    found, degree, factor = [], 5, 1.0
    for _ in range(3):
        found.append(portable.matmul(factor * coefficient, bernstein(degree, share).T))
        coefficient, factor, degree = np.diff(coefficient, axis=1), factor * degree, degree - 1
    return found


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
class _Pieces:
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


def _assemble(shapes: Shapes, head: float, blend: float, easing: float, *, last: bool) -> _Pieces:
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
    corner = turn > SMOOTH_TURN
    blended = corner & ~halt & (blend > 0.0) & (turn <= REVERSAL_ANGLE)
    jump = vector_lengths(after.bend - before.bend)
    eased = ~corner & ~halt & (jump > _JUMP)
    reach = np.zeros(len(joint))
    straight = (shapes.kind[:-1] == LINE) & (shapes.kind[1:] == LINE)
    count = np.where(blended, _pieces_of(turn, straight), 0)
    count[eased] = _EASING_PIECES
    for pieces in np.unique(count[blended]).tolist():
        rows = np.flatnonzero(blended & (count == pieces))
        reach[rows] = _corner_reach(shapes, rows, turn[rows], blend, pieces)
    rows = np.flatnonzero(eased)
    reach[rows] = _ease_reach(shapes, rows, easing)
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
                made = _rounded(shapes, rows, turn[rows], reach[rows], pieces)
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
    return _Pieces(
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
    _, exponent = np.frexp(np.maximum(span, 1e-12) / (4.0 * _END))
    steps = (exponent - 1) // 2 + 1.0  # the whole part of the logarithm to the base 4, and one
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
    graded_near = np.minimum(near, _STEPS)  # of lines; curves have more nodes
    distance = np.where(near > 0, np.ldexp(_END, 2 * (graded_near.astype(np.intc) - 1)), 0.0)
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
    made: _Rounding, index: NDArray[np.intp], first: NDArray[np.intp], kink: bool
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


EASING = 1e-6
"""Largest shift of the path where only the curvature jumps, as from a line to an arc [m]."""

_GAP = 1e-9
"""Distance up to which two segments meet [m]."""
_SHORT = 2e-9
"""Segments up to this length are none: sums of relative moves are off by the last digits [m]."""


@dataclass(frozen=True, eq=False)
class ReferencePath:
    """One stretch of a path: m pieces between m + 1 nodes.

    Two stretches in a row share a node: the last of one and the first of the next have the same
    point, curvature, stop and rest.

    Attributes
    ----------
    geometry : PathGeometry
        The pieces, in X, Y and Z; its own arc length starts from 0, and its `stop` is that below
        but for both ends.
    place : float
        Arc length of the first node from the start of the whole path [m].
    curvature : array, shape (m + 1,)
        Curvature at the nodes, the larger one of both sides; 0 on lines [1/m].
    owner : array of int, shape (m,)
        Index of the segment that each piece belongs to, counted from the first ever pushed; of a
        blend the first half belongs to the segment before the corner.
    blend : array of bool, shape (m,)
        Pieces of blends of corners.
    feed : array, shape (m,)
        Programmed feed [m/s]; inf for rapids, and where the program gives none as length per
        time: the machine's own speed.
    stop : array of bool, shape (m + 1,)
        Exact stops; those at the ends of the whole path too.
    rest : array, shape (m + 1,)
        Programmed dwell at a stop [s], 0 elsewhere.
    """

    geometry: PathGeometry
    place: float
    curvature: Array
    owner: NDArray[np.intp]
    blend: NDArray[np.bool_]
    feed: Array
    stop: NDArray[np.bool_]
    rest: Array

    @property
    def arc_length(self) -> Array:
        """Arc length of the nodes from the start of the whole path, shape (m + 1,) [m]."""
        return self.place + self.geometry.node

    @classmethod
    def of_geometry(cls, geometry: PathGeometry, feed: float = math.inf) -> ReferencePath:
        """Return a whole path that rests at both ends and at its corners.

        Parameters
        ----------
        geometry : PathGeometry
            The path, in two axes or three.
        feed : float
            Programmed feed all along [m/s]; inf for none.
        """
        count = len(geometry.coefficient)
        bend = vector_lengths(geometry.derivative(2))
        stop = geometry.stop.copy()
        stop[[0, -1]] = True
        return cls(
            geometry,
            0.0,
            np.maximum(np.append(bend[:, 0], 0.0), np.append(0.0, bend[:, -1])),
            np.zeros(count, np.intp),
            np.zeros(count, bool),
            np.full(count, feed),
            stop,
            np.zeros(count + 1),
        )

    @classmethod
    def join(cls, parts: Sequence[ReferencePath]) -> ReferencePath:
        """Return one stretch of several in a row.

        Raises
        ------
        ValueError
            If there is none, or one does not begin where the one before ends.
        """
        if not parts:
            raise ValueError('parts: expected at least one, but found none')
        for before, after in pairwise(parts):
            end, begin = before.geometry.coefficient[-1, 5], after.geometry.coefficient[0, 0]
            if not np.array_equal(end, begin):
                raise ValueError(
                    f'parts: expected each to begin where the one before ends, {end} m, but '
                    f'found {begin} m'
                )
        first = parts[0].place
        node = [part.place - first + part.geometry.node[1:] for part in parts]
        stop = np.concatenate([parts[0].stop[:1], *(part.stop[1:] for part in parts)])
        return cls(
            PathGeometry(
                np.concatenate([part.geometry.coefficient for part in parts]),
                np.concatenate([[0.0], *node]),
                _inner(stop),
            ),
            first,
            np.concatenate([parts[0].curvature[:1], *(part.curvature[1:] for part in parts)]),
            np.concatenate([part.owner for part in parts]),
            np.concatenate([part.blend for part in parts]),
            np.concatenate([part.feed for part in parts]),
            stop,
            np.concatenate([parts[0].rest[:1], *(part.rest[1:] for part in parts)]),
        )


class PathBuilder:
    r"""Builds the reference path of segments that arrive in parts, in bounded memory.

    Tangents that go on are no corners; at the others the path stops, or is blended where
    `blend` allows it and the turn is no reversal.  Between rapids and feeds, at dwells and where
    it is asked for the path stops.

    Parameters
    ----------
    blend : float
        Largest distance of a corner's blend from the programmed path [m]; 0 for exact stops.

    Raises
    ------
    ValueError
        If `blend` is negative or not finite.

    Notes
    -----
    Where the tangent goes on but the curvature jumps, the curvature goes from one to the other
    within a short stretch on each side, which moves the path by no more than `EASING`, and no
    more than `blend` if that is above 0.

    Examples
    --------
    >>> from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
    >>> segments = read_program('F600 G1 X1\nY1\n').segments
    >>> builder = PathBuilder()
    >>> parts = [builder.push(segments[:1]), builder.push(segments[1:]), builder.finish()]
    >>> [None if part is None else part.stop.tolist() for part in parts]
    [None, [True, True], [True, True]]
    """

    def __init__(self, *, blend: float = 0.0) -> None:
        if not 0.0 <= blend < math.inf:
            raise ValueError(
                f'blend: expected a distance of 0 m or more, but found {blend}; 0 stops at corners'
            )
        self.blend = float(blend)
        self._easing = min(EASING, blend) if blend > 0.0 else EASING
        self._count = 0
        self._kept: Shapes | None = None  # the last one, whose end is not known yet
        self._head = 0.0  # how much of it has left with the junction before it [m]
        self._place = Fraction()
        self._halt, self._rest = True, 0.0  # asked for since the last segment that moves
        # Curvature, stop and rest of the last node that has left, and its point.
        self._first: tuple[float, bool, float] = (0.0, True, 0.0)
        self._point: Array | None = None
        self._end: tuple[int, tuple[float, float, float]] | None = None
        self._finished = False

    def push(
        self, segments: Iterable[Segment], exact_stop: Iterable[bool] | None = None
    ) -> ReferencePath | None:
        """Add segments, and return what of the path is final with them.

        Parameters
        ----------
        segments : iterable of Segment
            The next ones; those without a length add nothing but count as owners.
        exact_stop : iterable of bool, optional
            Whether to stop at the end of each, whatever comes next.

        Returns
        -------
        ReferencePath or None
            The next stretch, up to where the last segment begins; None where nothing is final.

        Raises
        ------
        ValueError
            If a segment does not begin where the one before ends, a number is not finite, the
            flags are not one for each segment, or the path is finished.  Nothing is added then.
        """
        if self._finished:
            raise ValueError('expected no more segments, but found some after finish()')
        given = list(segments)
        flags = np.zeros(len(given), bool)
        if exact_stop is not None:
            flags = np.array(list(exact_stop), dtype=bool)
            if len(flags) != len(given):
                raise ValueError(
                    f'exact_stop: expected {len(given)} flags, one for each segment, but found '
                    f'{len(flags)}'
                )
        index, end = self._checked(given)
        dwell = np.array(
            [k for k, one in enumerate(given) if isinstance(one, DwellSegment)], dtype=np.intp
        )
        duration = np.array([given[k].duration for k in dwell.tolist()])
        if not ((duration >= 0.0) & (duration < np.inf)).all():
            at = int(np.argmin((duration >= 0.0) & (duration < np.inf)))
            raise ValueError(
                f'line {given[dwell[at]].line}: expected a dwell of 0 s or more, but found '
                f'{duration[at]}'
            )
        # What is asked for between two segments that move belongs to the later of them.
        slots = len(index) + 1
        rest: Array = np.zeros(slots)
        np.add.at(rest, np.searchsorted(index, dwell), duration)
        rest[0] += self._rest
        halt = np.zeros(slots, bool)
        halt[np.searchsorted(index, dwell)] = True
        halt[np.searchsorted(index, np.flatnonzero(flags), 'right')] = True
        halt[0] |= self._halt
        part = None
        if len(index):
            before = None if self._kept is None else self._kept.end[0]
            moving = [given[k] for k in index.tolist()]
            new = make_shapes(moving, self._count + index, before, halt[:-1], rest[:-1])
            if self._kept is None:
                self._first = (0.0, True, float(new.rest[0]))
            part = self._leave(new.behind(self._kept), last=False)
        self._halt, self._rest = bool(halt[-1]), float(rest[-1])
        self._count += len(given)
        self._end = end
        return part

    @property
    def moved(self) -> bool:
        """True if a segment has moved so far."""
        return self._kept is not None

    def finish(self) -> ReferencePath | None:
        """End the path, and return what is left of it.

        Returns
        -------
        ReferencePath or None
            The last stretch; None if it has been returned already.

        Raises
        ------
        ValueError
            If no segment has moved.
        """
        if self._finished:
            return None
        if self._kept is None:
            raise ValueError('expected segments that move, but found none')
        part = self._leave(self._kept, last=True)
        self._finished, self._kept = True, None
        return part

    def _leave(self, shapes: Shapes, *, last: bool) -> ReferencePath | None:
        """Return the pieces up to the last shape, or to the end, and keep the rest."""
        pieces = _assemble(shapes, self._head, self.blend, self._easing, last=last)
        found = self._path(pieces, last) if len(pieces.length) else None
        if found is not None:
            self._place += Fraction(found.geometry.length)
            self._first = (
                float(found.curvature[-1]),
                bool(found.stop[-1]),
                float(found.rest[-1]),
            )
            self._point = found.geometry.coefficient[-1, 5].copy()
        self._kept, self._head = shapes.last(), pieces.head
        return found

    def _path(self, pieces: _Pieces, last: bool) -> ReferencePath:
        coefficient, curvature = pieces.coefficient, pieces.curvature
        stop, rest = pieces.stop, pieces.rest
        # Neighbours have computed the same point each: what is left of the digits would be a gap.
        coefficient[1:, 0] = coefficient[:-1, 5]
        if self._point is not None:
            coefficient[0, 0] = self._point
        curvature[0] = max(curvature[0], self._first[0])
        stop[0], rest[0] = self._first[1:]
        if last:
            stop[-1], rest[-1] = True, self._rest
        return ReferencePath(
            PathGeometry(coefficient, _running_sums(pieces.length), _inner(stop)),
            float(self._place),
            curvature,
            pieces.owner,
            pieces.blend,
            pieces.feed,
            stop,
            rest,
        )

    def _checked(
        self, given: Sequence[Segment]
    ) -> tuple[NDArray[np.intp], tuple[int, tuple[float, float, float]] | None]:
        """Return which segments move, and the line and the end of the last that has a place."""
        placed = [k for k, one in enumerate(given) if not isinstance(one, DwellSegment)]
        if not placed:
            return np.zeros(0, dtype=np.intp), self._end
        start = np.array([given[k].start for k in placed], dtype=float)
        end = np.array([given[k].end for k in placed], dtype=float)
        length = np.array([given[k].length for k in placed])
        good = np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1) & np.isfinite(length)
        if not good.all():
            at = int(np.argmin(good))
            raise ValueError(
                f'line {given[placed[at]].line}: expected finite numbers, but found a segment '
                f'from {start[at]} m to {end[at]} m'
            )
        line = [given[k].line for k in placed]
        before = np.concatenate([start[:1] if self._end is None else [self._end[1]], end[:-1]])
        gap = vector_lengths(start - before)
        if (gap > _GAP).any():
            at = int(np.argmax(gap > _GAP))
            former = line[at - 1] if at or self._end is None else self._end[0]
            raise ValueError(
                f'segments: expected each to begin where the one before ends, but found a gap of '
                f'{1e3 * gap[at]:.6g} mm between line {former} and line {line[at]}; put a line '
                'or a rapid between them'
            )
        moving = np.array(placed, dtype=np.intp)[length > _SHORT]
        return moving, (line[-1], given[placed[-1]].end)


def smooth_geometry(curve: NurbsCurve) -> PathGeometry:
    """Return a curve as smooth pieces, with a stop wherever it turns on the spot.

    Parameters
    ----------
    curve : NurbsCurve
        In the plane or in space.
    """
    missing = 3 - curve.dimension
    space = NurbsCurve(
        np.pad(curve.control, ((0, 0), (0, missing))), curve.weight, curve.knot, curve.degree
    )
    first, last = (tuple(space.point(u).tolist()) for u in space.domain)
    builder = PathBuilder()
    segment = NurbsSegment(1, first, last, None, False, False, 0, space, 1)
    parts = [builder.push([segment]), builder.finish()]
    geometry = ReferencePath.join([part for part in parts if part is not None]).geometry
    axes = slice(0, curve.dimension)
    return PathGeometry(geometry.coefficient[:, :, axes], geometry.node, geometry.stop)


def _running_sums(length: Array) -> Array:
    """Return the sums of the first 0..m lengths, shape (m + 1,), rounded once each [m].

    Those of parts and of the whole then agree to the last digits.  What is summed are whole
    numbers, of units of the last digit of the total and of 2^-40 of these.
    """
    power = int(np.frexp(length.sum())[1]) - 52
    whole = np.floor(np.ldexp(length, -power))
    rest = np.floor(np.ldexp(length - np.ldexp(whole, power), 40 - power))
    units, parts = (np.append(0, np.cumsum(one.astype(np.int64))) for one in (whole, rest))
    units += parts >> 40
    parts &= (1 << 40) - 1
    return np.asarray(
        np.ldexp(units.astype(float), power) + np.ldexp(parts.astype(float), power - 40)
    )


def _inner(stop: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return stops without both ends."""
    found = stop.copy()
    found[[0, -1]] = False
    return found
