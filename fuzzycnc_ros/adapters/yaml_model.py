# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""YAML files read into models; what is wrong is named with its line and a remedy.

A model is validated against the nodes of the file, not against what YAML makes of them: a text
stays a text where YAML would see a number or a switch, and every node knows its line.  JSON
Schemas come from the same models.
"""

import difflib
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import SplitResult, urlsplit

from fuzzycnc_ros.files.yaml_file import YamlReading, number_of, value_errors
from fuzzycnc_ros.ros.parameters import ParameterError

try:
    # Models take these from here, so that the sentence below comes where they are missing.
    from pydantic import AfterValidator as AfterValidator
    from pydantic import BaseModel, ConfigDict, ValidationError
    from pydantic import BeforeValidator as BeforeValidator
    from pydantic import Discriminator as Discriminator
    from pydantic import Field as Field
    from pydantic import Tag as Tag
    from pydantic import ValidationInfo as ValidationInfo
    from pydantic import model_validator as model_validator
    from pydantic_core import PydanticCustomError, core_schema
except ImportError as error:
    raise ParameterError(
        f'files of devices, controls and thermal tests need pydantic 2 ({error}); run pip install '
        "'fuzzycnc_ros[modbus,opcua]'"
    ) from error

ENTRIES = {'devices': 'device', 'sensors': 'sensor', 'axes': 'axis', 'positions': 'axis'}
"""Name in messages of an entry of a list or mapping."""

VARIABLES = ('hand_shake', 'state', 'axes')
"""Sections whose fields are variables of a control."""

SWITCH = ('true', 'false')
"""Words of a field that says yes or no."""

TOLD_MAX = 50
"""Most mistakes of which the first line is looked for: each is found by a walk of the file."""

NO_FIELDS = 'expected fields with values, as name: value, but found none of them'

_LEADING_ZERO = re.compile(r'[-+]?0[0-9_]+')

SomeFields = TypeVar('SomeFields', bound='Fields')


def wrong(text: str, *at: str | int, named: bool = True) -> PydanticCustomError:
    """Return a refusal: what is wrong, in which field inside, and whether to name that field."""
    return PydanticCustomError('wrong', '{text}', {'text': text, 'at': at, 'named': named})


class Fields(BaseModel):
    """A mapping of a file."""

    model_config = ConfigDict(extra='forbid', frozen=True)

    @model_validator(mode='before')
    @classmethod
    def _check_names(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            raise wrong(NO_FIELDS)
        known = {item.alias or name: item for name, item in cls.model_fields.items()}
        if any(item.is_required() and name not in data for name, item in known.items()):
            return data  # is told first, by the model
        for name in data:
            if name not in known:
                near = difflib.get_close_matches(name, known, 1)
                hint = f'did you mean {near[0]}?' if near else ', '.join(sorted(known))
                raise wrong(f'unknown field {name!r}; {hint}', name, named=False)
        return data


def address_of(text: str, schemes: Sequence[str]) -> SplitResult | None:
    """Return the parts of an address that has one of the schemes, a host and a port; else None."""
    try:
        parts = urlsplit(text)
        complete = bool(parts.hostname) and parts.port is not None
    except ValueError:
        return None
    return parts if complete and parts.scheme in schemes else None


class _Scalar(ABC):
    """Reader of a field from its node."""

    @abstractmethod
    def read(self, node: Any) -> Any:
        """Return the value."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.no_info_before_validator_function(self.read, handler(source))


@dataclass(frozen=True)
class Text(_Scalar):
    """A text; what YAML would take for a number or a switch stays a text."""

    pattern: str = ''
    """Pattern that editors check it against."""

    def read(self, node: Any) -> str:
        """Return the text."""
        value = scalar(node, 'a text')
        if not value or not value.isprintable():
            raise wrong(f'expected a text but found {value!r}')
        return value

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        return handler(core) | ({'pattern': f'^{self.pattern}$'} if self.pattern else {})


@dataclass(frozen=True)
class Choice(_Scalar):
    """One of some words."""

    words: Sequence[str]

    def read(self, node: Any) -> str:
        """Return the word."""
        wanted = f'one of {", ".join(self.words)}'
        value = scalar(node, wanted)
        if value not in self.words:
            raise wrong(f'expected {wanted} but found {value!r}')
        return value

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        # Editors take true and false for what they are in YAML.
        words: list[Any] = [True, False] if self.words == SWITCH else list(self.words)
        return handler(core) | {'enum': words}


@dataclass(frozen=True)
class Number(_Scalar):
    """A number within bounds [unit]; of an `int` field a whole one."""

    low: float
    high: float
    unit: str = ''
    whole: bool = False
    remedy: str = ''

    def read(self, node: Any) -> int | float:
        """Return the number."""
        value = number(node)
        if self.low <= value <= self.high and (isinstance(value, int) or not self.whole):
            return value  # NaN is not within either
        kind = 'whole number' if self.whole else 'number'
        remedy = f'; {self.remedy}' if self.remedy else ''
        unit = f' {self.unit}' if self.unit else ''
        raise wrong(
            f'expected a {kind} from {self.low:.6g} to {self.high:.6g}{unit} but found '
            f'{node.value}{remedy}'
        )

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        return handler(core) | {'minimum': self.low, 'maximum': self.high}


class Numbers(_Scalar):
    """A list of numbers; one number is a list too."""

    def read(self, node: Any) -> list[int | float]:
        """Return the numbers."""
        return [number(item) for item in (node if isinstance(node, list) else [node])]

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        one = {'type': 'number'}
        return {'anyOf': [one, {'type': 'array', 'items': one}]}


