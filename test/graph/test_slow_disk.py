# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A recorder whose disk takes nothing any more, beside a machine that is compensated."""

import json
import os
import signal
import sys

import numpy as np
import pytest
from processes import children

from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.ros.topics import message_class
from fuzzycnc_ros.runtime.host import RecorderProgress
from fuzzycnc_ros.runtime.records import CompensationApplied, MachineState

pytestmark = [pytest.mark.ros, pytest.mark.slow]

STUCK_DISK = """
import signal, threading
def stick(number, frame):
    from fuzzycnc_ros.bags.writer import Sink
    Sink.write = lambda self, data: threading.Event().wait()
signal.signal(signal.SIGUSR1, stick)
"""
"""Read by each Python at its start: lets the writes of a recorder hang, as on a lost share."""
RATE = 60.0
AT_WORK = 2e-6
"""Offset from which on compensation is at work [m]."""


def test_only_the_recording_suffers(graph, observer, model_file, tmp_path):
    """Messages are taken, also of a new topic; people are told; the end is a failure, named."""
    (tmp_path / 'sitecustomize.py').write_text(STUCK_DISK)
    observer.watch_diagnostics()
    applied = observer.records('compensation_applied', CompensationApplied)
    progress = observer.records('recorder/progress', RecorderProgress)
    bag = tmp_path / 'bag'
    command = [
        *('env', f'PYTHONPATH={os.pathsep.join([str(tmp_path), str(graph.tree)])}'),
        *(sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'up', '--simulate', 'T2'),
        *('--rate', f'{RATE:g}', '--model', str(model_file), '--autostart'),
        *('--record', str(bag), '--json', str(tmp_path / 'outcome.json')),
    ]
    up = graph.launch('up', command, tmp_path)
    observer.until(
        lambda: applied and np.abs(applied[-1].offset).max() > AT_WORK, 'offsets are in force'
    )
    (pid,) = children(up.process.pid, 'nodes.recorder')
    os.kill(pid, signal.SIGUSR1)
    observer.until(
        lambda: observer.told('mill/recorder: disk', 'too slow for what comes'), 'people are told'
    )
    another = observer.node.create_publisher(message_class(MachineState.TYPE), 'another', 10)
    observer.until(another.get_subscription_count, 'the recorder reads it')
    begun, taken = len(applied), progress[-1].received
    observer.until(lambda: len(applied) > begun + 20, 'the machine goes on')
    assert {item.status for item in applied[begun:]} == {OffsetStatus.FOLLOWING}
    observer.until(lambda: progress[-1].received > taken + 100, 'messages are taken')
    assert up.interrupt(signal.SIGTERM) == 1
    (line,) = [text for text in up.output.splitlines() if text.startswith('error: ')]
    assert 'mill/recorder did not close its bag within 30 s and was killed' in line
    assert json.loads((tmp_path / 'outcome.json').read_text())['exit_code'] == 1
    assert repair(bag, tmp_path / 'repaired').topics['/mill/machine_state'].kept
