# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""LinuxCNC's offset registers: they add up changes of counts, so counts alone say nothing.

A register is its base plus scale times counts.  The base is zero until counts change where the
register does not take it: while the enable is off, or when the scale changes with counts standing.
From then on counts of zero mean another offset than zero.  The way back has no step: ramp the
registers to zero by counts, hold them there while the counts go to zero too, and go on.
"""

from enum import Enum

import numpy as np

from fuzzycnc_ros.components.linuxcnc_status import ControllerOutput, ControllerStatus
from fuzzycnc_ros.components.records import Floats

SURE = 4
"""Cycles for which a base must have been seen: counts and register are read one after the other,
and another process moves them meanwhile."""
TOLERANCE = 2.0
"""Base that is none [counts]."""


class RegisterPhase(Enum):
    """What is done about the bases."""

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
        self.phase = RegisterPhase.FOLLOWING
        self.base = np.zeros(size)
        """Offset at counts of zero [m]; followed only while the way back is gone."""
        self._seen = np.zeros(size)
        self._cycles = 0

    def observe(self, status: ControllerStatus) -> bool:
        """Look at a cycle; return whether a base was found now, which the offsets have to leave.

        While the registers take no counts nothing is concluded: LinuxCNC clears them then.
        """
        found = status.register - status.scale * status.counts
        tolerance = TOLERANCE * np.abs(status.scale)
        if not status.ready or status.frozen:
            self.phase, self._cycles = RegisterPhase.FOLLOWING, 0
            self.base = np.zeros_like(self.base)
            return False
        same = np.all(np.abs(found - self._seen) <= 0.1 * tolerance)
        self._cycles = self._cycles + 1 if same else 0
        self._seen = found
        sure = self._cycles >= SURE
        if self.phase is RegisterPhase.FOLLOWING:
            if sure and np.any(np.abs(found) > tolerance):
                self.phase, self.base = RegisterPhase.RAMPING, found
                return True
        elif self.phase is RegisterPhase.RAMPING:
            if sure:
                self.base = found
            if np.all(np.abs(status.register) <= tolerance) and np.all(
                np.abs(status.applied) <= tolerance
            ):
                self.phase = RegisterPhase.CLEARING
        elif not np.any(status.counts):
            self.phase, self.base = RegisterPhase.FOLLOWING, np.zeros_like(self.base)
            self._cycles = 0
        return False

    def output(self, wanted: Floats, status: ControllerStatus) -> ControllerOutput:
        """Return what to write so that the registers go to `wanted` [m]."""
        if self.phase is RegisterPhase.CLEARING:
            return ControllerOutput(counts=np.zeros_like(wanted), rezero=True)
        counts = (wanted - self.base) / status.scale
        return ControllerOutput(counts=np.rint(counts) + 0.0)
