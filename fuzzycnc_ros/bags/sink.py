# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file below a bag that is being written."""

from contextlib import suppress
from pathlib import Path


class Sink:
    """A file without buffer that knows how far it holds whole MCAP records.

    Parameters
    ----------
    path : Path
        The file; it must not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = open(path, 'xb', buffering=0)
        self._whole = 0

    @property
    def closed(self) -> bool:
        """Whether the file was closed."""
        return self._file.closed

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._whole

    def write(self, data: bytes) -> int:
        """Write whole records.

        Raises
        ------
        OSError
            If the disk is full or fails; the last record may then be in the file in part.
        """
        # mcap hands over whole records in every call, so each call ends on a record's boundary.
        rest = memoryview(data)
        while len(rest):
            rest = rest[self._file.write(rest) :]
        self._whole += len(data)
        return len(data)

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def keep_whole_records(self) -> None:
        """Cut off a record that was written in part."""
        with suppress(OSError):  # the cut is a courtesy: repair reads past a torn record as well
            self._file.truncate(self._whole)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
