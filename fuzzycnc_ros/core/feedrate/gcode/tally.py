# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What became of the motions of a program, to say why its text stays as it was."""

from math import isnan

from fuzzycnc_ros.core.feedrate.gcode.blocks import Block, Role

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
