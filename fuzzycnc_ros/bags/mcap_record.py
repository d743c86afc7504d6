# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Kinds, fields and compression of MCAP records, read without trust in any length they state."""

import struct

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.libraries import load

FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 2, 3, 4, 5, 6, 7
ATTACHMENT, STATISTICS, METADATA, DATA_END = 9, 11, 12, 15
MESSAGE_HEAD = struct.Struct('<HIQQ')
"""Channel, sequence number, log time and publish time of a message."""


class Cursor:
    """Reads the fields of one record and never beyond it."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0

    @property
    def left(self) -> int:
        """Number of bytes not read yet."""
        return len(self._data) - self._position

    def take(self, length: int) -> bytes:
        """Return the next bytes."""
        if length > self.left:
            raise BagFormatError(
                f'a field of {length} bytes lies in a record with {self.left} bytes left'
            )
        self._position += length
        return self._data[self._position - length : self._position]

    def skip(self, length: int) -> None:
        """Pass over the next bytes."""
        self.take(length)

    def number(self, code: str) -> int:
        """Return the next number of a `struct` format."""
        return int(struct.unpack(code, self.take(struct.calcsize(code)))[0])

    def block(self) -> bytes:
        """Return the next bytes, whose number stands before them."""
        return self.take(self.number('<I'))

    def text(self) -> str:
        """Return the next text, whose length stands before it."""
        try:
            return self.block().decode()
        except UnicodeDecodeError as error:
            raise BagFormatError(f'a text is not in UTF-8 ({error.reason})') from error

    def mapping(self) -> dict[str, str]:
        """Return the next map of texts."""
        inner = Cursor(self.block())
        result = {}
        while inner.left:
            key = inner.text()
            result[key] = inner.text()
        return result


def decompress(data: bytes, compression: str, size: int) -> bytes:
    """Decompress a chunk without ever allocating more than its head states.

    Parameters
    ----------
    data : bytes
        The compressed records.
    compression : str
        `zstd`, `lz4`, or empty.
    size : int
        Size that the head of the chunk states [bytes].

    Raises
    ------
    ValueError or one of `decompression_errors`
        If the data is damaged or larger than stated.
    """
    if compression == '':
        return data
    if compression == 'zstd':
        zstandard = load('zstandard')
        stated = zstandard.get_frame_parameters(data).content_size
        if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError(f'its zstd frame states {stated} bytes, its head {size}')
        return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=size))
    if compression == 'lz4':
        decompressor = load('lz4.frame').LZ4FrameDecompressor()
        return bytes(decompressor.decompress(data, max_length=size + 1))
    raise ValueError(f'unknown compression {compression!r}')


def decompression_errors() -> tuple[type[BaseException], ...]:
    """Return what the compression libraries raise on damaged data."""
    return (ValueError, RuntimeError, EOFError, MemoryError, load('zstandard').ZstdError)
