# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A move controlled live at 1 kHz: the same as in one process, and what goes wrong on a graph."""

import os
import resource
import sys
from pathlib import Path

import numpy as np
import pytest
from benches.positioning_run import run_positioning
from lifecycle_msgs.msg import Transition
from live_graph import ANSWER_TIMEOUT, KILL_TIMEOUT

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.servo.servo_controller_config import ServoControllerConfig
from fuzzycnc_ros.machine_file.parameters import node_parameters
from fuzzycnc_ros.machine_file.reader import read_machine_file
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.runtime.component import Level
from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.records import (
    AxisCommand,
    AxisState,
    ServoState,
)
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.servo.positioning import PositioningLog

pytestmark = pytest.mark.ros

OUTPUTS = ('position_command', 'axis_state', 'axis_command', 'servo_state', 'machine_state')
TARGET = -0.05
PRIORITY = 20


def start(graph, *, bag=None, lockstep=True, priority=0, **machine):
    """Start the controller, a recorder and the machine, which asks for a move of 1.2 s."""
    clock = {'use_sim_time': not lockstep}
    servo = graph.start(
        'servo_controller',
        {'lockstep': lockstep, 'autostart': True, 'realtime_priority': priority, **clock},
    )
    if bag is not None:
        graph.start('recorder', {'lockstep': lockstep, 'output': str(bag), **clock})
    machine = graph.start(
        'simulated_machine',
        {
            'duties': [''],
            'servo_axes': ['X:lathe'],
            'moves': [f'X:{TARGET}'],
            'lockstep': lockstep,
            'lockstep_nodes': ['servo_controller'],
            'lockstep_recorder': bag is not None,
            'answer_timeout': ANSWER_TIMEOUT,
            **machine,
        },
    )
    return servo, machine


def test_live_and_replayed_equal_in_process(graph, tmp_path):
    """Controller and machine in processes of their own: every message is that of one process."""
    _, machine = start(graph, bag=tmp_path / 'live')
    assert machine.wait() == 0
    assert machine.outcome['degraded'] is False
    graph.stop()
    with PublishedBag(tmp_path / 'alone') as bag:
        (alone,) = run_positioning((f'X:{TARGET}',), sink=bag)
    live, expected = (topic_hashes(tmp_path / name) for name in ('live', 'alone'))
    for topic in OUTPUTS:
        assert live[f'/mill/{topic}'] == expected[f'/mill/{topic}'], topic
    (move,) = PositioningLog.from_bag(tmp_path / 'live').moves()
    assert move.settle(2e-6) == alone.settle(2e-6) <= 0.7
    assert len(move.time) == 1201
    report = replay(tmp_path / 'live')
    assert report.identical, report.topics


MACHINE_FILE = """\
axes:
  Y:
    limits: {travel_low: 50 mm, travel_high: 450 mm, velocity: 100 mm/s, load: 20 %}
    plant: {model: lags, gain: 150 mm/s, velocity_lag: 30 ms}
    controller: {name: cascade, settings: {bandwidth: 1.5}}
"""
AXIS_PARAMETERS = """\
/**/servo_controller:
  ros__parameters:
    axes: ['Y:machine_file']
/**/simulated_machine:
  ros__parameters:
    duties: ['']
    servo_axes: ['Y:machine_file']
    moves: ['Y:0.1']
    move_time: 2.5
"""


@pytest.mark.slow
def test_an_axis_of_a_machine_file_is_driven_and_replayed_without_it(graph, tmp_path):
    """`fuzzycnc up` as a user calls it; the file has gone when the bag is replayed."""
    folder = tmp_path / 'up'
    (folder / 'p').mkdir(parents=True)
    file, bag = folder / 'my.yaml', tmp_path / 'live'
    file.write_text(MACHINE_FILE)
    (folder / 'p' / 'servo.yaml').write_text(AXIS_PARAMETERS)
    command = [sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'up', '--lockstep', '--autostart']
    command += ['--nodes', 'servo_controller,simulated_machine', '--machine-file', str(file)]
    command += ['--params', str(folder / 'p'), '--record', str(bag)]
    running = graph.launch('up', command, folder)
    assert running.wait() == 0, running.output
    parameters = node_parameters(read_machine_file(file))['servo_controller']
    config = ServoControllerConfig(**{**parameters, 'axes': ('Y:machine_file',)})
    file.unlink()
    (move,) = PositioningLog.from_bag(bag).moves()
    assert (move.axis, move.target, move.fault) == ('Y', 0.1, '')
    assert move.left < 5e-6
    (alone,) = run_positioning(('Y:0.1',), config, SimulatedMachineConfig(move_time=2.5))
    np.testing.assert_array_equal(move.duty, alone.duty)
    report = replay(bag)
    assert report.identical, report.topics


