# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes for the scheduling of a reference path: where feeds may change, and what counts for whom.

Feeds are asked for at nodes, and between two of them their square runs straight.  A long line
between two arcs has nodes at its ends only, where the arcs ask for slow feeds; so pieces get
further nodes near their ends, behind what the scheduler lets the neighbours reach.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array, dot_products
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry
from fuzzycnc_ros.core.feedrate.schedule.scheduler import Scheduler

_Bools = NDArray[np.bool_]

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.path.reference_path import ReferencePath

_EDGE_LEAST = 5e-5
"""Shortest distance of a new node from the end of a block [m]."""

_SPACING = 2e-4
"""Distance of nodes for rules that count points [m]: their windows were published for these."""

_NO_BEND = 1e-6
"""Curvature up to which a piece is straight [1/m]; rounding of doubles stays below."""

_POINTS_FEW = 5
"""Rules that look at no more points than this to a side do without even spacing."""


@dataclass(frozen=True)
class NodePlan:
    """Placement of nodes for a scheduler.

    Parameters
    ----------
    edge : float
        Up to this distance from a block's ends its neighbours' curvature counts [m]; infinite
        for rules that count points or link the whole path.
    near : float
        Up to this distance from a block's ends the feed may be lower because of its neighbours,
        to which it has to slow down [m].
    """

    edge: float
    near: float

    @classmethod
    def of(cls, scheduler: Scheduler) -> NodePlan:
        """Return the plan for a scheduler."""
        reach = scheduler.reach
        # What is taken from the whole path, or from far behind, is no bend of a neighbour's.
        most = max(reach.length_behind, reach.length_ahead)
        length = getattr(scheduler, 'guard_length', most)
        if max(reach.points_behind, reach.points_ahead) > _POINTS_FEW or not np.isfinite(length):
            return cls(np.inf, np.inf)
        edge = max(_EDGE_LEAST, 1.01 * length)
        return cls(edge, max(2.0 * edge, 1.01 * reach.length_ahead))

    @property
    def even(self) -> bool:
        """True if nodes lie at most `_SPACING` apart."""
        return not np.isfinite(self.edge)


def own_curvature(geometry: PathGeometry) -> Array:
    """Return the curvature at both ends of every piece as the piece itself has it, (m, 2)."""
    tangent, bend = geometry.end_derivatives()
    square = dot_products(tangent, tangent)
    along = dot_products(tangent, bend)
    across = np.maximum(dot_products(bend, bend) - along * along / square, 0.0)
    return np.asarray(np.sqrt(across) / square)


def with_nodes(path: ReferencePath, plan: NodePlan) -> ReferencePath:
    """Return the same path with the nodes that a scheduler needs."""
    length = np.diff(path.geometry.node)
    bent = own_curvature(path.geometry)
    path = replace(path, curvature=_raised(path.curvature, bent))
    if plan.even:
        count = np.maximum(np.ceil(length / _SPACING * (1.0 - 1e-12)), 1).astype(int)
        piece = np.repeat(np.arange(len(length)), count)
        first = np.append(0, np.cumsum(count))
        share = (np.arange(first[-1]) - first[piece]) / count[piece]
        return _cut(path, piece, share)
    boundary = np.concatenate([[True], _boundary(path), [True]])
    shares = [np.zeros(len(length))]
    for end, nodes in enumerate((slice(None, -1), slice(1, None))):
        foreign = path.curvature[nodes] > 1.001 * bent[:, end] + _NO_BEND
        wanted = foreign | (boundary[nodes] & ~path.stop[nodes])
        wanted &= ~path.blend & (length > 5.0 * plan.edge)
        for times in (1.0, 2.0):  # behind the second one not even the neighbour's node is near
            share = times * plan.edge / length
            shares.append(np.where(wanted, 1.0 - share if end else share, np.nan))
    return _cut(path, *_sorted(shares))


def with_ramps(
    path: ReferencePath, speed: Array, acceleration: float
) -> tuple[ReferencePath, Array]:
    """Return the same path with nodes where the motion has got going after a stop.

    Parameters
    ----------
    path : ReferencePath
        Path of m pieces.
    speed : ndarray, shape (m, 2)
        Speeds wanted at both ends of each piece [m/s].
    acceleration : float
        Along the path [m/s^2].

    Returns
    -------
    ReferencePath
        The path.
    ndarray, shape (k, 2)
        The speeds at the ends of its pieces [m/s].
    """
    length = np.diff(path.geometry.node)
    ramp = speed * speed / (2.0 * acceleration) / length[:, np.newaxis]
    ramp[(ramp > 0.25) | (ramp < 1e-6)] = np.nan  # others come out right without
    head = np.where(path.stop[:-1], ramp[:, 0], np.nan)
    tail = np.where(path.stop[1:], 1.0 - ramp[:, 1], np.nan)
    piece, share = _sorted([np.zeros(len(length)), head, tail])
    if len(piece) == len(length):
        return path, speed
    square = np.square(speed[piece])
    end = np.append(share[1:], 1.0)
    end[end == 0.0] = 1.0
    rise = square[:, 1] - square[:, 0]
    wanted = np.column_stack([square[:, 0] + rise * share, square[:, 0] + rise * end])
    return _cut(path, piece, share), np.sqrt(wanted)


