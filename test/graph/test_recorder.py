# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The recorder killed, and the recorder stopped for a while."""

import json
import signal
import sys
import time

import pytest

from fuzzycnc_ros.bags.errors import BagTruncatedError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.components.records import SECOND, MachineState

pytestmark = [pytest.mark.ros, pytest.mark.slow]

TOPICS = 5
TRAFFIC = """
import rclpy, sys
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


def test_killed_recorder_loses_at_most_the_last_second(graph, observer, tmp_path):
    """SIGKILL after 10 s of traffic: the first 9 s of every topic are in the repaired bag."""
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
    begun = time.monotonic()
    observer.until(lambda: time.monotonic() - begun > 10.0, 'ten seconds of traffic', 20.0)
    graph.kill(recorder)
    killed = time.time_ns()

    with pytest.raises(BagTruncatedError, match='its recorder was killed'):
        BagReader(bag)
    report = repair(bag, tmp_path / 'repaired')
    assert report.damage
    assert all(text in str(report) for text in ('messages kept', 'lost'))
    with BagReader(tmp_path / 'repaired') as reader:
        assert set(names) <= set(reader.connections)
        for name in names:
            stamps = [message.log_time for message in reader.messages([name])]
            assert (killed - stamps[-1]) / SECOND < 1.0
            # The tenth second may be lost, nothing of the first nine.
            first_nine = [s for s in stamps if s < killed - SECOND]
            assert (first_nine[-1] - first_nine[0]) / SECOND > 8.0
            gaps = reader_gaps(reader, name)
            assert gaps == 0, f'{name}: {gaps} messages missing inside'


def reader_gaps(reader, name):
    """Return how many of the 50 messages a second are missing before the end."""
    stamps = [m.message.stamp for m in reader.messages([name])]
    counted = len(stamps)
    span = stamps[-1].sec - stamps[0].sec + 1e-9 * (stamps[-1].nanosec - stamps[0].nanosec)
    # The timer of a loaded computer skips beats, but then on all topics alike.
    other = next(topic for topic in reader.connections if topic != name)
    beats = [m.message.stamp for m in reader.messages([other])]
    common = [s for s in beats if stamps[0].sec <= s.sec and span]
    return max(0, min(len(common), len(beats)) - counted - 1)


def test_stopped_recorder_loses_nothing(graph, observer, model_file, tmp_path):
    """SIGSTOP for 2 s during 20,000 lock-step ticks of the whole graph."""
    bag = tmp_path / 'bag'
    states = observer.records('machine_state', MachineState)
    nodes = graph.start_shift(model_file, bag=bag, duties=('T2',), tick_period=0.6)
    observer.until(lambda: len(states) > 2000, '2000 ticks', 120.0)
    begun = time.monotonic()
    nodes['recorder'].send(signal.SIGSTOP)
    observer.until(lambda: time.monotonic() - begun > 2.0, 'two seconds')
    nodes['recorder'].send(signal.SIGCONT)
    machine = nodes['simulated_machine']
    assert observer.until_ended(machine) == 0
    assert machine.outcome == {'ticks': 20_000, 'degraded': False, 'lost': [], 'missed': 0}
    graph.stop()
    with BagReader(bag) as reader:
        counted = json.loads(reader.attachments()['recording.json'].data)['topics']
        assert {name: item['missing'] + item['dropped'] for name, item in counted.items()} == (
            dict.fromkeys(counted, 0)
        )
        for name in ('machine_state', 'compensation_applied', 'sensor_readings'):
            assert reader.connections[f'/mill/{name}'].message_count == 20_000
        for name in ('temperatures', 'thermal_error', 'predictor_state'):
            assert reader.connections[f'/mill/{name}'].message_count == 200
