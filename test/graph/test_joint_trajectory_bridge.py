# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Joint trajectories on the simulated machine: by topic, and by action where it has messages."""

import json

import numpy as np
import pytest
import ros_messages
from action_msgs.msg import GoalStatus
from aggregator import matching
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import TransformStamped
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, Temperature
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fuzzycnc_ros.components.motion.joint_goal import GoalCode
from fuzzycnc_ros.ros.topics import RCLPY
from fuzzycnc_ros.runtime.component import HISTORY
from fuzzycnc_ros.runtime.host import NodeEvent
from fuzzycnc_ros.runtime.records import SECOND, MachineState

pytestmark = pytest.mark.ros

AHEAD = {'lead': 1.0, 'chunk': 0.5}
"""So early that a busy computer is never late."""
READINGS = {'interval': 1.0, 'named_topics': True, 'use_sim_time': True}


def start(graph, *others, **parameters):
    """Start the bridge and a machine that tells of itself twice a second, once all are there."""
    graph.start(
        'joint_trajectory_bridge',
        {'use_sim_time': True, 'autostart': True, **AHEAD, **parameters},
    )
    awaited = ['joint_trajectory_bridge', *others]
    graph.start(
        'simulated_machine',
        {'duties': ['T2'], 'tick_period': 0.5, 'rate': 0.5, 'lockstep_nodes': awaited},
    )


def trajectory(joints, *points, stamp=0):
    """Return a trajectory through points at (s, m, m, ...)."""
    return JointTrajectory(
        header=RCLPY.header(stamp, ''),
        joint_names=list(joints),
        points=[
            JointTrajectoryPoint(positions=list(place), time_from_start=duration(time))
            for time, *place in points
        ],
    )


def duration(time):
    """Return a time [s] as ROS has it."""
    return Duration(sec=int(time), nanosec=int(time % 1.0 * 1e9))


def heard(observer, kind, topic, qos=100):
    """Return a list that grows with the messages of a topic."""
    found = []
    observer.node.create_subscription(kind, topic, found.append, qos)
    return found


def test_goal_of_the_topic_moves_the_axes_and_sensors_have_names(graph, observer):
    joints = heard(observer, JointState, 'joint_states')
    bearing = heard(observer, Temperature, 'temperature/T1')
    events = observer.records('node_event', NodeEvent, HISTORY)
    observer.watch_diagnostics()
    goals = observer.node.create_publisher(JointTrajectory, 'joint_trajectory', 10)
    graph.start('temperature_acquisition', READINGS)
    start(graph, 'temperature_acquisition', joints=['mill_x', 'mill_y', 'mill_z'])
    observer.until(lambda: joints and goals.get_subscription_count(), 'joint states')
    assert list(joints[-1].name) == ['mill_x', 'mill_y', 'mill_z']
    assert joints[-1].header.frame_id == 'mill/workpiece'

    goals.publish(trajectory(['mill_q'], (1.0, 0.02)))
    item = 'mill/joint_trajectory_bridge: goal'
    observer.until(lambda: observer.told(item, 'topic 1: INVALID_JOINTS'), 'a refusal')
    goals.publish(trajectory(['mill_z', 'mill_x'], (0.5, -0.005, 0.01), (1.0, -0.01, 0.02)))
    observer.until(lambda: observer.told(item, 'topic 2: SUCCESSFUL, arrived'), 'the end')
    observer.until(lambda: abs(joints[-1].position[0] - 0.02) < 1e-4, 'the place')
    way = np.array([item.position for item in joints])
    assert np.abs(way[-1] - [0.02, 0.0, -0.01]).max() < 1e-4
    assert way[:, 0].max() < 0.02 + 1e-4
    (followed,) = [json.loads(item.request) for item in events if item.name == 'follow']
    assert followed['joint'] == ['mill_z', 'mill_x']

    observer.until(lambda: len(bearing) > 1, 'a sensor by its name')
    assert 10.0 < bearing[-1].temperature < 50.0
    assert bearing[-1].header.frame_id == 'mill/machine'
    # The example for diagnostic_aggregator has a place for all that is told.
    names = ['temperature_acquisition', 'joint_trajectory_bridge', 'simulated_machine']
    told = {f'mill/{name}: activity' for name in names}
    observer.until(lambda: told <= observer.statuses.keys(), 'diagnostics of all nodes')
    places = {name: matching(name) for name in observer.statuses}
    alive = '/Machines/mill/Alive'
    assert {name for name, found in places.items() if len({*found} - {alive}) != 1} == set()
    assert alive in places['mill/temperature_acquisition: activity']
    graph.stop()


@pytest.fixture(scope='module')
def messages_of_ros(tmp_path_factory):
    """Messages that no wheel has are there."""
    with ros_messages.installed(ros_messages.build(tmp_path_factory.mktemp('messages'))):
        yield


