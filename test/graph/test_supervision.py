# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc up` on a live graph whose nodes are killed."""

import json
import os
import re
import signal
import sys
import time
from itertools import pairwise

import numpy as np
import pytest

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.thermal.compensator import CompensatorConfig
from fuzzycnc_ros.runtime.component import LATCHED
from fuzzycnc_ros.runtime.convert import decode
from fuzzycnc_ros.runtime.enums import AppliedStatus, CompensationState
from fuzzycnc_ros.runtime.host import NodeConfiguration, NodeEvent
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    MachineState,
    Temperatures,
    ThermalError,
)

pytestmark = pytest.mark.ros

LIMITS, MACHINE = CompensatorConfig(), SimulatedMachineConfig()
MICRO = 1e-6
RATE = 120.0
"""Two minutes of machine time a second of wall time."""
AT_WORK = 3 * MICRO
"""Offset from which on compensation is at work [m]."""


class Up:
    """A supervised graph of a thermal shift, started by the command line."""

    def __init__(self, graph, model, folder):
        self.folder = folder
        command = [
            *(sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'up', '--simulate', 'T2'),
            *('--rate', f'{RATE:g}', '--model', str(model), '--autostart'),
            *('--record', str(folder / 'bag'), '--json', str(folder / 'outcome.json')),
        ]
        self.process = graph.launch('up', command, folder)

    def pid(self, node):
        """Return the process id of a node's newest life."""
        found = re.findall(rf'mill/{node} runs as process (\d+)', self.process.output)
        return int(found[-1]) if found else None

    def lives(self, node):
        """Return how often a node was started."""
        return len(re.findall(rf'mill/{node} runs as process', self.process.output))

    def living(self):
        """Return the processes that it has started and that still run."""
        pids = map(int, re.findall(r'runs as process (\d+)', self.process.output))
        return [pid for pid in pids if os.path.exists(f'/proc/{pid}')]


@pytest.fixture
def supervised(graph, observer, model_file, tmp_path):
    """A shift under supervision."""
    folder = tmp_path / 'up'
    folder.mkdir()
    return Up(graph, model_file, folder)


GROWN = 100_000
"""Size of a bag in which more than its first messages are [byte]."""


def records(bag, name, kind):
    """Return the records of a topic in a bag."""
    with BagReader(bag) as reader:
        return [
            decode(kind, message)
            for topic, _, _, message in reader.messages()
            if topic == f'/mill/{name}'
        ]


def check_steps(told, applied):
    """Hold all that was told and applied against limits; return the worst steps [m]."""
    steps = [0.0, 0.0]
    assert len(applied) > 30
    for before, after in pairwise(applied):
        elapsed = (after.stamp - before.stamp) / SECOND
        step = np.abs(after.offset - before.offset).max()
        steps[0] = max(steps[0], step)
        assert np.abs(after.offset).max() <= MACHINE.offset_max
        assert step <= MACHINE.slew_max * elapsed + 1e-12, f'at {after.stamp / SECOND} s'
    epoch = 0
    for number, command in enumerate(told):
        assert np.isfinite(command.offset).all()
        assert np.abs(command.offset).max() <= LIMITS.offset_max
        if command.epoch == epoch:
            before = told[number - 1]
            elapsed = (command.stamp - before.stamp) / SECOND
            step = np.abs(command.offset - before.offset).max()
            steps[1] = max(steps[1], step)
            assert step <= LIMITS.slew_max * elapsed + 1e-12, f'at {command.stamp / SECOND} s'
            continue
        epoch = command.epoch
        # A new owner starts from what is in force: the newest read-back that it can know.
        known = [item.offset for item in applied if item.stamp <= command.stamp][-6:]
        reach = LIMITS.slew_max * LIMITS.period + 1e-12
        nearest = min((np.abs(command.offset - offset).max() for offset in known), default=0.0)
        assert nearest <= reach, f'epoch {epoch} begins with a step of {nearest / MICRO} um'
    return steps


