# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Data exchanged between the bridge and LinuxCNC in one cycle, in SI units."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from fuzzycnc_ros.adapters.controller import Readout
from fuzzycnc_ros.core.inputs.lines import Lines, Travel
from fuzzycnc_ros.runtime.records import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class LinuxcncStatus(Readout):
    """State read from LinuxCNC; `ready` means that its offset registers take counts."""

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
    lines: Lines | None = None
    """Lines that the servo thread goes along; None where it knows none but counts."""
    travel: Travel
    """Travel along which offsets may slope."""
    base: Floats | None = None
    """Offset at counts of zero, as the servo thread found it in its newest period [m]."""
    tracking: bool = True
    """True if LinuxCNC moves offsets: not in joint mode."""
    tick: int
    """Duration of the servo thread in its newest period, in its own unit: another number is
    another period."""

    @property
    def standing(self) -> Lines:
        """Lines that counts stand for, whatever the registers make of them."""
        if self.lines is None:
            return Lines.constant(self.scale * self.counts)
        return self.lines

    @property
    def led(self) -> bool:
        """True if the registers follow the counts, and the counts this bridge."""
        return self.ready and self.alive and not self.frozen


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoThreadLimits:
    """Limits that the servo thread keeps whatever it is told."""

    counts_max: float
    counts_rate: float
    """Counts per second at a fixed place [1/s]."""
    slope: float = 0.0
    """Steepest line [counts/m]; 0 where the servo thread takes none."""
    hold_time: float
    """Time for which offsets stand without a bridge [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerOutput:
    """Command written by the bridge."""

    counts: Floats
    """Offsets at the references, parallel to the axes [counts]."""
    slope: Floats
    """[counts/m]"""
    reference: Floats
    """Positions at which the slopes have no effect [m]."""
    limit: float
    """Largest offset, wherever an axis is [counts]."""
    rezero: bool = False
    """Hold the registers at zero, whatever the counts do."""


SURE = 4
"""Servo periods for which a base must have been seen while the counts stood still: the register
follows the counts one period later, and on a busy computer a period may last long."""
TOLERANCE = 2.0
"""Base that is none [counts]."""


class RegisterPhase(Enum):
    """Treatment of the bases."""

    SETTLING = 'settling'
    FOLLOWING = 'following'
    RAMPING = 'ramping'
    CLEARING = 'clearing'


class OffsetRegisters:
    """Find counts that bring the registers to wanted offsets.

    Parameters
    ----------
    size : int
        Number of axes.
    """

    def __init__(self, size: int) -> None:
        self.phase = RegisterPhase.SETTLING
        self.base = np.zeros(size)
        """Offset at counts of zero [m]; followed only while the way back is gone."""
        self._seen = np.zeros(size)
        self._counts = np.zeros(size)
        self._tick = 0
        self._scale = np.zeros(size)
        self._cycles = 0

    @property
    def settled(self) -> bool:
        """True if the bases are known: for some periods nothing has moved the counts."""
        return self._cycles >= SURE

    def restart(self) -> None:
        """Hold the counts as they stand until the bases are known."""
        self.phase = RegisterPhase.SETTLING

    def look(self, status: LinuxcncStatus) -> None:
        """Follow the bases without doing anything about them."""
        found, still = status.base, True
        if found is None:
            found = status.register - status.scale * status.counts
            still = np.array_equal(status.counts, self._counts)
        near = np.abs(found - self._seen) <= TOLERANCE * np.abs(status.scale)
        if not (np.all(near) and still):
            self._cycles = 0
        elif status.tick != self._tick:
            self._cycles += 1
        self._seen, self._counts, self._tick = found, status.counts, status.tick

    def observe(self, status: LinuxcncStatus) -> bool:
        """Look at a cycle; return whether a base was found now, which the offsets have to leave.

        While the registers do not follow the counts nothing is concluded.
        """
        rescaled = not np.array_equal(status.scale, self._scale)
        self._scale = status.scale
        self.look(status)
        if not status.led or rescaled:
            self._cycles = 0
            self.restart()
            return False
        tolerance = TOLERANCE * np.abs(status.scale)
        if self.phase is RegisterPhase.CLEARING:
            if not np.any(status.counts):
                self._cycles = 0
                self.restart()
        elif self.phase is RegisterPhase.RAMPING:
            if self.settled:
                self.base = self._seen.copy()
            away = np.maximum(np.abs(status.register), np.abs(status.applied))
            if np.all(away <= tolerance):
                self.phase = RegisterPhase.CLEARING
        elif self.settled:
            if np.any(np.abs(self._seen) > tolerance):
                self.phase, self.base = RegisterPhase.RAMPING, self._seen.copy()
                return True
            self.phase, self.base = RegisterPhase.FOLLOWING, np.zeros_like(self.base)
        return False

    def output(
        self, wanted: Lines, status: LinuxcncStatus, most: float = np.inf
    ) -> ControllerOutput:
        """Return what brings the registers to `wanted`, no further than `most` [m]."""
        zero = np.zeros_like(status.counts)
        limit = most / float(np.min(status.scale))
        if self.phase is RegisterPhase.CLEARING:
            return ControllerOutput(
                counts=zero, slope=zero, reference=zero, limit=limit, rezero=True
            )
        base, lines = self.base, wanted
        if self.phase is RegisterPhase.SETTLING:
            base, lines = zero, status.standing
        counts = (lines.offset - base) / status.scale
        return ControllerOutput(
            counts=np.rint(counts) + 0.0 if status.lines is None else counts,
            slope=lines.slope / status.scale,
            reference=lines.reference_position,
            limit=limit,
        )
