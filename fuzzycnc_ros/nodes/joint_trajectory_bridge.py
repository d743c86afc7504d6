# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `joint_trajectory_bridge`: the action, the topic and the frames of ROS's own motion tools.

`control_msgs` and `tf2_msgs` need not be installed: without the one goals come by the topic
alone, without the other nobody is told of frames, and the diagnostics say so.
"""

from collections.abc import Iterable
from importlib import import_module
from itertools import count
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fuzzycnc_ros.components.motion.joint_goal import GoalCode, goal_arguments
from fuzzycnc_ros.components.motion.joint_trajectory_bridge import (
    GoalResult,
    JointStates,
    JointTrajectoryBridge,
)
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.streaming_node import StreamingNode
from fuzzycnc_ros.ros.topics import RCLPY, SUBSCRIPTION_DEPTH
from fuzzycnc_ros.runtime.component import Answer, Emission, Health, Level
from fuzzycnc_ros.runtime.records import Floats

FEEDBACK = 0.05
"""Wall time [s] between two feedbacks."""
FRAMES_DEPTH = 100
"""Frames that are kept for a slow reader, as tf2's own broadcasters do."""


class JointTrajectoryBridgeNode(StreamingNode):
    """Serve the bridge, its action and its topic, and tell the frames."""

    component: JointTrajectoryBridge

    def __init__(self) -> None:
        super().__init__(JointTrajectoryBridge)
        self._handles: dict[str, tuple[ServerGoalHandle, Future]] = {}
        self._number = count(1)
        self._server: ActionServer | None = None
        self.node.create_subscription(
            JointTrajectory, 'joint_trajectory', self._on_trajectory, SUBSCRIPTION_DEPTH
        )
        actions, frames = _optional('control_msgs.action'), _optional('tf2_msgs.msg')
        if actions is not None:
            self._kind = actions.FollowJointTrajectory
            self._server = ActionServer(
                self.node,
                self._kind,
                'follow_joint_trajectory',
                self._execute,
                cancel_callback=self._on_cancel,
            )
            self._timer = wall_timer(self.node, FEEDBACK, self._feed_back)
            self._timer.cancel()  # it runs while there is a goal
        self._frames: Any = None
        if frames is not None:
            self._transforms = frames.TFMessage
            self._frames = self.node.create_publisher(frames.TFMessage, '/tf', FRAMES_DEPTH)
            fixed = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._fixed = self.node.create_publisher(frames.TFMessage, '/tf_static', fixed)

    def start(self) -> None:
        """Tell where the workpiece lies, then start as every node."""
        super().start()
        if self._frames is not None:
            component = self.component
            place = component.configuration.workpiece_offset
            item = _transform(
                component.frame('machine'), component.frame('workpiece'), place, self.now()
            )
            self._fixed.publish(self._transforms(transforms=[item]))

    def stop(self) -> None:
        """Release the action."""
        if self._server is not None:
            self._server.destroy()
        super().stop()

    def publish(self, emissions: Iterable[Emission]) -> None:
        """Publish what the component emitted, where the tool is, and which goals have ended."""
        emissions = list(emissions)
        super().publish(emissions)
        for emission in emissions:
            if self._frames is not None and isinstance(emission.record, JointStates):
                joints, component = emission.record, self.component
                item = _transform(
                    component.frame('workpiece'),
                    component.frame('tool'),
                    component.tool(joints),
                    joints.stamp,
                )
                self._frames.publish(self._transforms(transforms=[item]))
        self._tell_outcomes()

    def request(self, name: str, arguments: Any) -> Answer:
        """Carry out a request; tell which goals it has ended."""
        answer = super().request(name, arguments)
        self._tell_outcomes()
        return answer

    def own_health(self) -> list[Health]:
        """Report what is not served because its messages are not installed."""
        found = []
        for name, there, package in (
            ('action', self._server is not None, 'control_msgs'),
            ('frames', self._frames is not None, 'tf2_msgs'),
        ):
            text = f'off: {package} is not installed; apt-get install ros-jazzy-' + (
                package.replace('_', '-')
            )
            found.append(Health(name, Level.OK, 'served' if there else text))
        return found

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self.request('follow', goal_arguments(f'topic {next(self._number)}', message))

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        asked, name = handle.request, bytes(handle.goal_id.uuid).hex()
        finished = Future(executor=self.node.executor)
        self._handles[name] = handle, finished
        self._timer.reset()
        if asked.multi_dof_trajectory.joint_names or asked.multi_dof_trajectory.points:
            text = (
                'multi_dof_trajectory: expected none, since each joint is an axis, but found one'
            )
            self._note(GoalResult(name, GoalCode.INVALID_JOINTS, text))
        elif asked.component_path_tolerance or asked.component_goal_tolerance:
            text = 'component tolerances: expected none, since no joint has components'
            self._note(GoalResult(name, GoalCode.INVALID_GOAL, text))
        else:
            arguments = goal_arguments(
                name,
                asked.trajectory,
                asked.path_tolerance,
                asked.goal_tolerance,
                asked.goal_time_tolerance,
            )
            self.request('follow', arguments)
        outcome = await finished
        del self._handles[name]
        if not self._handles:
            self._timer.cancel()
        if outcome.cancelled and handle.is_cancel_requested:
            handle.canceled()
        elif outcome.code is GoalCode.SUCCESSFUL:
            handle.succeed()
        else:
            handle.abort()
        return self._kind.Result(error_code=int(outcome.code), error_string=outcome.text)

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        answer = self.request('cancel', {'goal': bytes(handle.goal_id.uuid).hex()})
        return CancelResponse.ACCEPT if answer.success else CancelResponse.REJECT

    def _tell_outcomes(self) -> None:
        for outcome in self.component.take_outcomes():
            self._note(outcome)

    def _note(self, outcome: GoalResult) -> None:
        """Tell the sender of a goal how it ended; of the topic's, the log."""
        if outcome.goal in self._handles:
            self._handles[outcome.goal][1].set_result(outcome)
        logger = self.node.get_logger()
        text = f'goal {outcome.goal}: {outcome.code.name}, {outcome.text}'
        # Two calls: rclpy refuses another severity from the same line.
        if outcome.code is GoalCode.SUCCESSFUL:
            logger.info(text)
        else:
            logger.warning(text)

    def _feed_back(self) -> None:
        """Tell the sender of the goal that is followed where the joints are."""
        progress = self.component.progress
        if progress is None or progress.goal not in self._handles:
            return
        desired, actual = progress.desired, progress.actual
        feedback = self._kind.Feedback(
            header=RCLPY.header(progress.stamp, self.component.frame('workpiece')),
            joint_names=list(progress.joints),
            desired=_point(*desired),
            actual=_point(*actual),
            error=_point(desired[0] - actual[0], desired[1] - actual[1]),
        )
        if hasattr(feedback, 'index'):  # not in the messages of early releases of Jazzy
            feedback.index = progress.point
        self._handles[progress.goal][0].publish_feedback(feedback)


def _optional(module: str) -> Any:
    """Return a module of messages; None where its package is not installed."""
    try:
        return import_module(module)
    except ModuleNotFoundError:
        return None


def _point(position: Floats, velocity: Floats) -> JointTrajectoryPoint:
    return JointTrajectoryPoint(positions=position.tolist(), velocities=velocity.tolist())


def _transform(parent: str, child: str, place: Iterable[float], stamp: int) -> TransformStamped:
    """Return a frame that is shifted against another [m], at a time [ns]."""
    item = TransformStamped(header=RCLPY.header(stamp, parent), child_frame_id=child)
    shift = item.transform.translation
    shift.x, shift.y, shift.z = (float(value) for value in place)
    return item


def make() -> JointTrajectoryBridgeNode:
    """Create the node."""
    return JointTrajectoryBridgeNode()


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
