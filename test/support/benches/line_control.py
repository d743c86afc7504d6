# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A control that takes offset lines: the program of docs/how-to/opcua-output.md, step by step."""

import numpy as np

WATCHDOG = 3.0
"""Time without a heartbeat after which the control lets go [s]."""

SPEED_MAX = 1.0
"""Fastest motion of an axis [m/s]."""


class LineControl:
    """Variables as a control has them, here in SI units, and what its program does with them.

    Attributes
    ----------
    offset, slope, reference_position, valid_for, sequence, heartbeat, owner
        Written by a bridge.
    acknowledged, applied, alive
        Written by the program.
    frozen : bool
        Whether the program takes no new sets.
    stuck : bool
        Whether the axes do not follow it.
    """

    def __init__(self, size: int = 2) -> None:
        self.size = size
        self.on = self.homed = self.allowed = True
        self.running = self.estop = self.fault = False
        self.frozen = self.stuck = False
        self.limit = np.full(size, 60e-6)
        self.slew, self.watchdog = 20e-6, WATCHDOG
        self.position = np.zeros(size)
        self.spindle_speed = 0.0
        self.offset, self.slope = np.zeros(size), np.zeros(size)
        self.reference_position = np.zeros(size)
        self.valid_for, self.sequence, self.heartbeat, self.owner = 0.0, 0, 0, ''
        self.acknowledged, self.alive = 0, False
        self.applied = np.zeros(size)
        self._set = (np.zeros(size), np.zeros(size), np.zeros(size), 0.0)
        self._before = np.zeros(size)
        self._heard, self._silence, self._age = 0, 1e9, 0.0

    def scan(self, duration: float) -> None:
        """Run the program once, `duration` [s] after the last time."""
        self._silence += duration
        if self.heartbeat != self._heard:
            self._heard, self._silence = self.heartbeat, 0.0
        self.alive = self._silence <= self.watchdog
        if not self.alive:
            self._set = (*self._set[:3], 0.0)
        self._age += duration
        if self.sequence != self.acknowledged and not self.frozen:
            self._set = (
                self.offset.copy(),
                self.slope.copy(),
                self.reference_position.copy(),
                self.valid_for,
            )
            self.acknowledged, self._age = self.sequence, 0.0
        offset, slope, reference, valid_for = self._set
        ready = self.on and self.homed and self.allowed and not (self.estop or self.fault)
        follows = ready and self.alive and self.acknowledged != 0 and self._age <= valid_for
        here, there = (
            np.clip(offset + slope * (place - reference), -self.limit, self.limit)
            for place in (self.position, self._before)
        )
        near = np.abs(self.position - self._before) <= SPEED_MAX * duration
        self._before = self.position.copy()
        target = np.zeros(self.size)
        if follows:
            target = here
            along = np.where(near & (not self.stuck), here - there, 0.0)
            self.applied = np.clip(self.applied + along, -self.limit, self.limit)
        reach = 0.0 if self.stuck else self.slew * duration
        self.applied = self.applied + np.clip(target - self.applied, -reach, reach)
