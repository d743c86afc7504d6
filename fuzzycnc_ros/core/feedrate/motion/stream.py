# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Motion along a path that arrives in parts, the same as along the whole path.

Limits of jerk are shared out so that the average over a window in time of a motion keeps them.  An
average of length tau of accelerations up to a changes by at most 2 a / tau per second.  It also
mixes places up to tau apart, so every limit is first replaced by the smallest within tau: the
average then obeys the limits of the place it leads to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.axis_limits import acceleration_bands
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.pieces import Pieces, squares
from fuzzycnc_ros.core.feedrate.motion.sweeps import BandSweep, Braking, RiseSweep
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.path.reference_path import ReferencePath

_CHUNK = 8192
"""Pieces whose bounds are held at a time."""
_AVERAGE_EDGE = 1.0 + 1e-9
"""Pieces at the very edge of a window count, which rounding may move: factor."""


@dataclass(frozen=True)
class _Shares:
    """Largest squared speed, acceleration and jerk along the path in each piece, each (m,)."""

    cap: Array
    rise: Array
    jolt: Array


def _share_limits(geometry: PathGeometry, square: Array, table: Array) -> _Shares:
    """Share the limits out so that all parts of an axis' acceleration and jerk fit at once.

    Of an acceleration, 0.7 may go to the curve, the rest to the change of speed.  Of a jerk, half
    may go to the change of the curve, then 0.3 of the rest to the curve while the speed changes.
    What a part leaves unused goes to the next.

    Parameters
    ----------
    geometry : PathGeometry
        Path of m pieces.
    square : array, shape (m, 2)
        Squared desired speeds at both ends of each [m^2/s^2].
    table : array, shape (3, d + 1)
        Limits as `MotionLimits.table` gives them.
    """
    found = np.empty((3, len(square)))
    for begin in range(0, len(square), _CHUNK):
        chosen = slice(begin, begin + _CHUNK)
        found[:, chosen] = _shares(
            geometry.part(begin, begin + _CHUNK), square[chosen].min(axis=1), table
        )
    return _Shares(*found)


def _shares(geometry: PathGeometry, cap: Array, table: Array) -> Array:
    velocity, acceleration, jerk = table
    own, side, twist = (np.maximum(bound, 1e-12) for bound in geometry.bounds())
    for bound in (
        np.square(velocity / own),
        0.7 * acceleration / side,
        np.square(portable.cube_root(0.5 * jerk / twist)),
    ):
        cap = np.minimum(cap, bound.min(axis=1))
    square, speed = cap[:, np.newaxis], np.sqrt(cap)[:, np.newaxis]
    left = jerk - twist * square * speed
    turning = 3.0 * side * speed
    rise = np.minimum((acceleration - side * square) / own, 0.3 * left / turning).min(axis=1)
    jolt = ((left - turning * rise[:, np.newaxis]) / own).min(axis=1)
    return np.stack([cap, rise, jolt])


