# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Temporary folders, and what killed processes left of them and of shared memory.

Whoever is killed removes nothing.  The next process does, where a lock proves that the owner is
gone: the kernel lets go of a lock with the last process that has it.
"""

import fcntl
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PREFIX = 'fuzzycnc-run-'
"""Prefix of temporary folders that are locked as long as anybody needs them."""
SHARED_MEMORY = Path('/dev/shm')
LOCKED_WITHIN = 5.0
"""Age [s] up to which a segment may not have got its lock yet."""
_SEGMENT_LOCK = re.compile(r'(fastrtps_[0-9a-f]{16})_el')


class TemporaryFolder:
    """A folder that is there until the end of its block, and of all that hold its lock.

    Attributes
    ----------
    path : Path
        The folder.
    lock : int
        Descriptor of its lock, for processes that use it as well (`pass_fds`).
    """

    def __init__(self) -> None:
        new = Path(tempfile.mkdtemp(prefix='.fuzzycnc-'))
        self.lock = os.open(new, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # It is locked before it has a name for which others would remove it.
        self.path = new.rename(new.with_name(PREFIX + new.name.removeprefix('.fuzzycnc-')))

    def __enter__(self) -> Path:
        """Return the folder."""
        return self.path

    def __exit__(self, *_: object) -> None:
        """Remove it."""
        self.remove()

    def remove(self) -> None:
        """Remove it."""
        shutil.rmtree(self.path, ignore_errors=True)
        os.close(self.lock)


def remove_leftovers() -> None:
    """Remove the temporary folders and segments of shared memory of killed processes.

    Only those of this user count.  Ports in shared memory belong to all nodes of a domain, and
    stay.
    """
    for folder in _own(Path(tempfile.gettempdir()), f'{PREFIX}*'):
        with suppress(OSError), _locked(folder, os.O_DIRECTORY):
            shutil.rmtree(folder, ignore_errors=True)
    for file in _own(SHARED_MEMORY, 'fastrtps_*_el'):
        found = _SEGMENT_LOCK.fullmatch(file.name)
        with suppress(OSError), _locked(file):
            if found is None or time.time() - file.stat().st_mtime < LOCKED_WITHIN:
                continue
            file.with_name(found[1]).unlink(missing_ok=True)
            file.unlink()


def _own(folder: Path, pattern: str) -> list[Path]:
    """Return what of a folder belongs to this user."""
    found = []
    for path in folder.glob(pattern):
        with suppress(OSError):
            if path.lstat().st_uid == os.geteuid():
                found.append(path)
    return found


@contextmanager
def _locked(path: Path, flags: int = 0) -> Iterator[None]:
    """Hold the lock of a file or folder.

    Raises
    ------
    OSError
        If somebody else holds it, or it is gone.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | flags)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)
