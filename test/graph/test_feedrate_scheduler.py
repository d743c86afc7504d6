# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The feedrate scheduler as a managed node: transitions, programs by service, paths over DDS."""

import math
from functools import partial
from itertools import groupby, pairwise

import numpy as np
import pytest
from lifecycle_msgs.msg import State, Transition
from live_graph import AGAIN
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rosgraph_msgs.msg import Clock

from fuzzycnc_msgs.srv import ScheduleProgram
from fuzzycnc_ros.components.motion.tool_paths import curve_tool_path
from fuzzycnc_ros.core.feedrate.path.curves import trident
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.host import NodeConfiguration
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    FeedSchedule,
    MachineState,
    ToolPath,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)

pytestmark = pytest.mark.ros

LATCHED = Durability.LATCHED
NODE = 'feedrate_scheduler'
AXES = ('X', 'Y', 'Z')
CURVE = trident()
"""98 mm."""
STEP, PACE = 0.05, 0.02
"""Machine time and wall time between two looks of the machine [s]."""
BAD_PROGRAM = 'G0 X0 Y0\nG1 X10 F600\nG2 X20 Y5 I1 J1\n'


class Machine:
    """What the scheduler reads, published by the test; it makes the time."""

    def __init__(self, observer, readers=1):
        self._observer = observer
        self._clock = observer.node.create_publisher(Clock, '/clock', 10)
        self._publishers = {
            kind: observer.node.create_publisher(
                message_class(kind.TYPE),
                name,
                publisher_qos(LATCHED if kind is ToolPath else Durability.STREAM),
            )
            for name, kind in (
                ('machine_state', MachineState),
                ('axis_state', AxisState),
                ('trajectory_state', TrajectoryState),
                ('tool_path', ToolPath),
            )
        }
        ends = [self._clock, *self._publishers.values()]
        observer.until(
            lambda: (
                all(end.get_subscription_count() >= readers for end in ends[1:])
                and self._clock.get_subscription_count()
            ),
            'the scheduler reads its inputs',
        )

    def publish(self, record):
        """Publish a record."""
        self._publishers[type(record)].publish(encode(record, RCLPY))

    def tell(self, time, status=TrajectoryStatus.IDLE, path_id='', epoch=0):
        """Publish time and state of a machine that rests at the origin."""
        stamp = nanoseconds(time)
        self.publish(
            AxisState(
                stamp=stamp,
                axis=AXES,
                reference=np.zeros(3),
                position=np.zeros(3),
                velocity=np.zeros(3),
            )
        )
        self.publish(
            TrajectoryState(
                stamp=stamp,
                path_id=path_id,
                epoch=epoch,
                part=0,
                status=int(status),
                reason='',
                arc_length=np.nan,
            )
        )
        self.publish(
            MachineState(
                stamp=stamp,
                state=3,
                homed=True,
                offsets_allowed=True,
                cold_since=SECOND,
                spindle_speed=0.0,
                axis=AXES,
                position=np.zeros(3),
            )
        )
        self._clock.publish(Clock(clock=RCLPY.time(stamp)))

    def send_path(self, time, name='trident'):
        """Publish a path."""
        self.publish(curve_tool_path(CURVE, path_id=name, feed=0.2, stamp=nanoseconds(time)))


@pytest.fixture
def change(observer):
    """Ask for a transition; tell whether it was carried out."""
    return partial(observer.change, NODE)


@pytest.fixture
def state(observer):
    """Ask for the lifecycle state."""
    return partial(observer.state, NODE)


@pytest.fixture
def program(observer):
    """Have a program scheduled."""

    def ask(text, **arguments):
        request = ScheduleProgram.Request(program=text, **arguments)
        again = math.inf if request.run else AGAIN  # a run that is asked for twice refuses itself
        return observer.call(ScheduleProgram, '/mill/schedule_program', request, again=again)

    return ask


def follow(observer, machine, parts, time, done):
    """Let time pass until something holds; return the time."""

    def passes():
        nonlocal time
        time += STEP
        machine.tell(time)
        observer.spin_for(PACE)
        observer.state(NODE)  # time does not run away from a scheduler that is not scheduled
        return done()

    observer.until(passes, f'not by {time} s of machine time, {len(parts)} parts')
    return time


def test_transitions_and_a_path(graph, observer, change, state):
    """Inactive it is silent; active it sends a path; deactivated it ends it at rest."""
    node = graph.start('feedrate_scheduler', {'use_sim_time': True, 'tolerance': 1e-6})
    parts = observer.records('trajectory', Trajectory)
    feeds = observer.records('feed_schedule', FeedSchedule)
    told = observer.records('node_configuration', NodeConfiguration, LATCHED)
    machine = Machine(observer)
    observer.until(lambda: told, 'tells its configuration')
    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert not change(Transition.TRANSITION_ACTIVATE)
    assert node.process.poll() is None
    assert change(Transition.TRANSITION_CONFIGURE)
    assert state() == State.PRIMARY_STATE_INACTIVE
    for time in (10.0, 10.1, 10.2):
        machine.tell(time)
        observer.settle(NODE)
    assert not parts

    assert change(Transition.TRANSITION_ACTIVATE)
    assert state() == State.PRIMARY_STATE_ACTIVE
    machine.send_path(10.3)
    time = follow(observer, machine, parts, 10.35, lambda: len(parts) >= 5 and len(feeds) >= 5)
    assert [part.part for part in parts] == list(range(len(parts)))
    assert parts[0].start >= nanoseconds(10.3)
    for before, after in pairwise(parts):
        assert after.start == before.start + before.committed * nanoseconds(before.period)
    assert {part.path_id for part in parts} == {'trident'}
    assert {part.epoch for part in parts} == {1}
    assert not any(part.last for part in parts)
    np.testing.assert_array_equal(parts[0].position[:2], 0.0)

    # A parameter that changes now is in what has not been sent yet.
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=0.5)
    request = SetParameters.Request(parameters=[Parameter(name='feed_override', value=value)])
    name = '/mill/feedrate_scheduler/set_parameters'
    assert observer.call(SetParameters, name, request, again=AGAIN).results[0].successful
    value.double_value = 3.0
    refused = observer.call(SetParameters, name, request).results[0]
    assert not refused.successful
    assert 'feed_override' in refused.reason
    time = follow(observer, machine, feeds, time, lambda: feeds[-1].feed_override == 0.5)

    assert change(Transition.TRANSITION_DEACTIVATE)
    observer.until(lambda: parts[-1].last, 'ends the path')
    assert np.abs(parts[-1].velocity[-2:]).max() < 1e-9
    count = len(parts)
    for _ in range(20):
        time += STEP
        machine.tell(time)
    observer.settle(NODE)
    assert len(parts) == count
    assert change(Transition.TRANSITION_CLEANUP)

    def states():
        return [state for state, _ in groupby(record.lifecycle_state for record in told)]

    expected = ['unconfigured', 'inactive', 'active', 'inactive', 'unconfigured']
    observer.until(lambda: states() == expected, f'all states, found {states()}')
    graph.stop()


