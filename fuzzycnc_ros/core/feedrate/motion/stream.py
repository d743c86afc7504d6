# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Motion along a path that arrives in parts, the same as along the whole path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.pieces import Pieces, squares
from fuzzycnc_ros.core.feedrate.motion.profiles import AverageProfile, BandProfile, SpeedProfile
from fuzzycnc_ros.core.feedrate.motion.sweeps import Braking
from fuzzycnc_ros.core.feedrate.motion.trajectory import timed
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.reference.reference_path import ReferencePath

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


class MotionStream:
    """`limit_motion` for a path that arrives in parts, with bounded memory.

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
        self._profile: SpeedProfile
        if window:
            behind, passed = (None, None) if entry is None else (entry.behind, entry.passed)
            self._profile = AverageProfile(self._table, window, braking, behind, passed)
        else:
            self._profile = BandProfile(self._table, braking)
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
        if (square > self._feed_max**2 * (1.0 + 1e-9)).any():
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
