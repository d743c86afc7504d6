# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The compensator as a managed node, driven by its services."""

import json
import time
from dataclasses import replace
from functools import partial
from itertools import count, groupby

import numpy as np
import pytest
import rclpy
from lifecycle_msgs.msg import State, Transition
from rosgraph_msgs.msg import Clock
from tiers import rest_slow

from fuzzycnc_ros.components.thermal.compensator import CompensatorConfig
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.host import NodeConfiguration, NodeEvent
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    MachineState,
    ThermalError,
)

pytestmark = pytest.mark.ros

STREAM = Durability.STREAM
AXES = ('Y', 'Z')
LIMITS = CompensatorConfig()
OFFSET_MAX, SLEW_MAX = LIMITS.offset_max, LIMITS.slew_max


class Machine:
    """What the compensator reads, published by the test."""

    def __init__(self, observer, *, clock=True):
        self._publishers = {
            kind: observer.node.create_publisher(
                message_class(kind.TYPE), name, publisher_qos(STREAM)
            )
            for name, kind in (
                ('machine_state', MachineState),
                ('compensation_applied', CompensationApplied),
                ('thermal_error', ThermalError),
            )
        }
        self._clock = observer.node.create_publisher(Clock, '/clock', 10) if clock else None
        ends = [*self._publishers.values(), *([self._clock] if clock else [])]
        observer.until(
            lambda: all(end.get_subscription_count() >= 1 for end in ends),
            'the compensator reads its inputs',
        )

    def heard(self):
        """Return by how many each topic is read at least."""
        return min(item.get_subscription_count() for item in self._publishers.values())

    def tell_time(self, second):
        """Publish machine time."""
        self._clock.publish(Clock(clock=RCLPY.time(int(second * SECOND))))

    def send(self, second, error=(10e-6, -20e-6), applied=(0.0, 0.0)):
        """Publish state, read-back and error of one point of machine time."""
        for record in records_at(int(second * SECOND), error, applied):
            self._publishers[type(record)].publish(encode(record, RCLPY))
        if self._clock is not None:
            self.tell_time(second)


def records_at(stamp, error=(10e-6, -20e-6), applied=(0.0, 0.0)):
    """Return state, read-back and error of a machine [m]."""
    return [
        MachineState(
            stamp=stamp,
            state=3,
            homed=True,
            offsets_allowed=True,
            cold_since=SECOND,
            spindle_speed=0.0,
            axis=AXES,
            position=np.zeros(2),
        ),
        CompensationApplied(
            stamp=stamp,
            epoch=0,
            status=0,
            reason='',
            axis=AXES,
            offset=np.array(applied),
            at_limit=np.zeros(2, bool),
        ),
        ThermalError(
            stamp=stamp,
            axis=AXES,
            channel=AXES,
            error=np.array(error),
            standard_deviation=np.full(2, 1e-6),
            valid=True,
            reason=0,
            in_domain=True,
            model='test',
            substituted=(),
            substitute=(),
        ),
    ]


@pytest.fixture
def change(observer):
    """Ask for a transition; tell whether it was carried out."""
    return partial(observer.change, 'compensator')


@pytest.fixture
def state(observer):
    """Ask for the lifecycle state."""
    return partial(observer.state, 'compensator')


