# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Write part programs: every line as it was, but for the feed words."""

import math
from array import array
from collections.abc import Iterable, Iterator
from math import inf, isnan, nan

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.feedrate.gcode.blocks import Block, Program, Role
from fuzzycnc_ros.core.feedrate.gcode.modal import feed_decimals, least_feed
from fuzzycnc_ros.core.feedrate.gcode.segments import DwellSegment

# A feed that a word gives back within this is that word's own [-].
_SAME = 1e-9


def _target_of(block: Block, feed: float | None) -> float | None:
    """Return the feed that has to be in effect in a block, None if it does not matter."""
    if feed is None or math.isnan(feed):
        return block.feed if block.role in (Role.FEED, Role.KEPT) else None
    if block.role is not Role.FEED:
        raise ValueError(
            f'line {block.line}: expected no feed (NaN) for what is not schedulable but found '
            f'{feed} m/s'
        )
    if not 0.0 < feed < math.inf:
        raise ValueError(f'line {block.line}: expected a feed above 0 but found {feed} m/s')
    least = least_feed(block.feed_unit)
    if feed < least * block.feed_unit:
        raise ValueError(
            f'line {block.line}: expected a feed of at least {least:g} of the program per minute '
            f'but found {feed} m/s'
        )
    return feed


def _own_feed(block: Block, before: float | None) -> float | None:
    """Return the program's feed at a line that sets none; behind a call it may be unknown."""
    return before if block.feed is None else block.feed


def _same(feed: float, other: float | None, unit: float) -> bool:
    """Return True if two feeds [m/s] are one in a program whose unit of feed is given [m/s]."""
    if other is None:
        return False
    if feed == other:
        return True
    if abs(feed - other) > 2e-3 * unit:
        return False
    return _number(feed, unit) == _number(other, unit)


def _number(feed: float, unit: float) -> str:
    """Return a feed as digits, rounded down: no block runs faster than it should."""
    decimals = feed_decimals(unit)
    steps = max(math.floor(feed / unit * 10.0**decimals * (1.0 + _SAME)), 1)
    return f'{steps * 10.0**-decimals:.{decimals}f}'.rstrip('0')


def _with_word(block: Block, feed: float) -> str:
    """Return the text of a block with a feed word [m/s]; its own word where that is the same."""
    own = block.feed
    if block.word is not None and own is not None and abs(own - feed) <= _SAME * own:
        return block.text
    return _with_number(block, feed)


def _with_number(block: Block, feed: float) -> str:
    """Return the text of a block with a feed [m/s] in digits, instead of its own word if any."""
    text, number = block.text, _number(feed, block.feed_unit)
    if block.word is None:
        return f'{text[: block.insert]} F{number}{text[block.insert :]}'
    start, end = block.word
    return f'{text[:start]}F{number}{text[end:]}'


_MOVES = (Role.FEED, Role.KEPT, Role.RAPID)
_ELSEWHERE = -1  # a pass of a line that is not in the program: of a subroutine's own file


class _FeedLine:
    """A line: what it looks like, and the feed that holds for each of its passes."""

    __slots__ = ('block', 'free', 'most', 'moves', 'written')

    def __init__(self, block: Block) -> None:
        self.block = block
        self.free = True  # may get a feed word
        self.moves = False
        self.most = inf  # feed that is allowed in each pass [m/s]
        self.written = False

    def take(self, block: Block, allowed: float | None) -> None:
        self.moves = self.moves or block.role in _MOVES
        if block.word is not None:
            self.block = block  # a word that was computed in this pass
        if (
            allowed is None
            or block.optional
            or block.role is Role.SEALED
            or block.feed_unit != self.block.feed_unit
            or isinstance(block.segment, DwellSegment)
        ):
            self.free = False
        else:
            self.most = min(self.most, allowed)

    @property
    def addable(self) -> bool:
        """True if the line may get a word that holds for all of its passes."""
        return self.free and self.moves


