# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The positions that a controller with look-ahead commands, period by period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.simulation.controller.blends import (
    ARC,
    GAP,
    OVERLAP,
    STOP,
    TANGENT,
    TANGENTIAL,
    ControllerLimits,
    Junctions,
    junctions,
    move_limits,
)
from fuzzycnc_ros.simulation.controller.moves import Moves, merged

_PERIODS_LEAST = 1.02
"""Periods that a move takes at least."""


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


@dataclass(frozen=True, eq=False)
class _Parts:
    """Moves and the blends between them in order, k parts of one motion.

    Attributes
    ----------
    move : ndarray of int, shape (k,)
        Index of the move; of a blend, of the one before it.
    blend, alone : ndarray of bool, shape (k,)
        Which are blends, and which the planner has as parts of their own.
    low, high : ndarray, shape (k,)
        Shares of the move that are left of it.
    length, whole, speed, rise : ndarray, shape (k,)
        Way, that of it with what is run in one go with it [m], speed and acceleration at most
        [m/s, m/s^2].
    node : ndarray, shape (k + 1,)
        Speed at the ends at most [m/s].
    """

    move: NDArray[np.intp]
    blend: NDArray[np.bool_]
    alone: NDArray[np.bool_]
    low: Array
    high: Array
    length: Array
    whole: Array
    speed: Array
    rise: Array
    node: Array


def command(moves: Moves, limits: ControllerLimits) -> Commanded:
    """Return what a controller commands for moves that follow each other, from rest to rest.

    Lines are merged, corners passed as the path mode says, and the speed is as high as feeds,
    axes, blends and look-ahead let it be; acceleration is not limited in its change.

    Parameters
    ----------
    moves : Moves
        At least one move; only the first one begins a path.
    limits : ControllerLimits
        Of the axes.

    Returns
    -------
    Commanded
        From the start to the end.

    Examples
    --------
    See `fuzzycnc_ros.simulation.controller.program.simulate`.
    """
    plan = _Plan(merged(moves), limits)
    return plan.sampled()


