# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The positions that a controller with look-ahead commands, period by period."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.simulation.controller.blends import (
    OVERLAP,
    STOP,
    TANGENT,
    ControllerLimits,
    Corners,
    Plan,
    PlannedPart,
)
from fuzzycnc_ros.simulation.controller.moves import Moves, merged

_PLACE, _DIGITS = 1e-15, 4e-16
"""Way that counts as none [m], and share of a way that numbers do not tell from none [-]."""
_PACE = 1e-11
"""Speed that counts as none [m/s]."""
_INSTANT = 1e-12
"""Time that counts as none [s]."""
_NEAR = 3
"""Periods before the end of a segment that are gone through one by one."""
_FAR = _NEAR + 2.9
"""Periods before its end from which on some may be gone through together [-]."""
_SURE = 1.0 + 1e-9
"""Factor beyond what numbers leave unsure [-]."""


@dataclass(frozen=True, eq=False)
class Commanded:
    """Positions that a controller commands, m samples a period apart.

    Attributes
    ----------
    position : ndarray, shape (m, 3)
        [m]
    place : ndarray, shape (m,)
        Way along the programmed path [m].
    duration : float
        Time of the motion and its waits [s].
    """

    position: Array
    place: Array
    duration: float


def chains(moves: Moves) -> list[tuple[Moves, Corners]]:
    """Return moves as the planner gets them, and their corners: what no limit changes.

    Lines are merged, and moves cut where the program stands still.

    Parameters
    ----------
    moves : Moves
        At least one move; only the first one begins a path.
    """
    moves = merged(moves)
    # there the planner is empty
    last = np.flatnonzero(moves.stop[:-1]) + 1
    edges = pairwise([0, *last.tolist(), len(moves)])
    parts = [moves.chosen(np.arange(low, high)) for low, high in edges]
    return [(part, Corners.of(part)) for part in parts]


@dataclass(frozen=True, eq=False)
class FeedShare:
    """Feed share over the programmed path, as a component writes it to `motion.adaptive-feed`.

    Attributes
    ----------
    place : ndarray, shape (n,)
        Way along the path, not decreasing [m].
    share : ndarray, shape (n,)
        Factor of the feed there, linear in between, above 0 to 1 [-].
    """

    place: Array
    share: Array


LATENCY = 1
"""Periods from a position of the planner to the effect of the share there: the component
writes it in the same period, and it is read in the next one."""


def command(
    path: Sequence[tuple[Moves, Corners]],
    limits: ControllerLimits,
    adaptive: FeedShare | None = None,
) -> Commanded:
    """Return what a controller commands for a path, from rest to rest.

    Corners are passed as the path mode says, and the speed is as high as feeds,
    axes, blends and look-ahead let it be; acceleration is not limited in its change.

    Parameters
    ----------
    path : sequence of (Moves, Corners)
        As `chains` returns them.
    limits : ControllerLimits
        Of the axes.
    adaptive : FeedShare, optional
        Feed share in force with `M52 P1`.

    Returns
    -------
    Commanded
        From the start to the end.

    Examples
    --------
    See `fuzzycnc_ros.simulation.controller.program.simulate`.
    """
    first = path[0][0]
    parts = [_chain(moves, corners, limits, adaptive) for moves, corners in path]
    position = np.concatenate([first.start[:1], *(part.position for part in parts)])
    place = np.concatenate([first.place[:1, 0], *(part.place for part in parts)])
    # joints get cubic splines of the planner's positions, and two periods later
    one, two, three = (np.pad(position, ((2 - k, k), (0, 0)), 'edge') for k in range(3))
    place = np.pad(place, 1, 'edge')
    return Commanded((one + 4.0 * two + three) / 6.0, place, limits.period * (len(place) - 1))


def _chain(
    moves: Moves, corners: Corners, limits: ControllerLimits, adaptive: FeedShare | None
) -> Commanded:
    """Return what is commanded from one rest to the next, and while it stands there."""
    plan = Plan(moves, corners, limits)
    shares = None if adaptive is None else _SharesInForce(moves, plan.found, adaptive)
    run = _PlannerRun(plan, moves.rest.tolist(), limits, shares)
    position, place = _evaluated(moves, plan, run, limits.period)
    return Commanded(position, place, limits.period * len(place))


