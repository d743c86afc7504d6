# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""An operator at a live graph: calls services and actions and waits for their answers."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor

from fuzzycnc_msgs.action import TrainThermalModel
from fuzzycnc_msgs.srv import SelectSensors
from fuzzycnc_ros.cli.graph_processes import GraphError
from fuzzycnc_ros.nodes.environment import prepare_environment

DISCOVERY_TIMEOUT = 20.0
"""Wall time [s] until a node must be there."""
CALL_TIMEOUT = 120.0
"""Wall time [s] until a call must be answered."""

Progress = Callable[[str, str, int, int], None]


class Operator:
    """A ROS node that acts for a person.

    Parameters
    ----------
    machine : str
        Name of the machine, the namespace of its nodes.
    alive : callable
        Called while waiting; raises if the graph has broken down.
    """

    def __init__(self, machine: str, alive: Callable[[], None] = lambda: None) -> None:
        prepare_environment()
        self._alive = alive
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node(
            'operator', namespace=f'/{machine.strip("/")}', context=self.context
        )
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def __enter__(self) -> 'Operator':
        """Return the operator."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
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
            self._executor.spin_once(timeout_sec=0.1)

    def spin_once(self, timeout: float) -> None:
        """Handle one message, or return after `timeout` [s]."""
        self._executor.spin_once(timeout_sec=timeout)

    def select_sensors(self, bags: Sequence[Path], clusters: int = 0) -> str:
        """Let the graph select its sensors; return what it says.

        Raises
        ------
        GraphError
            If it cannot.
        """
        client = self.node.create_client(SelectSensors, 'select_sensors')
        self.spin_until(client.service_is_ready, DISCOVERY_TIMEOUT, 'service select_sensors')
        request = SelectSensors.Request(bag=[str(bag) for bag in bags], clusters=clusters)
        answer = self._wait(client.call_async(request), 'service select_sensors')
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
        self.spin_until(client.server_is_ready, DISCOVERY_TIMEOUT, 'action train_thermal_model')

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

    def _wait(self, future: Any, what: str) -> Any:
        self.spin_until(future.done, CALL_TIMEOUT, what)
        return future.result()
