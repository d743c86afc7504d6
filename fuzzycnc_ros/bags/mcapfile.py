# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading an MCAP file, whole or torn, without trust in any length or index that it states.

The file is walked over record by record: an index that is missing or lies cannot hide messages so.
Chunks are only decompressed when they are read.  Fields are read by the mcap library, from the
bytes of one record; lengths of records, chunks and attachments are checked before it sees them.
Format: https://mcap.dev/spec
"""

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

from fuzzycnc_ros.bags.errors import BagFormatError, MissingLibraryError
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.bags.storage import (
    TOPICS_MAX,
    Attachment,
    Channel,
    Contents,
    MessageBlock,
    RawMessage,
    check_regular,
)

MAGIC = b'\x89MCAP0\r\n'

_CHUNK_HEAD = struct.Struct('<QQQII')
_HEAD_MAX = 16 * 1024 * 1024
_INDEX_MAX = 256 * 1024 * 1024  # a recording of a day and a terabyte has 100 MB
_RUN_MAX = 1024 * 1024  # messages outside of chunks are read in runs of about this size
_RECORD = struct.Struct('<BQ')
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = 2, 3, 4, 5, 6, 7
_ATTACHMENT, _STATISTICS, _METADATA = 9, 11, 12
_MESSAGE_HEAD = struct.Struct('<HIQQ')
"""Channel, sequence number, log time and publish time of a message."""

REPEATED = 'fuzzycnc_repeated'
"""Entry of a channel that holds what the part before holds, too."""

CHUNK_MAX = 64 * 1024 * 1024
"""Largest uncompressed chunk that is read [bytes]; rosbag2 closes them below 1 MB, or when they
hold one message."""

RECORDS_MAX = 250_000
"""Most records of a chunk; a megabyte of the smallest messages has 33,000."""

FREE_RECORDS, FREE_BYTES = 1_000_000, 2**30
"""Records, and bytes of chunks, of any file; beyond them a file must be as large as has one byte
for each record and for 2,000 bytes of chunks: what is smaller was made to keep its reader busy."""

ATTACHMENT_MAX = 128 * 1024 * 1024
"""Largest attachment that is read [bytes]; a model takes less than one megabyte."""


@dataclass
class Tear:
    """Place at which the records of a file end too early, and the reason."""

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
    """The messages and attachments of an MCAP file of rosbag2.

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
        self.problems: list[str] = []
        self._attachments: list[tuple[int, int]] = []
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._channels: dict[int, Channel] = {}
        self._announced: dict[tuple[int, int], bytes] = {}
        self.statistics: dict[int, int] | None = None
        self._weighed: set[int] = set()  # offsets of chunks that count below
        self._records = self._inflated = 0
        self._rests = False
        self._file = path.open('rb')
        try:
            self._scan()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> 'McapFile':
        """Return the file."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        self._rests = False

    def rest(self) -> None:
        """Give the file back to the system; the next read opens it again."""
        self._file.close()
        self._rests = True

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
        try:
            while not footer:
                head = self._bytes(position, 9)
                if not head:
                    raise BagFormatError('the file ends without its index')
                length = int.from_bytes(head[1:], 'little')
                if len(head) < 9 or length > self.size - position - 9:
                    raise BagFormatError('the file ends inside of a record')
                if head[0] == 0:
                    raise BagFormatError('a record has the invalid kind 0')
                self._record(head[0], position, length)
                footer = head[0] == _FOOTER
                position += 9 + length
            if self._bytes(position, len(MAGIC)) != MAGIC:
                raise BagFormatError('the end mark is missing')
        except (BagFormatError, struct.error) as error:
            self.tear = Tear(position, str(error))

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
            named = _fields('Metadata', self._bytes(body, length))
            self.metadata[named.name] = named.metadata
        elif opcode == _STATISTICS:
            statistics = _fields('Statistics', self._bytes(body, length))
            self.statistics = statistics.channel_message_counts
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
        compression = _text(head[_CHUNK_HEAD.size : data_offset - body - 8])
        stored = int.from_bytes(head[data_offset - body - 8 : data_offset - body], 'little')
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
        what = 'Schema' if opcode == _SCHEMA else 'Channel'
        found = _fields(what, body)
        if self._announced.setdefault((opcode, found.id), body) != body:
            raise BagFormatError(f'{what.lower()} {found.id} is announced again as another')
        if opcode == _SCHEMA:
            self._schemas[found.id] = (found.name, found.encoding, _text(found.data))
            return
        if found.schema_id not in self._schemas:
            raise BagFormatError(f'topic {found.topic!r} has no message type')
        if len(self._channels) >= TOPICS_MAX and found.id not in self._channels:
            raise BagFormatError(f'expected at most {TOPICS_MAX} topics')
        name, encoding, definition = self._schemas[found.schema_id]
        self._channels[found.id] = Channel(
            topic=found.topic,
            type=name,
            definition=definition,
            encoding=encoding,
            qos=found.metadata.get('offered_qos_profiles', ''),
            type_hash=found.metadata.get('topic_type_hash', ''),
            message_encoding=found.message_encoding,
            repeated=found.metadata.get(REPEATED) == 'true',
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
        if self._rests:
            self._file, self._rests = self.path.open('rb'), False
        self._file.seek(offset)
        return self._file.read(length)

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
            blocks=[
                MessageBlock(c.start, c.stop, c.size, partial(self.read, c)) for c in self.chunks
            ],
            promised=None if counts is None else self.topic_counts(counts),
            repeated=self.repeated_counts(counts or {}),
            metadata=self.metadata,
            attachments=self.attachments,
        )

    def repeated_counts(self, counts: Mapping[int, int]) -> Counter[str]:
        """Return, of counts of channels, what this part repeats as counts of topics."""
        channels = self._channels
        return self.topic_counts(
            {k: n for k, n in counts.items() if k in channels and channels[k].repeated}
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
            If the chunk is damaged, larger than 64 MiB, or not what its head states.
        """
        self._check_weight()
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
        records = 0
        while position < end:
            records += 1
            if records > RECORDS_MAX:
                self._weigh(chunk, records, end)
                raise self._damaged(chunk, f'expected at most {RECORDS_MAX} records')
            body = position + 9
            opcode, length = _RECORD.unpack_from(data, position) if body <= end else (0, end)
            position = body + length
            if position > end:
                if torn:
                    break
                raise self._damaged(chunk, 'a record is longer than the chunk')
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
        self._weigh(chunk, records, end)
        return messages

    def _weigh(self, chunk: Chunk, records: int, size: int) -> None:
        """Count what a chunk holds, the first time that it is read."""
        if chunk.offset not in self._weighed:
            self._weighed.add(chunk.offset)
            self._records += records
            self._inflated += size

    def _check_weight(self) -> None:
        """Refuse a file that holds more than one of its size ever does."""
        if (
            self._records > FREE_RECORDS + self.size
            or self._inflated > FREE_BYTES + 2000 * self.size
        ):
            raise BagFormatError(
                f'{self.path}: expected a recording but {self.size} bytes stand for more than '
                f'{self._records} records of {self._inflated} bytes'
            )

    def salvage(self) -> list[RawMessage]:
        """Return the whole messages inside the chunk or record that a tear runs through."""
        if self.tear is None:
            return []
        begin = self.tear.offset
        head = self._bytes(begin, min(self.size - begin, 4096))
        if len(head) < 9 or head[0] != _CHUNK:
            return []
        with suppress(BagFormatError, *_decompression_errors()):
            chunk = self._chunk_head(begin + 9, self.size - begin - 9, torn=True)
            data = self._bytes(chunk.offset, min(self.size - chunk.offset, CHUNK_MAX))
            size = min(chunk.size, CHUNK_MAX)
            if chunk.compression == 'zstd':
                data = load('zstandard').ZstdDecompressor().stream_reader(data).read(size)
            elif chunk.compression:
                return []
            return self.parse(data[:size], chunk, torn=True)
        return []

    def _decompressed(self, chunk: Chunk, data: bytes) -> bytes:
        """Return the records of a chunk; what is allocated is never more than its head states."""
        try:
            if chunk.compression == 'zstd':
                zstandard = load('zstandard')
                stated = zstandard.get_frame_parameters(data).content_size
                if stated not in (chunk.size, zstandard.CONTENTSIZE_UNKNOWN):
                    raise ValueError(
                        f'its zstd frame states {stated} bytes, its head {chunk.size}'
                    )
                decompressor = zstandard.ZstdDecompressor()
                data = decompressor.decompress(data, max_output_size=chunk.size)
            elif chunk.compression == 'lz4':
                decompressor = load('lz4.frame').LZ4FrameDecompressor()
                data = decompressor.decompress(data, max_length=chunk.size + 1)
            elif chunk.compression:
                raise ValueError(f'unknown compression {chunk.compression!r}')
        except MissingLibraryError:
            raise
        except _decompression_errors() as error:
            raise self._damaged(chunk, f'it cannot be decompressed ({error})') from error
        if len(data) != chunk.size:
            found = 'more' if len(data) > chunk.size else len(data)
            raise self._damaged(chunk, f'expected {chunk.size} bytes but found {found}')
        if chunk.crc and zlib.crc32(data) != chunk.crc:
            raise self._damaged(chunk, 'its checksum is wrong')
        return data

    def _damaged(self, chunk: Chunk, reason: str) -> BagFormatError:
        return BagFormatError(
            f'{self.path}: the chunk at byte {chunk.offset} is damaged: {reason}; '
            'run `fuzzycnc info --repair` to keep the rest'
        )

    def _attachment(self, body: int, length: int) -> Attachment:
        if length > ATTACHMENT_MAX:
            raise BagFormatError(
                f'{self.path}: the attachment at byte {body}: expected at most {ATTACHMENT_MAX} '
                f'bytes but found {length}'
            )
        data = self._bytes(body, length)
        try:
            found = _fields('Attachment', data)
        except BagFormatError as error:
            raise BagFormatError(
                f'{self.path}: the attachment at byte {body} is damaged: {error}'
            ) from error
        if any(data[-4:]) and int.from_bytes(data[-4:], 'little') != zlib.crc32(data[:-4]):
            raise BagFormatError(
                f'{self.path}: the attachment {found.name!r} has a wrong checksum'
            )
        return Attachment(found.name, found.media_type, found.log_time, found.data)


class _Body(BytesIO):
    """The bytes of one record, beyond which no field is read."""

    def read(self, size: int | None = None, /) -> bytes:
        """Return the next bytes; they must be there."""
        left = self.getbuffer().nbytes - self.tell()
        if size is not None and size > left:
            raise BagFormatError(
                f'a field of {size} bytes lies in a record with {left} bytes left'
            )
        return super().read(size)


def _fields(kind: str, body: bytes) -> Any:
    """Return a record of a kind as the mcap library reads it."""
    stream = load('mcap.data_stream').ReadDataStream(_Body(body))
    try:
        return getattr(load('mcap.records'), kind).read(stream)
    except UnicodeDecodeError as error:
        raise BagFormatError(f'a text is not in UTF-8 ({error.reason})') from error


def _text(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise BagFormatError(f'a text is not in UTF-8 ({error.reason})') from error


def _decompression_errors() -> tuple[type[BaseException], ...]:
    """Return what the compression libraries raise on damaged data."""
    return (ValueError, RuntimeError, EOFError, MemoryError, load('zstandard').ZstdError)
