# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files written whole or not at all."""

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from fuzzycnc_ros.bags.os_errors import about


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
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f'.{path.name}.')
    except OSError as error:
        raise about(error, path) from None
    try:
        with os.fdopen(handle, 'wb') as file:
            file.write(text.encode() if isinstance(text, str) else text)
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    except BaseException as error:
        with suppress(FileNotFoundError):
            os.unlink(name)
        if isinstance(error, OSError):
            about(error, path)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
