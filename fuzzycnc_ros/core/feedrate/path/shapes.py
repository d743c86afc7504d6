# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes of a reference path: lines, arcs and smooth curves by arc length, many at once.

NURBS curves are cut where they are not smooth, and have nodes where they bend.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array, dot_products, vector_lengths
from fuzzycnc_ros.core.feedrate.gcode.segments import ArcSegment, NurbsSegment, Segment
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
STILL_LENGTH = 2e-9
"""Length up to which a stretch is none [m], as with segments."""
_PROBES = 9
"""Places in a span of a curve at which its speed is looked at."""
_NARROWINGS = 60
_STEPS = 2
"""Newton's steps before the last one for a place of a curve that nowhere comes to rest."""
_CLOSE = 1e-9
"""Excess that one more of them makes none [m]."""
_ASIDE = 1e-6
"""Share of a stretch at which a point without a direction takes the one of its neighbour."""


@dataclass(frozen=True)
class _CurveStretch:
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
        todo = np.flatnonzero(~np.isin(place, self.place))
        for count in range(_NARROWINGS):
            if not len(todo):
                break
            at = found[todo]
            excess = self.curve.arc_length(at) - self.offset - place[todo]
            speed = vector_lengths(self.curve.derivative(at))
            step = excess / np.maximum(speed, 1e-30)
            row = np.clip(np.searchsorted(self.place, place[todo]), 1, len(self.node) - 1)
            found[todo] = np.clip(at - step, self.node[row - 1], self.node[row])
            if count >= _STEPS:  # beside equal control points each step only halves the excess
                todo = todo[np.abs(excess) > _CLOSE]
        return found


def _curve_stretches(segment: NurbsSegment, start: Array) -> list[_CurveStretch]:
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
    way = np.diff(curve.arc_length(edges))
    found: list[_CurveStretch] = []
    for low, high, length in zip(
        edges[:-1].tolist(), edges[1:].tolist(), way.tolist(), strict=True
    ):
        if length <= STILL_LENGTH:  # equal control points: the curve stands still
            continue
        shift = (found[-1].end if found else start) - curve.point(low)
        offset = float(curve.arc_length(low))
        place = _nodes(curve, low, high)
        node = np.clip(curve.parameter(np.clip(place, 0.0, curve.length)), low, high)
        node[[0, -1]] = low, high
        found.append(_CurveStretch(curve, low, high, offset, shift, place - offset, node))
    return found


def _frames(curve: NurbsCurve, u: Array, low: float, high: float) -> tuple[Array, Array, Array]:
    """Return points, tangents and curvature vectors within a stretch, each (k, 3).

    At both ends they are the limits from inside.  Where the derivative vanishes, direction and
    curvature are those a little farther inside.
    """
    inside = np.clip(u, low, np.nextafter(high, low))
    point = curve.point(np.clip(u, low, high))
    first, second = curve.derivative(inside, 1), curve.derivative(inside, 2)
    speed = vector_lengths(first)
    mean = curve.length / (curve.domain[1] - curve.domain[0])
    still = np.flatnonzero(speed <= _ASIDE * mean)
    if len(still):
        away = np.where(inside[still] < 0.5 * (low + high), 1.0, -1.0) * (high - low) * 1e-3
        first[still] = curve.derivative(inside[still] + away, 1)
        second[still] = curve.derivative(inside[still] + away, 2)
        speed[still] = vector_lengths(first[still])
    tangent = first / speed[:, np.newaxis]
    along = dot_products(second, tangent)[:, np.newaxis]
    return point, tangent, (second - along * tangent) / np.square(speed[:, np.newaxis])


def _edges(curve: NurbsCurve) -> Array:
    """Return the parameters between which the curve is smooth, both ends of it included.

    Where it stands still, of equal control points, and where it turns back on the spot, it is not.
    """
    first, last = curve.domain
    knot, times = np.unique(curve.knot, return_counts=True)
    inside = (knot > first) & (knot < last)
    span = np.concatenate([[first], knot[inside], [last]])
    still = np.diff(curve.arc_length(span)) <= STILL_LENGTH
    cusps = _cusps(curve, span[:-1][~still], span[1:][~still])
    edges = np.unique([first, *span[:-1][still], *span[1:][still], *cusps, last])
    inner = knot[inside & (times >= curve.degree - 1) & ~np.isin(knot, edges)]
    if not len(inner):
        return edges
    _, before, bend = _frames(curve, inner, first, last)
    left = [_frames(curve, np.array([u]), first, u) for u in inner.tolist()]
    ahead, behind = before, np.concatenate([one[1] for one in left])
    jump = vector_lengths(bend - np.concatenate([one[2] for one in left]))
    size = vector_lengths(bend)
    rough = (turn_angles(behind, ahead) > SMOOTH_TURN) | (jump > _JUMP * size + 1e-9)
    return np.union1d(edges, inner[rough])


