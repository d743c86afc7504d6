# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Base of the nodes that hand the report of a machine to systems without ROS."""

import time
from abc import abstractmethod
from collections.abc import Callable
from datetime import datetime, timezone
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from fuzzycnc_ros.components.report.machine_report import SOURCES, MachineReport
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.configured_node import ConfiguredNode
from fuzzycnc_ros.ros.node_config import ExecutorConfig
from fuzzycnc_ros.ros.topics import create_subscription, subscription_qos
from fuzzycnc_ros.runtime.component import STREAM, Health, Level
from fuzzycnc_ros.runtime.convert import decode

PERIOD = 1.0
"""Wall time [s] between two reports."""

C = TypeVar('C', bound=ExecutorConfig)


class ReportNode(ConfiguredNode[C], Generic[C]):
    """Gather what the nodes of a machine publish; hand it on once a second.

    Parameters
    ----------
    node : Node
        The node, in the namespace of the machine.
    record : type of Config
        Its parameters.
    """

    def __init__(self, node: Node, record: type[C]) -> None:
        super().__init__(node, record)
        self._namespace = node.get_namespace().strip('/')
        self._machine = self._namespace or 'machine'
        self._report = MachineReport(self._machine)

    @property
    def done(self) -> bool:
        """Never: who is told may come back."""
        return False

    def start(self) -> None:
        """Do nothing: connections are made meanwhile."""

    @abstractmethod
    def stop(self) -> None:
        """End the connections."""

    @abstractmethod
    def _hand_on(self, document: dict[str, Any]) -> Health:
        """Hand a report on; say how that goes."""

    def _gather(self) -> None:
        """Begin."""
        for topic, record in SOURCES.items():
            create_subscription(
                self.node,
                record.TYPE,
                topic,
                self._taker(topic, record),
                subscription_qos(STREAM),
            )
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 100)
        wall_timer(self.node, PERIOD, self._tell)

    def _taker(self, topic: str, record: Any) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            self._report.take(topic, decode(record, message), time.monotonic())

        return take

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        found: dict[str, list[Health]] = {}
        for status in array.status:
            whose, _, name = status.name.partition(': ')
            namespace, _, node = whose.rpartition('/')
            if namespace == self._namespace:
                level = Level(min(status.level[0], Level.ERROR))
                found.setdefault(node, []).append(Health(name, level, status.message))
        for node, items in found.items():
            self._report.take_health(node, items, time.monotonic())

    def _tell(self) -> None:
        now = datetime.now(timezone.utc).isoformat(timespec='milliseconds')
        document = self._report.document(now, time.monotonic())
        self._publish_health([self._hand_on(document)])
