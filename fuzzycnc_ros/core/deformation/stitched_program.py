# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Part programs as stitches: read in figures, and written with the stitches in new places."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import hypot

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.stitch_path import ARC, LINE, StitchPath
from fuzzycnc_ros.core.feedrate.gcode.blocks import Block, Role
from fuzzycnc_ros.core.feedrate.gcode.lexer import read_line
from fuzzycnc_ros.core.feedrate.gcode.modal import CUTTER, INCH, LENGTH_UNIT, MILLIMETRE
from fuzzycnc_ros.core.feedrate.gcode.reader import ProgramReader
from fuzzycnc_ros.core.feedrate.gcode.segments import (
    ArcSegment,
    LineSegment,
    ProgramError,
    UnplacedSegment,
)

SAME_PLACE = 1e-9
"""Distance below which nothing moves, and below which an offset is none [m]."""

_UNITS = {'mm': MILLIMETRE, 'inch': INCH}
_DECIMALS = {MILLIMETRE: 4, INCH: 6}
_GEOMETRY = frozenset('XYIJKRP')
_MOTION = {10: 'G1', 20: 'G2', 30: 'G3'}
_ENDING = re.compile(r'[\r\n]*\Z')


@dataclass
class _Figure:
    """Stitches from one rapid to the next.

    Attributes
    ----------
    points : list of ndarray
        Nominal points of each block after its start, shape (steps, 2) [m], the start in front.
    kind, turn : list of float
        Kind and sense of the turn of each block.
    lines : list of int
        Line of each block.
    """

    points: list[Array] = field(default_factory=list)
    kind: list[float] = field(default_factory=list)
    turn: list[float] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)

    @property
    def steps(self) -> list[int]:
        """Steps of each block."""
        return [len(block) for block in self.points[1:]]

    def path(self, depth: float, step: float) -> StitchPath:
        """Return the stitches at one depth [m] and nominal step [m]."""
        return StitchPath(
            np.concatenate(self.points),
            np.repeat(self.kind, self.steps),
            depth=depth,
            step=step,
            turn=np.repeat(self.turn, self.steps),
        )


@dataclass(frozen=True)
class _ProgramLine:
    """A line of the program, and the figure and block that it belongs to."""

    block: Block
    unit: float
    figure: int = -1
    number: int = -1