def _cusps(curve: NurbsCurve, low: Array, high: Array) -> Array:
    """Return where the curve comes to rest within its spans `low` to `high`, (k,) each."""
    share = np.linspace(0.0, 1.0, _PROBES)
    u = low[:, np.newaxis] + (high - low)[:, np.newaxis] * share
    speed = vector_lengths(curve.derivative(np.minimum(u, np.nextafter(high, low)[:, np.newaxis])))
    row, column = np.nonzero((speed[:, 1:-1] <= speed[:, :-2]) & (speed[:, 1:-1] <= speed[:, 2:]))
    mean = curve.length / (curve.domain[1] - curve.domain[0])
    left, right = u[row, column], u[row, column + 2]
    for _ in range(_NARROWINGS if len(row) else 0):
        one, other = left + (right - left) / 3.0, right - (right - left) / 3.0
        slower = vector_lengths(curve.derivative(one)) <= vector_lengths(curve.derivative(other))
        left, right = np.where(slower, left, one), np.where(slower, other, right)
    found = 0.5 * (left + right)
    found = np.concatenate([low, found])
    return np.asarray(found[vector_lengths(curve.derivative(found)) <= _ASIDE * mean])


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
    off = vector_lengths(found - point[:, 1:-1]).max(axis=1)
    curvature = vector_lengths(bend)
    inner = curvature.max(axis=1)
    ends = np.maximum(curvature[:, 0], curvature[:, -1])
    turn = inner * length
    count = np.maximum(
        np.ceil(turn / TURN - 1e-9), np.ceil(np.sqrt(portable.cube_root(off / _OFF)) - 1e-9)
    )
    count = np.maximum(count, np.where((inner > _SWELL * ends) & (turn > _FLAT), 2.0, 1.0))
    return np.asarray(np.clip(count, 1.0, 8.0).astype(np.intp))


LINE, ARC, CURVE = 0, 1, 2

_NODE, _WEIGHT = np.polynomial.legendre.leggauss(8)
_ARC_MISFIT = 1e-7
"""Distance up to which the end of an arc may lie off its circle and angle [m]."""


@dataclass(frozen=True)
class Frame:
    """Points of a path with direction and curvature vector, each of shape (k, 3) [m, -, 1/m]."""

    point: Array
    tangent: Array
    bend: Array

    @property
    def curvature(self) -> Array:
        """Size of the curvature vector, shape (k,) [1/m]."""
        return np.asarray(vector_lengths(self.bend))


