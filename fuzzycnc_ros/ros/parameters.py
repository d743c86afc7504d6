# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from a component's configuration record, declared once; files that they name."""

import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar, overload

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.core.encodings import decoded

A = TypeVar('A', bound=Config)
B = TypeVar('B', bound=Config)

CLOCK = 'use_sim_time'
"""Parameter of ROS by which a node chooses its clock."""
NUMBER = re.compile(r'[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?')
"""A number in a text; nan and infinity are none."""
KEEPS_ITS_CLOCK = (
    f'{CLOCK}: a running node keeps its clock, as all that it has taken is stamped by that; '
    'end the node and start it with the other one'
)


class ParameterError(ValueError):
    """A parameter is unknown, of the wrong type or out of bounds; the text names it."""


@overload
def declare(node: Node, only: type[A], /) -> tuple[A]: ...


@overload
def declare(node: Node, one: type[A], other: type[B], /) -> tuple[A, B]: ...


def declare(node: Node, *records: type[Config]) -> tuple[Config, ...]:
    """Declare every field of the records; return the filled records.

    From here on the node keeps its clock.

    Raises
    ------
    ParameterError
        If an override names no parameter, has the wrong type or lies outside the bounds.
        rclpy itself ignores a misspelt name in silence.
    """
    known = {item.name for record in records for item in fields(record)}
    # rclpy offers no public view of overrides that no parameter took.
    overrides = node._parameter_overrides
    unknown = sorted(
        name
        for name in overrides
        if name not in known
        and not node.has_parameter(name)
        and not name.startswith('qos_overrides.')
    )
    gone = sorted(set(unknown).intersection(name for record in records for name in record.GONE))
    if gone:
        instead = ''.join(record.INSTEAD for record in records)
        raise ParameterError(
            f'parameter {", ".join(gone)}: earlier versions had it; delete it{instead}'
        )
    if unknown:
        raise ParameterError(
            f'unknown parameter {", ".join(unknown)}; expected one of {", ".join(sorted(known))}'
        )
    node.add_pre_set_parameters_callback(lambda parameters: _as_declared(node, parameters))
    node.add_on_set_parameters_callback(lambda parameters: _keeps_clock(node, parameters))
    try:
        return tuple(record(**_declare_fields(node, record)) for record in records)
    except ParameterError:
        raise
    except ValueError as error:
        # Words and lists, whose bounds ROS cannot express, are checked by the record itself.
        raise ParameterError(f'parameter {error}') from error


def changed(config: Config, parameters: list[Parameter]) -> Config:
    """Return the record with some parameters set anew.

    Raises
    ------
    ValueError
        If a value is out of bounds, or the clock is to be changed with it.
    """
    # Alone it is refused by `_keeps_clock`, which comes too late for what is set with it.
    if len(parameters) > 1 and any(item.name == CLOCK for item in parameters):
        raise ValueError(KEEPS_ITS_CLOCK)
    names = {item.name for item in fields(config)}
    values = {item.name: _plain(item.value) for item in parameters if item.name in names}
    return replace(config, **values)


def refusal(reason: str) -> SetParametersResult:
    """Return the answer to a parameter change that is refused."""
    return SetParametersResult(successful=False, reason=reason)


def _keeps_clock(node: Node, parameters: list[Parameter]) -> SetParametersResult:
    """Refuse to exchange wall time and machine time in a node that runs."""
    now = node.get_parameter(CLOCK).value
    if any(item.name == CLOCK and item.value != now for item in parameters):
        return refusal(KEEPS_ITS_CLOCK)
    return SetParametersResult(successful=True)


def _as_declared(node: Node, parameters: list[Parameter]) -> list[Parameter]:
    """Return parameters whose numbers have the type that they are declared with."""
    return [
        _in_doubles(item, node.get_parameter(item.name).type_)
        if node.has_parameter(item.name)
        else item
        for item in parameters
    ]


