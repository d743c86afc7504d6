# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Designs of stitching machines: runs of stitches with jumps, cuts and stops between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise
from math import ceil, inf

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.believed_deviation import CORNER
from fuzzycnc_ros.core.deformation.stitch_path import StitchPath

NEIGHBOURS = 1e-3
"""Distance up to which stitches of two runs are neighbours in the plan [m]."""

_NEAREST = 12  # stitches that are looked at for one of another run
_SAME = 1e-9


class Move(IntEnum):
    """Commands of a stitch design."""

    STITCH = 0
    """The needle goes down at the point."""
    JUMP = 1
    """The frame goes to the point without a stitch."""
    CUT = 2
    """The thread is cut or changed; nothing moves."""
    PAUSE = 3
    """The machine stops or changes its speed, and the thread goes on."""


@dataclass(frozen=True, eq=False)
class Design:
    """Commands in their order.

    Attributes
    ----------
    points : ndarray, shape (n, 2)
        Where each command ends [m].
    move : ndarray of int, shape (n,)
        `Move` of each.
    """

    points: Array
    move: NDArray[np.int64]

    @staticmethod
    def of_runs(runs: Sequence[ArrayLike]) -> Design:
        """Return a design that jumps from run to run, points of shape (k, 2) [m] each."""
        points: list[Array] = []
        move: list[int] = []
        for run in runs:
            stitches = np.asarray(run, float)
            points += [stitches[:1], stitches, stitches[-1:]]
            move += [Move.JUMP, *[Move.STITCH] * len(stitches), Move.CUT]
        return Design(np.concatenate([np.empty((0, 2)), *points]), np.array(move, dtype=np.int64))

    def runs(self) -> list[NDArray[np.intp]]:
        """Return the places of the stitches of each run, in their order.

        A run ends with a jump or a cut.  Its first stitch lies where the jump before it led, or
        the needle goes down there for the first time: no stitch leads to it.

        Examples
        --------
        >>> import numpy as np
        >>> square = [[0.0, 0.0], [3e-3, 0.0], [6e-3, 0.0]]
        >>> [run.tolist() for run in Design.of_runs([square, np.add(square, 0.02)]).runs()]
        [[1, 2, 3], [6, 7, 8]]
        """
        ends = np.isin(self.move, (Move.JUMP, Move.CUT))
        number = np.cumsum(ends)
        stitches = np.flatnonzero(self.move == Move.STITCH)
        cuts = np.flatnonzero(np.diff(number[stitches])) + 1
        return [run for run in np.split(stitches, cuts) if len(run)]


@dataclass(frozen=True)
class StitchLengths:
    """Stitch lengths that a file format and a machine accept.

    Parameters
    ----------
    unit : float
        Grid of the points [m]; 0 for none.
    along_axis : float
        Longest stitch along X or Y that the file can say [m].
    longest, shortest : float
        Longest and shortest stitch that the machine takes [m].
    """

    unit: float = 0.0
    along_axis: float = inf
    longest: float = inf
    shortest: float = 0.0


@dataclass(eq=False)
class PlacedDesign:
    """A design with its stitches in new places.

    Attributes
    ----------
    design : Design
        The design as planned.
    points : ndarray, shape (n, 2)
        New places of its commands [m].
    added : dict of int to ndarray
        Stitches that split the one at a place, shape (k, 2) [m].
    merged : ndarray of bool, shape (n,)
        Stitches that were left out, since they had become too short.
    """

    design: Design
    points: Array
    added: dict[int, Array] = field(default_factory=dict)
    merged: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))

    @property
    def split(self) -> int:
        """Number of stitches that were split."""
        return len(self.added)

    def runs(self) -> list[Array]:
        """Return the stitches of each run as they are written, shape (k, 2) [m] each."""
        found = []
        for run in self.design.runs():
            parts = [np.empty((0, 2))]
            for place in run.tolist():
                parts.append(self.added.get(place, parts[0]))
                if not self.merged[place]:
                    parts.append(self.points[place : place + 1])
            found.append(np.concatenate(parts))
        return found


def run_path(points: Array, depth: float, step: float | None) -> StitchPath | None:
    """Return the path of a run; None if it has no step that moves.

    Parameters
    ----------
    points : ndarray, shape (k, 2)
        Its stitches [m].
    depth : float
        Feed depth [m].
    step : float, optional
        Nominal stitch step [m]; the median length of its stitches if left out.
    """
    if len(points) < 2:
        return None
    lengths = np.hypot(*np.diff(points, axis=0).T)
    moving = lengths[lengths > _SAME]
    if not len(moving):
        return None
    return StitchPath(points, depth=depth, step=float(np.median(moving)) if step is None else step)


def placed_design(design: Design, offset: Array, lengths: StitchLengths) -> PlacedDesign:
    """Return a design with offsets added to its stitches, each of a length that can be sewn.

    Stitches that the offsets have made too long are split in equal parts; those that are longer
    than the machine takes are split whatever made them so.  Stitches that the offsets have made
    too short are merged with the next one.  What has no offset stays exactly where it was.

    Parameters
    ----------
    design : Design
        As planned.
    offset : ndarray, shape (n, 2)
        Offsets [m]; those of commands other than stitches do not count.
    lengths : StitchLengths
        What file and machine take.
    """
    stitch = design.move == Move.STITCH
    moved = stitch & (np.abs(offset) > 0.0).any(axis=1)
    points = design.points.copy()
    points[moved] += offset[moved]
    if lengths.unit:
        points[moved] = np.round(points[moved] / lengths.unit) * lengths.unit
    placed = PlacedDesign(design, points, {}, np.zeros(len(points), bool))
    for run in design.runs():
        _merge(placed, run, lengths)
        kept = run[~placed.merged[run]].tolist()
        for before, place in pairwise(kept):
            parts = _parts(design, points, before, place, lengths)
            if parts > 1:
                share = np.arange(1, parts)[:, np.newaxis] / parts
                between = points[before] + share * (points[place] - points[before])
                if lengths.unit:
                    between = np.round(between / lengths.unit) * lengths.unit
                placed.added[place] = between
    return placed


