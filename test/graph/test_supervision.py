# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc up` on a live graph whose nodes are killed; machines with two sources of commands."""

import json
import os
import re
import signal
import sys
import time
from itertools import pairwise

import numpy as np
import pytest
import rclpy

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.components.codes import AppliedStatus, CompensationState, MachineMode
from fuzzycnc_ros.components.compensator import CompensatorConfig
from fuzzycnc_ros.components.component import LATCHED, STREAM
from fuzzycnc_ros.components.host_records import NodeConfiguration, NodeEvent
from fuzzycnc_ros.components.records import (
    SECOND,
    AxisCommand,
    Compensation,
    CompensationApplied,
    MachineState,
    Temperatures,
    ThermalError,
)
from fuzzycnc_ros.components.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.convert import decode, encode
from fuzzycnc_ros.nodes.command_watch import LEASE, SETTLED, TopicSources
from fuzzycnc_ros.nodes.messages import RCLPY, message_class
from fuzzycnc_ros.nodes.qos import publisher_qos

pytestmark = [pytest.mark.ros, pytest.mark.slow]

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

    observer.until(at_work, f'compensates, found {told[-1:]} {applied[-1:]}', 60.0)
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
        observer.until(lambda s=since: at_work(s), f'compensates again, found {told[-1]}', 60.0)
        back_after[node] = round(time.monotonic() - killed, 2)
    print(f'time until compensating again [s]: {back_after}')
    assert supervised.process.interrupt(signal.SIGTERM) == 0, supervised.process.output
    assert supervised.living() == []
    outcome = json.loads((supervised.folder / 'outcome.json').read_text())
    assert outcome['restarts'] == {f'mill/{node}': 1 for node in back_after}
    assert outcome['given_up'] == []

    bag = supervised.folder / 'bag'
    commands = records(bag, 'compensation', Compensation)
    readings = records(bag, 'compensation_applied', CompensationApplied)
    steps = check_steps(commands, readings)
    print(f'largest steps [um]: applied {steps[0] / MICRO:.2f}, told {steps[1] / MICRO:.2f}')
    assert max(item.epoch for item in commands) > 1
    events = records(bag, 'node_event', NodeEvent)
    assert not [event for event in events if event.name == 'sources'], 'a restart is no stranger'


def test_killed_recorder_goes_on_in_another_bag(supervised, observer):
    """The machine, which makes time, ends the run when it dies."""
    states = observer.records('machine_state', MachineState)
    observer.until(lambda: len(states) > 20, 'the machine runs')
    os.kill(supervised.pid('recorder'), signal.SIGKILL)
    again = supervised.folder / 'bag_again1'
    observer.until(lambda: (again / 'bag_again1_0.mcap').exists(), 'another bag')
    count = len(states)
    observer.until(lambda: len(states) > count + 20, 'the machine runs on')
    os.kill(supervised.pid('simulated_machine'), signal.SIGKILL)
    assert supervised.process.wait() == 2
    assert 'mill/simulated_machine was killed by SIGKILL' in supervised.process.output
    assert supervised.living() == []
    assert len(records(again, 'machine_state', MachineState)) > 10


class Stranger:
    """A node that publishes what it should not."""

    def __init__(self, observer, topic, kind, name):
        self._observer = observer
        self.node = rclpy.create_node(name, namespace='/mill', context=observer.context)
        self._publisher = self.node.create_publisher(
            message_class(kind.TYPE), topic, publisher_qos(STREAM)
        )

    def send(self, record):
        """Publish a record."""
        self._publisher.publish(encode(record, RCLPY))

    def leave(self):
        """Leave the graph."""
        self.node.destroy_node()