@dataclass(frozen=True)
class Shapes:
    """Shapes that follow each other, n rows; each begins exactly where the one before ends.

    Attributes
    ----------
    kind : array, shape (n,)
        `LINE`, `ARC` or `CURVE`.
    start, end : array, shape (n, 3)
        Ends [m].
    length : array, shape (n,)
        Arc length [m].
    owner : array, shape (n,)
        Index of the segment that each belongs to.
    feed : array, shape (n,)
        Programmed feed [m/s]; inf for rapids, and where the program gives none.
    rapid, halt : array of bool, shape (n,)
        A rapid; an exact stop asked for before it.
    rest : array, shape (n,)
        Dwell before it [s].
    arc : array, shape (n, 17)
        Numbers of an arc, see `_arc_numbers`; 0 elsewhere.
    curve : array of object, shape (n,)
        `_CurveStretch` of a curve, None elsewhere.
    """

    kind: NDArray[np.int8]
    start: Array
    end: Array
    length: Array
    owner: NDArray[np.intp]
    feed: Array
    rapid: NDArray[np.bool_]
    halt: NDArray[np.bool_]
    rest: Array
    arc: Array
    curve: NDArray[np.object_]

    def __len__(self) -> int:
        return len(self.kind)

    def behind(self, other: Shapes | None) -> Shapes:
        """Return the shapes of `other` and these as one."""
        if other is None:
            return self
        return Shapes(
            *(
                np.concatenate([getattr(other, field.name), getattr(self, field.name)])
                for field in fields(self)
            )
        )

    def last(self) -> Shapes:
        """Return the last shape alone."""
        return Shapes(*(getattr(self, field.name)[-1:].copy() for field in fields(self)))

    def frame(self, index: NDArray[np.intp], place: Array) -> Frame:
        """Return the points of shapes `index` (k,) at the arc lengths `place` (k,) of each."""
        found = Frame(*(np.empty((len(index), 3)) for _ in range(3)))
        kind = self.kind[index]
        for which, evaluate in ((LINE, self._lines), (ARC, self._arcs), (CURVE, self._curves)):
            rows = np.flatnonzero(kind == which)
            if len(rows) == len(index):
                found = evaluate(index, place)
                break
            if len(rows):
                part = evaluate(index[rows], place[rows])
                found.point[rows], found.tangent[rows] = part.point, part.tangent
                found.bend[rows] = part.bend
        for rows, ends in (
            (place == 0.0, self.start),
            (place == self.length[index], self.end),
        ):
            found.point[rows] = ends[index[rows]]  # to the last digit
        return found

    def _lines(self, index: NDArray[np.intp], place: Array) -> Frame:
        length = self.length[index, np.newaxis]
        start = self.start[index]
        edge = self.end[index] - start
        return Frame(
            start + edge * (place[:, np.newaxis] / length), edge / length, np.zeros_like(edge)
        )

    def _arcs(self, index: NDArray[np.intp], place: Array) -> Frame:
        number, length = self.arc[index], self.length[index]
        share = place / length
        for _ in range(2 if np.any(number[:, 6] != 0.0) else 0):
            # Newton, for the length runs unevenly where the radius changes.
            excess = _arc_length(number, share) - place
            share = np.clip(share - excess / _arc_speed(number, share), 0.0, 1.0)
        point, first, second = _arc_derivatives(number, share)
        speed = vector_lengths(first)[:, np.newaxis]
        tangent = first / speed
        along = dot_products(second, tangent)[:, np.newaxis]
        return Frame(point, tangent, (second - along * tangent) / (speed * speed))

    def _curves(self, index: NDArray[np.intp], place: Array) -> Frame:
        found = Frame(*(np.empty((len(index), 3)) for _ in range(3)))
        for row in np.unique(index).tolist():
            chosen = np.flatnonzero(index == row)
            values = self.curve[row].frame(place[chosen])
            found.point[chosen], found.tangent[chosen], found.bend[chosen] = values
        return found


def make_shapes(
    segments: Sequence[Segment],
    owner: NDArray[np.intp],
    before: Array | None,
    halt: NDArray[np.bool_],
    rest: Array,
) -> Shapes:
    """Return the shapes of segments that move.

    Parameters
    ----------
    segments : sequence of Segment
        Lines, arcs and curves, n of them.
    owner : array, shape (n,)
        Index of each.
    before : array, shape (3,), or None
        Where the path ends so far [m].
    halt, rest : array, shape (n,)
        As in `Shapes`.

    Raises
    ------
    ValueError
        If an arc does not end where it says, or a curve is not in space.
    """
    count = len(segments)
    start = np.array([segment.start for segment in segments], dtype=float).reshape(count, 3)
    end = np.array([segment.end for segment in segments], dtype=float).reshape(count, 3)
    start[1:] = end[:-1]
    if before is not None:
        start[0] = before
    rapid = np.array([segment.rapid for segment in segments], dtype=bool)
    feed = np.array([_feed(segment) for segment in segments], dtype=float)
    kind = np.full(count, LINE, dtype=np.int8)
    length = vector_lengths(end - start)
    arc = np.zeros((count, 17))
    curve = np.full(count, None, dtype=object)
    stretches: dict[int, list[_CurveStretch]] = {}
    bent: list[ArcSegment] = []
    for k, segment in enumerate(segments):
        if isinstance(segment, ArcSegment):
            kind[k] = ARC
            bent.append(segment)
        elif isinstance(segment, NurbsSegment):
            kind[k] = CURVE
            stretches[k] = _curve_stretches(segment, start[k])
    arcs = np.flatnonzero(kind == ARC)
    arc[arcs] = _arc_numbers(bent, start[arcs], end[arcs])
    length[arcs] = _arc_length(arc[arcs], np.ones(len(arcs)))
    shapes = Shapes(kind, start, end, length, owner, feed, rapid, halt, rest, arc, curve)
    return _with_stretches(shapes, stretches) if stretches else shapes


