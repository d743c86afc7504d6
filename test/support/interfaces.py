# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reads the interface definitions of msg_defs/ for the contract tests."""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / 'msg_defs'
FILES = {
    kind: {path.stem: path for path in sorted((FOLDER / kind).glob(f'*.{kind}'))}
    for kind in ('msg', 'srv', 'action')
}
LINE = re.compile(
    r'(?P<type>[A-Za-z][\w/]*(?:\[[^\]]*\])?)\s+(?P<name>\w+)'
    r'(?:\s*=\s*(?P<value>[^#]*?))?\s*(?:#\s*(?P<comment>.*))?'
)
NUMBERS = re.compile(r'(u?int(8|16|32|64)|float(32|64)|byte|char)(\[\])?')


@dataclass(frozen=True)
class Field:
    """One field or constant of a definition."""

    type: str
    name: str
    value: str | None
    comment: str

    @property
    def is_number(self) -> bool:
        """Whether it holds one number or several."""
        return NUMBERS.fullmatch(self.type) is not None

    @property
    def is_float(self) -> bool:
        """Whether it holds floating point numbers."""
        return self.type.startswith('float')

    @property
    def is_array(self) -> bool:
        """Whether it holds several values."""
        return self.type.endswith(']')

    @property
    def tag(self) -> str | None:
        """What stands in brackets at the start of the comment."""
        found = re.match(r'\[([^\]]+)\]', self.comment)
        return found.group(1) if found else None


def head(path: Path) -> str:
    """Return the comment at the top of a definition as one text, a line of it per line."""
    lines = []
    for line in path.read_text().splitlines():
        if not line.startswith('#'):
            break
        lines.append(line.lstrip('# '))
    return '\n'.join(lines)


def parts(path: Path) -> list[list[Field]]:
    """Return the fields and constants of every part: one of a message, two or three of others."""
    found: list[list[Field]] = [[]]
    for line in path.read_text().splitlines():
        text = line.strip()
        if text == '---':
            found.append([])
        elif text and not text.startswith('#'):
            match = LINE.fullmatch(text)
            assert match, f'{path.name}: {line!r} is no field'
            found[-1].append(
                Field(match['type'], match['name'], match['value'], match['comment'] or '')
            )
    return found


def fields(message: str) -> list[Field]:
    """Return the fields of a message, without its constants."""
    return [item for item in parts(FILES['msg'][message])[0] if item.value is None]


def constants(message: str) -> dict[str, int]:
    """Return the constants of a message."""
    return {
        item.name: int(item.value)
        for item in parts(FILES['msg'][message])[0]
        if item.value is not None
    }
