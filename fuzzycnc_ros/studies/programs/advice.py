# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Settings with which a part program keeps a contour tolerance, the cheapest remedy first.

Every remedy is judged on the simulated controller: as the program is, with a lower acceleration,
with another path mode, with scheduled feeds, and with mixtures of these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.blocks import Program
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.writer import write_program
from fuzzycnc_ros.core.feedrate.schedule.program_schedule import schedule_program
from fuzzycnc_ros.core.feedrate.schedule.program_settings import ProgramSettings
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.agreement import disagreement
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits
from fuzzycnc_ros.simulation.controller.program import (
    PathMode,
    ProgramMoves,
    program_moves,
    simulate,
    turns,
    with_mode,
)
from fuzzycnc_ros.studies.programs.adaptive_feed import AdaptiveFeed, FeedTable
from fuzzycnc_ros.studies.programs.path_mode_words import program_with_mode
from fuzzycnc_ros.studies.programs.program_judge import LocalErrors, ProgramPath, ProgramResult
from fuzzycnc_ros.studies.programs.refined_feeds import refine
from fuzzycnc_ros.studies.programs.split_program import check_same_path, split_program

CORNERS = ('none', 'feed', 'split')
"""Treatments of corners: none, by feeds of blocks, by cutting blocks near them."""

SHARES = ((0.5, 0.2), (0.2, 0.2), (0.05, 0.05), (0.5, 0.5))
"""P and Q of G64 that are tried, as shares of the tolerance [-]."""
REFINED_MODE = 1
"""Which of them refined feeds get."""

LADDER = 2.0 ** -(np.arange(31) / 3.0)
"""Accelerations that are tried, as shares of the machine's: three to an octave, down to 1/1024."""

FINER = 2
"""Times that the step of the ladder between what keeps the aim and what does not is halved."""

SAFE = 0.99
"""Share of the corrected aim that is aimed at after a run on the real controller [-]."""

AGAIN = 3
"""Corrections of the aim of a remedy at most."""

NOTICED = 0.01
"""Share of the time that a remedy has to save, so that it takes the place of a cheaper one [-]."""

REFINED = (1.0, 0.5, 0.25)
"""Accelerations with which feeds are refined, as shares of the machine's [-]."""

