# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values that are wrong: NaN, stuck, a jump, a drift; and stamps of another clock."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fuzzycnc_ros.components.records import SECOND, Record, nanoseconds

Change = Callable[[Any], Any]
KINDS = ('nan', 'stuck', 'jump', 'drift')
"""How values can be wrong."""


@dataclass(frozen=True)
class Falsified:
    """Which field of a topic is falsified.

    Attributes
    ----------
    field : str
        The field, a number or an array.
    jump : float
        What a jump adds, in the unit of the field.
    drift : float
        What a drift adds per hour of machine time, in the unit of the field.
    """

    field: str
    jump: float
    drift: float


FIELDS = {
    'sensor_readings': Falsified('temperature', 30.0, 20.0),
    'temperatures': Falsified('temperature', 30.0, 20.0),
    'machine_state': Falsified('spindle_speed', 1000.0, 1000.0),
    'displacement': Falsified('displacement', 1e-3, 400e-6),
    'thermal_error': Falsified('error', 1e-3, 400e-6),
    'compensation_applied': Falsified('offset', 1e-3, 400e-6),
    'compensation': Falsified('offset', 1e-3, 400e-6),
}
"""What is falsified on each input; all jumps lie far beyond what the machine may be told."""


def falsified(topic: str, kind: str) -> Change:
    """Return what falsifies the records of a topic; it remembers the first that it gets.

    Raises
    ------
    ValueError
        If the kind is unknown.
    """
    if kind not in KINDS:
        raise ValueError(f'kind: expected one of {", ".join(KINDS)} but found {kind}')
    wrong = FIELDS[topic]
    first: list[Record] = []

    def change(record: Any) -> Any:
        first.append(record) if not first else None
        value = getattr(record, wrong.field)
        if kind == 'nan':
            new = value * np.nan
        elif kind == 'stuck':
            new = getattr(first[0], wrong.field)
        elif kind == 'jump':
            new = value + wrong.jump
        else:
            new = value + wrong.drift * (record.stamp - first[0].stamp) / (3600.0 * SECOND)
        return replace(record, **{wrong.field: new})

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
