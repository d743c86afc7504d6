# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feeds of a part program, refined on the simulated controller until they keep a tolerance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.program import ProgramMoves, simulate
from fuzzycnc_ros.studies.programs.program_judge import LocalErrors, ProgramPath

# FALL, RISE, RISE_MOST and BEHIND were chosen on nine random programs of lines with corners,
# lines and arcs, and splines as short lines (seeds 0 to 8), for 20 um: the least time among six.
FALL, RISE = 0.7, 0.5
"""Powers of error over tolerance by which feeds fall and rise in a round [-]."""
FALL_MOST, RISE_MOST = 0.3, 1.5
"""Factors of a feed in a round at most [-]."""
BEHIND = 0.7
"""Lead of the command that counts as the cause of an error, in delays of the machine."""
SETTLED = 0.95
"""Error over tolerance from which feeds no longer rise [-]."""
AIM = 0.97
"""Share of the tolerance that is aimed at [-]."""
ROUNDS, ROUNDS_DOWN = 24, 8
"""Rounds, and those at the end in which no feed rises."""


@dataclass(frozen=True, eq=False)
class RefinedFeeds:
    """Feeds that were found for a program.

    Attributes
    ----------
    feed : ndarray, shape (n,)
        By move, or by part of the path [m/s].
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
    longest: float = np.inf,
) -> RefinedFeeds:
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
    longest : float
        Time from which on nobody wants it [s]: the search ends there.

    Returns
    -------
    RefinedFeeds
        The fastest that keeps the tolerance, or else that with the least error.
    """
    plain = moves.moves

    def run(feed: Array) -> LocalErrors:
        tried = replace(moves, moves=replace(plain, feed=feed))
        return path.errors(simulate(tried, limits), machine)

    kept = plain.rapid
    return refine_parts(run, plain.place[:, 1], plain.feed, kept, tolerance, machine, longest)


def refine_parts(
    run: Callable[[Array], LocalErrors],
    edge: Array,
    own: Array,
    kept: NDArray[np.bool_],
    tolerance: float,
    machine: ContouringConfig,
    longest: float = np.inf,
) -> RefinedFeeds:
    """Refine the feeds of parts of a path; see `refine`.

    Parameters
    ----------
    run : callable
        Returns the errors that feeds leave, one for each part [m/s].
    edge : ndarray, shape (n,)
        Where each part ends along the path [m].
    own : ndarray, shape (n,)
        Feeds that none exceeds [m/s].
    kept : ndarray of bool, shape (n,)
        Parts whose feeds stay as they are.
    tolerance, machine, longest
        As in `refine`.
    """
    feed = own.copy()
    best: RefinedFeeds | None = None
    for number in range(ROUNDS):
        found = run(feed)
        judged = found.judged
        now = RefinedFeeds(feed, judged.duration, judged.error)
        if best is None or _rank(now, tolerance) < _rank(best, tolerance):
            best = now
        if judged.duration > longest:
            break
        over, pace = _by_part(found, edge, machine, AIM * tolerance)
        known = np.maximum(over, 1e-3)
        slower = np.minimum(feed, pace) * np.maximum(known**-FALL, FALL_MOST)
        faster = np.minimum(feed * np.minimum(known**-RISE, RISE_MOST), own)
        rises = (over > 0.0) & (over < SETTLED) & (number < ROUNDS - ROUNDS_DOWN)
        wanted = np.where(over > 1.0, slower, np.where(rises, faster, feed))
        wanted = np.where(kept, own, wanted)
        if np.array_equal(wanted, feed):
            break  # so it would be in all rounds that are left
        feed = wanted
    assert best is not None
    return best


def _rank(one: RefinedFeeds, tolerance: float) -> tuple[bool, float]:
    kept = one.error <= tolerance
    return not kept, one.duration if kept else one.error


def _by_part(
    found: LocalErrors, edge: Array, machine: ContouringConfig, aim: float
) -> tuple[Array, Array]:
    """Return, by part, the largest error that it has a part in over the aim, and its speed."""
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