@pytest.mark.realtime  # a kilohertz
def test_arrives_in_real_time_and_counts_what_was_missed(graph, observer):
    """Where the clock does not wait: machine time slips on a busy host, but rushes nothing.

    Without a priority a busy host leaves a process alone for longer than feedback may be missing.
    """
    _, highest = resource.getrlimit(resource.RLIMIT_RTPRIO)
    may = os.geteuid() == 0 or highest >= PRIORITY
    pace = {'rate': 1.0, 'priority': PRIORITY} if may else {'rate': 0.25}
    states = observer.records('servo_state', ServoState)
    axes = observer.records('axis_state', AxisState)
    commands = observer.records('axis_command', AxisCommand)
    _, machine = start(graph, lockstep=False, move_time=2.0, **pace)
    assert observer.until_ended(machine) == 0
    assert machine.outcome['ticks'] == 2001
    assert axes[-1].position[0] == pytest.approx(TARGET, abs=5e-6)
    assert all(item.status != ServoStatus.FAULT for item in states)
    # of what was heard here from the beginning on
    begin = max(axes[0].stamp, commands[0].stamp)
    first, *_, last = (item for item in states if item.stamp >= begin)
    answered = {item.stamp for item in commands}
    passed = {item.stamp for item in axes if first.stamp < item.stamp <= last.stamp}
    assert last.missed - first.missed == len(passed - answered)


@pytest.mark.slow
def test_drives_go_to_zero_when_the_controller_dies(graph, observer):
    """Killed in mid-move: the last command runs out of date, and the axis stands."""
    observer.watch_diagnostics()
    axes = observer.records('axis_state', AxisState)
    commands = observer.records('axis_command', AxisCommand)
    # Far, so that it is still under way when a busy computer has seen it begin.
    servo, machine = start(
        graph, answer_timeout=KILL_TIMEOUT, move_time=20.0, moves=[f'X:{4.0 * TARGET}']
    )
    observer.until(lambda: bool(axes) and axes[-1].position[0] < 0.3 * TARGET, 'the move')
    graph.kill(servo)
    observer.until(
        lambda: any(
            level >= Level.WARN and 'out of date' in text
            for level, text in observer.statuses.get('mill/simulated_machine: axes', [])
        ),
        f'word of the dead controller, found {observer.statuses}',
    )
    assert observer.until_ended(machine) == 1
    assert machine.outcome['degraded'] is True
    assert 'is servo_controller active?' in machine.outcome['failure']
    last = commands[-1]
    stopped = [item for item in axes if item.stamp > last.valid_until + 200_000_000]
    place = np.array([item.position[0] for item in stopped])
    assert np.ptp(place) < 3e-6
    # valid for 20 ms, then coasting, from no more than full speed
    then = next(item for item in axes if item.stamp >= last.stamp)
    assert abs(place[-1] - then.position[0]) < 0.286 * (0.02 + 0.0203)
    assert min(item.position[0] for item in axes) > 4.0 * TARGET - 5e-3


def test_fault_takes_the_axis_to_zero(graph, observer):
    """The command is zero, diagnostics say why, and the axis stays within its travel."""
    reason = 'no axis_state'
    observer.watch_diagnostics()
    commands = observer.records('axis_command', AxisCommand)
    states = observer.records('servo_state', ServoState)
    axes = observer.records('axis_state', AxisState)
    _, machine = start(graph, move_time=3.0, servo_silence=0.2)

    def told():
        found = observer.statuses.get('mill/servo_controller: state', [])
        return any(level == Level.ERROR and reason in text for level, text in found)

    observer.until(told, f'diagnostics of the fault, found {observer.statuses}')
    assert observer.until_ended(machine) == 1
    fault = next(item for item in states if item.status == ServoStatus.FAULT)
    assert reason in fault.reason
    assert all(item.duty[0] == 0.0 for item in commands if item.stamp >= fault.stamp)
    readings = np.array([item.position[0] for item in axes])
    readings = readings[np.isfinite(readings)]
    assert readings.min() > TARGET - 1e-5
    assert readings.max() < 2e-3


def test_a_fault_that_is_cleared_at_once_is_told(graph, observer):
    """Diagnostics come once a second, an operator may be faster."""
    observer.watch_diagnostics()
    states = observer.records('servo_state', ServoState)
    start(graph, move_time=3.0, servo_silence=0.2)
    observer.until(lambda: states and states[-1].status == ServoStatus.FAULT, 'the fault')
    assert observer.change('servo_controller', Transition.TRANSITION_DEACTIVATE)
    item = 'mill/servo_controller: state'
    observer.until(lambda: observer.told(item, 'inactive'), 'the end of the fault')
    assert observer.told(item, 'no axis_state')


def test_priority_in_real_time_is_taken_or_its_refusal_told(graph, observer):
    """All threads have it, those of DDS too; where it is not allowed, diagnostics say so."""
    observer.watch_diagnostics()
    servo = graph.start('servo_controller', {'realtime_priority': 20})
    threads = Path(f'/proc/{servo.process.pid}/task')

    def taken():
        found = {os.sched_getscheduler(int(thread.name)) for thread in threads.iterdir()}
        return found == {os.SCHED_FIFO}

    def refused():
        return observer.told('mill/servo_controller: priority', 'realtime_priority: 20')

    observer.until(lambda: taken() or refused(), f'priority, found {observer.statuses}')
    assert taken() != refused()
