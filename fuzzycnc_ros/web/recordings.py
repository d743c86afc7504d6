# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The bags in a folder: listed, packed for download, and looked into for what memory lacks."""

import os
import tarfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.bags.metadata import Metadata, read_metadata
from fuzzycnc_ros.components.dashboard.history import POINTS_MAX, History, Rows, Tier, joined
from fuzzycnc_ros.components.dashboard.machine_view import SOURCES, MachineView
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.runtime.convert import decode

CHUNK = 1 << 16
REPORTS = ('report.html',)
"""Names of reports in or beside a bag; `<bag>.html` is one too."""


RECORDED = (Tier(10.0, 8640), Tier(60.0, 20160))
"""Resolution of a bag once it was read: a day in rows of 10 s, two weeks in minutes."""
KEPT = 3
"""Bags that are kept so."""
LOOKED_INTO = 10
"""Bags that are read for one answer, the newest of those that are meant."""


class BagFolder:
    """The bags of a folder.

    Parameters
    ----------
    folder : Path, optional
        Where bags are; without one there are none.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._reading = threading.Lock()
        self._read: dict[tuple[str, int, str], History] = {}

    def history(
        self, machine: str, series: str, begin: float, end: float
    ) -> tuple[tuple[str, ...], Rows] | None:
        """Return what bags hold of a series between two times; None if they hold nothing.

        The times of messages in a bag have to be machine time, as they are in real time and in
        lock-step.

        Parameters
        ----------
        machine, series : str
            What is wanted.
        begin, end : float
            Machine time [s].
        """
        meant = []
        for bag in self._bags():
            metadata = _metadata(bag)
            if metadata is None or not metadata.message_count or _open(metadata):
                continue
            if 1e-9 * metadata.start <= end and 1e-9 * metadata.stop >= begin:
                meant.append((metadata.start, metadata.stop, bag))
        found: tuple[tuple[str, ...], Rows] | None = None
        for _, stop, bag in sorted(meant)[-LOOKED_INTO:]:
            kept = self._kept(bag, stop, machine)[series]
            part = kept.names, kept.rows(begin, end, POINTS_MAX)
            if len(part[1].time):
                found = part if found is None else joined(found, part, POINTS_MAX)
        return found

    def _kept(self, bag: Path, stop: int, machine: str) -> History:
        """Return what a bag holds of a machine; one bag is read at a time."""
        key = bag.name, stop, machine
        with self._reading:
            if key not in self._read:
                while len(self._read) >= KEPT:
                    del self._read[next(iter(self._read))]
                self._read[key] = _history_of(bag, machine)
            return self._read[key]

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
        metadata = _metadata(bag)
        begin: float | None = min((item.st_mtime for item in files), default=None)
        duration = None
        if metadata is not None and metadata.message_count:
            begin, duration = 1e-9 * metadata.start, 1e-9 * (metadata.stop - metadata.start)
        return {
            'name': visible(bag.name),
            'bytes': sum(item.st_size for item in files),
            'begin': begin,
            'duration': duration,
            'complete': metadata is not None and not _open(metadata),
        }


def _metadata(bag: Path) -> Metadata | None:
    try:
        return read_metadata(bag)
    except BagError:
        return None


def _open(metadata: Metadata) -> bool:
    """Return True if a recorder still writes the bag, or was killed while it did."""
    return metadata.custom.get('fuzzycnc_state') == 'recording'


def _history_of(bag: Path, machine: str) -> History:
    """Read what a bag holds of a machine, as far as it can be read."""
    # On use: it brings rosbags.
    from fuzzycnc_ros.bags.reader import BagReader

    view = MachineView(machine, History(RECORDED))
    names = {f'/{machine}/{name}': name for name in SOURCES}
    try:
        with BagReader(bag, strict=False) as reader:
            topics = [
                topic
                for topic, name in names.items()
                if topic in reader.connections
                and reader.connections[topic].type == SOURCES[name].TYPE
            ]
            for item in reader.messages(topics) if topics else ():
                name = names[item.topic]
                view.take(name, decode(SOURCES[name], item.message), 1e-9 * item.log_time)
    except BagError:
        return view.history  # what came before the damage
    return view.history


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
