# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What runs as a service tells its manager when it is up, and that it lives."""

import os
import re
import signal
import sys

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from managers import Manager
from processes import wait_for

pytestmark = [pytest.mark.ros, pytest.mark.slow]

NODES = ('temperature_acquisition', 'compensator')
COMMAND = (sys.executable, '-m', 'fuzzycnc_ros.cli.main')


@pytest.fixture
def manager(tmp_path, monkeypatch):
    """A manager of what the test starts, who waits for three signs of life a second."""
    with Manager(tmp_path) as found:
        for name, value in found.environment(watchdog=1.0).items():
            monkeypatch.setenv(name, value)
        yield found


def start(graph, folder, *words):
    folder.mkdir()
    return graph.launch(words[0], [*COMMAND, *words], folder)


def test_a_graph_is_ready_when_all_report_and_silent_when_a_node_hangs(
    graph, observer, manager, tmp_path
):
    reports = []

    def note(array):
        reports.extend(status.name for status in array.status)

    observer.node.create_subscription(DiagnosticArray, '/diagnostics', note, 100)
    up = start(graph, tmp_path / 'up', 'up', '--nodes', ','.join(NODES))
    wait_for(lambda: manager.has_heard('READY=1'), 'the graph is up')
    assert all(f'mill/{node} runs as process' in up.output for node in NODES)
    assert 'WATCHDOG=1' not in manager.all[: manager.all.index('READY=1')]
    wait_for(lambda: manager.has_heard('WATCHDOG=1'), 'a sign of life')

    manager.all.clear()  # a node may have been named before it had reported at all
    (hanging,) = map(int, re.findall(r'mill/compensator runs as process (\d+)', up.output))
    os.kill(hanging, signal.SIGSTOP)
    said = 'STATUS=nothing heard of mill/compensator'
    wait_for(lambda: manager.has_heard(said), 'the hanging node is named')
    manager.heard()
    reports.clear()

    def living_node_reported():
        observer.executor.spin_once(timeout_sec=0.1)
        return sum('temperature_acquisition: activity' in name for name in reports) >= 3

    wait_for(living_node_reported, 'three reports of the other node, one a second')
    assert manager.heard() == []

    os.kill(hanging, signal.SIGCONT)
    wait_for(lambda: 'WATCHDOG=1' in manager.heard(), 'a sign of life')
    wait_for(lambda: 'STATUS=all nodes report' in manager.since(said), 'all report again')
    assert up.interrupt(signal.SIGTERM) == 0
    assert manager.has_heard('STOPPING=1')
    assert 'READY=1' not in manager.all


def test_recording_and_page_tell_themselves_how_they_are(graph, manager, tmp_path):
    bag = tmp_path / 'bag'
    record = start(graph, tmp_path / 'record', 'record', '--out', str(bag))
    wait_for(lambda: manager.has_heard('READY=1'), 'the recording has begun')
    assert bag.is_dir()
    wait_for(lambda: manager.has_heard('WATCHDOG=1'), 'a sign of life')
    assert record.interrupt(signal.SIGTERM) == 0
    assert manager.has_heard('STOPPING=1')

    manager.all.clear()
    page = graph.start('dashboard', {'port': 0}, namespace='/')
    wait_for(lambda: manager.has_heard('READY=1'), 'the page is served')
    wait_for(lambda: manager.has_heard('WATCHDOG=1'), 'a sign of life')
    assert page.interrupt(signal.SIGTERM) == 0
    assert manager.has_heard('STOPPING=1')
