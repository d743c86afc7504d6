# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""NURBS curves of a reference path: cut where they are not smooth, with nodes where they bend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.segments import NurbsSegment
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.core.feedrate.path.path_geometry import (
    SMOOTH_TURN,
    bernstein,
    hermite,
    turn_angles,
)

TURN = 0.1
"""Largest turn of a piece [rad]."""

_OFF = 2e-10
"""Largest distance of a piece from its curve at the places tried [m]."""
_SWELL = 1.02
"""Largest curvature inside a piece, as a multiple of that at its ends [-]."""
_FLAT = 1e-4
"""Turn of a piece below which its curvature does not matter [rad]."""
_TRIED = np.array([0.25, 0.5, 0.75])
_ROUNDS = 40
_LEAST = 1e-7
"""Pieces shorter than this share of the stretch are not cut."""
_JUMP = 1e-6
"""Jump of the curvature at a knot that cuts a curve, as a share of the curvature there [-]."""
_ASIDE = 1e-6
"""Share of a stretch at which a point without a direction takes the one of its neighbour."""


@dataclass(frozen=True)
class CurveStretch:
    """Smooth part of a curve.

    Attributes
    ----------
    curve : NurbsCurve
        The whole curve.
    low, high : float
        Parameters of the stretch.
    offset : float
        Arc length of the curve before it [m].
    shift : array, shape (3,)
        What its start is off the end of what came before; it fades along the stretch [m].
    place : array, shape (n,)
        Arc lengths at which it has nodes, first 0 and last `length` [m].
    node : array, shape (n,)
        Parameters there.
    """

    curve: NurbsCurve
    low: float
    high: float
    offset: float
    shift: Array
    place: Array
    node: Array

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self.place[-1])

    @property
    def end(self) -> Array:
        """Last point, shape (3,) [m]."""
        return self.curve.point(self.high)

    def frame(self, place: Array) -> tuple[Array, Array, Array]:
        """Return points, tangents and curvature vectors at arc lengths (k,), each (k, 3)."""
        point, tangent, bend = _frames(self.curve, self._parameter(place), self.low, self.high)
        fade = 1.0 - place / self.length
        return point + fade[:, np.newaxis] * self.shift, tangent, bend

    def _parameter(self, place: Array) -> Array:
        """Return the parameters at arc lengths: from those of the nodes beside them by Newton."""
        found = np.asarray(np.interp(place, self.place, self.node))
        between = np.flatnonzero(~np.isin(place, self.place))
        for _ in range(3 if len(between) else 0):
            at = found[between]
            excess = self.curve.arc_length(at) - self.offset - place[between]
            speed = np.linalg.norm(self.curve.derivative(at), axis=1)
            step = excess / np.maximum(speed, 1e-30)
            row = np.clip(np.searchsorted(self.place, place[between]), 1, len(self.node) - 1)
            found[between] = np.clip(at - step, self.node[row - 1], self.node[row])
        return found


def curve_stretches(segment: NurbsSegment, start: Array) -> list[CurveStretch]:
    """Return the smooth stretches of a segment that begins at `start`, shape (3,) [m].

    Raises
    ------
    ValueError
        If the curve is not in space.
    """
    curve = segment.curve
    if curve.dimension != 3:
        raise ValueError(
            f'line {segment.line}: expected a curve in X, Y and Z, but found one of '
            f'{curve.dimension} coordinates; give its points a Z'
        )
    edges = _edges(curve)
    shift = start - curve.point(curve.domain[0])
    found = []
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        offset = float(curve.arc_length(low))
        place = _nodes(curve, low, high)
        node = np.clip(curve.parameter(np.clip(place, 0.0, curve.length)), low, high)
        node[[0, -1]] = low, high
        found.append(CurveStretch(curve, low, high, offset, shift, place - offset, node))
        shift = np.zeros(3)
    return found


