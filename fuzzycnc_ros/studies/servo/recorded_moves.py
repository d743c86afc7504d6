# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded moves of one axis, from a CSV file or a bag."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, pairwise
from math import exp, isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.signal import lfilter

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.runs import find_topic
from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.components.servo.servo_controller_config import (
    ServoControllerConfig,
    profile_limits,
)
from fuzzycnc_ros.core.remedies import RemediedError, Remedy
from fuzzycnc_ros.core.servo.axis import velocity_lag
from fuzzycnc_ros.core.servo.profile import point_to_point
from fuzzycnc_ros.runtime.convert import decode
from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.host import NodeConfiguration
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisCommand,
    AxisState,
    PositionCommand,
    Record,
    ServoState,
    nanoseconds,
)
from fuzzycnc_ros.studies.number_table import read_numbers

if TYPE_CHECKING:
    from fuzzycnc_ros.core.arrays import Array
    from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController

COLUMNS = ('t', 'reference', 'position', 'duty')
"""Columns of a CSV file; time in s, lengths in the unit that is told, duty from -1 to 1."""

ROWS_MIN = 50
"""Rows without a gap that are of use: fewer do not get the observer going."""

BLOCK = 20
"""Periods over which speed and duty are averaged to see whether they belong together."""

_RATIO = (0.05, 20.0)
"""Range of the axis' gain over the nominal one [-]."""

_LATE = 0.1
"""Tolerance of stamps, as a share of a period."""


@dataclass(frozen=True, eq=False)
class RecordedMoves:
    """Recorded moves of an axis, n rows a period apart but for gaps.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Time [s].
    reference, position, duty : ndarray, shape (n,)
        Where the axis was to be and was read [m], and the duty held from then on [-].
    """

    time: Array
    reference: Array
    position: Array
    duty: Array

    def stretches(self, period: float) -> list[slice]:
        """Return the stretches without a gap that are long enough."""
        apart = np.abs(np.diff(self.time) - period) > _LATE * period
        edges = [0, *(np.flatnonzero(apart) + 1).tolist(), len(self.time)]
        return [slice(first, last) for first, last in pairwise(edges) if last - first >= ROWS_MIN]


def records_of(
    moves: RecordedMoves, controller: VariableUniverseController, source: Path
) -> Array:
    """Return what rules are learnt from.

    Raises
    ------
    ValueError
        If there is no stretch of the controller's period, or the axis does not move as its duty
        and the nominal model say.
    """
    from fuzzycnc_ros.core.servo.rule_learning import records_of_run

    period = controller.period
    found = []
    for part in moves.stretches(period):
        target = moves.reference[part]
        speed = np.gradient(target, period)
        # a step is no motion
        speed[np.abs(speed) > 2.0 * abs(controller.axis.gain)] = 0.0
        found.append(
            records_of_run(
                target,
                moves.position[part],
                moves.duty[part],
                controller,
                velocity=speed,
                acceleration=np.gradient(speed, period),
            )
        )
    if not found:
        raise ValueError(
            f'{source}: expected {ROWS_MIN} rows or more, {1e3 * period:g} ms apart without a '
            f'gap, but found none among {len(moves.time)} rows'
        )
    _check_gain(moves, controller, source)
    return np.concatenate(found)


def _check_gain(
    moves: RecordedMoves, controller: VariableUniverseController, source: Path
) -> None:
    """Refuse lengths in a wrong unit and an axis that is driven the other way."""
    period, gain, lag = controller.period, controller.axis.gain, velocity_lag(controller.axis)
    keep = exp(-period / lag)
    driven = moved = 0.0
    for part in moves.stretches(period):
        # An axis with little friction is never as fast as full duty would make it in the end.
        speed = lfilter([0.0, gain * (1.0 - keep)], [1.0, -keep], moves.duty[part])
        expected = _changes(period * np.cumsum(speed))
        driven += float(expected @ expected)
        moved += float(expected @ _changes(moves.position[part]))
    ratio = moved / driven if driven else 0.0
    if -_RATIO[1] < ratio < -_RATIO[0]:
        raise ValueError(
            f'{source}: expected positive duty to drive to '
            f'{"positive" if gain > 0.0 else "negative"} positions but found the opposite; '
            f'{"give" if gain > 0.0 else "leave out"} --reversed'
        )
    if not _RATIO[0] <= ratio <= _RATIO[1]:
        raise ValueError(
            f'{source}: expected an axis of about {1e3 * abs(gain):g} mm/s at full duty but found '
            f'{1e3 * abs(ratio * gain):.3g} mm/s; is it this axis, and the unit right?'
        )


