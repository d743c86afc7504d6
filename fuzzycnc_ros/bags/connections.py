# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The topics of a bag, from the channels of all its files."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.metadata import Profiles, parse_qos
from fuzzycnc_ros.bags.storage import Contents


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
    for channel in (c for contents in files for c in contents.channels):
        known = found.get(channel.topic)
        if known and known.type != channel.type:
            raise BagFormatError(
                f'{path}: expected one type on {channel.topic} but found {known.type} '
                f'and {channel.type}'
            )
        profiles = list(known.profiles) if known else []
        profiles += [p for p in parse_qos(channel.qos) if p not in profiles]
        found[channel.topic] = Connection(
            channel.topic,
            channel.type,
            promised[channel.topic],
            profiles,
            channel.type_hash,
            channel.definition,
        )
    return found
