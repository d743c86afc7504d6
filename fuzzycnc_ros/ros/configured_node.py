# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of the nodes without a component: parameters and health."""

from collections.abc import Sequence
from typing import Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from fuzzycnc_ros.ros.health import diagnostic_array
from fuzzycnc_ros.ros.node_config import ExecutorConfig
from fuzzycnc_ros.ros.parameters import declare
from fuzzycnc_ros.runtime.component import Health

C = TypeVar('C', bound=ExecutorConfig)


class ConfiguredNode(Generic[C]):
    """Base of the nodes without a component: their parameters, what they say of themselves.

    Parameters
    ----------
    node : Node
        The node.
    record : type of Config
        Its parameters.
    """

    exit_code = 0

    def __init__(self, node: Node, record: type[C]) -> None:
        self.node = node
        (config,) = declare(node, record)
        self._config = config
        self.executor = config.executor
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def _publish_health(self, health: Sequence[Health]) -> None:
        """Publish on /diagnostics how the node is."""
        name, now = self.node.get_fully_qualified_name(), self.node.get_clock().now()
        self._diagnostics.publish(diagnostic_array(name, '', health, {}, now.to_msg()))
