# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks of a part program cut into several that run along the same path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.blocks import Block, Program, Role
from fuzzycnc_ros.core.feedrate.gcode.lexer import Line, read_line
from fuzzycnc_ros.core.feedrate.gcode.modal import INCH, MINUTE
from fuzzycnc_ros.core.feedrate.gcode.segments import ArcSegment, LineSegment, Segment

DECIMALS, DECIMALS_INCH = 6, 7
"""Of the points that are put in: they are nanometres off at most."""

_OFF = 2e-9
"""Distance of a point from the path up to which it lies on it [m]."""

_SAME = 1e-9
"""Difference up to which a word is what the block does [m]."""


def split_program(program: Program, cuts: Mapping[int, Sequence[float]]) -> str:
    r"""Return the text of a program with some blocks cut into several along the same path.

    The last piece of a line is the line as it was; before it come new ones with points on it.
    The pieces of an arc have its centre.  Blocks that say more than a motion are left whole:
    other G words, radius words, expressions, incremental words.

    Parameters
    ----------
    program : Program
        As read.
    cuts : mapping of int to sequence of float
        By index in `program.segments`: where to cut, as shares of the way, rising, in (0, 1).

    Returns
    -------
    str
        The program; feeds are those of the blocks.

    Examples
    --------
    >>> from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
    >>> program = read_program('G1 X10 F600\nY4 (up)\n')
    >>> print(split_program(program, {1: [0.25]}), end='')
    G1 X10 F600
    G1 Y1
    Y4 (up)
    """
    lines: list[str] = []
    index = -1
    for block in program.blocks:
        index += block.segment is not None
        shares = cuts.get(index) if block.segment is not None else None
        lines += _pieces(block, shares) if shares else [block.text]
    return ''.join(lines)


def check_same_path(program: Program, other: Program) -> None:
    """Refuse a program that does not run along the same path as another one.

    Parameters
    ----------
    program, other : Program
        As it was, and with some blocks cut.

    Raises
    ------
    ValueError
        If an end of a block is another one, or a point that was put in is not on the path.
    """
    pieces = iter(other.segments)
    for segment in program.segments:
        here: list[Segment] = []
        while not here or here[-1].end != segment.end:
            piece = next(pieces, None)
            if piece is None or len(here) > 64 or type(piece) is not type(segment):
                raise ValueError(f'line {segment.line}: expected the same path but it was changed')
            here.append(piece)
            if np.isnan(segment.end).any():
                break
        for piece in here:
            if not _along(piece, segment):
                raise ValueError(f'line {segment.line}: a piece of it is not on its path')
    if next(pieces, None) is not None:
        raise ValueError('expected the same path but blocks were added at its end')


def _along(piece: Segment, segment: Segment) -> bool:
    """Return True if a piece lies on a segment: on its line, or on an arc of one centre."""
    if isinstance(segment, ArcSegment) and isinstance(piece, ArcSegment):
        same = np.abs(np.subtract(piece.centre, segment.centre)).max() < 2.0 * _OFF
        near = np.abs(np.subtract(sorted(piece.radii), sorted(segment.radii))).max()
        within = abs(segment.radii[1] - segment.radii[0]) + _OFF
        return bool(same and near <= within and piece.sweep * segment.sweep > 0.0)
    if piece.end == segment.end and piece.start == segment.start:
        return True
    way = np.subtract(segment.end, segment.start)
    square = float(way @ way)
    for point in (piece.start, piece.end):
        away = np.subtract(point, segment.start)
        share = float(away @ way) / square if square else 0.0
        if not -1e-9 <= share <= 1.0 + 1e-9 or np.abs(away - share * way).max() > _OFF:
            return False
    return True


