# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from a component's configuration record, declared once."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.parameter import Parameter

from fuzzycnc_ros.core.config import Config


class ParameterError(ValueError):
    """A parameter is unknown, of the wrong type or out of bounds; the text names it."""


_ARGUMENT = re.compile(r"Couldn't parse ([^:]+): '(?:\S+ )?(.*)'\. Error: (.*?)(?:, at /|$)")
"""What rcl says of an argument: its kind, the argument, what is wrong, where in its source."""


@contextmanager
def arguments_refused() -> Iterator[None]:
    """Refuse ROS arguments and parameter files that rcl cannot read as wrong parameters."""
    set_logger_level('rcl', LoggingSeverity.FATAL)  # it would say the same in many lines
    try:
        yield
    except UnknownROSArgsError as error:
        raise ParameterError(f'expected ROS arguments but found {error}') from error
    except RCLError as error:
        found = _ARGUMENT.search(str(error))
        if found is None:
            raise  # not a matter of arguments
        kind, argument, reason = found.groups()
        if kind == 'params file':
            kind = 'a parameter file of ROS (YAML, see params/*.yaml)'
        raise ParameterError(f'{argument}: expected {kind} but: {reason}') from error
    finally:
        set_logger_level('rcl', LoggingSeverity.UNSET)


def declare(node: Node, *records: type[Config]) -> tuple[Config, ...]:
    """Declare every field of the records; return the filled records.

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
    if unknown:
        raise ParameterError(
            f'unknown parameter {", ".join(unknown)}; expected one of {", ".join(sorted(known))}'
        )
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
        If a value is out of bounds.
    """
    names = {item.name for item in fields(config)}
    values = {item.name: _plain(item.value) for item in parameters if item.name in names}
    return replace(config, **values)


def refusal(reason: str) -> SetParametersResult:
    """Return the answer to a parameter change that is refused."""
    return SetParametersResult(successful=False, reason=reason)


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
            # A whole number for a double is what people type; rclpy would refuse to start.
            override = node._parameter_overrides.get(item.name)
            if (
                override is not None
                and isinstance(default, float)
                and override.type_ is Parameter.Type.INTEGER
            ):
                node._parameter_overrides[item.name] = Parameter(
                    item.name, Parameter.Type.DOUBLE, float(override.value)
                )
            given = ros_value(default)
            value = node.declare_parameter(item.name, given, _descriptor(item)).value
        except InvalidParameterTypeException as error:
            raise ParameterError(f'parameter {item.name}: {error}') from error
        except InvalidParameterValueException:
            found = node._parameter_overrides[item.name].value
            raise ParameterError(
                f'parameter {item.name} = {found} is outside '
                f'[{item.metadata["low"]}, {item.metadata["high"]}] {item.metadata["unit"]}; '
                f'{item.metadata["doc"]}'
            ) from None
        values[item.name] = _plain(value)
    return values


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
