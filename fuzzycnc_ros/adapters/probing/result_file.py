# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Results of a probing cycle from a file that the control writes."""

from pathlib import Path

from fuzzycnc_ros.runtime.component import Health, Level

LINE_MAX = 200
"""Longest line [bytes]."""
BLOCK = 65536
"""Most that is read at once [bytes]."""


class ResultFile:
    """Read what is added to a file: lines of a code and a number.

    What stands in it at first is of older cycles.  A file that has become shorter was written
    anew, and is read from its beginning.

    Parameters
    ----------
    path : Path
        The file; it need not be there yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._at = self._size() or 0
        self._rest = b''
        self._trouble = ''

    def read(self) -> list[tuple[float, float]]:
        """Return what was added since the last call."""
        size = self._size()
        if size is None:
            return []
        if size < self._at:
            self._at, self._rest = 0, b''
        if size == self._at:
            return []
        try:
            with self._path.open('rb') as stream:
                stream.seek(self._at)
                block = stream.read(BLOCK)
        except OSError as error:
            self._trouble = str(error.strerror)
            return []
        self._at += len(block)
        *lines, self._rest = (self._rest + block).split(b'\n')
        self._rest = self._rest[-LINE_MAX:]
        return [found for line in lines if (found := self._pair(line)) is not None]

    def health(self) -> Health:
        """Report on the file."""
        return Health(
            'results', Level.WARN if self._trouble else Level.OK, self._trouble or str(self._path)
        )

    def _size(self) -> int | None:
        try:
            size = self._path.stat().st_size
        except OSError as error:
            self._trouble = f'{self._path}: {error.strerror}'
            return None
        self._trouble = ''
        return size

    def _pair(self, line: bytes) -> tuple[float, float] | None:
        """Return code and number of a line; empty ones and those of other programs have none."""
        words = line.replace(b',', b' ').split()
        try:
            code, value = (float(word) for word in words)
        except ValueError:
            if words:
                self._trouble = (
                    f'expected lines of a code and a number but found {line[:60]!r}; the program '
                    'alone may write into this file'
                )
            return None
        return code, value