def _frames(curve: NurbsCurve, u: Array, low: float, high: float) -> tuple[Array, Array, Array]:
    """Return points, tangents and curvature vectors within a stretch, each (k, 3).

    At both ends they are the limits from inside.  Where the derivative vanishes, direction and
    curvature are those a little farther inside.
    """
    inside = np.clip(u, low, np.nextafter(high, low))
    point = curve.point(np.clip(u, low, high))
    first, second = curve.derivative(inside, 1), curve.derivative(inside, 2)
    speed = np.linalg.norm(first, axis=1)
    mean = curve.length / (curve.domain[1] - curve.domain[0])
    still = np.flatnonzero(speed <= _ASIDE * mean)
    if len(still):
        away = np.where(inside[still] < 0.5 * (low + high), 1.0, -1.0) * (high - low) * 1e-3
        first[still] = curve.derivative(inside[still] + away, 1)
        second[still] = curve.derivative(inside[still] + away, 2)
        speed[still] = np.linalg.norm(first[still], axis=1)
    tangent = first / speed[:, np.newaxis]
    along = (second * tangent).sum(axis=1, keepdims=True)
    return point, tangent, (second - along * tangent) / speed[:, np.newaxis] ** 2


def _edges(curve: NurbsCurve) -> Array:
    """Return the parameters between which the curve is smooth, both ends of it included."""
    first, last = curve.domain
    knot, times = np.unique(curve.knot, return_counts=True)
    inner = knot[(knot > first) & (knot < last) & (times >= curve.degree - 1)]
    if not len(inner):
        return np.array([first, last])
    _, before, bend = _frames(curve, inner, first, last)
    left = [_frames(curve, np.array([u]), first, u) for u in inner.tolist()]
    ahead, behind = before, np.concatenate([one[1] for one in left])
    jump = np.linalg.norm(bend - np.concatenate([one[2] for one in left]), axis=1)
    size = np.linalg.norm(bend, axis=1)
    rough = (turn_angles(behind, ahead) > SMOOTH_TURN) | (jump > _JUMP * size + 1e-9)
    return np.concatenate([[first], inner[rough], [last]])


def _nodes(curve: NurbsCurve, low: float, high: float) -> Array:
    """Return arc lengths of the curve at which a stretch needs nodes, its ends included."""
    knot = np.unique(curve.knot)
    u = np.concatenate([[low], knot[(knot > low) & (knot < high)], [high]])
    node = curve.arc_length(u)
    whole = node[-1] - node[0]
    settled = np.zeros(len(node) - 1, bool)
    for _ in range(_ROUNDS):
        todo = np.flatnonzero(~settled)
        if not len(todo):
            break
        length = node[todo + 1] - node[todo]
        count = _pieces_needed(curve, node[todo], node[todo + 1], low, high)
        count[length <= _LEAST * whole] = 1
        pieces = np.ones(len(settled), dtype=np.intp)
        pieces[todo] = count
        settled = np.repeat(pieces == 1, pieces)
        row = np.repeat(np.arange(len(pieces)), pieces)
        step = np.arange(len(row)) - np.append(0, np.cumsum(pieces))[row]
        span = np.diff(node)
        node = np.append(node[row] + span[row] * (step / pieces[row]), node[-1])
    return np.asarray(node)


def _pieces_needed(curve: NurbsCurve, begin: Array, end: Array, low: float, high: float) -> Array:
    """Return into how many pieces each piece should be cut; 1 where it is good, shape (k,)."""
    share = np.concatenate([[0.0], _TRIED, [1.0]])
    place = begin[:, np.newaxis] + (end - begin)[:, np.newaxis] * share
    u = curve.parameter(np.clip(place, 0.0, curve.length).ravel())
    point, tangent, bend = (
        values.reshape(*place.shape, 3) for values in _frames(curve, u, low, high)
    )
    length = end - begin
    piece = hermite(
        point[:, [0, -1]].reshape(-1, 3),
        tangent[:, [0, -1]].reshape(-1, 3),
        bend[:, [0, -1]].reshape(-1, 3),
        np.repeat(length, 2)[:-1],
    )[::2]
    found = np.einsum('kb,mbd->mkd', bernstein(5, _TRIED), piece)
    off = np.linalg.norm(found - point[:, 1:-1], axis=2).max(axis=1)
    curvature = np.linalg.norm(bend, axis=2)
    inner = curvature.max(axis=1)
    ends = np.maximum(curvature[:, 0], curvature[:, -1])
    turn = inner * length
    count = np.maximum(np.ceil(turn / TURN - 1e-9), np.ceil((off / _OFF) ** (1.0 / 6.0) - 1e-9))
    count = np.maximum(count, np.where((inner > _SWELL * ends) & (turn > _FLAT), 2.0, 1.0))
    return np.asarray(np.clip(count, 1.0, 8.0).astype(np.intp))
