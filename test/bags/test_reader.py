# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading bags: bags of rosbag2 itself, bags that lie, hostile files."""

import os
import re
import shutil
import sqlite3
import struct
import zlib
from contextlib import closing
from pathlib import Path

import mcap.reader
import mcap.writer
import numpy as np
import pytest
import rosbags.rosbag2
import zstandard
from benches import pattern_bench
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.bags import playback
from fuzzycnc_ros.bags.errors import (
    BagCountError,
    BagDataError,
    BagError,
    BagFormatError,
    BagTopicError,
    BagTruncatedError,
    BagTypeError,
    BagVersionError,
)
from fuzzycnc_ros.bags.mcapfile import MAGIC, McapFile
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.typestore import deserialize, serialize
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.runtime.convert import decode
from fuzzycnc_ros.runtime.enums import PrimitiveKind
from fuzzycnc_ros.runtime.provenance import MESSAGE_SET
from fuzzycnc_ros.runtime.records import (
    CompensationApplied,
    Displacement,
    MachineState,
    StitchPattern,
    ThermalError,
)
from fuzzycnc_ros.studies.published_bag import PublishedBag

SECOND = 10**9
PY = 'rosbag2_py/test/resources'
TRANSPORT = 'rosbag2_transport/test/resources'
CPP = 'rosbag2_cpp/test/rosbag2_cpp/bags'

# Bag, messages, and of those the ones on topics that can be decoded without further packages.
SAMPLES = [
    ('ros2bag/test/resources/empty_bag', 0, 0),
    (f'{CPP}/only_services.mcap', 12, 0),
    (f'{CPP}/only_topics.mcap', 7, 7),
    (f'{CPP}/topics_and_services.db3', 13, 7),
    (f'{CPP}/topics_and_services.mcap', 13, 7),
    (f'{PY}/mcap/convert_a', 150, 50),
    (f'{PY}/mcap/convert_b', 75, 50),
    (f'{PY}/mcap/reindex_test_bags/multiple_files', 3177, 3177),
    (f'{PY}/mcap/talker', 20, 20),
    (f'{PY}/mcap/wbag', 6074, 6074),
    (f'{PY}/sqlite3/convert_a', 150, 0),
    (f'{PY}/sqlite3/convert_b', 75, 0),
    (f'{PY}/sqlite3/reindex_test_bags/multiple_files', 3177, 3177),
    (f'{PY}/sqlite3/talker', 20, 10),  # its definition of rcl_interfaces/msg/Log is a dummy
    (f'{PY}/sqlite3/wbag', 6074, 6074),
    (f'{TRANSPORT}/mcap/rewriter_a', 150, 50),
    (f'{TRANSPORT}/mcap/rewriter_b', 75, 50),
    (f'{TRANSPORT}/mcap/test_bag_for_seek', 5, 0),
    (f'{TRANSPORT}/sqlite3/rewriter_a', 150, 0),
    (f'{TRANSPORT}/sqlite3/rewriter_b', 75, 0),
    (f'{TRANSPORT}/sqlite3/test_bag_for_seek', 5, 0),
]


def decoded_or_refused(reader, topic):
    """Return how many messages of a topic can be decoded; all, or none with a clear reason."""
    try:
        return len(list(reader.messages([topic])))
    except (BagTypeError, BagDataError) as error:
        reason = str(error)
    assert reader.connections[topic].type in reason
    return 0


@pytest.mark.parametrize(('bag', 'count', 'decodable'), SAMPLES)
def test_bags_of_rosbag2_are_read_to_the_last_message(data, bag, count, decodable):
    with BagReader(data / 'rosbag2' / bag) as reader:
        assert reader.message_count == count
        raw = list(reader.messages(raw=True))
        assert len(raw) == count
        assert [m.log_time for m in raw] == sorted(m.log_time for m in raw)
        if count:
            assert (reader.start, reader.stop) == (raw[0].log_time, raw[-1].log_time)
        assert sum(decoded_or_refused(reader, topic) for topic in reader.connections) == decodable


