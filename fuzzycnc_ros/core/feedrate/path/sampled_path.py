# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What schedulers know of a path: arc length, curvature and where it turns back."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.path_curvature import curvature, turning_angle
from fuzzycnc_ros.core.feedrate.path.windows import arc_window_maximum

REVERSAL_ANGLE = math.radians(150.0)
"""Turn at one point [rad] from which a path counts as going back on itself."""

WINDOW_EDGE = 1.0 + 1e-6
"""Windows in arc length take in points at their very edge, which rounding may move: factor."""

_BLOCK = 4096


@dataclass(frozen=True, eq=False)
class SampledPath:
    """Curvature along a path at its distinct points.

    Parameters
    ----------
    arc_length : array_like, shape (m,)
        Arc length [m], finite, increasing, m >= 1.
    curvature : array_like, shape (m,)
        Magnitude of the curvature [1/m], finite, not negative.
    lap : float, optional
        Arc length at which a closed path is back at its first point [m], above that of the last
        point, which is another one.  Windows and averages then run across the start.
    reversal : array_like of bool, shape (m,), optional
        Where the path turns back; nowhere if absent.
    place : array_like of int, shape (n,), optional
        Place among the m points of each of the n points that the path was made of.
    programmed : array_like, shape (m,), optional
        Feed that is not exceeded in any case [m/s]: what the machine sees of a point depends on
        how fast it comes there.

    Raises
    ------
    ValueError
        If an argument is not as said.
    """

    arc_length: Array
    curvature: Array
    lap: float | None = None
    reversal: Any = None
    place: Any = None
    programmed: Any = None

    def __post_init__(self) -> None:
        arc_length = _vector('arc_length', self.arc_length)
        bend = _vector('curvature', self.curvature)
        if len(arc_length) == 0:
            raise ValueError('arc_length: expected one point or more, but found none')
        if len(bend) != len(arc_length):
            raise ValueError(
                f'curvature: expected {len(arc_length)} values, one for each arc length, '
                f'but found {len(bend)}'
            )
        _refuse(
            np.diff(arc_length, prepend=-np.inf) <= 0.0,
            arc_length,
            'arc_length: expected increasing arc lengths; leave out points on top of each other',
        )
        _refuse(bend < 0.0, bend, 'curvature: expected magnitudes; take the absolute value')
        if self.lap is not None and not arc_length[-1] < self.lap < math.inf:
            raise ValueError(
                f'lap: expected a length above that of the last point, {arc_length[-1]} m, '
                f'but found {self.lap}; leave out a last point that repeats the first'
            )
        reversal = np.zeros(len(bend), dtype=bool)
        if self.reversal is not None:
            reversal |= np.asarray(self.reversal, dtype=bool)
        if self.programmed is not None:
            programmed = np.asarray(self.programmed, dtype=np.float64)
            if programmed.shape != bend.shape or not (programmed > 0.0).all():
                raise ValueError(
                    f'programmed: expected {len(bend)} feeds above 0 m/s, but found shape '
                    f'{programmed.shape} or a feed that is not'
                )
            object.__setattr__(self, 'programmed', programmed)
        object.__setattr__(self, 'arc_length', arc_length)
        object.__setattr__(self, 'curvature', bend)
        object.__setattr__(self, 'reversal', reversal)

    @classmethod
    def from_points(
        cls, points: ArrayLike, *, closed: bool = False, rounding: float = 0.0
    ) -> 'SampledPath':
        """Return the curvature along a path given by points.

        Parameters
        ----------
        points : array_like, shape (n, d)
            Points in order [m], at least two distinct ones.
        closed : bool
            Whether the path goes on from the last point to the first, which may be repeated.
        rounding : float
            Largest error of a coordinate [m], 0 for coordinates with all their digits.

        Returns
        -------
        SampledPath
            The distinct points, with the place among them of each point given.

        Raises
        ------
        ValueError
            If the points are no path.

        Examples
        --------
        >>> path = SampledPath.from_points([[0.0, 0.0], [0.001, 0.0], [0.001, 0.0], [0.003, 0.0]])
        >>> path.arc_length.tolist(), path.place.tolist()
        ([0.0, 0.001, 0.003], [0, 1, 1, 2])
        """
        bend = curvature(points, closed=closed, rounding=rounding)
        path = np.asarray(points, dtype=np.float64)
        step = np.diff(path, axis=0)
        arc_length = np.zeros(len(path))
        np.cumsum(np.sqrt(np.einsum('ij,ij->i', step, step)), out=arc_length[1:])
        new = np.diff(arc_length, prepend=-1.0) > 0.0
        place = np.cumsum(new) - 1
        lap = None
        if closed:
            lap = float(arc_length[-1] + math.dist(path[0], path[-1]))
            if not arc_length[-1] < lap:
                # The last point is the first again, and so are those on top of it.
                last = place == place[-1]
                new &= ~last
                place[last] = 0
        reversal = None
        # The curvature of a corner is at least its turn over half the length of its sides.
        side = float(np.diff(arc_length).max()) if lap is None else lap
        if rounding > 0.0 or float(bend.max()) * side >= REVERSAL_ANGLE:
            reversal = turning_angle(points, closed=closed)[new] > REVERSAL_ANGLE
        return cls(arc_length[new], bend[new], lap, reversal, place)

    @property
    def closed(self) -> bool:
        """Whether the path goes on from its last point to its first."""
        return self.lap is not None

    def largest_within(self, ahead: float, behind: float) -> Array:
        """Return the largest curvature from an arc length before each point to one after it.

        Parameters
        ----------
        ahead, behind : float
            Lengths to look at after and before each point [m], 0 or more.

        Returns
        -------
        ndarray, shape (m,)
            Largest curvatures [1/m].
        """
        if self.lap is not None:
            return arc_window_maximum(
                self.curvature, self.arc_length, ahead, behind, period=self.lap
            )
        # In blocks with what their windows reach: a third of the time, as searches stay short.
        largest = np.empty(len(self.curvature))
        starts = np.arange(0, len(largest), _BLOCK)
        ends = np.minimum(starts + _BLOCK, len(largest))
        lows = np.searchsorted(self.arc_length, self.arc_length[starts] - behind * WINDOW_EDGE)
        highs = np.searchsorted(self.arc_length, self.arc_length[ends - 1] + ahead * WINDOW_EDGE)
        for start, end, low, high in zip(starts, ends, lows, highs, strict=True):
            found = arc_window_maximum(
                self.curvature[low:high], self.arc_length[low:high], ahead, behind
            )
            largest[start:end] = found[start - low : end - low]
        return largest

    def at_points(self, values: Array) -> Array:
        """Return values at the distinct points for the points that the path was made of."""
        return values if self.place is None else np.asarray(values[self.place])


def _vector(name: str, values: ArrayLike) -> Array:
    """Return finite doubles in one row."""
    vector = np.asarray(values, dtype=np.float64)
    if vector.ndim != 1:
        raise ValueError(f'{name}: expected one row of numbers, but found shape {vector.shape}')
    _refuse(~np.isfinite(vector), vector, f'{name}: expected finite numbers')
    return vector


def _refuse(wrong: NDArray[np.bool_], values: Array, expected: str) -> None:
    """Refuse values, naming the first wrong one."""
    if wrong.any():
        at = int(wrong.argmax())
        raise ValueError(f'{expected}; found {values[at]} at point {at}')
