# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Squared speeds within the limits along pieces that arrive one after the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.average import (
    WINDOW_EDGE,
    range_minimum,
    share_limits,
    windows,
)
from fuzzycnc_ros.core.feedrate.motion.axis_limits import acceleration_bands
from fuzzycnc_ros.core.feedrate.motion.pieces import Pieces
from fuzzycnc_ros.core.feedrate.motion.sweeps import BandSweep, Braking, RiseSweep


@dataclass(frozen=True, eq=False)
class Profile:
    """Squared speeds at k + 1 nodes, the first the last one of the profile before.

    `rise` holds the largest change of speed that each of the k pieces leaves, if motion is
    averaged [m/s^2].
    """

    square: Array
    rise: Array | None = None


class SpeedProfile(Protocol):
    """What turns pieces into speeds."""

    def push(self, pieces: Pieces) -> None:
        """Take the next pieces."""
        ...

    def settle(self, *, ended: bool = False) -> Profile:
        """Return what is final now, all of it if the path has ended."""
        ...

    def to_rest(self) -> Profile:
        """Return how the motion could go on from what is final to rest on known pieces."""
        ...


class BandProfile:
    """Speeds within the limits of velocity and acceleration of the path and the axes.

    Parameters
    ----------
    table : array, shape (3, d + 1)
        Limits as `MotionLimits.table` gives them.
    braking : Braking, optional
        Motion that is under way; by default the path starts at rest.
    """

    def __init__(self, table: Array, braking: Braking | None = None) -> None:
        self._table = table
        self._sweep = BandSweep(braking)

    def push(self, pieces: Pieces) -> None:
        """Take the next pieces."""
        bands = acceleration_bands(pieces.geometry, self._table)
        self._sweep.push(pieces.place, bands, pieces.square, pieces.stop)

    def settle(self, *, ended: bool = False) -> Profile:
        """Return what is final now."""
        return Profile(self._sweep.settle(ended=ended))

    def to_rest(self) -> Profile:
        """Return how the motion could go on to rest."""
        return Profile(self._sweep.to_rest())


class AverageProfile:
    """Speeds whose average over a window in time keeps all limits, those of jerk too.

    Three stages: the fastest motion within speed and acceleration tells what comes within the
    window of a piece; the smallest limits of that; the fastest motion within them.

    Parameters
    ----------
    table : array, shape (3, d + 1)
        Limits as `MotionLimits.table` gives them.
    window : float
        Length of the average [s].
    braking : Braking, optional
        Motion that is under way; by default the path starts at rest.
    behind : Pieces, optional
        Pieces before the first that come within the window of it.
    passed : array, shape (m + 1,), optional
        When the motion passed their nodes [s].
    """

    def __init__(
        self,
        table: Array,
        window: float,
        braking: Braking | None = None,
        behind: Pieces | None = None,
        passed: Array | None = None,
    ) -> None:
        self._table, self._window = table, window
        self._first, self._second = RiseSweep(braking), RiseSweep(braking)
        # Of the pieces that windows still reach, and all behind them
        self._limit = np.empty((2, 0))  # largest squared speed and acceleration
        self._length = np.empty(0)
        self._place, self._stop = np.empty(0), np.empty(0, bool)
        self._time = np.zeros(1)  # of the nodes that the first sweep has settled
        self._done = 0  # pieces that have passed on to the second sweep
        self._rise = np.empty(0)  # of the pieces that wait there
        if behind is not None and passed is not None and len(behind):
            self._note(behind)
            self._time, self._done = passed, len(behind)

    def push(self, pieces: Pieces) -> None:
        """Take the next pieces."""
        cap, rise = self._note(pieces)
        self._first.push(pieces.place, cap, 2.0 * rise * pieces.length, pieces.stop)

    def settle(self, *, ended: bool = False) -> Profile:
        """Return what is final now."""
        speed = np.sqrt(self._first.settle(ended=ended))
        known = len(self._time) - 1
        length = self._length[known : known + len(speed) - 1]
        moving = 2.0 * length / (speed[:-1] + speed[1:])
        self._time = np.append(self._time[:-1], np.cumsum(np.append(self._time[-1], moving)))
        known = len(self._time) - 1
        done, end = self._done, known if ended else self._windows_known()
        if end > done:
            stop = self._stop[: known + 1]
            low, high = windows(self._time, stop, self._window, done, end)
            cap, rise = (range_minimum(values, low, high) for values in self._limit)
            nodes = slice(done, end + 1)
            gain = 2.0 * rise * self._length[done:end]
            self._second.push(self._place[nodes], cap, gain, self._stop[nodes])
            self._rise = np.append(self._rise, rise)
            self._done = end
            self._forget()
        square = self._second.settle(ended=ended)
        count = len(square) - 1
        found, self._rise = self._rise[:count], self._rise[count:]
        return Profile(square, found)

    def _windows_known(self) -> int:
        """Return how many pieces have all that their windows reach ahead."""
        known = len(self._time) - 1
        reach = self._window * WINDOW_EDGE
        by_time = int(np.searchsorted(self._time[1:], self._time[-1] - reach, 'right'))
        stops = np.flatnonzero(self._stop[: known + 1])
        return min(max(by_time, int(stops[-1]) if len(stops) else 0), known)

    def _forget(self) -> None:
        """Drop what no window reaches any more."""
        reach = self._window * WINDOW_EDGE
        by_time = int(np.searchsorted(self._time, self._time[self._done] - reach, 'right')) - 1
        stops = np.flatnonzero(self._stop[: self._done + 1])
        # One more, for the sum that a window's edge was found with may round the other way.
        count = max(by_time - 1, int(stops[-1]) if len(stops) else 0, 0)
        self._limit, self._length = self._limit[:, count:], self._length[count:]
        self._place, self._stop = self._place[count:], self._stop[count:]
        self._time = self._time[count:]
        self._done -= count

    def to_rest(self) -> Profile:
        """Return how the motion could go on to rest."""
        return Profile(self._second.to_rest(), self._rise)

    def _note(self, pieces: Pieces) -> Array:
        """Keep the largest squared speeds and accelerations of the next pieces; return them."""
        shares = share_limits(pieces.geometry, pieces.square, self._table)
        rise = np.minimum(shares.rise, 0.5 * self._window * shares.jolt)
        found = np.stack([shares.cap, rise])
        self._limit = np.concatenate([self._limit, found], axis=1)
        self._length = np.append(self._length, pieces.length)
        stop = pieces.stop.copy()
        if len(self._stop):
            stop[0] |= self._stop[-1]
        self._stop = np.concatenate([self._stop[:-1], stop])
        self._place = np.append(self._place[:-1], pieces.place)
        return found
