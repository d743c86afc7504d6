# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a recorder says of its own bag: messages that are lost, holes in what was sampled."""

import json
from collections.abc import Mapping
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
    topics = _said(attachments, 'topics')
    try:
        lost = {str(name): int(item['missing'] + item['dropped']) for name, item in topics.items()}
    except (LookupError, TypeError) as error:
        raise _odd(error) from error
    return {name: count for name, count in lost.items() if count}


def holes(attachments: 'Mapping[str, Attachment]') -> dict[str, str]:
    """Return in words what is missing in the samples of each topic that has holes.

    Raises
    ------
    ValueError
        If the attachment is not what a recorder writes.
    """
    try:
        return {
            str(topic): hole_text(int(item['count']), float(item['longest_s']), item['at_s'])
            for topic, item in _said(attachments, 'holes').items()
        }
    except (LookupError, TypeError) as error:
        raise _odd(error) from error


def gaps(attachments: 'Mapping[str, Attachment]') -> list[str]:
    """Return in words when messages came that were not written, and why.

    Raises
    ------
    ValueError
        If the attachment is not what a recorder writes.
    """
    try:
        return [
            f'{int(gap["messages"])} messages from {_time(gap["from_s"])} to '
            f'{_time(gap["to_s"])} s, '
            f'since {gap["cause"]}'
            for gap in _said(attachments, 'gaps')
        ]
    except (LookupError, TypeError, ValueError) as error:
        raise _odd(error) from error


def publishers(attachments: 'Mapping[str, Attachment]') -> dict[str, tuple[str, ...]]:
    """Return the nodes that were seen to publish on each topic; empty if the bag does not say.

    Raises
    ------
    ValueError
        If the attachment is not what a recorder writes.
    """
    try:
        return {
            str(topic): tuple(map(str, nodes))
            for topic, nodes in _said(attachments, 'publishers').items()
        }
    except TypeError as error:
        raise _odd(error) from error


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


def _said(attachments: 'Mapping[str, Attachment]', part: str) -> Any:
    from fuzzycnc_ros.bags.recorder import REPORT_NAME

    if REPORT_NAME not in attachments:
        return {}
    try:
        # Recordings of earlier versions say nothing of holes and gaps.
        said = json.loads(attachments[REPORT_NAME].data)
        if part == 'gaps':
            return list(said.get(part, []))
        return dict(said['topics'] if part == 'topics' else said.get(part, {}))
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise _odd(error) from error


def _odd(error: Exception) -> ValueError:
    from fuzzycnc_ros.bags.recorder import REPORT_NAME

    return ValueError(f'{REPORT_NAME}: expected what the recorder counted but found {error!r}')
