# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""YAML files from anywhere: bounded in size and depth, and without references.

ROS itself reads no references (`&name`, `*name`) in parameter files; with them a file of a
kilobyte can stand for more values than any memory holds.
"""

from __future__ import annotations

import re
import stat
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.encodings import decoded
from fuzzycnc_ros.core.names import repeated_names
from fuzzycnc_ros.core.units import si_value
from fuzzycnc_ros.files.os_errors import os_sentence

SIZE_MAX = 1_000_000
"""Largest file that is read [bytes]; parameter files of all nodes together take 30,000."""
DEPTH_MAX = 50
"""Deepest nesting that is read."""


def value_errors() -> tuple[type[Exception], ...]:
    """Return what PyYAML raises for a value that its tag does not fit, such as `!!int ''`."""
    import yaml

    return (
        yaml.YAMLError, ValueError, OverflowError, LookupError, AttributeError, TypeError,
    )  # fmt: skip


def compose(path: Path, wanted: str) -> Any:
    """Return the root node of a YAML file, None if it is empty; nodes know their lines.

    Parameters
    ----------
    path : Path
        The file.
    wanted : str
        What it should be, for the message.

    Raises
    ------
    ValueError
        If it is missing, no regular file, too large, no YAML, nested too deep, or has references.
    """
    import yaml

    try:
        status = path.stat()
    except OSError as error:
        raise ValueError(
            f'{path}: expected {wanted} but nothing is there'
            if isinstance(error, FileNotFoundError)
            else os_sentence(error, path)
        ) from error
    if not stat.S_ISREG(status.st_mode) or status.st_size > SIZE_MAX:
        raise ValueError(f'{path}: expected {wanted}, a file of at most {SIZE_MAX} bytes')
    try:
        text = decoded(path.read_bytes())
        depth = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEPTH_MAX:
                raise ValueError(f'expected at most {DEPTH_MAX} levels')
            if isinstance(event, yaml.AliasEvent):
                place = f'line {event.start_mark.line + 1}: ' if event.start_mark else ''
                raise ValueError(f'{place}expected no references (*{event.anchor})')
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except OSError as error:
        raise ValueError(os_sentence(error, path)) from error
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(f'{path}: expected {wanted} (YAML) but: {error}') from error


def construct(path: Path, node: Any) -> Any:
    """Return the value of a node.

    Raises
    ------
    ValueError
        If it cannot be made; the message names file and line.
    """
    import yaml

    try:
        return None if node is None else yaml.SafeLoader('').construct_document(node)
    except value_errors() as error:
        line = node.start_mark.line + 1
        raise ValueError(f'{path}: line {line}: expected a value but: {error}') from error


def number_of(node: Any) -> int | float | None:
    """Return the number that a node is, None if none; 20e-6 is one as in ROS, unlike in YAML 1.1.

    Raises
    ------
    Exception
        Of `value_errors`, if its tag does not fit.
    """
    import yaml

    value = yaml.SafeLoader('').construct_object(node)
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value
    if node.style is None and isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            pass
    return None


class Entry(NamedTuple):
    """A value of a file: the line of its name, and its node."""

    line: int
    node: Any


SomeConfig = TypeVar('SomeConfig', bound=Config)


@dataclass
class YamlReading:
    """A file of names and values that is being read; every refusal names file, line and place.

    Parameters
    ----------
    path : Path
        The file.
    wanted : str
        What it should be, for messages.
    noun : str
        What a name in it stands for.

    Attributes
    ----------
    source : dict of str to str
        Line of each value of a configuration by its place, such as `axes.X.limits.velocity`.
    """

    path: Path
    wanted: str
    noun: str = 'name'
    source: dict[str, str] = field(default_factory=dict)

    def wrong(self, line: int, place: str, message: str) -> ValueError:
        """Return a refusal of what stands in a line."""
        return ValueError(f'{self.path}: line {line}: {place}{": " if place else ""}{message}')

    def root(self) -> Entry:
        """Return the whole file.

        Raises
        ------
        ValueError
            If it cannot be read or is empty.
        """
        root = compose(self.path, self.wanted)
        if root is None:
            raise ValueError(f'{self.path}: expected {self.wanted} but found an empty file')
        return Entry(1, root)

    def top(self, wanted: str = 'names and values') -> dict[str, Entry]:
        """Return what the file holds by name; errors as `root` and `mapping`."""
        return self.mapping(self.root(), self.wanted, wanted)

    def pairs(
        self, entry: Entry, place: str, wanted: str = 'names and values'
    ) -> list[tuple[str, Entry]]:
        """Return names and values of a mapping, in the order of the file."""
        if entry.node.id != 'mapping':
            found = 'a list' if entry.node.id == 'sequence' else repr(entry.node.value)
            raise self.wrong(entry.line, place, f'expected {wanted} but found {found:.60}')
        return [
            # A bare Y is true in YAML 1.1; its text is the axis.
            (str(key.value), Entry(key.start_mark.line + 1, value))
            for key, value in entry.node.value
        ]

    def mapping(
        self, entry: Entry, place: str, wanted: str = 'names and values'
    ) -> dict[str, Entry]:
        """Return what a mapping holds by name; refuses names that come twice."""
        pairs = self.pairs(entry, place, wanted)
        for twice in repeated_names(name for name, _ in pairs):
            line = [item.line for name, item in pairs if name == twice][1]
            raise self.wrong(line, place, f'expected {twice} once but found it again')
        return dict(pairs)

    def section(self, found: Mapping[str, Entry], name: str, above: str = '') -> dict[str, Entry]:
        """Return the mapping of a name; empty if there is none."""
        place = f'{above}.{name}' if above else name
        return self.mapping(found[name], place) if name in found else {}

    def known(
        self, found: Mapping[str, Entry], names: Collection[str], place: str, remedy: str = ''
    ) -> None:
        """Refuse a name that is none of some; the remedy stands for the list of them."""
        for name, entry in found.items():
            if name not in names:
                near = [f'did you mean {one}?' for one in get_close_matches(name, names, 1)]
                other = remedy if remedy or near else f'known: {", ".join(names)}'
                meant = '; '.join([f'unknown {self.noun} {name}', *near, *filter(None, [other])])
                raise self.wrong(entry.line, place, meant)

    def value(self, entry: Entry) -> Any:
        """Return a value as YAML reads it."""
        return construct(self.path, entry.node)

    def plain(self, entry: Entry) -> Any:
        """Return a value; 20e-6 is a number here as in ROS, though not in YAML 1.1."""
        if entry.node.id == 'sequence':
            return [self.plain(entry._replace(node=item)) for item in entry.node.value]
        value = self.value(entry)  # names the line of what cannot be made
        number = number_of(entry.node) if isinstance(value, str) else None
        return value if number is None else number

    def number(self, entry: Entry, place: str, unit: str = '-') -> float:
        """Return a number in SI; it may have a unit of the kind of an SI unit."""
        value = self.value(entry)
        try:
            found: Any = si_value(value, unit)
            if not isinstance(found, bool):
                return float(found)
        except (TypeError, OverflowError):
            pass
        except ValueError as error:
            raise self.wrong(entry.line, place, str(error)) from error
        raise self.wrong(entry.line, place, f'expected a number but found {value!r:.60}')

    def text(self, entry: Entry, place: str, wanted: str = 'a text') -> str:
        """Return a text."""
        value = self.value(entry)
        if not isinstance(value, str):
            raise self.wrong(entry.line, place, f'expected {wanted} but found {value!r}')
        return value

    def config(
        self,
        kind: type[SomeConfig],
        found: Mapping[str, Entry],
        place: str,
        *,
        without: Collection[str] = (),
        given: Mapping[str, float] | None = None,
        units: bool = True,
    ) -> SomeConfig:
        """Return a configuration from a section.

        Parameters
        ----------
        kind : type of Config
            What is made.
        found : mapping of str to Entry
            The section.
        place : str
            What it is called.
        without : collection of str
            Fields that it must not have.
        given : mapping of str to float, optional
            Values where the section says nothing.
        units : bool
            Whether numbers may have units.

        Raises
        ------
        ValueError
            If a name is unknown or a value out of its bounds.
        """
        items = {item.name: item for item in fields(kind) if item.name not in without}
        self.known(found, tuple(items), place)
        values: dict[str, Any] = dict(given or {})
        for name, entry in found.items():
            item, where = items[name], f'{place}.{name}' if place else name
            raw = self.plain(entry)
            is_number = isinstance(item.default, (int, float)) and type(item.default) is not bool
            if units and is_number:
                try:
                    raw = si_value(raw, item.metadata['unit'])
                except ValueError as error:
                    raise self.wrong(entry.line, where, str(error)) from error
            values[name] = raw
            self.source[where] = f'line {entry.line}'
        try:
            return kind(**values)
        except ValueError as error:
            text = str(error)
            named = [found[word].line for word in re.findall(r'\w+', text) if word in found]
            lines = named or sorted(entry.line for entry in found.values()) or [1]
            raise self.wrong(lines[0], place, text) from error
