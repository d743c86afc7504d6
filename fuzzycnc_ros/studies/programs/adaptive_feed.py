# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feed shares along the path of a part program, for LinuxCNC's adaptive feed (M52 P1).

The program keeps its lines, arcs and feed words.  A table beside it holds by how much of the
programmed feed the tool goes at each place of the path; the component `fuzzycnc_feed` finds the
place and writes the share.  LinuxCNC does not look ahead for that, so the table contains the
braking.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.adapters.linuxcnc.feed_process import LENGTH_OF_TOOL, NO_LENGTH
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.lexer import read_line
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.simulation.controller.agreement import disagreement
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits, move_limits
from fuzzycnc_ros.simulation.controller.motion import Commanded, FeedShare
from fuzzycnc_ros.simulation.controller.moves import merged
from fuzzycnc_ros.simulation.controller.program import (
    PathMode,
    ProgramMoves,
    program_moves,
    simulate,
)
from fuzzycnc_ros.studies.programs.path_mode_words import program_with_mode
from fuzzycnc_ros.studies.programs.program_judge import LocalErrors, ProgramPath, ProgramResult
from fuzzycnc_ros.studies.programs.refined_feeds import refine_parts

ADAPTIVE_MODE = PathMode(2e-6, 2e-6)
"""Path mode of these programs: with 4 um LinuxCNC left up to a third more than was said."""

SHARE_LEAST = 0.01
"""Least share in a table, that of the component [-]."""

_CELL = 5e-5
"""Longest part of the path with a share of its own [m]."""
_BRAKING = 0.5
"""Share of its acceleration with which LinuxCNC brakes a block that may overlap [-]."""
_AIMS = (1.0, 0.95, 0.9)
"""Shares of a tolerance that are aimed at, one after the other [-]."""
_DECIMALS = 4
"""Of shares in a table, rounded down."""
_END = (2.0, 30.0)
"""M words that end a program."""
_OFFSETS = range(540, 600)
"""G words in tenths that choose the work offset, G54 to G59.3."""
_SHIFTS = frozenset({100, 410, 411, 420, 421, 431, 432, 520, 680, 690, 920, 921, 922, 923})
"""G words in tenths that shift or turn the path while the program runs: no table knows them."""
_HEADER = re.compile(
    r'fuzzycnc-feed 1\nprogram ([0-9a-f]{64})\nwork-offset (\d+)\ntool-length (-?\d+)\n'
)


@dataclass(frozen=True, eq=False)
class FeedTable:
    """Feed shares along the path of a program, n points.

    Attributes
    ----------
    program : str
        The program that it belongs to.
    adaptive : FeedShare
        Shares over the way along the path.
    point : ndarray, shape (n, 3)
        Points of the path in the coordinates of the program [m].
    line : ndarray of int, shape (n,)
        Line of the program of the motion from each point on.
    """

    program: str
    adaptive: FeedShare
    point: Array
    line: NDArray[np.intp]

    def text(self) -> str:
        """Return the table as the component reads it; lengths in mm."""
        offset, length = coordinates(self.program)
        rows = zip(
            self.line.tolist(),
            (1e3 * self.point).tolist(),
            self.adaptive.share.tolist(),
            strict=True,
        )
        return (
            f'fuzzycnc-feed 1\nprogram {program_hash(self.program)}\n'
            f'work-offset {offset}\ntool-length {length}\npoints {len(self.line)}\n'
        ) + ''.join(
            f'{line} {x:.5f} {y:.5f} {z:.5f} {share:.{_DECIMALS}f}\n'
            for line, (x, y, z), share in rows
        )


def program_hash(program: str) -> str:
    """Return the SHA-256 of the bytes of a program, as hex digits."""
    return hashlib.sha256(program.encode(errors='surrogateescape')).hexdigest()


