# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The contour error of a machine while it moves: distance to the path that it was told so far."""

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.contour import Contour, ContourDistance

WINDOW_LENGTH, WINDOW_TIME = 2e-3, 0.012
"""Contour error is searched that far [m], and the way of that time [s], around the axes' place."""

_SPACING = 5e-7
"""Least distance of two vertices of the path that is kept [m]; on a bend of 20 um radius the
chord between them is 1.6 nm off."""


class PathError:
    """Measure the contour error sample by sample, from commanded and actual positions alone.

    The nearest point of the commanded positions, taken as a polyline, is searched in an arc
    window of 2 mm and the way of 0.012 s around the place that was commanded a machine's delay
    ago, as in method sheet 002 section 6.

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
