# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Records and messages are one thing: same fields, same constants, nothing lost on the way."""

from dataclasses import fields, is_dataclass
from itertools import product
from operator import attrgetter
from typing import Any, get_type_hints

import interfaces
import numpy as np
import pytest
from each_case import for_each

from fuzzycnc_ros.core.deformation.compensation import StepFlag
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.runtime import enums as codes
from fuzzycnc_ros.runtime import host as host_records
from fuzzycnc_ros.runtime import records
from fuzzycnc_ros.runtime.convert import Target, decode, encode
from fuzzycnc_ros.runtime.records import Record, SensorCluster

TYPES = {
    item.TYPE.split('/')[-1]: item
    for item in (vars(records) | vars(host_records)).values()
    if isinstance(item, type) and is_dataclass(item) and hasattr(item, 'TYPE')
}
ANNOTATIONS = {
    'string': str,
    'bool': bool,
    'uint8': int,
    'uint16': int,
    'uint32': int,
    'uint64': int,
    'float64': float,
    'builtin_interfaces/Time': records.Stamp,
    'string[]': records.Names,
    'bool[]': records.Bools,
    'uint8[]': records.Bytes,
    'uint32[]': records.Offsets,
    'uint64[]': records.Counts,
    'int64[]': records.Blocks,
    'float64[]': records.Floats,
    'SensorCluster[]': tuple[SensorCluster, ...],
}
ENUMS = [
    ('Temperatures', 'STATUS', codes.Status),
    ('SpindleSpeed', 'STATUS', codes.SpeedStatus),
    ('ProbeTouch', 'KIND', codes.TouchKind),
    ('MachineState', 'COOLANT', codes.Coolant),
    ('ThermalError', 'REASON', codes.Reason),
    ('Compensation', 'STATE', codes.CompensationState),
    ('CompensationApplied', 'STATUS', OffsetStatus),
    ('MachineState', 'STATE', codes.MachineMode),
    ('ToolPath', 'KIND', codes.SegmentKind),
    ('ToolPath', 'JUNCTION', codes.Junction),
    ('TrajectoryState', 'STATUS', TrajectoryStatus),
    ('ServoState', 'STATUS', codes.ServoStatus),
    ('ServoTrialState', 'STATUS', codes.TrialStatus),
    ('StitchPattern', 'KIND', codes.PrimitiveKind),
    ('CompensatedPath', 'FLAG', StepFlag),
]
CASES = ('ordinary', 'empty', 'extreme')


def value_of(annotation: str, case: str, rng: np.random.Generator) -> Any:
    """Return a value for a field of a message."""
    count = {'ordinary': 3, 'empty': 0, 'extreme': 2}[case]
    kind = annotation.removesuffix('[]')
    if annotation == 'SensorCluster[]':
        return tuple(sample(SensorCluster, case, rng) for _ in range(count))
    if annotation.endswith('[]'):
        if kind == 'string':
            return tuple(f'T{number}µ'[: 2 + number] for number in range(count))
        if kind == 'bool':
            return rng.random(count) < 0.5
        if kind == 'float64':
            values = rng.normal(size=count)
            if case == 'extreme':
                values[:] = [np.nan, -np.inf]
            return values
        limits = np.iinfo(kind)
        ends = [limits.min, limits.max]
        return np.array(ends if case == 'extreme' else rng.integers(0, 99, count), dtype=kind)
    if kind == 'string':
        return {'ordinary': 'grösste Abweichung', 'empty': '', 'extreme': 'x' * 70_000}[case]
    if kind == 'bool':
        return case == 'ordinary'
    if kind == 'float64':
        return {'ordinary': 0.25, 'empty': 0.0, 'extreme': float('nan')}[case]
    if kind == 'builtin_interfaces/Time':
        return {'ordinary': 21_600_012_345_678_901, 'empty': 0, 'extreme': (2**31) * 10**9 - 1}[
            case
        ]
    return {'ordinary': 7, 'empty': 0, 'extreme': int(np.iinfo(kind).max)}[case]


def sample(record_type: type, case: str, rng: np.random.Generator) -> Any:
    """Return a record whose every field holds something."""
    name = record_type.TYPE.split('/')[-1]
    values = {
        item.name: value_of(item.type, case, rng)
        for item in interfaces.fields(name)
        if item.name != 'header'
    }
    if issubclass(record_type, Record):
        values['stamp'] = value_of('builtin_interfaces/Time', case, rng)
        values['frame_id'] = '' if case == 'empty' else 'mill/machine'
    return record_type(**values)


def assert_same(found: Any, wanted: Any) -> None:
    """Compare two records field by field; NaN equals NaN, and types count."""
    assert type(found) is type(wanted)
    for item in fields(wanted):
        one, other = getattr(found, item.name), getattr(wanted, item.name)
        if isinstance(other, np.ndarray):
            assert isinstance(one, np.ndarray)
            assert one.dtype == other.dtype
            np.testing.assert_array_equal(one, other)
        elif isinstance(other, tuple) and other and is_dataclass(other[0]):
            assert len(one) == len(other)
            for part, whole in zip(one, other, strict=True):
                assert_same(part, whole)
        elif isinstance(other, float):
            assert type(one) is float
            np.testing.assert_equal(one, other)
        else:
            assert type(one) is type(other)
            assert one == other


