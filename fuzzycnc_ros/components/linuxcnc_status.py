# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What passes between the bridge and LinuxCNC in one cycle, in SI units."""

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.components.codes import MachineMode
from fuzzycnc_ros.components.records import Bools, Floats, Names


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerStatus:
    """What LinuxCNC tells; arrays are parallel to the axes of the bridge."""

    mode: MachineMode
    homed: bool
    ready: bool
    """The machine is on and homed: its offset registers take counts."""
    alive: bool
    """The watchdog in the servo thread hears this bridge."""
    frozen: bool
    """`eoffset-enable` of an axis is off: the offset stays where it is."""
    soft_limited: bool
    """A soft limit cuts an offset."""
    writer: str = ''
    """HAL component that writes the counts; empty if none does."""
    position: Floats
    """Commanded, without offsets [m]."""
    applied: Floats
    """Offsets in force: the read-back [m]."""
    register: Floats
    """Offsets that LinuxCNC goes to: the sum of what its counts have changed by [m]."""
    counts: Floats
    """Counts that LinuxCNC sees [-]."""
    scale: Floats
    """Offset of one count [m]."""
    spindle_speed: float = np.nan
    """Positive clockwise seen from the spindle [rad/s]."""

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


def describe(axes: Names, values: Floats, chosen: Bools | None = None) -> str:
    """Return offsets [m] as text in micrometres, those that are chosen or not zero."""
    picked = np.abs(values) > 0.0 if chosen is None else np.asarray(chosen, bool)
    return ', '.join(
        f'{axis} {1e6 * value:.2f} um'
        for axis, value, take in zip(axes, values, picked, strict=True)
        if take
    )