@pytest.mark.slow
@pytest.mark.realtime  # two minutes of machine time a second, and readings may not be missing long
def test_killed_nodes_come_back_without_a_step(supervised, observer):
    """One after the other, with compensation at work; the whole bag is looked at."""
    told = observer.records('compensation', Compensation)
    applied = observer.records('compensation_applied', CompensationApplied)
    heard = {
        'temperature_acquisition': observer.records('temperatures', Temperatures),
        'thermal_predictor': observer.records('thermal_error', ThermalError),
        'compensator': told,
    }
    lives = observer.records('node_configuration', NodeConfiguration, LATCHED)

    def at_work(since=0):
        command = told[-1] if told else None
        return (
            command is not None
            and command.stamp > since
            and command.state == CompensationState.ACTIVE
            and np.abs(applied[-1].offset).max() > AT_WORK
            and applied[-1].status == AppliedStatus.FOLLOWING
        )

    observer.until(at_work, f'compensates, found {told[-1:]} {applied[-1:]}')
    back_after = {}
    for node in ('temperature_acquisition', 'sensor_selector', 'thermal_predictor', 'compensator'):
        known, begun = len(heard.get(node, ())), supervised.lives(node)
        told_lives = len(lives)
        since = applied[-1].stamp
        os.kill(supervised.pid(node), signal.SIGKILL)
        killed = time.monotonic()
        observer.until(lambda n=node, b=begun: supervised.lives(n) > b, f'{node} is started again')
        observer.until(
            lambda n=node, k=told_lives: any(item.node == n for item in lives[k:]),
            f'{node} says what it runs with',
        )
        if node in heard:
            observer.until(lambda h=heard[node], k=known: len(h) > k + 1, f'{node} is back')
        observer.until(lambda s=since: at_work(s), f'compensates again, found {told[-1]}')
        back_after[node] = round(time.monotonic() - killed, 2)
    print(f'time until compensating again [s]: {back_after}')
    # Temperatures were missing while their node was away.
    assert supervised.process.interrupt(signal.SIGTERM) == 1, supervised.process.output
    assert supervised.living() == []
    outcome = json.loads((supervised.folder / 'outcome.json').read_text())
    assert outcome['restarts'] == {f'mill/{node}': 1 for node in back_after}
    assert outcome['given_up'] == []
    assert '/mill/temperatures has ' in outcome['lacking'][0]

    bag = supervised.folder / 'bag'
    commands = records(bag, 'compensation', Compensation)
    readings = records(bag, 'compensation_applied', CompensationApplied)
    steps = check_steps(commands, readings)
    print(f'largest steps [um]: applied {steps[0] / MICRO:.2f}, told {steps[1] / MICRO:.2f}')
    assert max(item.epoch for item in commands) > 1
    events = records(bag, 'node_event', NodeEvent)
    assert not [event for event in events if event.name == 'sources'], 'a restart is no stranger'


@pytest.mark.slow
def test_killed_recorder_goes_on_in_another_bag(supervised, observer):
    """The machine, which makes time, ends the run when it dies."""
    states = observer.records('machine_state', MachineState)
    observer.until(lambda: len(states) > 20, 'the machine runs')
    os.kill(supervised.pid('recorder'), signal.SIGKILL)
    again = supervised.folder / 'bag_again1'
    file = again / 'bag_again1_0.mcap'
    # What stands at its beginning is smaller: now it holds what came later.
    observer.until(lambda: file.exists() and file.stat().st_size > GROWN, 'another bag grows')
    count = len(states)
    observer.until(lambda: len(states) > count + 20, 'the machine runs on')
    os.kill(supervised.pid('simulated_machine'), signal.SIGKILL)
    assert supervised.process.wait() == 2
    assert 'mill/simulated_machine was killed by SIGKILL' in supervised.process.output
    assert supervised.living() == []
    assert len(records(again, 'machine_state', MachineState)) > 10