def _in_doubles(parameter: Parameter, declared: Parameter.Type) -> Parameter:
    """Return a parameter that is declared as double, or as a list of doubles, as such.

    A whole number is what people type.  Text is what `ros2 param load` sends for 2e-05, and for a
    list with such a number, though `ros2 param dump` has written both: YAML 1.1 has no number
    without a point.
    """
    value = parameter.value
    if declared is Parameter.Type.DOUBLE:
        number = _number(value)
        return parameter if number is None else Parameter(parameter.name, declared, number)
    if declared is Parameter.Type.DOUBLE_ARRAY:
        if isinstance(value, str):
            listed = re.fullmatch(r'\s*\[(.*)\]\s*', value)
            value = [item.strip() for item in listed[1].split(',')] if listed else ()
        numbers = [_number(item) for item in value or ()]
        if numbers and None not in numbers:
            return Parameter(parameter.name, declared, numbers)
    return parameter


def _number(value: Any) -> float | None:
    """Return a number, or a text that is one, as double; None of anything else."""
    if isinstance(value, str):
        return float(value) if NUMBER.fullmatch(value) else None
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number else None


def ros_value(value: Any) -> Any:
    """Return a record's value as a ROS parameter takes it.

    An empty list has no type, neither in ROS nor in YAML; one empty name stands for it.
    """
    if isinstance(value, tuple):
        return list(value) or ['']
    return value


def _plain(value: Any) -> Any:
    if isinstance(value, str) or not hasattr(value, '__iter__'):
        return value
    return tuple(item for item in value if item != '')


def _declare_fields(node: Node, record: type[Config]) -> dict[str, Any]:
    values = {}
    for item in fields(record):
        default: Any = item.default
        try:
            given = ros_value(default)
            override = node._parameter_overrides.get(item.name)
            if override is not None:
                kind = Parameter.Type.from_parameter_value(given)
                node._parameter_overrides[item.name] = _in_doubles(override, kind)
            value = node.declare_parameter(item.name, given, _descriptor(item)).value
        except InvalidParameterTypeException as error:
            raise ParameterError(f'parameter {item.name}: {error}{_remedy(item)}') from error
        except InvalidParameterValueException:
            found = node._parameter_overrides[item.name].value
            raise ParameterError(
                f'parameter {item.name} = {found} is outside '
                f'[{item.metadata["low"]}, {item.metadata["high"]}] {item.metadata["unit"]}; '
                f'{item.metadata["doc"]}'
            ) from None
        values[item.name] = _plain(value)
    return values


def _remedy(item: Any) -> str:
    """Return what to do where YAML reads a name as a switch or a number."""
    if isinstance(item.default, str):
        return '; put the word in quotes'
    if isinstance(item.default, tuple) and all(isinstance(v, str) for v in item.default):
        return "; put names in quotes, as in ['Y', 'Z']"
    return ''


def _descriptor(item: Any) -> ParameterDescriptor:
    meta, default = item.metadata, item.default
    sample = default[0] if isinstance(default, tuple) and default else default
    text = f'{meta["doc"]} [{meta["unit"]}]'
    if meta['choices']:
        text += f'; one of {", ".join(meta["choices"])}'
    descriptor = ParameterDescriptor(description=text, read_only=not meta['live'])
    if isinstance(sample, bool) or meta['low'] is None:
        return descriptor
    if isinstance(sample, int):
        descriptor.integer_range = [
            IntegerRange(from_value=int(meta['low']), to_value=int(meta['high']))
        ]
    elif isinstance(sample, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(meta['low']), to_value=float(meta['high']))
        ]
    return descriptor


def file_text(file: str, size_max: int) -> str:
    """Return the text of a file, of at most one character more than is allowed.

    Parameters
    ----------
    file : str
        Its name; `~` is the home folder.
    size_max : int
        Largest document that its reader takes [characters].  One more is refused by the reader;
        an endless file ends here.

    Raises
    ------
    ValueError
        If it cannot be read.
    """
    try:
        with Path(file).expanduser().open('rb') as opened:
            data = opened.read(4 * size_max + 1)  # characters of four bytes each
            return decoded(data)[: size_max + 1]
    except OSError as error:
        raise ValueError(error.strerror) from error
    except RuntimeError as error:  # a home folder that nobody has
        raise ValueError(str(error)) from error
