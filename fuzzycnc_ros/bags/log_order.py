# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag in the order of their log time, with no more of it in memory than overlaps."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.storage import Block, RawMessage

OVERLAP_MAX = 128 * 1024 * 1024
"""Most bytes of chunks overlapping in time that are sorted together; more is no recording."""

MESSAGES_MAX = 1_000_000
"""Most messages that are."""

Report = Callable[[Exception], None]
"""Takes what is wrong with a block; raises it, or the block is left out."""


def in_log_order(
    path: Path, every: Iterable[Block], start: int | None, stop: int | None, report: Report
) -> Iterator[RawMessage]:
    """Yield the messages of all blocks that touch a span, in the order of their log time.

    Parameters
    ----------
    path : Path
        The bag, for the error message.
    every : iterable of Block
        Its blocks, in file order; ties stay in this order.
    start, stop : int or None
        Only blocks with messages of `start` <= log time < `stop` [ns].
    report : callable
        Told of damaged blocks.

    Raises
    ------
    BagFormatError
        If more than `OVERLAP_MAX` bytes or `MESSAGES_MAX` messages overlap in time.
    """
    blocks = [
        (place, block)
        for place, block in enumerate(every)
        if (start is None or block.stop >= start) and (stop is None or block.start < stop)
    ]
    blocks.sort(key=lambda entry: entry[1].start)
    group: dict[int, Block] = {}
    group_stop = 0
    for place, block in blocks:
        if group and block.start > group_stop:
            yield from _merged(path, group, report)
            group = {}
        group_stop = max(group_stop, block.stop) if group else block.stop
        group[place] = block
    yield from _merged(path, group, report)


def _merged(path: Path, group: Mapping[int, Block], report: Report) -> list[RawMessage]:
    """Return the messages of blocks, by their place, that overlap in time, sorted together."""
    if sum(block.size for block in group.values()) > OVERLAP_MAX:
        raise BagFormatError(
            f'{path}: expected chunks one after the other in time but {len(group)} of '
            f'them, more than {OVERLAP_MAX} bytes, overlap'
        )
    messages: list[RawMessage] = []
    for _, block in sorted(group.items()):
        try:
            messages += block.read()
        except BagFormatError as error:
            report(error)
        if len(messages) > MESSAGES_MAX:
            raise BagFormatError(
                f'{path}: expected chunks one after the other in time but {len(group)} of '
                f'them, more than {MESSAGES_MAX} messages, overlap'
            )
    messages.sort(key=lambda message: message.log_time)  # stable: ties stay in file order
    return messages