def _merge(placed: PlacedDesign, run: NDArray[np.intp], lengths: StitchLengths) -> None:
    """Leave stitches of a run out that offsets have made too short; never its ends."""
    design, points = placed.design, placed.points
    last = int(run[0])
    for number, place in enumerate(run[1:].tolist(), start=1):
        planned = _apart(design.points, place, int(run[number - 1]))
        if planned >= lengths.shortest > _apart(points, place, last) and number < len(run) - 1:
            placed.merged[place] = True
        else:
            last = place


def _apart(points: Array, one: int, other: int) -> float:
    return float(np.hypot(*(points[one] - points[other])))


def _parts(design: Design, points: Array, before: int, place: int, lengths: StitchLengths) -> int:
    """Return into how many stitches the one between two places has to be split."""
    parts = 1
    along = float(np.abs(points[place] - points[before]).max())
    planned = float(np.abs(design.points[place] - design.points[before]).max())
    if planned <= lengths.along_axis + _SAME < along:  # a longer plan is the writer's own affair
        parts = ceil(along / lengths.along_axis - _SAME)
    way = _apart(points, place, before)
    if way > lengths.longest + _SAME:
        parts = max(parts, ceil(way / max(lengths.longest - lengths.unit, 0.5 * lengths.longest)))
    return parts


def stitches_along(line: ArrayLike, step: float) -> Array:
    """Return the stitches along a flattened path, shape (k, 2) [m].

    Its ends and corners get a stitch, and the way between them is divided into equal steps.

    Parameters
    ----------
    line : array_like, shape (n, 2)
        Points of the path [m].
    step : float
        Stitch step [m].

    Examples
    --------
    >>> (1e3 * stitches_along([[0, 0], [6e-3, 0], [6e-3, 4e-3]], 3e-3)).round(3).tolist()
    [[0.0, 0.0], [3.0, 0.0], [6.0, 0.0], [6.0, 4.0]]
    """
    points: Array = np.asarray(line, float)
    moving = np.append(True, np.hypot(*np.diff(points, axis=0).T) > _SAME)
    points = points[moving]
    if len(points) < 2:
        return points
    feed = np.diff(points, axis=0)
    length = np.hypot(*feed.T)
    heading = portable.arctan2(feed[:, 1], feed[:, 0])
    turn = np.abs((np.diff(heading) + np.pi) % (2.0 * np.pi) - np.pi)
    way = np.append(0.0, np.cumsum(length))
    corners = way[np.concatenate([[0], np.flatnonzero(turn > CORNER) + 1, [len(points) - 1]])]
    places = [corners[:1]]
    for first, last in pairwise(corners):
        count = max(round(round((last - first) / step, 9)), 1)
        places.append(first + (last - first) * np.arange(1, count + 1) / count)
    at = np.concatenate(places)
    return np.column_stack([np.interp(at, way, axis) for axis in points.T])


@dataclass(frozen=True, eq=False)
class PlacedRun:
    """A run of stitches and the offsets that it was given.

    Attributes
    ----------
    planned, commanded : ndarray, shape (k, 2)
        Where its stitches are to lie, and where they are commanded [m].
    offset : ndarray, shape (k, 2)
        Offsets that the model calls for [m].
    """

    planned: Array
    commanded: Array
    offset: Array


@dataclass(frozen=True)
class NeighbourGap:
    """Neighbouring stitches of two runs.

    Attributes
    ----------
    runs : tuple of int
        Numbers of the runs, from 0.
    place : tuple of float
        Where they lie in the plan [m].
    planned, before, after : float
        Their distance as planned, as the sheet would show it, and with compensation [m].
    """

    runs: tuple[int, int]
    place: tuple[float, float]
    planned: float
    before: float
    after: float

    @property
    def opening(self) -> float:
        """By how much it opens without compensation [m]."""
        return self.before - self.planned


def neighbour_gaps(runs: Sequence[PlacedRun]) -> list[NeighbourGap]:
    """Return for each two neighbouring runs the stitches between which most opens, worst first.

    Without compensation the sheet shows a stitch as far from its place as its offset is long, in
    the opposite direction.
    """
    if len(runs) < 2:
        return []
    label = np.repeat(np.arange(len(runs)), [len(run.planned) for run in runs])
    points, offset, commanded = (
        np.concatenate([getattr(run, name) for run in runs])
        for name in ('planned', 'offset', 'commanded')
    )
    shown = (points, points - offset, commanded - offset)
    distance, near = cKDTree(points).query(
        points, k=min(_NEAREST, len(points)), distance_upper_bound=NEIGHBOURS
    )
    near = np.where(np.isfinite(distance), near, 0)
    other = np.isfinite(distance) & (label[near] != label[:, np.newaxis])
    chosen = other.argmax(axis=1)
    found: dict[tuple[int, int], NeighbourGap] = {}
    for one in np.flatnonzero(other.any(axis=1)).tolist():
        two = int(near[one, chosen[one]])
        pair = (int(min(label[one], label[two])), int(max(label[one], label[two])))
        apart = [float(np.hypot(*(where[one] - where[two]))) for where in shown]
        gap = NeighbourGap(pair, (float(points[one, 0]), float(points[one, 1])), *apart)
        if pair not in found or gap.opening > found[pair].opening:
            found[pair] = gap
    return sorted(found.values(), key=lambda gap: -gap.opening)