@pytest.mark.parametrize('bag', [f'{PY}/mcap/talker', f'{PY}/mcap/convert_a'])
def test_bags_that_rosbags_reads_as_empty(data, bag):
    """The trap that this reader exists for; should rosbags mend it, it can be dropped here."""
    with rosbags.rosbag2.Reader(data / 'rosbag2' / bag) as other:
        assert sum(1 for _ in other.messages()) == 0 < other.message_count
    with BagReader(data / 'rosbag2' / bag) as reader:
        assert len(list(reader.messages(raw=True))) == reader.message_count > 0


def test_messages_come_back_as_written(small_bag):
    with BagReader(small_bag) as reader:
        assert (reader.start, reader.stop) == (SECOND, 300 * SECOND)
        found = list(reader.messages())
        assert len(found) == 400
        first = found[0]
        assert first[:3] == ('/mill/temperatures', 'fuzzycnc_msgs/msg/Temperatures', SECOND)
        assert first.message.sensor == ['n0', 'n1']
        np.testing.assert_array_equal(first.message.temperature, [20.0, 21.0])
        raw = list(reader.messages(raw=True))
        assert [serialize(m.message) for m in found] == [m.message for m in raw]


def test_topics_and_times_select(small_bag):
    with BagReader(small_bag) as reader:
        some = list(reader.messages(['/mill/displacement'], 10 * SECOND, 20 * SECOND))
        assert [m.log_time // SECOND for m in some] == [10, 13, 16, 19]
        with pytest.raises(BagTopicError, match=r'/mill/temperatures'):
            next(reader.messages(['/nothing']))


def test_order_is_log_time_then_file_order(make_bag, new):
    times = [5, 3, 3, 9, 1, 9, 9, 2] * 50
    messages = [
        ('/t', new.temperatures(number), log_time) for number, log_time in enumerate(times)
    ]
    with BagReader(make_bag(messages, chunk_size=512)) as reader:
        found = [(m.log_time, m.message.header.stamp.nanosec) for m in reader.messages()]
    assert found == sorted((log_time, number) for number, log_time in enumerate(times))


def test_require_lists_what_is_there(small_bag):
    with BagReader(small_bag) as reader:
        reader.require(['/mill/temperatures'])
        reader.require({'/mill/temperatures': 'fuzzycnc_msgs/msg/Temperatures'})
        with pytest.raises(BagTopicError, match=r'/x but the bag has .*temperatures \(300\)'):
            reader.require(['/x'])
        with pytest.raises(BagTopicError, match=r'to be std_msgs/msg/Bool'):
            reader.require({'/mill/temperatures': 'std_msgs/msg/Bool'})


def test_empty_bag_says_so(data):
    with BagReader(data / 'rosbag2/ros2bag/test/resources/empty_bag') as reader:
        with pytest.raises(BagTopicError, match=r'no messages at all'):
            reader.require(['/rosout'])


# Bags that contradict themselves


def replace_in_metadata(bag, old, new):
    path = bag / 'metadata.yaml'
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_metadata_that_promises_more_is_refused(small_bag):
    replace_in_metadata(small_bag, 'message_count: 300', 'message_count: 301')
    with pytest.raises(BagCountError, match=r'expected 301 messages on /mill/temperatures.*300'):
        BagReader(small_bag)
    with BagReader(small_bag, strict=False) as reader:
        assert len(list(reader.messages(raw=True))) == 400
        assert '301' in reader.problems[0]


@pytest.mark.parametrize(
    ('old', 'new', 'told'),
    [
        (r'^  message_count: \d+', '  message_count: 7', '7 messages in all but'),
        (r'^    nanoseconds: \d+', '    nanoseconds: 5', '0.000000005 s as the duration of all'),
        (
            r'^    nanoseconds_since_epoch: \d+',
            '    nanoseconds_since_epoch: 5',
            '0.000000005 s as the beginning of all',
        ),
        (r'^    message_count: \d+(?=\n  custom)', '    message_count: 8', '8 messages in bag_0'),
        (
            r'^      nanoseconds: \d+',
            '      nanoseconds: 6',
            's as the duration of bag_0.mcap',
        ),
        ('storage_identifier: mcap', 'storage_identifier: sqlite3', 'says sqlite3 as storage but'),
        ("compression_format: ''", 'compression_format: zstd', 'says zstd as compression of'),
        ("compression_mode: ''", 'compression_mode: FILE', 'says file as compression of files'),
        (
            'type: fuzzycnc_msgs/msg/Temperatures',
            'type: std_msgs/msg/String',
            'std_msgs/msg/String on /mill/temperatures but .* hold fuzzycnc_msgs/msg/Temperatures',
        ),
    ],
)
def test_metadata_whose_facts_are_wrong_is_told(small_bag, fuzzycnc, old, new, told):
    file = small_bag / 'metadata.yaml'
    text = file.read_text(encoding='utf-8')
    with BagReader(small_bag) as reader:
        assert not reader.problems
    changed, count = re.subn(old, new, text, count=1, flags=re.MULTILINE)
    assert count == 1
    file.write_text(changed, encoding='utf-8')
    with BagReader(small_bag) as reader:
        assert len(list(reader.messages())) == reader.message_count
        (problem,) = reader.problems
    assert re.search(told, problem)
    assert f'problem: {problem[:40]}' in fuzzycnc('info', small_bag).out


def test_metadata_that_hides_a_topic_is_refused(small_bag):
    replace_in_metadata(small_bag, 'name: /mill/displacement', 'name: /mill/other')
    with pytest.raises(BagCountError, match=r'messages on /mill/'):
        BagReader(small_bag)


def test_index_that_promises_more_is_refused_at_the_end(small_bag):
    """An index that states one message too many, its own checksum put right."""
    file = small_bag / 'bag_0.mcap'
    content = bytearray(file.read_bytes())
    at = content.rindex(struct.pack('<HQ', 1, 300)) + 2
    content[at : at + 8] = struct.pack('<Q', 301)
    footer = len(content) - len(MAGIC) - 20
    start = struct.unpack_from('<Q', content, footer)[0]
    struct.pack_into('<I', content, footer + 16, zlib.crc32(content[start : footer + 16]))
    file.write_bytes(content)
    (small_bag / 'metadata.yaml').unlink()
    with BagReader(small_bag) as reader:
        assert reader.message_count == 401
        seen = []
        with pytest.raises(BagCountError, match=r'promises but read 300'):
            seen.extend(reader.messages(raw=True))
        assert len(seen) == 400, 'the error comes after all that there is'
    with BagReader(small_bag, strict=False) as reader:
        assert len(list(reader.messages(raw=True))) == 400
        assert any('promises but read 300' in problem for problem in reader.problems)


def test_storage_file_that_metadata_hides_is_refused(small_bag):
    shutil.copy(small_bag / 'bag_0.mcap', small_bag / 'bag_1.mcap')
    with pytest.raises(BagCountError, match=r'found bag_1.mcap beside them'):
        BagReader(small_bag)


def test_metadata_that_the_recorder_did_not_finish(small_bag):
    """Killed after the file was closed and before metadata.yaml was: nothing is lost."""
    replace_in_metadata(small_bag, 'fuzzycnc_state: closed', 'fuzzycnc_state: recording')
    replace_in_metadata(small_bag, 'message_count: 300', 'message_count: 0')
    with BagReader(small_bag) as reader:
        assert len(list(reader.messages(raw=True))) == 400
        assert 'did not finish' in reader.problems[0]


def test_wrong_checksum_of_the_index_is_refused(small_bag):
    file = small_bag / 'bag_0.mcap'
    content = bytearray(file.read_bytes())
    content[content.rindex(struct.pack('<HQ', 1, 300)) + 2] ^= 1
    file.write_bytes(content)
    with pytest.raises(BagError, match=r'checksum of the index|expected 300 messages'):
        BagReader(small_bag)


def test_damaged_chunk_is_refused(small_bag):
    file = small_bag / 'bag_0.mcap'
    content = bytearray(file.read_bytes())
    with McapFile(file) as mcap:
        chunk = mcap.chunks[3]
    content[chunk.offset + chunk.length // 2] ^= 0xFF
    file.write_bytes(content)
    with BagReader(small_bag) as reader:
        with pytest.raises(BagFormatError, match=r'damaged.*info --repair'):
            list(reader.messages(raw=True))
    with BagReader(small_bag, strict=False) as reader:
        assert 0 < len(list(reader.messages(raw=True))) < 400
        assert any('damaged' in problem for problem in reader.problems)


# Hostile files


@pytest.mark.parametrize(
    'name', ['../secret.mcap', '/etc/passwd', 'a/../../secret.mcap', 'link.mcap', 'gone.mcap']
)
def test_files_outside_of_the_bag_are_refused(small_bag, tmp_path, name):
    shutil.copy(small_bag / 'bag_0.mcap', tmp_path / 'secret.mcap')
    (small_bag / 'link.mcap').symlink_to(tmp_path / 'secret.mcap')
    replace_in_metadata(small_bag, '- bag_0.mcap', f'- {name}')
    reason = {
        'link.mcap': 'inside of the bag but .* leads to',
        'gone.mcap': 'expected the storage file',
    }.get(name, 'inside of the bag but metadata.yaml names')
    with pytest.raises(BagFormatError, match=reason):
        BagReader(small_bag)


def test_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / 'pipe.mcap')
    with pytest.raises(BagFormatError, match=r'regular file'):
        BagReader(tmp_path / 'pipe.mcap')


@pytest.mark.parametrize(
    ('content', 'complaint'),
    [
        ('', 'entries of rosbag2'),
        ('a: [', 'expected YAML'),
        ('{' * 100000, 'expected YAML'),
        ('rosbag2_bagfile_information: {version: 99}', 'version 9 or older'),
        ('rosbag2_bagfile_information: {version: 9}', 'missing or wrong'),
        ('!!python/object/apply:os.system [true]', 'expected YAML'),
        (' ' * 9_000_000, 'at most'),
    ],
)
def test_hostile_metadata_is_refused(small_bag, content, complaint):
    (small_bag / 'metadata.yaml').write_text(content)
    with pytest.raises(BagFormatError, match=complaint):
        BagReader(small_bag)


@pytest.mark.parametrize(
    ('name', 'content', 'complaint'),
    [
        ('a.mcap', b'', 'empty'),
        ('a.mcap', b'#ROSBAG V2.0\n' * 3, 'first bytes'),
        ('a.mcap', MAGIC, 'truncated at byte 8'),
        ('a.mcap', MAGIC + b'\x06' + b'\xff' * 8, 'truncated at byte 8'),
        ('a.db3', b'no database' * 100, 'sqlite3 bag'),
        ('a.bag', b'#ROSBAG V2.0\n', 'ros2 bag convert'),
        ('a.csv', b't,t1\n', 'fuzzycnc import-csv'),
        ('a.json', b'{}', 'give it as the model'),
    ],
)
def test_no_bag_is_refused(tmp_path, name, content, complaint):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BagFormatError, match=complaint):
        BagReader(tmp_path / name)