ALL = for_each(TYPES.values(), attrgetter('TYPE'))
EVERY_CASE = for_each(product(TYPES.values(), CASES), lambda case: f'{case[0].TYPE}, {case[1]}')


def test_every_message_has_a_record():
    assert set(TYPES) == set(interfaces.FILES['msg'])


@ALL
def test_record_has_the_fields_of_the_message(record_type):
    name = record_type.TYPE.split('/')[-1]
    hints = get_type_hints(record_type, include_extras=True)
    declared = interfaces.fields(name)
    spread = []
    if declared[0].name == 'header':
        assert issubclass(record_type, Record)
        spread = ['stamp', 'frame_id']
        declared = declared[1:]
    assert [item.name for item in fields(record_type)] == [*spread, *(i.name for i in declared)]
    for item in declared:
        assert hints[item.name] == ANNOTATIONS[item.type], item.name


@pytest.mark.parametrize(('message', 'prefix', 'enum'), ENUMS)
def test_enum_has_the_constants_of_the_message(message, prefix, enum):
    own = {
        name.removeprefix(f'{prefix}_'): value
        for name, value in interfaces.constants(message).items()
        if name.startswith(f'{prefix}_')
    }
    assert own == {item.name: item.value for item in enum}


def rosbags_target() -> Target:
    """Return the target that builds rosbags' messages."""
    pytest.importorskip('rosbags', reason="rosbags is missing: pip install 'fuzzycnc_ros[bags]'")
    from fuzzycnc_ros.bags.typestore import message_type

    return Target(message_type, numpy_arrays=True)


def rclpy_target() -> Target:
    """Return the target that builds rclpy's messages."""
    pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')
    pytest.importorskip('fuzzycnc_msgs.msg', reason='fuzzycnc_msgs is not built: run `make test`')
    from fuzzycnc_ros.ros.topics import RCLPY

    return RCLPY


@EVERY_CASE
def test_round_trip_through_rosbags(record_type, case):
    from fuzzycnc_ros.bags import typestore

    record = sample(record_type, case, np.random.default_rng(1))
    message = encode(record, rosbags_target())
    raw = typestore.serialize(message, record_type.TYPE)
    assert_same(decode(record_type, message), record)
    assert_same(decode(record_type, typestore.deserialize(raw, record_type.TYPE)), record)


@pytest.mark.ros
@EVERY_CASE
def test_round_trip_through_rclpy(record_type, case):
    target = rclpy_target()
    from rclpy.serialization import deserialize_message, serialize_message

    record = sample(record_type, case, np.random.default_rng(1))
    message = encode(record, target)
    again = deserialize_message(serialize_message(message), type(message))
    assert_same(decode(record_type, message), record)
    assert_same(decode(record_type, again), record)


@pytest.mark.ros
@EVERY_CASE
def test_both_libraries_write_the_same_bytes(record_type, case):
    """Once the padding is normalised, as everywhere where bytes are compared."""
    ours, theirs = rosbags_target(), rclpy_target()
    from rclpy.serialization import serialize_message

    from fuzzycnc_ros.bags import typestore

    record = sample(record_type, case, np.random.default_rng(1))
    one = typestore.serialize(encode(record, ours), record_type.TYPE)
    other = serialize_message(encode(record, theirs))
    # rmw sizes its buffer for the padding before elements that an empty sequence does not have,
    # and returns the whole buffer; on the wire the rest is cut off.
    sequences = sum(isinstance(value, np.ndarray) for value in vars(record).values())
    assert 0 <= len(other) - len(one) <= 8 + 4 * sequences
    assert typestore.serialize(typestore.deserialize(other[: len(one)], record_type.TYPE)) == one


@ALL
def test_decoded_arrays_are_independent_of_the_message(record_type):
    """A component may keep a record for hours; the message's buffer may be reused."""
    message = encode(sample(record_type, 'ordinary', np.random.default_rng(2)), rosbags_target())
    record = decode(record_type, message)
    for item in fields(record):
        value = getattr(record, item.name)
        if isinstance(value, np.ndarray):
            assert not np.shares_memory(value, getattr(message, item.name))


@pytest.mark.parametrize('stamp', [0, 1, 999_999_999, 1_000_000_000, 1_700_000_000_123_456_789])
def test_stamps_are_kept_to_the_nanosecond(stamp):
    record = host_records.DeadlineFired(stamp=stamp, frame_id='mill/machine', node='compensator')
    message = encode(record, rosbags_target())
    assert 0 <= message.header.stamp.nanosec < records.SECOND
    assert decode(host_records.DeadlineFired, message).stamp == stamp