def test_strangers_are_refused_together_with_the_owner(graph, observer, model_file):
    """Offsets from a stranger and from a second compensator; duties from two strangers."""
    observer.watch_diagnostics()
    told = observer.records('compensation', Compensation)
    applied = observer.records('compensation_applied', CompensationApplied)
    states = observer.records('machine_state', MachineState)
    graph.start_shift(model_file, lockstep=False, duties=('T2',), rate=RATE)

    def at_work():
        return (
            applied
            and applied[-1].status == AppliedStatus.FOLLOWING
            and np.abs(applied[-1].offset).max() > AT_WORK
        )

    def refused(name):
        last = applied[-1]
        return last.status == AppliedStatus.REFUSED and name in last.reason

    observer.until(at_work, 'compensates', 60.0)
    stranger = Stranger(observer, 'compensation', Compensation, 'stranger')
    observer.until(lambda: refused('/mill/compensator, /mill/stranger'), 'refuses both')
    # Orders of the highest rank change nothing any more.
    last = told[-1]
    stranger.send(Compensation(**{**vars(last), 'epoch': 1000, 'offset': np.full(2, 50 * MICRO)}))
    observer.until(lambda: not applied[-1].offset.any(), 'goes to zero')
    item = 'mill/simulated_machine: sources of compensation'
    observer.until(lambda: observer.told(item, '/mill/stranger'), 'says who')
    observer.until(
        lambda: observer.told('mill/compensator: read-back', '/mill/stranger'), 'says so too'
    )
    stranger.leave()
    observer.until(at_work, f'compensates again, found {applied[-1]}', 60.0)

    second = graph.start(
        'compensator',
        {'autostart': True, 'use_sim_time': True},
        arguments=('-r', '__node:=compensator_2'),
    )
    observer.until(lambda: refused('/mill/compensator, /mill/compensator_2'), 'refuses both')
    assert second.interrupt() == 0
    observer.until(at_work, f'compensates again, found {applied[-1]}', 60.0)

    pair = [Stranger(observer, 'axis_command', AxisCommand, f'driver_{n}') for n in (1, 2)]
    observer.until(lambda: states[-1].state == MachineMode.FAULT, 'does not move')
    item = 'mill/simulated_machine: sources of axis_command'
    observer.until(lambda: observer.told(item, '/mill/driver_1, /mill/driver_2'), 'says who')
    for driver in pair:
        driver.leave()
    observer.until(lambda: states[-1].state != MachineMode.FAULT, 'moves again')
    assert at_work()
    check_steps([command for command in told if command.epoch != 1000], applied)
    graph.stop()


A, B, UNKNOWN = '/mill/compensator', '/mill/b', '_NODE_NAMESPACE_UNKNOWN_/_NODE_NAME_UNKNOWN_'


def looks(sources, names, until, start=0.0, numbers=()):
    """Look every 0.2 s; return what was found last."""
    found, now = None, start
    numbers = list(numbers)
    while now < until:
        if numbers:
            sources.heard(numbers.pop(0))
        found = sources.look(names, now)
        now += 0.2
    return found


def test_different_names_are_two_sources_at_once():
    sources = TopicSources()
    assert looks(sources, [A], 5.0) == ()
    assert looks(sources, [B, A], 5.0 + 0.1, 5.0) is None
    assert looks(sources, [B, A], 5.0 + 0.2 * (SETTLED + 1), 5.2) == (B, A)
    assert looks(sources, [A], 7.0, 6.5) == ()


@pytest.mark.parametrize('again', [A, UNKNOWN])
def test_restarted_node_is_one_source(again):
    """Until its lease runs out the graph shows the dead one too."""
    sources = TopicSources()
    looks(sources, [A], 5.0, numbers=range(50, 75))
    assert looks(sources, [A, again], 5.0 + LEASE - 1.0, 5.0, numbers=range(1, 60)) is None
    assert looks(sources, [A], 40.0, 30.0) == ()


@pytest.mark.parametrize('again', [A, UNKNOWN])
def test_two_that_speak_are_two_sources_whatever_their_names(again):
    sources = TopicSources()
    looks(sources, [A], 5.0, numbers=range(50, 75))
    assert looks(sources, [A, again], 5.7, 5.0, numbers=[75, 1, 76, 2, 77]) == tuple(
        sorted([A, again])
    )


def test_two_that_begin_together_are_two_sources():
    sources = TopicSources()
    assert looks(sources, [A, A], 1.5, numbers=[1, 1, 2, 2, 3, 3]) == (A, A)


def test_two_restarts_in_a_row_are_still_one_source():
    sources = TopicSources()
    looks(sources, [A], 5.0, numbers=range(50, 75))
    assert looks(sources, [A, A], 7.0, 5.0, numbers=range(1, 11)) is None
    assert looks(sources, [A, A, A], 9.0, 7.0, numbers=range(1, 11)) is None


def test_two_of_one_name_that_outlast_the_lease_are_two_sources():
    sources = TopicSources()
    assert looks(sources, [A, A], LEASE - 1.0) is None
    assert looks(sources, [A, A], LEASE + 1.0, LEASE - 1.0) == (A, A)
