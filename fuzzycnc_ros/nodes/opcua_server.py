# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `opcua_server`: what a machine does, once a second, for clients of OPC UA to read."""

from pathlib import Path
from typing import Any

from rclpy.node import Node

from fuzzycnc_ros.adapters.report_node import ReportNode
from fuzzycnc_ros.bags.secret_file import check_secret
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.node_config import OpcuaServerConfig
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.addresses import is_loopback
from fuzzycnc_ros.runtime.component import Health


class OpcuaServerNode(ReportNode[OpcuaServerConfig]):
    """Serve what the nodes of a machine publish as variables that nobody can write."""

    def __init__(self, node: Node) -> None:
        super().__init__(node, OpcuaServerConfig)
        from fuzzycnc_ros.adapters.opcua.report_server import ReportServer, ServerAccess

        config = self._config
        files = {
            name: getattr(config, name) for name in ('certificate', 'private_key', 'credentials')
        }
        missing = [name for name, value in files.items() if not value]
        entry = None
        if not is_loopback(config.listen) or len(missing) < len(files):
            if missing:
                raise ParameterError(
                    f'parameter {missing[0]}: expected a file, since others reach {config.listen} '
                    'or another of certificate, private_key and credentials is given, but it is '
                    'empty; give all three'
                )
            # Needs pydantic, which nobody else has to have.
            from fuzzycnc_ros.adapters.opcua.file_fields import read_credentials

            paths = {name: Path(value).expanduser() for name, value in files.items()}
            credentials = read_credentials(paths['credentials'])
            try:
                check_secret(paths['private_key'], 'private_key')
            except ValueError as error:
                raise ParameterError(str(error)) from error
            entry = ServerAccess(paths['certificate'], paths['private_key'], *credentials)
        self._server = ReportServer(
            self._machine, config.listen, config.port, config.age_max, entry
        )
        self._gather()

    def stop(self) -> None:
        """End the server."""
        self._server.close()

    def _hand_on(self, document: dict[str, Any]) -> Health:
        self._server.publish(document)
        return self._server.health()


def make() -> OpcuaServerNode:
    """Create the node."""
    return OpcuaServerNode(Node('opcua_server'))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
