# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Transitions from move to move: without a change, on an arc, or with a stop.

The rules are those of LinuxCNC 2.9 as its manual and its planner have them: nearly tangent moves
follow each other at once, other corners are rounded by an arc within the tolerance of G64, and
where that would be slower one move starts while the last one ends.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass, replace
from math import acos, cos, hypot, inf, isnan, pi, sin, sqrt, tan

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.simulation.controller.moves import Moves

TANGENTIAL = 0.5
"""Share of the acceleration that is kept for the speed while the path bends [-]."""
NORMAL = sqrt(1.0 - TANGENTIAL**2)
"""Share of the acceleration that bends get [-]."""
_KINK = 0.1
"""Share of the acceleration that an unrounded kink may take in one period [-]."""
_MOST_LENGTH = 0.5
"""Share of a move that a blend may take at either end [-]."""
_MOST_ROUNDING = 0.25
"""Share of the length of a move by which a corner of it is rounded at most [-]."""
_GAP = 4
"""Periods below which the rest of a line before a blend is run at the blend's speed."""
_REVERSED = pi * 2.0 / 180.0
"""Turn short of a reversal below which a corner is always a stop [rad]."""
_SHORTEST = 1e-9
"""Shortest blend [m]."""
_STRAIGHT = 2e-6
"""Turn below which two moves have no plane [rad]."""
_FLAT = 1e-6
"""Most way along its axis of an arc that may be cut short by a blend [m]."""
_NARROWEST = pi / 12.0
"""Half of the angle between two arcs below which no blend is looked for [rad]."""
_PERIODS_LEAST = 1.02
"""Periods that a move takes at least, by look-ahead."""

STOP, TANGENT, OVERLAP = range(3)


@dataclass(frozen=True, kw_only=True)
class ControllerLimits:
    """Limits of a controller.

    Parameters
    ----------
    velocity, acceleration : tuple of float, length 3
        Limits of X, Y and Z [m/s, m/s^2].
    path_velocity : float
        Limit along the path [m/s].
    period : float
        Time between two commanded positions [s].
    look_ahead : int
        Moves that are looked ahead.
    ramp_time : float
        Moves that take less than this change their speed evenly [s].

    Raises
    ------
    ValueError
        If a limit is not above 0.
    """

    velocity: tuple[float, float, float]
    acceleration: tuple[float, float, float]
    path_velocity: float = np.inf
    period: float = 1e-3
    look_ahead: int = 50
    ramp_time: float = 0.01

    def __post_init__(self) -> None:
        for name in ('velocity', 'acceleration', 'path_velocity', 'period', 'look_ahead'):
            value = np.asarray(getattr(self, name), dtype=float)
            if not (value > 0.0).all():
                raise ValueError(f'{name}: expected more than 0 but found {getattr(self, name)}')


class BlendArc:
    """An arc that rounds a corner, in the plane of its two tangents.

    Points are complex numbers: the corner is 0, the tangent before it 1.

    Attributes
    ----------
    corner : int
        Index of the move before the corner.
    centre, start, end : complex
        Its centre, and where it begins and ends, from there [m].
    radius, angle : float
        [m, rad]
    line : float or None
        What is left of the line before it and run with it [m]; None if that is run alone.
    """

    __slots__ = ('angle', 'centre', 'corner', 'end', 'line', 'radius', 'start')

    def __init__(self, corner: int, centre: complex, start: complex, end: complex) -> None:
        self.corner, self.centre = corner, centre
        self.start, self.end = start - centre, end - centre
        self.radius = abs(self.start)
        self.angle = 0.0
        self.line: float | None = None
        if self.radius > 0.0 and self.end:
            self.angle = abs(cmath.phase(self.end / self.start))

    @property
    def length(self) -> float:
        """The way from its beginning to its end [m]."""
        return self.radius * self.angle + (self.line or 0.0)