class _SharesInForce:
    """Feed shares by the way inside segments, behind the component that writes them."""

    def __init__(self, moves: Moves, found: list[PlannedPart], adaptive: FeedShare) -> None:
        begin, end = moves.place.T.tolist()
        self._low, self._rate = [], []
        for one in found:
            after = one.move if one.blend is None else one.move + 1
            low = begin[one.move] + (end[one.move] - begin[one.move]) * one.low
            high = begin[after] + (end[after] - begin[after]) * one.high
            self._low.append(low)
            self._rate.append((high - low) / max(one.length, _PLACE))
        self._place, self._share = adaptive.place.tolist(), adaptive.share.tolist()
        self._index = max(bisect_right(self._place, begin[0]) - 1, 0)
        self._seen = deque([begin[0]] * (LATENCY + 2), LATENCY + 2)

    def see(self, index: int, way: float) -> None:
        """Note where a segment is at the end of a period."""
        self._seen.append(self._low[index] + self._rate[index] * way)

    def now(self) -> float:
        """Return the share that is in force in the next period."""
        before, here = self._seen[0], self._seen[1]
        ahead = here + LATENCY * (here - before)
        place, index = self._place, self._index
        last = len(place) - 1
        while index < last and place[index + 1] <= ahead:
            index += 1
        self._index = index
        low = place[index]
        if index == last or ahead <= low:
            return self._share[index]
        part = (ahead - low) / (place[index + 1] - low)
        return self._share[index] + part * (self._share[index + 1] - self._share[index])


