# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Segments of part programs in metres: lines, arcs, NURBS curves and dwells."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve

Point = tuple[float, float, float]
"""X, Y and Z [m]."""


class ProgramError(ValueError):
    """A part program that says something impossible; names its line.

    Parameters
    ----------
    line : int
        Number of the line, the first one is 1.
    message : str
        What was expected, what was found, and the remedy.
    """

    def __init__(self, line: int, message: str) -> None:
        super().__init__(f'line {line}: {message}')
        self.line = line


@dataclass(frozen=True, slots=True)
class Segment(ABC):
    """A block that moves the tool, or lets it stand.

    Parameters
    ----------
    line : int
        Number of the line in the program; of a curve over many lines the first.
    start, end : tuple of float, length 3
        Where it starts and ends [m], in the coordinates of the program.
    feed : float or None
        Feed in effect [m/s].  None for a rapid and a dwell, where it is no length per time (G93,
        G95), where the controller computes it, and in a block that may be skipped (/).
    rapid : bool
        A rapid: the controller's own speed.
    turning : bool
        Other axes than X, Y and Z move along: what the feed means there is the machine's matter.
    run : int
        Segments of one run follow each other without a gap, a stop or a change of kind.
    """

    line: int
    start: Point
    end: Point
    feed: float | None
    rapid: bool
    turning: bool
    run: int

    @property
    def way(self) -> Point:
        """From its start to its end [m]; NaN where the program does not say."""
        (x, y, z), (right, up, top) = self.start, self.end
        return right - x, up - y, top - z

    @property
    def schedulable(self) -> bool:
        """True if its feed may be chosen anew."""
        return self.feed is not None and not self.turning and self.length > 0.0

    @property
    @abstractmethod
    def length(self) -> float:
        """Length of the way [m]."""

    @abstractmethod
    def points(self, count: int) -> Array:
        """Return points along it, start and end included.

        Parameters
        ----------
        count : int
            How many steps of equal length, at least 1.

        Returns
        -------
        ndarray, shape (count + 1, 3)
            Points [m].
        """

    @abstractmethod
    def curvatures(self, count: int) -> Array:
        """Return the exact curvature at `points(count)`, shape (count + 1,) [1/m]."""


@dataclass(frozen=True, slots=True)
class LineSegment(Segment):
    """A straight line."""

    @property
    def length(self) -> float:
        """Length of the way [m]."""
        return math.dist(self.start, self.end)

    def points(self, count: int) -> Array:
        """Return points along it, see `Segment.points`."""
        return np.linspace(self.start, self.end, count + 1)

    def curvatures(self, count: int) -> Array:
        """Return zeros, see `Segment.curvatures`."""
        return np.zeros(count + 1)


@dataclass(frozen=True, slots=True)
class ArcSegment(Segment):
    """An arc, a full circle or a helix.

    Parameters
    ----------
    axes : tuple of int, length 3
        Indices of the first and the second axis of the plane, and of the one across: (0, 1, 2)
        in G17, (2, 0, 1) in G18, (1, 2, 0) in G19.
    centre : tuple of float, length 2
        Centre in the plane [m].
    sweep : float
        Angle swept [rad], above 0 counterclockwise (G3).

    Notes
    -----
    Rounded programs give a start and an end that are not quite equally far from the centre; the
    radius then changes in proportion to the angle, as LinuxCNC's does, so that both points are
    met.
    """

    axes: tuple[int, int, int]
    centre: tuple[float, float]
    sweep: float

    @property
    def radii(self) -> tuple[float, float]:
        """Distance of start and end from the centre [m]."""
        first, second, _ = self.axes
        (x, y), (start, end) = self.centre, (self.start, self.end)
        return (
            math.hypot(start[first] - x, start[second] - y),
            math.hypot(end[first] - x, end[second] - y),
        )

    @property
    def misfit(self) -> float:
        """Difference of both radii [m]."""
        start, end = self.radii
        return abs(end - start)

    @property
    def length(self) -> float:
        """Length of the way [m], to the second order in the change of the radius."""
        start, end = self.radii
        across = self.axes[2]
        flat = 0.5 * (start + end) * abs(self.sweep)
        return math.hypot(flat, end - start, self.end[across] - self.start[across])

    def points(self, count: int) -> Array:
        """Return points along it at equal angles, see `Segment.points`."""
        first, second, across = self.axes
        share = np.linspace(0.0, 1.0, count + 1)
        start, end = self.radii
        angle = portable.arctan2(
            self.start[second] - self.centre[1], self.start[first] - self.centre[0]
        )
        radius = start + (end - start) * share
        point = np.empty((count + 1, 3))
        sine, cosine = portable.sin_cos(angle + self.sweep * share)
        point[:, first] = self.centre[0] + radius * cosine
        point[:, second] = self.centre[1] + radius * sine
        point[:, across] = self.start[across] + (self.end[across] - self.start[across]) * share
        point[0], point[-1] = self.start, self.end  # to the last digit
        return point

    def curvatures(self, count: int) -> Array:
        """Return r / (r^2 + c^2), c the rise per radian; see `Segment.curvatures`."""
        across = self.axes[2]
        start, end = self.radii
        radius = start + (end - start) * np.linspace(0.0, 1.0, count + 1)
        rise = (self.end[across] - self.start[across]) / self.sweep
        return np.asarray(radius / (radius * radius + rise * rise))


