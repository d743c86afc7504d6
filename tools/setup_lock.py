# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a lock file asks for, and what of it an environment already holds whole."""

from __future__ import annotations

import functools
import os
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Entry:
    """One package of a lock: its normalised name, its version, and its lines for pip."""

    name: str
    version: str
    text: str


@functools.total_ordering
class Version:
    """A version in a marker; it compares with another's text as pip does."""

    def __init__(self, text: str) -> None:
        self.numbers = tuple(int(number) for number in text.split('.'))

    def __eq__(self, other: object) -> bool:
        text = str(other)
        if text.endswith('.*'):
            given = Version(text[:-2]).numbers
            return self.numbers[: len(given)] == given
        return self.numbers == Version(text).numbers

    def __lt__(self, other: object) -> bool:
        return self.numbers < Version(str(other)).numbers

    def __hash__(self) -> int:
        return hash(self.numbers)


def applies(marker: str) -> bool:
    """Return whether a marker of a lock holds for this interpreter.

    Raises
    ------
    NameError
        If the marker asks for something that no marker of ours asks for.
    """
    names = {
        'implementation_name': sys.implementation.name,
        'os_name': os.name,
        'platform_python_implementation': 'CPython',
        'python_full_version': Version('.'.join(str(part) for part in sys.version_info[:3])),
        'sys_platform': sys.platform,
    }
    return bool(eval(marker, {'__builtins__': {}}, names))


def entries(lock: Path) -> list[Entry]:
    """Return the packages of a lock file that this interpreter needs."""
    found: list[Entry] = []
    for text in re.findall(r'^\w.*(?:\n +.*)*', lock.read_text(), re.M):
        head = text.replace('\\\n', ' ').partition(' --hash')[0]
        pinned, _, marker = head.partition(';')
        name, _, version = pinned.strip().partition('==')
        if not marker.strip() or applies(marker.strip()):
            found.append(Entry(normal(name), version, text + '\n'))
    return found


def normal(name: str) -> str:
    """Return a distribution name in its normal form."""
    return re.sub(r'[-_.]+', '-', name).lower()


def held(site_packages: Path) -> set[tuple[str, str]]:
    """Return names and versions installed whole; forget what an interrupted pip left in part.

    pip lists its own file INSTALLER in RECORD only when all the others are in their places.
    """
    whole = set()
    for folder in site_packages.glob('*.dist-info'):
        name, _, version = folder.name[: -len('.dist-info')].rpartition('-')
        record = folder / 'RECORD'
        if record.is_file() and '.dist-info/INSTALLER,' in record.read_text():
            whole.add((normal(name), version))
        else:
            # What is left is overwritten: without this pip would take it for installed.
            for path in sorted(folder.rglob('*'), reverse=True):
                path.rmdir() if path.is_dir() else path.unlink()
            folder.rmdir()
    return whole


def slices(wanted: Iterable[Entry], size: int) -> list[list[Entry]]:
    """Return the entries in as few groups of nearly equal length as the size allows."""
    given = list(wanted)
    count = -(-len(given) // size)
    return [given[index::count] for index in range(count)]
