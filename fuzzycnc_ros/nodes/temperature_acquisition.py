# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `temperature_acquisition`: drivers bring readings, the component checks and averages."""

from rclpy.node import Node

from fuzzycnc_msgs.srv import SetThermalReference
from fuzzycnc_ros.adapters.readings.open_source import open_source
from fuzzycnc_ros.components.thermal.temperature_acquisition import (
    TemperatureAcquisition,
)
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.host import ComponentNode
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.component import Health


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
        self._source = open_source(node, config, self.component.frame('machine'))
        node.create_service(SetThermalReference, 'set_thermal_reference', self._on_reference)

    def stop(self) -> None:
        """Release the driver, then the node."""
        self._source.close()
        super().stop()

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