def test_missing_bag_is_refused(tmp_path):
    with pytest.raises(BagFormatError, match=r'nothing is there'):
        BagReader(tmp_path / 'none')
    with pytest.raises(BagFormatError, match=r'neither'):
        BagReader(tmp_path)


def one_chunk(path, stated_size, data):
    """Write an MCAP file whose only chunk states any size."""
    head = struct.pack('<QQQI', 0, 0, stated_size, 0) + struct.pack('<I', 4) + b'zstd'
    body = head + struct.pack('<Q', len(data)) + data
    records = [
        b'\x01' + struct.pack('<Q', 8) + bytes(8),
        b'\x06' + struct.pack('<Q', len(body)) + body,
        b'\x0f' + struct.pack('<Q', 4) + bytes(4),
        b'\x02' + struct.pack('<Q', 20) + bytes(20),
    ]
    path.write_bytes(MAGIC + b''.join(records) + MAGIC)


@pytest.mark.parametrize(
    ('stated', 'real', 'complaint'),
    [
        (2**40, 10, 'at most'),
        (2**63, 10, 'at most'),
        (100, 50_000_000, 'states 50000000 bytes'),
        (100, 50, 'states 50 bytes'),
    ],
)
def test_decompression_bomb_is_refused(tmp_path, stated, real, complaint):
    one_chunk(tmp_path / 'a.mcap', stated, zstandard.compress(bytes(real)))
    with pytest.raises(BagFormatError, match=complaint):
        BagReader(tmp_path / 'a.mcap')