STEP = 1.03
"""Feeds are written in steps of this factor, rounded down, so that neighbours share a word."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class ProgramRemedy:
    """Something to set, and what it does.

    Attributes
    ----------
    name : str
        What it is.
    acceleration : tuple of float, length 3
        Of X, Y and Z [m/s^2].
    mode : PathMode or None
        Path mode throughout; None for the program's own.
    program : str or None
        The program with other feeds or more blocks; None for the one that was given.
    judged : ProgramResult
        On the simulated controller.
    aim : float
        Largest contour error that was looked for there [m].
    table : FeedTable or None
        Feed shares that the program needs besides.
    """

    name: str
    acceleration: tuple[float, float, float]
    mode: PathMode | None
    program: str | None
    judged: ProgramResult
    aim: float
    table: FeedTable | None = None

    @property
    def kept(self) -> bool:
        """True if the simulated controller keeps the aim."""
        return self.judged.error <= self.aim

    def sets_the_same(self, other: ProgramRemedy) -> bool:
        """Return True if another remedy asks for the same settings."""
        return (self.acceleration, self.mode, self.program) == (
            other.acceleration, other.mode, other.program,
        )  # fmt: skip


@dataclass(frozen=True)
class Advice:
    """Remedies for a program.

    Attributes
    ----------
    tolerance, aim : float
        Largest contour error wanted, and that on the simulated controller, so that the real one
        keeps the tolerance [m].
    remedies : tuple of ProgramRemedy
        The first one is the program as it is.
    best : int
        Index of the fastest that keeps the aim, or of that with the least error.
    """

    tolerance: float
    aim: float
    remedies: tuple[ProgramRemedy, ...]
    best: int

    @property
    def chosen(self) -> ProgramRemedy:
        """The remedy that is recommended."""
        return self.remedies[self.best]


class Adviser:
    """Looks for remedies for a program.

    Parameters
    ----------
    program : Program
        The part program.
    tolerance : float
        Largest contour error wanted [m].
    limits : ControllerLimits
        What the controller may do at most.
    machine : ContouringConfig
        Lags of the axes.
    settings : ProgramSettings
        How feeds are scheduled.
    before : PathMode, optional
        Path mode before the program says so.
    units : {'mm', 'inch'}
        Unit before the program says G20 or G21.

    Raises
    ------
    ValueError
        If nothing moves, or the tolerance is not above 0.
    """

    def __init__(
        self,
        program: Program,
        tolerance: float,
        limits: ControllerLimits,
        machine: ContouringConfig,
        settings: ProgramSettings,
        before: PathMode | None = None,
        units: str = 'mm',
    ) -> None:
        if not 0.0 < tolerance < np.inf:
            raise ValueError(f'tolerance: expected more than 0 m but found {tolerance} m')
        self._program, self._tolerance, self._units = program, tolerance, units
        self._quickest = np.inf  # time of what keeps the aim so far [s]
        self._steps: dict[str, Callable[[], ProgramRemedy | None]] = {}
        self._tried: dict[
            tuple[float, PathMode | None], ProgramResult
        ] = {}  # with the program's feeds
        self._likely = 2  # index of the path mode that may be best: the least rounding
        self._limits, self._machine, self._settings = limits, machine, settings
        self._moves = program_moves(program.blocks, before)
        # what is worked out for a path mode serves all accelerations
        self._last = self._moves, PathMode(), with_mode(self._moves, PathMode())
        self._path = ProgramPath(self._moves)
        self._aim = tolerance / disagreement(self._moves.moves)
        self._modes = [
            PathMode(rounding * tolerance, merging * tolerance) for rounding, merging in SHARES
        ]

    @property
    def _refining(self) -> PathMode:
        """The path mode of refined feeds."""
        return self._modes[REFINED_MODE]

    @property
    def path(self) -> ProgramPath:
        """The path by which errors are measured."""
        return self._path

    def advise(
        self,
        corners: str = 'feed',
        progress: Progress = lambda text, done, total: None,
        adaptive: bool = False,
    ) -> Advice:
        """Return remedies and the one that is recommended.

        Parameters
        ----------
        corners : {'none', 'feed', 'split'}
            Whether feeds are refined on the simulated controller until corners keep the
            tolerance too, and whether blocks may be cut for that.
        progress : callable
            Told what is tried, and how much is done.
        adaptive : bool
            Whether the machine has the component that follows feed shares.

        Raises
        ------
        ValueError
            If a choice is unknown, or the program cannot be followed.
        """
        if corners not in CORNERS:
            raise ValueError(f'corners: expected {", ".join(CORNERS)} but found {corners}')
        steps: list[Callable[[], ProgramRemedy | None]] = [
            self._as_it_is, self._by_constant, self._slower, self._other_mode, self._slower_mode,
            self._scheduled, self._scheduled_mix,
        ]  # fmt: skip
        if corners != 'none':
            steps.append(self._refined)
        if corners == 'split':
            steps.append(self._split)
        if adaptive:
            steps.append(self._adaptive)
        found: list[ProgramRemedy] = []
        for number, step in enumerate(steps):
            progress(step.__name__.strip('_').replace('_', ' '), number, len(steps))
            remedy = step()
            if remedy is not None:
                self._steps[remedy.name] = step
                found.append(remedy)
        best = best_of([one.judged for one in found], self._aim)
        return Advice(self._tolerance, self._aim, tuple(found), best)

    def lower(self, remedy: ProgramRemedy, error: float) -> ProgramRemedy | None:
        """Look again for a remedy that left more than the tolerance on the real controller.

        Parameters
        ----------
        remedy : ProgramRemedy
            One of those that were found.
        error : float
            What it left there [m].

        Returns
        -------
        ProgramRemedy or None
            For an aim that is as much lower; None if that changes nothing.
        """
        usual = self._aim
        self._aim = SAFE * remedy.judged.error * self._tolerance / error
        try:
            found = self._steps[remedy.name]()
        finally:
            self._aim = usual
        return None if found is None or found.sets_the_same(remedy) else found

    def _run(self, moves: ProgramMoves, share: float, mode: PathMode | None) -> ProgramResult:
        """Judge moves with a share of the acceleration and a path mode."""
        return self._path.run(self._moded(moves, mode), self._slowed(share), self._machine)

    def _moded(self, moves: ProgramMoves, mode: PathMode | None) -> ProgramMoves:
        """Return moves with a path mode, the same at each call while they are the same."""
        if mode is None:
            return moves
        if self._last[:2] != (moves, mode):
            self._last = moves, mode, with_mode(moves, mode)
        return self._last[2]

    def _try(
        self, moves: ProgramMoves, share: float, mode: PathMode | None, longest: float = np.inf
    ) -> ProgramResult | None:
        """Judge moves without the deviation of the commands, which takes a third of the time.

        None if they take longer than anybody wants.
        """
        known = self._tried.get((share, mode)) if moves is self._moves else None
        if known is not None:
            return known if known.duration <= longest else None
        moved = self._moded(moves, mode)
        judged = self._path.run_within(longest, moved, self._slowed(share), self._machine)
        if moves is self._moves and judged is not None:
            self._tried[share, mode] = judged
        return judged

    def _slowed(self, share: float) -> ControllerLimits:
        most = self._limits.acceleration
        x, y, z = (min(value, share * max(most)) for value in most)
        return replace(self._limits, acceleration=(x, y, z))

    def _remedy(
        self, name: str, share: float, mode: PathMode | None, judged: ProgramResult,
        program: str | None = None,
    ) -> ProgramRemedy:  # fmt: skip
        if judged.error <= self._aim:
            self._quickest = min(self._quickest, judged.duration)
        rise = self._slowed(share).acceleration
        return ProgramRemedy(name, rise, mode, program, judged, self._aim)

    def _as_it_is(self) -> ProgramRemedy:
        return self._remedy('as it is', 1.0, None, self._run(self._moves, 1.0, None))

    def _by_constant(self) -> ProgramRemedy | None:
        """MAX_ACCELERATION = tolerance / C."""
        share = self._aim / self._machine.contour_constant / max(self._limits.acceleration)
        if share >= 1.0:
            return None
        judged = self._run(self._moves, share, None)
        return self._remedy('acceleration of tolerance / C', share, None, judged)

    def _slower(self) -> ProgramRemedy:
        _, share = self._fastest_of([(self._moves, None)])
        judged = self._run(self._moves, share, None)
        return self._remedy('lower acceleration', share, None, judged)

    def _other_mode(self) -> ProgramRemedy:
        tried = [(mode, self._try(self._moves, 1.0, mode)) for mode in self._modes]
        mode, _ = min(
            ((mode, judged) for mode, judged in tried if judged is not None),
            key=lambda one: self._order(one[1]),
        )
        return self._remedy('path mode', 1.0, mode, self._run(self._moves, 1.0, mode))

    def _slower_mode(self) -> ProgramRemedy:
        number, share = self._fastest_of([(self._moves, mode) for mode in self._modes])
        mode, self._likely = self._modes[number], number
        judged = self._run(self._moves, share, mode)
        return self._remedy('lower acceleration, path mode', share, mode, judged)

    def _scheduled(self) -> ProgramRemedy:
        moves, text = self._schedule(self._settings)
        judged = self._run(moves, 1.0, None)
        return self._remedy('scheduled feeds', 1.0, None, judged, text)

    def _scheduled_mix(self) -> ProgramRemedy:
        found = [
            self._schedule(replace(self._settings, blend=mode.rounding)) for mode in self._modes
        ]
        tried = [(moves, mode) for (moves, _), mode in zip(found, self._modes, strict=True)]
        number, share = self._fastest_of(tried)
        (moves, text), mode = found[number], self._modes[number]
        judged = self._run(moves, share, mode)
        name = 'scheduled feeds, lower acceleration, path mode'
        return self._remedy(name, share, mode, judged, text)

    def _refined(self) -> ProgramRemedy:
        return self._refine('feeds refined for corners', self._program)

    def _split(self) -> ProgramRemedy:
        moves = with_mode(self._moves, self._refining)
        cuts = cuts_near_errors(self._path, moves, self._aim, self._limits, self._machine)
        text = split_program(self._program, cuts)
        program = read_program(text, self._units)
        check_same_path(self._program, program)
        return self._refine('blocks cut near corners, feeds refined', program)

    def _adaptive(self) -> ProgramRemedy:
        """Feed shares along the path, at all of the acceleration."""
        search = AdaptiveFeed(self._program.text, self._limits, self._machine, self._units)
        table, judged = search.keeping(self._aim, LOST * self._quickest)
        remedy = self._remedy('feed shares along the path', 1.0, None, judged, table.program)
        return replace(remedy, table=table)

    def _refine(self, name: str, program: Program) -> ProgramRemedy:
        """Return a program with the feeds that were found best, with the best acceleration."""
        mode = self._refining
        moves = with_mode(program_moves(program.blocks), mode)
        path = ProgramPath(moves)
        found: list[ProgramRemedy] = []
        for share in REFINED:
            limits = self._slowed(share)
            for aim in (1.0, 0.9):
                known = refine(
                    path,
                    moves,
                    aim * self._aim,
                    limits,
                    self._machine,
                    longest=LOST * self._quickest,
                )
                text = self._written(program, moves, known.feed)
                # judged as it was written, by the path as it was given
                written = with_mode(program_moves(read_program(text, self._units).blocks), mode)
                judged = self._path.run(written, limits, self._machine)
                found.append(self._remedy(name, share, mode, judged, text))
                if found[-1].kept:
                    break
        return min(found, key=lambda one: self._order(one.judged))

    def _schedule(self, settings: ProgramSettings) -> tuple[ProgramMoves, str]:
        feeds = schedule_program(self._program, settings).feeds
        text = write_program(self._program, feeds)
        return self._moves.with_feeds(feeds), text

    def _written(self, program: Program, moves: ProgramMoves, feed: Array) -> str:
        """Return a program with feeds by move, of which each segment gets the least."""
        wanted = np.full(len(program.segments), np.inf)
        np.minimum.at(wanted, moves.segment, np.where(moves.moves.rapid, np.inf, feed))
        own = np.array(
            [
                one.feed if one.schedulable and one.feed is not None else np.nan
                for one in program.segments
            ]
        )
        with np.errstate(invalid='ignore'):
            step = np.ceil(np.log(own / np.minimum(wanted, own)) / np.log(STEP) - 1e-9)
            feeds = own * STEP**-step
        least = 2e-3 * 1e-3 / 60.0
        return write_program(program, np.where(feeds < least, least, feeds))

    def _fastest_of(
        self, tried: Sequence[tuple[ProgramMoves, PathMode | None]]
    ) -> tuple[int, float]:
        """Return which moves with a path mode are best, and with which acceleration.

        The likely ones come first: the better what is known, the less of the others is measured.
        """
        best: tuple[tuple[bool, float], int, float] | None = None
        for number in sorted(range(len(tried)), key=lambda number: number != self._likely):
            late, longest = (True, np.inf) if best is None else best[0]
            found = [
                (self._order(judged), number, share)
                for share, judged in self._ladder(*tried[number], np.inf if late else longest)
            ]
            first = min(found, key=lambda one: one[0], default=None)
            if first is not None and (best is None or first[:2] < best[:2]):
                best = first
        assert best is not None
        return best[1:]

    def _ladder(
        self, moves: ProgramMoves, mode: PathMode | None, longest: float
    ) -> Iterator[tuple[float, ProgramResult]]:
        """Look for the largest acceleration that keeps the aim, of a ladder and in between.

        Time rises as the acceleration falls, so that below one that takes longer than wanted
        nothing is looked for.  What was judged is yielded.
        """
        kept = False

        def known(share: float) -> Iterator[tuple[float, ProgramResult]]:
            nonlocal kept
            judged = self._try(moves, share, mode, longest)
            kept = judged is None or judged.error <= self._aim
            if judged is not None:
                yield share, judged

        yield from known(1.0)
        if kept:
            return
        low, high = 0, len(LADDER)
        while low < high:
            middle = (low + high) // 2
            yield from known(float(LADDER[middle]))
            low, high = (low, middle) if kept else (middle + 1, high)
        if 0 < low < len(LADDER):
            beyond, within = float(LADDER[low - 1]), float(LADDER[low])
            for _ in range(FINER):
                between = float(np.sqrt(beyond * within))
                yield from known(between)
                beyond, within = (beyond, between) if kept else (between, within)

    def _order(self, judged: ProgramResult) -> tuple[bool, float]:
        kept = judged.error <= self._aim
        return not kept, judged.duration if kept else judged.error


def best_of(judged: Sequence[ProgramResult], tolerance: float) -> int:
    """Return which is the fastest that keeps a tolerance, or has the least error if none does.

    Of those that take no more than `NOTICED` longer than the fastest, the first one.

    Parameters
    ----------
    judged : sequence of ProgramResult
        The cheapest remedies first.
    tolerance : float
        Largest contour error wanted [m].
    """
    kept = [index for index, one in enumerate(judged) if one.error <= tolerance]
    if not kept:
        return min(range(len(judged)), key=lambda index: judged[index].error)
    least = min(judged[index].duration for index in kept)
    return next(index for index in kept if judged[index].duration <= (1.0 + NOTICED) * least)


def with_lower_aims(
    advice: Advice, adviser: Adviser, run: Callable[[ProgramRemedy, int], ProgramResult]
) -> tuple[Advice, list[ProgramResult]]:
    """Run remedies on the real controller, and those that leave too much with a lower aim again.

    What could be the fastest that keeps the tolerance gets up to `AGAIN` corrections.

    Parameters
    ----------
    advice : Advice
        What was found on the simulated controller.
    adviser : Adviser
        What found it.
    run : callable
        Runs a remedy; is told which it is by its number, counted on with those that follow.

    Returns
    -------
    Advice
        With the remedies as they ran last.
    list of ProgramResult
        What they did on the real controller.
    """
    remedies = list(advice.remedies)
    measured = [run(remedy, number) for number, remedy in enumerate(remedies)]
    runs = len(remedies)
    left = {index: AGAIN for index, remedy in enumerate(remedies) if remedy.kept}
    while True:
        kept = [one.duration for one in measured if one.error <= advice.tolerance]
        open_yet = [
            index
            for index, more in left.items()
            if more and measured[index].error > advice.tolerance
            and measured[index].duration < min(kept, default=np.inf)
        ]  # fmt: skip
        if not open_yet:
            return replace(advice, remedies=tuple(remedies)), measured
        index = min(open_yet, key=lambda one: measured[one].duration)
        lower = adviser.lower(remedies[index], measured[index].error)
        left[index] -= 1
        if lower is None:
            left[index] = 0
            continue
        remedies[index], measured[index] = lower, run(lower, runs)
        runs += 1


def advised_program(program: Program, remedy: ProgramRemedy, units: str = 'mm') -> str:
    """Return the program that a remedy asks for, path mode included.

    Parameters
    ----------
    program : Program
        As it was given.
    remedy : ProgramRemedy
        What is recommended.
    units : {'mm', 'inch'}
        Unit before the program says G20 or G21.
    """
    text = program.text if remedy.program is None else remedy.program
    return text if remedy.mode is None else program_with_mode(text, remedy.mode, units)


LOST = 4.0
"""Feeds are refined no further where they take that many times as long as what keeps the tolerance
already: a round lowers them to `refined_feeds.FALL_MOST` at most, and raises them by less [-]."""
CUTS = (1e-4, 4e-4)
"""Distances at which a block is cut before and after a part that is too fast [m]."""
CUT_LEAST = 1.5
"""Blocks are cut where half of them is longer than that many times the cut [-]."""
BENT = float(np.radians(3.0))
"""Turn between two blocks near which they may be cut [rad]."""


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
