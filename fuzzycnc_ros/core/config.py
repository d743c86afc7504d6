# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Configuration records: one frozen dataclass per component, its fields the single schema.

A field made with `param` carries unit, meaning, bounds and whether it may change at run time.
The ROS declaration, `params/*.yaml` and the parameter tables of the docs all follow from it.
"""

import sys
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from math import isfinite
from types import MappingProxyType
from typing import Any, ClassVar

Value = bool | int | float | str | tuple[str, ...] | tuple[float, ...]
"""Value of a parameter; tuples become ROS arrays."""


def param(
    default: Value,
    unit: str,
    doc: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    live: bool = False,
) -> Any:
    """Make a dataclass field with unit, meaning, inclusive bounds or allowed words.

    Parameters
    ----------
    default : bool, int, float, str or tuple
        Default value; its type is the parameter's type.
    unit : str
        SI unit, `-` for a pure number, a name or a switch.
    doc : str
        One sentence for people who set the parameter.
    low, high : float, optional
        Inclusive bounds; both are required for a number or a tuple of numbers.
    choices : tuple of str, optional
        Allowed words of a text parameter.
    live : bool
        Whether the component re-reads the value while it runs.
    """
    sample = default[0] if isinstance(default, tuple) and default else default
    if isinstance(sample, (int, float)) and not isinstance(sample, bool):
        if low is None or high is None:
            raise TypeError(f'a number needs bounds: {doc}')
    metadata = {
        'unit': unit,
        'doc': doc,
        'low': low,
        'high': high,
        'choices': choices,
        'live': live,
    }
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Config:
    """Base of all configuration records; checks types, bounds and words.

    Attributes
    ----------
    GONE : mapping
        Parameters that earlier versions had, each with the value that is what is done now: a bag
        that says so is replayed.
    INSTEAD : str
        Words on what takes their place, which follow 'delete it'.
    """

    GONE: ClassVar[Mapping[str, Value]] = MappingProxyType({})
    INSTEAD: ClassVar[str] = ''

    def __post_init__(self) -> None:
        """Check every field.

        Raises
        ------
        ValueError
            If a value has another type than its default, is not finite, lies outside its
            bounds or is not one of the allowed words.  The message names the parameter.
        """
        for item in fields(self):
            value = _coerced(item.name, getattr(self, item.name), item.default)
            object.__setattr__(self, item.name, value)
            _check_range(item.name, value, item.metadata)


def same_param(config: type[Config], name: str) -> Any:
    """Make a field with default, unit, bounds and text of a field of another configuration."""
    item = {item.name: item for item in fields(config)}[name]
    return field(default=item.default, metadata=item.metadata)


def _coerced(name: str, value: Any, default: Any) -> Value:
    """Return `value` in the type of `default`: whole numbers for doubles, lists for tuples."""
    if default is MISSING:
        raise TypeError(f'{name} has no default')
    value = _without_numpy(value)
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return _double(name, value)
    if isinstance(default, tuple) and isinstance(value, (list, tuple)):
        wanted: type = type(default[0]) if default else str
        items = [
            _double(name, v) if wanted is float and type(v) is int else v  # YAML writes 1 for 1.0
            for v in value
        ]
        if all(type(v) is wanted for v in items):
            return tuple(items)
    elif type(value) is type(default):
        return value  # type: ignore[no-any-return]
    raise ValueError(
        f'{name}: expected {type(default).__name__} as in the default {default!r} '
        f'but found {value!r}'
    )


def _without_numpy(value: Any) -> Any:
    """Return numpy's scalars and arrays as what Python calls them.

    Who made such a value has loaded numpy; a configuration alone does not.
    """
    numpy = sys.modules.get('numpy')
    if numpy is not None and isinstance(value, (numpy.ndarray, numpy.generic)):
        value = value.tolist()
        if isinstance(value, numpy.longdouble):  # is left as it is by tolist
            return float(value)
    if isinstance(value, (list, tuple)):
        return [_without_numpy(item) for item in value]
    return value


def _double(name: str, value: int) -> float:
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f'{name}: expected a number but found one beyond all doubles') from None


def _check_range(name: str, value: Value, meta: Any) -> None:
    low, high, unit = meta['low'], meta['high'], meta['unit']
    if low is not None:
        numbers = value if isinstance(value, tuple) else (value,)
        for number in numbers:
            if not isinstance(number, (int, float)):
                raise ValueError(f'{name}: expected a number but found {number!r}')
            if not (low <= number <= high and isfinite(number)):  # a huge int is no double
                raise ValueError(
                    f'{name} = {number} is outside [{low}, {high}] {unit}; {meta["doc"]}'
                )
    if meta['choices'] and value not in meta['choices']:
        raise ValueError(f'{name}: expected one of {", ".join(meta["choices"])} but found {value}')
