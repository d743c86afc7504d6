# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files written whole or not at all."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

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
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f'.{path.name}.')
        os.close(handle)
    except OSError as error:
        raise about(error, path) from None
    try:
        yield Path(name)
        os.chmod(name, 0o666 & ~_umask())
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


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
