# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded moves of one axis, as a table or from a CSV file, for `fuzzycnc servo learn`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fuzzycnc_ros.cli.models.number_table import read_numbers

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
"""What the axis' gain may be against the nominal one."""

_LATE = 0.1
"""What a stamp may be off a period, as share of it."""


@dataclass(frozen=True, eq=False)
class Moves:
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


def records_of(moves: Moves, controller: VariableUniverseController, source: Path) -> Array:
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


def _check_gain(moves: Moves, controller: VariableUniverseController, source: Path) -> None:
    """Refuse lengths in a wrong unit and an axis that is driven the other way."""
    period, gain = controller.period, controller.axis.gain
    driven = moved = 0.0
    for part in moves.stretches(period):
        position, duty = moves.position[part], moves.duty[part]
        speed = (position[BLOCK:] - position[:-BLOCK]) / (BLOCK * period)
        mean = np.convolve(duty, np.full(BLOCK, 1.0 / BLOCK), 'valid')[: len(speed)]
        driven += float(mean @ mean)
        moved += float(mean @ speed)
    ratio = moved / (driven * gain) if driven else 0.0
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


def read_csv(path: Path, metres: float) -> Moves:
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
    return Moves(time, metres * reference, metres * position, duty)
