# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rounding of junctions: blends of corners, and easing of jumps of the curvature.

Let T0 and T1 be the directions before and after a corner, K0 and K1 the curvature vectors, l the
reach to either side and p(s) the programmed path at distance s from the corner.  The blend is

    q(t) = p(s(t)) + l (T1 - T0) g(t) + l^2 (K1 - K0) e(s(t) / l),    0 <= t <= 1,
    s(t) = l (f(1 - t) - f(t)),   g(t) = min(f(t), f(1 - t))

with f a quintic that falls from 1 to 0 and has three zeros at t = 1.  Between lines this is the
quintic whose control points lie on them.  For any curves the corrections vanish to the second
derivative at both ends, and the jumps of p' and p'' in the middle are cancelled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.path_geometry import bernstein, hermite
from fuzzycnc_ros.core.feedrate.path.shapes import CURVE, LINE, Frame, Shapes

_TINY = 0.1
"""Turn of a corner up to which its blend has two pieces [rad]."""
_FEW = 0.5
"""The same for four pieces [rad]."""
_EIGHT = 1.6
"""The same for eight pieces [rad]."""
EASING_PIECES = 6
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
class Rounding:
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


def pieces_of(turn: Array, straight: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the number of pieces of corners, by their turn [rad] and whether between lines."""
    found = np.where(turn <= _EIGHT, 8, 12)
    found = np.where(turn <= np.where(straight, _FEW, 0.0), 4, found)
    return np.asarray(np.where(turn <= _TINY, np.where(straight, 2, 6), found), dtype=np.intp)


def control_shares(turn: Array, pieces: int) -> tuple[Array, Array]:
    """Return how far along each side the second and third control point lie, each (k,).

    The curvature is the flatter the nearer the second one is to the first, and rises the steeper.
    The values keep the largest one within a few per cent of the least possible for a deviation.
    """
    if pieces in (2, 6):
        first, second = _TWO_PIECES if pieces == 2 else _UNIFORM
        return np.full(len(turn), first), np.full(len(turn), second)
    square = turn**2
    return 0.28 - 0.02 * square, 0.72 - 0.034 * square - 0.003 * square**2


def line_reach(turn: Array, tolerance: float, pieces: int) -> Array:
    """Return the reach at which blends of lines are `tolerance` from them [m], shape (k,)."""
    first, second = control_shares(turn, pieces)
    middle = (1.0 + 5.0 * (1.0 - first) + 10.0 * (1.0 - second)) / 32.0
    return np.asarray((1.0 - 1e-9) * tolerance / (middle * np.sin(turn)))


def corner_reach(
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
    reach = _whole_halves(np.minimum(line_reach(turn, tolerance, pieces), limit), shapes, index)
    bent = np.flatnonzero((shapes.kind[index] != LINE) | (shapes.kind[index + 1] != LINE))
    if not len(bent):
        return reach
    found = np.minimum(reach[bent], _bend_limit(shapes, index[bent]))
    jump = _jump(shapes, index[bent])
    found = np.minimum(found, np.sqrt(2.0 * tolerance / (_EASE_MOST * jump + 1e-30)))
    todo = np.arange(len(bent))
    for _ in range(_ROUNDS):
        at = index[bent[todo]]
        made = rounded(shapes, at, turn[bent[todo]], found[todo], pieces)
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


def ease_reach(shapes: Shapes, index: NDArray[np.intp], easing: float) -> Array:
    """Return how far jumps of the curvature are eased to either side [m], shape (k,).

    At most half of each shape, and so that the path moves by no more than `easing` [m].
    """
    limit = 0.5 * np.minimum(shapes.length[index], shapes.length[index + 1])
    found = np.sqrt(easing / (_EASE_MOST * _jump(shapes, index)))
    found = np.minimum(np.minimum(found, limit), _bend_limit(shapes, index))
    return _whole_halves(found, shapes, index)


def rounded(
    shapes: Shapes, index: NDArray[np.intp], turn: Array, reach: Array, pieces: int
) -> Rounding:
    """Return the pieces of roundings that reach by `reach` (k,) [m] to either side."""
    share = _SHARES[pieces]
    first, second = control_shares(turn, pieces)
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
    bend = (base.bend + ease[2]) * rate**2 + (base.tangent + ease[1]) * gain + kink * part[2]
    speed = np.linalg.norm(velocity, axis=2, keepdims=True)
    tangent = velocity / speed
    bend = (bend - (bend * tangent).sum(axis=2, keepdims=True) * tangent) / speed**2
    for at in (0, -1):  # where the path goes on, to the last digit
        point[:, at], tangent[:, at] = base.point[:, at], base.tangent[:, at]
        bend[:, at] = base.bend[:, at]
    coefficient, length = _pieces(point, tangent, bend)
    return Rounding(coefficient, length, np.linalg.norm(bend, axis=2), point, place)


def _pieces(point: Array, tangent: Array, bend: Array) -> tuple[Array, Array]:
    """Return quintics through nodes (k, n + 1, 3), and their lengths (k, n)."""
    chord = np.linalg.norm(np.diff(point, axis=1), axis=2)
    curvature = np.linalg.norm(bend, axis=2)
    half = np.minimum(0.25 * chord * (curvature[:, :-1] + curvature[:, 1:]), 1.0)
    length = chord * (1.0 + half**2 / 6.0)
    weight = bernstein(4, 0.5 * (1.0 + _NODE))
    for _ in range(2):  # the length of a quintic hardly depends on the one it is made with
        coefficient = _between(point, tangent, bend, length)
        velocity = 5.0 * np.einsum('gb,knbd->kngd', weight, np.diff(coefficient, axis=2))
        length = 0.5 * np.linalg.norm(velocity, axis=3) @ _WEIGHT
    return _between(point, tangent, bend, length), length


def _between(point: Array, tangent: Array, bend: Array, length: Array) -> Array:
    """Return quintics between nodes in rows (k, n + 1, 3), shape (k, n, 6, 3)."""
    rows, nodes, _ = point.shape
    # All rows in one go; the pieces from one row to the next are dropped.
    span = np.concatenate([length, np.ones((rows, 1))], axis=1).ravel()[:-1]
    found = hermite(point.reshape(-1, 3), tangent.reshape(-1, 3), bend.reshape(-1, 3), span)
    found = np.concatenate([found, found[-1:]]).reshape(rows, nodes, 6, 3)
    return np.asarray(found[:, :-1])


def _distance_bound(shapes: Shapes, index: NDArray[np.intp], made: Rounding) -> Array:
    """Return bounds on the distance of roundings from the path beside them [m], shape (k,)."""
    middle = made.coefficient.shape[1] // 2
    found = np.zeros(len(index))
    for side, columns in ((0, slice(0, middle + 1)), (1, slice(middle, None))):
        node, place = made.node[:, columns], made.place[:, columns]
        ahead = np.full(place.shape, bool(side))
        for _ in range(2):  # towards the nearest points of the path, on this side
            base = _beside(shapes, index, place, ahead)
            place = place + ((node - base.point) * base.tangent).sum(axis=2)
            place = np.maximum(place, 0.0) if side else np.minimum(place, 0.0)
            place = np.maximum.accumulate(place, axis=1)
        base = _beside(shapes, index, place, ahead)
        path = _between(base.point, base.tangent, base.bend, np.diff(place, axis=1))
        pieces = slice(0, middle) if side == 0 else slice(middle, None)
        away = np.linalg.norm(made.coefficient[:, pieces] - path, axis=3)
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
    return np.asarray(np.linalg.norm(after.bend - before.bend, axis=1))


def _ease(place: Array, reach: Array) -> tuple[Array, Array, Array]:
    """Return l^2 e(s / l) and its first two derivatives by s, each (k, n)."""
    share = np.minimum(np.abs(place) / reach, 1.0)
    powers = np.arange(1, 6)
    found = []
    factor = _EASE
    for order in range(3):
        term = [c * share ** max(p - order, 0) for c, p in zip(factor, powers, strict=True)]
        found.append(np.sum(term, axis=0) * reach ** (2 - order))
        factor = factor * np.maximum(powers - order, 0)
    sign = np.where(place > 0.0, 1.0, -1.0)
    return found[0] * sign, found[1], found[2] * sign


def _bernstein_values(coefficient: Array, share: Array) -> list[Array]:
    """Return polynomials (k, 6) and their first two derivatives at shares (n,), each (k, n)."""
    found, degree, factor = [], 5, 1.0
    for _ in range(3):
        found.append(factor * coefficient @ bernstein(degree, share).T)
        coefficient, factor, degree = np.diff(coefficient, axis=1), factor * degree, degree - 1
    return found