class _Plan:
    """Speeds and times of moves and blends."""

    def __init__(self, moves: Moves, limits: ControllerLimits) -> None:
        self._moves, self._limits = moves, limits
        own = move_limits(moves, limits)
        self._joined = junctions(moves, own, limits)
        half = np.where(self._joined.kind == OVERLAP, 0.5, 1.0)
        half = np.minimum(half, np.append(1.0, half[:-1]))
        kink = np.maximum(self._joined.kink, np.append(0.0, self._joined.kink[:-1]))
        rise = own.acceleration * half * (1.0 - kink)
        self._parts = _parts(moves, own.speed, rise, self._joined, limits.period)
        self._speeds()
        self._times()

    def _speeds(self) -> None:
        """Look ahead and back, so that every speed can be reached and left."""
        part, limits = self._parts, self._limits
        least = part.whole / (_PERIODS_LEAST * limits.period)
        self._most = np.minimum(part.speed, least)
        edge = np.append(np.inf, self._most), np.append(self._most, np.inf)
        square = np.minimum(part.node, np.minimum(*edge)) ** 2
        gain = np.append(0.0, np.cumsum(2.0 * part.rise * part.length))
        number = np.append(0, np.cumsum(part.alone))
        ahead = np.searchsorted(number, number + limits.look_ahead, 'right') - 1
        square = np.minimum(square, gain[ahead] - gain)
        square = np.minimum.accumulate((square + gain)[::-1])[::-1] - gain
        square = np.minimum.accumulate(square - gain) + gain
        self._node = np.sqrt(np.maximum(square, 0.0))

    def _times(self) -> None:
        """Set when each part begins and ends, and how its speed goes in between."""
        part, limits = self._parts, self._limits
        begin, end = self._node[:-1], self._node[1:]
        peak = np.sqrt(part.rise * part.length + 0.5 * (begin**2 + end**2))
        top = np.maximum(np.minimum(peak, self._most), np.maximum(begin, end))
        up, down = (top - begin) / part.rise, (top - end) / part.rise
        way = 0.5 * (begin + top) * up + 0.5 * (end + top) * down
        level = np.maximum(part.length - way, 0.0) / np.maximum(top, 1e-12)
        # a short part changes its speed evenly; what is left unused of the acceleration stays so
        with np.errstate(divide='ignore'):
            even = 2.0 * part.length / (begin + end)
        ramped = (even < limits.ramp_time) & (end > 0.0) & ~self._moves.rapid[part.move]
        # an even ramp is a climb or a fall all along
        rises = ramped & (end >= begin)
        falls = ramped & ~rises
        self._top = np.select([rises, falls], [end, begin], top)
        self._up = np.select([rises, falls], [even, np.zeros_like(even)], up)
        self._level = np.where(ramped, 0.0, level)
        self._down = np.select([rises, falls], [np.zeros_like(even), even], down)
        span = self._up + self._level + self._down
        # where moves overlap, the next one starts when the last one has slowed down that far
        kind, move = self._joined.kind, part.move
        closes = np.append(move[1:] != move[:-1], True) & ~part.blend
        last = closes & np.isin(kind[move], (STOP, OVERLAP))
        rest = np.where(last, self._moves.rest[move], 0.0)
        with np.errstate(divide='ignore', invalid='ignore'):
            early = np.minimum(self._joined.speed[move] / part.rise, self._down)
        early = np.where(last & (kind[move] == OVERLAP), early, 0.0)
        # a stop is seen in a period of its own
        rest = rest + np.where(last & (kind[move] == STOP), limits.period, 0.0)
        self._begin = np.append(0.0, np.cumsum(span + rest - early)[:-1])
        self._span, self._last = span, last
        self.duration = float(self._begin[-1] + span[-1] + self._moves.rest[move[-1]])

    def sampled(self) -> Commanded:
        """Return positions and places, a period apart."""
        period = self._limits.period
        count = int(np.ceil(self.duration / period - 1e-9)) + 1
        time = period * np.arange(count, dtype=np.float64)
        at = np.clip(np.searchsorted(self._begin, time, 'right') - 1, 0, len(self._begin) - 1)
        way = self._way(at, time)
        position, place = self._evaluate(at, way)
        # what is left of the move before, where two overlap
        chain = np.append(0, np.cumsum(self._last)[:-1])[at]
        final = np.flatnonzero(self._last)
        over = np.append(-np.inf, self._begin[final] + self._span[final])
        late = np.flatnonzero(time < over[chain])
        if len(late):
            before = final[chain[late] - 1]
            whole = self._parts.length[before]
            here, _ = self._evaluate(before, self._way(before, time[late]))
            end, _ = self._evaluate(before, whole)
            position[late] += here - end
        return Commanded(position, place, self.duration)

    def _way(self, at: NDArray[np.intp], time: Array) -> Array:
        """Return the way inside parts at times [m]."""
        part, node = self._parts, self._node
        since = np.minimum(time - self._begin[at], self._span[at])
        up, level, down = self._up[at], self._level[at], self._down[at]
        begin, top, end = node[:-1][at], self._top[at], node[1:][at]
        rising = np.minimum(since, up)
        holding = np.clip(since - up, 0.0, level)
        falling = np.clip(since - up - level, 0.0, down)
        with np.errstate(divide='ignore', invalid='ignore'):
            gain = np.where(up > 0.0, (top - begin) / up, 0.0)
            loss = np.where(down > 0.0, (top - end) / down, 0.0)
        way = begin * rising + 0.5 * gain * rising**2 + top * holding
        way += top * falling - 0.5 * loss * falling**2
        return np.asarray(np.clip(way, 0.0, part.length[at]))

    def _evaluate(self, at: NDArray[np.intp], way: Array) -> tuple[Array, Array]:
        """Return positions and places of ways inside parts."""
        part, moves = self._parts, self._moves
        share = way / part.length[at]
        move = part.move[at]
        along = part.low[at] + (part.high - part.low)[at] * share
        position = moves.position(move, np.where(part.blend[at], 0.0, along))
        place = moves.place[move, 0] + np.diff(moves.place, axis=1)[move, 0] * along
        bent = np.flatnonzero(part.blend[at])
        if len(bent):
            position[bent], place[bent] = self._blended(move[bent], share[bent])
        return position, place

    def _blended(self, move: NDArray[np.intp], share: Array) -> tuple[Array, Array]:
        """Return points of blends: cubic curves as near to arcs as such curves can be."""
        moves, trim = self._moves, self._joined.trim
        after = move + 1
        out = 1.0 - trim[move] / moves.length[move]
        into = trim[move] / moves.length[after]
        first, last = moves.position(move, out), moves.position(after, into)
        one, other = moves.tangent(move, out), moves.tangent(after, into)
        turn = portable.arccos(np.clip(np.einsum('ij,ij->i', one, other), -1.0, 1.0))
        chord = np.linalg.norm(last - first, axis=1)
        with np.errstate(divide='ignore', invalid='ignore'):
            arm = (
                (4.0 / 3.0) * portable.tan(0.25 * turn) * chord / (2.0 * portable.sin(0.5 * turn))
            )
        arm = np.where(turn > 1e-6, arm, chord / 3.0)[:, np.newaxis]
        s = share[:, np.newaxis]
        rest = 1.0 - s
        point = (
            rest**2 * rest * first
            + 3.0 * rest**2 * s * (first + arm * one)
            + 3.0 * rest * s**2 * (last - arm * other)
            + s**2 * s * last
        )
        low = moves.place[move, 0] + out * np.diff(moves.place, axis=1)[move, 0]
        high = moves.place[after, 0] + into * np.diff(moves.place, axis=1)[after, 0]
        return point, low + (high - low) * share


