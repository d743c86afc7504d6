# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""An operator at a live graph: calls services and actions and waits for their answers."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import rclpy
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter

from fuzzycnc_msgs.action import TrainThermalModel
from fuzzycnc_msgs.srv import ForgetThermalPosterior, SelectSensors, SetThermalReference
from fuzzycnc_ros.files.uninterrupted import uninterrupted
from fuzzycnc_ros.ros.lifecycle import REACHED
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.processes import prepare_environment
from fuzzycnc_ros.ros.topics import RCLPY, create_publisher, create_subscription, subscription_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.records import Record

DISCOVERY_TIMEOUT = 20.0
"""Wall time [s] until a node must be there."""
SETTLED = 0.5
"""Wall time [s] in which the nodes of this host find a new one."""
CALL_TIMEOUT = 120.0
"""Wall time [s] until a call must be answered."""
AGAIN = 3.0
"""Wall time [s] after which an answer may have been lost: on a busy computer a server that has not
found its client yet drops it."""

Progress = Callable[[str, str, int, int], None]


class OperatorClient:
    """A ROS node that acts for a person.

    Parameters
    ----------
    machine : str
        Name of the machine, the namespace of its nodes.
    alive : callable
        Called while waiting; raises if the graph has broken down.
    patience : float
        Wall time [s] until a node must be there.
    """

    def __init__(
        self,
        machine: str,
        alive: Callable[[], None] = lambda: None,
        patience: float = DISCOVERY_TIMEOUT,
    ) -> None:
        prepare_environment()
        self._alive = alive
        self._patience = patience
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node(
            'operator', namespace=f'/{machine.strip("/")}', context=self.context
        )
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def __enter__(self) -> 'OperatorClient':
        """Return the operator."""
        return self

    def __exit__(self, *error: object) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def spin_until(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Handle messages until a condition holds.

        Raises
        ------
        GraphError
            If it does not hold in time.
        """
        until = time.monotonic() + timeout
        while not condition():
            self._alive()
            if time.monotonic() > until:
                raise GraphError(f'{what}: nothing within {timeout:g} s')
            self.spin_once(0.1)

    def spin_once(self, timeout: float) -> None:
        """Handle one message, or return after `timeout` [s]."""
        with uninterrupted():  # where a message is made of bytes, a wish to end gets lost
            self._executor.spin_once(timeout_sec=timeout)

    def has_publisher(self, topic: str) -> bool:
        """Return True if another node publishes a topic of the machine, or an absolute one."""
        return self.node.count_publishers(topic) > 0

    def publishers(self, topic: str) -> list[Any]:
        """Return what is known of the publishers of an absolute topic."""
        return list(self.node.get_publishers_info_by_topic(topic))

    def newest(self, record: type[Record], topic: str) -> Record:
        """Return the next record of a topic, the newest of a latched one.

        Raises
        ------
        GraphError
            If none comes in time.
        """
        heard: list[Any] = []
        subscription = create_subscription(
            self.node,
            record.TYPE,
            topic,
            heard.append,
            subscription_qos(Durability.STREAM),
        )
        try:
            self.spin_until(lambda: bool(heard), self._patience, f'topic {topic}')
        finally:
            self.node.destroy_subscription(subscription)
        return decode(record, heard[-1])

    def publish(
        self,
        record: Record,
        topic: str,
        durability: Durability = Durability.STREAM,
        heard: Callable[[], bool] = lambda: True,
    ) -> int:
        """Publish a record once, to all that read the topic; return how many they are.

        Parameters
        ----------
        record : Record
            What is published.
        topic : str
            Where.
        durability : Durability
            How the topic is offered.
        heard : callable
            Whether those read it who must.

        Raises
        ------
        GraphError
            If nobody reads it.
        """
        publisher = create_publisher(self.node, record.TYPE, topic, durability)
        try:
            self.spin_until(
                lambda: publisher.get_subscription_count() > 0 and heard(),
                self._patience,
                f'readers of topic {topic}',
            )
            self.pause(SETTLED)  # one reader is there, the others are about to be
            readers = int(publisher.get_subscription_count())
            publisher.publish(encode(record, RCLPY))
            self.spin_until(
                # A longer wait could not be interrupted.
                lambda: bool(publisher.wait_for_all_acked(Duration(seconds=0.1))),
                self._patience,
                f'confirmation of topic {topic} by its readers',
            )
            return readers
        finally:
            self.node.destroy_publisher(publisher)

    def pause(self, duration: float) -> None:
        """Handle messages for some wall time [s]."""
        until = time.monotonic() + duration
        while (left := until - time.monotonic()) > 0.0:
            self.spin_once(left)

    def transition(self, node: str, label: str) -> bool:
        """Ask a managed node for a transition; return whether it was carried out."""
        request = ChangeState.Request()
        request.transition.label = label
        answer = self._call(
            ChangeState,
            f'{node}/change_state',
            request,
            done=lambda: self.lifecycle(node) == REACHED[label],
        )
        # Somebody else may have asked for the same a moment before.
        return answer is None or answer.success or self.lifecycle(node) == REACHED[label]

    def lifecycle(self, node: str) -> str:
        """Return the state of a managed node, such as `active`."""
        answer = self._call(GetState, f'{node}/get_state', GetState.Request(), twice=True)
        return str(answer.current_state.label)

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> list[str]:
        """Set parameters of a node; return why they were refused, empty if taken."""
        request = parameter_request(values)
        return refusals(self._call(SetParameters, f'{node}/set_parameters', request, twice=True))

    def set_reference(self, by: str, *, force: bool = False) -> str:
        """Declare the machine thermally at rest; return what will happen.

        While offsets are in force it has to be forced.

        Raises
        ------
        GraphError
            If it is refused.
        """
        request = SetThermalReference.Request(set_by=by, force=force)
        answer = self._call(SetThermalReference, 'set_thermal_reference', request, twice=True)
        if not answer.success:
            raise GraphError(f'set_thermal_reference: {answer.message}')
        return str(answer.message)

    def forget(self, mode: int, *, why: str, by: str) -> str:
        """Know less of the thermal error than probes have taught; return what is known now.

        Raises
        ------
        GraphError
            If it is refused.
        """
        request = ForgetThermalPosterior.Request(mode=mode, why=why, by=by)
        answer = self._call(ForgetThermalPosterior, 'forget_thermal_posterior', request)
        if not answer.success:
            raise GraphError(f'forget: {answer.message}')
        return str(answer.message)

    def select_sensors(self, bags: Sequence[Path], clusters: int = 0) -> str:
        """Let the graph select its sensors; return what it says.

        Raises
        ------
        GraphError
            If it cannot.
        """
        request = SelectSensors.Request(bag=[str(bag) for bag in bags], clusters=clusters)
        answer = self._call(SelectSensors, 'select_sensors', request)
        if not answer.success:
            raise GraphError(f'select_sensors: {answer.message}')
        return str(answer.message)

    def train(
        self, bags: Sequence[Path], *, model: str, file: Path, progress: Progress | None = None
    ) -> str:
        """Let the graph train its thermal model; return what it says.

        Raises
        ------
        GraphError
            If it cannot.
        """
        client = ActionClient(self.node, TrainThermalModel, 'train_thermal_model')
        self.spin_until(client.server_is_ready, self._patience, 'action train_thermal_model')

        def on_feedback(message: Any) -> None:
            feedback = message.feedback
            if progress is not None:
                progress(feedback.stage, feedback.candidate, feedback.done, feedback.total)

        goal = TrainThermalModel.Goal(bag=[str(b) for b in bags], model=model, file=str(file))
        what = 'action train_thermal_model'
        handle = self._wait(client.send_goal_async(goal, feedback_callback=on_feedback), what)
        if not handle.accepted:
            raise GraphError(f'{what}: refused; a training is under way')
        result = self._wait(handle.get_result_async(), what).result
        if not result.success:
            raise GraphError(f'{what}: {result.message}')
        return str(result.message)

    def _call(
        self,
        kind: Any,
        name: str,
        request: Any,
        *,
        twice: bool = False,
        done: Callable[[], bool] = lambda: False,
    ) -> Any:
        """Call a service of the machine and return its answer.

        Where that is late it is called again if it may be called `twice`, and None is returned if
        what it is to do is `done`.
        """
        client = self.node.create_client(kind, name)
        try:
            self.spin_until(client.service_is_ready, self._patience, f'service {name}')
            calls = [client.call_async(request)]
            called_at = time.monotonic()

            def over() -> bool:
                nonlocal called_at
                late = time.monotonic() - called_at > AGAIN
                if late:
                    called_at = time.monotonic()
                    if twice:
                        calls.append(client.call_async(request))
                return any(call.done() for call in calls) or (late and done())

            self.spin_until(over, CALL_TIMEOUT, f'service {name}')
            return next((call.result() for call in calls if call.done()), None)
        finally:
            self.node.destroy_client(client)

    def _wait(self, future: Any, what: str) -> Any:
        self.spin_until(future.done, CALL_TIMEOUT, what)
        return future.result()


def parameter_request(values: Mapping[str, Any]) -> SetParameters.Request:
    """Return the request that sets parameters of a node."""
    given = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    return SetParameters.Request(parameters=given)


def refusals(answer: SetParameters.Response) -> list[str]:
    """Return why parameters were refused, empty if they were taken."""
    return [item.reason or 'refused' for item in answer.results if not item.successful]