def _pieces(block: Block, shares: Sequence[float]) -> list[str]:
    """Return the lines of a block that is cut; the line itself where it cannot be."""
    segment = block.segment
    line = read_line(block.text, block.line)
    if segment is None or not _plain(block, line):
        return [block.text]
    unit = block.feed_unit * MINUTE
    decimals = DECIMALS_INCH if unit == INCH else DECIMALS
    feed = '' if block.word is None else f' {block.text[slice(*block.word)].strip()}'
    ending = block.text[len(block.text.rstrip('\r\n')) :] or '\n'

    def number(value: float) -> str:
        return f'{round(value / unit, decimals) + 0.0:.{decimals}f}'.rstrip('0').rstrip('.')

    def words(letters: str, values: Sequence[float]) -> str:
        return ''.join(
            f' {letter}{number(value)}' for letter, value in zip(letters, values, strict=True)
        )

    if isinstance(segment, LineSegment):
        moving = [axis for axis in range(3) if segment.start[axis] != segment.end[axis]]
        letters = ''.join('XYZ'[axis] for axis in moving)
        start, end = np.array(segment.start), np.array(segment.end)
        points = (start + share * (end - start) for share in shares)
        added = [f'G1{words(letters, point[moving].tolist())}{feed}{ending}' for point in points]
        return [*added, block.text]
    assert isinstance(segment, ArcSegment)
    first, second, height = segment.axes
    code = 'G3' if segment.sweep > 0.0 else 'G2'
    axes = [first, second] + ([height] if segment.start[height] != segment.end[height] else [])
    letters = ''.join('XYZ'[axis] for axis in axes)
    centre = np.array(segment.centre)
    here = np.array(segment.start)
    added = []
    for share in shares:
        there = _on_arc(segment, share)
        offset = centre - here[[first, second]]
        added.append(
            f'{code}{words(letters, there[axes].tolist())}'
            f'{words("IJK"[first] + "IJK"[second], offset.tolist())}{feed}{ending}'
        )
        # from where the controller will be: the words are rounded
        here = np.round(there / unit, decimals) * unit
    offset = centre - here[[first, second]]
    text = block.text
    for word in sorted(line.words, key=lambda word: -word.start):
        if word.letter in 'IJK':
            value = number(offset[[first, second].index('IJK'.index(word.letter))])
            text = f'{text[: word.start]}{word.letter}{value}{text[word.end :]}'
    return [*added, text]


def _on_arc(segment: ArcSegment, share: float) -> Array:
    """Return the point of an arc at a share of its angle [m]."""
    first, second, height = segment.axes
    begin, end = segment.radii
    angle = np.arctan2(
        segment.start[second] - segment.centre[1], segment.start[first] - segment.centre[0]
    )
    radius = begin + (end - begin) * share
    point = np.empty(3)
    point[first] = segment.centre[0] + radius * np.cos(angle + segment.sweep * share)
    point[second] = segment.centre[1] + radius * np.sin(angle + segment.sweep * share)
    point[height] = segment.start[height] + share * (segment.end[height] - segment.start[height])
    return point


def _plain(block: Block, line: Line) -> bool:
    """Return True if a block is a line or an arc and nothing else, in absolute words."""
    segment = block.segment
    if block.role is not Role.FEED or block.optional or line.names or line.calls or line.strange:
        return False
    if not isinstance(segment, (LineSegment, ArcSegment)):
        return False
    unit = block.feed_unit * MINUTE
    letters = [word.letter for word in line.words]
    if len(set(letters)) != len(letters):
        return False
    arc, code = False, 1.0
    if isinstance(segment, ArcSegment):
        arc, code = True, 3.0 if segment.sweep > 0.0 else 2.0
    inside = ['IJK'[axis] for axis in segment.axes[:2]] if isinstance(segment, ArcSegment) else []
    if arc and not all(letter in letters for letter in inside):
        return False
    for letter, value, _, _ in line.words:
        if (
            value is None
            or letter not in 'NFGXYZIJK'
            or (letter in 'IJK' and letter not in inside)
        ):
            return False
        if letter == 'G' and value != code:
            return False
        if letter in 'XYZ' and abs(value * unit - segment.end['XYZ'.index(letter)]) > _SAME:
            return False
        if letter in inside and isinstance(segment, ArcSegment):
            axis = inside.index(letter)
            wanted = segment.centre[axis] - segment.start[segment.axes[axis]]
            if abs(value * unit - wanted) > _SAME:
                return False
    # a full turn has no end to be told from its start
    return not (arc and segment.start == segment.end)
