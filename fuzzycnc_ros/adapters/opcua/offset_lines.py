# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Offsets along axes as lines K0 + slope (x - P0), and what passes to and from such controls.

A line is guarded by its values at the two ends of the travel: if both stay within a size and move
no faster than a rate, the offset at any place between them does too.
"""

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.adapters.controller import Readout
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import Bools, Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Lines:
    """One line per axis: offset + slope (x - reference_position)."""

    offset: Floats
    """K0, at the reference position [m]."""
    slope: Floats
    """Offset per length of travel [-]."""
    reference_position: Floats
    """P0 [m]."""

    @classmethod
    def constant(cls, offset: Floats) -> 'Lines':
        """Return lines that have an offset [m] everywhere."""
        zero = np.zeros_like(offset)
        return cls(offset=offset, slope=zero, reference_position=zero)

    def at(self, position: Floats) -> Floats:
        """Return the offsets at a position [m]; NaN where it is unknown and matters."""
        travel = np.where(self.slope == 0.0, 0.0, position - self.reference_position)
        return np.asarray(self.offset + self.slope * travel)


@dataclass(frozen=True, kw_only=True, eq=False)
class Travel:
    """The travel of each axis; both ends are the same where the control takes no slope."""

    low: Floats
    """[m]"""
    high: Floats
    """[m]"""

    @property
    def sloping(self) -> Bools:
        """Whether each axis takes a slope."""
        return np.asarray(self.high > self.low, bool)

    def ends(self, lines: Lines) -> Floats:
        """Return the offsets at the lower ends, then those at the upper ends [m]."""
        return np.concatenate([self._at(lines, self.low), self._at(lines, self.high)])

    def lines(self, ends: Floats, reference_position: Floats) -> Lines:
        """Return the lines through offsets at the ends [m]."""
        low, high = np.split(ends, 2)
        span = np.where(self.sloping, self.high - self.low, 1.0)
        slope = np.where(self.sloping, (high - low) / span, 0.0)
        offset = low + slope * (reference_position - self.low)
        return Lines(offset=np.asarray(offset), slope=slope, reference_position=reference_position)

    def _at(self, lines: Lines, place: Floats) -> Floats:
        return lines.at(np.where(self.sloping, place, lines.reference_position))


@dataclass(frozen=True, kw_only=True, eq=False)
class LineLimits:
    """What a control that takes lines keeps whatever it is told."""

    offset_max: Floats
    """Largest offset of each axis; infinite where it does not tell [m]."""
    slew_max: float
    """Fastest change of an offset; infinite if it does not tell [m/s]."""
    travel: Travel
    resolution: Floats
    """Smallest difference that its variables hold [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LineStatus(Readout):
    """What a control that takes lines tells in one cycle."""

    lines: Lines
    """The set that stands in its variables."""
    sequence: int
    """Number of that set; 0 if nobody owns it."""
    acknowledged: int
    """Number of the set that it follows."""
    heartbeat: int
    allowed: bool = True
    """Whether it takes offsets in its present state, apart from being on and homed."""
    alive: bool = True
    """Whether its watchdog hears somebody."""
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
    """What a bridge writes: the set as a whole when its number is new, the heartbeat always."""

    lines: Lines
    sequence: int
    heartbeat: int
    validity: float
    """How long the control may follow the set without a newer one [s]."""