def coordinates(program: str) -> tuple[int, int]:
    """Return the coordinates that a program asks for.

    Returns
    -------
    offset : int
        G word of its work offset in tenths; 0 if it names none.
    length : int
        Number of its tool length, 0 for none (G49); `NO_LENGTH` or `LENGTH_OF_TOOL`.

    Raises
    ------
    ValueError
        If it shifts or turns its path, or switches the adaptive feed by itself.
    """
    offset, length = 0, NO_LENGTH
    for number, text in enumerate(program.splitlines(), 1):
        words = read_line(text, number).words
        codes = [round(10.0 * word.value) for word in words if word.letter == 'G' and word.value]
        shifts = [code for code in codes if code in _SHIFTS]
        if shifts:
            raise ValueError(
                f'line {number}: expected a program that leaves its coordinates as they are but '
                f'found G{shifts[0] / 10:g}; set them before it starts'
            )
        for code in codes:
            if code in _OFFSETS:
                offset = code
            if code == 490:
                length = 0
            if code == 430:
                given = [word.value for word in words if word.letter == 'H']
                length = round(given[0]) if given and given[0] is not None else LENGTH_OF_TOOL
    return offset, length


def adaptive_program(program: str, units: str = 'mm') -> str:
    r"""Return a program that heeds the adaptive feed, in the path mode of its table.

    Raises
    ------
    ValueError
        If it has M52 already.

    Examples
    --------
    >>> print(adaptive_program('G21\nG1 X1 F60\nM2\n'), end='')
    G21
    M52 P1
    G64 P0.002 Q0.002
    G1 X1 F60
    M52 P0
    M2
    """
    for number, text in enumerate(program.splitlines(), 1):
        if 52.0 in _codes(text, number):
            raise ValueError(f'line {number}: expected a program without M52 but found it')
    lines = program_with_mode(program, ADAPTIVE_MODE, units).splitlines(keepends=True)
    first = next(index for index, line in enumerate(lines) if line.startswith('G64 P'))
    end = next(
        (
            index
            for index in range(first + 1, len(lines))
            if lines[index].startswith('%') or any(code in _END for code in _codes(lines[index]))
        ),
        len(lines),
    )
    if not lines[-1].endswith('\n'):
        lines[-1] += '\n'
    return ''.join([*lines[:first], 'M52 P1\n', *lines[first:end], 'M52 P0\n', *lines[end:]])


def _codes(text: str, number: int = 1) -> list[float | None]:
    """Return the values of the M words of a line."""
    return [word.value for word in read_line(text, number).words if word.letter == 'M']


