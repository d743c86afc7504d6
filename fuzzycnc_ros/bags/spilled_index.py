# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The index of a long recording on the disk instead of in memory."""

import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fuzzycnc_ros.bags.libraries import load

_HEAD = struct.Struct('<BQ')
_LIST = '_Writer__chunk_indices'


class SpilledIndex:
    """Entries of the chunk index of an MCAP file, in the order in which they were added.

    Parameters
    ----------
    folder : Path
        Where a nameless file may grow; it is gone with the process, however that ends.
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)

    def append(self, entry: Any) -> None:
        """Add an entry.

        Raises
        ------
        OSError
            If the disk refuses it.
        """
        builder = load('mcap.data_stream').RecordBuilder()
        entry.write(builder)
        self._file.write(builder.end())

    def __iter__(self) -> Iterator[Any]:
        """Yield the entries."""
        records, streams = load('mcap.records'), load('mcap.data_stream')
        self._file.seek(0)
        reader = streams.ReadDataStream(self._file)
        while head := self._file.read(_HEAD.size):
            del head  # opcode and length; the entry is read field by field
            yield records.ChunkIndex.read(reader)

    def close(self) -> None:
        """Give the space back."""
        self._file.close()


def spill_index(writer: Any, folder: Path) -> SpilledIndex | None:
    """Let a writer of the mcap library keep its chunk index on the disk; return that.

    The library keeps an entry of about 1 kB for every chunk until the file is closed. Chunks that
    are closed twice a second, so that a kill loses little, come to 170,000 a day. There is no
    public way to put the list elsewhere; where the library has changed it stays in memory.
    """
    if getattr(writer, _LIST, None) != []:
        return None
    index = SpilledIndex(folder)
    setattr(writer, _LIST, index)
    return index
