# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Standard streams that a process can rely on, whatever it was started with.

A parent may have closed them, made their encoding ASCII, or stopped to read them.
"""

import io
import os
import sys
from contextlib import suppress
from typing import Any, TextIO

_SPELT_OUT = 'backslashreplace'
"""Treatment of characters that the encoding of a stream does not have."""


class _Dropping(io.FileIO):
    """A file whose writer is told of no trouble: what nobody takes is lost."""

    def write(self, data: Any, /) -> int:
        """Write, or drop."""
        try:
            return super().write(data) or 0
        except OSError:
            return len(data)


def steady_streams(*, output_matters: bool) -> None:
    """Make standard input, output and error ones that can be used.

    Closed ones lead nowhere; their descriptors would be those of the next files that are opened,
    into which libraries would write.  What nobody reads on standard error is dropped.

    Parameters
    ----------
    output_matters : bool
        Whether it is an error that nobody reads standard output; else it is dropped as well.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # The lowest free descriptor: those below are open by now.
            os.open(os.devnull, os.O_RDWR)
    sys.stdin = sys.stdin or open(0, encoding='utf-8', closefd=False)
    sys.stderr = _dropping(sys.stderr, 2)
    if sys.stdout is None or not output_matters:
        sys.stdout = _dropping(sys.stdout, 1)
    elif isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors=_SPELT_OUT)


def is_dropped(stream: TextIO) -> bool:
    """Return whether nobody gets what is written to a stream, as it was closed from the start."""
    return isinstance(getattr(getattr(stream, 'buffer', None), 'raw', None), _Dropping)


def _dropping(stream: 'TextIO | None', number: int) -> TextIO:
    """Return a stream that stands for another one, and drops what nobody takes."""
    if stream is not None:
        with suppress(OSError):
            stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(_Dropping(number, 'w', closefd=False)),
        encoding='utf-8' if stream is None else stream.encoding,
        errors=_SPELT_OUT,
        line_buffering=True,
    )