def _cut(path: ReferencePath, piece: NDArray[np.intp], low: Array) -> ReferencePath:
    """Return the same path in other pieces.

    Parameters
    ----------
    path : ReferencePath
        Path of m pieces.
    piece : ndarray of int, shape (k,)
        Which of its pieces each of the new ones is of; none may be left out.
    low : ndarray, shape (k,)
        Share of that piece at which the new one begins, 0 for the first.
    """
    if len(piece) == len(path.owner):
        return path
    node = path.geometry.node
    high = np.append(low[1:], 1.0)
    high[high == 0.0] = 1.0
    coefficient = path.geometry.coefficient[piece]
    changed = (low > 0.0) | (high < 1.0)
    coefficient[changed] = _restricted(coefficient[changed], low[changed], high[changed])
    old = np.append(low == 0.0, True)
    at, share = piece[~old[:-1]], low[~old[:-1]]
    geometry = PathGeometry(coefficient, np.empty(len(old)), np.zeros(len(old), bool))
    place, curvature = geometry.node, np.empty(len(old))
    place[old] = node
    place[~old] = node[at] + np.diff(node)[at] * share
    curvature[:-1] = own_curvature(geometry)[:, 0]
    curvature[old] = path.curvature
    geometry.stop[old] = path.geometry.stop
    stop, rest = np.zeros(len(old), bool), np.zeros(len(old))
    stop[old], rest[old] = path.stop, path.rest
    return replace(
        path,
        geometry=geometry,
        curvature=curvature,
        owner=path.owner[piece],
        blend=path.blend[piece],
        feed=path.feed[piece],
        stop=stop,
        rest=rest,
    )


def near_neighbours(path: ReferencePath, own: Array, bend: Array, plan: NodePlan) -> _Bools:
    """Return on which pieces the neighbours of a block count for the feed, (m,).

    Parameters
    ----------
    path : ReferencePath
        Path of m pieces.
    own : ndarray, shape (m,)
        Curvature that each piece's block has by itself [1/m]; infinite where it varies.
    bend : ndarray, shape (m,)
        Curvature of each piece [1/m].  What is above its block's own comes from a neighbour, as
        where the curvature goes over from one to the other.
    plan : NodePlan
        How far neighbours count.  Where they have no definite reach, what lies within a quarter
        of the rest of the block of its ends is near.
    """
    foreign = path.blend | (bend > 1.001 * own + _NO_BEND)
    node = path.geometry.node
    change = (np.diff(path.owner) != 0) | (foreign[1:] != foreign[:-1])
    first = np.flatnonzero(np.append(True, change))
    count = np.diff(np.append(first, len(path.owner)))
    start, end = node[first], node[first + count]
    reach = 0.25 * (end - start) if plan.even else np.full(len(first), plan.near)
    reach *= 1.0 - 1e-9
    near = foreign | (np.repeat(start + reach, count) > node[:-1])
    return np.asarray(near | (np.repeat(end - reach, count) < node[1:]))


def _boundary(path: ReferencePath) -> NDArray[np.bool_]:
    """Return at which inner nodes a block or a blend begins, (m - 1,)."""
    return np.asarray((np.diff(path.owner) != 0) | (path.blend[1:] != path.blend[:-1]), dtype=bool)


def _raised(curvature: Array, bent: Array) -> Array:
    """Return curvatures at the nodes, at least half of those at the other ends of the pieces.

    Where the curvature rises from nothing within a piece, as at the start of a blend, its start
    would allow any feed, and half-way the squared feed would still be half of that.
    """
    found = curvature.copy()
    found[:-1] = np.maximum(found[:-1], 0.5 * bent[:, 1])
    found[1:] = np.maximum(found[1:], 0.5 * bent[:, 0])
    return found


def _sorted(shares: list[Array]) -> tuple[NDArray[np.intp], Array]:
    """Return the pieces after cutting at shares, NaN for none: by piece, and where they begin."""
    table = np.column_stack(shares)
    table.sort(axis=1)  # NaN last
    kept = ~np.isnan(table)
    return np.nonzero(kept)[0], table[kept]


def _restricted(coefficient: Array, low: Array, high: Array) -> Array:
    """Return the parts of Bernstein polynomials from shares `low` to `high`, (k, 6, d)."""
    found = coefficient.copy()
    t = high[:, np.newaxis, np.newaxis]
    for k in range(1, found.shape[1]):  # de Casteljau, the left part
        found[:, k:] = (1.0 - t) * found[:, k - 1 : -1] + t * found[:, k:]
    t = (low / high)[:, np.newaxis, np.newaxis]
    for k in range(found.shape[1] - 1, 0, -1):  # and of that the right one
        found[:, :k] = (1.0 - t) * found[:, :k] + t * found[:, 1 : k + 1]
    return found
