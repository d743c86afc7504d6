# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Message definitions: where they lie, and parsing such that a hostile one does no harm.

rosbags turns a definition into Python code and runs it, so nothing reaches it unchecked.
"""

import os
import re
import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

from fuzzycnc_ros.bags.errors import BagTypeError
from fuzzycnc_ros.bags.libraries import load

SEPARATOR = '=' * 80
"""Line between the definitions that one schema text embeds."""

DEFINITION_MAX = 64 * 1024
"""Longest definition text that is parsed [characters]; the longest of ROS has 20,000."""

DEPTH_MAX = 32
"""Deepest nesting of messages; the deepest of ROS has 6 levels."""

MEMBERS_MAX = 2048
"""Most members of a message, those of the messages in it and of fixed arrays counted one by one:
rosbags writes code for each element of an array of strings or messages."""

_TYPE_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*/(msg|srv|action)/[A-Za-z][A-Za-z0-9_]*')
_FIELD_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*')
BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4
"""Kinds of nodes in rosbags' parse tree, as `rosbags.interfaces.Nodetype` has them."""

Types = dict[str, Any]
"""rosbags' parse tree: type name to (constants, fields)."""


def folders(package: str) -> list[Path]:
    """Return where the `.msg` files of a package may lie, best first.

    A source checkout comes before an installed package, so that tests see what is edited;
    then the prefixes of a sourced ROS workspace, then the running Python's own prefix.
    """
    checkout = Path(__file__).resolve().parents[2] / 'msg_defs' / 'msg'
    prefixes = [Path(p) for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]
    prefixes.append(Path(sys.prefix))
    installed = [prefix / 'share' / package / 'msg' for prefix in prefixes]
    return [checkout, *installed] if package == 'fuzzycnc_msgs' else installed


def find_folder(package: str) -> Path | None:
    """Return the folder that holds the `.msg` files of a package, or None."""
    return next((f for f in folders(package) if any(f.glob('*.msg'))), None)


def find_text(type_name: str) -> str | None:
    """Return the text of a type's `.msg` file on this machine, or None."""
    if not _TYPE_NAME.fullmatch(type_name):
        return None
    package, kind, name = type_name.split('/')
    folder = find_folder(package) if kind == 'msg' else None
    path = folder / f'{name}.msg' if folder else None
    return path.read_text(encoding='utf-8') if path and path.is_file() else None


def parse(text: str, type_name: str, encoding: str = 'ros2msg') -> Types:
    """Parse a definition together with the definitions that it embeds.

    Parameters
    ----------
    text : str
        Definition; others may follow, each after a separator line.
    type_name : str
        Name of the first type, `package/msg/Name`.
    encoding : str
        `ros2msg` or `ros2idl`.

    Raises
    ------
    BagTypeError
        If the text is too long, cannot be parsed, has names that are no identifiers, refers to
        itself, or has more levels or members than any message needs.
    """
    if encoding not in ('ros2msg', 'ros2idl'):
        raise BagTypeError(
            f'{type_name}: expected a definition in ros2msg or ros2idl but found {encoding!r}'
        )
    if len(text) > DEFINITION_MAX:
        raise BagTypeError(
            f'{type_name}: expected a definition of at most {DEFINITION_MAX} characters '
            f'but found {len(text)}'
        )
    if not _TYPE_NAME.fullmatch(type_name):
        raise BagTypeError(f'expected a type name such as package/msg/Name, found {type_name!r}')
    typesys = load('rosbags.typesys')
    try:
        if encoding == 'ros2idl':
            types: Types = typesys.get_types_from_idl(text)
        else:
            types = typesys.get_types_from_msg(text, type_name)
    except (typesys.TypesysError, ValueError, RecursionError) as error:
        line = ' '.join(str(error).split())[:160]  # the parser quotes the whole text
        raise BagTypeError(f'{type_name}: its definition cannot be parsed: {line}') from error
    if type_name not in types:
        raise BagTypeError(
            f'expected the definition of {type_name} but found {", ".join(types) or "none"}'
        )
    _check(types)
    return types


def references(types: Types, type_name: str) -> list[str]:
    """Return the types that the fields of a type refer to, in order, each once."""
    return list(dict.fromkeys(_named(types[type_name][1])))


def _named(fields: list[Any]) -> Iterator[str]:
    for _, (kind, detail) in fields:
        inner = (kind, detail) if kind in (BASE, NAME) else detail[0]
        if inner[0] == NAME:
            yield inner[1]


def _check(types: Types) -> None:
    for name, (constants, fields) in types.items():
        if not _TYPE_NAME.fullmatch(name):
            raise BagTypeError(f'expected a type name such as package/msg/Name, found {name!r}')
        for field in chain((c[0] for c in constants), (f[0] for f in fields)):
            if not _FIELD_NAME.fullmatch(field):
                raise BagTypeError(f'{name}: expected a field name but found {field!r}')
        for field, (kind, detail) in fields:
            if kind == ARRAY and detail[1] < 0:
                raise BagTypeError(f'{name}: expected a length of {field!r}, found {detail[1]}')
    counts: dict[str, int] = {}
    for name in types:
        _count_members(types, name, (), counts)


def _count_members(
    types: Types, name: str, parents: tuple[str, ...], counts: dict[str, int]
) -> int:
    """Return the members of a type with all that it contains; each type is counted once."""
    if name in parents:
        raise BagTypeError(f'{name}: expected a definition that does not contain itself')
    if len(parents) > DEPTH_MAX:
        raise BagTypeError(f'{name}: expected at most {DEPTH_MAX} levels of messages')
    if name not in types:
        return 1  # this machine's own
    if name not in counts:
        total = 0
        for _, (kind, detail) in types[name][1]:
            inner = (kind, detail) if kind in (BASE, NAME) else detail[0]
            number = 1
            if inner[0] == NAME:
                number = _count_members(types, inner[1], (*parents, name), counts)
            if kind == ARRAY and (inner[0] == NAME or inner[1][0] == 'string'):
                number *= detail[1]
            total += number
        if total > MEMBERS_MAX:
            raise BagTypeError(
                f'{name}: expected at most {MEMBERS_MAX} members, with those of the messages in '
                f'it and of arrays, but found {total}'
            )
        counts[name] = total
    return counts[name]