class AdaptiveFeed:
    """Looks for the feed shares of a program.

    Parameters
    ----------
    program : str
        As it was given.
    limits : ControllerLimits
        Of the controller.
    machine : ContouringConfig
        Lags of the axes.
    units : {'mm', 'inch'}
        Unit before the program says G20 or G21.

    Raises
    ------
    ValueError
        If the path is not known as a whole, or shifted by the program.
    """

    def __init__(
        self, program: str, limits: ControllerLimits, machine: ContouringConfig, units: str = 'mm'
    ) -> None:
        coordinates(program)
        self._program = adaptive_program(program, units)
        self._limits, self._machine = limits, machine
        self._moves = _cutting(program_moves(read_program(self._program, units).blocks))
        gaps = len(self._moves.runs()) - 1
        if gaps:
            raise ValueError(
                f'expected a program whose whole path is known but found {gaps} gaps in it: '
                'changes of the work offset or of the tool length, cycles, calls'
            )
        self.path = ProgramPath(self._moves)
        # as the planner gets them
        self._plain = plain = merged(self._moves.runs()[0])
        count = np.ceil(plain.length / _CELL).astype(int)
        self._move = np.repeat(np.arange(len(plain)), count)
        number = np.arange(len(self._move)) - np.repeat(np.cumsum(count) - count, count)
        low = plain.place[self._move, 0]
        span = plain.place[self._move, 1] - low
        self._begin = low + span * number / count[self._move]
        self._end = low + span * (number + 1) / count[self._move]
        most, gain = move_limits(plain, limits)
        self._own = np.minimum(plain.feed, most)[self._move]
        self._braking = 2.0 * _BRAKING * gain[self._move] * (self._end - self._begin)

    @property
    def disagreement(self) -> float:
        """By how much LinuxCNC may exceed the simulated contour error [-]."""
        return disagreement(self._moves.moves)

    def own(self) -> ProgramResult:
        """Judge the program in its path mode without shares."""
        return self.path.judge(simulate(self._moves, self._limits), self._machine)

    def keeping(
        self, tolerance: float, longest: float = np.inf
    ) -> tuple[FeedTable, ProgramResult]:
        """Return what `table` does for the first of some aims whose shares as written keep it."""
        for aim in _AIMS:
            table, judged = self.table(aim * tolerance, longest)
            if judged.error <= tolerance:
                break
        return table, judged

    def table(self, tolerance: float, longest: float = np.inf) -> tuple[FeedTable, ProgramResult]:
        """Return the shares that keep a tolerance, or leave the least error, and what they do.

        Parameters
        ----------
        tolerance : float
            Largest contour error wanted [m].
        longest : float
            Time from which on nobody wants it [s].
        """

        def run(feed: Array) -> LocalErrors:
            return self.path.errors(self._commanded(self._shares(feed)), self._machine)

        kept = np.zeros(len(self._own), dtype=bool)
        found = refine_parts(run, self._end, self._own, kept, tolerance, self._machine, longest)
        table = self._tabled(self._shares(found.feed))
        return table, self.path.judge(self._commanded(table.adaptive), self._machine)

    def _commanded(self, adaptive: FeedShare) -> list[Commanded]:
        return simulate(self._moves, self._limits, adaptive)

    def _shares(self, feed: Array) -> FeedShare:
        """Return shares at both ends of the parts, which LinuxCNC can brake for in time."""
        square = feed**2
        node = np.append(np.minimum(square[1:], square[:-1]), square[-1])
        speed = node.tolist()  # at the ends of the parts
        after = speed[-1]
        for index in range(len(speed) - 1, -1, -1):
            speed[index] = min(speed[index], after)
            after = min(speed[index] + float(self._braking[index]), float(square[index]))
        ends = np.sqrt(speed)
        begins = np.append(np.sqrt(after), ends[:-1])
        share = np.stack([begins, ends], axis=1) / self._own[:, np.newaxis]
        scale = 10.0**_DECIMALS
        share = np.clip(np.floor(share * scale + 1e-6) / scale, SHARE_LEAST, 1.0)
        return FeedShare(np.stack([self._begin, self._end], axis=1).ravel(), share.ravel())

    def _tabled(self, adaptive: FeedShare) -> FeedTable:
        """Return a table of the points that are needed."""
        plain, share = self._plain, adaptive.share.reshape(-1, 2)
        inside = self._begin > plain.place[self._move, 0]
        # of a line whose share stays the same its ends are enough
        flat = (share[:, 0] == share[:, 1]) & ~plain.arc[self._move]
        same = inside & flat & np.append(False, flat[:-1])
        same &= np.append(False, share[1:, 0] == share[:-1, 1])
        # the end of a part is the beginning of the next one, but where the feed is another one
        doubled = ~inside & np.append(False, share[1:, 0] != share[:-1, 1])
        begin = np.flatnonzero(~same)
        at = np.sort(np.concatenate([2 * begin, 2 * np.flatnonzero(doubled) - 1]))
        at = np.append(at, 2 * len(share) - 1)
        part = at // 2
        move = self._move[part]
        place = adaptive.place[at]
        along = (place - plain.place[move, 0]) / (plain.place[move, 1] - plain.place[move, 0])
        point = plain.position(move, along)
        last = np.searchsorted(self._moves.moves.place[:, 1], plain.place[:, 1] - 1e-12)
        line = self._moves.line[last][move]
        # from a doubled point on it is the next motion that runs
        return FeedTable(self._program, FeedShare(place, adaptive.share[at]), point, line)


def _cutting(moves: ProgramMoves) -> ProgramMoves:
    """Return moves without the paths before and behind that are rapids alone.

    Programs set the tool length on the way to the part.
    """
    first = np.flatnonzero(moves.moves.first)
    cuts = np.flatnonzero(~moves.moves.rapid)
    if not len(cuts):
        return moves
    begin = first[first <= cuts[0]][-1]
    end = np.append(first, len(moves.moves))
    kept = np.arange(begin, end[end > cuts[-1]][0])
    return replace(
        moves, moves=moves.moves.chosen(kept), line=moves.line[kept], segment=moves.segment[kept]
    )


def table_header(text: str) -> tuple[str, int, int]:
    """Return hash, work offset and tool length of a table; see `coordinates`.

    Raises
    ------
    ValueError
        If it is no table.
    """
    found = _HEADER.match(text)
    if found is None:
        raise ValueError('expected a table of `fuzzycnc schedule --as adaptive` but found none')
    return found[1], int(found[2]), int(found[3])
