# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Records with wrong content: everything that a message of the type can carry, and a machine not.

A mutated record always is a possible message: types and ranges are those of its definition.
"""

import random
import re
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np

from fuzzycnc_ros.bags.definitions import find_text
from fuzzycnc_ros.bags.typestore import message_type, serialize, typestore
from fuzzycnc_ros.runtime.convert import Target, encode
from fuzzycnc_ros.runtime.records import SECOND, Record

ROSBAGS = Target(message_type, numpy_arrays=True)

_BASE, _NAME, _SEQUENCE = 1, 2, 4  # rosbags.interfaces.Nodetype
FLOATS = (
    np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 1e-3, 1e-6, -1e-6, 50.0, 1e3, -1e3, 1e9, -1e9,
    1e154, -1e154, 1e300, 1.7976931348623157e308, -1.7976931348623157e308, 5e-324,
)  # fmt: skip
TEXTS = (
    '', ' ', 'X', 'Y', 'Z', 'x', 'Q', 'T1', 'T99', 'mill/workpiece', 'lathe/machine', '/', '..',
    '../../etc/passwd', '\x00', '\u202e', 'é' * 40, 'A' * 20000, '%s{0}\n', '0', 'nan', 'curve',
)  # fmt: skip
SECONDS = (
    -(2**31), -1, 0, 1, 10, 1000, 10**6, 10**9, 2 * 10**9, 2**31 - 1,
)  # fmt: skip
SHIFTS = (-SECOND * 86_400, -SECOND, -1, 0, 1, SECOND, 600 * SECOND, 86_400 * SECOND)
LENGTHS = (0, 1, 2, 3, 7, 100, 20_000)
_RANGES = {
    'uint8': (0, 2**8 - 1),
    'uint16': (0, 2**16 - 1),
    'uint32': (0, 2**32 - 1),
    'uint64': (0, 2**64 - 1),
    'int32': (-(2**31), 2**31 - 1),
    'int64': (-(2**63), 2**63 - 1),
}


def mutated(record: Any, rng: random.Random, edits: int = 1) -> Any:
    """Return a record with up to `edits` fields changed."""
    for _ in range(edits):
        choice = rng.random()
        if choice < 0.1:
            record = _shortened(record, rng)
        elif choice < 0.3 and isinstance(record, Record):
            record = replace(record, stamp=_stamp(record.stamp, rng))
        else:
            name, kind = rng.choice(_fields(type(record)))
            record = replace(record, **{name: _value(kind, getattr(record, name), rng)})
    return record


def check_published(record: Record) -> None:
    """Refuse a record that is no message, or holds a number that its definition rules out."""
    serialize(encode(record, ROSBAGS))
    _check_finite(record)


def _check_finite(record: Any) -> None:
    for name, may_be_nan in _floats(record.TYPE).items():
        values = np.asarray(getattr(record, name), dtype=np.float64)
        bad = np.isinf(values) if may_be_nan else ~np.isfinite(values)
        assert not bad.any(), f'{record.TYPE}: {name}: {values}'
    for item in fields(record):
        value = getattr(record, item.name)
        if isinstance(value, tuple) and value and hasattr(value[0], 'TYPE'):
            for part in value:
                _check_finite(part)


@cache
def _floats(type_name: str) -> dict[str, bool]:
    """Return the floating-point fields of a message and whether they may be NaN."""
    text = find_text(type_name)
    assert text is not None
    found = re.findall(r'^float64(?:\[\d*\])? +(\w+) +#(.*)$', text, re.MULTILINE)
    return {name: 'NaN' in comment for name, comment in found}


@cache
def _fields(record_type: Any) -> list[tuple[str, Any]]:
    """Return names and kinds of what may be changed, as the message defines it."""
    message_type(record_type.TYPE)
    there = {item.name for item in fields(record_type)}
    found = [(n, kind) for n, kind in typestore().fielddefs[record_type.TYPE][1] if n in there]
    return [*found, ('frame_id', (_BASE, ('string', 0)))] if 'frame_id' in there else found


def _value(kind: Any, value: Any, rng: random.Random) -> Any:
    number, detail = kind
    if number == _BASE:
        return _scalar(detail[0], value, rng)
    if number == _NAME:
        return _stamp(value, rng)
    if detail[0][0] == _NAME:
        return tuple(_resized(list(value), rng, lambda item: mutated(item, rng)))
    name = detail[0][1][0]
    items = list(value) or [_scalar(name, '' if name == 'string' else 0, rng)]
    items = _resized(items, rng, lambda item: _scalar(name, item, rng))
    if name == 'string':
        return tuple(items)
    return np.array(items, dtype=np.dtype('bool' if name == 'bool' else name))


def _resized(items: list[Any], rng: random.Random, change: Callable[[Any], Any]) -> list[Any]:
    """Change one or all elements of a list, their order, or its length."""
    choice = rng.randrange(8)
    if not items:
        return []
    if choice == 0:
        length = rng.choice(LENGTHS)
        return (items * (length // len(items) + 1))[:length]
    if choice == 1:
        return items[: rng.randrange(len(items))]
    if choice == 2:
        return [*items, rng.choice(items)]
    if choice == 3:
        return rng.sample(items, len(items))
    if choice == 4:
        return [change(rng.choice(items))] * len(items)
    place = rng.randrange(len(items))
    return [change(item) if k == place else item for k, item in enumerate(items)]


def _scalar(name: str, value: Any, rng: random.Random) -> Any:
    if name == 'string':
        return rng.choice(TEXTS)
    if name == 'bool':
        return bool(rng.getrandbits(1))
    if name == 'float64':
        choice = rng.randrange(3)
        if choice == 0:
            return float(value) * rng.choice((-1.0, 0.5, 2.0, 1e3, 1.0 + 1e-9))
        if choice == 1:
            return float(value) + rng.choice((1e-6, -1e-6, 1e-3, 10.0, -10.0))
        return rng.choice(FLOATS)
    low, high = _RANGES[name]
    wanted = rng.choice((low, high, 0, 1, 2, 3, 4, 5, 6, 7, int(value) + 1, int(value) - 1, 255))
    return min(max(wanted, low), high)


def _stamp(value: int, rng: random.Random) -> int:
    if rng.getrandbits(1):
        return rng.choice(SECONDS) * SECOND + rng.choice((0, 1, SECOND - 1))
    wanted = value + rng.choice(SHIFTS)
    # Good records after it still need stamps that a message can carry.
    return wanted if 0 <= wanted <= SECONDS[-2] * SECOND else value


def _shortened(record: Any, rng: random.Random) -> Any:
    """Return a record all of whose arrays have the same new length."""
    length = rng.choice((0, 0, 1, 2, 500))
    changes: dict[str, Any] = {}
    for name, (number, _) in _fields(type(record)):
        value = getattr(record, name)
        if number == _SEQUENCE and len(value):
            some = list(value) * (length // len(value) + 1)
            changes[name] = (
                tuple(some[:length])
                if isinstance(value, tuple)
                else np.array(some[:length], dtype=value.dtype)
            )
    return replace(record, **changes)
