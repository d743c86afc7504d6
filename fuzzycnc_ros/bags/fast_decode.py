# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding flat messages with name arrays faster than rosbags does.

A stream repeats its array of names in every message, and decoding it is most of the work.  The
bytes of an array of strings state its own end and, starting at a multiple of four, do not depend
on where they stand: bytes that begin as those of the message before give the same names.
Whatever is unusual about a message is left to rosbags, whose checks and errors then apply.
"""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from fuzzycnc_ros.bags.typestore import deserialize

Decode = Callable[[bytes], Any]
Step = Callable[[bytes, int], tuple[Any, int]]
"""Takes the message without its head and a position; returns a value and where it ends."""

_BASE, _NAME, _SEQUENCE = 1, 2, 4  # rosbags.interfaces.Nodetype
_HEAD = b'\x00\x01'  # CDR, little endian
_LENGTH = struct.Struct('<I')
_STAMP = struct.Struct('<iI')
_TIME, _HEADER = 'builtin_interfaces/msg/Time', 'std_msgs/msg/Header'
_TIME_FIELDS = [('sec', (_BASE, ('int32', 0))), ('nanosec', (_BASE, ('uint32', 0)))]
_HEADER_FIELDS = [('stamp', (_NAME, _TIME)), ('frame_id', (_BASE, ('string', 0)))]
_NUMBERS = {
    'bool': ('?', np.bool_),
    'int8': ('b', np.int8),
    'uint8': ('B', np.uint8),
    'int16': ('h', np.int16),
    'uint16': ('H', np.uint16),
    'int32': ('i', np.int32),
    'uint32': ('I', np.uint32),
    'int64': ('q', np.int64),
    'uint64': ('Q', np.uint64),
    'float32': ('f', np.float32),
    'float64': ('d', np.float64),
}


def fast_decoder(store: Any, type_name: str) -> Decode | None:
    """Return a faster decoder of a type, or None where rosbags' own is as good.

    Parameters
    ----------
    store : rosbags Typestore
        Store that defines the type.
    type_name : str
        The type; worth it are flat ones with an array of strings.
    """
    fields = [desc for _, desc in store.fielddefs[type_name][1]]
    if not any(_is_names(desc) for desc in fields):
        return None
    steps = [_step(store, desc) for desc in fields]
    plan = [step for step in steps if step is not None]
    if len(plan) < len(steps):
        return None
    make = store.types[type_name]

    def decode(raw: bytes) -> Any:
        if raw[:2] == _HEAD:
            body = raw[4:]
            position = 0
            values = []
            try:
                for step in plan:
                    value, position = step(body, position)
                    values.append(value)
            except (ValueError, struct.error):
                return deserialize(raw, type_name, store)
            if position <= len(body) <= position + 3:
                return make(*values)
        return deserialize(raw, type_name, store)

    return decode


def _is_names(desc: Any) -> bool:
    return bool(desc[0] == _SEQUENCE and desc[1][0][0] == _BASE and desc[1][0][1][0] == 'string')


def _step(store: Any, desc: Any) -> Step | None:
    kind, detail = desc
    if _is_names(desc):
        return _names()
    if kind == _SEQUENCE and detail[0][0] == _BASE and detail[0][1][0] in _NUMBERS:
        return _numbers(detail[0][1][0])
    if kind == _BASE and detail[0] == 'string':
        return _string
    if kind == _BASE and detail[0] in _NUMBERS:
        return _number(detail[0])
    # A bag may bring a type of the same name with other fields: ROS 1 had another header.
    if kind != _NAME or store.fielddefs.get(_TIME, ((), ()))[1] != _TIME_FIELDS:
        return None
    if detail == _TIME:
        return _time(store.types[_TIME])
    if detail == _HEADER and store.fielddefs[_HEADER][1] == _HEADER_FIELDS:
        return _header(store.types[_HEADER], store.types[_TIME])
    return None


def _string(body: bytes, position: int) -> tuple[str, int]:
    begin = (position + 3 & -4) + 4
    end = begin + _LENGTH.unpack_from(body, begin - 4)[0]
    if not begin < end <= len(body) or body[end - 1]:
        raise ValueError('a string has a wrong length')
    return body[begin : end - 1].decode(), end


def _names() -> Step:
    block = b''
    names: list[str] = []

    def step(body: bytes, position: int) -> tuple[list[str], int]:
        nonlocal block, names
        begin = position + 3 & -4
        if block and body.startswith(block, begin):
            return names.copy(), begin + len(block)
        count = _LENGTH.unpack_from(body, begin)[0]
        if count * 5 > len(body):
            raise ValueError('more strings than bytes')
        found = []
        end = begin + 4
        for _ in range(count):
            name, end = _string(body, end)
            found.append(name)
        block, names = body[begin:end], found
        return found.copy(), end

    return step


def _numbers(name: str) -> Step:
    dtype = np.dtype(_NUMBERS[name][1]).newbyteorder('<')
    size = dtype.itemsize

    def step(body: bytes, position: int) -> tuple[Any, int]:
        begin = position + 3 & -4
        count = _LENGTH.unpack_from(body, begin)[0]
        begin += 4
        if count:  # nothing aligns an empty array
            begin = begin + size - 1 & -size
        return np.frombuffer(body, dtype, count, begin), begin + count * size

    return step


def _number(name: str) -> Step:
    form = struct.Struct('<' + _NUMBERS[name][0])
    size = form.size

    def step(body: bytes, position: int) -> tuple[Any, int]:
        begin = position + size - 1 & -size
        return form.unpack_from(body, begin)[0], begin + size

    return step


def _time(make: Any) -> Step:
    def step(body: bytes, position: int) -> tuple[Any, int]:
        begin = position + 3 & -4
        return make(*_STAMP.unpack_from(body, begin)), begin + 8

    return step


def _header(make: Any, make_time: Any) -> Step:
    time = _time(make_time)

    def step(body: bytes, position: int) -> tuple[Any, int]:
        stamp, position = time(body, position)
        frame_id, position = _string(body, position)
        return make(stamp, frame_id), position

    return step