def test_bomb_without_stated_size_is_refused(tmp_path):
    compressor = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    data = compressor.compress(bytes(50_000_000)) + compressor.flush()
    one_chunk(tmp_path / 'a.mcap', 100, data)
    with pytest.raises(BagFormatError, match=r'decompressed|found'):
        BagReader(tmp_path / 'a.mcap')


def test_one_chunk_too_large_is_no_overlap(tmp_path):
    """130 MiB in 4 kB, as its head and its index say."""
    path = tmp_path / 'a.mcap'
    with open(path, 'wb') as file:
        writer = mcap.writer.Writer(file, chunk_size=1 << 30)
        writer.start('ros2', '')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        writer.add_message(writer.register_channel('/said', 'cdr', schema), 0, bytes(130 << 20), 0)
        writer.finish()
    with BagReader(path) as reader, pytest.raises(BagFormatError, match='its head states 1363'):
        list(reader.raw_messages())


@pytest.mark.parametrize('method', ['lz4', 'zstd', 'none'])
def test_chunks_of_other_writers_are_read_however_they_are_compressed(tmp_path, method):
    path = tmp_path / 'a.mcap'
    compression = mcap.writer.CompressionType[method.upper()]
    with open(path, 'wb') as file:
        writer = mcap.writer.Writer(file, compression=compression)
        writer.start('ros2', '')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        channel = writer.register_channel('/said', 'cdr', schema)
        for number in range(100):
            text = f'message {number}\0'.encode()
            payload = b'\0\1\0\0' + struct.pack('<I', len(text)) + text
            writer.add_message(channel, number * SECOND, payload, number * SECOND)
        writer.finish()
    with open(path, 'rb') as file:
        chunks = mcap.reader.make_reader(file).get_summary().chunk_indexes
    assert {chunk.compression for chunk in chunks} == {method.replace('none', '')}
    with BagReader(path) as reader:
        said = [read.message.data for read in reader.messages()]
    assert said == [f'message {number}' for number in range(100)]


