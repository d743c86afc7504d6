# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories: positions over time within limits of velocity, acceleration and jerk.

Without limits of jerk the squared speed runs straight between the nodes (`axis_limits`).  With
them, the limits at each place are first shared out into the largest speed, acceleration and jerk
along the path; the fastest motion within speed and acceleration is then averaged over a window in
time.  An average of length tau of accelerations up to a changes by at most 2 a / tau per second.
It also mixes places up to tau apart, so every limit is first replaced by the smallest within tau:
the average then obeys the limits of the place it leads to.  At stops the motion rests for tau.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.axis_limits import fastest_speed, node_minimum
from fuzzycnc_ros.core.feedrate.limits import MotionLimits, sweep
from fuzzycnc_ros.core.feedrate.path_geometry import PathGeometry

_AT_STOPS = 8
"""Pieces of a segment that ends at a stop: the motion gets going within the first of them."""
_PIECES_MAX = 64
_WINDOWS = 2.0 ** np.arange(-6, 1)
"""Windows tried, as shares of the longest useful one."""


@dataclass(frozen=True)
class Samples:
    """Trajectory at a fixed period: time (k,) [s]; derivatives of position, each (k, d) [SI].

    `arc_length` (k,) [m] and `speed` (k,) [m/s] are those along the path.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    arc_length: Array
    speed: Array


@dataclass(frozen=True)
class Trajectory:
    """Motion along a path.

    Attributes
    ----------
    geometry : PathGeometry
        The path.
    time, arc_length, speed, acceleration : array, shape (k,)
        Motion before averaging: from each instant on, the acceleration is constant until the
        next [s, m, m/s, m/s^2].
    window : float
        Length of the average [s]; 0 for none.
    """

    geometry: PathGeometry
    time: Array
    arc_length: Array
    speed: Array
    acceleration: Array
    window: float = 0.0

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        return float(self.time[-1]) + self.window

    def along(self, time: ArrayLike) -> tuple[Array, Array, Array]:
        """Return arc length, speed and acceleration along the path at times (k,) [s]."""
        at = np.clip(np.asarray(time, dtype=float), 0.0, self.duration)
        if self.window == 0.0:
            return self._plain(at)
        here, speed_here, _ = self._plain(at)
        there, speed_there, _ = self._plain(at - self.window)
        mean = (self._area(at) - self._area(at - self.window)) / self.window
        return (
            np.asarray(mean, dtype=float),
            (here - there) / self.window,
            (speed_here - speed_there) / self.window,
        )

    def sample(self, period: float) -> Samples:
        """Return the trajectory every `period` [s]; the last sample is at or after the end.

        Raises
        ------
        ValueError
            If the period is not positive.
        """
        if not 0.0 < period < np.inf:
            raise ValueError(f'period: expected a positive number of s, but found {period}')
        time = period * np.arange(int(np.ceil(self.duration / period - 1e-9)) + 1)
        place, speed, rise = self.along(time)
        tangent, bend = (self.geometry.evaluate(place, order) for order in (1, 2))
        velocity = tangent * speed[:, np.newaxis]
        return Samples(
            np.asarray(time, dtype=float),
            self.geometry.evaluate(place),
            velocity,
            tangent * rise[:, np.newaxis] + bend * speed[:, np.newaxis] ** 2,
            place,
            np.asarray(np.linalg.norm(velocity, axis=1), dtype=float),
        )

    def speed_at(self, arc_length: ArrayLike) -> Array:
        """Return the speeds at places on the path, shape (k,) [m/s]."""
        place = np.asarray(arc_length, dtype=float)
        if self.window == 0.0:
            moving = np.append(np.diff(self.arc_length) > 0.0, True)
            square = np.interp(place, self.arc_length[moving], self.speed[moving] ** 2)
            return np.asarray(np.sqrt(square))
        low, high = np.zeros(len(place)), np.full(len(place), self.duration)
        for _ in range(52):  # halves the interval down to the spacing of doubles
            middle = 0.5 * (low + high)
            late = self.along(middle)[0] >= place
            low, high = np.where(late, low, middle), np.where(late, middle, high)
        return self.along(high)[1]

    def _plain(self, at: Array) -> tuple[Array, Array, Array]:
        """Motion before averaging, at rest before the start and after the end."""
        index = np.clip(np.searchsorted(self.time, at, 'right') - 1, 0, len(self.time) - 1)
        since = np.maximum(at - self.time[index], 0.0)
        rise = np.where(at < 0.0, 0.0, self.acceleration[index])
        speed = np.where(at < 0.0, 0.0, self.speed[index])
        return (
            self.arc_length[index] + (speed + 0.5 * rise * since) * since,
            np.maximum(speed + rise * since, 0.0),
            rise,
        )

    def _area(self, at: Array) -> Array:
        """Integral of arc length over time; in long doubles, for differences of it count."""
        index = np.clip(np.searchsorted(self.time, at, 'right') - 1, 0, len(self.time) - 1)
        # Before the start the path's beginning, arc length 0, adds nothing.
        since = np.maximum(at - self.time[index], 0.0)
        return np.asarray(
            self._areas[index]
            + self._piece(
                self.arc_length[index], self.speed[index], self.acceleration[index], since
            )
        )

    @cached_property
    def _areas(self) -> Array:
        """Integral of arc length up to each instant."""
        step = np.diff(self.time)
        piece = self._piece(self.arc_length[:-1], self.speed[:-1], self.acceleration[:-1], step)
        return np.append(np.longdouble(0.0), np.cumsum(piece))

    @staticmethod
    def _piece(place: Array, speed: Array, rise: Array, since: Array) -> Array:
        span = since.astype(np.longdouble)
        return np.asarray(span * (place + span * (speed / 2.0 + rise * span / 6.0)))


def limit_motion(
    geometry: PathGeometry,
    speed: ArrayLike,
    limits: MotionLimits,
    *,
    start: float = 0.0,
    end: float = 0.0,
    window: float | None = None,
) -> Trajectory:
    """Return the motion that follows the desired speeds as far as the limits allow.

    Parameters
    ----------
    geometry : PathGeometry
        Path of m segments; its corners are exact stops.
    speed : float or array, shape (m + 1,)
        Desired speeds at the nodes, above 0 [m/s]; lower values serve as given speeds of
        junctions.  Between nodes the square is linear.
    limits : MotionLimits
        Kept at every moment.
    start, end : float
        Speeds at the ends [m/s]; lower ones are taken where these cannot be had.  With limits of
        jerk both ends are at rest.
    window : float, optional
        Length of the average with limits of jerk [s]; by default the fastest of several.

    Raises
    ------
    ValueError
        If a speed is not positive and finite, a shape differs, or `start` or `end` is not 0
        where jerk is limited.
    """
    wanted = np.broadcast_to(np.asarray(speed, dtype=float), geometry.node.shape)
    good = (wanted > 0.0) & (wanted < np.inf)
    if not good.all():
        at = int(np.argmin(good))
        raise ValueError(
            f'speed: expected more than 0 m/s, but found {wanted[at]} at node {at}; corners of '
            'the path are stops by themselves'
        )
    if not (0.0 <= start < np.inf and 0.0 <= end < np.inf):
        raise ValueError(f'start, end: expected 0 m/s or more, but found {start} and {end}')
    fine = _refined(geometry, wanted, limits)
    square = np.interp(fine.node, geometry.node, wanted**2)
    if not limits.limits_jerk:
        square[[0, -1]] = np.minimum(square[[0, -1]], [start**2, end**2])
        return _timed(fine, fastest_speed(fine, square, limits))
    if start or end:
        raise ValueError(
            f'start, end: expected 0 m/s where jerk is limited, but found {start} and {end}'
        )
    if window is not None and not 0.0 < window < np.inf:
        raise ValueError(f'window: expected a positive number of s, but found {window}')
    shares = _shares(fine, square, limits)
    # A longer window than the longest of these admits no more acceleration anywhere.
    longest = 2.0 * float((shares.rise / shares.jolt).max())
    tried = [window] if window is not None else [longest * share for share in _WINDOWS]
    found = [_averaged(fine, shares, float(one)) for one in tried]
    return min(found, key=lambda one: one.duration)


def _refined(geometry: PathGeometry, wanted: Array, limits: MotionLimits) -> PathGeometry:
    """Cut segments that are long for a motion which is uniform in each."""
    table = limits.table(geometry.axes)
    fastest = min(float(wanted.max()), float(np.linalg.norm(table[0, 1:])), table[0, 0])
    braking = fastest**2 / (2.0 * min(table[1, 0], float(np.linalg.norm(table[1, 1:]))))
    length = np.diff(geometry.node)
    pieces = np.clip(np.ceil(length / (0.1 * braking)), 1, _PIECES_MAX).astype(int)
    rest = geometry.stop.copy()
    rest[[0, -1]] = True
    at_stop = rest[:-1] | rest[1:]
    pieces[at_stop] = np.maximum(pieces[at_stop], _AT_STOPS)
    return geometry.split(pieces)


def _timed(
    geometry: PathGeometry, square: Array, dwell: float = 0.0, window: float = 0.0
) -> Trajectory:
    """Return the motion with squared speeds at the nodes; it rests for `dwell` at stops."""
    speed = np.sqrt(square)
    step = np.diff(geometry.node)
    moving = 2.0 * step / (speed[:-1] + speed[1:])
    rise = np.append(np.diff(square) / (2.0 * step), 0.0)
    time = np.append(0.0, np.cumsum(moving + dwell * geometry.stop[:-1]))
    if dwell == 0.0:
        return Trajectory(geometry, time, geometry.node, speed, rise, window)
    corner = np.flatnonzero(geometry.stop)
    return Trajectory(
        geometry,
        np.insert(time, corner + 1, time[corner] + dwell),
        np.insert(geometry.node, corner + 1, geometry.node[corner]),
        np.insert(speed, corner + 1, 0.0),
        np.insert(rise, corner, 0.0),
        window,
    )


@dataclass(frozen=True)
class _Shares:
    """Largest squared speed, acceleration and jerk along the path in each segment, each (m,)."""

    cap: Array
    rise: Array
    jolt: Array


def _shares(geometry: PathGeometry, wanted: Array, limits: MotionLimits) -> _Shares:
    """Share the limits out so that all parts of an axis' acceleration and jerk fit at once.

    Of an acceleration, 0.7 may go to the curve, the rest to the change of speed.  Of a jerk, half
    may go to the change of the curve, then 0.3 of the rest to the curve while the speed changes.
    What a part leaves unused goes to the next.
    """
    velocity, acceleration, jerk = limits.table(geometry.axes)
    own, side, twist = (np.maximum(bound, 1e-12) for bound in geometry.bounds())
    cap = np.minimum(wanted[:-1], wanted[1:])
    for bound in (
        (velocity / own) ** 2,
        0.7 * acceleration / side,
        (0.5 * jerk / twist) ** (2.0 / 3.0),
    ):
        cap = np.minimum(cap, bound.min(axis=1))
    square, speed = cap[:, np.newaxis], np.sqrt(cap)[:, np.newaxis]
    left = jerk - twist * square * speed
    turning = 3.0 * side * speed
    rise = np.minimum((acceleration - side * square) / own, 0.3 * left / turning).min(axis=1)
    jolt = ((left - turning * rise[:, np.newaxis]) / own).min(axis=1)
    return _Shares(cap, rise, jolt)


def _averaged(geometry: PathGeometry, shares: _Shares, window: float) -> Trajectory:
    """Return the fastest motion whose average over `window` [s] keeps to the shares."""
    rise = np.minimum(shares.rise, 0.5 * window * shares.jolt)
    first = _timed(geometry, _swept(geometry, shares.cap, rise)).time
    # No motion within smaller limits covers the ground faster, so what comes within the window
    # of it lies among these segments, and on this side of every stop.
    low = np.searchsorted(first, first[:-1] - window, 'right') - 1
    high = np.searchsorted(first, first[1:] + window, 'left')
    inner = np.flatnonzero(geometry.stop)
    fence = np.concatenate([[0], inner, [len(rise)]])
    span = np.searchsorted(inner, np.arange(len(rise)), 'right')
    low = np.maximum(low, fence[span])
    high = np.minimum(high, fence[span + 1])
    cap, rise = (range_minimum(values, low, high) for values in (shares.cap, rise))
    return _timed(geometry, _swept(geometry, cap, rise), window, window)


def _swept(geometry: PathGeometry, cap: Array, rise: Array) -> Array:
    """Return the largest squared speeds at the nodes, at rest at the ends and at stops."""
    found = node_minimum(cap)
    found[[0, -1]] = 0.0
    found[geometry.stop] = 0.0
    gain = 2.0 * rise * np.diff(geometry.node)
    return sweep(sweep(found[::-1], gain[::-1])[::-1], gain)


def range_minimum(values: Array, low: Array, high: Array) -> Array:
    """Return the smallest of `values[low[k]:high[k]]` for every k; no range may be empty."""
    found = np.empty(len(low))
    level = np.frexp(high - low)[1] - 1  # largest power of two within the range
    table = values
    for power in range(int(level.max()) + 1):
        if power:
            half = 1 << (power - 1)
            table = np.minimum(table[:-half], table[half:])
        chosen = np.flatnonzero(level == power)
        found[chosen] = np.minimum(table[low[chosen]], table[high[chosen] - (1 << power)])
    return found
