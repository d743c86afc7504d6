# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `mtconnect_adapter`: what a machine does, once a second, to agents of MTConnect."""

from pathlib import Path
from typing import Any

from rclpy.node import Node

from fuzzycnc_ros.adapters.mtconnect.shdr_server import ShdrServer
from fuzzycnc_ros.adapters.report_node import ReportNode
from fuzzycnc_ros.components.report.shdr import Shdr
from fuzzycnc_ros.files.atomic import write_regular
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.node_config import MtconnectAdapterConfig
from fuzzycnc_ros.runtime.component import Health, Level

SETTLED = 5
"""Reports without a new data item after which the file of devices is written."""


class MtconnectAdapterNode(ReportNode[MtconnectAdapterConfig]):
    """Serve what the nodes of a machine publish as SHDR; write the file that an agent needs."""

    def __init__(self, node: Node) -> None:
        super().__init__(node, MtconnectAdapterConfig)
        self._shdr = Shdr(self._machine, self._config.age_max)
        self._server = ShdrServer(self._config.listen, self._config.port)
        self._quiet = self._known = 0
        self._trouble = ''
        self._gather()

    def stop(self) -> None:
        """Let go of the agents, which then tell that the machine is not available."""
        self._server.close()

    def _hand_on(self, document: dict[str, Any]) -> Health:
        news = self._shdr.take(document)
        self._server.publish(news, self._shdr.everything())
        # An agent that reads the file anew begins anew: not once for each data item.
        self._quiet = 0 if len(self._shdr.items) > self._known else self._quiet + 1
        self._known = len(self._shdr.items)
        if self._quiet == SETTLED and self._known and self._config.devices_file:
            self._write(Path(self._config.devices_file).expanduser())
        health = self._server.health()
        if self._trouble:
            return Health(health.name, Level.WARN, self._trouble, health.values)
        return health

    def _write(self, path: Path) -> None:
        """Write the file of devices unless it is there already."""
        text = self._shdr.devices()
        log = self.node.get_logger()
        try:
            if path.is_file() and path.read_text() == text:
                return
            write_regular(path, text)
        except (OSError, UnicodeDecodeError) as error:
            self._trouble = f'devices_file {path} cannot be written ({error})'
            log.warning(self._trouble)
            return
        log.info(
            f'{path}: {self._known} data items; start the agent anew if it has read it before'
        )


def make() -> MtconnectAdapterNode:
    """Create the node."""
    return MtconnectAdapterNode(Node('mtconnect_adapter'))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
