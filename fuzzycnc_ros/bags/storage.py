# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of the storage formats: channels, and blocks of messages."""

import stat
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.files.os_errors import os_sentence

TOPICS_MAX = 10_000
"""Most topics of a storage file; a shop of a hundred machines has fewer."""


@dataclass(frozen=True)
class Channel:
    """One stream of messages of a storage file.

    Parameters
    ----------
    topic, type : str
        Topic and message type.
    definition, encoding : str
        Definition that the file embeds and its format; empty if there is none.
    qos : str
        Offered QoS profiles as stored.
    type_hash : str
        REP 2011 hash as stored, empty if there is none.
    message_encoding : str
        How the messages are serialised.
    repeated : bool
        Whether its messages stand in the part of the bag before as well: what is latched, said
        again so that the part can be read alone.
    """

    topic: str
    type: str
    definition: str = ''
    encoding: str = ''
    qos: str = ''
    type_hash: str = ''
    message_encoding: str = 'cdr'
    repeated: bool = False


class RawMessage(NamedTuple):
    """An undecoded message; both times in ns."""

    log_time: int
    publish_time: int
    sequence: int
    channel: Channel
    payload: bytes


@dataclass(frozen=True)
class MessageBlock:
    """Messages that are read in one go: a chunk, or a run of records or rows.

    Parameters
    ----------
    start, stop : int
        Earliest and latest log time [ns] as the file states.
    size : int
        Bytes that reading takes.
    read : callable
        Return the messages in file order; raises BagFormatError if they are damaged.
    """

    start: int
    stop: int
    size: int
    read: Callable[[], list[RawMessage]]


@dataclass(frozen=True)
class Attachment:
    """A file inside a bag."""

    name: str
    media_type: str
    log_time: int
    data: bytes

    @property
    def text(self) -> str:
        """The content as text; what is no UTF-8 shows as replacement characters."""
        return self.data.decode(errors='replace')


@dataclass
class Contents:
    """Contents of a storage file.

    Parameters
    ----------
    channels : list of Channel
        All channels, also those without messages.
    blocks : list of MessageBlock
        All messages, in file order.
    promised : dict of str to int, optional
        Messages on each topic as the file's own index states; None if it has none.
    repeated : dict of str to int
        How many of them are repeated.
    metadata : dict
        Named records of text to text.
    attachments : list of callable
        Each returns an attachment.
    """

    channels: list[Channel] = field(default_factory=list)
    blocks: list[MessageBlock] = field(default_factory=list)
    promised: dict[str, int] | None = None
    repeated: dict[str, int] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[Callable[[], Attachment]] = field(default_factory=list)


def check_regular(path: Path) -> int:
    """Return the size of a regular file; anything else could block forever.

    Raises
    ------
    BagFormatError
        If it is missing, empty or no regular file.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise BagFormatError(os_sentence(error, path)) from error
    if not stat.S_ISREG(status.st_mode):
        raise BagFormatError(f'{path}: expected a regular file')
    if status.st_size == 0:
        raise BagFormatError(f'{path}: expected a bag but the file is empty (0 bytes)')
    return status.st_size