def test_messages_that_rosbag2_compressed_one_by_one_are_not_called_damaged(tmp_path, fuzzycnc):
    payload = b'\0\1\0\0' + struct.pack('<I', 5) + b'told\0'
    with BagWriter(tmp_path / 'bag', flush_interval=None) as writer:
        writer.add_topic('/said', 'std_msgs/msg/String')
        writer.write('/said', 1, 1, zstandard.compress(payload))
    with BagReader(tmp_path / 'bag') as reader:
        with pytest.raises(BagDataError, match='compressed by rosbag2 one by one; convert'):
            list(reader.messages())
    assert 'problem: ' in (told := fuzzycnc('info', tmp_path / 'bag').out)
    assert '1 messages are compressed by rosbag2 one by one' in ' '.join(told.split())


TOPICS = 'CREATE TABLE topics(id, name, type, serialization_format)'
MESSAGES = 'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)'


@pytest.mark.parametrize(
    ('statements', 'complaint'),
    [
        ([TOPICS], r'found no table messages'),
        ([MESSAGES.replace('timestamp', 'time'), TOPICS], r'no such column: timestamp'),
        ([TOPICS, MESSAGES, "INSERT INTO messages VALUES(1, 7, 0, x'00')"], r'topic number 7'),
        ([TOPICS, MESSAGES, "INSERT INTO messages VALUES(1, 1, 'now', x'00')"], r'whole numbers'),
        ([TOPICS, MESSAGES, 'INSERT INTO messages VALUES(1, 1, 0, NULL)'], r'whole numbers'),
        (
            [
                TOPICS,
                'CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id+1 '
                "FROM n) SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n",
            ],
            r'found no table messages',
        ),
    ],
)
def test_hostile_database_is_refused(tmp_path, statements, complaint):
    with closing(sqlite3.connect(tmp_path / 'a.db3')) as database, database:
        for statement in statements:
            database.execute(statement)
    with pytest.raises(BagFormatError, match=complaint):
        BagReader(tmp_path / 'a.db3')


