# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A part program as a controller of the kind of LinuxCNC runs it, and what its axes make of it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.blocks import Block, Role
from fuzzycnc_ros.core.feedrate.gcode.lexer import read_line
from fuzzycnc_ros.core.feedrate.gcode.segments import (
    ArcSegment,
    DwellSegment,
    LineSegment,
    Segment,
)
from fuzzycnc_ros.simulation.controller.blends import ControllerLimits, Corners
from fuzzycnc_ros.simulation.controller.motion import Commanded, FeedShare, chains, command
from fuzzycnc_ros.simulation.controller.moves import Moves

_MODE = re.compile(r'[gG]\s*0*6\s*[14]')
_STANDS = re.compile(r'[mMtT]\s*\d')
_GAP = 1e-9
"""Distance up to which two segments meet [m]."""
_CURVE_CHORD = 1e-6
"""Distance of the lines from a NURBS curve that stand for it [m], about."""


@dataclass(frozen=True)
class PathMode:
    """Path mode: treatment of corners.

    Parameters
    ----------
    rounding : float
        How far it may leave a corner [m], P of G64; infinite for G64 without P, 0 for exact path
        (G61), NaN for exact stop (G61.1).
    merging : float
        How far lines may lie from the one that they are merged into [m], Q of G64.
    """

    rounding: float = inf
    merging: float = 0.0

    @property
    def word(self) -> str:
        """The words of a program in millimetres."""
        if np.isnan(self.rounding):
            return 'G61.1'
        if self.rounding == 0.0:
            return 'G61'
        if self.rounding == inf:
            return 'G64'
        q = '' if self.merging == self.rounding else f' Q{1e3 * self.merging:.6g}'
        return f'G64 P{1e3 * self.rounding:.6g}{q}'


def path_modes(
    blocks: Iterable[Block], before: PathMode | None = None
) -> Iterator[tuple[Block, PathMode]]:
    r"""Yield the blocks of a program with the path mode that is in effect at their ends.

    Parameters
    ----------
    blocks : iterable of Block
        As `ProgramReader` yields them.
    before : PathMode, optional
        What is in effect before the program says so: G64 without P, as LinuxCNC starts.

    Examples
    --------
    >>> from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
    >>> program = read_program('G21 G61\nG1 X1 F60\nG64 P0.02\nX2\n')
    >>> [mode.word for _, mode in path_modes(program.blocks)]
    ['G61', 'G61', 'G64 P0.02', 'G64 P0.02']
    """
    mode = before or PathMode()
    for block in blocks:
        if '6' in block.text and _MODE.search(block.text):
            mode = _mode_of(block, mode)
        yield block, mode


def _mode_of(block: Block, mode: PathMode) -> PathMode:
    words = read_line(block.text, block.line).words
    codes = [round(10.0 * word.value) for word in words if word.letter == 'G' and word.value]
    if 611 in codes:
        return PathMode(nan, 0.0)
    if 610 in codes:
        return PathMode(0.0, 0.0)
    if 640 not in codes:
        return mode
    # the feed is in the same unit per minute
    unit = 60.0 * block.feed_unit
    given = {word.letter: word.value * unit for word in words if word.value is not None}
    rounding = given.get('P', 0.0)
    merging = given.get('Q', rounding)
    return PathMode(rounding or inf, merging)


@dataclass(frozen=True, eq=False)
class ProgramMoves:
    """The moves of a part program.

    Attributes
    ----------
    moves : Moves
        All of them.
    line, segment : ndarray of int, shape (n,)
        Numbers of their lines, and indices among the program's segments.
    unknown : int
        Motions that are left out, since the program does not say where they go.
    """

    moves: Moves
    line: NDArray[np.intp]
    segment: NDArray[np.intp]
    unknown: int

    def with_feeds(self, feeds: Array) -> ProgramMoves:
        """Return the program with other feeds by segment [m/s]; NaN keeps its own."""
        feed = feeds[self.segment]
        feed = np.where(np.isnan(feed), self.moves.feed, feed)
        return replace(self, moves=replace(self.moves, feed=feed))

    def runs(self) -> list[Moves]:
        """Return the moves in paths without a gap."""
        first = np.flatnonzero(self.moves.first)
        edge = np.append(first, len(self.moves))
        return [self.moves.chosen(np.arange(low, high)) for low, high in pairwise(edge)]

    @cached_property
    def chains(self) -> list[list[tuple[Moves, Corners]]]:
        """Moves and corners of each path as the planner gets them, once for all limits."""
        return [chains(run) for run in self.runs()]


