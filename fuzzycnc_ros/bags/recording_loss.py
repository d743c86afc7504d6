# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Losses of a recorder's bag: missing messages, holes in what was sampled."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fuzzycnc_ros.bags.storage import Attachment

LACKING = 1
"""Exit code of a run whose recording lacks something."""


def lost_messages(attachments: 'Mapping[str, Attachment]') -> dict[str, int]:
    """Return how many messages of each topic are lost; those that are whole are left out.

    Raises
    ------
    ValueError
        If the attachment is not what a recorder writes.
    """
    with _said(attachments, 'topics') as topics:
        lost = {str(name): int(item['missing'] + item['dropped']) for name, item in topics.items()}
        return {name: count for name, count in lost.items() if count}


def holes(attachments: 'Mapping[str, Attachment]') -> dict[str, str]:
    """Return in words what is missing in the samples of each topic that has holes.

    Raises
    ------
    ValueError
        If the attachment is not what a recorder writes.
    """
    with _said(attachments, 'holes') as found:
        return {
            str(topic): hole_text(int(item['count']), float(item['longest_s']), item['at_s'])
            for topic, item in found.items()
        }


def gaps(attachments: 'Mapping[str, Attachment]') -> list[str]:
    """Return in words when messages came that were not written, and why.

    Raises
    ------
    ValueError
        If the attachment is not what a recorder writes.
    """
    with _said(attachments, 'gaps') as found:
        return [
            f'{int(gap["messages"])} messages from {_time(gap["from_s"])} to '
            f'{_time(gap["to_s"])} s, '
            f'since {gap["cause"]}'
            for gap in found
        ]


def publishers(attachments: 'Mapping[str, Attachment]') -> dict[str, tuple[str, ...]]:
    """Return the nodes that were seen to publish on each topic; empty if the bag does not say.

    Raises
    ------
    ValueError
        If the attachment is not what a recorder writes.
    """
    with _said(attachments, 'publishers') as found:
        return {str(topic): tuple(map(str, nodes)) for topic, nodes in found.items()}


def hole_text(count: int, longest: float, at: float) -> str:
    """Return in words how many holes there are, and the longest [s]."""
    number = '1 hole' if count == 1 else f'{count} holes, the longest'
    return f'{number} of {longest:g} s at {_time(at)} s'


def _time(seconds: float) -> str:
    """Return a time to the millisecond, also one of the day's clock, which has ten digits."""
    return f'{seconds:.3f}'.rstrip('0').rstrip('.')


def loss(bag: Path) -> str:
    """Return in one sentence what a recording lacks; empty if it is whole.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    from fuzzycnc_ros.bags.metadata import storage_files
    from fuzzycnc_ros.bags.reader import BagReader

    # The newest part speaks for those before it, which may be a year's.
    newest = storage_files(bag)[-1:]
    with BagReader(*newest or [bag]) as reader:
        attachments = reader.attachments()
    lost = lost_messages(attachments)
    parts = [f'{count} messages of {topic} are lost' for topic, count in lost.items()]
    parts += [f'{topic} has {text}' for topic, text in holes(attachments).items()]
    if not parts:
        return ''
    unwritten = gaps(attachments)
    if unwritten:
        return f'{bag}: {"; ".join(parts)}: not written were {"; ".join(unwritten)}'
    return f'{bag}: {"; ".join(parts)}: the computer was too busy, or a node was away'


@contextmanager
def _said(attachments: 'Mapping[str, Attachment]', part: str) -> Iterator[Any]:
    """Give a part of what a recorder says; what cannot be taken of it raises a `ValueError`."""
    from fuzzycnc_ros.bags.recorder import REPORT_NAME

    try:
        # Recordings of earlier versions say nothing but the topics, others nothing at all.
        given = REPORT_NAME in attachments
        said = json.loads(attachments[REPORT_NAME].data) if given else {'topics': {}}
        yield said['topics'] if part == 'topics' else said.get(part, {})
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(
            f'{REPORT_NAME}: expected what the recorder counted but found {error!r}'
        ) from error