@dataclass(frozen=True, slots=True)
class NurbsSegment(Segment):
    """A NURBS curve, of one block over many lines.

    Parameters
    ----------
    curve : NurbsCurve
        The curve in three dimensions [m].
    last_line : int
        Number of the block's last line.
    """

    curve: NurbsCurve
    last_line: int

    @property
    def length(self) -> float:
        """Length of the way [m]."""
        return float(self.curve.length)

    def points(self, count: int) -> Array:
        """Return points along it, see `Segment.points`."""
        point = self.curve.point(self._parameter(count))
        point[0], point[-1] = self.start, self.end  # to the last digit
        return point

    def curvatures(self, count: int) -> Array:
        """Return the exact curvature, see `Segment.curvatures`."""
        return self.curve.curvature(self._parameter(count))

    def _parameter(self, count: int) -> Array:
        return self.curve.parameter(np.linspace(0.0, self.length, count + 1))


@dataclass(frozen=True, slots=True)
class DwellSegment(Segment):
    """A wait; its place is NaN where the program does not say it.

    Parameters
    ----------
    duration : float
        How long [s].
    """

    duration: float

    @property
    def length(self) -> float:
        """No way at all."""
        return 0.0

    def points(self, count: int) -> Array:
        """Return the place, over and over."""
        return np.tile(self.start, (count + 1, 1))

    def curvatures(self, count: int) -> Array:
        """Return zeros."""
        return np.zeros(count + 1)


_NOWHERE = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class UnplacedSegment(Segment):
    """A line or an arc in relative coordinates, from a place that the program does not say.

    Its length counts, its feed stays that of the program; start and end are NaN.

    Parameters
    ----------
    shape : Segment
        The same motion somewhere else.
    """

    shape: Segment

    @classmethod
    def of(cls, shape: Segment) -> 'UnplacedSegment':
        """Return a motion without its place."""
        return cls(
            shape.line,
            _NOWHERE,
            _NOWHERE,
            shape.feed,
            shape.rapid,
            shape.turning,
            shape.run,
            shape,
        )

    @property
    def way(self) -> Point:
        """From its start to its end [m]."""
        return self.shape.way

    @property
    def schedulable(self) -> bool:
        """Never."""
        return False

    @property
    def length(self) -> float:
        """Length of the way [m]."""
        return self.shape.length

    def points(self, count: int) -> Array:
        """Return places that nobody knows, see `Segment.points`."""
        return np.full((count + 1, 3), np.nan)

    def curvatures(self, count: int) -> Array:
        """Return the exact curvature, see `Segment.curvatures`."""
        return self.shape.curvatures(count)


_GAP = 1e-9
"""Distance up to which two segments meet [m]."""


@dataclass(frozen=True, eq=False)
class ProgramPoints:
    """Points along the path of a program.

    Parameters
    ----------
    point : ndarray, shape (n, 3)
        Points [m].
    segment : ndarray, shape (n,)
        Index of the segment of each point; where two meet, of the later one.
    curvature : ndarray, shape (n,)
        Exact curvature of that segment [1/m]: 0 on lines, whose corners are no matter of
        curvature; where two segments meet, the larger one of both.
    """

    point: Array
    segment: NDArray[np.intp]
    curvature: Array


def sample_path(segments: Sequence[Segment], spacing: float) -> ProgramPoints:
    r"""Return points along segments that follow each other, all ends included.

    Parameters
    ----------
    segments : sequence of Segment
        A run of a program, or any part of it that has no gap.  Dwells and segments of no length
        add no points.
    spacing : float
        Largest distance of points along the path [m].

    Returns
    -------
    ProgramPoints
        Points in equal steps inside each segment; no two in a row are the same.

    Raises
    ------
    ValueError
        If the spacing is not above 0, nothing moves, or there is a gap.

    Examples
    --------
    >>> from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
    >>> program = read_program('F600 G1 X3\nX4\n')
    >>> path = sample_path(program.segments, 0.002)
    >>> path.point[:, 0].tolist(), path.segment.tolist()
    ([0.0, 0.0015, 0.003, 0.004], [0, 0, 1, 1])
    """
    if not 0.0 < spacing < np.inf:
        raise ValueError(f'expected a spacing above 0 but found {spacing} m')
    length = np.array([segment.length for segment in segments])
    moving = np.flatnonzero(length > 0.0)
    part = [segments[index] for index in moving.tolist()]
    if not part:
        raise ValueError('expected segments that move but found none')
    start = np.array([segment.start for segment in part])
    end = np.array([segment.end for segment in part])
    gap = np.linalg.norm(start[1:] - end[:-1], axis=1)
    if (gap > _GAP).any():
        first = int(np.argmax(gap > _GAP))
        raise ValueError(
            f'expected segments that follow each other but found a gap of {gap[first]:.6g} m '
            f'before line {part[first + 1].line}; sample each run by itself'
        )
    count = np.ceil(length[moving] / spacing * (1.0 - 1e-12)).astype(np.intp)
    count = np.maximum(count, 1)
    owner = np.repeat(np.arange(moving.size), count)
    offset = np.concatenate([[0], np.cumsum(count)])
    share = (np.arange(offset[-1]) - offset[owner]) / count[owner]
    point = np.empty((offset[-1] + 1, 3))
    point[:-1] = start[owner] + (end - start)[owner] * share[:, np.newaxis]
    point[-1] = end[-1]
    curvature = np.zeros(offset[-1] + 1)
    for index, segment in enumerate(part):
        if not isinstance(segment, LineSegment):
            steps = int(count[index])
            own = slice(offset[index], offset[index] + steps)
            point[own] = segment.points(steps)[:-1]
            bent = segment.curvatures(steps)
            curvature[own] = np.maximum(curvature[own], bent[:-1])
            curvature[own.stop] = bent[-1]
    return ProgramPoints(point, np.append(moving[owner], moving[-1]), curvature)
