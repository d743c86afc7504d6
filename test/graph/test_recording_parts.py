# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The recorder node and its commands with parts, a budget, a disk without room and shipping."""

import json

import pytest
from diagnostic_msgs.msg import DiagnosticArray

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.bags.metadata import storage_files
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.replay.replay import replay

pytestmark = pytest.mark.ros

NODES = 'temperature_acquisition'


@pytest.mark.slow
def test_run_in_parts(command, tmp_path):
    """A lock-step run, an hour of machine time in each part, shipped; replayed as one bag."""
    bag, archive = tmp_path / 'bag', tmp_path / 'archive'
    running = command(
        *('up', '--simulate', 'T2', '--lockstep', '--nodes', NODES, '--record', bag),
        *('--split-duration', '1h', '--ship', archive, '--json', tmp_path / 'outcome.json'),
    )
    assert running.wait() == 0, running.output
    parts = storage_files(bag)
    assert len(parts) > 2
    assert json.loads((tmp_path / 'outcome.json').read_text())['lacking'] == []
    shipped = json.loads((bag / 'shipped.json').read_text())
    assert [entry['part'] for entry in shipped] == [part.name for part in parts]
    assert topic_hashes(archive / 'bag') == topic_hashes(bag)
    assert replay(bag).identical
    for part in parts:  # each begins with the node's configuration
        with BagReader(part) as reader:
            latched = list(reader.messages(['/mill/node_configuration']))
            (own,) = (stored for stored in latched if stored.message.node == NODES)
            first_output = next(iter(reader.messages(['/mill/temperatures'])))
            assert own.log_time <= first_output.log_time


def accounted_for(item):
    """Whether what is not equal is due to a cut: its state, or itself, lies in another part."""
    beyond_the_end = (
        item.first_difference.startswith('not recorded') and item.identical == item.recorded
    )
    return item.equal or 'began before the bag' in item.not_recomputed or beyond_the_end


@pytest.mark.slow
def test_any_part_of_a_budgeted_run_is_replayed_from_its_head_or_says_what_is_not(
    command, model_file, tmp_path
):
    """The oldest parts are deleted here, but for their copies in the archive."""
    bag, archive = tmp_path / 'bag', tmp_path / 'archive'
    running = command(
        *('up', '--simulate', 'T2', '--lockstep', '--model', model_file, '--autostart'),
        *('--record', bag, '--split-size', '600kB', '--budget', '1.5MB', '--ship', archive),
    )
    assert running.wait() == 0, running.output
    kept, parts = storage_files(bag), storage_files(archive / 'bag')
    assert 1 < len(kept) < len(parts)
    first, *later = parts
    for cut in (bag, *later):
        report = replay(cut)
        found = {item.topic: item for item in report.topics}
        error = found['/mill/thermal_error']
        assert error.recorded - 1 <= error.identical > 2, cut  # a cut may part it from its cause
        assert not report.identical, cut
        assert all(accounted_for(item) for item in report.topics), (cut, report.topics)
        told = command('replay', cut)
        assert told.wait() == 1
        assert 'begins in the middle of a recording' in told.output
    assert all(accounted_for(item) for item in replay(first).topics)


def test_disk_without_room(graph, observer, tmp_path):
    """No disk has so much room: nothing is written, which is an alarm and no success."""
    alarms = []
    observer.node.create_subscription(DiagnosticArray, '/diagnostics', alarms.append, 10)
    bag = tmp_path / 'bag'
    recorder = graph.start('recorder', {'output': str(bag), 'free_min': 2**50})

    def alarmed():
        found = [status for message in alarms for status in message.status]
        return [s.message for s in found if s.level == b'\x02' and 'waits' in s.message]

    observer.until(alarmed, 'the alarm')
    assert 'make room, it then goes on by itself' in alarmed()[0]
    graph.stop()
    assert 'less than free_min' in recorder.output
    with BagReader(bag) as reader:
        assert reader.message_count == 0


def test_budget_without_parts_is_refused(command, tmp_path):
    running = command('record', '--out', tmp_path / 'bag', '--budget', '100MB')
    assert running.wait() != 0
    assert 'expected --split-size or --split-duration, too' in running.output
    assert not (tmp_path / 'bag').exists()


def test_secret_in_the_place_is_refused(graph, tmp_path):
    recorder = graph.start(
        'recorder', {'output': str(tmp_path / 'bag'), 'ship': 'sftp://mill:s3same@host/a'}
    )
    assert recorder.wait() != 0
    assert 'expected a URL without a password' in recorder.output
    assert 's3same' not in recorder.output
    assert not (tmp_path / 'bag').exists()
