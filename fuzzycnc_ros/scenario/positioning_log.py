# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What driven axes did on the moves that they were given."""

import os
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.runs import find_topic
from fuzzycnc_ros.components.codes import ServoStatus
from fuzzycnc_ros.components.records import (
    SECOND,
    AxisCommand,
    AxisState,
    PositionCommand,
    Record,
    ServoState,
)
from fuzzycnc_ros.convert import decode
from fuzzycnc_ros.core.servo.positioning import settle_times

Floats = NDArray[np.float64]

TOPICS: dict[str, type[Record]] = {
    'position_command': PositionCommand,
    'axis_state': AxisState,
    'axis_command': AxisCommand,
    'servo_state': ServoState,
}
"""Topics that moves are judged by."""


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
        """How far beyond the target the axis read [m]; 0 if it did not."""
        direction = np.sign(self.target - self.start)
        return float(max(0.0, np.nanmax((self.position - self.target) * direction)))

    @property
    def left(self) -> float:
        """Distance from the target at the end [m]."""
        return float(abs(self.target - self.position[-1]))


class PositioningLog:
    """The records of moves; a sink for `InProcessGraph`, or read from a bag."""

    def __init__(self) -> None:
        self._records: dict[str, list[Any]] = defaultdict(list)

    def __call__(self, topic: str, record: Record) -> None:
        """Take one published record."""
        if topic in TOPICS:
            self._records[topic].append(record)

    @classmethod
    def from_bag(
        cls, path: str | os.PathLike[str], *, namespace: str | None = None
    ) -> 'PositioningLog':
        """Read the log of a recorded run.

        Raises
        ------
        BagError
            If the bag cannot be read or lacks `position_command`, `axis_state` and
            `axis_command`.
        """
        log = cls()
        with BagReader(path) as reader:
            topic = find_topic(reader, 'position_command', PositionCommand.TYPE, namespace)
            space = topic.removesuffix('position_command')
            reader.require([topic, f'{space}axis_state', f'{space}axis_command'])
            names = {f'{space}{name}': name for name in TOPICS}
            there = [name for name in names if name in reader.connections]
            for message in reader.messages(there):
                name = names[message.topic]
                log(name, decode(TOPICS[name], message.message))
        return log

    def moves(self) -> tuple[PositioningMove, ...]:
        """Return the moves in the order of their commands, one per axis."""
        commands = sorted(self._records['position_command'], key=lambda item: item.stamp)
        ends = [*(item.stamp for item in commands[1:]), None]
        return tuple(
            self._move(name, command, until)
            for command, until in zip(commands, ends, strict=True)
            for name in command.axis
            if any(name in state.axis for state in self._between('axis_state', command, until))
        )

    def _move(self, name: str, command: PositionCommand, until: int | None) -> PositioningMove:
        """Return what became of one move, up to the next command at `until` [ns]."""
        states = [
            item for item in self._between('axis_state', command, until) if name in item.axis
        ]
        duties = {
            item.stamp: item.duty[item.axis.index(name)]
            for item in self._between('axis_command', command, until)
            if name in item.axis
        }
        told = [item for item in self._between('servo_state', command, until) if name in item.axis]
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

    def _between(self, topic: str, command: PositionCommand, until: int | None) -> list[Any]:
        """Return the records of a topic from a command on up to `until` [ns]."""
        return [
            item
            for item in self._records[topic]
            if command.stamp <= item.stamp and (until is None or item.stamp < until)
        ]


def _times(records: list[Any], start: int) -> Floats:
    """Return the times of records since a stamp [s]."""
    return np.array([(item.stamp - start) / SECOND for item in records], dtype=np.float64)


def _column(records: list[Any], axis: str, field: str) -> Floats:
    """Return a field of one axis over records."""
    return np.array(
        [getattr(item, field)[item.axis.index(axis)] for item in records], dtype=np.float64
    )