class StitchedProgram:
    r"""A part program whose moves with feed in X and Y are stitched.

    A figure goes from one rapid in X or Y to the next; lifts in between do not end it.

    Parameters
    ----------
    lines : iterable of str
        Lines with their endings.
    step : float
        Stitch step [m]; each block is divided into equal steps of about that.
    units : {'mm', 'inch'}
        Unit before the program says G20 or G21.
    size : tuple of float, optional
        Clamped area from the origin, which no point may leave [m].

    Attributes
    ----------
    figures : list of _Figure
        The figures.

    Raises
    ------
    ProgramError
        At the first line that says something impossible, or that cannot be stitched: a block
        shorter than a step, a curve, a move of X or Y together with another axis, relative
        coordinates, cutter compensation, a point off the sheet; and if nothing is stitched.

    Examples
    --------
    >>> program = StitchedProgram(['G0 X0 Y0\n', 'G1 X9 F600 (side)\n', 'M30\n'], 3e-3)
    >>> offset = np.zeros((4, 2))
    >>> offset[1:, 1] = 1e-4, 2e-4, 3e-4
    >>> print(''.join(program.written([offset])), end='')
    G0 X0 Y0
    G1 X3. Y0.1 F600 (side)
    X6. Y0.2
    X9. Y0.3
    M30
    """

    def __init__(
        self,
        lines: Iterable[str],
        step: float,
        *,
        units: str = 'mm',
        size: tuple[float, float] | None = None,
    ) -> None:
        self.figures: list[_Figure] = []
        self._entries: list[_ProgramLine] = []
        self._step, self._size = step, size
        self._unit, self._absolute, self._cutter = _UNITS[units], True, False
        self._open = False
        for block in ProgramReader(units).blocks(lines):
            self._take(block)
        if not self.figures:
            raise ProgramError(
                1, 'expected moves with feed (G1, G2, G3) in X and Y but found none to stitch'
            )

    def written(self, offsets: Sequence[Array]) -> Iterator[str]:
        """Yield the lines of the program with its stitches shifted.

        Parameters
        ----------
        offsets : sequence of ndarray
            Offsets of the points of each figure, shape (steps + 1, 2) [m].

        Yields
        ------
        str
            Lines.  A block becomes one G1 per stitch, the first with the other words and the
            comment of the block; blocks without any offset, and everything else, stay as they
            are, but for an axis that a rapid did not name after a figure that ends elsewhere.
        """
        ends = [np.cumsum([0, *figure.steps]) for figure in self.figures]
        points = [np.concatenate(figure.points) for figure in self.figures]
        shift = np.zeros(2)
        motion = ''
        for entry in self._entries:
            block = entry.block
            if entry.figure < 0:
                yield _placed(entry, shift)
                if _travels(block):
                    shift = np.zeros(2)
                motion = _motion(block) or motion
                continue
            first, last = ends[entry.figure][entry.number : entry.number + 2]
            part = offsets[entry.figure][first : last + 1]
            shift = part[-1]
            own = _motion(block)
            if np.abs(part).max() < SAME_PLACE:
                wanted = own or _word_of(block)
                yield (
                    block.text if own or motion == wanted else _replaced(block, wanted, keep=True)
                )
                motion = wanted
                continue
            texts = [
                f'X{_number(x, entry.unit)} Y{_number(y, entry.unit)}'
                for x, y in points[entry.figure][first + 1 : last + 1] + part[1:]
            ]
            begun = _replaced(block, f'G1 {texts[0]}')
            ending = _ending(begun) or '\n'
            yield begun if _ending(begun) or len(texts) == 1 else f'{begun}{ending}'
            yield from (f'{text}{ending}' for text in texts[1:])
            motion = 'G1'

    def _take(self, block: Block) -> None:
        """Take a block: remember what it sets, and add it to a figure if it is stitched."""
        for word in read_line(block.text, block.line).words:
            if word.letter == 'G' and word.value is not None:
                code = round(10.0 * word.value)
                self._unit = LENGTH_UNIT.get(code, self._unit)
                if code in (900, 910):
                    self._absolute = code == 900
                elif code in CUTTER or code == 400:
                    self._cutter = code != 400
        segment = block.segment
        passed = segment is None or segment.rapid or isinstance(segment, UnplacedSegment)
        if segment is None or passed or not _travels(block):
            self._open = self._open and not _travels(block)
            self._entries.append(_ProgramLine(block, self._unit))
            return
        points = self._stitches(block)
        start = np.array(segment.start[:2])
        if not self._open:
            self.figures.append(_Figure([start[np.newaxis]]))
            self._open = True
        figure = self.figures[-1]
        figure.points.append(points)
        turn = segment.sweep if isinstance(segment, ArcSegment) else 0.0
        figure.kind.append(float(ARC if turn else LINE))
        figure.turn.append(float(np.sign(turn)))
        figure.lines.append(block.line)
        entry = _ProgramLine(block, self._unit, len(self.figures) - 1, len(figure.lines) - 1)
        self._entries.append(entry)

    def _stitches(self, block: Block) -> Array:
        """Return the stitches of a block after its start, shape (steps, 2) [m]."""
        segment = block.segment
        assert segment is not None
        refused = ''
        if not isinstance(segment, (LineSegment, ArcSegment)):
            refused = 'a NURBS curve; give lines and arcs'
        elif segment.turning or segment.start[2] != segment.end[2]:
            refused = 'another axis moving along; stitch in the plane'
        elif isinstance(segment, ArcSegment) and segment.axes[:2] != (0, 1):
            refused = 'an arc in another plane; stitch in G17'
        elif not self._absolute:
            refused = 'relative coordinates (G91); give absolute ones (G90)'
        elif self._cutter:
            refused = 'cutter compensation; switch it off (G40)'
        elif read_line(block.text, block.line).assigned:
            refused = 'words of the control (such as CR=); give X, Y, I and J'
        elif block.optional:
            refused = 'a block that may be skipped (/); the path must be known'
        if refused:
            raise ProgramError(
                block.line, f'expected a line or an arc in X and Y but found {refused}'
            )
        length = segment.length
        if length < self._step * (1.0 - 1e-9):
            raise ProgramError(
                block.line,
                f'expected a block of at least the stitch step of {1e3 * self._step:g} mm but '
                f'found {1e3 * length:.3f} mm; join short blocks, or take a shorter step',
            )
        points = segment.points(max(round(length / self._step), 1))[:, :2]
        if self._size is not None:
            outside = ((points < 0.0) | (points > self._size)).any(axis=1)
            if outside.any():
                x, y = 1e3 * points[int(outside.argmax())]
                raise ProgramError(
                    block.line,
                    f'expected points on the sheet of {1e3 * self._size[0]:g} x '
                    f'{1e3 * self._size[1]:g} mm from the origin but found {x:.3f}, {y:.3f} mm',
                )
        return np.asarray(points[1:])


