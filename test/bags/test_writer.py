# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Writing bags: refusals, what rosbags and mcap see, a full disk, a kill."""

import resource
import subprocess
import sys
import tracemalloc
from pathlib import Path

import mcap.reader
import mcap.writer
import pytest
import rosbags.rosbag2
import yaml

from fuzzycnc_ros.bags.errors import (
    BagError,
    BagExistsError,
    BagTopicError,
    BagTruncatedError,
    BagTypeError,
    BagWriteError,
    MissingLibraryError,
)
from fuzzycnc_ros.bags.metadata import LATCHED, STREAM, Qos, parse_qos, qos_text
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.bags.typestore import message_type, serialize, type_hash
from fuzzycnc_ros.bags.writer import BagWriter

STRING = 'std_msgs/msg/String'
SECOND = 10**9


def test_existing_directory_is_refused_and_untouched(tmp_path):
    (tmp_path / 'bag').mkdir()
    with pytest.raises(BagExistsError, match=r'choose another name'):
        BagWriter(tmp_path / 'bag')
    assert list((tmp_path / 'bag').iterdir()) == []


def test_unwritable_place_is_refused(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagWriteError, match=r'file is a file; name another place'):
        BagWriter(tmp_path / 'file' / 'bag')


def test_mcap_that_is_too_old_is_refused(tmp_path, monkeypatch):
    monkeypatch.delattr(mcap.writer.Writer, 'flush')
    with pytest.raises(MissingLibraryError, match=r'mcap 1.5 or newer'):
        BagWriter(tmp_path / 'bag')
    assert not (tmp_path / 'bag').exists()


def chunks(path, count):
    """Write a bag with a chunk for each message; return its bytes."""
    with BagWriter(path, flush_interval=None) as writer:
        writer.add_topic('/a', STRING)
        payload = serialize(message_type(STRING)(data='x'))
        for number in range(count):
            writer.write('/a', number, number, payload)
            writer.flush()
    return writer.file.read_bytes()


def test_the_index_of_a_long_recording_is_not_kept_in_memory(tmp_path, monkeypatch):
    chunks(tmp_path / 'first', 10)  # libraries are loaded
    tracemalloc.start()
    try:
        with BagWriter(tmp_path / 'bag', flush_interval=None) as writer:
            writer.add_topic('/a', STRING)
            payload = serialize(message_type(STRING)(data='x'))
            before = tracemalloc.get_traced_memory()[0]
            for number in range(5000):
                writer.write('/a', number, number, payload)
                writer.flush()
            grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 100_000  # in a list it would be millions
    assert len(list((tmp_path / 'bag').iterdir())) == 2
    monkeypatch.setattr('fuzzycnc_ros.bags.writer._INDEX', 'what another version has')
    spilled = (tmp_path / 'first' / 'first_0.mcap').read_bytes()
    (tmp_path / 'other').mkdir()
    assert chunks(tmp_path / 'other' / 'first', 10) == spilled


def test_misuse_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r'expected zstd or none'):
        BagWriter(tmp_path / 'a', compression='gzip')
    assert not (tmp_path / 'a').exists()
    writer = BagWriter(tmp_path / 'bag')
    with pytest.raises(BagTopicError, match=r'call add_topic'):
        writer.write('/a', 0, 0, b'')
    with pytest.raises(BagTypeError, match=r'expected a message definition'):
        writer.add_topic('/a', 'no_msgs/msg/No')
    with pytest.raises(BagTopicError, match=r'topic name'):
        writer.add_topic('/a b', STRING)
    writer.add_topic('/a', STRING)
    with pytest.raises(BagTopicError, match=r'expected type'):
        writer.add_topic('/a', 'std_msgs/msg/Bool')
    for time in (-1, 2**63):
        with pytest.raises(BagError, match=r'2\^63'):
            writer.write('/a', time, 0, b'')
    assert writer.message_count == 0
    writer.close()
    writer.close()
    with pytest.raises(BagWriteError, match=r'closed'):
        writer.write('/a', 0, 0, b'')


@pytest.mark.parametrize('word', ['history', 'reliability', 'durability'])
def test_unknown_quality_of_service_is_refused(word):
    with pytest.raises(ValueError, match=f'{word}: expected'):
        Qos(**{word: 'perhaps'})