@pytest.fixture(scope='module')
def intact(tmp_path_factory, new):
    path = tmp_path_factory.mktemp('intact') / 'bag'
    with BagWriter(path, flush_interval=None, chunk_size=512) as writer:
        writer.add_topic('/t', 'fuzzycnc_msgs/msg/Temperatures')
        for k in range(60):
            writer.write_message('/t', new.temperatures(k), k)
        writer.attach('a', 'b')
    return (path / 'bag_0.mcap').read_bytes()


@settings(max_examples=150, deadline=None)
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_any_truncation_is_reported(intact, tmp_path_factory, share):
    path = tmp_path_factory.getbasetemp() / 'torn.mcap'
    path.write_bytes(intact[: int(len(intact) * share)])
    with pytest.raises(BagFormatError, match=r'truncated|empty|first bytes'):
        BagReader(path)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), max_size=4))
def test_any_damage_is_reported_or_harmless(intact, tmp_path_factory, flips):
    """Whatever bytes are flipped: a clear error, or all messages; nothing else, no crash."""
    content = bytearray(intact)
    for share, mask in flips:
        content[int(len(content) * share)] ^= mask
    path = tmp_path_factory.getbasetemp() / 'damaged.mcap'
    path.write_bytes(content)
    try:
        with BagReader(path) as reader:
            outcome = len(list(reader.messages(raw=True)))
            reader.attachments()
    except BagError as error:
        outcome = str(path) in str(error)
    assert outcome in (60, True)


# Versions


def rewrite_definition(bag, tmp_path, version, change):
    """Copy a bag, stating another message-set version and other definitions."""
    target = tmp_path / 'old'
    with (
        BagReader(bag) as reader,
        BagWriter(target, flush_interval=None, message_set=version) as writer,
    ):
        for topic, connection in reader.connections.items():
            writer.add_topic(topic, connection.type, definition=change(connection.definition))
        for message in reader.messages(raw=True):
            writer.write(message.topic, message.log_time, message.log_time, message.message)
    return target


def test_bag_of_a_newer_message_set_is_refused(small_bag, tmp_path):
    newer = rewrite_definition(small_bag, tmp_path, MESSAGE_SET + 1, str)
    refused = f'expected message set {MESSAGE_SET} or older but found {MESSAGE_SET + 1}'
    with pytest.raises(BagVersionError, match=refused):
        BagReader(newer)


def test_other_definition_without_upgrader_is_refused(small_bag, tmp_path):
    old = rewrite_definition(
        small_bag, tmp_path, 0, lambda text: text.replace('string[] sensor ', 'string[] name ')
    )
    with BagReader(old) as reader:
        assert reader.message_set == 0
        assert len(list(reader.messages(raw=True))) == 400
        with pytest.raises(BagVersionError, match=r'no upgrader'):
            list(reader.messages())
        assert len(list(reader.messages(['/mill/displacement']))) == 100


def test_upgrader_brings_old_messages_to_the_current_set(small_bag, tmp_path, new):
    old = rewrite_definition(
        small_bag, tmp_path, 0, lambda text: text.replace('string[] sensor ', 'string[] name ')
    )

    def name_becomes_sensor(message):
        stamp = message.header.stamp
        return new.temperatures(
            stamp.sec * SECOND + stamp.nanosec, message.temperature, message.name, message.status
        )

    upgraders = {('fuzzycnc_msgs/msg/Temperatures', 0): name_becomes_sensor}
    with BagReader(old, upgraders=upgraders) as reader, BagReader(small_bag) as current:
        found = [serialize(m.message) for m in reader.messages()]
        assert found == [m.message for m in current.messages(raw=True)]


def test_patterns_of_before_jumps_are_stitched_throughout(tmp_path):
    """Kinds were added to the message without a change of its layout."""
    with PublishedBag(tmp_path / 'new') as bag:
        bag('stitch_pattern', pattern_bench.pattern())
    kept = re.compile(r'^uint8 KIND_(?!LINE|ARC).*\n', re.MULTILINE)
    old = rewrite_definition(tmp_path / 'new', tmp_path, 2, lambda text: kept.sub('', text))
    with BagReader(old) as reader:
        assert 'KIND_JUMP' not in reader.connections['/mill/stitch_pattern'].definition
        (found,) = [decode(StitchPattern, item.message) for item in reader.messages()]
    assert set(found.kind.tolist()) == {PrimitiveKind.LINE}


