# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Data exchanged with a control that takes offsets along its axes as lines."""

from dataclasses import dataclass

from fuzzycnc_ros.adapters.controller import Readout
from fuzzycnc_ros.core.inputs.lines import Lines, Travel
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class LineLimits:
    """Limits that a control that takes lines keeps by itself."""

    offset_max: Floats
    """Largest offset of each axis; infinite where it does not tell [m]."""
    slew_max: float
    """Fastest change of an offset; infinite if it does not tell [m/s]."""
    travel: Travel
    resolution: Floats
    """Smallest difference that its variables hold [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LineStatus(Readout):
    """State read in one cycle from a control that takes lines."""

    lines: Lines
    """The set that stands in its variables."""
    sequence: int
    """Number of that set; 0 if nobody owns it."""
    acknowledged: int
    """Number of the set that it follows."""
    heartbeat: int
    allowed: bool = True
    """True if it takes offsets in its present state, apart from being on and homed."""
    alive: bool = True
    """True if its watchdog sees a heartbeat."""
    limits: LineLimits

    @property
    def obstacle(self) -> str:
        """Why offsets are not taken; empty if they are."""
        on = self.mode in (MachineMode.ON, MachineMode.RUNNING)
        if on and self.homed and not self.allowed:
            return 'the control does not allow offsets'
        return super().obstacle


@dataclass(frozen=True, kw_only=True, eq=False)
class LineOrders:
    """Command written by a bridge: the set as a whole when its number is new; heartbeats."""

    lines: Lines
    sequence: int
    heartbeat: int
    validity: float
    """Time for which the control may follow the set without a newer one [s]."""
