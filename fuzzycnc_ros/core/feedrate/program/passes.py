# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One feed word for lines that are run several times, in loops and subroutines."""

from array import array
from collections.abc import Iterator
from math import inf, isnan, nan

from fuzzycnc_ros.core.feedrate.program.blocks import Block, Role
from fuzzycnc_ros.core.feedrate.program.feed_words import same, target_of, with_number
from fuzzycnc_ros.core.feedrate.program.segments import DwellSegment

_MOVES = (Role.FEED, Role.KEPT, Role.RAPID)
_ELSEWHERE = -1  # a pass of a line that is not in the program: of a subroutine's own file


class _Entry:
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
        """Whether the line may get a word that holds for all of its passes."""
        return self.free and self.moves


class PassMerger:
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
        self._entry: dict[int, _Entry] = {}
        # Of each pass its line, the feed that it asks for and that of the program; NaN for none.
        self._line = array('q')
        self._target = array('d')
        self._own = array('d')
        self._sets = array('b')

    def take(self, block: Block, feed: float | None) -> None:
        """Take a pass with its feed [m/s], None or NaN for that of the program."""
        target = target_of(block, feed)
        if block.role is Role.SEALED and block.word is None:
            target = block.feed
        if block.text:
            entry = self._entry.get(block.line)
            if entry is None:
                entry = self._entry[block.line] = _Entry(block)
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
            yield with_number(entry.block, entry.most) if entry.written else entry.block.text

    def _corrected(self) -> bool:
        """Run all passes; return whether a line got a word, or a lower one, on the way."""
        changed, active = False, self._start
        setter: _Entry | None = None  # line whose new word is in effect
        rapid: _Entry | None = None  # first rapid after what was scheduled
        for line, target, own, sets in zip(
            self._line, self._target, self._own, self._sets, strict=True
        ):
            entry = self._entry.get(line)
            if entry is not None and entry.written:
                active, setter = entry.most, entry
            elif sets or isnan(own):
                active, setter = (None if isnan(own) else own), None
            if isnan(target):
                if rapid is None and entry is not None and entry.addable:
                    rapid = entry
                continue
            if entry is not None and entry.addable:
                if not same(entry.most, active, entry.block.feed_unit):
                    entry.written = changed = True
                    active, setter = entry.most, entry
                rapid = None
            elif active is not None and setter is not None and active != target:
                if rapid is not None and not rapid.written:
                    rapid.written = changed = True
                elif active > target:
                    setter.most = target
                    changed = True
        return changed
