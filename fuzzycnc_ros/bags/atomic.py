# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files written whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex

from fuzzycnc_ros.bags.os_errors import about


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give an empty file to write, which takes its place at the end of the block.

    After an error or a kill the old file is there, or none.

    Raises
    ------
    OSError
        If it cannot be written; the error names `path`.
    """
    name = path.with_name(f'.{path.name}.{token_hex(8)}')
    try:
        # The system takes off the mask of the process, which can be asked only by changing it.
        os.close(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666))
    except OSError as error:
        raise about(error, path) from None
    try:
        yield name
        os.replace(name, path)
    except BaseException as error:
        with suppress(FileNotFoundError):
            os.unlink(name)
        if isinstance(error, OSError):
            about(error, path)
        raise


def write_text(path: Path, text: str | bytes) -> None:
    """Write a file; after an error or a kill it is the old one or none.

    Parameters
    ----------
    path : Path
        The file.
    text : str or bytes
        What stands in it.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with whole_file(path) as draft:
        draft.write_bytes(text.encode() if isinstance(text, str) else text)
