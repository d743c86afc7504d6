# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `linuxcnc_bridge`: compensation into the LinuxCNC of this computer."""

from fuzzycnc_ros.adapters.bridge_node import ControllerBridgeNode
from fuzzycnc_ros.adapters.controller import Controller
from fuzzycnc_ros.adapters.linuxcnc.control import Linuxcnc, LinuxcncError, linuxcnc_runs
from fuzzycnc_ros.adapters.linuxcnc.linuxcnc_bridge import LinuxcncBridge
from fuzzycnc_ros.adapters.linuxcnc.status import (
    ControllerOutput,
    LinuxcncStatus,
    ServoThreadLimits,
)
from fuzzycnc_ros.ros import run

SOON = 0.002
"""Wall time [s] between two cycles while LinuxCNC is on its way: the read-back comes sooner."""

LinuxcncController = Controller[LinuxcncStatus, ControllerOutput, ServoThreadLimits]


class LinuxcncBridgeNode(ControllerBridgeNode):
    """Serve the bridge and its connection to LinuxCNC."""

    component: LinuxcncBridge
    RETRY_FIRST = RETRY_MAX = 1.0

    def __init__(self) -> None:
        super().__init__(LinuxcncBridge)
        self._why = 'LinuxCNC does not run here'

    def start(self) -> None:
        """Look for LinuxCNC before anybody activates the node."""
        if not self.settings.lockstep:
            for _ in range(10):
                self._cycle()
        super().start()

    def _open(self) -> LinuxcncController:
        if not linuxcnc_runs():
            raise LinuxcncError('LinuxCNC does not run here')
        config = self.component.configuration
        controller = Linuxcnc(config.axes, config.interpreter)
        self.node.get_logger().info('connected to LinuxCNC')
        return controller

    def _wait(self) -> float:
        period = self.component.configuration.cycle_period
        return min(period, SOON) if self.component.moving else period

    def _before_activation(self, controller: LinuxcncController) -> str:
        return self._claim(controller)

    def _refusal(self, controller: LinuxcncController) -> str:
        status = controller.read()
        assert status is not None, 'LinuxCNC is read at once'
        return self.component.refusal(controller.limits(), status)


def make() -> LinuxcncBridgeNode:
    """Create the node."""
    return LinuxcncBridgeNode()


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
