# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of a bag, from the channels of all its files."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.metadata import Profiles, parse_qos
from fuzzycnc_ros.bags.storage import Contents

QOS_MAX = 1000
"""Most different QoS texts that are read; a topic that has another counts as of unknown QoS."""

_LISTED = 30  # topics that a message lists


@dataclass(frozen=True)
class Connection:
    """A topic of a bag.

    Parameters
    ----------
    topic, type : str
        Topic and message type.
    message_count : int
        Messages that the bag promises.
    profiles : list of dict
        QoS profiles that its publishers offered.
    type_hash : str
        Hash of the type, empty if the bag does not say.
    definition : str
        Definition that the bag embeds, empty if there is none.
    """

    topic: str
    type: str
    message_count: int
    profiles: Profiles
    type_hash: str
    definition: str


def connect(path: Path, files: Sequence[Contents]) -> dict[str, Connection]:
    """Return the topics of a bag by name.

    Parameters
    ----------
    path : Path
        The bag, for the error message.
    files : sequence of Contents
        What its files hold.

    Raises
    ------
    BagFormatError
        If a topic has several types.
    """
    found: dict[str, Connection] = {}
    promised: Counter[str] = Counter()
    for contents in files:
        promised.update(contents.promised or {})
    known_qos: dict[str, Profiles] = {}
    offered: dict[str, dict[str, None]] = {}  # the texts of each topic, each once
    for channel in (c for contents in files for c in contents.channels):
        known = found.get(channel.topic)
        if known and known.type != channel.type:
            raise BagFormatError(
                f'{path}: expected one type on {channel.topic} but found {known.type} '
                f'and {channel.type}'
            )
        if channel.qos not in known_qos and len(known_qos) < QOS_MAX:
            known_qos[channel.qos] = parse_qos(channel.qos)
        offered.setdefault(channel.topic, {})[channel.qos] = None
        found[channel.topic] = Connection(
            channel.topic,
            channel.type,
            promised[channel.topic],
            [],
            channel.type_hash,
            channel.definition,
        )
    for topic, texts in offered.items():
        profiles = found[topic].profiles
        for text in texts:
            profiles += [p for p in known_qos.get(text, []) if p not in profiles]
    return found


def listed(topics: Iterable[str], none: str) -> str:
    """Return topics as text, `none` if there are none; of very many, the first ones."""
    names = list(topics)
    more = f' and {len(names) - _LISTED} more' if len(names) > _LISTED else ''
    return ', '.join(names[:_LISTED]) + more or none
