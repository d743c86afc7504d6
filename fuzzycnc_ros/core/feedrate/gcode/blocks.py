# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A part program as read: its lines, what moves, what was passed through, and a tally of feeds."""

from dataclasses import dataclass
from enum import Enum, auto
from functools import cached_property
from math import isnan

from fuzzycnc_ros.core.feedrate.gcode.segments import Segment


class Role(Enum):
    """Meaning of a line for the feed."""

    PLAIN = auto()
    """Moves nothing that heeds the feed."""
    RAPID = auto()
    """A rapid; a feed word on it is heeded by the blocks that follow."""
    FEED = auto()
    """Moves along a segment whose feed may be chosen."""
    KEPT = auto()
    """Moves, or may move, with the feed of the program; a feed word may be added."""
    SEALED = auto()
    """May move with the feed of the program; no feed word may be added (cycles, calls, `/`)."""


@dataclass(frozen=True, slots=True)
class Block:
    """One line of a part program.

    Parameters
    ----------
    line : int
        Its number, the first one is 1.
    text : str
        The line as it was read, with its ending.
    role : Role
        What it means for the feed.
    segment : Segment or None
        What moves; of a curve over many lines the first line has it.
    feed : float or None
        Feed of the program in effect at the end of the line [m/s], None where it is none.
    word : tuple of int, length 2, or None
        Where the line's own feed word starts and ends in the text, if it sets the feed.
    insert : int
        Where in the text a feed word may be put.
    feed_unit : float
        What one unit of a feed word is [m/s].
    optional : bool
        A switch at the machine may skip the line.
    followed : bool
        The line belongs to a part whose order O-words or calls decide: it may be run several
        times, and each time is a block.
    rounding : float or None
        How far the program lets its corners be rounded off [m]: P of G64, 0 for exact path and
        exact stop (G61, G61.1); None where it does not say.
    """

    line: int
    text: str
    role: Role
    segment: Segment | None
    feed: float | None
    word: tuple[int, int] | None
    insert: int
    feed_unit: float
    optional: bool
    followed: bool = False
    rounding: float | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """Something that was passed through untouched.

    Parameters
    ----------
    line : int
        Where it was met first.
    count : int
        How often it was met.
    text : str
        What it is, and what follows from it.
    """

    line: int
    count: int
    text: str

    def __str__(self) -> str:
        """Say it in one line."""
        times = '' if self.count == 1 else f' ({self.count} times)'
        return f'line {self.line}: {self.text}{times}'


@dataclass(frozen=True)
class Program:
    """A part program.

    Parameters
    ----------
    blocks : tuple of Block
        All lines in the order in which they are run; those that are not run come last.
    notes : tuple of Note
        What was passed through, in the order in which it was met first.
    """

    blocks: tuple[Block, ...]
    notes: tuple[Note, ...]

    @property
    def text(self) -> str:
        """The program as it was read."""
        lines: dict[int, str] = {}
        for block in self.blocks:
            lines.setdefault(block.line, block.text)
        return ''.join(lines[number] for number in sorted(lines))

    @cached_property
    def segments(self) -> tuple[Segment, ...]:
        """Moving parts in order; rapids and dwells among them."""
        return tuple(block.segment for block in self.blocks if block.segment is not None)

    @cached_property
    def runs(self) -> tuple[tuple[int, int], ...]:
        """First and one past the last index in `segments` of each run that may be scheduled.

        Inside a run the tool moves on from segment to segment without a stop or a gap that the
        program asks for; before and after it the speed is the machine's own matter.  Segments of
        no length may lie inside.
        """
        found: list[tuple[int, int]] = []
        for index, segment in enumerate(self.segments):
            if not segment.schedulable:
                continue
            if found and self.segments[found[-1][1] - 1].run == segment.run:
                found[-1] = (found[-1][0], index + 1)
            else:
                found.append((index, index + 1))
        return tuple(found)


_LOWER = 1.0 - 1e-6  # share of its own feed below which a block has got another one


class FeedTally:
    r"""Counts motions by what decided their feed.

    Examples
    --------
    >>> from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
    >>> tally = FeedTally()
    >>> for block in read_program('G0 X1\nM30\n').blocks:
    ...     tally.take(block, None)
    >>> tally.reason
    'only rapids, no motion with feed'
    """

    def __init__(self) -> None:
        self._chosen = self._lowered = self._kept = self._rapid = 0

    def take(self, block: Block, feed: float | None) -> None:
        """Take a block with the feed chosen for it [m/s], None or NaN for its own."""
        if feed is not None and not isnan(feed):
            self._chosen += 1
            self._lowered += block.feed is not None and feed < _LOWER * block.feed
        elif block.role in (Role.KEPT, Role.SEALED):
            self._kept += 1
        elif block.role is Role.RAPID:
            self._rapid += 1

    @property
    def reason(self) -> str:
        """Why no feed word is another one, if none is."""
        kept = f'{self._kept:,} motions or calls keep their feed for the reasons noted'
        if self._lowered:
            return f'{self._lowered:,} feeds are lower by less than a feed word can say'
        if self._chosen:
            found = f'the tolerance asks for no lower feed on the {self._chosen:,} blocks with one'
            return f'{found}; {kept}' if self._kept else found
        if self._kept:
            return f'no feed may be chosen: {kept}'
        return 'only rapids, no motion with feed' if self._rapid else 'nothing moves'
