# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values that are wrong: NaN, stuck, a jump, a drift; and stamps of another clock."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fuzzycnc_ros.runtime.records import SECOND, Record, nanoseconds

Change = Callable[[Any], Any]
KINDS = ('nan', 'stuck', 'jump', 'drift')
"""How values can be wrong."""


@dataclass(frozen=True)
class Falsified:
    """What is falsified of a topic.

    Attributes
    ----------
    topic : str
        The topic.
    field : str
        Its field, a number or an array.
    jump : float
        What a jump adds, in the unit of the field.
    drift : float
        What a drift adds per hour of machine time, in the unit of the field.
    nan : str
        Field that is NaN instead, where the other has whole numbers.
    """

    topic: str
    field: str
    jump: float
    drift: float
    nan: str = ''

    def name(self, kind: str) -> str:
        """Return the field that is wrong."""
        return (kind == 'nan' and self.nan) or self.field


def _of(*items: Falsified) -> dict[str, Falsified]:
    return {item.topic: item for item in items}


FIELDS = _of(
    Falsified('sensor_readings', 'temperature', 30.0, 20.0),
    Falsified('temperatures', 'temperature', 30.0, 20.0),
    Falsified('machine_state', 'spindle_speed', 1000.0, 1000.0),
    Falsified('displacement', 'displacement', 1e-3, 400e-6),
    Falsified('thermal_error', 'error', 1e-3, 400e-6),
    Falsified('compensation_applied', 'offset', 1e-3, 400e-6),
    Falsified('compensation', 'offset', 1e-3, 400e-6),
)
"""Inputs of thermal compensation; all jumps lie far beyond what the machine may be told."""
_FAST = 36.0
"""Drift of a position [m/h], 10 mm/s: what is falsified lasts for a second or two."""
PATH_FIELDS = {
    **_of(
        Falsified('tool_path', 'data', 1e-2, _FAST),
        Falsified('trajectory', 'position', 1e-3, _FAST),
        Falsified('trajectory_state', 'epoch', 1000.0, 3.6e6, nan='arc_length'),
    ),
    'feed_of_tool_path': Falsified('tool_path', 'feedrate', 1000.0, 3600.0),
    'axis_reference': Falsified('axis_state', 'reference', 1e-3, _FAST),
}
"""Inputs of feeds: those of the scheduler, and what the machine gets from it."""
DRIVE_FIELDS = _of(
    Falsified('axis_state', 'position', 1e-3, _FAST),
    Falsified('axis_command', 'duty', 0.5, 3600.0),
    Falsified('position_command', 'position', 1.0, _FAST),
)
"""Inputs of servo axes: those of the controller, and what the drives get from it."""
PATTERN_FIELDS = _of(
    Falsified('material', 'thickness', 0.5, 3.6),
    Falsified('stitch_pattern', 'end', 5e-3, _FAST),
    Falsified('compensated_path', 'offset', 1e-3, _FAST),
)
"""Inputs of patterns: those of the compensator, and what the machine gets from it."""


def falsified(wrong: Falsified, kind: str) -> Change:
    """Return what falsifies the records of a topic; it remembers the first that it gets.

    Raises
    ------
    ValueError
        If the kind is unknown.
    """
    if kind not in KINDS:
        raise ValueError(f'kind: expected one of {", ".join(KINDS)} but found {kind}')
    name = wrong.name(kind)
    first: list[Record] = []

    def change(record: Any) -> Any:
        first.append(record) if not first else None
        value = getattr(record, name)
        if kind == 'nan':
            new = value * np.nan
        elif kind == 'stuck':
            new = getattr(first[0], name)
        elif kind == 'jump':
            new = value + wrong.jump
        else:
            new = value + wrong.drift * (record.stamp - first[0].stamp) / (3600.0 * SECOND)
        if isinstance(value, int):
            new = round(new)
        return replace(record, **{name: new})

    return change


def shifted(seconds: float) -> Change:
    """Return what moves the stamps of records [s]."""

    def change(record: Any) -> Any:
        return replace(record, stamp=max(0, record.stamp + nanoseconds(seconds)))

    return change


def shifted_clock(seconds: int) -> Change:
    """Return what moves messages of `/clock` [s]."""

    def change(message: Any) -> Any:
        message.clock.sec = max(0, message.clock.sec + seconds)
        return message

    return change
