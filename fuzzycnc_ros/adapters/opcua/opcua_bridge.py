# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `opcua_bridge`: offset lines into a control that exposes variables by OPC UA."""

from dataclasses import dataclass

from fuzzycnc_ros.adapters.opcua.linear_offset_bridge import LineBridge, LineBridgeConfig
from fuzzycnc_ros.core.config import param


@dataclass(frozen=True, kw_only=True)
class OpcuaBridgeConfig(LineBridgeConfig):
    """Parameters of `opcua_bridge`."""

    axes: tuple[str, ...] = param(
        ('X', 'Y', 'Z'), '-', 'Axes that take offsets, as in the control file'
    )
    control_file: str = param(
        '', '-', 'File that says where the control is and which variables it has; required'
    )


class OpcuaBridge(LineBridge[OpcuaBridgeConfig]):
    """The bridge to a control that takes lines, behind OPC UA."""

    NAME = 'opcua_bridge'
    SUMMARY = (
        'A real machine in place of the simulated one: compensation as lines K0 + slope (x - P0) '
        'into variables of a control by OPC UA, and its read-back. Managed lifecycle.'
    )
    CONFIG = OpcuaBridgeConfig