def _travels(block: Block) -> bool:
    """Return whether a block moves X or Y, or may do so."""
    segment = block.segment
    if segment is None or isinstance(segment, UnplacedSegment):
        return block.role in (Role.RAPID, Role.KEPT, Role.SEALED)
    if not all(np.isfinite([*segment.start, *segment.end])):
        return False  # a wait in a place that is not known
    apart = hypot(segment.end[0] - segment.start[0], segment.end[1] - segment.start[1])
    return apart > SAME_PLACE or (isinstance(segment, ArcSegment) and segment.axes[:2] == (0, 1))


def _motion(block: Block) -> str:
    """Return the motion word of a block, if it has one."""
    found = ''
    for word in read_line(block.text, block.line).words:
        if word.letter == 'G' and word.value is not None:
            found = _MOTION.get(round(10.0 * word.value), found)
    return found


def _word_of(block: Block) -> str:
    """Return the motion word that a block needs."""
    if not isinstance(block.segment, ArcSegment):
        return 'G1'
    return 'G3' if block.segment.sweep > 0.0 else 'G2'


def _placed(entry: _ProgramLine, shift: Array) -> str:
    """Return a line that is not stitched, with both axes named if the tool stands elsewhere."""
    block, segment = entry.block, entry.block.segment
    if segment is None or not segment.rapid or not _travels(block):
        return block.text
    named = {word.letter for word in read_line(block.text, block.line).words}
    missing: Mapping[str, float] = {
        axis: place
        for axis, place, off in zip('XY', segment.end, shift, strict=False)
        if axis not in named and abs(off) >= SAME_PLACE
    }
    added = ''.join(f' {axis}{_number(place, entry.unit)}' for axis, place in missing.items())
    return f'{block.text[: block.insert]}{added}{block.text[block.insert :]}'


def _replaced(block: Block, text: str, *, keep: bool = False) -> str:
    """Return a line with other geometry, or with a motion word in front of what it has."""
    words = read_line(block.text, block.line).words
    geometry = [
        word
        for word in words
        if word.letter in _GEOMETRY
        or (word.letter == 'G' and round(10.0 * (word.value or 0.0)) in _MOTION)
    ]
    place = min(word.start for word in geometry)
    if keep:
        return f'{block.text[:place]}{text} {block.text[place:]}'
    line = block.text
    for word in reversed(geometry):
        end = word.end
        while end < len(line) and line[end] in ' \t':
            end += 1
        line = line[: word.start] + line[end:]
    rest = line[place:]
    gap = ' ' if rest.strip() else ''
    return f'{line[:place]}{text}{gap}{rest}'


def _number(place: float, unit: float) -> str:
    decimals = _DECIMALS[unit]
    value = round(place / unit, decimals) + 0.0  # no -0
    return f'{value:.{decimals}f}'.rstrip('0')


def _ending(text: str) -> str:
    """Return the ending of a line, empty where the last one has none."""
    found = _ENDING.search(text)
    return found[0] if found else ''
