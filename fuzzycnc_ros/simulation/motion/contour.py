# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The programmed contour that a machine is judged by: positions by arc length, distances to it.

The contour error of axes that lag is found against the commanded positions of a while ago.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array

_NEIGHBOURS = 3
"""Vertices looked up for each sample; the segments at all but the last are tried."""

_BLOCK = 32_768
"""Segments searched in one go, as many as stay in the cache of a processor."""

_SAMPLES = 4096
"""Samples searched in one go, for the same reason."""

_GROUP = 16
"""Segments that are passed over together where all of them are too far away."""


@dataclass(frozen=True)
class ContourDistance:
    """Distance of samples from a contour.

    Attributes
    ----------
    distance : ndarray, shape (m,)
        Shortest distance to the contour inside each sample's window [m].
    arc_length : ndarray, shape (m,)
        Where on the contour the nearest point lies [m].
    """

    distance: Array
    arc_length: Array


class Contour:
    """A path in arc length, with a search for the nearest point that knows where to look.

    Parameters
    ----------
    point : callable
        Positions of the path, shape (m, d) [m], at parameters of shape (m,).
    parameter : array_like, shape (n,)
        Increasing parameters of the arc-length table, first and last the path's ends; dense
        enough that the path hardly bends between two of them.
    vertices : int
        Least number of vertices of the polyline that distances are taken to.

    Attributes
    ----------
    length : float
        Length of the path [m].

    Raises
    ------
    ValueError
        If parameters do not increase, positions are not finite or not in two or more
        dimensions, or the path has no length.

    Notes
    -----
    `curve` and `polyline` build the two usual kinds.  A polyline of 40 001 points keeps its
    corners as vertices; a curve's are equally spaced in arc length.

    Examples
    --------
    >>> square = Contour.polyline([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    >>> square.position([0.5, 1.5]).tolist()
    [[0.5, 0.0], [1.0, 0.5]]
    >>> found = square.distance([[0.5, 0.25]], [0.5], 1.0)
    >>> found.distance.tolist(), found.arc_length.tolist()
    ([0.25], [0.5])
    """

    def __init__(
        self,
        point: Callable[[Array], Array],
        parameter: ArrayLike,
        *,
        vertices: int = 40_001,
    ) -> None:
        _check_vertices(vertices)
        table = np.asarray(parameter, dtype=np.float64)
        if table.ndim != 1 or len(table) < 2 or not np.all(np.diff(table) > 0.0):
            raise ValueError('parameter: expected two or more increasing numbers')
        self._point = point
        self._parameter = table
        self._arc = _arc_length(_checked(point(table), len(table)))
        self.length = float(self._arc[-1])
        if not self.length > 0.0:
            raise ValueError('expected a path with a length but all its points are one')
        self._vertices = self.position(np.linspace(0.0, self.length, vertices))
        self._index()

    @classmethod
    def curve(cls, point: Callable[[Array], Array], *, vertices: int = 40_001) -> 'Contour':
        """Take a smooth curve over the parameters 0 to 1, such as `NurbsCurve.point`."""
        _check_vertices(vertices)
        return cls(point, np.linspace(0.0, 1.0, vertices), vertices=vertices)

    @classmethod
    def polyline(cls, points: ArrayLike, *, vertices: int = 40_001) -> 'Contour':
        """Take straight lines between `points`, shape (n, d) [m], corners and all.

        Points that coincide with the one before are left out.
        """
        _check_vertices(vertices)
        corner = _checked(np.asarray(points, dtype=np.float64), len(np.asarray(points)))
        # Points may differ by less than their place along the path can tell.
        corner = corner[np.append(True, np.diff(_arc_length(corner)) > 0.0)]
        if len(corner) < 2:
            raise ValueError('points: expected two or more different points')
        arc = _arc_length(corner)

        def point(at: Array) -> Array:
            return np.column_stack([np.interp(at, arc, axis) for axis in corner.T])

        # Of a closed path two vertices would be one.
        contour = cls(point, arc, vertices=max(vertices, 1001))
        grid = np.union1d(arc, np.linspace(0.0, arc[-1], vertices))
        contour._vertices = point(grid)
        contour._index()
        return contour

    def _index(self) -> None:
        """Prepare the search over the vertices."""
        # Here, since `PathError` does without: a third of a second that a machine saves at start.
        from scipy.spatial import cKDTree

        step = np.diff(self._vertices, axis=0)
        kept = np.append(True, np.any(step != 0.0, axis=1))
        self._vertices = self._vertices[kept]
        self._step = np.diff(self._vertices, axis=0)
        self._square = np.einsum('ij,ij->i', self._step, self._step)
        self._vertex_arc = _arc_length(self._vertices)
        # the polyline is shorter than the curve by its chords' share
        self._vertex_arc *= self.length / self._vertex_arc[-1]
        self._longest = float(np.sqrt(self._square.max()))
        self._tree = cKDTree(self._vertices)
        # balls around groups of segments that follow each other
        first = np.arange(0, len(self._step), _GROUP)[:, np.newaxis]
        group = self._vertices[np.minimum(first + np.arange(_GROUP + 1), len(self._step))]
        self._middle = 0.5 * (group.min(axis=1) + group.max(axis=1))
        self._radius = np.linalg.norm(group - self._middle[:, np.newaxis], axis=2).max(axis=1)

    def arc_length(self, parameter: ArrayLike) -> Array:
        """Return the arc length at parameters of the path [m]; outside, that of the ends."""
        at = np.asarray(parameter, dtype=np.float64)
        return np.asarray(np.interp(at, self._parameter, self._arc))

    def position(self, arc_length: ArrayLike) -> Array:
        """Return the path's positions, shape (m, d) [m], at arc lengths of shape (m,) [m].

        Outside of the path they are those of its ends.
        """
        at = np.asarray(arc_length, dtype=np.float64)
        return np.asarray(self._point(np.interp(at, self._arc, self._parameter)))

    def distance(self, points: ArrayLike, arc_length: ArrayLike, reach: float) -> ContourDistance:
        """Return the shortest distance to the part of the path around each sample's own place.

        Parameters
        ----------
        points : array_like, shape (m, d)
            Where the tool was [m].
        arc_length : array_like, shape (m,)
            Where on the path the tool should have been [m].
        reach : float
            How far before and behind that place the nearest point may lie [m]; positive.

        Raises
        ------
        ValueError
            If shapes differ, a number is not finite or the reach not positive.

        Notes
        -----
        The window keeps a sample on its own branch: without it a path that crosses itself is
        measured against the wrong one.  Nearest vertices of the whole path come first; they
        decide wherever they prove that no segment inside the window can be nearer, all other
        samples are searched through their whole window.
        """
        place = np.asarray(points, dtype=np.float64)
        arc = np.asarray(arc_length, dtype=np.float64)
        dimensions = self._vertices.shape[1]
        if place.shape != (len(arc), dimensions):
            raise ValueError(
                f'points: expected the shape ({len(arc)}, {dimensions}) but found {place.shape}'
            )
        if not (np.isfinite(place).all() and np.isfinite(arc).all()):
            raise ValueError('expected finite positions and arc lengths')
        if not (np.isfinite(reach) and reach > 0.0):
            raise ValueError(f'reach: expected more than 0 m but found {reach} m')
        parts = range(0, max(len(arc), 1), _SAMPLES)
        found = [
            self._distance(place[first : first + _SAMPLES], arc[first : first + _SAMPLES], reach)
            for first in parts
        ]
        square, arc_length = map(np.concatenate, zip(*found, strict=True))
        return ContourDistance(np.sqrt(square), arc_length)

    def _distance(self, place: Array, arc: Array, reach: float) -> tuple[Array, Array]:
        """Return squared distances and arc lengths of the nearest points."""
        # segments whose ends both lie in the window, and always at least one
        low = np.searchsorted(self._vertex_arc, arc - reach, side='left')
        high = np.searchsorted(self._vertex_arc, arc + reach, side='right') - 1
        low = np.clip(low, 0, len(self._step) - 1)
        high = np.maximum(np.clip(high, 1, len(self._step)), low + 1)
        square, fraction, segment, proven = self._near_vertices(place, low, high)
        rest = np.flatnonzero(~proven)
        square[rest], fraction[rest], segment[rest] = self._whole_window(
            place[rest], low[rest], high[rest], square[rest]
        )
        begin = self._vertex_arc[segment]
        return square, begin + fraction * (self._vertex_arc[segment + 1] - begin)

    def _near_vertices(
        self, place: Array, low: NDArray[np.intp], high: NDArray[np.intp]
    ) -> tuple[Array, Array, NDArray[np.intp], NDArray[np.bool_]]:
        """Search the segments at the nearest vertices; say for which samples that is proof."""
        count = min(_NEIGHBOURS, len(self._vertices))
        radius, vertex = map(np.asarray, self._tree.query(place, k=range(1, count + 1)))
        tried = vertex[:, :-1]
        candidate = np.concatenate([tried - 1, tried], axis=1)
        inside = (candidate >= low[:, None]) & (candidate < high[:, None])
        candidate = np.where(inside, candidate, low[:, None])
        square, fraction = self._to_segment(place[:, None, :], candidate)
        square[~inside] = np.inf
        best = square.argmin(axis=1)
        row = np.arange(len(place))
        # An end of the nearest segment is at most half a segment farther along it; all vertices
        # nearer than the last neighbour have been tried.
        bound = square[row, best] + 0.25 * (self._longest * self._longest)
        proven = radius[:, -1] * radius[:, -1] >= bound
        return square[row, best], fraction[row, best], candidate[row, best], proven

    def _whole_window(
        self, place: Array, low: NDArray[np.intp], high: NDArray[np.intp], known: Array
    ) -> tuple[Array, Array, NDArray[np.intp]]:
        """Search each sample's window for what is no farther than the square that is known."""
        square = np.empty(len(place))
        fraction = np.empty(len(place))
        segment = np.empty(len(place), dtype=np.intp)
        reach = (1.0 + 1e-9) * np.sqrt(known)
        block = np.cumsum(high - low) // _BLOCK
        for rows in np.split(np.arange(len(place)), np.flatnonzero(np.diff(block)) + 1):
            if not len(rows):
                continue
            owner, group = _counted(rows, low[rows] // _GROUP, (high[rows] - 1) // _GROUP + 1)
            away = place.take(owner, axis=0) - self._middle.take(group, axis=0)
            within = self._radius[group] + reach[owner]
            near = np.einsum('ij,ij->i', away, away) <= within * within * (1.0 + 1e-9)
            owner, group = owner[near], group[near]
            begin = np.maximum(group * _GROUP, low[owner])
            owner, candidate = _counted(
                owner, begin, np.minimum(group * _GROUP + _GROUP, high[owner])
            )
            found, part = self._to_segment(place.take(owner, axis=0), candidate)
            start = np.searchsorted(owner, rows)
            square[rows] = np.minimum.reduceat(found, start)
            hit = np.flatnonzero(found == square[owner])
            first = hit[np.searchsorted(hit, start)]
            fraction[rows] = part[first]
            segment[rows] = candidate[first]
        return square, fraction, segment

    def _to_segment(self, place: Array, segment: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return the squared distance to segments and where along them it is taken, 0 to 1."""
        away = place - self._vertices.take(segment, axis=0)
        step = self._step.take(segment, axis=0)
        along = np.einsum('...i,...i->...', away, step) / self._square.take(segment)
        along = np.minimum(np.maximum(along, 0.0), 1.0)
        step *= along[..., None]
        away -= step
        return np.einsum('...i,...i->...', away, away), along


def _counted(
    owner: NDArray[np.intp], low: NDArray[np.intp], high: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return owners and numbers, from low to high of each owner, one owner after the other."""
    size = high - low
    number = np.arange(int(size.sum())) + np.repeat(low - (np.cumsum(size) - size), size)
    return np.repeat(owner, size), number


def _arc_length(points: Array) -> Array:
    """Return the length along a polyline at each of its points."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _check_vertices(vertices: int) -> None:
    """Refuse a polyline of less than two vertices."""
    if vertices < 2:
        raise ValueError(f'vertices: expected 2 or more but found {vertices}')


def _checked(points: Array, count: int) -> Array:
    """Refuse what is no list of `count` positions in two or more dimensions."""
    if points.ndim != 2 or points.shape[0] != count or points.shape[1] < 2:
        raise ValueError(
            f'points: expected the shape ({count}, 2) or ({count}, 3) but found {points.shape}'
        )
    if not np.isfinite(points).all():
        raise ValueError('points: expected finite numbers only')
    return points


WINDOW_LENGTH, WINDOW_TIME = 2e-3, 0.012
"""Contour error is searched that far [m], and the way of that time [s], around the axes' place."""

_SPACING = 5e-7
"""Least distance of two vertices of the path that is kept [m]; on a bend of 20 um radius the
chord between them is 1.6 nm off."""


class PathError:
    """Measure the contour error sample by sample, from commanded and actual positions alone.

    The nearest point of the commanded positions, taken as a polyline, is searched in an arc
    window of 2 mm and the way of 0.012 s around the place that was commanded a machine's delay
    ago.

    Parameters
    ----------
    period : float
        Time between two samples [s]; positive.
    delay : float
        Time by which the axes lag behind what is commanded [s]; not negative.

    Raises
    ------
    ValueError
        If the period is not positive or the delay negative.

    Notes
    -----
    Samples are searched in batches: one search over a hundred costs little more than over one.
    The path is known up to the newest commanded position only.  The memory holds the window's
    stretch of the path, of vertices at least 0.5 um apart, however slowly it is followed.

    Examples
    --------
    Axes that run beside a straight line:

    >>> error = PathError(1e-3, 0.0)
    >>> for k in range(50):
    ...     error.add([1e-4 * k, 0.0], 1e-4 * k, [1e-4 * k, 2e-6])
    >>> found = error.take()
    >>> f'{1e6 * found.distance.max():.3f} um, nearest at {1e3 * found.arc_length[30]:.3f} mm'
    '2.000 um, nearest at 3.000 mm'
    """

    def __init__(self, period: float, delay: float) -> None:
        if not (period > 0.0 and delay >= 0.0):
            raise ValueError(
                f'expected a positive period and a delay of 0 s or more but found {period} s and '
                f'{delay} s'
            )
        self._period, self._lag = period, delay / period
        self.begin()

    @property
    def pending(self) -> int:
        """Number of samples that wait for `take`."""
        return len(self._actual)

    def begin(self) -> None:
        """Forget the path; the next sample begins another."""
        self._commanded: list[ArrayLike] = []
        self._told: list[float] = []
        self._actual: list[ArrayLike] = []
        # the newest samples, back to the delay: way along the polyline of all of them [m]
        self._way = np.zeros(0)
        self._newest: Array | None = None
        # the polyline of the window: vertices, their way, their place as the sender tells it
        self._vertex: list[Array] = []
        self._vertex_way: list[float] = []
        self._vertex_told: list[float] = []

    def add(self, commanded: ArrayLike, arc_length: float, actual: ArrayLike) -> None:
        """Take one sample, a period after the last.

        Parameters
        ----------
        commanded, actual : array_like, shape (d,)
            Where the axes are told to be and where they are [m]; finite.
        arc_length : float
            Way along the path at the commanded position [m], only for what `take` returns.
        """
        self._commanded.append(commanded)
        self._told.append(arc_length)
        self._actual.append(actual)

    def take(self) -> ContourDistance:
        """Return contour error and nearest place of all samples since the last call.

        Returns
        -------
        ContourDistance
            One distance and arc length per sample; empty where there is none.
        """
        if not self._actual:
            return ContourDistance(np.zeros(0), np.zeros(0))
        commanded = np.array(self._commanded, dtype=np.float64)
        actual = np.array(self._actual, dtype=np.float64)
        way = self._extend(commanded)
        count = len(commanded)
        at = np.arange(len(way) - count, len(way)) - self._lag
        place = np.interp(at, np.arange(len(way)), way)
        # as fast as it was commanded since the place of the first sample
        speed = np.diff(way[max(int(at[0]), 0) :], prepend=way[max(int(at[0]), 0)]).max()
        reach = WINDOW_LENGTH + WINDOW_TIME * float(speed) / self._period
        found = self._search(actual, place, reach, commanded[-1])
        keep = int(np.ceil(self._lag)) + 1
        self._way = way[-keep:]
        self._forget(float(place[-1]) - 2.0 * reach)
        self._commanded, self._told, self._actual = [], [], []
        return found

    def _extend(self, commanded: Array) -> Array:
        """Add commanded positions to the path; return the way at the newest samples."""
        if self._newest is None:
            self._newest = commanded[0]
            self._vertex, self._vertex_way = [commanded[0]], [0.0]
            self._vertex_told = [self._told[0]]
        step = np.linalg.norm(np.diff(commanded, axis=0, prepend=self._newest[None]), axis=1)
        before = float(self._way[-1]) if len(self._way) else 0.0
        way = before + np.cumsum(step)
        self._newest = commanded[-1]
        last = self._vertex_way[-1]
        for row, here in enumerate(way.tolist()):
            if here - last >= _SPACING:
                self._vertex.append(commanded[row])
                self._vertex_way.append(here)
                self._vertex_told.append(self._told[row])
                last = here
        return np.concatenate([self._way, way])

    def _search(self, actual: Array, place: Array, reach: float, newest: Array) -> ContourDistance:
        """Search the nearest points on the path as far as it is known."""
        vertex, told = [*self._vertex, newest], [*self._vertex_told, self._told[-1]]
        kept = np.array(self._vertex_way)
        corner = np.array(vertex)
        step = np.linalg.norm(np.diff(corner, axis=0), axis=1)
        if len(step) and step[-1] < 1e-3 * _SPACING:
            corner, told, step = corner[:-1], told[:-1], step[:-1]
        if not len(step):  # at rest at the beginning
            distance = np.linalg.norm(actual - corner[0], axis=1)
            return ContourDistance(distance, np.full(len(actual), told[0]))
        # chords are a little shorter than the way of all samples
        chord = np.append(0.0, np.cumsum(step))
        known = kept if len(kept) == len(corner) else np.append(kept, kept[-1] + step[-1])
        contour = Contour.polyline(corner, vertices=2)
        found = contour.distance(actual, np.interp(place, known, chord), reach)
        return ContourDistance(found.distance, np.interp(found.arc_length, chord, told))

    def _forget(self, way: float) -> None:
        """Drop the vertices of the path that no later window reaches."""
        first = int(np.searchsorted(self._vertex_way, way, side='right')) - 1
        if first > 0:
            del self._vertex[:first], self._vertex_way[:first], self._vertex_told[:first]
