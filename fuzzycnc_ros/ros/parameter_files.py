# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The folder of parameter files of a graph: which nodes each file reaches, and which it does not.

ROS gives every file to every node and says nothing of a section that belongs to none of them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from fuzzycnc_ros.files.yaml_file import compose, construct
from fuzzycnc_ros.ros.presence import GraphError

SUFFIXES = ('.yaml', '.yml')
_PARAMETERS = 'ros__parameters'
_ANY = {'**': '(?:/[^/]+)*', '*': '/[^/]+'}


@dataclass(frozen=True)
class ParameterSection:
    """Parameters in a file, and the nodes that they are for.

    Attributes
    ----------
    file, line : Path, int
        Where it stands.
    pattern : str
        Full name of a node, with `*` for one part and `**` for any.
    values : mapping of str to any
        Its parameters, as YAML reads them.
    """

    file: Path
    line: int
    pattern: str
    values: Mapping[str, Any]

    @property
    def node(self) -> str:
        """Name of the node without its namespace."""
        return self.pattern.rpartition('/')[2]

    def reaches(self, node: str) -> bool:
        """Return whether a node of a full name reads it."""
        parts = self.pattern.split('/')[1:]
        return bool(re.fullmatch(''.join(_ANY.get(p, f'/{re.escape(p)}') for p in parts), node))


def parameter_files(folder: Path | None, named: str = '') -> list[Path]:
    """Return the parameter files of a folder; none without one.

    Raises
    ------
    GraphError
        If there are none in it; the text names the folder, after `named`.
    """
    if folder is None:
        return []
    if folder.exists() and not folder.is_dir():
        raise GraphError(f'{named}{folder}: expected a folder but found a file; name its folder')
    files = sorted(path for path in folder.glob('*') if path.suffix.lower() in SUFFIXES)
    if not files:
        raise GraphError(f'{named}{folder}: expected files <node>.yaml but found none')
    return files


def sections(files: Sequence[Path]) -> list[ParameterSection]:
    """Return the sections of parameter files.

    Raises
    ------
    ValueError
        If one is no YAML or holds no parameters, in which ROS finds less to name; the message
        names the line.
    """
    found: list[ParameterSection] = []
    for file in files:
        root = compose(file, 'a ROS parameter file')
        for key, value in _items(root):
            part = list(_sections(file, key, value, ''))
            if not part:
                raise ValueError(
                    f'{file}: line {key.start_mark.line + 1}: expected `/**/NODE:` with '
                    f'`{_PARAMETERS}:` below it but found `{key.value}:`; keep device files and '
                    'others outside of the folder of parameter files'
                )
            found += part
    return found


def _sections(file: Path, key: Any, value: Any, above: str) -> Iterator[ParameterSection]:
    """Yield the sections from a key on, which is part of a node's name."""
    name = above + ''.join(f'/{part}' for part in str(key.value).split('/') if part)
    for below, content in _items(value):
        if below.value == _PARAMETERS:
            values = {str(item.value): construct(file, value) for item, value in _items(content)}
            yield ParameterSection(file, key.start_mark.line + 1, name, values)
        else:
            yield from _sections(file, below, content, name)


def _items(node: Any) -> Sequence[tuple[Any, Any]]:
    """Return the keys and values of a YAML mapping, none of anything else."""
    return node.value if node is not None and node.id == 'mapping' else ()


def unread(
    folder: Path,
    found: Sequence[ParameterSection],
    running: Collection[str],
    known: Collection[str],
) -> list[str]:
    """Say what of a folder no node of a graph reads, in a line for each cause.

    Parameters
    ----------
    folder : Path
        The folder.
    found : sequence of ParameterSection
        The sections of its files.
    running : collection of str
        Full names of the nodes that are started.
    known : collection of str
        Names of all nodes of the package.

    Raises
    ------
    GraphError
        If a file has the name of a node that is started, and does not reach it.
    """
    lost = [part for part in found if not any(part.reaches(node) for node in running)]
    names = {node.rpartition('/')[2] for node in running}
    for part in lost:
        stem = part.file.stem
        reached = any(item.file == part.file and item not in lost for item in found)
        if stem in names and not reached:
            raise GraphError(
                f'{part.file}: line {part.line}: expected `/**/{stem}:` but found '
                f'`{part.pattern}:`, which no node of this graph is called'
            )
    idle = sorted({part.node for part in lost if part.node in {*known} - names})
    said = []
    if idle:
        said.append(f'{folder}: not read, as their nodes are not started: {", ".join(idle)}')
    for part in lost:
        if part.node not in idle:
            close = get_close_matches(part.node, known, 1)
            remedy = f'; did you mean {close[0]}?' if close and close[0] != part.node else ''
            said.append(
                f'{part.file}: line {part.line}: not read: no node of this graph is called '
                f'{part.pattern}{remedy}'
            )
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in SUFFIXES and path.name.partition('.')[0] in known:
            said.append(f'{path}: not read: only names that end with .yaml or .yml are')
        elif path.is_dir() and any(item.suffix.lower() in SUFFIXES for item in path.iterdir()):
            said.append(f'{path}: not read: only files in the folder itself are')
    return said