def test_rosbags_reads_every_message_and_fact(small_bag):
    with rosbags.rosbag2.Reader(small_bag) as reader:
        assert reader.message_count == 400
        assert sum(1 for _ in reader.messages()) == 400
        assert {c.digest for c in reader.connections} == {
            type_hash('fuzzycnc_msgs/msg/Temperatures'),
            type_hash('fuzzycnc_msgs/msg/Displacement'),
        }
        assert all('MSG: std_msgs/Header' in c.msgdef.data for c in reader.connections)
        (profile,) = reader.connections[0].ext.offered_qos_profiles
        assert (profile.depth, profile.durability.name) == (2000, 'VOLATILE')


def test_a_topic_of_which_no_profile_is_known_says_so_with_nothing():
    assert qos_text([]) == ''
    assert parse_qos(qos_text([])) == []


def test_file_is_what_rosbag2_writes(small_bag):
    assert {path.name for path in small_bag.iterdir()} == {'metadata.yaml', 'bag_0.mcap'}
    with (small_bag / 'bag_0.mcap').open('rb') as file:
        reader = mcap.reader.make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        assert summary.statistics.message_count == 400
        assert {c.compression for c in summary.chunk_indexes} == {'zstd'}
        assert {s.encoding for s in summary.schemas.values()} == {'ros2msg'}
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        assert sum(1 for _ in reader.iter_messages()) == 400
    assert records['fuzzycnc'] == {'message_set': '4'}
    stored = yaml.safe_load(records['rosbag2']['serialized_metadata'])
    assert (
        stored
        == yaml.safe_load((small_bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    )
    assert stored['version'] == 9
    assert stored['message_count'] == 400
    assert stored['starting_time'] == {'nanoseconds_since_epoch': SECOND}
    assert stored['duration'] == {'nanoseconds': 299 * SECOND}
    assert stored['relative_file_paths'] == ['bag_0.mcap']
    profile = stored['topics_with_message_count'][0]['topic_metadata']['offered_qos_profiles'][0]
    # The keys and words that the loader of rosbag2 asks for.
    assert profile == {
        'history': 'keep_last',
        'depth': 2000,
        'reliability': 'reliable',
        'durability': 'volatile',
        'deadline': {'sec': 9223372036, 'nsec': 854775807},
        'lifespan': {'sec': 9223372036, 'nsec': 854775807},
        'liveliness': 'automatic',
        'liveliness_lease_duration': {'sec': 9223372036, 'nsec': 854775807},
        'avoid_ros_namespace_conventions': False,
    }


def test_equal_messages_give_equal_bytes(make_bag, new):
    messages = [('/t', new.temperatures(k * SECOND), k * SECOND) for k in range(200)]
    one, two = (make_bag(messages, f'{part}/bag') / 'bag_0.mcap' for part in ('one', 'two'))
    assert one.stat().st_size > 1000
    assert one.read_bytes() == two.read_bytes()


def test_bag_without_messages_is_valid(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/a', STRING, LATCHED)
    with BagReader(tmp_path / 'bag') as reader:
        assert reader.message_count == 0
        assert reader.connections['/a'].profiles[0]['durability'] == 'transient_local'
        assert list(reader.messages()) == []
    with rosbags.rosbag2.Reader(tmp_path / 'bag') as other:
        assert other.message_count == 0


def test_attachments_come_back(tmp_path):
    with BagWriter(tmp_path / 'bag', custom={'scenario': 'T2'}) as writer:
        writer.attach('model.json', '{"a": "µm"}', 'application/json', 5)
        writer.add_topic('/a', STRING, STREAM)
        writer.write('/a', 1, 2, b'\x00\x01\x00\x00\x01\x00\x00\x00\x00', sequence=2**40 + 7)
        writer.attach('raw', bytes(range(256)))
    with BagReader(tmp_path / 'bag') as reader:
        found = reader.attachments()
        assert found['model.json'].text == '{"a": "µm"}'
        assert found['model.json'].media_type == 'application/json'
        assert found['raw'].data == bytes(range(256))
        assert reader.metadata.custom['scenario'] == 'T2'


def test_open_chunk_is_closed_by_time(tmp_path):
    now = 0.0
    writer = BagWriter(tmp_path / 'bag', flush_interval=0.5, clock=lambda: now)
    writer.add_topic('/a', STRING)
    empty = writer.file.stat().st_size
    payload = b'\x00\x01\x00\x00\x01\x00\x00\x00\x00'
    writer.write('/a', 1, 1, payload)
    now = 0.4
    writer.flush_if_due()
    assert writer.file.stat().st_size == empty
    now = 0.5
    writer.flush_if_due()
    flushed = writer.file.stat().st_size
    assert flushed > empty
    now = 5.0
    writer.flush_if_due()
    assert writer.file.stat().st_size == flushed, 'nothing waits, so nothing is written'
    writer.close()


def test_bag_being_written_says_so(tmp_path):
    writer = BagWriter(tmp_path / 'bag')
    with pytest.raises(BagTruncatedError, match=r'killed, or still writes'):
        BagReader(tmp_path / 'bag')
    writer.close()
    with BagReader(tmp_path / 'bag') as reader:
        assert reader.message_count == 0


def test_full_disk_is_one_error_and_keeps_what_was_written(tmp_path, new):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    writer = BagWriter(tmp_path / 'bag', chunk_size=4096, compression='none')
    writer.add_topic('/t', 'fuzzycnc_msgs/msg/Temperatures')
    payload = serialize(new.temperatures(0, range(50)))

    def fill():
        while True:
            writer.write('/t', writer.message_count, writer.message_count, payload)

    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, hard))
        with pytest.raises(BagWriteError, match=r'larger than allowed.*start a new bag') as caught:
            fill()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    written = writer.message_count
    with pytest.raises(BagWriteError) as again:
        writer.write('/t', written, written, payload)
    assert str(again.value) == str(caught.value)
    writer.close()
    assert writer.file.stat().st_size <= 200_000
    report = repair(tmp_path / 'bag', tmp_path / 'repaired')
    kept = report.topics['/t'].kept
    assert written - kept <= 4096 // len(payload) + 2, 'only the last chunk may be lost'
    with BagReader(tmp_path / 'repaired') as reader:
        assert [m.log_time for m in reader.messages(raw=True)] == list(range(kept))


WRITE_UNTIL_KILLED = """
import sys, time
from fuzzycnc_ros.bags.recorder import RecordingThread
from fuzzycnc_ros.bags.writer import BagWriter

k = 0
# Time passes with the messages, however fast they are written.
thread = RecordingThread(BagWriter(sys.argv[1], clock=lambda: k / 50))
topics = [f'/t{i}' for i in range(5)]
for topic in topics:
    thread.add_topic(topic, 'std_msgs/msg/UInt64')
while True:
    for topic in topics:
        payload = b'\\x00\\x01\\x00\\x00' + k.to_bytes(8, 'little')
        thread.put(topic, payload, k * 20_000_000, k * 20_000_000, k + 1)
    k += 1
    while thread.progress().written < 5 * k:
        time.sleep(0.0005)
    print(k, flush=True)
"""


def test_sigkill_loses_at_most_the_last_second(tmp_path, root):
    """50 Hz on five topics, killed without warning: less than 50 of each are lost."""
    bag = tmp_path / 'bag'
    process = subprocess.Popen(
        [sys.executable, '-c', WRITE_UNTIL_KILLED, str(bag)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=root,
    )
    last = ''
    for line in process.stdout:
        if line == '170\n':
            process.kill()
        if line.endswith('\n'):
            last = line
    process.stdout.close()
    process.wait()
    assert process.returncode == -9
    sent = int(last)
    assert sent >= 170
    with pytest.raises(BagTruncatedError, match=r'info --repair'):
        BagReader(bag)
    report = repair(bag)
    with BagReader(report.path) as reader:
        for topic in (f'/t{i}' for i in range(5)):
            found = list(reader.messages([topic]))
            assert [m.message.data for m in found] == list(range(len(found))), 'gap or disorder'
            assert sent - len(found) < 50
            assert report.topics[topic].kept == len(found)
    assert str(Path(report.path)) in str(report)
