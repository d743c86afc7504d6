# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes under `fuzzycnc up` that run into a limit of their memory."""

import os
import re
import resource
import signal
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('starlette', reason="the page needs pip install 'fuzzycnc_ros[page]'")

from processes import children, free_port

from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.records import SECOND, CompensationApplied

pytestmark = [pytest.mark.ros, pytest.mark.slow]

LEAK = """
import signal
held = []
def leak(number, frame):
    while True:
        held.append(bytearray(1 << 20))
signal.signal(signal.SIGUSR1, leak)
"""
"""Read by each Python at its start: lets a node take memory until it gets no more."""
ROOM = 64 << 20
"""What a node may take on top of what it has [bytes]."""
RATE = 60.0
AT_WORK = 2e-6
"""Offset from which on compensation is at work [m]."""
NODES = ('compensator', 'thermal_predictor', 'recorder', 'dashboard')
MACHINE = SimulatedMachineConfig()


def size_of(pid):
    """Return the address space of a process [bytes]."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[0])
    return pages * resource.getpagesize()


def test_nodes_that_get_no_more_memory(graph, observer, model_file, tmp_path):
    """Each says so in a sentence and is started anew; offsets move no faster than they may."""
    (tmp_path / 'sitecustomize.py').write_text(LEAK)
    applied = observer.records('compensation_applied', CompensationApplied)
    command = [
        *('env', f'PYTHONPATH={os.pathsep.join([str(tmp_path), str(graph.tree)])}'),
        *(sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'up', '--simulate', 'T2,T2'),
        *('--rate', f'{RATE:g}', '--model', str(model_file), '--autostart'),
        *('--record', str(tmp_path / 'bag'), f'--page={free_port()}'),
    ]
    up = graph.launch('up', command, tmp_path)

    observer.until(
        lambda: applied and np.abs(applied[-1].offset).max() > AT_WORK, 'offsets are in force'
    )
    for node in NODES:
        (pid,) = children(up.process.pid, f'nodes.{node}')
        most = size_of(pid) + ROOM
        resource.prlimit(pid, resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))
        os.kill(pid, signal.SIGUSR1)
        says = f'{node} ended with code 1: error: there is not enough memory: this process may '
        says += f'have {most / 1e6:.0f} MB'
        observer.until(lambda text=says: text in up.output, f'{says}, found {up.output}')
        again = re.compile(rf'{node} runs as process (?!{pid}\b)\d+')
        observer.until(lambda word=again: word.search(up.output), f'{node} is started anew')
        heard = len(applied) + 3
        # Offsets themselves pass zero as the duty goes on.
        observer.until(
            lambda n=heard: len(applied) > n and applied[-1].status == OffsetStatus.FOLLOWING,
            f'the machine follows after {node}, found {applied[-1]}, {up.output}',
        )
    for before, after in pairwise(applied):
        elapsed = (after.stamp - before.stamp) / SECOND
        step = np.abs(after.offset - before.offset).max()
        assert step <= MACHINE.slew_max * elapsed + 1e-12, f'at {after.stamp / SECOND} s'
    assert up.interrupt(signal.SIGTERM) == 1  # a recording that has a hole is no success
    assert 'mill/recorder ended with code 1: error: there is not enough memory' in up.output
