# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Where planned motion can be changed, and what then leads on from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.pieces import Pieces
from fuzzycnc_ros.core.feedrate.motion.stream import MotionEntry, MotionStream
from fuzzycnc_ros.core.feedrate.motion.sweeps import Braking
from fuzzycnc_ros.core.feedrate.motion.trajectory import timed
from fuzzycnc_ros.core.feedrate.planner.braking import REMAINDER_MIN, strongest_braking
from fuzzycnc_ros.core.feedrate.planner.feeds import FeedPlan
from fuzzycnc_ros.core.feedrate.planner.planned_motion import PlannedMotion


@dataclass(frozen=True, eq=False)
class Cut:
    """State of motion before averaging, from which it may go on otherwise.

    Attributes
    ----------
    motion : PlannedMotion
        The motion up to here and, as planned, behind.
    time, rest : float
        When this is, and how long the motion rests here from then on [s].
    behind, ahead : Pieces
        The path before and after.
    rise : array, shape (m,)
        Largest change of speed that each piece ahead leaves, for motion that is averaged [m/s^2].
    place, square : array, shape (k,)
        Squared speeds planned ahead, to rest at the last place [m, m^2/s^2].
    """

    motion: PlannedMotion
    time: float
    rest: float
    behind: Pieces
    ahead: Pieces
    rise: Array
    place: Array
    square: Array

    def braking(self, table: Array) -> Braking:
        """Return the fastest way to rest, within a table of limits if motion is not averaged."""
        limits = self.rise if self.motion.window else table
        entry = float(self.square[0])
        return strongest_braking(self.ahead, entry, self.place, self.square, limits)

    def ended(self) -> PlannedMotion:
        """Return the motion up to here."""
        pieces = self.behind if len(self.behind) else self.ahead.part(0, 1)
        rows = self.motion.until(self.time, float(self.square[0]))
        return PlannedMotion(pieces, np.zeros(len(pieces)), *rows, self.motion.window)

    def braked(self, braking: Braking) -> PlannedMotion:
        """Return the motion up to here and to rest."""
        place = braking.place
        rows = self.motion.until(self.time, float(self.square[0]))
        if len(place) > 1:
            length = np.diff(place)
            more = timed(place, length, braking.lowest, np.zeros(len(length)), self.time)
            joined = [np.append(one[:-1], two) for one, two in zip(rows, more, strict=True)]
            rows = (joined[0], joined[1], joined[2], joined[3])
        end = max(int(np.searchsorted(self.ahead.place, place[-1])), 1)
        pieces = Pieces.join([self.behind, self.ahead.part(0, min(end, len(self.ahead)))])
        rise = np.append(np.zeros(len(self.behind)), self.rise[:end])
        return PlannedMotion(pieces, rise, *rows, self.motion.window)

    def entry(self, braking: Braking, feeds: FeedPlan) -> MotionEntry:
        """Return how motion within other limits or feeds takes over."""
        return MotionEntry(self.time, braking, self.rest, *self._lookback(feeds))

    def _lookback(self, feeds: FeedPlan) -> tuple[Pieces | None, Array | None]:
        """Return the pieces that the average still mixes in, and when they were passed."""
        window, pieces = self.motion.window, self.behind
        if not window or not len(pieces) or self.ahead.stop[0]:
            return None, None
        passed = self.motion.passed(pieces.place)
        passed[-1] = self.time
        stops = np.flatnonzero(pieces.stop[:-1])
        recent = int(np.searchsorted(passed[1:], self.time - window, 'right'))
        first = max(int(stops[-1]) if len(stops) else 0, recent)
        last = len(pieces) - int(pieces.length[-1] < REMAINDER_MIN)
        if first >= last:
            return None, None
        pieces = pieces.part(first, last)
        low, high = pieces.place[:-1], pieces.place[1:]
        if feeds.piece(low, high)[-1] < feeds.ready:
            pieces = pieces.with_square(feeds.square(low, high))
        return pieces, np.append(passed[first:last], self.time)