def _with_stretches(shapes: Shapes, stretches: dict[int, list[_CurveStretch]]) -> Shapes:
    """Return the shapes with each curve cut into its smooth stretches."""
    count = np.ones(len(shapes), dtype=np.intp)
    for k, parts in stretches.items():
        count[k] = len(parts)
    row = np.repeat(np.arange(len(shapes)), count)
    found = Shapes(*(getattr(shapes, field.name)[row] for field in fields(shapes)))
    first = np.append(0, np.cumsum(count))
    for k, parts in stretches.items():
        for at, part in enumerate(parts, int(first[k])):
            found.curve[at], found.length[at] = part, part.length
            if at > first[k]:
                found.start[at] = found.end[at - 1]
                found.halt[at], found.rest[at] = False, 0.0
            if part is not parts[-1]:
                found.end[at] = part.end
    return found


def _feed(segment: Segment) -> float:
    return math.inf if segment.rapid or segment.feed is None else segment.feed


def _arc_numbers(segments: Sequence[ArcSegment], start: Array, end: Array) -> Array:
    """Return axes (3), centre (2), radius, its change, angle, sweep, height, rise, misfits (6).

    One row for each arc.  The misfits are what the ends (k, 3) are off the formula, spread over
    the arc.
    """
    number = np.zeros((len(segments), 17))
    for row, segment in zip(number, segments, strict=True):
        first, second, across = segment.axes
        low, high = segment.radii
        angle = portable.arctan2(
            segment.start[second] - segment.centre[1], segment.start[first] - segment.centre[0]
        )
        height = segment.start[across]
        # A change of the radius within the digits of the coordinates is none.
        change = high - low if abs(high - low) > 1e-14 + 1e-12 * low else 0.0
        row[:11] = (
            *segment.axes,
            *segment.centre,
            low,
            change,
            angle,
            segment.sweep,
            height,
            segment.end[across] - height,
        )
    begin, _, _ = _arc_derivatives(number, np.zeros(len(number)))
    finish, _, _ = _arc_derivatives(number, np.ones(len(number)))
    number[:, 11:14], number[:, 14:] = start - begin, end - finish
    away = vector_lengths(number[:, 14:])
    if not (away <= _ARC_MISFIT).all():
        at = int(np.argmin(away <= _ARC_MISFIT))
        raise ValueError(
            f'line {segments[at].line}: expected an arc that ends where its centre and angle '
            f'lead, but found its end {1e3 * away[at]:.6g} mm away from there'
        )
    return number


def _arc_derivatives(number: Array, share: Array) -> tuple[Array, Array, Array]:
    """Return points of arcs at shares 0..1 and two derivatives by the share, each (k, 3)."""
    axes = number[:, :3].astype(np.intp)
    radius, change, angle, sweep, height, rise = number[:, 5:11].T
    row = np.arange(len(number))
    turned = angle + sweep * share
    sine, cosine = portable.sin_cos(turned)
    distance = radius + change * share
    point, first, second = (np.zeros((len(number), 3)) for _ in range(3))
    point[row, axes[:, 0]] = number[:, 3] + distance * cosine
    point[row, axes[:, 1]] = number[:, 4] + distance * sine
    point[row, axes[:, 2]] = height + rise * share
    first[row, axes[:, 0]] = change * cosine - distance * sweep * sine
    first[row, axes[:, 1]] = change * sine + distance * sweep * cosine
    first[row, axes[:, 2]] = rise
    second[row, axes[:, 0]] = -2.0 * change * sweep * sine - distance * (sweep * sweep) * cosine
    second[row, axes[:, 1]] = 2.0 * change * sweep * cosine - distance * (sweep * sweep) * sine
    point += number[:, 11:14] * (1.0 - share)[:, np.newaxis]
    point += number[:, 14:17] * share[:, np.newaxis]
    first += number[:, 14:17] - number[:, 11:14]
    return point, first, second


def _arc_speed(number: Array, share: Array) -> Array:
    """Return the length of the derivative by the share."""
    radius = number[:, 5] + number[:, 6] * share
    square = np.square(number[:, 6]) + np.square(number[:, 10])
    return np.asarray(np.sqrt(square + np.square(number[:, 8] * radius)))


def _arc_length(number: Array, share: Array) -> Array:
    """Return the length of arcs from their start up to shares of them [m]."""
    found = np.zeros(len(number))
    for node, weight in zip(_NODE, _WEIGHT, strict=True):
        found += weight * _arc_speed(number, 0.5 * share * (1.0 + node))
    return 0.5 * share * found