class PlannedPart:
    """A move or a blend as the planner runs it.

    Attributes
    ----------
    move : int
        Index of the move; of a blend, of the one before it.
    blend : BlendArc or None
        Of blends.
    low, high : float
        Shares of the move between which it runs [-].
    length, nominal : float
        Way, and that before any blend took some [m].
    feed, most, final : float
        Speed asked for, speed at most, and speed at its end at most [m/s].
    rise : float
        Acceleration along the path [m/s^2].
    end : int
        `STOP`, `TANGENT` or `OVERLAP`.
    rapid : bool
        Whether it is a rapid.
    """

    __slots__ = (
        'arc_share', 'blend', 'cycle', 'end', 'feed', 'final', 'gain', 'high', 'kink', 'kink_in',
        'kink_out', 'length', 'low', 'most', 'move', 'nominal', 'on_brake', 'overlapped',
        'overlapping', 'overlaps', 'progress', 'ramp', 'rapid', 'rise', 'speed', 'split',
        'term_speed', 'tolerance', 'top',
    )  # fmt: skip

    def __init__(
        self, move: int, length: float, feed: float, most: float, rise: float, period: float
    ) -> None:
        self.move, self.length, self.nominal = move, length, length
        self.feed, self.most, self.rise = feed, min(most, length / period), rise
        self.blend: BlendArc | None = None
        self.low, self.high, self.final = 0.0, 1.0, 0.0
        self.end, self.rapid, self.overlapped = OVERLAP, False, False
        self.kink, self.kink_in, self.kink_out = -1.0, 0.0, 0.0
        self.arc_share, self.tolerance, self.gain = 1.0, inf, 0.0
        # what happens while it runs
        self.progress, self.speed, self.cycle, self.term_speed = 0.0, 0.0, period, 0.0
        self.split, self.on_brake = False, False
        self.ramp, self.overlapping, self.overlaps, self.top = False, False, 0.0, 0.0

    def acceleration(self) -> float:
        """Return what is left for the speed, beside kinks, overlaps and the bend [m/s^2]."""
        return self.plain_acceleration() * self.arc_share

    def plain_acceleration(self) -> float:
        """Return what is left beside kinks and overlaps [m/s^2]."""
        kink = self.kink_in if self.kink_in > self.kink_out else self.kink_out
        free = self.rise * (1.0 - kink)
        return 0.5 * free if self.overlapped or self.end == OVERLAP else free

    def asked(self) -> float:
        """Return the speed that feed and axes let be [m/s]."""
        return self.feed if self.feed < self.most else self.most


