# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The recorder killed, and the recorder stopped for a while."""

import contextlib
import json
import shutil
import signal
import sys
import time

import pytest
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from fuzzycnc_ros.bags.errors import BagError, BagTruncatedError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.runtime.host import RecorderProgress
from fuzzycnc_ros.runtime.records import SECOND, MachineState

pytestmark = [pytest.mark.ros, pytest.mark.slow]

TOPICS = 5
TRAFFIC = """
import rclpy, sys
from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header
from rclpy.executors import ExternalShutdownException
rclpy.init(args=[sys.argv[0], '--ros-args', '-r', '__ns:=/mill'])
node = rclpy.create_node('traffic')
publishers = [node.create_publisher(Header, f'topic{k}', 2000) for k in range({topics})]
def publish():
    header = Header(stamp=node.get_clock().now().to_msg())
    for publisher in publishers:
        publisher.publish(header)
node.create_timer(0.02, publish)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
"""Publishes 50 times a second on each topic."""


def test_killed_recorder_keeps_what_it_has_written(graph, observer, tmp_path):
    """SIGKILL in the midst of traffic: all that was on the disk before is in the repaired bag.

    That messages get there within a second is shown where time can be driven, in test_writer.py.
    """
    bag = tmp_path / 'bag'
    recorder = graph.start('recorder', {'output': str(bag), 'topics': '^/mill/topic'})
    script = TRAFFIC.replace('{topics}', str(TOPICS))
    folder = tmp_path / 'traffic'
    folder.mkdir()
    graph.launch('traffic', [sys.executable, '-c', script], folder)
    names = [f'/mill/topic{k}' for k in range(TOPICS)]
    # The observer's own readers would slow the traffic down: it only looks at the graph.
    observer.until(
        lambda: all(observer.node.count_subscribers(name) == 1 for name in names),
        'the recorder reads every topic',
    )
    written = {}

    def eight_seconds_written():
        """The first 400 beats of every topic are on the disk, while the recorder goes on."""
        copy = tmp_path / f'copy{len(list(tmp_path.glob("copy*")))}'
        shutil.copytree(bag, copy)
        with contextlib.suppress(BagError):  # its end is torn, or it has hardly begun
            kept = repair(copy, copy / 'whole').topics
            written.update({name: kept[name].kept for name in names if name in kept})
        observer.spin_for(0.5)
        return len(written) == TOPICS and min(written.values()) >= 400

    observer.until(eight_seconds_written, '400 beats on the disk', 120.0)
    graph.kill(recorder)

    with pytest.raises(BagTruncatedError, match='its recorder was killed'):
        BagReader(bag)
    report = repair(bag, tmp_path / 'repaired')
    assert report.damage
    assert all(text in str(report) for text in ('messages kept', 'lost'))
    with BagReader(tmp_path / 'repaired') as reader:
        assert set(names) <= set(reader.connections)
        sent = {name: [beat(m.message) for m in reader.messages([name])] for name in names}
    for name in names:
        assert len(sent[name]) >= written[name] >= 400
        # Each beat goes to all topics: one that is missing between two others was lost.
        own = set(sent[name])
        beats = {stamp for stamps in sent.values() for stamp in stamps}
        assert [b for b in beats - own if min(own) < b < max(own)] == [], name


def beat(header):
    """Return when a message was sent [ns]."""
    return header.stamp.sec * SECOND + header.stamp.nanosec


def test_what_was_published_before_the_end_is_in_the_bag(graph, observer, tmp_path):
    """A recorder that is asked to end while messages wait for it takes them first."""
    bag = tmp_path / 'bag'
    said = observer.node.create_publisher(Header, '/mill/said', 500)
    recorder = graph.start('recorder', {'output': str(bag), 'topics': '^/mill/said'})
    observer.until(lambda: said.get_subscription_count() == 1, 'a recorder that listens')
    recorder.send(signal.SIGSTOP)
    for number in range(300):
        said.publish(Header(frame_id=str(number)))
    recorder.send(signal.SIGINT)
    recorder.send(signal.SIGCONT)
    assert observer.until_ended(recorder) == 0
    with BagReader(bag) as reader:
        assert [item.message.frame_id for item in reader.messages()] == [
            str(number) for number in range(300)
        ]


def test_what_comes_before_the_first_clock_is_told_and_kept(graph, observer, tmp_path):
    bag = tmp_path / 'bag'
    observer.watch_diagnostics()
    progress = observer.records('recorder/progress', RecorderProgress)
    said = observer.node.create_publisher(Header, '/mill/said', 500)
    clock = observer.node.create_publisher(Clock, '/clock', 10)
    recorder = graph.start(
        'recorder', {'output': str(bag), 'topics': '^/mill/said', 'use_sim_time': True}
    )
    observer.until(lambda: said.get_subscription_count() == 1, 'a recorder that listens')
    for number in range(2):
        said.publish(Header(frame_id=str(number)))
    observer.until(
        lambda: observer.told('mill/recorder: clock', 'in memory for the first machine time'),
        'people are told',
    )
    observer.until(clock.get_subscription_count, 'it reads the clock')

    def goes_on():
        clock.publish(Clock(clock=Time(sec=70)))
        said.publish(Header(frame_id='later'))
        return progress[-1].written > 2

    observer.until(goes_on, 'it writes them')
    recorder.send(signal.SIGINT)
    assert observer.until_ended(recorder) == 0
    with BagReader(bag) as reader:
        found = [(item.message.frame_id, item.log_time) for item in reader.messages()]
    assert found[:3] == [(text, 70 * SECOND) for text in ('0', '1', 'later')]


@pytest.mark.parametrize(
    ('ticks', 'period'), [(5000, 2.4), pytest.param(20_000, 0.6, marks=pytest.mark.qualify)]
)
def test_stopped_recorder_loses_nothing(graph, observer, model_file, tmp_path, ticks, period):
    """SIGSTOP for 2 s during lock-step ticks of the whole graph."""
    bag = tmp_path / 'bag'
    states = observer.records('machine_state', MachineState)
    nodes = graph.start_shift(model_file, bag=bag, duties=('T2',), tick_period=period)
    observer.until(lambda: len(states) > 0.1 * ticks, 'a tenth of the ticks')
    observer.forget('machine_state')
    begun = time.monotonic()
    nodes['recorder'].send(signal.SIGSTOP)
    observer.until(lambda: time.monotonic() - begun > 2.0, 'two seconds')
    nodes['recorder'].send(signal.SIGCONT)
    machine = nodes['simulated_machine']
    assert observer.until_ended(machine) == 0
    assert machine.outcome == {'ticks': ticks, 'degraded': False, 'lost': [], 'missed': 0}
    graph.stop()
    with BagReader(bag) as reader:
        counted = json.loads(reader.attachments()['recording.json'].data)['topics']
        assert {name: item['missing'] + item['dropped'] for name, item in counted.items()} == (
            dict.fromkeys(counted, 0)
        )
        for name in ('machine_state', 'compensation_applied', 'sensor_readings'):
            assert reader.connections[f'/mill/{name}'].message_count == ticks
        for name in ('temperatures', 'thermal_error'):
            assert reader.connections[f'/mill/{name}'].message_count == 200
        # A checkpoint goes with every valid prediction.
        errors = reader.messages(['/mill/thermal_error'])
        valid = [m.message.header.stamp.sec for m in errors if m.message.valid]
        states = reader.messages(['/mill/predictor_state'])
        assert [m.message.header.stamp.sec for m in states] == valid
        assert len(valid) > 190
