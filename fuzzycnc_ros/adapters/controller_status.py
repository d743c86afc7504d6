# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What any controller tells its bridge in one cycle, in SI units."""

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Readout:
    """What a controller tells; arrays are parallel to the axes of the bridge."""

    mode: MachineMode
    homed: bool
    ready: bool
    """The machine is on and homed, and takes offsets."""
    writer: str = ''
    """Who writes offsets now; empty if nobody does, or nobody knows."""
    position: Floats
    """Commanded, without offsets; NaN where the controller does not tell [m]."""
    applied: Floats
    """Offsets in force: the read-back [m]."""
    spindle_speed: float = np.nan
    """Positive clockwise seen from the spindle [rad/s]."""

    @property
    def obstacle(self) -> str:
        """Why offsets are not taken; empty if they are."""
        if self.ready:
            return ''
        words = {MachineMode.ESTOP: 'in emergency stop', MachineMode.FAULT: 'in a fault'}
        word = words.get(self.mode, 'off')
        return 'machine is not homed' if not self.homed else f'machine is {word}'
