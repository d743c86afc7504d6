# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feed words: which feed a block asks for, and its digits in the text."""

import math

from fuzzycnc_ros.core.feedrate.program.blocks import Block, Role
from fuzzycnc_ros.core.feedrate.program.modal import INCH, MINUTE

# Fine enough for 0.1 % of 1 mm/min; controllers take that many decimals.
_DECIMALS_MILLIMETRE = 3
_DECIMALS_INCH = 5

# A feed that a word gives back within this is that word's own [-].
_SAME = 1e-9


def target_of(block: Block, feed: float | None) -> float | None:
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
    return feed


def same(feed: float, other: float | None, unit: float) -> bool:
    """Whether two feeds [m/s] are one in a program whose unit of feed is given [m/s]."""
    if other is None:
        return False
    if abs(feed - other) > 2.0 * 10.0**-_DECIMALS_MILLIMETRE * unit:
        return False
    return _number(feed, unit) == _number(other, unit)


def _number(feed: float, unit: float) -> str:
    """Return a feed as digits, rounded down: no block runs faster than it should."""
    decimals = _DECIMALS_INCH if unit == INCH / MINUTE else _DECIMALS_MILLIMETRE
    steps = math.floor(feed / unit * 10.0**decimals * (1.0 + _SAME))
    if steps == 0:
        raise ValueError(
            f'expected a feed of at least {10.0**-decimals:g} of the program per minute but '
            f'found {feed} m/s'
        )
    return f'{steps * 10.0**-decimals:.{decimals}f}'.rstrip('0')


def with_word(block: Block, feed: float) -> str:
    """Return the text of a block with a feed word [m/s]; its own word where that is the same."""
    own = block.feed
    if block.word is not None and own is not None and abs(own - feed) <= _SAME * own:
        return block.text
    return with_number(block, feed)


def with_number(block: Block, feed: float) -> str:
    """Return the text of a block with a feed [m/s] in digits, instead of its own word if any."""
    text, number = block.text, _number(feed, block.feed_unit)
    if block.word is None:
        return f'{text[: block.insert]} F{number}{text[block.insert :]}'
    start, end = block.word
    return f'{text[:start]}F{number}{text[end:]}'