def _changes(position: Array) -> Array:
    """Return how the speed changes from one block of periods to the next."""
    ways = position[BLOCK:] - position[:-BLOCK]
    return np.asarray(ways[BLOCK:] - ways[:-BLOCK])


def read_csv(path: Path, metres: float) -> RecordedMoves:
    """Read moves from a CSV file whose lengths are multiples of so many metres.

    Raises
    ------
    ValueError
        If a column is missing or a cell is no finite number; the message names the line.
    """
    time, reference, position, duty = read_numbers(path, COLUMNS).values.T
    if np.abs(duty).max() > 1.0:
        raise ValueError(
            f'{path}: duty: expected shares of the drive from -1 to 1 but found '
            f'{duty[np.abs(duty).argmax()]:g}'
        )
    return RecordedMoves(time, metres * reference, metres * position, duty)


NEEDED: dict[str, type[Record]] = {
    'axis_state': AxisState,
    'axis_command': AxisCommand,
    'servo_state': ServoState,
}

BESIDE: dict[str, type[Record]] = {
    'position_command': PositionCommand,
    'node_configuration': NodeConfiguration,
}
"""Topics without which there are fewer moves."""

_USED = ('period', 'velocity_max', 'acceleration_max', 'jerk_max', 'axes', 'axis_data')
"""Parameters of the controller that its moves depend on."""

_AGREES = 1e-9
"""Difference to what the controller said of the reference that is none [m]."""

Row = tuple[float, float, float, float]
"""Time [s], reference and position [m], duty [-]."""

_DRIVEN = (ServoStatus.RESTING, ServoStatus.MOVING)


def read_bag(path: Path, axis: str | None) -> RecordedMoves:
    """Read the moves of an axis from a bag of a run with `servo_controller`.

    Raises
    ------
    BagError
        If the bag cannot be read or lacks a topic.
    ValueError
        If it has no such axis, or several and none is named, or no move of it.
    """
    seen = _records(path)
    states, commands, servos = ({record.stamp: record for record in seen[name]} for name in NEEDED)
    chosen = _axis(path, axis, {name for one in commands.values() for name in one.axis})
    course = _ReferenceBuilder(chosen, seen, _configuration(path, seen))
    rows: list[Row] = []
    for stamp in sorted(states):
        position = _of(states[stamp], 'position', chosen)
        told = servos.get(stamp)
        duty = _of(commands[stamp], 'duty', chosen) if stamp in commands else nan
        rows += course.go_on(stamp, told, (position, duty))
    good = [row for row in rows if all(map(isfinite, row))]
    if not good:
        raise ValueError(
            f'{path}: expected moves of the axis {chosen} that were commanded by '
            'position_command and answered by axis_command but found none'
        )
    return RecordedMoves(*np.array(good).T)


