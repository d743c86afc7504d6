# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Identity of a bag by its content, and of the code that computes its figures."""

import hashlib
import os
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from fuzzycnc_ros import __version__
from fuzzycnc_ros.bags.finding import STORAGE

BLOCK = 1024 * 1024
"""Bytes that are read at a time."""

FIGURES = (
    'core',
    'runtime',
    'components/thermal',
    'bags',
    'studies/thermal/missing_readings.py',
    'studies/fleet/judging.py',
)
"""Folders and files of the package whose code figures depend on."""


class FileState(NamedTuple):
    """Name of a file of a bag, its size [bytes] and when it was changed [ns]."""

    name: str
    size: int
    changed: int


def files_of(bag: Path) -> tuple[FileState, ...]:
    """Return the files that make a bag, sorted by name; none of a folder that is no bag.

    Raises
    ------
    OSError
        If it cannot be looked at.
    """
    if not bag.is_dir():
        return (_state(bag.name, bag.stat()),)
    with os.scandir(bag) as entries:
        found = [
            _state(entry.name, entry.stat())
            for entry in entries
            if entry.name == 'metadata.yaml' or entry.name.endswith(STORAGE)
        ]
    return tuple(sorted(found))


def content_hash(bag: Path, files: Iterable[FileState]) -> str:
    """Return the SHA-256 of a bag, 64 hexadecimal digits.

    Of a single file it is that of the file.  Of a folder it is that of what
    `sha256sum metadata.yaml *.mcap`, sorted by name, prints there.

    Raises
    ------
    OSError
        If a file cannot be read.
    """
    if not bag.is_dir():
        return _file_hash(bag)
    lines = [f'{_file_hash(bag / file.name)}  {file.name}\n' for file in files]
    return hashlib.sha256(''.join(lines).encode('utf-8', 'surrogateescape')).hexdigest()


@cache
def result_version() -> str:
    """Return the version that figures belong to: of the package, and of what it computes with.

    A change of a source file that figures may depend on, of numpy or of scipy gives another one.
    """
    digest = hashlib.sha256(f'{version("numpy")} {version("scipy")}'.encode())
    package = Path(__file__).parents[2]
    for place in FIGURES:
        for path in sorted((package / place).rglob('*.py')) or [package / place]:
            digest.update(str(path.relative_to(package)).encode() + path.read_bytes())
    return f'{__version__}+{digest.hexdigest()[:12]}'


def _state(name: str, stat: os.stat_result) -> FileState:
    return FileState(name, stat.st_size, stat.st_mtime_ns)


def _file_hash(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open('rb') as file:
        while block := file.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()
