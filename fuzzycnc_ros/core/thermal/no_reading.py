# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values that stand for no reading: what sensors, inputs and loggers say when they have none."""

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.run import SAMPLES_MIN, TEMPERATURE_MAX, TEMPERATURE_MIN

FAR = 10.0
"""Difference to the next other readings that shows that a value is none [K]."""

ROUNDED = 1e-6
"""Difference of a value within the range to a known one that is rounding [degC]."""

_POWER_ON = 85.0

_MEANINGS = {
    _POWER_ON: 'what a DS18B20 says at power-on, before it has measured',
    0.0: 'what inputs say without a sensor',
    -127.0: 'what drivers of the DS18B20 say of a sensor that does not answer',
    **dict.fromkeys(
        (327.67, -327.68, 3276.7, -3276.8, 32767.0, -32768.0, 655.35, 6553.5, 65535.0),
        'the end of the range of a 16-bit input',
    ),
    **dict.fromkeys((850.0, -200.0, -242.02, 988.79), 'the end of the range of a Pt100 input'),
    **dict.fromkeys(
        (1372.0, 1370.0, 1200.0, 1000.0, 400.0, 1300.0, 1768.0, 1820.0, -270.0, -210.0),
        'the end of the range of a thermocouple input',
    ),
    **dict.fromkeys((-273.15, -273.1, -459.67), 'absolute zero'),
    **dict.fromkeys((-40.0, -45.0, -46.85, 125.0, 127.94, 128.0, 130.0), 'the end of a range'),
}
"""Values that stand for no reading, in the unit of the file or in degC, and what they are."""

_NINES = re.compile(r'-?9{2,}(\.9+)?')


class NoReading(NamedTuple):
    """A value that a sensor has where it read nothing.

    Parameters
    ----------
    column : int
        The sensor.
    value : float
        The value in the file.
    meaning : str
        What it stands for.
    rows : ndarray of int
        Where it is.
    clear : bool
        Whether other readings show that it is none; if not, the sensor says nothing else.
    """

    column: int
    value: float
    meaning: str
    rows: NDArray[np.int64]
    clear: bool


def values_without_reading(raw: Array, temperature: Array) -> list[NoReading]:
    """Return the values that stand for no reading.

    Parameters
    ----------
    raw : ndarray, shape (n, s)
        Values of the file, in its own unit; NaN where one is missing.
    temperature : ndarray, shape (n, s)
        The same in degC.

    Notes
    -----
    A value counts as none if it is known for that, or is one that no machine has again and again,
    and the next other readings on both sides are over 10 K off, which metal cannot be.  A sensor
    that has no other reading at all is judged by the median of the other sensors, and without
    those it is not clear.
    """
    found = []
    impossible = (temperature < TEMPERATURE_MIN) | (temperature > TEMPERATURE_MAX)
    suspects = np.zeros(raw.shape, dtype=bool)
    kinds: list[tuple[int, float, str]] = []
    for column, (own, warm) in enumerate(zip(raw.T, temperature.T, strict=True)):
        known = np.flatnonzero(np.isfinite(own))
        values, first, counts = np.unique(own[known], return_index=True, return_counts=True)
        degrees = warm[known[first]]
        beyond = ~((degrees >= TEMPERATURE_MIN) & (degrees <= TEMPERATURE_MAX))
        for place in np.flatnonzero(beyond | _is_known(values) | _is_known(degrees)).tolist():
            value, count = float(values[place]), counts[place]
            meaning = _meaning(value, float(degrees[place]), bool(beyond[place]))
            if not meaning and beyond[place] and 2 <= count < len(known):
                meaning = f'in {count} rows exactly, and no machine has it'
            if meaning:
                kinds.append((column, value, meaning))
                suspects[own == value, column] = True
    if not kinds:
        return []
    sound = np.where(suspects, np.nan, temperature)
    # Only of interest beside a sensor that says nothing else, and so is not one of them.
    level = _median(np.where(impossible, np.nan, sound))
    for column, value, meaning in kinds:
        at = np.flatnonzero(raw[:, column] == value)
        clear = _is_far(temperature[at, column], at, sound[:, column], level[at])
        alone = len(at) == len(raw) and not np.isfinite(level).any()
        if clear or alone:
            found.append(NoReading(column, value, meaning, at, clear))
    return found


def _meaning(value: float, degrees: float, beyond: bool) -> str:
    for known, meaning in _MEANINGS.items():
        # One decimal may be all that a logger writes; within the range only the value itself is.
        near = 0.05 if beyond else ROUNDED
        if abs(value - known) <= near or abs(degrees - known) <= near:
            return meaning
    if beyond and _NINES.fullmatch(f'{value:.10g}'):
        return 'what loggers write for no reading'
    return ''


def _is_known(values: Array) -> NDArray[np.bool_]:
    """Return whether values within the range are among the known ones."""
    off = np.abs(values[:, np.newaxis] - np.array(list(_MEANINGS)))
    return np.asarray((off <= ROUNDED).any(axis=1))


def _median(temperature: Array) -> Array:
    """Return the median of the sensors for each reading, NaN without any."""
    level = np.full(len(temperature), np.nan)
    rows = np.isfinite(temperature).any(axis=1)
    if rows.any():
        level[rows] = np.nanmedian(temperature[rows], axis=1)
    return level


def _is_far(values: Array, at: NDArray[np.int64], own: Array, level: Array) -> bool:
    """Return whether values are far off what the sensor reads beside them, or the others."""
    rows = np.flatnonzero(np.isfinite(own))
    if not len(rows):
        # All that a sensor says: one value throughout is no reading if the others are elsewhere.
        known = np.isfinite(level)
        return len(at) >= SAMPLES_MIN and bool(
            known.any() and (np.abs(values - level)[known] > FAR).all()
        )
    place = np.searchsorted(rows, at)
    before, behind = (
        own[rows[np.maximum(place - 1, 0)]],
        own[rows[np.minimum(place, len(rows) - 1)]],
    )
    before = np.where(place > 0, before, behind)
    behind = np.where(place < len(rows), behind, before)
    off = np.minimum(np.abs(values - before), np.abs(values - behind))
    return bool((off > FAR).all())