def test_transitions(graph, observer, change, state):
    """Inactive it is silent; active it follows; deactivated it ramps to zero."""
    node = graph.start('compensator', {'use_sim_time': True})
    commands = observer.records('compensation', Compensation)
    told = observer.records('node_configuration', NodeConfiguration, Durability.LATCHED)
    machine = Machine(observer)
    observer.until(lambda: told and commands == [], 'tells its configuration')
    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert not change(Transition.TRANSITION_ACTIVATE)
    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert node.process.poll() is None

    assert change(Transition.TRANSITION_CONFIGURE)
    assert state() == State.PRIMARY_STATE_INACTIVE
    machine.send(60)
    assert not change(Transition.TRANSITION_CONFIGURE)
    assert commands == []

    assert change(Transition.TRANSITION_ACTIVATE)
    assert state() == State.PRIMARY_STATE_ACTIVE
    for second in range(70, 570, 10):
        machine.send(second)
        stamp = second * SECOND
        # The first error may overtake the read-back, which it cannot do without.
        wanted = second > 70
        observer.until(lambda s=stamp, w=wanted: not w or (commands and commands[-1].stamp >= s))
    assert commands[-1].state == CompensationState.ACTIVE
    np.testing.assert_allclose(commands[-1].offset, [-10e-6, 20e-6])

    assert change(Transition.TRANSITION_DEACTIVATE)
    assert state() == State.PRIMARY_STATE_INACTIVE
    for second in range(570, 1070, 10):
        machine.tell_time(second)
        if not commands[-1].offset.any():
            break
        observer.until(lambda s=second: commands[-1].stamp >= (s - 10) * SECOND, 'ramps to zero')
    assert commands[-1].state == CompensationState.INACTIVE
    offsets = np.array([command.offset for command in commands])
    elapsed = np.diff([command.stamp for command in commands]) / SECOND
    assert np.abs(offsets).max() <= OFFSET_MAX
    assert (np.abs(np.diff(offsets, axis=0)).max(axis=1) <= SLEW_MAX * elapsed + 1e-15).all()
    silent = len(commands)
    machine.send(100_000)

    assert not change(Transition.TRANSITION_DEACTIVATE)
    assert change(Transition.TRANSITION_CLEANUP)
    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert len(commands) == silent

    def states():
        return [state for state, _ in groupby(record.lifecycle_state for record in told)]

    expected = ['unconfigured', 'inactive', 'active', 'inactive', 'unconfigured']
    observer.until(lambda: len(states()) >= len(expected), f'all states, found {states()}')
    assert states() == expected
    graph.stop()


def test_autostart(graph, observer, state):
    graph.start('compensator', {'autostart': True})
    observer.watch_diagnostics()
    observer.until(lambda: state() == State.PRIMARY_STATE_ACTIVE, 'active')
    observer.until(
        lambda: observer.told('mill/compensator: state', 'waiting for the read-back'),
        f'says what it waits for, found {observer.statuses}',
    )
    graph.stop()


def settled(observer, machine, commands, begin=60, ticks=1):
    """Let the compensator follow, tick by tick, until it has arrived; return the newest second."""
    for second in count(begin, 10):
        machine.send(second)
        if commands:
            observer.until(lambda s=second: commands[-1].stamp >= s * SECOND, 'an answer')
            ticks -= np.allclose(commands[-1].offset, [-10e-6, 20e-6], atol=1e-12)
        else:
            observer.spin_for(0.1)  # it is not active yet
        if ticks <= 0:
            return second


def followed_again(observer, machine, commands, begin):
    """Tell tick after tick, until one is followed; return the second of the next one.

    One who has left may still be in the graph without a name: what comes meanwhile is refused.
    """
    later = count(begin, 10)

    def followed():
        machine.send(next(later))
        observer.spin_for(0.2)
        last = commands[-1]
        return last.stamp >= begin * SECOND and last.state == CompensationState.ACTIVE

    observer.until(followed, 'follows the one that is left')
    return next(later)


@pytest.fixture
def stranger(observer):
    """Publish as a node that has no business to until it is `heard`, and leave."""

    def publish(topic, record, heard, *, stays=False):
        node = rclpy.create_node('stranger', namespace='/mill', context=observer.context)
        publisher = node.create_publisher(message_class(record.TYPE), topic, publisher_qos(STREAM))
        observer.until(
            lambda: publisher.get_subscription_count() >= 1, 'the stranger has a reader'
        )

        def told():
            publisher.publish(encode(record, RCLPY))  # a reader may not have met him yet
            observer.spin_for(0.2)
            return heard()

        observer.until(told, 'the stranger is heard')
        if not stays:
            node.destroy_node()
        return node

    return publish


@pytest.mark.parametrize('kind', [ThermalError, MachineState, CompensationApplied])
def test_word_of_a_stranger_is_refused_and_named(graph, observer, stranger, kind):
    """His error would be followed, his machine state stop it, his read-back end it for ever."""
    observer.watch_diagnostics()
    graph.start('compensator', {'use_sim_time': True, 'autostart': True, 'slew_max': 1e-5})
    commands = observer.records('compensation', Compensation)
    events = observer.records('node_event', NodeEvent, Durability.HISTORY)
    machine = Machine(observer)
    second = settled(observer, machine, commands)
    false = {
        ThermalError: {'error': np.array([45e-6, 45e-6])},
        MachineState: {'offsets_allowed': False},
        CompensationApplied: {'epoch': 2**61, 'status': 1},
    }[kind]
    record = next(item for item in records_at((second + 5) * SECOND) if type(item) is kind)
    topic = {ThermalError: 'thermal_error', MachineState: 'machine_state'}.get(
        kind, 'compensation_applied'
    )

    # His first messages may come before his name does, and are refused without it.
    item = f'mill/compensator: strangers on {topic}'
    stranger(topic, replace(record, **false), lambda: observer.told(item, '/mill/stranger'))
    observer.until(lambda: any(item.name == 'refused' for item in events), 'the event')
    second = followed_again(observer, machine, commands, second + 10)
    settled(observer, machine, commands, second, ticks=7)
    assert commands[-1].state == CompensationState.ACTIVE
    np.testing.assert_allclose([item.offset for item in commands[-5:]], [(-10e-6, 20e-6)] * 5)
    assert {item.epoch for item in commands} == {1}