def program_moves(blocks: Iterable[Block], before: PathMode | None = None) -> ProgramMoves:
    """Return the moves of a part program, as a controller gets them before it merges lines.

    Parameters
    ----------
    blocks : iterable of Block
        As `ProgramReader` yields them.
    before : PathMode, optional
        The path mode before the program says so.

    Raises
    ------
    ValueError
        If nothing moves.
    """
    rows: list[tuple[float, ...]] = []
    arcs: list[tuple[int, ArcSegment]] = []
    flags: list[list[bool]] = []
    line: list[tuple[int, int]] = []
    place, unknown, broken = 0.0, 0, True
    where: tuple[float, ...] = (nan,) * 3
    number = -1
    for block, mode in path_modes(blocks, before):
        segment = block.segment
        if segment is None:
            if flags and _STANDS.search(block.text) and block.insert:
                flags[-1][1] = flags[-1][1] or _stands(block)
            if block.role in (Role.KEPT, Role.SEALED, Role.RAPID):
                unknown, broken = unknown + 1, True
            continue
        number += 1
        if isinstance(segment, DwellSegment):
            if flags:
                flags[-1][1] = True
                rows[-1] = (*rows[-1][:-1], rows[-1][-1] + segment.duration)
            continue
        if not (np.isfinite(segment.start).all() and np.isfinite(segment.end).all()):
            unknown, broken = unknown + 1, True
            continue
        if segment.length == 0.0:
            continue
        for part in _plain(segment):
            gap = broken or max(map(abs, np.subtract(part.start, where))) > _GAP
            feed = inf if part.rapid else (part.feed or nan)
            if feed != feed:
                unknown, broken = unknown + 1, True
                break
            if isinstance(part, ArcSegment):
                arcs.append((len(rows), part))
            length = part.length
            rows.append(
                (*part.start, *part.end, length, feed, place, place + length, mode.rounding,
                 mode.merging, 0.0)
            )  # fmt: skip
            flags.append([part.rapid, False, gap])
            line.append((part.line, number))
            place, where, broken = place + length, part.end, False
    if not rows:
        raise ValueError('expected a program that moves the tool but found none of its moves')
    number, index = np.array(line, dtype=np.intp).T
    return ProgramMoves(_table(rows, flags, arcs), number, index, unknown)


def _stands(block: Block) -> bool:
    """Return True if a line without a motion lets the tool stand: M and T words do."""
    return any(word.letter in 'MT' for word in read_line(block.text, block.line).words)


def _plain(segment: Segment) -> Iterable[Segment]:
    """Return a segment as lines and arcs."""
    if isinstance(segment, (LineSegment, ArcSegment)):
        return (segment,)
    # a cusp bends infinitely: no sharper than the chord error is told apart
    bend = min(float(segment.curvatures(64).max()), 1.0 / _CURVE_CHORD)
    count = int(np.ceil(segment.length * np.sqrt(max(bend, 1e-9) / (8.0 * _CURVE_CHORD))))
    points = [tuple(point) for point in segment.points(max(count, 8)).tolist()]
    return [
        LineSegment(segment.line, one, other, segment.feed, False, False, segment.run)
        for one, other in pairwise(points)
    ]


def _table(
    rows: list[tuple[float, ...]], flags: list[list[bool]], arcs: list[tuple[int, ArcSegment]]
) -> Moves:
    table, flag = np.array(rows), np.array(flags, dtype=bool)
    count = len(table)
    centre, radial, across, rise = (np.zeros((count, 3)) for _ in range(4))
    sweep, growth = np.zeros(count), np.zeros(count)
    flat = np.zeros(count, dtype=bool)
    for index, arc in arcs:
        first, second, height = arc.axes
        spot = np.zeros(3)
        spot[[first, second]], spot[height] = arc.centre, arc.start[height]
        out = np.subtract(arc.start, spot)
        turned = np.zeros(3)
        turned[first], turned[second] = -out[second], out[first]
        centre[index], radial[index] = spot, out
        across[index] = turned if arc.sweep > 0.0 else -turned
        rise[index, height] = arc.end[height] - arc.start[height]
        sweep[index] = abs(arc.sweep)
        begin, end = arc.radii
        growth[index] = end / begin - 1.0 if begin > 0.0 else 0.0
        flat[index] = height == 2
    return Moves(
        table[:, :3], table[:, 3:6], centre, radial, across, rise, sweep, growth, table[:, 6],
        table[:, 7], flag[:, 0], flag[:, 1], flag[:, 2], table[:, 12], table[:, 10],
        table[:, 11], flat, table[:, 8:10],
    )  # fmt: skip


def simulate(
    moves: ProgramMoves, limits: ControllerLimits, adaptive: FeedShare | None = None
) -> list[Commanded]:
    r"""Return what a controller commands for a program, by path without a gap.

    Parameters
    ----------
    moves : ProgramMoves
        The program.
    limits : ControllerLimits
        Of the axes.
    adaptive : FeedShare, optional
        Feed share over the path in force, as with `M52 P1`.

    Examples
    --------
    >>> from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
    >>> program = read_program('G61 G1 X10 F6000\nY10\n')
    >>> limits = ControllerLimits(velocity=(0.25,) * 3, acceleration=(2.0,) * 3)
    >>> [found] = simulate(program_moves(program.blocks), limits)
    >>> f'{found.duration:.3f} s'
    '0.314 s'
    """
    return [command(path, limits, adaptive) for path in moves.chains]


def with_mode(moves: ProgramMoves, mode: PathMode) -> ProgramMoves:
    """Return a program whose path mode is another one throughout."""
    count = len(moves.moves)
    changed = replace(
        moves.moves,
        rounding=np.full(count, mode.rounding),
        merging=np.full(count, mode.merging),
    )
    return replace(moves, moves=changed)


def turns(moves: Moves) -> Array:
    """Return by how much the path turns at the end of each move [rad]; 0 at the last one."""
    index = np.arange(len(moves))
    before = moves.tangent(index[:-1], np.ones(len(index) - 1))
    after = moves.tangent(index[1:], np.zeros(len(index) - 1))
    cosine = np.clip(np.einsum('ij,ij->i', before, after), -1.0, 1.0)
    return np.append(portable.arccos(cosine), 0.0)