class _ReferenceBuilder:
    """Reference of an axis, from its commands and its controller's reports."""

    def __init__(
        self, name: str, seen: dict[str, list[Any]], config: ServoControllerConfig
    ) -> None:
        self._name, self._config = name, config
        axes = config.driven
        # A bag without parameters tells of an axis that the default ones do not have.
        self._data = axes.get(name) or next(iter(axes.values()))
        self._commands = sorted(seen['position_command'], key=lambda item: item.stamp)
        self._period = nanoseconds(config.period)
        self._known = False
        self._last = 0
        self._open: list[Row] = []
        self._motion: tuple[float, ...] = (nan, 0.0, 0.0)
        self._way: Iterator[tuple[float, ...]] = iter(())

    def go_on(self, stamp: int, told: ServoState | None, values: tuple[float, float]) -> list[Row]:
        """Return the rows that are certain now: time [s], reference [m], and the values."""
        due = self._advance(stamp)
        time = stamp / SECOND
        if told is None:
            if self._known:
                self._open.append((time, self._motion[0], *values))
            return []
        reference = _of(told, 'reference', self._name)
        agrees = self._known and abs(self._motion[0] - reference) <= _AGREES
        certain, self._open = self._open if agrees else [], []
        if told.status not in _DRIVEN or not isfinite(reference):
            self._known = False
            return certain
        self._known = agrees or told.status == ServoStatus.RESTING
        if not agrees:
            self._rest(reference)
            if due is not None:  # this is where it sets out
                self._go(due)
                self._motion = next(self._way, self._motion)
                self._known = True
        return [*certain, (time, reference, *values)]

    def _rest(self, reference: float) -> None:
        self._motion, self._way = (reference, 0.0, 0.0), iter(())

    def _advance(self, stamp: int) -> PositionCommand | None:
        """Bring the reference to the control period of a stamp [ns]; return a new command."""
        due: PositionCommand | None = None
        while self._commands and self._commands[0].stamp <= stamp:
            due = self._commands.pop(0)
        if due is not None and self._name not in due.axis:
            due = None
        periods = round((stamp - self._last) / self._period) if self._last else 1
        self._last = stamp
        if not self._known:
            return due
        for _ in range(periods - 1):  # those that the bag has no state of
            self._motion = next(self._way, self._motion)
        if due is not None:
            self._go(due)
        self._motion = next(self._way, self._motion)
        return due

    def _go(self, command: PositionCommand) -> None:
        """Set out from the present motion."""
        reference, speed, change = self._motion
        target = _of(command, 'position', self._name)
        speed_max = _of(command, 'velocity', self._name)
        limits = profile_limits(self._config, speed_max, self._data)
        profile = point_to_point(reference, target, limits, velocity=speed, acceleration=change)
        way = profile.sample(self._config.period)
        rows = zip(
            *(x.tolist() for x in (way.position, way.velocity, way.acceleration)), strict=True
        )
        # the first row is the motion of the period before, which is over if there was any
        self._way = islice(rows, 1 if speed or change else 0, None)


def _records(path: Path) -> dict[str, list[Any]]:
    """Return the records of a bag by topic."""
    seen: dict[str, list[Any]] = defaultdict(list)
    with BagReader(path) as reader:
        space = find_topic(reader, 'servo_state', ServoState.TYPE).removesuffix('servo_state')
        reader.require({f'{space}{name}': kind.TYPE for name, kind in NEEDED.items()})
        kinds = {**NEEDED, **BESIDE}
        names = {f'{space}{name}': name for name in kinds}
        there = [topic for topic in names if topic in reader.connections]
        for message in reader.messages(there):
            name = names[message.topic]
            seen[name].append(decode(kinds[name], message.message))
    return seen


def _configuration(path: Path, seen: dict[str, list[Any]]) -> ServoControllerConfig:
    """Return what the controller began to run with, as far as its moves depend on it."""
    for item in seen['node_configuration']:
        if item.node == ServoController.NAME:
            try:
                given = json.loads(item.parameters)
                # all others may be those of another version
                return ServoControllerConfig(**{n: given[n] for n in _USED if n in given})
            except (TypeError, ValueError) as error:
                raise ValueError(
                    f'{path}: expected the parameters of servo_controller: {error}'
                ) from error
    return ServoControllerConfig()


def _axis(path: Path, axis: str | None, known: set[str]) -> str:
    """Return the axis that is meant."""
    if axis not in known and not (axis is None and len(known) == 1):
        names = sorted(known)
        found = 'none named' if axis is None else repr(axis)
        raise RemediedError(
            f'axis: expected one of the driven axes {", ".join(names) or "(none)"} of {path} but '
            f'found {found}',
            *(Remedy(f'name {name}', {'name': name}) for name in names[:1]),
        )
    return axis if axis is not None else next(iter(known))


def _of(record: Any, field: str, axis: str) -> float:
    """Return a value of an axis; NaN where it has none."""
    names = list(record.axis)
    return float(getattr(record, field)[names.index(axis)]) if axis in names else float('nan')
