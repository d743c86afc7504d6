# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Write part programs: every line as it was, but for the feed words."""

import re
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.feedrate.program.blocks import Block, Program, Role
from fuzzycnc_ros.core.feedrate.program.feed_words import same, target_of, with_word
from fuzzycnc_ros.core.feedrate.program.lexer import read_line
from fuzzycnc_ros.core.feedrate.program.passes import PassMerger

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
    >>> from fuzzycnc_ros.core.feedrate.program.reader import read_program
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
    writer, merger = _Writer(), None
    for block, feed in blocks:
        if merger is None and block.followed:
            yield from writer.settle(block.feed)
            merger = PassMerger(writer.active)
        if merger is None:
            yield from writer.take(block, feed)
        else:
            merger.take(block, feed)
    yield from writer.flush() if merger is None else merger.lines()


def strip_feeds(text: str) -> str:
    """Return a program without its feed words, to compare what must not change.

    Parameters
    ----------
    text : str
        A part program.

    Returns
    -------
    str
        The program without the words F that set a feed, and without the blanks before them.
    """
    lines = []
    for number, line in enumerate(re.findall(r'[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+', text), 1):
        rest = line
        if 'F' in line or 'f' in line:
            words = read_line(line, number).words
            if not any(word.letter == 'G' and word.value == 4.0 for word in words):
                for word in reversed(words):
                    if word.letter == 'F':
                        rest = rest[: word.start].rstrip(' \t') + rest[word.end :]
        lines.append(rest)
    return ''.join(lines)


class _Writer:
    """Puts feed words where the feed changes.

    Before a cycle or a call the program's own feed has to be in effect again, but their lines
    take no feed word: the rapid before it does.  Lines are held back from the last scheduled
    block on for that.
    """

    def __init__(self) -> None:
        self._active: float | None = None  # None: unknown
        self._held: list[tuple[Block, float | None]] = []

    def take(self, block: Block, feed: float | None) -> Iterator[str]:
        """Take a block; yield the lines that are settled."""
        target = target_of(block, feed)
        if block.role is Role.SEALED:
            if block.word is None:
                self._restore(block.feed)
            target = None
        elif block.role is Role.FEED or len(self._held) >= _HELD_MOST:
            if block.role is not Role.FEED:
                self._restore(block.feed)
            yield from self.flush()
        word = None
        if target is not None:
            if block.word is not None or not same(target, self._active, block.feed_unit):
                word = target
                self._active = target
        elif block.word is not None:
            self._active = block.feed
        self._held.append((block, word))
        if block.optional or block.feed is None:
            self._active = None  # a word on it may be skipped; a call may have set another one
        if self._active is None or self._active == block.feed:
            yield from self.flush()

    def flush(self) -> Iterator[str]:
        """Yield all lines that are held back."""
        for block, word in self._held:
            yield block.text if word is None else with_word(block, word)
        self._held.clear()

    @property
    def active(self) -> float | None:
        """Feed in effect after all lines so far [m/s], None where it is unknown."""
        return self._active

    def settle(self, feed: float | None) -> Iterator[str]:
        """Yield all lines, a rapid among those held back with this feed again."""
        if any(block.role is Role.RAPID for block, _ in self._held):
            self._restore(feed)
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
