# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Walk over an MCAP file, header by header: where chunks lie, what is announced, where it ends.

An index that is missing or lies cannot hide messages so, and no length that the file states is
trusted.  Nothing is decompressed.
Format: https://mcap.dev/spec
"""

import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.mcap_record import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    STATISTICS,
    Cursor,
)
from fuzzycnc_ros.bags.storage import TOPICS_MAX, Channel, check_regular

MAGIC = b'\x89MCAP0\r\n'

_CHUNK_HEAD = struct.Struct('<QQQII')
_HEAD_MAX = 16 * 1024 * 1024
_INDEX_MAX = 256 * 1024 * 1024  # a recording of a day and a terabyte has 100 MB
_RUN_MAX = 1024 * 1024  # messages outside of chunks are read in runs of about this size


@dataclass
class Tear:
    """Where and why the records of a file end too early."""

    offset: int
    reason: str


@dataclass
class Chunk:
    """Place and head of a chunk, or of a run of messages outside of chunks."""

    offset: int
    length: int
    start: int
    stop: int
    compression: str = ''
    size: int = 0
    crc: int = 0
    loose: bool = False
    counts: Counter[int] = field(default_factory=Counter)


class McapScan:
    """The records of an MCAP file of rosbag2, as far as their heads tell.

    Parameters
    ----------
    path : Path
        The file.

    Attributes
    ----------
    chunks : list of Chunk
        All chunks in file order; a run of messages outside of chunks counts as one.
    metadata : dict
        Named records of text to text.
    statistics : dict or None
        Messages of each channel as the index states.
    tear : Tear or None
        Where the file was cut off.
    problems : list of str
        Damage that cost no message as such, for example a wrong checksum of the index.

    Raises
    ------
    BagFormatError
        If it cannot be read or is no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = check_regular(path)
        self.chunks: list[Chunk] = []
        self.metadata: dict[str, dict[str, str]] = {}
        self.tear: Tear | None = None
        self.data_ended = False
        self.problems: list[str] = []
        self._attachments: list[tuple[int, int]] = []
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._channels: dict[int, Channel] = {}
        self._announced: dict[tuple[int, int], bytes] = {}
        self.statistics: dict[int, int] | None = None
        self._file = path.open('rb')
        try:
            self._scan()
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def channels(self) -> list[Channel]:
        """The channels seen so far; those of a torn file show as its chunks are read."""
        return list(self._channels.values())

    def _scan(self) -> None:
        if self._bytes(0, len(MAGIC)) != MAGIC:
            raise BagFormatError(
                f'{self.path}: expected an MCAP file but its first bytes are others'
            )
        position = len(MAGIC)
        footer = False
        while not footer:
            head = self._bytes(position, 9)
            length = int.from_bytes(head[1:], 'little')
            if not head:
                self.tear = Tear(position, 'the file ends without its index')
                return
            if len(head) < 9 or length > self.size - position - 9:
                self.tear = Tear(position, 'the file ends inside of a record')
                return
            if head[0] == 0:
                self.tear = Tear(position, 'a record has the invalid kind 0')
                return
            try:
                self._record(head[0], position, length)
            except (BagFormatError, struct.error) as error:
                self.tear = Tear(position, str(error) or 'a record is damaged')
                return
            footer = head[0] == FOOTER
            position += 9 + length
        if self._bytes(position, len(MAGIC)) != MAGIC:
            self.tear = Tear(position, 'the end mark is missing')

    def _record(self, opcode: int, position: int, length: int) -> None:
        body = position + 9
        if opcode in (SCHEMA, CHANNEL, METADATA, STATISTICS) and length > _HEAD_MAX:
            raise BagFormatError(f'a record of {length} bytes where {_HEAD_MAX} are plenty')
        if opcode == CHUNK:
            self.chunks.append(self._chunk_head(body, length))
        elif opcode == MESSAGE_INDEX:
            identifier, count = struct.unpack('<HI', self._bytes(body, 6))
            if self.chunks:
                self.chunks[-1].counts[identifier] += count // 16
        elif opcode == MESSAGE:
            self._loose_message(position, length)
        elif opcode in (SCHEMA, CHANNEL):
            self._announce(opcode, self._bytes(body, length))
        elif opcode == ATTACHMENT:
            self._attachments.append((body, length))
        elif opcode == METADATA:
            cursor = Cursor(self._bytes(body, length))
            name = cursor.text()
            self.metadata[name] = cursor.mapping()
        elif opcode == STATISTICS:
            cursor = Cursor(self._bytes(body, length))
            cursor.skip(42)
            pairs = Cursor(cursor.block())
            self.statistics = {}
            while pairs.left:
                identifier = pairs.number('<H')
                self.statistics[identifier] = pairs.number('<Q')
        elif opcode == DATA_END:
            self.data_ended = True
        elif opcode == FOOTER:
            self._check_summary(body)

    def _chunk_head(self, body: int, length: int, *, torn: bool = False) -> Chunk:
        head = self._bytes(body, min(length, 128))
        if len(head) < _CHUNK_HEAD.size:
            raise BagFormatError('a chunk is shorter than its head')
        start, stop, size, crc, text_length = _CHUNK_HEAD.unpack_from(head)
        data_offset = body + _CHUNK_HEAD.size + text_length + 8
        if text_length > 64 or data_offset > body + length:
            raise BagFormatError('the head of a chunk is damaged')
        cursor = Cursor(head[_CHUNK_HEAD.size - 4 :])
        compression = cursor.text()
        stored = cursor.number('<Q')
        if stored > body + length - data_offset and not torn:
            raise BagFormatError('a chunk states more data than it holds')
        return Chunk(data_offset, stored, start, stop, compression, size, crc)

    def _loose_message(self, position: int, length: int) -> None:
        """Add a message that lies outside of all chunks to the current run of such messages."""
        if length < MESSAGE_HEAD.size:
            raise BagFormatError('a message is shorter than its head')
        identifier, _, time, _ = MESSAGE_HEAD.unpack(self._bytes(position + 9, MESSAGE_HEAD.size))
        end = position + 9 + length
        last = self.chunks[-1] if self.chunks else None
        follows = last and last.loose and last.offset + last.length == position
        if last and follows and last.size < _RUN_MAX:
            last.length = last.size = end - last.offset
            last.start, last.stop = min(last.start, time), max(last.stop, time)
        else:
            last = Chunk(position, end - position, time, time, size=end - position, loose=True)
            self.chunks.append(last)
        last.counts[identifier] += 1

    def _announce(self, opcode: int, body: bytes) -> None:
        cursor = Cursor(body)
        identifier = cursor.number('<H')
        if self._announced.setdefault((opcode, identifier), body) != body:
            what = 'schema' if opcode == SCHEMA else 'channel'
            raise BagFormatError(f'{what} {identifier} is announced again as another')
        if opcode == SCHEMA:
            name, encoding = cursor.text(), cursor.text()
            self._schemas[identifier] = (name, encoding, cursor.text())
            return
        schema = cursor.number('<H')
        topic, encoding = cursor.text(), cursor.text()
        facts = cursor.mapping()
        if schema not in self._schemas:
            raise BagFormatError(f'topic {topic!r} has no message type')
        if len(self._channels) >= TOPICS_MAX and identifier not in self._channels:
            raise BagFormatError(f'expected at most {TOPICS_MAX} topics')
        name, schema_encoding, definition = self._schemas[schema]
        self._channels[identifier] = Channel(
            topic=topic,
            type=name,
            definition=definition,
            encoding=schema_encoding,
            qos=facts.get('offered_qos_profiles', ''),
            type_hash=facts.get('topic_type_hash', ''),
            message_encoding=encoding,
        )

    def _check_summary(self, body: int) -> None:
        start, _, crc = struct.unpack('<QQI', self._bytes(body, 20))
        if start == 0 or crc == 0:
            return
        # The checksum covers the footer as well, up to the checksum itself.
        found, position, end = 0, start, body + 16
        if end - start > _INDEX_MAX:
            self.problems.append(f'{self.path}: the index is larger than {_INDEX_MAX} bytes')
            return
        while len(MAGIC) <= start <= body and position < end:
            found = zlib.crc32(self._bytes(position, min(end - position, _RUN_MAX)), found)
            position += _RUN_MAX
        if found != crc:
            self.problems.append(f'{self.path}: the checksum of the index is wrong')

    def _bytes(self, offset: int, length: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(length)
