# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of bags that were judged before, by content of bag and model and by version of the code.

A file of SQLite, whose transactions survive a kill and keep two runs at once apart.  Its log
(WAL) makes a transaction cost no wait for the disk, and needs a disk of this host.
"""

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fuzzycnc_ros.files.os_errors import about
from fuzzycnc_ros.studies.fleet.content import FileState
from fuzzycnc_ros.studies.fleet.judging import BagResult, Document

FILE = 'judged.sqlite'
"""File in the folder of the cache."""

PATIENCE = 60.0
"""Longest time that another run may hold the file [s]."""

_TABLES = """
pragma journal_mode = wal;
pragma synchronous = normal;
create table if not exists bags (path text primary key, size integer, files text, sha256 text);
create index if not exists bags_by_size on bags (size);
create table if not exists judged (
  bag text, machine text, model text, version text, document text,
  primary key (bag, version, machine, model)
);
"""

_FACTS = ''
"""Name in place of machine and model for the facts of a bag."""


@dataclass(frozen=True)
class StoredResults:
    """Stored results of a bag.

    Parameters
    ----------
    facts : dict or None
        Facts of the bag; None if it was never judged.
    figures : mapping
        (Namespace, hash of the model) -> figures.
    """

    facts: Document | None
    figures: Mapping[tuple[str, str], Document]


class Cache:
    """Figures in a folder; made where there is none.

    Parameters
    ----------
    folder : Path
        The folder.
    version : str
        Version that figures belong to; those of others are as good as absent.

    Raises
    ------
    OSError
        If the folder cannot be made or written.
    ValueError
        If the file in it is no cache.

    Notes
    -----
    That a bag is unchanged is taken from names, sizes and times of change of its files: a bag
    whose content changes while all of them stay is not read again.
    """

    def __init__(self, folder: Path, version: str) -> None:
        self._path = folder / FILE
        self._version = version
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise about(error, folder) from None
        with self._named():
            self._base = sqlite3.connect(self._path, timeout=PATIENCE, isolation_level=None)
            self._base.executescript(_TABLES)

    def __enter__(self) -> 'Cache':
        """Return the cache."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the file; what was put in is there, also after an error or a kill."""
        self._base.close()

    def content_of(self, path: str, files: tuple[FileState, ...]) -> str | None:
        """Return the hash of the content of a bag, if its files are as they were."""
        with self._named():
            row = self._base.execute(
                'select files, sha256 from bags where path = ?', (path,)
            ).fetchone()
        return row[1] if row and row[0] == json.dumps(files) else None

    def may_have_moved(self, files: tuple[FileState, ...]) -> bool:
        """Return whether a bag of this size was seen in another place."""
        with self._named():
            found = self._base.execute(
                'select 1 from bags where size = ? limit 1', (_size(files),)
            ).fetchone()
        return found is not None

    def known(self, sha256: str) -> StoredResults:
        """Return what is known of a bag by its content."""
        with self._named():
            rows = self._base.execute(
                'select machine, model, document from judged where bag = ? and version = ?',
                (sha256, self._version),
            ).fetchall()
        found = {(machine, model): json.loads(text) for machine, model, text in rows}
        return StoredResults(found.pop((_FACTS, _FACTS), None), found)

    def put(self, path: str, judged: BagResult) -> None:
        """Remember a bag; then it is safe from a kill."""
        documents = [
            (_FACTS, _FACTS, judged.facts),
            *((machine, model, found) for (machine, model), found in judged.figures.items()),
        ]
        with self._named(), self._base:
            self._base.execute('begin immediate')
            self._base.execute(
                'insert or replace into bags values (?, ?, ?, ?)',
                (path, _size(judged.files), json.dumps(judged.files), judged.sha256),
            )
            self._base.executemany(
                'insert or replace into judged values (?, ?, ?, ?, ?)',
                [
                    (judged.sha256, machine, model, self._version, json.dumps(document))
                    for machine, model, document in documents
                    if document
                ],
            )

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Say of errors which file they are about, and what helps."""
        try:
            yield
        except sqlite3.OperationalError as error:
            if 'locked' in str(error):
                cause = f'another run has held it for {PATIENCE:g} s; wait for that'
            else:
                cause = f'{error}; free some space or change its rights'
            raise ValueError(f'{self._path}: {cause}, or name another cache') from None
        except sqlite3.DatabaseError as error:
            raise ValueError(
                f'{self._path}: expected figures of earlier runs but found something else '
                f'({error}); remove it, and they are recomputed'
            ) from None


def _size(files: tuple[FileState, ...]) -> int:
    return sum(file.size for file in files)