def test_second_source_of_errors_is_held_and_named(graph, observer, stranger):
    observer.watch_diagnostics()
    graph.start('compensator', {'use_sim_time': True, 'autostart': True, 'slew_max': 1e-5})
    commands = observer.records('compensation', Compensation)
    machine = Machine(observer)
    second = settled(observer, machine, commands)

    def holds():
        return commands[-1].state == CompensationState.HOLDING

    other = stranger('thermal_error', records_at((second + 5) * SECOND)[2], holds, stays=True)
    item, named = (
        'mill/compensator: sources of thermal_error',
        '/mill/observer, /mill/stranger; end',
    )
    observer.until(lambda: observer.told(item, named), 'both are named')
    other.destroy_node()
    followed_again(observer, machine, commands, second + 10)


@pytest.mark.parametrize('step', rest_slow([-86_400, -3_600, 3_600], 1))
def test_clock_that_is_set_is_told_and_held_through(graph, observer, tmp_path, step):
    observer.watch_diagnostics()
    clock = tmp_path / 'clock'
    clock.write_text('0')
    parameters = {'autostart': True, 'period': 0.1, 'slew_max': 1e-4}
    graph.start_by(clock, 'compensator', parameters)
    graph.start_by(clock, 'recorder', {'output': str(tmp_path / 'bag')})
    commands = observer.records('compensation', Compensation)
    events = observer.records('node_event', NodeEvent, Durability.HISTORY)
    machine = Machine(observer, clock=False)
    ends = ['compensation', 'node_event', 'node_configuration']
    observer.until(
        lambda: (
            all(observer.node.count_subscribers(f'/mill/{end}') >= 1 for end in ends[2:])
            and all(observer.node.count_subscribers(f'/mill/{end}') >= 2 for end in ends[:2])
            and machine.heard() >= 2
        ),
        'the recorder listens',
    )
    observer.settle('compensator', 'recorder')

    def at_work(state, since=0):
        def found():
            last = commands[-1].offset if commands else np.zeros(2)
            machine.send((time.time_ns() + int(clock.read_text())) / SECOND, applied=last)
            observer.spin_for(0.1)
            observer.state('compensator')  # no more waits for it than it keeps
            return any(item.state == state for item in commands[since:])

        return found

    observer.until(at_work(CompensationState.ACTIVE), 'follows')
    settled = [-10e-6, 20e-6]
    observer.until(
        lambda: at_work(CompensationState.ACTIVE)() and np.allclose(commands[-1].offset, settled)
    )
    before, since = commands[-1], len(commands)
    other = tmp_path / 'other'
    other.write_text(str(step * SECOND))
    other.replace(clock)
    observer.until(at_work(CompensationState.ACTIVE, since + 2), 'follows in the new series')
    told = [item for item in events if item.name == 'clock_step']
    assert len(told) == 1
    assert json.loads(told[0].request)['step'] / SECOND == pytest.approx(step, abs=2.0)
    observer.until(
        lambda: observer.told('mill/compensator: clock', 'the clock stepped by'),
        'told to the operator',
    )
    fresh = [item for item in commands[since:] if (item.stamp - before.stamp) * step > 0]
    shift = (fresh[-1].stamp - before.stamp) / SECOND
    assert shift == pytest.approx(step, abs=120.0)
    np.testing.assert_allclose([item.offset for item in fresh], [settled] * len(fresh))
    graph.stop()
    report = replay(tmp_path / 'bag')
    (row,) = (item for item in report.topics if item.topic == '/mill/compensation')
    assert row.recorded > row.recomputed == row.identical >= 2
    assert 'came after the clock of compensator was set' in row.not_recomputed
    assert not report.differing
    assert not report.equivalent
    assert 'the clock of compensator was set' in report.notes[0]
