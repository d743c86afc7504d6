# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading an MCAP file, whole or torn; chunks are only decompressed when they are read."""

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import TracebackType

from fuzzycnc_ros.bags.errors import BagFormatError, MissingLibraryError
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.bags.mcap_record import (
    CHANNEL,
    CHUNK,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    Cursor,
    decompress,
    decompression_errors,
)
from fuzzycnc_ros.bags.mcap_scan import Chunk, McapScan
from fuzzycnc_ros.bags.storage import Attachment, Block, Contents, RawMessage

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

_RECORD = struct.Struct('<BQ')


class McapFile(McapScan):
    """The messages and attachments of an MCAP file of rosbag2."""

    def __init__(self, path: Path) -> None:
        self._weighed: set[int] = set()  # offsets of chunks that count below
        self._records = self._inflated = 0
        super().__init__(path)

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
            if position + 9 > end or (
                position + 9 + int.from_bytes(data[position + 1 : position + 9], 'little') > end
            ):
                if torn:
                    break
                raise self._damaged(chunk, 'a record is longer than the chunk')
            opcode, length = _RECORD.unpack_from(data, position)
            body = position + 9
            position = body + length
            if opcode == MESSAGE:
                if length < MESSAGE_HEAD.size:
                    raise self._damaged(chunk, 'a message is shorter than its head')
                identifier, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(data, body)
                channel = channels.get(identifier)
                if channel is None:
                    raise self._damaged(chunk, f'channel {identifier} was never announced')
                payload = data[body + MESSAGE_HEAD.size : position]
                messages.append(RawMessage(log_time, publish_time, sequence, channel, payload))
            elif opcode in (SCHEMA, CHANNEL):
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
        if len(head) < 9 or head[0] != CHUNK:
            return []
        with suppress(BagFormatError, *decompression_errors()):
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
        if length > ATTACHMENT_MAX:
            raise BagFormatError(
                f'{self.path}: the attachment at byte {body}: expected at most {ATTACHMENT_MAX} '
                f'bytes but found {length}'
            )
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