class Client:
    """A client of the action that notes the feedback."""

    def __init__(self, observer):
        from control_msgs.action import FollowJointTrajectory
        from control_msgs.msg import JointTolerance

        self.kind, self.tolerance = FollowJointTrajectory, JointTolerance
        self.feedback = []
        self._observer = observer
        self._client = ActionClient(observer.node, self.kind, 'follow_joint_trajectory')
        observer.until(self._client.server_is_ready, 'the action')

    def send(self, *goal, **options):
        """Send a goal; return its handle."""
        stamp = options.pop('stamp', 0)
        future = self._client.send_goal_async(
            self.kind.Goal(trajectory=trajectory(*goal, stamp=stamp), **options),
            feedback_callback=lambda message: self.feedback.append(message.feedback),
        )
        self._observer.until(future.done, 'answer to the goal')
        assert future.result().accepted
        return future.result()

    def result(self, handle):
        """Wait for the end of a goal; return its status, code and text."""
        future = handle.get_result_async()
        self._observer.until(future.done, 'end of the goal')
        answer = future.result()
        return answer.status, GoalCode(answer.result.error_code), answer.result.error_string

    def cancel(self, handle):
        """Cancel a goal."""
        future = handle.cancel_goal_async()
        self._observer.until(future.done, 'answer to the cancellation')
        return bool(future.result().goals_canceling)

    def close(self):
        """Leave the graph."""
        self._client.destroy()


@pytest.mark.slow
def test_action_and_frames(graph, observer, messages_of_ros):
    """Each result code, feedback, a goal that is cancelled and one that is replaced; /tf."""
    from tf2_msgs.msg import TFMessage

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    moving = heard(observer, TFMessage, '/tf')
    fixed = heard(observer, TFMessage, '/tf_static', latched)
    states = observer.records('machine_state', MachineState)
    start(graph, workpiece_offset=[0.1, 0.2, 0.3], age_max=1.0)
    observer.until(lambda: moving and fixed and states, 'frames and the machine')
    client = Client(observer)
    try:
        follow_goals(observer, client, states)
    finally:
        client.close()
    (frame,) = fixed[-1].transforms
    assert (frame.header.frame_id, frame.child_frame_id) == ('mill/machine', 'mill/workpiece')
    assert shift(frame) == [0.1, 0.2, 0.3]
    (frame,) = moving[-1].transforms
    assert (frame.header.frame_id, frame.child_frame_id) == ('mill/workpiece', 'mill/tool')
    assert frame.transform.rotation.w == 1.0
    assert max(shift(item.transforms[0])[0] for item in moving) == pytest.approx(0.02, abs=1e-3)
    graph.stop()


def follow_goals(observer, client, states):
    """Send goals that end in every way."""
    status, code, text = client.result(client.send('XY', (0.5, 0.01, 0.0), (1.0, 0.02, 0.01)))
    assert (status, code, text) == (
        GoalStatus.STATUS_SUCCEEDED,
        GoalCode.SUCCESSFUL,
        'arrived',
    )
    told = client.feedback
    assert list(told[-1].joint_names) == ['X', 'Y']
    wanted, found, off = (
        [list(getattr(item, name).positions) for item in told]
        for name in ('desired', 'actual', 'error')
    )
    np.testing.assert_allclose(np.array(wanted) - found, off, atol=1e-12)
    assert 0.0 < wanted[len(told) // 2][0] < 0.02 or len(told) < 4

    old = states[-1].stamp - 60 * SECOND
    for goal, options, expected in (
        (('Q', (1.0, 0.0)), {}, GoalCode.INVALID_JOINTS),
        (('X', (0.01, 0.0)), {}, GoalCode.INVALID_GOAL),
        (('X', (1.0, 0.0)), {'stamp': old}, GoalCode.OLD_HEADER_TIMESTAMP),
        (
            ('X', (1.0, 0.0)),
            {'path_tolerance': [client.tolerance(name='X', position=1e-6)]},
            GoalCode.PATH_TOLERANCE_VIOLATED,
        ),
        (
            ('Y', (1.0, 0.0)),
            {
                'goal_tolerance': [client.tolerance(name='Y', position=1e-15)],
                'goal_time_tolerance': duration(0.2),
            },
            GoalCode.GOAL_TOLERANCE_VIOLATED,
        ),
    ):
        status, code, text = client.result(client.send(*goal, **options))
        assert (status, code) == (GoalStatus.STATUS_ABORTED, expected), text
        assert text

    client.feedback.clear()
    first = client.send('X', (20.0, 0.01))
    observer.until(lambda: client.feedback, 'feedback')
    second = client.send('X', (20.0, 0.015))
    status, code, text = client.result(first)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, GoalCode.INVALID_GOAL)
    assert text.startswith('replaced by the newer goal')
    client.feedback.clear()
    observer.until(lambda: client.feedback, 'feedback')
    assert client.cancel(second)
    status, code, _ = client.result(second)
    assert (status, code) == (GoalStatus.STATUS_CANCELED, GoalCode.SUCCESSFUL)


def shift(frame: TransformStamped):
    """Return how far a frame is from its parent [m]."""
    place = frame.transform.translation
    return [place.x, place.y, place.z]
