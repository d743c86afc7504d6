# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion between messages and the records of components, by attribute access only.

Neither rclpy nor rosbags is imported: both libraries' message objects have the same attribute
names, and the caller says how to make one.  A record's annotations are the whole mapping.
"""

from array import array
from collections.abc import Callable
from dataclasses import fields
from functools import cache, lru_cache
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from fuzzycnc_ros.runtime import records as definitions
from fuzzycnc_ros.runtime.records import SECOND, Record

R = TypeVar('R')
MessageFactory = Callable[[str], Callable[..., Any]]
"""Return the constructor of a message type, named `package/msg/Name`."""
Decoder = Callable[[Any], Any]
Encoder = Callable[[Any, 'Target'], Any]

_TYPECODES = {
    np.dtype(np.float64): 'd',
    np.dtype(np.uint8): 'B',
    np.dtype(np.uint32): 'I',
    np.dtype(np.uint64): 'Q',
    np.dtype(np.int64): 'q',
}


class Target:
    """Target library of messages: how to build them.

    Parameters
    ----------
    factory : callable
        Message type name to constructor.
    numpy_arrays : bool
        Whether messages hold numpy arrays (rosbags) or `array.array` and lists (rclpy).
    """

    def __init__(self, factory: MessageFactory, *, numpy_arrays: bool) -> None:
        self.factory = cache(factory)
        self._numpy_arrays = numpy_arrays

    def array(self, values: Any) -> Any:
        """Return a numeric or boolean array in the library's own form."""
        if self._numpy_arrays:
            return values
        if values.dtype == np.bool_:
            return values.tolist()
        # Filling from the buffer avoids rclpy's check of every single element.
        return array(_TYPECODES[values.dtype], values.tobytes())

    def time(self, stamp: int) -> Any:
        """Return a `builtin_interfaces/msg/Time`."""
        seconds, rest = divmod(stamp, SECOND)
        return self.factory('builtin_interfaces/msg/Time')(sec=seconds, nanosec=rest)

    def header(self, stamp: int, frame_id: str) -> Any:
        """Return a `std_msgs/msg/Header`."""
        return self.factory('std_msgs/msg/Header')(stamp=self.time(stamp), frame_id=frame_id)


def stamp_of(time: Any) -> int:
    """Return a `builtin_interfaces/msg/Time` in nanoseconds."""
    return int(time.sec) * SECOND + int(time.nanosec)


def decode(record_type: type[R], message: Any) -> R:
    """Return the record of a message.

    Parameters
    ----------
    record_type : type
        A class of `fuzzycnc_ros.runtime.records`.
    message : object
        A message of the type `record_type.TYPE`, from rclpy or rosbags.
    """
    values = {name: read(getattr(message, name)) for name, read, _ in _plan(record_type)}
    if issubclass(record_type, Record):
        header = message.header
        values['stamp'] = stamp_of(header.stamp)
        values['frame_id'] = header.frame_id
    return record_type(**values)


def encode(record: Any, target: Target) -> Any:
    """Return the message of a record, made by `target`."""
    values = {name: write(getattr(record, name), target) for name, _, write in _plan(type(record))}
    if isinstance(record, Record):
        values['header'] = target.header(record.stamp, record.frame_id)
    return target.factory(record.TYPE)(**values)


def _array_codec(dtype: Any) -> tuple[Decoder, Encoder]:
    def read(values: Any) -> Any:
        return np.array(values, dtype=dtype)

    def write(values: Any, target: Target) -> Any:
        return target.array(np.ascontiguousarray(values, dtype=dtype))

    return read, write


def _nested_codec(record_type: type) -> tuple[Decoder, Encoder]:
    def read(values: Any) -> Any:
        return tuple(decode(record_type, value) for value in values)

    def write(values: Any, target: Target) -> Any:
        return [encode(value, target) for value in values]

    return read, write


@lru_cache(64)
def _shared(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return equal names as one object: records that are kept do not each hold their own."""
    return names


def _scalar_codec(kind: Callable[[Any], Any]) -> tuple[Decoder, Encoder]:
    return kind, lambda value, target: kind(value)


def _codec(hint: Any) -> tuple[Decoder, Encoder]:
    """Return the pair that reads and writes one annotation of a record."""
    if hint == definitions.Stamp:
        return stamp_of, lambda value, target: target.time(value)
    if hint in (bool, int, float, str):
        return _scalar_codec(hint)
    if hasattr(hint, '__metadata__'):  # Annotated[NDArray[...], name]
        hint = get_args(hint)[0]
    if get_origin(hint) is tuple:
        item = get_args(hint)[0]
        if item is str:
            return lambda values: _shared(tuple(values)), lambda value, target: list(value)
        return _nested_codec(item)
    return _array_codec(get_args(get_args(hint)[1])[0])


_plans: dict[type, tuple[tuple[str, Decoder, Encoder], ...]] = {}


def _plan(record_type: type) -> tuple[tuple[str, Decoder, Encoder], ...]:
    """Return how to read and write each field of a record."""
    plan = _plans.get(record_type)
    if plan is None:
        plan = _plans[record_type] = _make_plan(record_type)
    return plan


def _make_plan(record_type: type) -> tuple[tuple[str, Decoder, Encoder], ...]:
    hints = get_type_hints(record_type, include_extras=True)
    spread = ('stamp', 'frame_id') if issubclass(record_type, Record) else ()
    names = [item.name for item in fields(record_type) if item.name not in spread]
    return tuple((name, *_codec(hints[name])) for name in names)