class _PlannerRun:
    """Runs segments period by period, as LinuxCNC's planner does.

    Even acceleration over many periods is kept as one entry.

    Attributes
    ----------
    segment, way : list
        Of entries: index of a segment, and its way at the end of a period [m].
    leaps : list of tuple
        Entries that stand for many periods: index of the entry, periods, speed before them [m/s],
        acceleration [m/s^2]; their way is that before them.
    early : list of tuple
        Periods in which a segment and the one before it move: index of the entry, index of the one
        before, its way [m].
    """

    def __init__(
        self,
        plan: Plan,
        rest: list[float],
        limits: ControllerLimits,
        shares: _SharesInForce | None,
    ) -> None:
        self._plan, self._found, self._shares = plan, plan.found, shares
        self._period, self._ramp_time = limits.period, limits.ramp_time
        self._path_velocity = limits.path_velocity
        self._asked = [one.feed for one in plan.found]  # with a share of 1
        self.segment: list[int] = []
        self.way: list[float] = []
        self.leaps: list[tuple[int, int, float, float]] = []
        self.early: list[tuple[int, int, float]] = []
        for one in self._found:
            one.gain, one.top = one.acceleration(), min(one.asked(), limits.path_velocity)
        for one, after in pairwise(self._found):
            if one.end == OVERLAP:
                one.overlaps = plan.overlap_speed(one, after)
        self._set_off()
        for index, one in enumerate(self._found):
            self._through(index, one)
            if shares is not None and one.end == STOP:
                shares.see(index, one.length)
            if rest[one.move] > 0.0 and (one.end == STOP or one is self._found[-1]):
                # a stop is seen in a period of its own
                one.speed = 0.0
                self._enter(index, one, round(rest[one.move] / limits.period) + 1, 0.0)

    def _set_off(self) -> None:
        """Run the first period, in which the planner knows the first move alone."""
        first = self._found[0]
        if first.blend is None:
            gain, first.gain = first.gain, self._plan.first_gain
            self._step(first, None)
            first.gain = gain
        self._note(0, first)

    def _share(self, index: int) -> None:
        """Scale the speed asked for of a segment and the next two by the share in force."""
        assert self._shares is not None
        share = self._shares.now()
        for number in range(index, min(index + 3, len(self._found))):
            one = self._found[number]
            one.feed = self._asked[number] * share
            one.top = min(one.asked(), self._path_velocity)

    def _through(self, index: int, one: PlannedPart) -> None:
        """Run a segment to its end."""
        found, shares = self._found, self._shares
        after = found[index + 1] if index + 1 < len(found) else None
        beyond = found[index + 2] if index + 2 < len(found) else None
        if shares is not None:
            self._share(index)
        if index or one.blend is not None:  # when the first one starts, its end is not known
            self._start(one)
        period, segments, ways = self._period, self.segment, self.way
        far = _FAR * period
        overlaps = one.end == OVERLAP and after is not None
        done = False
        while not done:
            if shares is not None:
                self._share(index)
            if one.split:
                one.progress = one.length
                if after is not None:
                    if one.end == TANGENT:
                        after.cycle = period - one.cycle
                        after.speed = one.term_speed
                    self._step(after, beyond)
                    self._note(index + 1, after)
                else:
                    self._note(index, one)
                return
            if shares is None and (one.on_brake or one.length - one.progress >= far * one.speed):
                self._leap(index, one, after)
            one.cycle = period
            done = self._step(one, after)
            if shares is not None and overlaps and after is not None and one.on_brake:
                one.overlaps = self._plan.overlap_speed(one, after)
            if overlaps and after is not None and self._overlaps(one):
                self._step(after, None)
                self.early.append((len(ways), index, one.progress))
                self._note(index + 1, after)
            elif shares is None:
                segments.append(index)
                ways.append(one.progress)
            else:
                self._note(index, one)

    def _start(self, one: PlannedPart) -> None:
        """Choose whether a segment changes its speed evenly."""
        left = one.length - one.progress
        pace = one.speed + min(one.final, one.top)
        even = left > 0.0 and 2.0 * left < self._ramp_time * pace
        one.ramp = even and one.end == TANGENT and not one.rapid

    def _note(self, index: int, one: PlannedPart) -> None:
        """Note where a segment is at the end of a period."""
        self.segment.append(index)
        self.way.append(one.progress)
        if self._shares is not None:
            self._shares.see(index, one.progress)

    def _enter(self, index: int, one: PlannedPart, count: int, rise: float) -> None:
        """Note how a segment goes on over many periods."""
        self.leaps.append((len(self.way), count, one.speed, rise))
        self._note(index, one)

    def _overlaps(self, one: PlannedPart) -> bool:
        if one.on_brake and one.speed < one.overlaps:
            one.overlapping = True
        return one.overlapping

    def _step(self, one: PlannedPart, after: PlannedPart | None) -> bool:
        """Run a segment for its part of a period; return whether it rests at its end."""
        cycle, speed, rise = one.cycle, one.speed, one.gain
        length, way = one.length, one.progress
        final = _final(one, after)
        left = length - way
        if one.ramp and final >= _PACE:
            mean = 0.5 * (speed + final)
            time = max(left / mean, 1e-16)
            gain, wanted = (final - speed) / time, final
        else:
            ramp = 0.5 * rise * cycle
            square = final * final + rise * (2.0 * left - speed * cycle) + ramp * ramp
            wanted = sqrt(square) - ramp if square > ramp * ramp else -ramp
            gain = ((wanted if wanted < one.top else one.top) - speed) / (cycle or _INSTANT)
        if gain > rise:
            gain = rise
        elif gain < -rise:
            gain = -rise
        now = speed + gain * cycle
        if now < 0.0:
            now = 0.0
            if left < speed * cycle:
                way = length
        else:
            way += 0.5 * (now + speed) * cycle
            if not way < length:
                way = length
        one.progress, one.speed = way, now
        one.on_brake = gain < 0.0 and abs(wanted - now) < _PACE
        left = length - way
        period = one.cycle = self._period
        faster = now if now > final else final
        if left > _SURE * faster * period and left > _SURE * (_PLACE + _DIGITS * length):
            return False  # the end is farther than a period, whatever the speed does
        return self._near_end(one, left, final)

    def _near_end(self, one: PlannedPart, left: float, final: float) -> bool:
        """Split the next period where the segment ends in it; return whether it ended at rest."""
        if left <= _PLACE + _DIGITS * one.length:
            one.progress = one.length
            one.split, one.cycle, one.term_speed = True, 0.0, one.speed
            return one.end == STOP
        if one.end == STOP:
            return False
        mean = 0.5 * (one.speed + final)
        if mean <= _PACE:
            return False
        time = max(0.5 * _INSTANT, left / mean)
        gain = (final - one.speed) / time
        if abs(gain) > one.gain:
            gain = one.gain if gain > 0.0 else -one.gain
            square = (one.speed / gain) ** 2 + 2.0 / gain * left
            if square < 0.0:
                return False
            root = sqrt(square) if gain > 0.0 else -sqrt(square)
            time = root - one.speed / gain
            final = one.speed + time * gain
        if time < _INSTANT:
            one.progress = one.length
            time = 0.0
        if time < self._period and not (one.split and time > 0.0):
            one.split, one.cycle, one.term_speed = True, time, final
        return False

    def _leap(self, index: int, one: PlannedPart, after: PlannedPart | None) -> None:
        """Run through the periods in which the acceleration stays, but the last ones."""
        if one.ramp or one.overlapping or one.split:
            return
        period, rise, speed = self._period, one.gain, one.speed
        left = one.length - one.progress
        final = _final(one, after)
        top, gain = one.top, rise * period
        spare = 2.0 * rise * left + final * final - speed * speed  # until it has to brake
        if speed < top - gain and spare > 0.0:
            most = min(top, sqrt(speed * speed + 2.0 * rise * left))
            # (v + n g)^2 - f^2 = 2 a (left - way), the way that of n periods
            root = sqrt(speed * speed + 0.5 * spare) - speed
            number = min((top - speed) / gain, root / gain, left / (most * period) - _NEAR)
        elif abs(speed - top) <= 1e-9 * top and spare > 0.0:
            gain = 0.0
            way = spare / (2.0 * rise)
            number = min(way / (top * period), left / (top * period) - _NEAR)
        elif speed > top + gain:
            gain = -gain
            number = min((speed - top) / -gain, left / (speed * period) - _NEAR)
        elif one.on_brake and abs(spare) <= 1e-6 * max(speed * speed, 1e-12):
            edge = max(final, one.overlaps if one.end == OVERLAP else 0.0)
            number = (speed - edge) / gain - 2.0 - _NEAR
            gain = -gain
        else:
            return
        count = int(number) - 1
        if count < 2:
            return
        self._enter(index, one, count, gain / period)
        one.progress += (speed + 0.5 * gain * count) * count * period
        one.speed = speed + gain * count


