# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The fast decoder gives what rosbags gives, message by message, error by error."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.bags import definitions
from fuzzycnc_ros.bags.decoder import fast_decoder
from fuzzycnc_ros.bags.errors import BagDataError
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.bags.typestore import deserialize, message_type, serialize, typestore

TEMPERATURES = 'fuzzycnc_msgs/msg/Temperatures'
KINDS = 'test_msgs/msg/Kinds'
DEFINITION = """string[] first
uint8 a
float64[] numbers
bool[] flags
string text
int16[] small
string[] second
float32 b
uint64[] large
builtin_interfaces/Time time
int64 c
"""
NAMES = st.lists(st.text(max_size=9), max_size=5)


@pytest.fixture(scope='module')
def store():
    typesys = load('rosbags.typesys')
    made = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    made.register(definitions.parse(DEFINITION, KINDS))
    return made


@pytest.fixture(scope='module')
def decoder(store):
    return fast_decoder(store, KINDS)


def array(strategy, dtype):
    return st.lists(strategy, max_size=5).map(lambda values: np.array(values, dtype=dtype))


VALUES = {
    'first': NAMES,
    'a': st.integers(0, 255),
    'numbers': array(st.floats(), np.float64),
    'flags': array(st.booleans(), np.bool_),
    'text': st.text(max_size=9),
    'small': array(st.integers(-9, 9), np.int16),
    'second': NAMES,
    'b': st.floats(width=32),
    'large': array(st.integers(0, 2**64 - 1), np.uint64),
    'time': st.builds(
        lambda sec, nanosec: message_type('builtin_interfaces/msg/Time')(sec=sec, nanosec=nanosec),
        st.integers(-(2**31), 2**31 - 1),
        st.integers(0, 10**9 - 1),
    ),
    'c': st.integers(-(2**63), 2**63 - 1),
}


def same(store, one, two):
    assert type(one) is type(two)
    for (name, a), (other, b) in zip(vars(one).items(), vars(two).items(), strict=True):
        assert name == other
        assert type(a) is type(b)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
    assert serialize(one, KINDS, store) == serialize(two, KINDS, store)


@settings(max_examples=300, deadline=None)
@given(st.fixed_dictionaries(VALUES))
def test_messages_equal_those_of_rosbags(store, decoder, values):
    raw = serialize(store.types[KINDS](**values), KINDS, store)
    for _ in range(2):  # the second time from the remembered names
        same(store, decoder(raw), deserialize(raw, KINDS, store))


@settings(max_examples=300, deadline=None)
@given(st.fixed_dictionaries(VALUES), st.data())
def test_damaged_messages_fail_as_with_rosbags(store, decoder, values, data):
    raw = bytearray(serialize(store.types[KINDS](**values), KINDS, store))
    decoder(bytes(raw))
    for _ in range(data.draw(st.integers(1, 3))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    damaged = bytes(raw[: data.draw(st.integers(2, len(raw)))])
    outcomes = []
    for decode in (decoder, lambda bytes_: deserialize(bytes_, KINDS, store)):
        try:
            outcomes.append(serialize(decode(damaged), KINDS, store))
        except BagDataError as error:
            outcomes.append(str(error))
    assert outcomes[0] == outcomes[1]


def test_names_that_change_are_seen(new):
    decoder = fast_decoder(typestore(), TEMPERATURES)
    for names in (('a', 'b'), ('a', 'c'), ('a', 'bb'), ('a', 'b', 'c'), (), ('a', 'b')):
        raw = serialize(new.temperatures(5, np.arange(float(len(names))), names))
        assert decoder(raw).sensor == list(names)


def test_messages_share_nothing_that_can_be_changed(new):
    decoder = fast_decoder(typestore(), TEMPERATURES)
    raw = serialize(new.temperatures(5))
    one, two = decoder(raw), decoder(raw)
    one.sensor.append('x')
    assert two.sensor == decoder(raw).sensor == ['n0', 'n1']


def test_big_endian_is_left_to_rosbags(new):
    message = new.temperatures(5)
    raw = bytes(typestore().serialize_cdr(message, TEMPERATURES, little_endian=False))
    decoded = fast_decoder(typestore(), TEMPERATURES)(raw)
    assert serialize(decoded) == serialize(message)


@pytest.mark.parametrize(
    'name', ['std_msgs/msg/String', 'fuzzycnc_msgs/msg/SensorSelection', 'std_msgs/msg/Empty']
)
def test_other_types_are_left_to_rosbags(name):
    assert fast_decoder(typestore(), name) is None


def test_other_header_is_left_to_rosbags():
    typesys = load('rosbags.typesys')
    odd = typesys.get_typestore(typesys.Stores.EMPTY)
    odd.register(
        definitions.parse(
            'std_msgs/Header header\nstring[] name\n'
            f'{definitions.SEPARATOR}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\n'
            f'{definitions.SEPARATOR}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n',
            'old_msgs/msg/Old',
        )
    )
    assert fast_decoder(odd, 'old_msgs/msg/Old') is None
    assert fast_decoder(typestore(), TEMPERATURES) is not None
