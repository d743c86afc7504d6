# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `mqtt_publisher`: what a machine does, once a second, to a broker of MQTT."""

import json
import logging
from pathlib import Path
from typing import Any

from rclpy.node import Node

from fuzzycnc_ros.adapters.report_node import ReportNode
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.node_config import MqttPublisherConfig
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.component import Health

TURN = 0.1
"""Wall time [s] between two looks at what the broker has confirmed."""


class MqttPublisherNode(ReportNode[MqttPublisherConfig]):
    """Hand what the nodes of a machine publish to the broker."""

    def __init__(self, node: Node) -> None:
        super().__init__(node, MqttPublisherConfig)
        if not self._config.broker_file:
            raise ParameterError('parameter broker_file: expected a file that names the broker')
        logging.getLogger('paho').setLevel(logging.CRITICAL + 1)
        try:
            # Needs pydantic, which nobody else has to have.
            from fuzzycnc_ros.adapters.mqtt.broker_file import read_broker
            from fuzzycnc_ros.adapters.mqtt.connection import BrokerConnection

            broker = read_broker(Path(self._config.broker_file).expanduser())
            self._connection = BrokerConnection(broker, self._machine)
        except ParameterError as error:
            raise ParameterError(f'parameter broker_file: {error}') from error
        self._gather()
        wall_timer(node, TURN, self._connection.turn)

    def stop(self) -> None:
        """End the connection."""
        self._connection.close()

    def _hand_on(self, document: dict[str, Any]) -> Health:
        self._connection.publish(json.dumps(document, allow_nan=False))
        return self._connection.health()


def make() -> MqttPublisherNode:
    """Create the node."""
    return MqttPublisherNode(Node('mqtt_publisher'))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
