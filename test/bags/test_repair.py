# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Repairing torn and damaged bags."""

import shutil

import pytest
from fuzzing import raw_bags as raw
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.bags.errors import BagExistsError, BagFormatError
from fuzzycnc_ros.bags.mcapfile import McapFile
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.bags.writer import BagWriter

TEMPERATURES = 'fuzzycnc_msgs/msg/Temperatures'


def raw_messages(path):
    with BagReader(path) as reader:
        return list(reader.messages(raw=True))


def test_repair_keeps_everything_of_a_sound_bag(small_bag):
    report = repair(small_bag)
    assert report.path == small_bag.parent / 'bag_repaired'
    assert report.damage == ()
    assert {t.lost for t in report.topics.values()} == {0}
    assert raw_messages(report.path) == raw_messages(small_bag)


def test_refusals(small_bag, tmp_path, data):
    with pytest.raises(BagExistsError, match=r'choose another'):
        repair(small_bag, small_bag)
    with pytest.raises(BagFormatError, match=r'nothing is there'):
        repair(tmp_path / 'none')
    (tmp_path / 'a.mcap').write_bytes(b'nothing of the kind')
    with pytest.raises(BagFormatError, match=r'nothing can be repaired'):
        repair(tmp_path / 'a.mcap')
    assert not (tmp_path / 'a_repaired').exists()
    with pytest.raises(BagFormatError, match=r'recover'):
        repair(data / 'rosbag2/rosbag2_py/test/resources/sqlite3/talker', tmp_path / 'out')


def test_damaged_chunk_is_left_out_and_counted(small_bag):
    file = small_bag / 'bag_0.mcap'
    whole = raw_messages(small_bag)
    with McapFile(file) as mcap:
        chunk = mcap.chunks[3]
        lost = mcap.topic_counts(chunk.counts)
    content = bytearray(file.read_bytes())
    content[chunk.offset + chunk.length // 2] ^= 0xFF
    file.write_bytes(content)
    report = repair(small_bag)
    assert sum(lost.values()) > 0
    assert {name: t.lost for name, t in report.topics.items()} == {
        name: lost[name] for name in report.topics
    }
    kept = raw_messages(report.path)
    assert len(kept) == 400 - sum(lost.values())
    assert set(kept) <= set(whole)
    assert 'damage' in str(report)
    assert f'lost: {lost["/mill/temperatures"]}' in str(report)


def test_missing_and_damaged_metadata_is_made_anew(small_bag):
    (small_bag / 'metadata.yaml').write_text('rosbag2: [')
    report = repair(small_bag, small_bag.parent / 'one')
    assert 'expected YAML' in report.damage[0]
    (small_bag / 'metadata.yaml').unlink()
    repair(small_bag, small_bag.parent / 'two')
    assert raw_messages(small_bag.parent / 'one') == raw_messages(small_bag.parent / 'two')
    assert len(raw_messages(small_bag.parent / 'one')) == 400


def test_split_bag_of_rosbag2_is_joined(data, tmp_path):
    source = data / 'rosbag2/rosbag2_py/test/resources/mcap/wbag'
    report = repair(source, tmp_path / 'out')
    assert raw_messages(tmp_path / 'out') == raw_messages(source)
    assert sum(t.kept for t in report.topics.values()) == 6074


def test_whole_messages_of_a_torn_chunk_are_salvaged(tmp_path, new):
    """Recorders of ROS itself write large chunks: what is whole in the torn one counts."""
    with BagWriter(
        tmp_path / 'bag', flush_interval=None, chunk_size=10**6, compression='none'
    ) as writer:
        writer.add_topic('/t', TEMPERATURES)
        for k in range(100):
            writer.write_message('/t', new.temperatures(k), k)
        file = writer.file
    with McapFile(file) as mcap:
        chunk = mcap.chunks[0]
    torn = tmp_path / 'torn.mcap'
    torn.write_bytes(file.read_bytes()[: chunk.offset + chunk.length // 2])
    report = repair(torn)
    assert 30 < report.topics['/t'].kept < 60
    assert report.topics['/t'].lost is None
    found = raw_messages(report.path)
    assert [m.log_time for m in found] == list(range(len(found)))


def test_a_damaged_announcement_hides_no_sound_one(tmp_path):
    chunk = raw.chunk(raw.channel(1, '/t') + raw.message(1, 2))
    file = raw.mcap(tmp_path / 'a.mcap', [raw.schema(), chunk, raw.channel(1, b'\xff')])
    report = repair(file)
    assert 'not in UTF-8' in report.damage[0]
    assert report.topics['/t'].kept == 1


def test_facts_and_attachments_survive(tmp_path, new):
    with BagWriter(tmp_path / 'bag', custom={'scenario': 'T2'}, message_set=0) as writer:
        writer.add_topic('/t', TEMPERATURES)
        writer.attach('model.json', '{}', 'application/json')
        writer.write_message('/t', new.temperatures(1), 1)
        writer.flush()
        shutil.copytree(tmp_path / 'bag', tmp_path / 'torn')
    (tmp_path / 'torn' / 'bag_0.mcap').rename(tmp_path / 'torn' / 'torn_0.mcap')
    report = repair(tmp_path / 'torn')
    with BagReader(report.path) as reader:
        assert reader.attachments()['model.json'].text == '{}'
        assert reader.metadata.custom['scenario'] == 'T2'
        assert reader.metadata.custom['repaired_from'] == 'torn'
        assert reader.message_set == 0
        assert reader.connections['/t'].profiles[0]['depth'] == 2000


@pytest.fixture(scope='module')
def intact(tmp_path_factory, new):
    path = tmp_path_factory.mktemp('intact') / 'bag'
    with BagWriter(path, flush_interval=None, chunk_size=512) as writer:
        writer.add_topic('/t', TEMPERATURES)
        for k in range(80):
            writer.write_message('/t', new.temperatures(k), k)
    file = path / 'bag_0.mcap'
    with McapFile(file) as mcap:
        return file.read_bytes(), mcap.chunks


@settings(max_examples=100, deadline=None)
@given(share=st.floats(0.0, 1.0))
def test_every_chunk_before_a_tear_survives(intact, tmp_path_factory, share):
    content, chunks = intact
    end = max(100, int(len(content) * share))
    folder = tmp_path_factory.mktemp('torn')
    (folder / 'torn.mcap').write_bytes(content[:end])
    report = repair(folder / 'torn.mcap')
    found = raw_messages(report.path)
    whole = [chunk for chunk in chunks if chunk.offset + chunk.length <= end]
    assert [m.log_time for m in found] == list(range(len(found)))
    assert len(found) >= sum(sum(chunk.counts.values()) for chunk in whole)
    assert report.stop == (found[-1].log_time if found else 0)