def _parts(moves: Moves, speed: Array, rise: Array, joined: Junctions, period: float) -> _Parts:
    """Return moves and blends in order."""
    count = len(moves)
    blended = joined.kind == ARC
    trim = joined.trim / moves.length
    before = np.append(0.0, joined.trim[:-1]) / moves.length
    where = np.arange(count) + np.append(0, np.cumsum(blended)[:-1])
    size = count + int(blended.sum())
    move = np.repeat(np.arange(count), 1 + blended)
    blend = np.ones(size, dtype=bool)
    blend[where] = False
    arcs = where[blended] + 1
    length, most, gain = np.empty(size), np.empty(size), np.empty(size)
    low, high = np.zeros(size), np.ones(size)
    low[where], high[where] = before, np.maximum(1.0 - trim, before)
    length[where] = np.maximum(moves.length * (1.0 - trim - before), 1e-12)
    length[arcs] = (
        joined.turn[blended] * joined.trim[blended] / portable.tan(0.5 * joined.turn[blended])
    )
    most[where], most[arcs] = speed, joined.speed[blended]
    gain[where], gain[arcs] = rise, TANGENTIAL * joined.acceleration[blended]
    whole = length.copy()
    # what is left of a line before a blend is run with it, unless that takes some periods
    rest = np.flatnonzero(blended & ~moves.arc)
    rest = rest[length[where[rest]] < GAP * period * joined.speed[rest]]
    most[where[rest]] = joined.speed[rest]
    whole[where[rest]] += length[where[rest] + 1]
    whole[where[rest] + 1] = whole[where[rest]]
    alone = np.ones(size, dtype=bool)
    alone[where[rest]] = False
    node = np.full(size + 1, np.inf)
    node[0] = 0.0
    tangent = joined.kind == TANGENT
    node[where[tangent] + 1] = joined.speed[tangent]
    node[where[np.isin(joined.kind, (STOP, OVERLAP))] + 1] = 0.0
    return _Parts(move, blend, alone, low, high, length, whole, most, gain, node)
