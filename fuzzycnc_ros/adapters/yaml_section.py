# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Mappings of a YAML file, field by field; what is wrong is named with its line and a remedy."""

import difflib
import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from fuzzycnc_ros.bags.yaml_file import compose, value_errors
from fuzzycnc_ros.ros.parameters import ParameterError

REQUIRED: Any = object()
"""Default of a field that must be there."""

_LEADING_ZERO = re.compile(r'[-+]?0[0-9_]+')


class Section:
    """A mapping of a file.

    Parameters
    ----------
    path : Path
        The file.
    node : yaml.Node
        The mapping.
    label : str
        What it describes, for messages; empty for the whole file.
    outer : Section, optional
        Where some fields are looked up that are missing here.
    inherited : collection of str
        Which fields that is.

    Raises
    ------
    ParameterError
        If the node is no mapping or has a field twice.
    """

    def __init__(
        self,
        path: Path,
        node: Any,
        label: str,
        outer: 'Section | None' = None,
        inherited: Collection[str] = (),
    ) -> None:
        import yaml

        self.path, self.label = path, label
        self._node, self._outer, self._inherited = node, outer, inherited
        self._fields: dict[str, Any] = {}
        self._known: set[str] = set()
        if not isinstance(node, yaml.MappingNode):
            raise self.error('expected fields with values, as name: value, but found none of them')
        for key, value in node.value:
            name = str(key.value)
            if name in self._fields:
                first = self._fields[name].start_mark.line + 1
                raise self.error(
                    f'{name!r} stands here again after line {first}; name everything once', key
                )
            self._fields[name] = value

    @classmethod
    def read(cls, path: Path, what: str) -> 'Section':
        """Read a file.

        Raises
        ------
        ParameterError
            If it cannot be read, is no YAML or holds no fields.
        """
        try:
            node = compose(path, what)
        except ValueError as error:
            raise ParameterError(' '.join(str(error).split())) from error
        if node is None:
            raise ParameterError(f'{path}: expected {what} but the file is empty')
        return cls(path, node, '')

    def error(self, text: str, node: Any = None) -> ParameterError:
        """Return an error that names the file, the line of a node and what the section is."""
        place = node if node is not None else self._node
        line = place.start_mark.line + 1 if place is not None else 1
        label = f'{self.label}: ' if self.label else ''
        return ParameterError(f'{self.path}: line {line}: {label}{text}')

    def line_error(self, name: str, text: str) -> ParameterError:
        """Return an error at the line of a field."""
        return self.error(f'{name}: {text}', self._find(name))

    def __contains__(self, name: str) -> bool:
        return self._find(name) is not None

    def text(self, name: str, default: Any = REQUIRED) -> str:
        """Return a text; what YAML would take for a number or a switch stays a text."""
        node = self._take(name, default)
        if node is None:
            return str(default)
        value = self._scalar(name, node, 'a text')
        if not value or not value.isprintable():
            raise self.error(f'{name}: expected a text but found {value!r}', node)
        return value

    def word(self, name: str, words: Sequence[str], default: Any = REQUIRED) -> str:
        """Return one of some words."""
        node = self._take(name, default)
        if node is None:
            return str(default)
        value = self._scalar(name, node, f'one of {", ".join(words)}')
        if value not in words:
            raise self.error(
                f'{name}: expected one of {", ".join(words)} but found {value!r}', node
            )
        return value

    def whole(
        self, name: str, low: int, high: int, default: Any = REQUIRED, remedy: str = ''
    ) -> int:
        """Return a whole number within bounds."""
        node = self._take(name, default)
        if node is None:
            return int(default)
        value = self._number(name, node)
        if not isinstance(value, int) or not low <= value <= high:
            raise self.error(
                f'{name}: expected a whole number from {low} to {high} but found '
                f'{node.value}{remedy and "; " + remedy}',
                node,
            )
        return value

    def number(
        self, name: str, low: float, high: float, default: Any = REQUIRED, unit: str = ''
    ) -> float:
        """Return a number within bounds."""
        node = self._take(name, default)
        if node is None:
            return float(default)
        value = self._number(name, node)
        if not low <= value <= high:  # NaN is not either
            raise self.error(
                f'{name}: expected a number from {low:g} to {high:g}{unit and " " + unit} '
                f'but found {node.value}',
                node,
            )
        return float(value)

    def numbers(self, name: str) -> tuple[int | float, ...]:
        """Return a list of numbers; one number is a list too, a missing field an empty one."""
        import yaml

        node = self._take(name, ())
        if node is None:
            return ()
        items = node.value if isinstance(node, yaml.SequenceNode) else [node]
        return tuple(self._number(name, item) for item in items)

    def section(self, name: str) -> 'Section | None':
        """Return a mapping inside, None if there is none."""
        node = self._take(name, None)
        return None if node is None else Section(self.path, node, self._inner(name))

    def sections(self, name: str, what: str) -> list['Section']:
        """Return the mappings of a list inside."""
        import yaml

        node = self._take(name, REQUIRED)
        if not isinstance(node, yaml.SequenceNode) or not node.value:
            raise self.error(f'{name}: expected a list, each item with a dash, of {what}', node)
        return [
            Section(self.path, item, f'{what} {index}')
            for index, item in enumerate(node.value, start=1)
        ]

    def named(
        self, name: str, what: str, shorthand: str, inherited: Collection[str]
    ) -> list['tuple[str, Section]']:
        """Return the named entries of a mapping inside.

        Inherited fields that an entry lacks are looked up here.  An entry that is a mere value
        stands for its one field `shorthand`.
        """
        mapping = self.section(name)
        if mapping is None:
            return []
        found = []
        for key, value in mapping._fields.items():
            mapping._known.add(key)
            if not key or not key.isprintable():
                raise self.error(f'expected a printable name of a {what} but found {key!r}', value)
            label = self._inner(f'{what} {key}')
            inner = _full(value, shorthand)
            found.append((key, Section(self.path, inner, label, self, inherited)))
        return found

    def entry(self, name: str, shorthand: str) -> 'Section | None':
        """Return a mapping inside, None if missing; a mere value is its field `shorthand`."""
        node = self._take(name, None)
        if node is None:
            return None
        return Section(self.path, _full(node, shorthand), self._inner(name))

    def done(self) -> None:
        """Refuse the fields that nobody has asked for.

        Raises
        ------
        ParameterError
            If there is one.
        """
        for name, node in self._fields.items():
            if name not in self._known:
                near = difflib.get_close_matches(name, self._known, 1)
                hint = f'did you mean {near[0]}?' if near else ', '.join(sorted(self._known))
                raise self.error(f'unknown field {name!r}; {hint}', node)

    def _inner(self, name: str) -> str:
        return f'{self.label}, {name}' if self.label else name

    def _find(self, name: str) -> Any:
        if name in self._fields:
            return self._fields[name]
        outer = self._outer if name in self._inherited else None
        return outer._find(name) if outer is not None else None

    def _take(self, name: str, default: Any) -> Any:
        """Return the node of a field, None if it is missing; it counts as asked for."""
        self._known.add(name)
        if self._outer is not None and name in self._inherited:
            self._outer._known.add(name)
        node = self._find(name)
        if node is None and default is REQUIRED:
            raise self.error(f'expected the field {name!r} but it is missing')
        return node

    def _scalar(self, name: str, node: Any, wanted: str) -> str:
        import yaml

        if not isinstance(node, yaml.ScalarNode):
            raise self.error(f'{name}: expected {wanted} but found a list or fields', node)
        return str(node.value)

    def _number(self, name: str, node: Any) -> int | float:
        """Return a number; 20e-6 is one here as in ROS, though not in YAML 1.1."""
        import yaml

        text = self._scalar(name, node, 'a number')
        if _LEADING_ZERO.fullmatch(text):
            raise self.error(
                f'{name}: expected a number but {text} would be octal in YAML; leave the leading '
                'zeros out',
                node,
            )
        try:
            value = yaml.SafeLoader('').construct_object(node)
            small = not isinstance(value, int) or value.bit_length() <= 64
            if isinstance(value, (int, float)) and not isinstance(value, bool) and small:
                return value
            if node.style is None and isinstance(value, str):
                return float(value)
        except value_errors():
            pass
        raise self.error(f'{name}: expected a number but found {text!r}', node)


def _full(node: Any, shorthand: str) -> Any:
    """Return a mapping of the one field `shorthand` for a mere value, others as they are."""
    import yaml

    if not isinstance(node, yaml.ScalarNode):
        return node
    field = yaml.ScalarNode('', shorthand, node.start_mark, node.end_mark)
    return yaml.MappingNode('', [(field, node)], node.start_mark, node.end_mark)
