# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The one place where output files are written, whole or not at all.

A regular file, or a new one, is exchanged in one step.  A symbolic link stays, and its target is
written.  Everything else (a device, a pipe, a socket, a descriptor under `/proc`) is written
through: to exchange it would destroy it, for the whole computer if it is `/dev/null`.
"""

import errno
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex
from typing import IO

from fuzzycnc_ros.files.os_errors import about

NEW_FILE = 0o666
"""Permissions of a new file; the system takes off the mask of the process."""
SECRET_FILE = 0o600
"""The same of a file that nobody else reads."""

_LINKS_MAX = 40
"""Links that Linux follows before it says ELOOP."""
_DESCRIPTOR = re.compile(r'/proc/(\d+)(?:/task/\d+)?/fd/(\d+)')
"""Descriptor of an open file, which looks like a symbolic link and may have no or another name."""


def destination(path: Path) -> Path:
    """Return the file that is written under a name: where symbolic links lead to.

    Raises
    ------
    OSError
        If links lead round in a circle; the error names `path`.
    """
    place = path
    for _ in range(_LINKS_MAX):
        place = place.parent.resolve() / place.name
        if _DESCRIPTOR.fullmatch(str(place)) or not place.is_symlink():
            return place
        place = place.parent / os.readlink(place)
    raise about(OSError(errno.ELOOP, os.strerror(errno.ELOOP)), path)


def is_written_through(path: Path) -> bool:
    """Return whether a name stands for something that is neither a regular file nor a new one.

    Raises
    ------
    OSError
        If it cannot be looked at.
    """
    place = destination(path)
    if _DESCRIPTOR.fullmatch(str(place)):
        return True
    try:
        mode = place.stat().st_mode
    except FileNotFoundError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def write_regular(path: Path, text: str) -> None:
    """Write a file as `write_text`, but none whose reader this process would have to wait for.

    Raises
    ------
    OSError
        If it cannot be written, or is a device or a pipe.
    """
    if is_written_through(path):
        raise about(OSError(errno.EINVAL, 'expected a regular file or a new one'), path)
    write_text(path, text)


@contextmanager
def whole_file(path: Path, mode: int = NEW_FILE) -> Iterator[IO[bytes]]:
    """Give an empty file to write, which takes its place at the end of the block.

    After an error or a kill the old file is there, or none; what is written through has got
    nothing then.

    Parameters
    ----------
    path : Path
        The file.
    mode : int
        Permissions of the file.

    Raises
    ------
    OSError
        If it cannot be written; the error names `path`.
    """
    try:
        place = destination(path)
        through = is_written_through(place)
    except OSError as error:
        raise about(error, path) from None
    if through:
        with tempfile.TemporaryFile() as draft:
            yield draft
            draft.seek(0)
            try:
                with _opened(place) as file:
                    shutil.copyfileobj(draft, file)
            except OSError as error:
                raise about(error, path) from None
        return
    name = place.with_name(f'.{place.name}.{token_hex(8)}')
    try:
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        # The mask of the process can be asked only by changing it, so the system takes it off.
        draft = os.fdopen(os.open(name, flags, mode), 'w+b')
    except OSError as error:
        raise about(error, place) from None
    try:
        with draft:
            yield draft
        os.replace(name, place)
    except BaseException as error:
        with suppress(FileNotFoundError):
            os.unlink(name)
        if isinstance(error, OSError) and error.filename in (None, name, str(name)):
            about(error, path)
        raise


def _opened(place: Path) -> IO[bytes]:
    """Open what is no regular file, to write to it."""
    found = _DESCRIPTOR.fullmatch(str(place))
    if found is not None and int(found[1]) == os.getpid():
        # Opened by name it would begin at the start of a file that has got other output already;
        # a socket cannot be opened by name at all.
        return os.fdopen(os.dup(int(found[2])), 'wb')
    return os.fdopen(os.open(place, os.O_WRONLY | os.O_APPEND | os.O_NOCTTY | os.O_CLOEXEC), 'wb')


def write_text(path: Path, text: str | bytes, mode: int = NEW_FILE) -> None:
    """Write a file; after an error or a kill it is the old one or none.

    Parameters
    ----------
    path : Path
        The file.
    text : str or bytes
        What stands in it.
    mode : int
        Permissions of the file.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with whole_file(path, mode) as draft:
        draft.write(text.encode() if isinstance(text, str) else text)
