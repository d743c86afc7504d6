# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of `linuxcnc_bridge`."""

from dataclasses import dataclass

from fuzzycnc_ros.adapters.controller_bridge_config import ControllerBridgeConfig
from fuzzycnc_ros.core.config import param


@dataclass(frozen=True, kw_only=True)
class LinuxcncBridgeConfig(ControllerBridgeConfig):
    """Parameters of `linuxcnc_bridge`."""

    axes: tuple[str, ...] = param(
        ('X', 'Y', 'Z'), '-', 'Axes that take offsets, as in the HAL file'
    )
    offset_max: float = param(
        60e-6, 'm', 'Largest offset of an axis; below that of the HAL file', low=1e-6, high=1e-3
    )
    slew_max: float = param(
        5e-6, 'm/s', 'Fastest change of an offset; below the HAL file', low=1e-9, high=1e-3
    )
    cycle_period: float = param(
        0.005, 's', 'Time between two looks at LinuxCNC', low=0.001, high=0.1
    )
    interpreter: str = param(
        '/usr/bin/python3', '-', "Python that LinuxCNC's modules hal and linuxcnc are built for"
    )
