# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `opcua_bridge`: compensation into a control that exposes variables by OPC UA.

The connection lives in a thread of its own: the node never waits for the network.
"""

import logging
import os
import socket
from pathlib import Path

from fuzzycnc_ros.adapters.bridge_node import ControllerBridgeNode
from fuzzycnc_ros.adapters.controller import Controller
from fuzzycnc_ros.adapters.link import LinkError
from fuzzycnc_ros.adapters.opcua.control import ControlFile, OpcUaControl
from fuzzycnc_ros.adapters.opcua.offset_lines import LineLimits, LineOrders, LineStatus
from fuzzycnc_ros.adapters.opcua.opcua_bridge import OpcuaBridge
from fuzzycnc_ros.adapters.opcua.session import library_trouble
from fuzzycnc_ros.adapters.threaded import ThreadedController
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.parameters import ParameterError

LOOK = 0.01
"""Wall time [s] between two looks at what the thread has brought."""

LineController = Controller[LineStatus, LineOrders, LineLimits]


class OpcuaBridgeNode(ControllerBridgeNode):
    """Serve the bridge and its connection to the control."""

    component: OpcuaBridge
    RETRY_FIRST, RETRY_MAX = 0.25, 2.0

    def __init__(self) -> None:
        super().__init__(OpcuaBridge)
        self._file = self._read_file()
        # What the library has to say is in the health, in the operator's words.
        logging.getLogger('asyncua').setLevel(logging.CRITICAL + 1)
        self._name = f'{self.node.get_fully_qualified_name()} {socket.gethostname()} {os.getpid()}'

    def _read_file(self) -> ControlFile | None:
        """Return what the control file says; None without one, which is told in every cycle."""
        config = self.component.configuration
        if not config.control_file:
            return None
        if library_trouble():
            raise ParameterError(library_trouble())
        try:
            # Need pydantic, which a bridge without a file does not have to have.
            from fuzzycnc_ros.adapters.opcua.control_file import check_axes, read_control
            from fuzzycnc_ros.adapters.opcua.file_fields import read_credentials

            path = Path(config.control_file).expanduser()
            file = read_control(path, self.settings.state_directory)
            if file.server.credentials is not None:
                read_credentials(file.server.credentials)
        except ParameterError as error:
            raise ParameterError(f'parameter control_file: {error}') from error
        check_axes(file, config.axes)
        return file

    def _open(self) -> LineController:
        file = self._file
        if file is None:
            raise LinkError('parameter control_file: expected a file of a control but it is empty')
        from fuzzycnc_ros.adapters.opcua.file_fields import read_credentials

        config = self.component.configuration
        return ThreadedController(
            lambda: OpcUaControl(file, self._name, read_credentials, config.takeover_time),
            config.cycle_period,
            config.takeover_time,
        )

    def _wait(self) -> float:
        return min(LOOK, self.component.configuration.cycle_period)

    def _before_activation(self, controller: LineController) -> str:
        return self.component.refusal()

    def _refusal(self, controller: LineController) -> str:
        return self.component.refusal()


def make() -> OpcuaBridgeNode:
    """Create the node."""
    return OpcuaBridgeNode()


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