def _windows(
    time: Array, stop: NDArray[np.bool_], window: float, begin: int, end: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which pieces come within a window in time of pieces `begin` to `end`.

    Parameters
    ----------
    time : array, shape (m + 1,)
        When a motion that is nowhere slower passes the nodes [s].
    stop : array of bool, shape (m + 1,)
        Nodes across which windows do not reach.
    window : float
        Length [s].
    begin, end : int
        Pieces from `begin` up to, without, `end`.

    Returns
    -------
    low, high : array of int, shape (end - begin,)
        Pieces from `low` up to, without, `high`.
    """
    reach = window * _AVERAGE_EDGE
    low = np.searchsorted(time, time[begin:end] - reach, 'right') - 1
    high = np.searchsorted(time, time[begin + 1 : end + 1] + reach, 'left')
    inner = np.flatnonzero(stop[1:-1]) + 1
    fence = np.concatenate([[0], inner, [len(time) - 1]])
    span = np.searchsorted(inner, np.arange(begin, end), 'right')
    return np.maximum(low, fence[span]), np.minimum(high, fence[span + 1])


def range_minimum(values: Array, low: NDArray[np.intp], high: NDArray[np.intp]) -> Array:
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


@dataclass(frozen=True, eq=False)
class _Profile:
    """Squared speeds at k + 1 nodes, the first the last one of the profile before.

    `rise` holds the largest change of speed that each of the k pieces leaves, if motion is
    averaged [m/s^2].
    """

    square: Array
    rise: Array | None = None


class _SpeedProfile(Protocol):
    """Speed profile: turns pieces into speeds."""

    def push(self, pieces: Pieces) -> None:
        """Take the next pieces."""
        ...

    def settle(self, *, ended: bool = False) -> _Profile:
        """Return what is final now, all of it if the path has ended."""
        ...

    def to_rest(self) -> _Profile:
        """Return how the motion could go on from what is final to rest on known pieces."""
        ...


class _BandProfile:
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

    def settle(self, *, ended: bool = False) -> _Profile:
        """Return what is final now."""
        return _Profile(self._sweep.settle(ended=ended))

    def to_rest(self) -> _Profile:
        """Return how the motion could go on to rest."""
        return _Profile(self._sweep.to_rest())


class _AverageProfile:
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

    def push(self, pieces: Pieces, shares: _Shares | None = None) -> None:
        """Take the next pieces, and their shares of the limits where they are known already."""
        cap, rise = self._note(pieces, shares)
        self._first.push(pieces.place, cap, 2.0 * rise * pieces.length, pieces.stop)

    def settle(self, *, ended: bool = False) -> _Profile:
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
            low, high = _windows(self._time, stop, self._window, done, end)
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
        return _Profile(square, found)

    def _windows_known(self) -> int:
        """Return how many pieces have all that their windows reach ahead."""
        known = len(self._time) - 1
        reach = self._window * _AVERAGE_EDGE
        by_time = int(np.searchsorted(self._time[1:], self._time[-1] - reach, 'right'))
        stops = np.flatnonzero(self._stop[: known + 1])
        return min(max(by_time, int(stops[-1]) if len(stops) else 0), known)

    def _forget(self) -> None:
        """Drop what no window reaches any more."""
        reach = self._window * _AVERAGE_EDGE
        by_time = int(np.searchsorted(self._time, self._time[self._done] - reach, 'right')) - 1
        stops = np.flatnonzero(self._stop[: self._done + 1])
        # One more, for the sum that a window's edge was found with may round the other way.
        count = max(by_time - 1, int(stops[-1]) if len(stops) else 0, 0)
        self._limit, self._length = self._limit[:, count:], self._length[count:]
        self._place, self._stop = self._place[count:], self._stop[count:]
        self._time = self._time[count:]
        self._done -= count

    def to_rest(self) -> _Profile:
        """Return how the motion could go on to rest."""
        return _Profile(self._second.to_rest(), self._rise)

    def _note(self, pieces: Pieces, shares: _Shares | None = None) -> Array:
        """Keep the largest squared speeds and accelerations of the next pieces; return them."""
        if shares is None:
            shares = _share_limits(pieces.geometry, pieces.square, self._table)
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


_GROUP = 4096
"""Pieces taken at a time."""


@dataclass(frozen=True, eq=False)
class MotionPart:
    """Final motion along some pieces, before averaging.

    Attributes
    ----------
    pieces : Pieces
        The m pieces.
    time, arc_length, speed, acceleration : array, shape (k,)
        From each instant on, the acceleration is constant until the next [s, m, m/s, m/s^2]; time
        and arc length from the start of the whole path.  The first instant is the last of the
        part before.
    rise : array, shape (m,), or None
        With an average, the largest change of speed that each piece leaves [m/s^2].
    """

    pieces: Pieces
    time: Array
    arc_length: Array
    speed: Array
    acceleration: Array
    rise: Array | None = None

    @property
    def geometry(self) -> PathGeometry:
        """The pieces, node from 0."""
        return self.pieces.geometry

    @property
    def place(self) -> float:
        """Arc length of their first node from the start of the whole path [m]."""
        return float(self.pieces.place[0])


@dataclass(frozen=True, eq=False)
class MotionEntry:
    """Motion under way from which a stream takes over.

    Attributes
    ----------
    time : float
        When it does [s].
    braking : Braking
        The motion; its first place is that of the first piece to come.
    rest : float
        How long the motion rests there first [s].
    behind : Pieces or None
        With an average, the pieces passed within the window before; desired speeds as for those
        to come.
    passed : array, shape (m + 1,), or None
        When the nodes of these were passed [s].
    """

    time: float
    braking: Braking
    rest: float = 0.0
    behind: Pieces | None = None
    passed: Array | None = None


_WINDOWS = tuple(2.0**power for power in range(-6, 1))
"""Windows tried, as shares of the longest useful one."""


def fastest_window(pieces: Pieces, table: Array, feed_max: float) -> float:
    """Return that of several lengths of the average with which a path takes the least time [s].

    Parameters
    ----------
    pieces : Pieces
        The whole path, with squared desired speeds.
    table : array, shape (3, d + 1)
        Limits as `MotionLimits.table` gives them, jerk among them.
    feed_max : float
        No desired speed is above it [m/s].
    """
    fine = pieces.fine(table, feed_max)
    shares = _share_limits(fine.geometry, fine.square, table)
    # A longer window than the longest of these admits no more acceleration anywhere.
    longest = 2.0 * float((shares.rise / shares.jolt).max())

    def duration(window: float) -> float:
        profile = _AverageProfile(table, window)
        profile.push(fine, shares)
        speed = np.sqrt(profile.settle(ended=True).square)
        moving = float((2.0 * fine.length / (speed[:-1] + speed[1:])).sum())
        return moving + window * int(fine.stop[1:].sum())

    return min((longest * share for share in _WINDOWS), key=duration)


def default_window(limits: MotionLimits, axes: int, feed_max: float) -> float:
    """Return the length of the average that suits some limits [s]; 0 without limits of jerk.

    An average of length tau changes accelerations up to a by 2 a / tau per second.  One of 2 a / j
    leaves all of the acceleration a, but takes as long at every stop; to reach speed v and
    no more, sqrt(2 v / j) is the fastest.
    """
    if not limits.limits_jerk:
        return 0.0
    velocity, acceleration, jerk = limits.table(axes).min(axis=1)
    fastest = min(float(velocity), feed_max)
    return float(min(2.0 * acceleration / jerk, np.sqrt(2.0 * fastest / jerk)))


def timed(
    place: Array, length: Array, square: Array, dwell: Array, start: float
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


class MotionStream:
    """The motion along a path that arrives in parts, within limits and with bounded memory.

    Motion leaves as soon as no continuation of the path can change it.  Given the same window and
    `feed_max`, it is that of the whole path, however the path is cut into parts.

    Parameters
    ----------
    limits : MotionLimits
        Kept at every moment.
    axes : int
        Number of axes of the path.
    feed_max : float
        No desired speed is above it [m/s].
    window : float, optional
        Length of the average [s]; by default `default_window`.
    settle : float
        Rest at every stop within the path besides the programmed one [s].
    entry : MotionEntry, optional
        Motion under way; by default the path starts at rest at time 0.

    Raises
    ------
    ValueError
        If the limits do not fit the axes, or a number is out of its range.
    """

    def __init__(
        self,
        limits: MotionLimits,
        axes: int,
        *,
        feed_max: float,
        window: float | None = None,
        settle: float = 0.0,
        entry: MotionEntry | None = None,
    ) -> None:
        if not 0.0 < feed_max < np.inf:
            raise ValueError(f'feed_max: expected a positive number of m/s, but found {feed_max}')
        if not 0.0 <= settle < np.inf:
            raise ValueError(f'settle: expected 0 s or more, but found {settle}')
        if window is None:
            window = default_window(limits, axes, feed_max)
        elif not 0.0 < window < np.inf:
            raise ValueError(f'window: expected a positive number of s, but found {window}')
        self.window = window
        self._axes, self._table = axes, limits.table(axes)
        self._feed_max, self._settle = feed_max, settle
        self._time = 0.0 if entry is None else entry.time
        self._rest = None if entry is None else entry.rest  # at the first node, if given
        braking = None if entry is None else entry.braking
        self._resting = braking is None or braking.lowest[0] == 0.0
        self._profile: _SpeedProfile
        if window:
            behind, passed = (None, None) if entry is None else (entry.behind, entry.passed)
            self._profile = _AverageProfile(self._table, window, braking, behind, passed)
        else:
            self._profile = _BandProfile(self._table, braking)
        self._fine: Pieces | None = None  # pieces that wait for their speeds
        self._held: Pieces | None = None  # the last piece, whose end may be that of the path
        self._begun = entry is not None  # motion has left or is under way
        self._end: float | None = None  # place where the last piece ends
        self._ended = False

    def push(self, path: ReferencePath, speed: ArrayLike) -> list[MotionPart]:
        """Take the next part of the path; return the motion that is final now.

        Parameters
        ----------
        path : ReferencePath
            Part of m pieces.
        speed : array, shape (m + 1,) or (m, 2)
            Desired speeds at the nodes, or at both ends of each piece where they jump, above 0
            and at most `feed_max` [m/s].

        Raises
        ------
        ValueError
            If the part has other axes, does not begin where the one before ended, a speed is out
            of its range, or the stream has been finished.  Nothing is taken then.
        """
        if path.geometry.axes != self._axes:
            raise ValueError(f'path: expected {self._axes} axes, but found {path.geometry.axes}')
        square = squares(speed, len(path.geometry.coefficient))
        if (square > self._feed_max * self._feed_max * (1.0 + 1e-9)).any():
            raise ValueError(
                f'speed: expected at most feed_max, {self._feed_max} m/s, but found '
                f'{np.sqrt(square.max())} m/s'
            )
        return self.take(Pieces.of_path(path, square))

    def take(self, pieces: Pieces) -> list[MotionPart]:
        """Take pieces as `push` does."""
        if self._ended:
            raise ValueError('expected no more of the path, for it has been finished')
        if self._end is not None and abs(self._end - pieces.place[0]) > 1e-9:
            raise ValueError(
                f'path: expected it to go on at {self._end} m, where the last part ended, but '
                f'found {pieces.place[0]} m'
            )
        if self._end is None:
            pieces.stop[0] |= not self._begun
        self._end = float(pieces.place[-1])
        if self._held is not None:
            pieces = Pieces.join([self._held, pieces])
            self._held = None
        if not pieces.stop[-1] and pieces.whole[-1]:
            self._held = pieces.part(len(pieces) - 1, len(pieces))
            pieces = pieces.part(0, len(pieces) - 1)
        return self._plan(pieces)

    def finish(self) -> list[MotionPart]:
        """Return the rest of the motion: the path ends here, at rest."""
        if self._ended:
            return []
        held, self._held, self._ended = self._held, None, True
        found: list[MotionPart] = []
        if held is not None:
            held.stop[-1] = True
            found = self._plan(held)
        found += self._leave(ended=True)
        if self._fine is not None and self._fine.rest[-1] > 0.0:
            still = np.zeros(2)
            time = np.array([self._time, self._time + self._fine.rest[-1]])
            place = self._fine.place[-1] + still
            found.append(MotionPart(self._fine, time, place, still, still))
        return found

    @property
    def waiting(self) -> Pieces:
        """Pieces that have arrived and whose motion is not final."""
        parts = [part for part in (self._fine, self._held) if part is not None]
        return Pieces.join(parts) if parts else Pieces.none(self._axes)

    def to_rest(self) -> tuple[Array, Array, Array | None]:
        """Return how the motion could go on from what is final to rest on the path.

        Returns
        -------
        place, square : array, shape (k + 1,)
            Nodes, the first ones that wait [m], and squared speeds there [m^2/s^2].
        rise : array, shape (k,), or None
            As that of `MotionPart`.
        """
        if self._fine is None:
            return np.zeros(0), np.zeros(0), None
        profile = self._profile.to_rest()
        return self._fine.place[: len(profile.square)], profile.square, profile.rise

    def _plan(self, pieces: Pieces) -> list[MotionPart]:
        """Take pieces whose ends are known."""
        found = []
        if len(pieces):
            fine = pieces.fine(self._table, self._feed_max, resting=self._resting)
            self._resting = False
            for begin in range(0, len(fine), _GROUP):
                some = fine.part(begin, min(begin + _GROUP, len(fine)))
                self._profile.push(some)
                self._fine = some if self._fine is None else Pieces.join([self._fine, some])
                found += self._leave()
        return found

    def _leave(self, *, ended: bool = False) -> list[MotionPart]:
        """Return the motion that is final now."""
        if self._fine is None:
            return []
        profile = self._profile.settle(ended=ended)
        count = len(profile.square) - 1
        if count == 0:
            return []
        some, self._fine = self._fine.part(0, count), self._fine.part(count, len(self._fine))
        dwell = np.where(some.stop, some.rest + self._settle + self.window, 0.0)[:-1]
        if self._rest is not None:
            dwell[0], self._rest = self._rest, None
        elif not self._begun:
            dwell[0] = some.rest[0]
        self._begun = True
        motion = timed(some.place, some.length, profile.square, dwell, self._time)
        self._time = float(motion[0][-1])
        return [MotionPart(some, *motion, profile.rise)]
