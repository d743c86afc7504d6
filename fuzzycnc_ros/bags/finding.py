# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Which bags are meant by paths, folders and patterns, and what each is called."""

import glob
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

STORAGE = ('.mcap', '.db3')
"""Endings of files that are bags by themselves."""


@dataclass(frozen=True)
class NamedBag:
    """A bag and what its run is called, which no other of the same command line is."""

    path: Path
    name: str


def find_bags(places: Sequence[Path]) -> tuple[NamedBag, ...]:
    """Return the bags that a command line names, those of a folder or pattern sorted by name.

    Parameters
    ----------
    places : sequence of Path
        Bags; folders, all bags below which are meant; patterns such as `runs/2026-*`.  What does
        not exist is returned as a bag, so that whoever reads it says so.

    Returns
    -------
    tuple of NamedBag
        A bag is called by its own name, with as many of its folders in front as it takes to
        tell it from the others.

    Raises
    ------
    ValueError
        If a bag is named twice, or a pattern fits nothing.
    """
    paths = [path for place in places for path in _expanded(place)]
    seen: set[Path] = set()
    for path in paths:
        place = path.resolve()
        if place in seen:
            raise ValueError(
                f'{path}: expected different bags but found {path.stem!r} twice; give each once, '
                'or rename one'
            )
        seen.add(place)
    return tuple(NamedBag(path, name) for path, name in zip(paths, _names(paths), strict=True))


def _expanded(place: Path) -> list[Path]:
    """Return the bags that a word of the command line stands for."""
    if place.is_dir():
        return _below(place) or [place]
    if place.exists() or not glob.has_magic(str(place)):
        return [place]
    fitting = [Path(text) for text in sorted(glob.glob(str(place), recursive=True))]
    found = [bag for path in fitting for bag in (_below(path) if path.is_dir() else [path])]
    bags = [path for path in dict.fromkeys(found) if path.is_dir() or path.suffix in STORAGE]
    if not bags:
        raise ValueError(f'{place}: expected a pattern that fits bags but it fits none')
    # `**` finds folders and what is in them, and so the files of a bag beside the bag itself.
    known = set(bags)
    return [path for path in bags if known.isdisjoint(path.parents)]


def _below(folder: Path) -> list[Path]:
    """Return the bags of a folder, itself if it is one."""
    bags = []
    for place, folders, files in os.walk(folder):
        folders.sort()
        if 'metadata.yaml' in files or any(Path(name).suffix in STORAGE for name in files):
            bags.append(Path(place))
            folders.clear()
    return bags


def _names(paths: Sequence[Path]) -> list[str]:
    """Return a name for each path: its stem, with folders in front where that is not enough."""
    absolute = [path.absolute() for path in paths]
    names = [path.stem for path in absolute]
    for depth in range(1, max((len(path.parts) for path in absolute), default=1)):
        unclear = {name for name, count in Counter(names).items() if count > 1}
        if not unclear:
            break
        names = [
            '/'.join((*path.parts[-1 - depth : -1], path.stem)) if name in unclear else name
            for path, name in zip(absolute, names, strict=True)
        ]
    return names