class _PassMerger:
    """Chooses the feed words of lines that are run in any order and any number of times.

    A line gets the least feed of its passes, and a word only where the feed in effect would be
    another one in some pass.  A word is never above the feed that the program has in effect in
    any pass of its line, so that what follows without a word of its own runs no faster than the
    program says, wherever it was come from.

    Parameters
    ----------
    active : float or None
        Feed in effect before the first pass [m/s], None where it is unknown.
    """

    def __init__(self, active: float | None) -> None:
        self._start = active
        self._before: float | None = None  # feed of the program after the last pass
        self._entry: dict[int, _FeedLine] = {}
        # Of each pass its line, the feed that it asks for and that of the program; NaN for none.
        self._line = array('q')
        self._target = array('d')
        self._own = array('d')
        self._sets = array('b')

    def take(self, block: Block, feed: float | None) -> None:
        """Take a pass with its feed [m/s], None or NaN for that of the program."""
        target = _target_of(block, feed)
        if block.role is Role.SEALED and block.word is None:
            target = _own_feed(block, self._before)
        self._before = block.feed
        if block.text:
            entry = self._entry.get(block.line)
            if entry is None:
                entry = self._entry[block.line] = _FeedLine(block)
            entry.take(block, block.feed if target is None else target)
        self._line.append(block.line if block.text else _ELSEWHERE)
        self._target.append(nan if target is None else target)
        self._own.append(nan if block.feed is None else block.feed)
        self._sets.append(block.word is not None)

    def lines(self) -> Iterator[str]:
        """Yield all lines in the order of their numbers."""
        while self._corrected():
            pass
        for number in sorted(self._entry):
            entry = self._entry[number]
            yield _with_number(entry.block, entry.most) if entry.written else entry.block.text

    def _corrected(self) -> bool:
        """Run all passes; return whether a line got a word, or a lower one, on the way."""
        changed, active = False, self._start
        setter: _FeedLine | None = None  # line whose new word is in effect
        rapid: _FeedLine | None = None  # first rapid after what was scheduled
        for line, target, own, sets in zip(
            self._line, self._target, self._own, self._sets, strict=True
        ):
            entry = self._entry.get(line)
            if entry is not None and entry.written:
                active, setter = entry.most, entry
            elif sets or (isnan(own) and isnan(target)):
                active, setter = (None if isnan(own) else own), None
            if isnan(target):
                if rapid is None and entry is not None and entry.addable:
                    rapid = entry
                continue
            if entry is not None and entry.addable:
                if not _same(entry.most, active, entry.block.feed_unit):
                    entry.written = changed = True
                    active, setter = entry.most, entry
                rapid = None
            elif active is not None and active != target:
                if rapid is not None and not rapid.written:
                    rapid.written = changed = True
                elif setter is not None and active > target:
                    setter.most = target
                    changed = True
            if isnan(own):  # a call that may set another feed
                active, setter = None, None
        return changed


# Lines that are held back at most, to stream in bounded memory.
_HELD_MOST = 1000


def write_program(program: Program, feeds: ArrayLike | None = None) -> str:
    r"""Return the text of a program with feeds chosen anew.

    Parameters
    ----------
    program : Program
        The program as read.
    feeds : array_like, shape (m,), optional
        Feed of each of `program.segments` [m/s].  NaN keeps the program's own, and must stand
        for whatever is not schedulable.  None keeps all.

    Returns
    -------
    str
        The program: every line in its order, unchanged but for feed words that were added or
        changed.  Words appear only where the feed changes; what is not scheduled runs with the
        feed that the program gave it, or, just before a cycle or a call without a rapid before
        it, with a slower one.

    Raises
    ------
    ValueError
        If the number of feeds is wrong, or one is not above 0 or cannot be heeded.

    Examples
    --------
    >>> from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
    >>> program = read_program('G0 X0\nG1 X10 F600 (fast)\nX20\n')
    >>> print(write_program(program, [float('nan'), 0.005, 0.01]), end='')
    G0 X0
    G1 X10 F300. (fast)
    X20 F600.
    """
    if feeds is None:
        return program.text
    feed = np.asarray(feeds, dtype=np.float64)
    if feed.shape != (len(program.segments),):
        raise ValueError(
            f'expected feeds of shape ({len(program.segments)},), one per segment, but found '
            f'{feed.shape}'
        )
    kept = np.isnan(feed)
    values = iter(feed.tolist())
    wanted = (None if block.segment is None else next(values) for block in program.blocks)
    if kept.all():
        return program.text
    return ''.join(write_blocks(zip(program.blocks, wanted, strict=True)))


