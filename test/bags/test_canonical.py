# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The canonical form: what changes a hash and what does not."""

import random
import struct

import numpy as np
import pytest

from fuzzycnc_ros.bags import canonical
from fuzzycnc_ros.bags.canonical import combined_hash, tagged_fields, topic_hashes
from fuzzycnc_ros.bags.errors import BagDataError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.typestore import message_type, serialize
from fuzzycnc_ros.bags.writer import BagWriter

TEMPERATURES = 'fuzzycnc_msgs/msg/Temperatures'
SECOND = 10**9


@pytest.fixture
def messages(new):
    return [
        ('/mill/temperatures', TEMPERATURES, k, new.temperatures(k * SECOND, (20.0, k)))
        for k in range(20)
    ]


def test_order_log_time_and_padding_do_not_count(messages):
    expected = topic_hashes(messages)
    assert len(expected['/mill/temperatures']) == 64
    shuffled = [(t, kind, 7, m) for t, kind, _, m in messages]
    random.Random(0).shuffle(shuffled)
    assert topic_hashes(shuffled) == expected
    dirty = []
    for topic, kind, log_time, message in messages:
        raw = bytearray(serialize(message))
        end = raw.index(b'machine\x00') + len('machine\x00')
        raw[end : end + -(end - 4) % 4] = b'\xaa' * (-(end - 4) % 4)
        dirty.append((topic, kind, log_time, bytes(raw)))
    assert topic_hashes(dirty) == expected


def test_order_of_equal_stamps_does_not_count(new):
    same = [('/t', TEMPERATURES, 0, new.temperatures(5, (k,))) for k in range(6)]
    assert topic_hashes(same) == topic_hashes(same[::-1])


def test_every_content_counts(messages, new):
    expected = topic_hashes(messages)
    assert topic_hashes(messages[:-1]) != expected
    assert topic_hashes([*messages, messages[0]]) != expected
    topic, kind, log_time, _ = messages[3]
    changed = list(messages)
    changed[3] = (topic, kind, log_time, new.temperatures(3 * SECOND, (20.0, np.nextafter(3, 4))))
    assert topic_hashes(changed) != expected


def test_bag_and_its_messages_agree(small_bag):
    with BagReader(small_bag) as reader:
        decoded = topic_hashes(reader.messages())
        raw = topic_hashes(reader.messages(raw=True))
    assert topic_hashes(small_bag) == decoded == raw
    assert list(decoded) == ['/mill/displacement', '/mill/temperatures']


def test_types_that_only_the_bag_knows_are_hashed(tmp_path):
    definition = 'float64 load  # [-] Load\nfloat64 took  # [wall] [s] Time it took\n'
    hashes = []
    for part, (load, took) in enumerate([(1.0, 2.0), (1.0, 3.0), (2.0, 2.0)]):
        with BagWriter(tmp_path / f'{part}') as writer:
            writer.add_topic('/a', 'far_msgs/msg/Load', definition=definition)
            writer.write('/a', 1, 1, b'\x00\x01\x00\x00' + struct.pack('<dd', load, took))
        hashes.append(topic_hashes(tmp_path / f'{part}'))
    assert hashes[0] == hashes[1] != hashes[2]


def test_plumbing_is_left_out(new):
    names = [*canonical.EXCLUDED, 'temperatures', 'my_clock', 'recorder_progress']
    hashes = topic_hashes((f'/mill/{n}', TEMPERATURES, 0, new.temperatures(0)) for n in names)
    assert list(hashes) == ['/mill/my_clock', '/mill/recorder_progress', '/mill/temperatures']
    assert topic_hashes([('/diagnostics', TEMPERATURES, 0, new.temperatures(0))]) == {}
    assert topic_hashes([('/a/x', TEMPERATURES, 0, new.temperatures(0))], exclude=['/x']) == {}


def test_combined_hash_depends_on_names_and_hashes():
    assert combined_hash({'/a': '1', '/b': '2'}) != combined_hash({'/a': '2', '/b': '1'})
    assert combined_hash({'/a': '1'}) != combined_hash({'/c': '1'})


DEFINITION = """uint8 KIND = 1  # [wall] a constant is no field
std_msgs/Header header
float64 load        # [-] Load; not [wall]y
builtin_interfaces/Time written  # [wall] When it was written
Part[] part         # Parts
string host # [wall] Where
float64[] took  # [wall] [s] How long
================================================================================
MSG: shop_msgs/Part
string name
uint32[2] seen  # [wall] [-] Clock ticks
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""


def test_tagged_fields_are_found_wherever_they_are():
    assert tagged_fields(DEFINITION.replace('not [wall]y', ''), 'shop_msgs/msg/Load') == (
        ('written',),
        ('part', 'seen'),
        ('host',),
        ('took',),
    )


def test_tagged_fields_do_not_count(monkeypatch, tmp_path):
    folder = tmp_path / 'share' / 'wall_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Part.msg').write_text('string name\nuint32[2] seen  # [wall] [-] Clock ticks\n')
    (folder / 'Load.msg').write_text(
        'float64 load  # [-] Load\nbuiltin_interfaces/Time written  # [wall] When\n'
        'Part[] part\nstring host  # [wall] Where\nfloat64[] took  # [wall] [s] How long\n'
    )
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    load, part, time = (
        message_type(name)
        for name in ('wall_msgs/msg/Load', 'wall_msgs/msg/Part', 'builtin_interfaces/msg/Time')
    )
    paths = (('written',), ('part', 'seen'), ('host',), ('took',))
    monkeypatch.setattr(canonical, 'wall_fields', lambda name: paths)

    def make(value, noise):
        return load(
            load=value,
            written=time(sec=noise, nanosec=noise),
            part=[part(name='p', seen=np.array([noise, 2], dtype=np.uint32))],
            host=f'host{noise}',
            took=np.array([float(noise)]),
        )

    def digest(message):
        return topic_hashes([('/t', 'wall_msgs/msg/Load', 0, message)])

    assert digest(make(1.0, 3)) == digest(make(1.0, 4))
    assert digest(make(1.0, 3)) != digest(make(2.0, 3))
    message = make(1.0, 3)
    digest(message)
    assert message.written.sec == 3, 'hashing leaves the message as it was'


def test_message_that_does_not_fit_is_refused():
    with pytest.raises(BagDataError, match=r'fit'):
        topic_hashes([('/t', TEMPERATURES, 0, b'\x00\x01\x00\x00')])