GOLDEN = Path(__file__).parents[2] / 'bags' / 'mill_warm_up'
"""A run that was recorded with message set 1."""


def without_version(bag, target):
    """Copy a bag as a recorder writes it that knows no message sets."""
    with BagReader(bag) as reader, target.open('wb') as stream:
        writer = mcap.writer.Writer(stream)
        writer.start(profile='ros2', library='another')
        channels = {}
        for topic, found in reader.connections.items():
            schema = writer.register_schema(found.type, 'ros2msg', found.definition.encode())
            channels[topic] = writer.register_channel(topic, 'cdr', schema)
        for item in reader.messages(raw=True):
            at = item.log_time
            writer.add_message(channels[item.topic], at, item.message, at)
        writer.finish()
    return target


@pytest.mark.parametrize('stated', [True, False])
def test_a_displacement_of_set_1_was_measured_at_the_reference_position(tmp_path, stated):
    bag = GOLDEN if stated else without_version(GOLDEN, tmp_path / 'bare.mcap')
    with BagReader(bag) as reader:
        assert reader.message_set == (1 if stated else MESSAGE_SET)
        found = [decode(Displacement, m.message) for m in reader.messages(['/mill/displacement'])]
        assert len(found) == 60
        assert all(item.displacement.shape == (2,) for item in found)
        assert all(np.isnan(item.position).all() for item in found)
        assert max(np.abs(item.displacement).max() for item in found) > 5e-6
        sent = list(playback.messages(reader, playback.played_topics(reader, reader.connections)))
    played = [item.payload for item in sent if item.topic == '/mill/displacement']
    again = [decode(Displacement, deserialize(raw, Displacement.TYPE)) for raw in played]
    assert [item.stamp for item in again] == [item.stamp for item in found]
    assert all(np.isnan(item.position).all() for item in again)
    with BagReader(bag) as reader:
        states = [
            decode(MachineState, m.message) for m in reader.messages(['/mill/machine_state'])
        ]
    assert states
    with BagReader(bag) as reader:
        errors = [
            decode(ThermalError, m.message) for m in reader.messages(['/mill/thermal_error'])
        ]
        told = [
            decode(CompensationApplied, m.message)
            for m in reader.messages(['/mill/compensation_applied'])
        ]
    assert len(errors) == 60
    assert all(np.isnan(item.slope).all() and len(item.slope) == 2 for item in errors)
    assert all(np.isnan(item.reference_position).all() for item in errors)
    assert told
    assert not any(item.slope.any() for item in told)
    assert all(state.coolant == 0 and np.isnan(state.travel).all() for state in states)


def test_a_displacement_that_no_set_has_had_is_refused(small_bag, tmp_path):
    def named_otherwise(text):
        return text.replace('float64[] displacement ', 'float64[] deviation ')

    with BagReader(rewrite_definition(small_bag, tmp_path, 1, named_otherwise)) as reader:
        with pytest.raises(BagVersionError, match=r'message set 1\) defines it otherwise'):
            list(reader.messages(['/mill/displacement']))


def test_a_version_far_below_the_first_keeps_nobody_busy(small_bag, tmp_path):
    old = rewrite_definition(small_bag, tmp_path, -(10**15), str)
    with BagReader(old) as reader:
        assert len(list(reader.messages())) == 400


def test_definition_without_comments_is_the_same_type(small_bag, tmp_path):
    def bare(text):
        return '\n'.join(line.split('#')[0] for line in text.splitlines()) + '\n'

    old = rewrite_definition(small_bag, tmp_path, 1, bare)
    with BagReader(old) as reader:
        assert len(list(reader.messages())) == 400


def test_truncated_bag_that_claims_to_be_closed(small_bag):
    file = small_bag / 'bag_0.mcap'
    file.write_bytes(file.read_bytes()[:-500])
    with pytest.raises(BagTruncatedError, match=r'cut off or damaged.*info --repair'):
        BagReader(small_bag)