def move_limits(moves: Moves, limits: ControllerLimits) -> tuple[Array, Array]:
    """Return what speed and acceleration the axes allow in each move [m/s, m/s^2]."""
    velocity, rise = np.array(limits.velocity), np.array(limits.acceleration)
    way = np.abs(moves.end - moves.start)
    slowest, weakest = (way / velocity).max(axis=1), (way / rise).max(axis=1)
    bent = np.flatnonzero(moves.arc)
    if len(bent):
        # in the plane of an arc the lesser of both axes counts, all along
        part = np.abs(np.stack([moves.radial[bent], moves.across[bent]])).max(axis=0)
        inside = part > 1e-3 * part.max(axis=1, keepdims=True)
        plain_rise = np.where(inside, rise, np.inf).min(axis=1)
        plain_speed = np.where(inside, velocity, np.inf).min(axis=1)
        height = np.linalg.norm(moves.rise[bent], axis=1)
        flat = np.sqrt(np.maximum(moves.length[bent] ** 2 - height**2, 0.0))
        radius = moves.radius()[bent] * np.minimum(1.0, 1.0 + moves.growth[bent])
        around = np.minimum(np.sqrt(NORMAL * plain_rise * radius), plain_speed)
        slowest[bent] = np.maximum(slowest[bent], flat / around)
        weakest[bent] = np.maximum(weakest[bent], flat / plain_rise)
    with np.errstate(divide='ignore'):
        return moves.length / slowest, moves.length / weakest


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners between moves that follow each other, n - 1 of them.

    Attributes
    ----------
    along, inward : ndarray, shape (n - 1, 3)
        The planes of the corners: unit vectors along the move before it, and across that to
        where the next one goes.
    change, across : ndarray, shape (n - 1, 3)
        Size of the change of the unit tangents by axis, and lengths of the axes in the planes.
    turn : list of float
        [rad]
    onward, aside : list of float
        Parts of the unit vector along the move before it that lie along the next one, and along
        what pulls that aside; of arcs as if they did not climb.
    sense_out, sense_in : list of float
        1 where the arc before it, and behind it, bends as the corner does, -1 if the other way;
        0 out of its plane, and of lines.
    """

    along: Array
    inward: Array
    change: Array
    across: Array
    turn: list[float]
    onward: list[float]
    aside: list[float]
    sense_out: list[float]
    sense_in: list[float]

    @staticmethod
    def of(moves: Moves) -> Corners:
        """Return the corners between moves."""
        count = len(moves)
        one, other = np.arange(count - 1), np.arange(1, count)
        before = moves.tangent(one, np.ones(count - 1))
        after = moves.tangent(other, np.zeros(count - 1))
        cosine = np.einsum('ij,ij->i', before, after)
        normal = _unit(np.cross(before, after))
        # of lines the angle is what counts
        sense_out = sense_in = aside = [0.0] * (count - 1)
        onward = cosine.tolist()
        if moves.arc.any():
            axis = _unit(np.cross(moves.radial, moves.across))
            sense_out, sense_in = _senses(axis[one], normal), _senses(axis[other], normal)
            # overlapping moves are compared without what an arc climbs
            level = replace(moves, rise=np.zeros_like(moves.rise), growth=np.zeros(count))
            out = level.tangent(one, np.ones(count - 1))
            into = level.tangent(other, np.zeros(count - 1))
            onward = np.einsum('ij,ij->i', out, into).tolist()
            aside = np.einsum('ij,ij->i', out, -_unit(moves.radial[other])).tolist()
        return Corners(
            before,
            _unit(after - cosine[:, np.newaxis] * before),
            np.abs(after - before),
            np.sqrt(np.maximum(1.0 - normal**2, 0.0)),
            np.arccos(np.clip(cosine, -1.0, 1.0)).tolist(),
            onward,
            aside,
            sense_out,
            sense_in,
        )


class Plan:
    """Moves from rest to rest, with the blends between them.

    Parameters
    ----------
    moves : Moves
        What the planner gets.
    corners : Corners
        Between them.
    limits : ControllerLimits
        Of the axes.

    Attributes
    ----------
    found : list of PlannedPart
        Moves and blends in order.
    first_gain : float
        Acceleration of the first one while nothing is known of the next [m/s^2].
    along, inward : ndarray, shape (n - 1, 3)
        The planes of the corners: unit vectors along the move before it, and across that to
        where the next one goes.
    """

    def __init__(self, moves: Moves, corners: Corners, limits: ControllerLimits) -> None:
        self._limits, self._period = limits, limits.period
        self.along, self.inward = corners.along, corners.inward
        self._turn, self._onward, self._aside = corners.turn, corners.onward, corners.aside
        self._sense_out, self._sense_in = corners.sense_out, corners.sense_in
        rise = np.array(limits.acceleration)
        # what a kink takes of the axes' acceleration, for each m/s^2 along the path
        self._jump = (corners.change / rise).max(axis=1).tolist()
        self._rise = _in_plane(corners.across, rise).tolist()
        self._flat = _in_plane(corners.across, np.array(limits.velocity)).tolist()
        most, gain = move_limits(moves, limits)
        self._most, self._gain = most.tolist(), gain.tolist()
        self._length, self._feed = moves.length.tolist(), moves.feed.tolist()
        self._rapid, self._bent = moves.rapid.tolist(), moves.arc.tolist()
        self._rounding, self._sweep = moves.rounding.tolist(), moves.sweep.tolist()
        self._radius = moves.radius().tolist()
        self._height = np.linalg.norm(moves.rise, axis=1).tolist()
        self._angle = list(self._sweep)
        self.found: list[PlannedPart] = []
        for index in range(len(moves)):
            self._add(index)
        _look_ahead(self.found, limits)

    def _add(self, index: int) -> None:
        """Add a move, and pass to it from the one before it."""
        now = PlannedPart(
            index, self._length[index], self._feed[index], self._most[index],
            self._gain[index], self._period,
        )  # fmt: skip
        now.feed, now.rapid = min(now.feed, self._most[index]), self._rapid[index]
        rounding = self._rounding[index]
        now.tolerance = rounding if rounding > 0.0 else inf
        now.end = OVERLAP if rounding > 0.0 else STOP
        if self._bent[index]:
            now.arc_share = TANGENTIAL
        if self.found:
            before = self.found[-1]
            self._pass(before, now)
            self._close(before)
        else:
            self.first_gain = now.acceleration()
        self.found.append(now)

    def _close(self, before: PlannedPart) -> None:
        """Set the limits of a move whose length is known now."""
        before.most = min(before.most, before.length / self._period)
        if self._bent[before.move]:
            radius = self._bend(before.move)
            plain = before.plain_acceleration()
            across = before.most**2 / max(radius, 1e-15)
            if across > NORMAL * plain:
                before.most = sqrt(NORMAL * plain * radius)
            else:
                before.arc_share = sqrt(1.0 - (across / plain) ** 2)

    def _bend(self, move: int) -> float:
        """Return the radius of curvature of a move [m]."""
        radius = self._radius[move]
        return radius + self._height[move] ** 2 / max(radius, 1e-15)

    def _pass(self, before: PlannedPart, now: PlannedPart) -> None:
        """Choose how a move goes on into the next."""
        corner = before.move
        turn = self._turn[corner]
        if before.rapid != now.rapid or isnan(self._rounding[corner]):
            before.end = STOP
            return
        if pi - turn < _REVERSED:
            before.end = STOP
            return
        slower = min(before.asked(), now.asked())
        scale = (slower / self._period + now.rise) * self._jump[corner]
        if self._bent[corner] or self._bent[now.move]:
            scale /= TANGENTIAL
        tangent = scale < _KINK
        before.kink = slower if tangent else slower * _KINK / scale
        before.kink_out = max(before.kink_out, min(scale, _KINK))
        now.kink_in = max(now.kink_in, min(scale, _KINK))
        if tangent:
            before.end = TANGENT
            return
        if before.end == STOP:
            return
        blend = self._blend(before, now)
        speed = 0.0 if blend is None else blend[1]
        # to overlap takes acceleration from both moves: only half of its speed counts
        floor = 2.0 * max(speed, before.kink)
        if self._overlap(before, now, (0.5, 0.5), floor)[1] >= floor:
            self._plain(before, now)
            before.end, now.overlapped = OVERLAP, True
        elif blend is not None and speed > before.kink:
            self._round(before, now, *blend)
        else:
            before.end = TANGENT

    @staticmethod
    def _plain(before: PlannedPart, now: PlannedPart) -> None:
        before.kink, before.kink_out, now.kink_in = -1.0, 0.0, 0.0

    def overlap_speed(self, before: PlannedPart, now: PlannedPart) -> float:
        """Return the speed below which the next move starts [m/s]."""
        return self._overlap(before, now, (1.0, 0.5 if now is self.found[-1] else 1.0), -1.0)[0]

    def _overlap(
        self, before: PlannedPart, now: PlannedPart, share: tuple[float, float], floor: float
    ) -> tuple[float, float]:
        """Return starting and net speeds of a corner where one move starts while one ends.

        Of the lengths of the moves only shares are sure, since blends may still take some.  Zeros
        if the net speed is less than a floor.
        """
        gain, rise = before.acceleration(), now.acceleration()
        top = self._limits.path_velocity
        first = min(sqrt(gain * before.length * share[0]), before.asked(), top)
        second = min(sqrt(rise * now.length * share[1]), now.asked(), top)
        if 0.5 * (first + second) < floor or not first or not second:
            return 0.0, 0.0
        time = min(before.length / first, now.length / second, max(first / gain, second / rise))
        first, second = min(first, time * gain), min(second, time * rise)
        half = self._half(before, now)
        if before.tolerance < inf and cos(half) > 1e-3:
            within = 2.0 * sqrt(gain * before.tolerance / cos(half))
            first, second = min(first, within), min(second, within)
        return first, 0.5 * sin(half) * (first + second)

    def _half(self, before: PlannedPart, now: PlannedPart) -> float:
        """Return half of the angle between two moves, the next one pulled aside by its bend."""
        straight, aside = self._onward[before.move], self._aside[before.move]
        along = now.plain_acceleration()
        inward = 0.0
        if self._bent[now.move]:
            inward = (0.5 * now.feed) ** 2 / self._radius[now.move]
        share = (straight * along + aside * inward) / hypot(along, inward)
        return 0.5 * acos(max(-1.0, min(1.0, -share)))

    def _blend(
        self, before: PlannedPart, now: PlannedPart
    ) -> tuple[BlendArc, float, float, float] | None:
        """Return an arc that rounds a corner, its speed, and what it takes of both moves.

        Of a line that is a length [m], of an arc an angle [rad].  None if there is no such arc.
        """
        corner, period = before.move, self._period
        turn = self._turn[corner]
        if turn < _STRAIGHT or pi - turn < _STRAIGHT:
            return None
        half, ahead = 0.5 * (pi - turn), cmath.exp(1j * turn)
        bent = self._bent[corner], self._bent[now.move]
        if bent == (False, False):
            largest = [inf, inf]
            reach = min(before.length, _MOST_LENGTH * before.nominal, _MOST_LENGTH * now.length)
        else:
            found = self._beside(before, now, half)
            if found is None:
                return None
            half, reach, largest = found
        wide = pi - 2.0 * half
        nominal = min(before.nominal, now.nominal)
        tolerance = min(before.tolerance, now.tolerance, _MOST_ROUNDING * nominal)
        rise = self._rise[corner]
        goal = min(max(before.asked(), now.asked()), self._fastest(before, now, wide, any(bent)))
        away = min(reach, cos(half) * tolerance / (1.0 - sin(half)))
        room = tan(half) * away
        plan = min(sqrt(NORMAL * rise * room), goal)
        # a parabola of half the acceleration tells how much of the moves is used
        gentle = 0.5 * rise
        span = min(sqrt(2.0 * gentle * away), plan) / gentle * plan
        radius = max(plan**2 / (NORMAL * rise), min(span / wide, room))
        if radius <= 0.0 or radius * wide < _SHORTEST:
            return None
        trim = radius / tan(half)
        if not any(bent):
            centre = radius / sin(half) * (ahead - 1.0) / abs(ahead - 1.0)
            arc = BlendArc(corner, centre, complex(-trim), trim * ahead)
            trims = trim, trim
        else:
            known = self._touching(corner, now.move, radius, ahead, tolerance, largest)
            if known is None:
                return None
            arc, trims = known
        if not bent[0] and not before.overlapped:
            rest = before.length - trims[0]
            if rest / plan < _GAP * period:
                arc.line = max(rest, 0.0)
        if arc.angle < 1e-6:
            return None
        return arc, min(plan, arc.length / period), *trims

    def _beside(
        self, before: PlannedPart, now: PlannedPart, straight: float
    ) -> tuple[float, float, list[float]] | None:
        """Return what a blend beside arcs has of room, None if it cannot be.

        Half of the angle between the moves [rad], the way along them [m], and the angles that it
        may take of arcs [rad].
        """
        corner = before.move
        moves = corner, now.move
        senses = self._sense_out[corner], self._sense_in[corner]
        half, largest = straight, [inf, inf]
        reach = [
            min(before.length, _MOST_LENGTH * before.nominal), _MOST_LENGTH * now.nominal
        ]  # fmt: skip
        for side, move in enumerate(moves):
            if not self._bent[move]:
                continue
            if senses[side] == 0.0 or self._height[move] > _FLAT:
                return None
            inside = senses[side] > 0.0
            share = self._angle[move] * (2.0 / 3.0, 1.0 / 3.0)[side]
            largest[side] = min(share, straight if inside else 0.5 * pi)
            reach[side] = largest[side] * self._radius[move]
            if inside:
                reach[side] = sin(0.25 * largest[side]) * self._radius[move]
                half = min(half, straight - 0.25 * largest[side])
        if inf not in largest and half < _NARROWEST:
            return None
        return half, min(reach), largest

    def _fastest(self, before: PlannedPart, now: PlannedPart, turn: float, bent: bool) -> float:
        """Return the speed midway between those of two lines, as vectors, or that of the axes."""
        flat = self._flat[before.move]
        if bent:
            return flat
        wide = cos(min(turn, 0.49 * pi))
        first, second = min(before.most, now.most / wide), min(now.most, before.most / wide)
        base = abs(second * cmath.exp(1j * turn) - first)
        return max(flat, first * second * sin(turn) / base)

    def _touching(
        self, corner: int, after: int, radius: float, ahead: complex, tolerance: float,
        largest: list[float],
    ) -> tuple[BlendArc, tuple[float, float]] | None:  # fmt: skip
        """Return an arc that touches two moves, one of them an arc, and what it takes of both."""
        first = second = 0j
        bent = self._bent[corner], self._bent[after]
        if bent[0]:
            first = 1j * self._sense_out[corner] * self._radius[corner]
            near = self._radius[corner] - self._sense_out[corner] * radius
        if bent[1]:
            second = 1j * self._sense_in[corner] * self._radius[after] * ahead
            far = self._radius[after] - self._sense_in[corner] * radius
        if all(bent):
            between = second - first
            apart = abs(between)
            if apart == 0.0:
                return None
            along = (near**2 - far**2 + apart**2) / (2.0 * apart)
            aside = sqrt(max(near**2 - along**2, 0.0))
            ways = [first + between / apart * complex(along, side) for side in (aside, -aside)]
            centre = min(ways, key=abs)
        else:
            onto = 1.0 + 0j if bent[1] else ahead
            seen = (second if bent[1] else first) * onto.conjugate()
            apart = far if bent[1] else near
            square = apart**2 - (radius - seen.imag) ** 2
            if square < 0.0:
                return None
            way = min(abs(sqrt(square) - seen.real), abs(sqrt(square) + seen.real))
            centre = onto * complex(-way if bent[1] else way, radius)
        if abs(centre) - radius > tolerance:
            return None
        trims = [0.0, 0.0]
        ends = [0j, 0j]
        for side, middle in enumerate((first, second)):
            if bent[side]:
                trims[side] = abs(cmath.phase((centre - middle) / -middle))
                if trims[side] > largest[side]:
                    return None
                sense = (self._sense_out, self._sense_in)[side][corner]
                turned = cmath.exp(1j * sense * trims[side] * (-1.0, 1.0)[side])
                ends[side] = middle - middle * turned
            else:
                trims[side] = way
                ends[side] = way * (-1.0 + 0j, ahead)[side]
        return BlendArc(corner, centre, *ends), (trims[0], trims[1])

    def _round(
        self,
        before: PlannedPart,
        now: PlannedPart,
        arc: BlendArc,
        speed: float,
        out: float,
        into: float,
    ) -> None:
        """Put an arc between two moves."""
        corner = before.move
        self._plain(before, now)
        blend = PlannedPart(
            corner, arc.length, max(before.asked(), now.asked()), speed, self._rise[corner],
            self._period,
        )  # fmt: skip
        blend.blend, blend.end, blend.arc_share = arc, TANGENT, TANGENTIAL
        self._shorten(before, out, True)
        self._shorten(now, into, False)
        if arc.line is not None:
            # the rest of the line is run with the blend
            blend.low = before.low
            self.found.pop()
        else:
            blend.low = before.high
            before.end = TANGENT
        blend.high = now.low
        self.found.append(blend)

    def _shorten(self, one: PlannedPart, trim: float, at_end: bool) -> None:
        move = one.move
        if self._bent[move]:
            share = trim / self._sweep[move]
            self._angle[move] -= trim
            one.length *= self._angle[move] / (self._angle[move] + trim)
        else:
            share = trim / self._length[move]
            one.length = max(one.length - trim, 0.0)
        if at_end:
            one.high = max(one.high - share, one.low)
        else:
            one.low += share


def _look_ahead(found: list[PlannedPart], limits: ControllerLimits) -> None:
    """Set the speeds at the ends, so that each can be left within the look-ahead."""
    count = len(found)
    for index, one in enumerate(found[1:-1], 1):
        if found[index - 1].end == TANGENT:
            one.most = min(one.most, one.length / (_PERIODS_LEAST * limits.period))
    most = np.array([one.most for one in found])
    tangent = np.array([one.end == TANGENT for one in found[:-1]], dtype=bool)
    kink = np.array([one.kink if one.kink >= 0.0 else inf for one in found[:-1]])
    node = np.where(tangent, np.minimum(np.minimum(most[:-1], most[1:]), kink), 0.0)
    power = np.array([one.acceleration() * one.length for one in found])
    # the last move known may still be cut by half: half of it is counted, and its feed
    entry = np.minimum(power, np.array([one.asked() for one in found]) ** 2)
    gain = np.append(0.0, np.cumsum(2.0 * power))
    number = np.arange(1, count)
    tail = np.minimum(number + limits.look_ahead, count - 1)
    square = np.minimum(node**2, gain[tail] - gain[number] + entry[tail])
    square = np.minimum.accumulate((square + gain[number])[::-1])[::-1] - gain[number]
    final = np.sqrt(np.maximum(square, 0.0)).tolist()
    for one, speed in zip(found, final, strict=False):
        one.final = speed


def _in_plane(across: Array, limit: Array) -> Array:
    """Return the least limit of axes in planes, by the lengths of the axes in them, (m, 3)."""
    with np.errstate(divide='ignore'):
        return np.asarray((limit / across).min(axis=1))


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-15))


def _senses(axis: Array, normal: Array) -> list[float]:
    """Return 1 for arcs that bend as their corner does, -1 for the others; 0 out of its plane."""
    sense = np.einsum('ij,ij->i', axis, normal)
    return np.where(np.abs(sense) > 1.0 - 1e-9, np.sign(sense), 0.0).tolist()
