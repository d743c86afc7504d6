# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The bags in a folder: listed, packed for download, and looked into for what memory lacks."""

import os
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fuzzycnc_ros.bags.metadata import read_metadata
from fuzzycnc_ros.core.names import visible

CHUNK = 1 << 16
REPORTS = ('report.html',)
"""Names of reports in or beside a bag; `<bag>.html` is one too."""


class BagFolder:
    """The bags of a folder.

    Parameters
    ----------
    folder : Path, optional
        Where bags are; without one there are none.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def listed(self) -> list[dict[str, Any]]:
        """Return name, size, time, duration and completeness of each bag, the newest first."""
        found = [self._described(bag) for bag in self._bags()]
        return sorted(found, key=lambda item: -(item['begin'] or 0.0))

    def archive(self, name: str) -> tuple[str, Iterator[bytes]] | None:
        """Return the name and the bytes of an archive of a bag, None if there is no such bag."""
        bag = self._named(name)
        if bag is None:
            return None
        return f'{_plain(bag.name)}.tar', _packed(bag)

    def report(self, name: str) -> Path | None:
        """Return the page with the report of a bag, None if there is none."""
        bag = self._named(name)
        if bag is None:
            return None
        places = [*(bag / other for other in REPORTS), bag.with_name(f'{bag.name}.html')]
        return next((p for p in places if p.is_file() and not p.is_symlink()), None)

    def _bags(self) -> list[Path]:
        if self._folder is None or not self._folder.is_dir():
            return []
        return [
            path
            for path in self._folder.iterdir()
            if path.is_dir() and not path.is_symlink() and _is_bag(path)
        ]

    def _named(self, name: str) -> Path | None:
        """Return a bag by its name; names are compared, never joined to a path."""
        return next((bag for bag in self._bags() if bag.name == name), None)

    def _described(self, bag: Path) -> dict[str, Any]:
        files = [item.stat() for item in bag.iterdir() if item.is_file()]
        begin: float | None = min((item.st_mtime for item in files), default=None)
        duration = None
        complete = False
        try:
            metadata = read_metadata(bag)
        except ValueError:
            metadata = None
        if metadata is not None:
            complete = True
            begin, duration = 1e-9 * metadata.start, 1e-9 * (metadata.stop - metadata.start)
        return {
            'name': visible(bag.name),
            'bytes': sum(item.st_size for item in files),
            'begin': begin,
            'duration': duration,
            'complete': complete,
        }


def _is_bag(folder: Path) -> bool:
    return any(item.suffix in ('.mcap', '.db3') for item in folder.iterdir())


def _plain(name: str) -> str:
    """Return a name for the header of an answer."""
    return ''.join(c if c.isascii() and (c.isalnum() or c in '._-') else '_' for c in name)


def _packed(bag: Path) -> Iterator[bytes]:
    """Yield a tar archive of the files of a bag, as far as they are written."""
    for path in sorted(item for item in bag.iterdir() if item.is_file()):
        if path.is_symlink():
            continue
        with path.open('rb') as file:
            info = tarfile.TarInfo(f'{bag.name}/{path.name}')
            info.size = left = os.fstat(file.fileno()).st_size
            info.mtime = int(os.fstat(file.fileno()).st_mtime)
            yield info.tobuf(tarfile.PAX_FORMAT)
            while left:
                chunk = file.read(min(CHUNK, left)) or bytes(min(CHUNK, left))
                left -= len(chunk)
                yield chunk
            yield bytes(-info.size % tarfile.BLOCKSIZE)
    yield bytes(2 * tarfile.BLOCKSIZE)
