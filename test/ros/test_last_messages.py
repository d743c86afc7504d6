# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a node publishes just before it ends reaches its readers, even slow ones."""

import os
import signal
import subprocess
import sys

import pytest
from processes import HANG, said, start

pytestmark = pytest.mark.ros

NODES = """
import sys
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import String
from fuzzycnc_ros.ros import run

COUNT = 500

class Reader:
    exit_code, executor, done = 0, 'lean', False
    def __init__(self):
        self.node, self.count = Node('reader'), 0
        self.node.create_subscription(String, 'burst', self.take, COUNT)
    def start(self):
        print('reads', flush=True)
    def stop(self):
        print(self.count, flush=True)
    def take(self, message):
        self.count += 1
        self.done = self.count == COUNT

class Writer:
    exit_code, executor, done = 0, 'lean', False
    def __init__(self):
        self.node = Node('writer')
        self.publisher = self.node.create_publisher(String, 'burst', COUNT)
        self.timer = self.node.create_timer(0.02, self.look)
    def start(self):
        pass
    def stop(self):
        pass
    def look(self):
        if not self.publisher.get_subscription_count():
            return
        self.timer.cancel()
        print('matched', flush=True)
        sys.stdin.readline()
        for number in range(COUNT):
            self.publisher.publish(String(data=2000 * 'x'))
        print('sent', flush=True)
        self.done = sys.argv[2] == 'done'

def waits(publisher, timeout):
    if publisher.topic_name == '/burst':
        print('waits', flush=True)
    return wait(publisher, timeout)

wait, Publisher.wait_for_all_acked = Publisher.wait_for_all_acked, waits
run.DELIVERING, run.LETTING_GO = float(sys.argv[3]), 240
run.main({'reader': Reader, 'writer': Writer}[sys.argv[1]], sys.argv[:1])
"""


@pytest.fixture
def pair(domain, root):
    """Start a reader, and a writer that ends in one of two ways; yield both as they match."""
    path = os.pathsep.join([str(root), os.environ.get('PYTHONPATH', '')])
    environment = {**os.environ, 'PYTHONPATH': path, 'ROS_DOMAIN_ID': str(domain)}
    begun = []

    def begin(end, patience):
        for name in ('reader', 'writer'):
            line = [sys.executable, '-c', NODES, name, end, str(patience)]
            pipes = {'stdin': subprocess.PIPE, 'stdout': subprocess.PIPE}
            begun.append(start(line, env=environment, text=True, **pipes))
        reader, writer = begun
        assert said(reader) == 'reads\n'
        assert said(writer) == 'matched\n'
        reader.send_signal(signal.SIGSTOP)
        writer.stdin.write('\n')
        writer.stdin.flush()
        assert said(writer) == 'sent\n'
        if end == 'asked':
            writer.send_signal(signal.SIGTERM)
        assert said(writer) == 'waits\n'
        return reader, writer

    yield begin
    for process in begun:
        process.kill()
        process.communicate()


@pytest.mark.parametrize('end', ['done', 'asked'])
def test_a_node_that_ends_waits_for_what_it_has_published(pair, end):
    reader, writer = pair(end, HANG)
    reader.send_signal(signal.SIGCONT)
    assert writer.wait(HANG) == 0
    assert said(reader) == '500\n'
    assert reader.wait(HANG) == 0


def test_a_reader_that_stands_still_holds_no_end_up(pair):
    _, writer = pair('asked', 0.2)
    assert writer.wait(HANG) == 0
