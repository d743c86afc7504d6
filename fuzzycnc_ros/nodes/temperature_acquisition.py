# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `temperature_acquisition`: drivers bring readings, the component checks and averages."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import Temperature

from fuzzycnc_msgs.srv import SetThermalReference
from fuzzycnc_ros.adapters.readings.open_source import open_source
from fuzzycnc_ros.components.thermal.temperature_acquisition import (
    TemperatureAcquisition,
)
from fuzzycnc_ros.core.names import topic_words
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.host import ComponentNode
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.ros.topics import RCLPY, create_publisher
from fuzzycnc_ros.runtime.component import STREAM, Emission, Health
from fuzzycnc_ros.runtime.enums import Status
from fuzzycnc_ros.runtime.records import Temperatures


class TemperatureAcquisitionNode(ComponentNode):
    """Serve the acquisition, its drivers and the service `set_thermal_reference`."""

    def __init__(self, node: Node) -> None:
        super().__init__(node, TemperatureAcquisition)
        config = self.component.configuration
        if self.settings.lockstep and config.source != 'topic':
            # A driver brings readings when it has them; turns cannot announce them.
            raise ParameterError(
                f'parameter source = {config.source}: in lock-step readings come from the topic '
                'sensor_readings; import a file with `fuzzycnc import-csv` and play the bag'
            )
        self._named: dict[str, Any] = {}
        self._source = open_source(node, config, self.component.frame('machine'))
        if self._source.makes_time:
            self._ahead_max = 0  # the next row of a file may be hours on
        if own := self._source.sensor_limits:
            limits = (*own, *config.sensor_limits)
            self.component.reconfigure(replace(config, sensor_limits=limits))
        node.create_service(SetThermalReference, 'set_thermal_reference', self._on_reference)

    def now(self) -> int:
        """Return machine time [ns]: a file that is played may have its own."""
        return self.merger.time if self._source.makes_time else super().now()

    def stop(self) -> None:
        """Release the driver, then the node."""
        self._source.close()
        super().stop()

    def publish(self, emissions: Iterable[Emission]) -> None:
        """Publish what the component emitted, and each sensor by its name if that is wanted."""
        emissions = list(emissions)
        super().publish(emissions)
        if self.component.configuration.named_topics:
            for emission in emissions:
                record = emission.record
                if emission.output == 'temperatures' and isinstance(record, Temperatures):
                    self._publish_named(record)

    def _publish_named(self, sample: Temperatures) -> None:
        """Publish a sample sensor by sensor; what is not to be believed is no number there."""
        if self._named.keys() != {*sample.sensor}:
            for publisher in self._named.values():
                self.node.destroy_publisher(publisher)
            self._named = {
                name: create_publisher(
                    self.node, 'sensor_msgs/msg/Temperature', f'temperature/{word}', STREAM
                )
                for name, word in topic_words(sample.sensor).items()
            }
        header = RCLPY.header(sample.stamp, sample.frame_id)
        values = zip(sample.sensor, sample.temperature, sample.status, strict=True)
        for name, value, status in values:
            known = float(value) if status == Status.OK else float('nan')
            self._named[name].publish(Temperature(header=header, temperature=known))

    def own_health(self) -> list[Health]:
        """Report on what the driver reads."""
        return self._source.health()

    def _on_reference(
        self, request: SetThermalReference.Request, response: SetThermalReference.Response
    ) -> SetThermalReference.Response:
        arguments = {'set_by': request.set_by, 'force': request.force}
        answer = self.request('set_thermal_reference', arguments)
        response.success, response.message = answer.success, answer.message
        return response


def make() -> TemperatureAcquisitionNode:
    """Create the node."""
    return TemperatureAcquisitionNode(Node(TemperatureAcquisition.NAME))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