@dataclass(frozen=True, eq=False)
class Outlook:
    """All that is known of motion to come.

    Attributes
    ----------
    motion : PlannedMotion
        Motion that is final.
    stream : MotionStream or None
        What plans the motion behind it; nothing while the feed is held.
    entry : MotionEntry or None
        Motion that the stream took over, None at the path's start.
    pending : Pieces
        Pieces behind those of the stream.
    begin : float
        Place of the path's start [m].
    dwell : float
        Rest at stops within the path, besides the programmed one [s].
    resting : tuple of float or None
        When motion was cut last, and until when it rests there [s].
    """

    motion: PlannedMotion
    stream: MotionStream | None
    entry: MotionEntry | None
    pending: Pieces
    begin: float
    dwell: float
    resting: tuple[float, float] | None

    def cut(self, time: float) -> Cut:
        """Return the state of the motion at a time, or soon behind."""
        motion = self.motion
        place, speed, rest = motion.state(time)
        pieces, rises, at_place, square = self._ahead()
        at = int(np.clip(np.searchsorted(pieces.place, place, 'right') - 1, 0, len(pieces) - 1))
        left = float(pieces.place[at + 1]) - place
        if place > pieces.place[at] and speed > 0.0 and left < REMAINDER_MIN:
            # On to the end of the piece, as planned
            place = float(pieces.place[at + 1])
            fast = float(np.sqrt(np.interp(place, at_place, square, right=0.0)))
            time += 2.0 * max(left, 0.0) / (speed + fast)
            behind, front = pieces.divided(place)
            speed, rest = fast, self._rest_at(front)
        else:
            behind, front = pieces.divided(place)
            if speed > 0.0 and (not len(front) or front.stop[0]):
                speed, rest = 0.0, self._rest_at(front)  # arriving, all but for rounding
            elif speed == 0.0 and time >= motion.time[-1]:
                rest = self._rest_left(front, time)
        further = at_place > place
        return Cut(
            motion,
            time,
            rest,
            behind,
            front,
            rises[len(pieces) - len(front) :],
            np.append(place, at_place[further]),
            np.append(speed**2, square[further]),
        )

    def _ahead(self) -> tuple[Pieces, Array, Array, Array]:
        """Return all pieces, their largest changes of speed, and the plan to rest."""
        motion = self.motion
        pieces, rise = [motion.pieces], [motion.rise]
        place, square = motion.arc_length, motion.speed**2
        if self.stream is not None:
            pieces.append(self.stream.waiting)
            rise.append(np.zeros(len(pieces[-1])))
            more_place, more, more_rise = self.stream.to_rest()
            if more_rise is not None:
                rise[-1][: len(more_rise)] = more_rise
            place, square = np.append(place, more_place[1:]), np.append(square, more[1:])
            if square[-1] > 0.0 and self.entry is not None:
                # What the stream knows does not suffice, but when it began, a way to rest was.
                braking = self.entry.braking
                behind = braking.place > place[-1]
                place = np.append(place, braking.place[behind])
                square = np.append(square, braking.lowest[behind])
        pieces.append(self.pending)
        rise.append(np.zeros(len(self.pending)))
        following = [some for some in pieces[1:] if len(some)]
        if following and following[0].place[0] < motion.pieces.place[-1]:
            # Before any motion, the first piece is there to tell the position only.
            pieces, rise = pieces[1:], rise[1:]
        return Pieces.join(pieces), np.concatenate(rise), place, square

    def _rest_at(self, front: Pieces) -> float:
        """Return how long the motion rests at the beginning of some pieces [s]."""
        if not len(front) or not front.stop[0]:
            return 0.0
        if front.place[0] <= self.begin:
            return float(front.rest[0])
        return float(front.rest[0]) + self.dwell

    def _rest_left(self, front: Pieces, time: float) -> float:
        """Return how long the motion has to rest yet behind its last instant [s]."""
        arrived = float(self.motion.time[-1])
        if self.resting is not None and self.resting[0] == arrived:
            return max(self.resting[1] - time, 0.0)
        return max(arrived + self._rest_at(front) - time, 0.0)