@dataclass(frozen=True)
class Shorthand:
    """A mapping for whose one field a mere value may stand."""

    field: str

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.no_info_before_validator_function(
            lambda data: full(data, self.field), handler(source)
        )

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        schema = handler(core)
        one = handler.resolve_ref_schema(schema)['properties'][self.field]
        return {'anyOf': [one, schema]}


def full(data: Any, field: str) -> Any:
    """Return a mapping of one field for a mere value, others as they are."""
    return data if isinstance(data, (dict, list)) else {field: data}


def read_file(path: Path, model: type[SomeFields], what: str) -> SomeFields:
    """Read a file.

    Parameters
    ----------
    path : Path
        The file; names of files in it are relative to its folder.
    model : type of Fields
        What stands in it.
    what : str
        The same in words, for messages.

    Raises
    ------
    ParameterError
        If it cannot be read or is not valid; the text names file, line and field.
    """
    try:
        root = YamlReading(path, what).root().node
    except ValueError as error:
        raise ParameterError(' '.join(str(error).split())) from error
    refusals: list[tuple[int, str]] = []
    data = _tree(root, root, (), refusals)
    if not refusals:
        try:
            return model.model_validate(data, context=path)
        except ValidationError as error:
            found = error.errors(include_url=False)[:TOLD_MAX]
            refusals = [_told(root, item) for item in found]
    line, text = min(refusals, key=lambda item: item[0])
    raise ParameterError(f'{path}: line {line}: {text}') from None


def _told(root: Any, item: Any) -> tuple[int, str]:
    """Return the line and the text of a refusal."""
    told, at = item.get('ctx', {}), item['loc']
    if item['type'] == 'missing':
        kind = 'variable' if len(at) > 1 and at[0] in VARIABLES else 'field'
        label = _label(root, at[:-1])
        return _line(root, at[:-1]), f'{label}expected the {kind} {at[-1]!r} but it is missing'
    inside = (*at, *told.get('at', ()))
    label = _label(root, inside if told.get('named', True) else at)
    text = told.get('text') or (NO_FIELDS if item['type'] == 'dict_type' else item['msg'])
    return _line(root, inside), f'{label}{text}'


def _tree(root: Any, node: Any, at: tuple[Any, ...], refusals: list[tuple[int, str]]) -> Any:
    """Return mappings and lists of nodes; scalars stay nodes."""
    import yaml

    if isinstance(node, yaml.SequenceNode):
        return [_tree(root, item, (*at, i), refusals) for i, item in enumerate(node.value)]
    if not isinstance(node, yaml.MappingNode):
        return node
    found: dict[str, Any] = {}
    lines: dict[str, int] = {}
    for key, value in node.value:
        name, line, text = str(key.value), key.start_mark.line + 1, ''
        if not name or not name.isprintable():
            text = f'expected a printable name but found {name!r}'
        elif name in lines:
            first = lines[name]
            text = f'{name!r} is repeated here after line {first}; give each name once'
        if text and not refusals:
            refusals.append((line, f'{_label(root, at)}{text}'))
        lines[name] = line
        found[name] = _tree(root, value, (*at, name), refusals)
    return found


def _child(node: Any, step: Any) -> Any:
    if isinstance(step, int):
        items = node.value if isinstance(node.value, list) else []
        return items[step] if step < len(items) else None
    pairs = node.value if isinstance(node.value, list) else []
    return next((p[1] for p in pairs if isinstance(p, tuple) and p[0].value == step), None)


def _line(root: Any, at: Sequence[Any]) -> int:
    """Return the line of a place; of an inherited field where it stands."""
    trail = [root]
    for step in at:
        found = (_child(node, step) for node in reversed(trail))
        trail.append(next((node for node in found if node is not None), trail[-1]))
    return int(trail[-1].start_mark.line) + 1


def _label(root: Any, at: Sequence[Any]) -> str:
    """Return what a place is called: `device rtd, sensor T1: register: `."""
    words: list[str] = []
    node, outer, field = root, '', ''
    for step in at:
        node_inside = _child(node, step)
        if outer in ENTRIES and (isinstance(step, int) or node_inside is not None):
            name = _child(node_inside, 'name') if isinstance(step, int) else None
            called = name.value if name is not None and isinstance(name.value, str) else ''
            title = step + 1 if isinstance(step, int) else step
            words.append(f'{ENTRIES[outer]} {called or title}')
            field = outer = ''
        elif not str(step).startswith('<'):  # the tag of a union
            words += [field] if field and field not in ENTRIES else []
            field = outer = str(step)
        node = node_inside if node_inside is not None else node
    return (f'{", ".join(words)}: ' if words else '') + (f'{field}: ' if field else '')


def scalar(node: Any, wanted: str) -> str:
    """Return the text of a mere value."""
    if isinstance(node, (dict, list)):
        raise wrong(f'expected {wanted} but found a list or fields')
    return str(node.value)


def number(node: Any) -> int | float:
    """Return a number."""
    text = scalar(node, 'a number')
    if _LEADING_ZERO.fullmatch(text):
        raise wrong(
            f'expected a number but {text} would be octal in YAML; leave the leading zeros out'
        )
    with suppress(*value_errors()):
        value = number_of(node)
        if isinstance(value, float) or (value is not None and value.bit_length() <= 64):
            return value
    raise wrong(f'expected a number but found {text!r}')
