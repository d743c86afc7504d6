# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feeds of blocks refined on the simulated controller, and blocks cut near what is too fast."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.controller_blends import ControllerLimits
from fuzzycnc_ros.core.feedrate.schedule.controller_program import ProgramMoves, simulate, turns
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.studies.programs.program_judge import LocalErrors, ProgramPath

# FALL, RISE, RISE_MOST and BEHIND were chosen on nine random programs of lines with corners,
# lines and arcs, and splines as short lines (seeds 0 to 8), for 20 um: the least time among six.
FALL, RISE = 0.7, 0.5
"""Powers of error over tolerance by which feeds fall and rise in a round [-]."""
FALL_MOST, RISE_MOST = 0.3, 1.5
"""Factors of a feed in a round at most [-]."""
BEHIND = 0.7
"""What was commanded this long before an error counts as its cause, in delays of the machine."""
SETTLED = 0.95
"""Error over tolerance from which feeds no longer rise [-]."""
AIM = 0.97
"""Share of the tolerance that is aimed at [-]."""
ROUNDS, ROUNDS_DOWN = 24, 8
"""Rounds, and those at the end in which no feed rises."""
CUTS = (1e-4, 4e-4)
"""Where a block is cut before and after what is too fast [m]."""
CUT_LEAST = 1.5
"""Blocks are cut where half of them is longer than that many times the cut [-]."""
BENT = float(np.radians(3.0))
"""Turn between two blocks near which they may be cut [rad]."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Refined:
    """Feeds that were found for a program.

    Attributes
    ----------
    feed : ndarray, shape (n,)
        By move [m/s].
    duration, error : float
        What they take and leave on the simulated controller [s, m].
    """

    feed: Array
    duration: float
    error: float


def refine(
    path: ProgramPath,
    moves: ProgramMoves,
    tolerance: float,
    limits: ControllerLimits,
    machine: ContouringConfig,
    progress: Progress = lambda done, total: None,
) -> Refined:
    """Lower the feed of each block until the contour error keeps a tolerance, and not further.

    In each round the program is simulated; feeds fall where the error that they cause is too
    large, and rise elsewhere, up to those that the program has.

    Parameters
    ----------
    path : ProgramPath
        By which errors are measured.
    moves : ProgramMoves
        The program with its own feeds, and the path mode that it shall have.
    tolerance : float
        Largest contour error wanted [m].
    limits, machine
        The controller and the lags of the axes.
    progress : callable
        Told the round and how many there are.

    Returns
    -------
    Refined
        The fastest that keeps the tolerance, or else that with the least error.
    """
    plain = moves.moves
    own = np.where(plain.rapid, np.inf, plain.feed)
    feed = plain.feed.copy()
    best: Refined | None = None
    for number in range(ROUNDS):
        progress(number, ROUNDS)
        tried = replace(moves, moves=replace(plain, feed=feed))
        found = path.errors(simulate(tried, limits), machine)
        judged = found.judged
        now = Refined(feed, judged.duration, judged.error)
        if best is None or _rank(now, tolerance) < _rank(best, tolerance):
            best = now
        over, pace = _by_move(found, plain.place[:, 1], machine, AIM * tolerance)
        known = np.maximum(over, 1e-3)
        slower = np.minimum(feed, pace) * np.maximum(known**-FALL, FALL_MOST)
        faster = np.minimum(feed * np.minimum(known**-RISE, RISE_MOST), own)
        rises = (over > 0.0) & (over < SETTLED) & (number < ROUNDS - ROUNDS_DOWN)
        feed = np.where(over > 1.0, slower, np.where(rises, faster, feed))
        feed = np.where(plain.rapid, plain.feed, feed)
    assert best is not None
    return best


def _rank(one: Refined, tolerance: float) -> tuple[bool, float]:
    kept = one.error <= tolerance
    return not kept, one.duration if kept else one.error


def _by_move(
    found: LocalErrors, edge: Array, machine: ContouringConfig, aim: float
) -> tuple[Array, Array]:
    """Return, by move, the largest error that it has a part in over the aim, and its speed."""
    last = len(edge) - 1
    low = np.clip(
        np.searchsorted(edge, found.place - found.speed * BEHIND * machine.delay), 0, last
    )
    high = np.clip(np.searchsorted(edge, found.place), 0, last)
    count = high - low + 1
    move = np.repeat(low - (np.cumsum(count) - count), count) + np.arange(count.sum())
    over = np.zeros(len(edge))
    np.maximum.at(over, move, np.repeat(found.error / aim, count))
    pace = np.zeros(len(edge))
    np.maximum.at(pace, high, found.speed)
    return over, np.where(pace > 0.0, pace, np.inf)


def cuts_near_errors(
    path: ProgramPath,
    moves: ProgramMoves,
    tolerance: float,
    limits: ControllerLimits,
    machine: ContouringConfig,
) -> dict[int, list[float]]:
    """Return where blocks are to be cut, so that only their ends need to be slow.

    Parameters
    ----------
    path, moves, tolerance, limits, machine
        As in `refine`.

    Returns
    -------
    dict of int to list of float
        By segment of the program: shares of its way.
    """
    plain = moves.moves
    found = path.errors(simulate(moves, limits), machine)
    bad = _reached(found, plain.place[:, 1], machine, tolerance)
    turn = np.concatenate([turns(run) for run in moves.runs()])
    sharp = (turn > BENT) | plain.stop
    begins = np.append(True, sharp[:-1])
    cuts: dict[int, list[float]] = {}
    for index in np.flatnonzero(bad & ~plain.rapid).tolist():
        length = float(plain.length[index])
        ends = [cut / length for cut in CUTS if 2.0 * CUT_LEAST * cut < length]
        shares = [*(ends if begins[index] else ())]
        shares += [1.0 - share for share in reversed(ends)] if sharp[index] else []
        if shares:
            cuts[int(moves.segment[index])] = shares
    return cuts


def _reached(
    found: LocalErrors, edge: Array, machine: ContouringConfig, tolerance: float
) -> NDArray[np.bool_]:
    """Return which moves lie near a place whose error is too large."""
    bad = found.error > tolerance
    place, reach = found.place[bad], found.speed[bad] * machine.delay
    last = len(edge) - 1
    low = np.clip(np.searchsorted(edge, place - reach), 0, last)
    high = np.clip(np.searchsorted(edge, place + 0.5 * reach), 0, last)
    count = np.zeros(len(edge) + 1, dtype=int)
    np.add.at(count, low, 1)
    np.add.at(count, high + 1, -1)
    return np.asarray(np.cumsum(count)[:-1] > 0)
