# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How a controller passes from move to move: without a change, on an arc, or with a stop.

The rules are those of LinuxCNC 2.9 as its manual and its planner have them: nearly tangent moves
follow each other at once, other corners are rounded by an arc within the tolerance of G64, and
where that would be slower one move starts while the last one ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.simulation.controller.moves import Moves

TANGENTIAL = 0.5
"""Share of the acceleration that is kept for the speed while the path bends [-]."""
_NORMAL = float(np.sqrt(1.0 - TANGENTIAL**2))
"""Share of the acceleration that bends get [-]."""
_KINK = 0.1
"""Share of the acceleration that an unrounded kink may take in one period [-]."""
_MOST_LENGTH = 0.5
"""Share of a move that a blend may take at either end [-]."""
_MOST_ROUNDING = 0.25
"""Share of the length of a move by which a corner of it is rounded at most [-]."""
GAP = 4
"""Periods below which the rest of a line before a blend is run at the blend's speed."""
_REVERSED = np.pi * 2.0 / 180.0
"""Turn short of a reversal below which a corner is always a stop [rad]."""
_SHORTEST = 1e-9
"""Shortest blend [m]."""

STOP, TANGENT, ARC, OVERLAP = range(4)


@dataclass(frozen=True, kw_only=True)
class ControllerLimits:
    """What a controller keeps.

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


@dataclass(frozen=True, eq=False)
class MoveLimits:
    """Speed and acceleration of n moves: what the axes allow, the feed, and the lesser speed.

    Attributes
    ----------
    most, speed, acceleration : ndarray, shape (n,)
        Speed that the axes allow, that with the feed [m/s], and acceleration [m/s^2].
    """

    most: Array
    speed: Array
    acceleration: Array


@dataclass(frozen=True, eq=False)
class Junctions:
    """The ends of n moves; the last one is a stop.

    Attributes
    ----------
    kind : ndarray of int, shape (n,)
        `STOP`, `TANGENT`, `ARC` or `OVERLAP`.
    speed : ndarray, shape (n,)
        Speed at the end where it is tangent, of the blend where there is one, at which the next
        move starts where they overlap [m/s].
    trim : ndarray, shape (n,)
        Way that a blend takes of both moves [m].
    acceleration : ndarray, shape (n,)
        Of blends [m/s^2].
    kink : ndarray, shape (n,)
        Share of both moves' acceleration that a kink takes [-].
    turn : ndarray, shape (n,)
        Change of direction [rad].
    """

    kind: NDArray[np.intp]
    speed: Array
    trim: Array
    acceleration: Array
    kink: Array
    turn: Array


def move_limits(moves: Moves, limits: ControllerLimits) -> MoveLimits:
    """Return what speed and acceleration the axes allow in each move."""
    velocity, rise = np.array(limits.velocity), np.array(limits.acceleration)
    way = np.abs(moves.end - moves.start)
    slowest = np.maximum((way / velocity).max(axis=1), moves.length / limits.path_velocity)
    weakest = (way / rise).max(axis=1)
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
        pitch = height / moves.sweep[bent]
        sharp = radius + pitch**2 / np.maximum(radius, 1e-12)
        around = np.minimum(np.sqrt(_NORMAL * plain_rise * sharp), plain_speed)
        slowest[bent] = np.maximum(slowest[bent], flat / around)
        weakest[bent] = np.maximum(weakest[bent], flat / plain_rise)
    with np.errstate(divide='ignore'):
        most = moves.length / slowest
        acceleration = moves.length / weakest
    if len(bent):
        # what the bend takes of the acceleration is not there for the speed
        across = np.minimum(most[bent] ** 2 / sharp / acceleration[bent], _NORMAL)
        most[bent] = np.minimum(most[bent], np.sqrt(_NORMAL * acceleration[bent] * sharp))
        acceleration[bent] *= np.sqrt(1.0 - across**2)
    return MoveLimits(most, np.minimum(most, moves.feed), acceleration)


def junctions(moves: Moves, own: MoveLimits, limits: ControllerLimits) -> Junctions:
    """Return how each move passes into the next.

    Parameters
    ----------
    moves : Moves
        What the planner gets.
    own : MoveLimits
        Limits of the moves.
    limits : ControllerLimits
        Of the axes.
    """
    count = len(moves)
    one, other = np.arange(count - 1), np.arange(1, count)
    before = moves.tangent(one, np.ones(count - 1))
    after = moves.tangent(other, np.zeros(count - 1))
    cosine = np.clip(np.einsum('ij,ij->i', before, after), -1.0, 1.0)
    turn = portable.arccos(cosine)
    slower = np.minimum(own.speed[:-1], own.speed[1:])
    rise = np.array(limits.acceleration)
    jump = (slower / limits.period + own.acceleration[1:])[:, np.newaxis] * np.abs(after - before)
    scale = (jump / rise).max(axis=1)
    bent = moves.arc[:-1] | moves.arc[1:]
    scale = np.where(bent, scale / TANGENTIAL, scale)
    joined = ~moves.stop[:-1] & ~moves.first[1:] & (moves.rapid[:-1] == moves.rapid[1:])
    joined &= (np.pi - turn > _REVERSED) & ~np.isnan(moves.rounding[:-1])
    tangent = joined & (scale < _KINK)
    kinked = np.where(tangent, slower, slower * _KINK / np.maximum(scale, _KINK))

    blend = _Blends(moves, own, limits, turn, np.cross(before, after))
    mixed = moves.rounding[:-1] > 0.0
    net, start = _overlaps(moves, own, turn)
    value = np.stack([np.where(mixed, 0.5 * net, 0.0), kinked, np.where(mixed, blend.speed, 0.0)])
    best = value.argmax(axis=0)
    kind = np.select(
        [~joined, tangent, ~mixed, best == 2, best == 1], [STOP, TANGENT, STOP, ARC, TANGENT],
        OVERLAP,
    )  # fmt: skip
    speed = np.select(
        [kind == TANGENT, kind == ARC, kind == OVERLAP], [kinked, blend.speed, start]
    )
    kink = np.where(kind == TANGENT, np.minimum(scale, _KINK), 0.0)
    trim = np.where(kind == ARC, blend.trim, 0.0)

    def closed(values: Array, last: float = 0.0) -> Array:
        return np.append(values, last)

    return Junctions(
        np.append(kind, STOP).astype(np.intp),
        closed(speed),
        closed(trim),
        closed(blend.acceleration, 1.0),
        closed(kink),
        closed(turn),
    )


class _Blends:
    """Arcs that round corners, as large as the tolerance and the moves let them be.

    Attributes
    ----------
    speed, trim, acceleration : ndarray, shape (n - 1,)
        Speed on the arc [m/s], way from its ends to the corner [m], and acceleration in its
        plane [m/s^2].
    """

    def __init__(
        self, moves: Moves, own: MoveLimits, limits: ControllerLimits, turn: Array, normal: Array
    ) -> None:
        half = 0.5 * (np.pi - turn)
        length = moves.length
        ready = length[:-1] * _MOST_LENGTH, length[1:] * _MOST_LENGTH
        reach = np.minimum(*ready)
        if moves.arc.any():
            reach = np.minimum(self._along(moves), reach)
        rounding = np.minimum(moves.rounding[:-1], moves.rounding[1:])
        rounding = np.minimum(rounding, _MOST_ROUNDING * np.minimum(length[:-1], length[1:]))
        self.acceleration = _in_plane(normal, np.array(limits.acceleration))
        flat = _in_plane(normal, np.array(limits.velocity))
        goal = np.maximum(own.speed[:-1], own.speed[1:])
        lines = ~(moves.arc[:-1] | moves.arc[1:])
        goal = np.minimum(goal, np.maximum(flat, np.where(lines, _altitude(own.most, turn), 0.0)))
        with np.errstate(divide='ignore', invalid='ignore'):
            tolerated = portable.cos(half) * rounding / (1.0 - portable.sin(half))
            away = np.minimum(reach, tolerated)
            largest = portable.tan(half) * away
            across = _NORMAL * self.acceleration
            plan = np.minimum(np.sqrt(across * largest), goal)
            # a parabola of half the acceleration tells how much of the moves is used
            gentle = 0.5 * self.acceleration
            span = np.minimum(np.sqrt(2.0 * gentle * away), plan) / gentle * plan
            radius = np.maximum(plan**2 / across, np.minimum(span / turn, largest))
            trim = radius / portable.tan(half)
        useful = np.isfinite(plan) & np.isfinite(trim) & (radius * turn > _SHORTEST) & (trim > 0.0)
        self.speed = np.where(useful, plan, 0.0)
        self.trim = np.where(useful, trim, 0.0)

    @staticmethod
    def _along(moves: Moves) -> Array:
        """Return how far along its moves the blend of each corner may reach [m]."""
        radius = moves.radius()
        end = np.minimum(moves.sweep * 2.0 / 3.0, np.pi / 2.0) * radius * (1.0 + moves.growth)
        begin = np.minimum(moves.sweep / 3.0, np.pi / 2.0) * radius
        whole = moves.length * _MOST_LENGTH
        return np.minimum(
            np.where(moves.arc, end, whole)[:-1], np.where(moves.arc, begin, whole)[1:]
        )


def _in_plane(normal: Array, limit: Array) -> Array:
    """Return the least limit of axes in the planes across normals, (m, 3)."""
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    unit = normal / np.maximum(length, 1e-15)
    share = np.sqrt(np.maximum(1.0 - unit**2, 0.0))
    with np.errstate(divide='ignore'):
        return np.asarray((limit / share).min(axis=1))


def _altitude(speed: Array, turn: Array) -> Array:
    """Return the speed midway between those of two moves, as vectors [m/s]."""
    wide = portable.cos(np.minimum(turn, 0.49 * np.pi))
    first = np.minimum(speed[:-1], speed[1:] / wide)
    second = np.minimum(speed[1:], speed[:-1] / wide)
    square = first**2 + second**2 - 2.0 * first * second * portable.cos(turn)
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.asarray(first * second * portable.sin(turn) / np.sqrt(np.maximum(square, 0.0)))


def _overlaps(moves: Moves, own: MoveLimits, turn: Array) -> tuple[Array, Array]:
    """Return net and starting speeds of corners where one move starts while the last ends."""
    rise = 0.5 * own.acceleration
    # what a blend at the other end may take is left out
    peak = np.minimum(np.sqrt(0.5 * rise * moves.length), own.speed)
    with np.errstate(divide='ignore', invalid='ignore'):
        longest = moves.length / peak
        least = peak / rise
        time = np.minimum(np.minimum(longest[:-1], longest[1:]), np.maximum(least[:-1], least[1:]))
        first = np.minimum(peak[:-1], time * rise[:-1])
        second = np.minimum(peak[1:], time * rise[1:])
        half = 0.5 * (np.pi - turn)
        within = 2.0 * np.sqrt(
            rise[:-1] * moves.rounding[:-1] / np.maximum(portable.cos(half), 1e-3)
        )
    first, second = np.minimum(first, within), np.minimum(second, within)
    return np.asarray(0.5 * portable.sin(half) * (first + second)), first
