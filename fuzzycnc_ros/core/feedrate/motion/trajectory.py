# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories: positions over time within limits of velocity, acceleration and jerk.

Without limits of jerk the squared speed runs straight between the nodes (`axis_limits`).  With
them, the limits at each place are first shared out into the largest speed, acceleration and jerk
along the path; the fastest motion within speed and acceleration is then averaged over a window in
time (`motion_average`).  At stops the motion rests for the length of the window.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.average import (
    Shares,
    range_minimum,
    share_limits,
    windows,
)
from fuzzycnc_ros.core.feedrate.motion.axis_limits import fastest_speed, node_minimum
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits, sweep
from fuzzycnc_ros.core.feedrate.motion.pieces import Pieces, squares
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry

_WINDOWS = 2.0 ** np.arange(-6, 1)
"""Windows tried, as shares of the longest useful one."""


@dataclass(frozen=True)
class _Samples:
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

    def sample(self, period: float) -> _Samples:
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
        return _Samples(
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
    feed_max: float | None = None,
) -> Trajectory:
    """Return the motion that follows the desired speeds as far as the limits allow.

    Parameters
    ----------
    geometry : PathGeometry
        Path of m segments; its corners are exact stops.
    speed : float or array, shape (m + 1,) or (m, 2)
        Desired speeds at the nodes, or at both ends of each segment where they jump, above 0
        [m/s]; lower values serve as given speeds of junctions.  In between the square is linear.
    limits : MotionLimits
        Kept at every moment.
    start, end : float
        Speeds at the ends [m/s]; lower ones are taken where these cannot be had.  With an average
        both ends are at rest.
    window : float, optional
        Length of the average [s]; by default the fastest of several with limits of jerk, and no
        average without.
    feed_max : float, optional
        Speed that segments are cut for [m/s]; by default the largest desired one.

    Raises
    ------
    ValueError
        If a speed is not positive and finite, a shape differs, or `start` or `end` is not 0
        where the motion is averaged.
    """
    pieces = Pieces.of_geometry(geometry, squares(speed, len(geometry.coefficient)))
    if not (0.0 <= start < np.inf and 0.0 <= end < np.inf):
        raise ValueError(f'start, end: expected 0 m/s or more, but found {start} and {end}')
    table = limits.table(geometry.axes)
    fine = pieces.fine(table, feed_max or float(np.sqrt(pieces.square.max())))
    if window is None and not limits.limits_jerk:
        cap = np.minimum(
            np.append(fine.square[:, 0], np.inf), np.append(np.inf, fine.square[:, 1])
        )
        cap[[0, -1]] = np.minimum(cap[[0, -1]], [start**2, end**2])
        return _timed(fine.geometry, fastest_speed(fine.geometry, cap, limits))
    if start or end:
        raise ValueError(
            f'start, end: expected 0 m/s where jerk is limited, but found {start} and {end}'
        )
    if window is not None and not 0.0 < window < np.inf:
        raise ValueError(f'window: expected a positive number of s, but found {window}')
    shares = share_limits(fine.geometry, fine.square, table)
    # A longer window than the longest of these admits no more acceleration anywhere.
    longest = 2.0 * float((shares.rise / shares.jolt).max())
    tried = [window] if window is not None else [longest * share for share in _WINDOWS]
    found = [_averaged(fine.geometry, shares, float(one)) for one in tried]
    return min(found, key=lambda one: one.duration)


def timed(
    place: Array, length: Array, square: Array, dwell: Array, start: float = 0.0
) -> tuple[Array, Array, Array, Array]:
    """Return time, arc length, speed and acceleration at the instants of a motion.

    Parameters
    ----------
    place, square : array, shape (m + 1,)
        Arc length [m] and squared speeds [m^2/s^2] at the nodes, the square linear in between.
    length : array, shape (m,)
        Lengths of the pieces [m].
    dwell : array, shape (m,)
        Rests at the first m nodes, at which the speed is 0 where they are not [s].
    start : float
        When the motion comes to the first node [s].
    """
    speed = np.sqrt(square)
    moving = 2.0 * length / (speed[:-1] + speed[1:])
    rise = np.append(np.diff(square) / (2.0 * length), 0.0)
    time = np.cumsum(np.append(start, moving + dwell))
    rests = np.flatnonzero(dwell)
    if not len(rests):
        return time, place, speed, rise
    return (
        np.insert(time, rests + 1, time[rests] + dwell[rests]),
        np.insert(place, rests + 1, place[rests]),
        np.insert(speed, rests + 1, 0.0),
        np.insert(rise, rests, 0.0),
    )


def _timed(
    geometry: PathGeometry, square: Array, dwell: float = 0.0, window: float = 0.0
) -> Trajectory:
    """Return the motion with squared speeds at the nodes; it rests for `dwell` at stops."""
    rests = np.where(geometry.stop[:-1], dwell, 0.0)
    motion = timed(geometry.node, np.diff(geometry.node), square, rests)
    return Trajectory(geometry, *motion, window)


def _averaged(geometry: PathGeometry, shares: Shares, window: float) -> Trajectory:
    """Return the fastest motion whose average over `window` [s] keeps to the shares."""
    rise = np.minimum(shares.rise, 0.5 * window * shares.jolt)
    first = _timed(geometry, _swept(geometry, shares.cap, rise)).time
    # No motion within smaller limits covers the ground faster, so what comes within the window
    # of it lies among these segments, and on this side of every stop.
    low, high = windows(first, geometry.stop, window, 0, len(rise))
    cap, rise = (range_minimum(values, low, high) for values in (shares.cap, rise))
    return _timed(geometry, _swept(geometry, cap, rise), window, window)


def _swept(geometry: PathGeometry, cap: Array, rise: Array) -> Array:
    """Return the largest squared speeds at the nodes, at rest at the ends and at stops."""
    found = node_minimum(cap)
    found[[0, -1]] = 0.0
    found[geometry.stop] = 0.0
    gain = 2.0 * rise * np.diff(geometry.node)
    return sweep(sweep(found[::-1], gain[::-1])[::-1], gain)