def write_blocks(blocks: Iterable[tuple[Block, float | None]]) -> Iterator[str]:
    """Yield the lines of a program with feeds chosen anew, as a stream.

    Parameters
    ----------
    blocks : iterable of (Block, float or None)
        All blocks in order, each with its feed [m/s]; None or NaN keeps the program's own.

    Yields
    ------
    str
        Lines in the order of their numbers, see `write_program`.  From the first block on that
        is `followed` they come together at the end.

    Raises
    ------
    ValueError
        If a feed is not above 0, or is given for a block whose feed is not to be chosen.
    """
    writer, merger = _FeedWriter(), None
    for block, feed in blocks:
        if merger is None and block.followed:
            yield from writer.settle(block)
            merger = _PassMerger(writer.active)
        if merger is None:
            yield from writer.take(block, feed)
        else:
            merger.take(block, feed)
    yield from writer.flush() if merger is None else merger.lines()


class _FeedWriter:
    """Puts feed words where the feed changes.

    Before a cycle or a call the program's own feed has to be in effect again, but their lines
    take no feed word: the rapid before it does.  Lines are held back from the last scheduled
    block on for that.
    """

    def __init__(self) -> None:
        self._active: float | None = None  # None: unknown
        self._before: float | None = None  # feed of the program after the last block
        self._held: list[tuple[Block, float | None]] = []

    def take(self, block: Block, feed: float | None) -> Iterator[str]:
        """Take a block; yield the lines that are settled."""
        target = _target_of(block, feed)
        if block.role is Role.SEALED:
            if block.word is None:
                self._restore(_own_feed(block, self._before))
            target = None
        elif block.role is Role.FEED or len(self._held) >= _HELD_MOST:
            if block.role is not Role.FEED:
                self._restore(block.feed)
            yield from self.flush()
        word = None
        if target is not None:
            if block.word is not None or not _same(target, self._active, block.feed_unit):
                word = target
                self._active = target
        elif block.word is not None:
            self._active = block.feed
        self._before = block.feed
        self._held.append((block, word))
        if block.optional or block.feed is None:
            self._active = None  # a word on it may be skipped; a call may have set another one
        if self._active is None or self._active == block.feed:
            yield from self.flush()

    def flush(self) -> Iterator[str]:
        """Yield all lines that are held back."""
        for block, word in self._held:
            yield block.text if word is None else _with_word(block, word)
        self._held.clear()

    @property
    def active(self) -> float | None:
        """Feed in effect after all lines so far [m/s], None where it is unknown."""
        return self._active

    def settle(self, following: Block) -> Iterator[str]:
        """Yield all lines, a rapid among those held back with the program's feed again."""
        if any(block.role is Role.RAPID for block, _ in self._held):
            self._restore(_own_feed(following, self._before))
        yield from self.flush()

    def _restore(self, feed: float | None) -> None:
        """Have the program's feed, or a slower one, in effect after the lines held back."""
        if feed is None or self._active == feed:
            return
        for index, (block, _) in enumerate(self._held):
            if block.role is Role.RAPID and not block.optional and index > 0:
                self._held[index] = (block, feed)
                self._active = feed
                return
        if self._active is not None and feed < self._active and self._held:
            block = self._held[0][0]
            if block.role is Role.FEED:
                self._held[0] = (block, feed)
                self._active = feed
