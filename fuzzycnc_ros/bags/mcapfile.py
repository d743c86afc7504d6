# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading an MCAP file record by record, whole or torn, without trust in any length it states.

The whole file is walked over once, header by header, so that an index that is missing or lies
cannot hide messages; chunks are only decompressed when they are read.
Format: https://mcap.dev/spec
"""

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import TracebackType

from fuzzycnc_ros.bags.errors import BagFormatError, MissingLibraryError
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.bags.mcap_record import Cursor, decompress, decompression_errors
from fuzzycnc_ros.bags.storage import (
    Attachment,
    Block,
    Channel,
    Contents,
    RawMessage,
    check_regular,
)

MAGIC = b'\x89MCAP0\r\n'
CHUNK_MAX = 256 * 1024 * 1024
"""Largest uncompressed chunk that is read [bytes]; rosbag2 closes them below 1 MB."""

_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = 2, 3, 4, 5, 6, 7
_ATTACHMENT, _STATISTICS, _METADATA, _DATA_END = 9, 11, 12, 15
_RECORD = struct.Struct('<BQ')
_MESSAGE_HEAD = struct.Struct('<HIQQ')
_CHUNK_HEAD = struct.Struct('<QQQII')
_HEAD_MAX = 16 * 1024 * 1024
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


class McapFile:
    """An MCAP file of rosbag2.

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
        self.statistics: dict[int, int] | None = None
        self._file = path.open('rb')
        try:
            self._scan()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> 'McapFile':
        """Return the file."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def channels(self) -> list[Channel]:
        """The channels seen so far; those of a torn file show as its chunks are read."""
        return list(self._channels.values())

    @property
    def attachments(self) -> list[Callable[[], Attachment]]:
        """Functions that read the attachments."""
        return [partial(self._attachment, *place) for place in self._attachments]

    def topic_counts(self, counts: Mapping[int, int]) -> Counter[str]:
        """Return counts of channels as counts of topics.

        Raises
        ------
        BagFormatError
            If a channel was never announced.
        """
        result: Counter[str] = Counter()
        for identifier, count in counts.items():
            if identifier not in self._channels:
                raise BagFormatError(
                    f'{self.path}: the index counts messages of channel {identifier}, which was '
                    'never announced; run `fuzzycnc info --repair`'
                )
            result[self._channels[identifier].topic] += count
        return result

    def contents(self) -> Contents:
        """Return channels, blocks and counts of a whole file.

        Raises
        ------
        BagFormatError
            If a chunk that has to be read for its channels is damaged.
        """
        named = set(self.statistics or ()).union(*(chunk.counts for chunk in self.chunks))
        if self.statistics is None or named - set(self._channels):
            for chunk in self.chunks:  # the summary does not name all channels: the chunks do
                self.read(chunk)
        counts = self.statistics if self.statistics is not None else self._indexed()
        return Contents(
            channels=self.channels,
            blocks=[Block(c.start, c.stop, c.size, partial(self.read, c)) for c in self.chunks],
            promised=None if counts is None else self.topic_counts(counts),
            metadata=self.metadata,
            attachments=self.attachments,
        )

    def _indexed(self) -> Counter[int] | None:
        """Return the messages of each channel as the index records after each chunk state."""
        if not all(chunk.counts for chunk in self.chunks):
            return None
        return sum((chunk.counts for chunk in self.chunks), Counter())

    def read(self, chunk: Chunk) -> list[RawMessage]:
        """Return the messages of a chunk.

        Raises
        ------
        BagFormatError
            If the chunk is damaged, larger than 256 MiB, or not what its head states.
        """
        if max(chunk.size, chunk.length) > CHUNK_MAX:
            raise self._damaged(
                chunk, f'expected at most {CHUNK_MAX} bytes but its head states {chunk.size}'
            )
        data = self._bytes(chunk.offset, chunk.length)
        return self.parse(self._decompressed(chunk, data), chunk)

    def parse(self, data: bytes, chunk: Chunk, *, torn: bool = False) -> list[RawMessage]:
        """Return the messages among the records of an uncompressed chunk.

        Parameters
        ----------
        data : bytes
            Records one after the other.
        chunk : Chunk
            Where they come from, for the error message.
        torn : bool
            Whether the last record may be incomplete; it is left out then.
        """
        messages: list[RawMessage] = []
        position, end = 0, len(data)
        channels = self._channels
        while position < end:
            if position + 9 > end or (
                position + 9 + int.from_bytes(data[position + 1 : position + 9], 'little') > end
            ):
                if torn:
                    break
                raise self._damaged(chunk, 'a record is longer than the chunk')
            opcode, length = _RECORD.unpack_from(data, position)
            body = position + 9
            position = body + length
            if opcode == _MESSAGE:
                if length < _MESSAGE_HEAD.size:
                    raise self._damaged(chunk, 'a message is shorter than its head')
                identifier, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(
                    data, body
                )
                channel = channels.get(identifier)
                if channel is None:
                    raise self._damaged(chunk, f'channel {identifier} was never announced')
                payload = data[body + _MESSAGE_HEAD.size : position]
                messages.append(RawMessage(log_time, publish_time, sequence, channel, payload))
            elif opcode in (_SCHEMA, _CHANNEL):
                try:
                    self._announce(opcode, data[body:position])
                except BagFormatError as error:
                    raise self._damaged(chunk, str(error)) from error
        return messages

    def salvage(self) -> list[RawMessage]:
        """Return the whole messages inside the chunk or record that a tear runs through."""
        if self.tear is None:
            return []
        begin = self.tear.offset
        head = self._bytes(begin, min(self.size - begin, 4096))
        if len(head) < 9 or head[0] != _CHUNK:
            return []
        with suppress(BagFormatError, *decompression_errors()):
            chunk = self._chunk_head(begin + 9, self.size - begin - 9, torn=True)
            data = self._bytes(chunk.offset, self.size - chunk.offset)
            if chunk.compression == 'zstd':
                data = load('zstandard').ZstdDecompressor().decompressobj().decompress(data)
            elif chunk.compression:
                return []
            return self.parse(data[: chunk.size], chunk, torn=True)
        return []

    # Scanning

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
            footer = head[0] == _FOOTER
            position += 9 + length
        if self._bytes(position, len(MAGIC)) != MAGIC:
            self.tear = Tear(position, 'the end mark is missing')

    def _record(self, opcode: int, position: int, length: int) -> None:
        body = position + 9
        if opcode in (_SCHEMA, _CHANNEL, _METADATA, _STATISTICS) and length > _HEAD_MAX:
            raise BagFormatError(f'a record of {length} bytes where {_HEAD_MAX} are plenty')
        if opcode == _CHUNK:
            self.chunks.append(self._chunk_head(body, length))
        elif opcode == _MESSAGE_INDEX:
            identifier, count = struct.unpack('<HI', self._bytes(body, 6))
            if self.chunks:
                self.chunks[-1].counts[identifier] += count // 16
        elif opcode == _MESSAGE:
            self._loose_message(position, length)
        elif opcode in (_SCHEMA, _CHANNEL):
            self._announce(opcode, self._bytes(body, length))
        elif opcode == _ATTACHMENT:
            self._attachments.append((body, length))
        elif opcode == _METADATA:
            cursor = Cursor(self._bytes(body, length))
            name = cursor.text()
            self.metadata[name] = cursor.mapping()
        elif opcode == _STATISTICS:
            cursor = Cursor(self._bytes(body, length))
            cursor.skip(42)
            pairs = Cursor(cursor.block())
            self.statistics = {}
            while pairs.left:
                identifier = pairs.number('<H')
                self.statistics[identifier] = pairs.number('<Q')
        elif opcode == _DATA_END:
            self.data_ended = True
        elif opcode == _FOOTER:
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
        if length < _MESSAGE_HEAD.size:
            raise BagFormatError('a message is shorter than its head')
        identifier, _, time, _ = _MESSAGE_HEAD.unpack(
            self._bytes(position + 9, _MESSAGE_HEAD.size)
        )
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
        if opcode == _SCHEMA:
            name, encoding = cursor.text(), cursor.text()
            self._schemas[identifier] = (name, encoding, cursor.text())
            return
        schema = cursor.number('<H')
        topic, encoding = cursor.text(), cursor.text()
        facts = cursor.mapping()
        if schema not in self._schemas:
            raise BagFormatError(f'topic {topic!r} has no message type')
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
        if not len(MAGIC) <= start <= body or crc != zlib.crc32(
            self._bytes(start, body + 16 - start)
        ):
            self.problems.append(f'{self.path}: the checksum of the index is wrong')

    # Reading

    def _bytes(self, offset: int, length: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(length)

    def _decompressed(self, chunk: Chunk, data: bytes) -> bytes:
        try:
            data = decompress(data, chunk.compression, chunk.size)
        except MissingLibraryError:
            raise
        except decompression_errors() as error:
            raise self._damaged(chunk, f'it cannot be decompressed ({error})') from error
        if len(data) != chunk.size:
            raise self._damaged(chunk, f'expected {chunk.size} bytes but found {len(data)}')
        if chunk.crc and zlib.crc32(data) != chunk.crc:
            raise self._damaged(chunk, 'its checksum is wrong')
        return data

    def _damaged(self, chunk: Chunk, reason: str) -> BagFormatError:
        return BagFormatError(
            f'{self.path}: the chunk at byte {chunk.offset} is damaged: {reason}; '
            'run `fuzzycnc info --repair` to keep the rest'
        )

    def _attachment(self, body: int, length: int) -> Attachment:
        data = self._bytes(body, length)
        cursor = Cursor(data)
        try:
            log_time, _ = cursor.number('<Q'), cursor.number('<Q')
            name, media_type = cursor.text(), cursor.text()
            content = cursor.take(cursor.number('<Q'))
            crc = cursor.number('<I')
        except BagFormatError as error:
            raise BagFormatError(
                f'{self.path}: the attachment at byte {body} is damaged: {error}'
            ) from error
        if crc and crc != zlib.crc32(data[:-4]):
            raise BagFormatError(f'{self.path}: the attachment {name!r} has a wrong checksum')
        return Attachment(name, media_type, log_time, content)
