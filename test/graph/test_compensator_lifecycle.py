# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The compensator as a managed node, driven by its services."""

from functools import partial
from itertools import groupby

import numpy as np
import pytest
from lifecycle_msgs.msg import State, Transition
from rosgraph_msgs.msg import Clock

from fuzzycnc_ros.components.codes import CompensationState
from fuzzycnc_ros.components.component import Durability
from fuzzycnc_ros.components.host_records import NodeConfiguration
from fuzzycnc_ros.components.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    MachineState,
    ThermalError,
)
from fuzzycnc_ros.convert import encode
from fuzzycnc_ros.nodes.messages import RCLPY, message_class
from fuzzycnc_ros.nodes.qos import publisher_qos

pytestmark = pytest.mark.ros

STREAM = Durability.STREAM
AXES = ('Y', 'Z')
OFFSET_MAX, SLEW_MAX = 50e-6, 0.1e-6  # the compensator's defaults


class Machine:
    """What the compensator reads, published by the test."""

    def __init__(self, observer):
        self._observer = observer
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
        self._clock = observer.node.create_publisher(Clock, '/clock', 10)
        ends = [self._clock, *self._publishers.values()]
        observer.until(
            lambda: all(end.get_subscription_count() == 1 for end in ends),
            'the compensator reads its inputs',
        )

    def tell_time(self, second):
        """Publish machine time."""
        self._clock.publish(Clock(clock=RCLPY.time(second * SECOND)))

    def send(self, second, error=(10e-6, -20e-6), applied=(0.0, 0.0)):
        """Publish state, read-back and error of one point of machine time."""
        stamp = second * SECOND
        records = [
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
        for record in records:
            self._publishers[type(record)].publish(encode(record, RCLPY))
        self.tell_time(second)


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