def test_programs_by_service(graph, observer, state, program):
    """A program comes back with feeds, a broken one with its line; one that is run moves."""
    graph.start('feedrate_scheduler', {'use_sim_time': True, 'autostart': True})
    parts = observer.records('trajectory', Trajectory)
    machine = Machine(observer)
    observer.until(lambda: state() == State.PRIMARY_STATE_ACTIVE, 'active')
    text = 'G21 G0 X10\nG1 X20 F6000\nG2 X40 I10\nM30\n'
    found = program(text)
    assert found.success, found.message
    assert 's in all' in found.message
    assert found.duration > 0.5
    lines = found.program.splitlines()
    assert lines[0] == 'G21 G0 X10'
    assert lines[2].startswith('G2 X40 I10 F')

    broken = program(BAD_PROGRAM)
    assert not broken.success
    assert broken.message.startswith('line 3: ')
    assert broken.program == ''
    assert np.isnan(broken.duration)
    assert not program('').success

    machine.tell(20.0)
    observer.settle(NODE)
    assert program(text, path_id='part', run=True).success
    follow(observer, machine, parts, 20.05, lambda: bool(parts) and parts[-1].last)
    assert {part.path_id for part in parts} == {'part'}
    assert parts[0].start > nanoseconds(20.0)
    np.testing.assert_allclose(parts[-1].position[-3:], [0.04, 0.0, 0.0], atol=1e-12)
    again = program(text, path_id='other', run=True)
    assert not again.success
    assert 'part is being run' in again.message
    graph.stop()


def test_recording_of_a_live_run_replays(graph, observer, change, state, program, tmp_path):
    """A path, a program and a deactivation in real time: the same again, byte for byte."""
    bag = tmp_path / 'bag'
    recorder = graph.start('recorder', {'output': str(bag), 'use_sim_time': True})
    graph.start('feedrate_scheduler', {'use_sim_time': True, 'autostart': True})
    parts = observer.records('trajectory', Trajectory)
    machine = Machine(observer, readers=2)
    observer.until(lambda: state() == State.PRIMARY_STATE_ACTIVE, 'active')
    readers = {'/mill/trajectory': 2, '/mill/feed_schedule': 1}  # the recorder, and this test
    observer.until(
        lambda: all(observer.node.count_subscribers(name) == n for name, n in readers.items()),
        'the recorder reads what the scheduler says',
    )
    machine.tell(30.0)
    observer.settle(NODE, 'recorder')
    machine.send_path(30.1)
    time = follow(observer, machine, parts, 30.15, lambda: bool(parts) and parts[-1].last)
    for _ in range(2):
        time += 0.5
        machine.tell(time, TrajectoryStatus.FINISHED, 'trident', 1)
        observer.settle(NODE)
    assert not program('').success  # who is asked knows whom to answer
    assert program('G1 X90 F600\n', path_id='slow', run=True).success
    follow(
        observer,
        machine,
        parts,
        time + 0.05,
        lambda: parts[-1].path_id == 'slow' and parts[-1].part >= 2,
    )
    assert change(Transition.TRANSITION_DEACTIVATE)
    observer.until(lambda: parts[-1].last, 'ends the path')
    observer.settle(NODE, 'recorder')
    assert recorder.interrupt() == 0
    graph.stop()
    report = replay(bag, nodes=['feedrate_scheduler'])
    assert report.identical, [item for item in report.topics if not item.equal]
    found = {item.topic: item.recorded for item in report.topics}
    assert found == {'/mill/trajectory': len(parts), '/mill/feed_schedule': len(parts)}


def test_second_path_is_told_to_be_lost(graph, observer):
    graph.start('feedrate_scheduler', {'use_sim_time': True, 'autostart': True})
    observer.watch_diagnostics()
    parts = observer.records('trajectory', Trajectory)
    machine = Machine(observer)
    for time in (5.0, 5.1, 5.2):
        machine.tell(time)
        observer.settle(NODE)
    machine.send_path(5.3, 'first')
    time = follow(observer, machine, parts, 5.35, lambda: len(parts) >= 2)
    machine.send_path(time + 0.01, 'second')
    observer.until(
        lambda: observer.told(
            'mill/feedrate_scheduler: lost path', 'second refused: first is being run'
        ),
        f'says that a path is lost, found {observer.statuses}',
    )
    graph.stop()
