# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Moves of driven axes in a recording, judged one by one."""

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisCommand,
    AxisState,
    PositionCommand,
    ServoState,
)
from fuzzycnc_ros.simulation.servo.positioning import settle_times
from fuzzycnc_ros.studies.record_log import RecordLog

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PositioningMove:
    """A move of one axis as it was commanded and made; n control periods.

    Attributes
    ----------
    axis : str
        Name of the axis.
    start, target : float
        Where it read at the beginning, and where it was sent [m].
    time : ndarray, shape (n,)
        Time since the command [s].
    position, velocity : ndarray, shape (n,)
        What was read [m, m/s].
    duty : ndarray, shape (n,)
        What the drive was commanded for the period from then on [-]; NaN where nobody did.
    told_time, reference, disturbance : ndarray, shape (m,)
        What the controller said of itself now and then: time [s], where the axis was to be [m],
        what friction and load take [-].
    missed : int
        Deadlines missed since activation.
    fault : str
        Why the controller gave up; empty if it did not.
    """

    axis: str
    start: float
    target: float
    time: Floats
    position: Floats
    velocity: Floats
    duty: Floats
    told_time: Floats
    reference: Floats
    disturbance: Floats
    missed: int
    fault: str

    def settle(self, tolerance: float = 2e-6) -> float:
        """Return when the reading came within a tolerance of the target for good [s].

        Infinite if it still is further away at the end.
        """
        return float(settle_times(self.time, self.target - self.position, tolerance))

    @property
    def overshoot(self) -> float:
        """Overshoot of the reading beyond the target [m]; 0 if there was none."""
        direction = np.sign(self.target - self.start)
        return float(max(0.0, np.nanmax((self.position - self.target) * direction)))

    @property
    def left(self) -> float:
        """Distance from the target at the end [m]."""
        return float(abs(self.target - self.position[-1]))


class PositioningLog(RecordLog):
    """The records of moves; a sink for `InProcessGraph`, or read from a bag."""

    TOPICS = MappingProxyType(
        {
            'position_command': PositionCommand,
            'axis_state': AxisState,
            'axis_command': AxisCommand,
            'servo_state': ServoState,
        }
    )
    REQUIRED = ('position_command', 'axis_state', 'axis_command')

    def moves(self) -> tuple[PositioningMove, ...]:
        """Return the moves in the order of their commands, one per axis."""
        commands = sorted(self._records['position_command'], key=lambda item: item.stamp)
        ends = [*(item.stamp for item in commands), None][1:]
        return tuple(
            self._move(name, command, until)
            for command, until in zip(commands, ends, strict=True)
            for name in command.axis
            if self._of(name, 'axis_state', command, until)
        )

    def _move(self, name: str, command: PositionCommand, until: int | None) -> PositioningMove:
        """Return what became of one move, up to the next command at `until` [ns]."""
        states = self._of(name, 'axis_state', command, until)
        duties = {
            item.stamp: item.duty[item.axis.index(name)]
            for item in self._of(name, 'axis_command', command, until)
        }
        told = self._of(name, 'servo_state', command, until)
        position = _column(states, name, 'position')
        faults = [item.reason for item in told if item.status == ServoStatus.FAULT]
        return PositioningMove(
            axis=name,
            start=float(position[0]),
            target=float(command.position[command.axis.index(name)]),
            time=_times(states, command.stamp),
            position=position,
            velocity=_column(states, name, 'velocity'),
            duty=np.array([duties.get(item.stamp, np.nan) for item in states]),
            told_time=_times(told, command.stamp),
            reference=_column(told, name, 'reference'),
            disturbance=_column(told, name, 'disturbance'),
            missed=max((item.missed for item in told), default=0),
            fault=faults[0] if faults else '',
        )

    def _of(self, name: str, topic: str, command: PositionCommand, until: int | None) -> list[Any]:
        """Return the records of a topic that tell of an axis, from a command to `until` [ns]."""
        return [item for item in self._between(topic, command.stamp, until) if name in item.axis]


def _times(records: list[Any], start: int) -> Floats:
    """Return the times of records since a stamp [s]."""
    return np.array([(item.stamp - start) / SECOND for item in records], dtype=np.float64)


def _column(records: list[Any], axis: str, field: str) -> Floats:
    """Return a field of one axis over records."""
    return np.array(
        [getattr(item, field)[item.axis.index(axis)] for item in records], dtype=np.float64
    )