def _final(one: PlannedPart, after: PlannedPart | None) -> float:
    """Return the speed that the end of a segment shall have [m/s]."""
    if one.end != TANGENT or after is None:
        return 0.0
    top = one.top if one.top < after.top else after.top
    return one.final if one.final < top else top


def _evaluated(moves: Moves, plan: Plan, run: _PlannerRun, period: float) -> tuple[Array, Array]:
    """Return positions and places at the ends of all periods."""
    way = np.array(run.way)
    entry = np.arange(len(way))
    if run.leaps:
        which, count, speed, rise = (np.array(part) for part in zip(*run.leaps, strict=True))
        periods = np.ones(len(way), dtype=np.intp)
        periods[which] = count
        first = np.cumsum(periods) - periods  # period of each entry
        entry, way = np.repeat(entry, periods), np.repeat(way, periods)
        leap = np.repeat(np.arange(len(which)), count)
        inside = np.arange(len(leap)) - np.repeat(np.cumsum(count) - count, count)
        since = (inside + 1.0) * period
        number = first[which][leap] + inside
        way[number] += speed[leap] * since
        way[number] += 0.5 * rise[leap] * since**2
    points = _Points(moves, plan)
    position, place = points.at(np.array(run.segment, dtype=np.intp)[entry], way)
    if run.early:
        number, before, gone = map(np.array, zip(*run.early, strict=True))
        number = np.searchsorted(entry, number)
        here, _ = points.at(before, gone)
        there, _ = points.at(before, points.length[before])
        position[number] += here - there
    return position, place


class _Points:
    """Points of segments.

    Attributes
    ----------
    length : ndarray, shape (k,)
        Of segments [m].
    """

    def __init__(self, moves: Moves, plan: Plan) -> None:
        found = plan.found
        self._moves, self._plan = moves, plan
        self._move = np.array([one.move for one in found], dtype=np.intp)
        self._low, self._high, self.length = np.array(
            [(one.low, one.high, one.length) for one in found]
        ).T
        self._blend = np.array([one.blend is not None for one in found])
        self._begin = moves.place[:, 0]
        self._span = moves.place[:, 1] - moves.place[:, 0]

    def at(self, segment: NDArray[np.intp], way: Array) -> tuple[Array, Array]:
        """Return positions and places of ways inside segments."""
        move = self._move[segment]
        share = way / np.maximum(self.length[segment], 1e-15)
        low = self._low[segment]
        along = low + (self._high[segment] - low) * share
        place = self._begin[move] + self._span[move] * along
        bent = self._blend[segment]
        position = self._moves.position(move, np.where(bent, 0.0, along))
        rounded = np.flatnonzero(bent)
        if not len(rounded):
            return position, place
        position[rounded] = self._rounded(segment[rounded], way[rounded])
        one = move[rounded]
        begin = self._begin[one] + self._span[one] * low[rounded]
        end = self._begin[one + 1] + self._span[one + 1] * self._high[segment[rounded]]
        place[rounded] = begin + (end - begin) * share[rounded]
        return position, place

    def _rounded(self, segment: NDArray[np.intp], way: Array) -> Array:
        """Return points of arcs between moves."""
        arcs = [one.blend for one in self._plan.found if one.blend is not None]
        index = (np.cumsum(self._blend) - 1)[segment]
        centre, start, end = (
            np.array([getattr(arc, name) for arc in arcs])[index]
            for name in ('centre', 'start', 'end')
        )
        sizes = [(arc.radius, arc.angle, arc.line or 0.0) for arc in arcs]
        radius, angle, line = np.array(sizes)[index].T
        gone = way - line
        turned = np.maximum(gone, 0.0) / radius
        point = centre + (np.sin(angle - turned) * start + np.sin(turned) * end) / np.sin(angle)
        # before it the rest of the line, which comes along the tangent
        point += np.minimum(gone, 0.0)
        corner = np.array([arc.corner for arc in arcs])[index]
        flat = point.real[:, np.newaxis] * self._plan.along[corner]
        flat += point.imag[:, np.newaxis] * self._plan.inward[corner]
        return np.asarray(self._moves.end[corner] + flat)
