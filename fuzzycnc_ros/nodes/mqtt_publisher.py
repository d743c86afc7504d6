# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `mqtt_publisher`: what a machine does, once a second, to a broker of MQTT."""

import json
import logging
import time
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from fuzzycnc_ros.components.report.machine_report import SOURCES, MachineReport
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.ros.plain_node import PlainNode
from fuzzycnc_ros.ros.topics import create_subscription, subscription_qos
from fuzzycnc_ros.runtime.component import STREAM, Health, Level
from fuzzycnc_ros.runtime.convert import decode
from fuzzycnc_ros.runtime.host import MqttPublisherConfig

PERIOD = 1.0
"""Wall time [s] between two reports."""
TURN = 0.1
"""Wall time [s] between two looks at what the broker has confirmed."""


class MqttPublisherNode(PlainNode[MqttPublisherConfig]):
    """Gather what the nodes of a machine publish, and hand it to the broker."""

    def __init__(self, node: Node) -> None:
        super().__init__(node, MqttPublisherConfig)
        if not self._config.broker_file:
            raise ParameterError('parameter broker_file: expected a file that names the broker')
        self._namespace = node.get_namespace().strip('/')
        machine = self._namespace or 'machine'
        self._report = MachineReport(machine)
        logging.getLogger('paho').setLevel(logging.CRITICAL + 1)
        try:
            # Needs pydantic, which nobody else has to have.
            from fuzzycnc_ros.adapters.mqtt.broker_file import read_broker
            from fuzzycnc_ros.adapters.mqtt.connection import BrokerConnection

            broker = read_broker(Path(self._config.broker_file).expanduser())
            self._connection = BrokerConnection(broker, machine)
        except ParameterError as error:
            raise ParameterError(f'parameter broker_file: {error}') from error
        for topic, record in SOURCES.items():
            create_subscription(
                node,
                record.TYPE,
                topic,
                self._taker(topic, record),
                subscription_qos(STREAM),
            )
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 100)
        wall_timer(node, PERIOD, self._tell)
        wall_timer(node, TURN, self._connection.turn)

    @property
    def done(self) -> bool:
        """Never: a broker that is away comes back."""
        return False

    def start(self) -> None:
        """Do nothing: the connection is made meanwhile."""

    def stop(self) -> None:
        """End the connection."""
        self._connection.close()

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
        self._connection.publish(json.dumps(document, allow_nan=False))
        self._publish_health([self._connection.health()])


def make() -> MqttPublisherNode:
    """Create the node."""
    return MqttPublisherNode(Node('mqtt_publisher'))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
