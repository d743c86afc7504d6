# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What passes between the bridge and LinuxCNC in one cycle, in SI units."""

from dataclasses import dataclass

from fuzzycnc_ros.adapters.controller_status import Readout
from fuzzycnc_ros.runtime.records import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerStatus(Readout):
    """What LinuxCNC tells; `ready` means that its offset registers take counts."""

    alive: bool
    """The watchdog in the servo thread hears this bridge."""
    frozen: bool
    """`eoffset-enable` of an axis is off: the offset stays where it is."""
    soft_limited: bool
    """A soft limit cuts an offset."""
    register: Floats
    """Offsets that LinuxCNC goes to: the sum of what its counts have changed by [m]."""
    counts: Floats
    """Counts that LinuxCNC sees [-]."""
    scale: Floats
    """Offset of one count [m]."""
    tick: int
    """How long the servo thread took in its newest period, in its own unit: another number is
    another period."""

    @property
    def led(self) -> bool:
        """Whether the registers follow the counts, and the counts this bridge."""
        return self.ready and self.alive and not self.frozen


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerLimits:
    """Limits that the servo thread keeps whatever it is told."""

    counts_max: float
    counts_rate: float
    """Counts per second [1/s]."""
    hold_time: float
    """How long offsets stand without a bridge [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerOutput:
    """What the bridge writes."""

    counts: Floats
    """Whole numbers, parallel to the axes."""
    rezero: bool = False
    """Hold the registers at zero, whatever the counts do."""
