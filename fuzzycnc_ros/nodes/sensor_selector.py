# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `sensor_selector`: service `select_sensors`, selection on a latched topic."""

from rclpy.node import Node

from fuzzycnc_msgs.srv import SelectSensors
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.components.thermal.sensor_selector import SensorSelector
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.host import ComponentNode


class SensorSelectorNode(ComponentNode):
    """Serve the selector and its service."""

    component: SensorSelector

    def __init__(self, node: Node) -> None:
        super().__init__(node, SensorSelector)
        self.component.prepare('', read_run)
        node.create_service(SelectSensors, 'select_sensors', self._on_select)

    def _on_select(
        self, request: SelectSensors.Request, response: SelectSensors.Response
    ) -> SelectSensors.Response:
        arguments = {'bag': list(request.bag), 'clusters': int(request.clusters)}
        answer = self.request('select_sensors', arguments)
        response.success, response.message = answer.success, answer.message
        return response


def make() -> SensorSelectorNode:
    """Create the node."""
    return SensorSelectorNode(Node(SensorSelector.NAME))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
