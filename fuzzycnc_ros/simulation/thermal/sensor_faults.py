# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of temperature sensors as named knobs, and their text form in parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

FAULT_KINDS = ('dead', 'stuck', 'drift', 'open', 'jump')
"""Kinds of faults, as written in the text form."""

_DEFAULT_VALUE = {'drift': 2.0, 'open': 50.0, 'jump': 5.0}
_TEXT_FORM = "sensor:kind:start[:value], for example 'T18:drift:3600:2.0'"


@dataclass(frozen=True)
class SensorFault:
    """One fault of one temperature sensor from a point in time on.

    Parameters
    ----------
    sensor : str
        Name of the sensor.
    kind : {'dead', 'stuck', 'drift', 'open', 'jump'}
        `dead` reads NaN; `stuck` repeats the first reading at or after `start`; `drift` moves
        away by `value` per hour; `open` (an open input) and `jump` add `value` at once.
    start : float
        When it begins, after the start of the run [s].
    value : float, optional
        Drift [K/h] or step [K].  Left out: 2 K/h for `drift`, 50 K for `open`, 5 K for `jump`;
        `dead` and `stuck` take none.

    Raises
    ------
    ValueError
        If the kind is unknown, a number is not finite, the start is negative, or a value is
        given to a kind that takes none.
    """

    sensor: str
    kind: str
    start: float = 0.0
    value: float | None = None

    def __post_init__(self) -> None:
        if not self.sensor:
            raise ValueError(f'sensor: expected a name but found {self.sensor!r}')
        if self.kind not in FAULT_KINDS:
            raise ValueError(
                f'kind of the fault on {self.sensor}: expected one of '
                f'{", ".join(FAULT_KINDS)} but found {self.kind!r}'
            )
        if not (isfinite(self.start) and self.start >= 0.0):
            raise ValueError(
                f'start of the fault on {self.sensor}: expected 0 s or more '
                f'but found {self.start} s'
            )
        if self.value is None:
            object.__setattr__(self, 'value', _DEFAULT_VALUE.get(self.kind))
        elif self.kind not in _DEFAULT_VALUE:
            raise ValueError(
                f'value of the fault on {self.sensor}: expected none for {self.kind!r} '
                f'but found {self.value}'
            )
        elif not isfinite(self.value):
            raise ValueError(
                f'value of the fault on {self.sensor}: expected a finite number '
                f'but found {self.value}'
            )


def parse_sensor_fault(text: str) -> SensorFault:
    """Read a fault from its text form `sensor:kind:start[:value]`.

    Parameters
    ----------
    text : str
        Text form; start in seconds, value in K/h (`drift`) or K (`open`, `jump`).

    Returns
    -------
    SensorFault
        The fault.

    Raises
    ------
    ValueError
        If the text has another form or the fault itself is refused; the message holds the
        text.

    Examples
    --------
    >>> parse_sensor_fault('T18:drift:3600:2.0')
    SensorFault(sensor='T18', kind='drift', start=3600.0, value=2.0)
    """
    parts = [part.strip() for part in text.split(':')]
    if len(parts) not in (3, 4):
        raise ValueError(f'sensor fault: expected {_TEXT_FORM} but found {text!r}')
    try:
        numbers = [float(part) for part in parts[2:]]
    except ValueError:
        raise ValueError(
            f'sensor fault: expected numbers for start and value, as in {_TEXT_FORM}, '
            f'but found {text!r}'
        ) from None
    try:
        return SensorFault(parts[0], parts[1], *numbers)
    except ValueError as error:
        raise ValueError(f'sensor fault {text!r}: {error}') from error


class FaultInjector:
    """Applies faults to readings in the order of time; remembers what stuck sensors hold.

    Parameters
    ----------
    sensors : sequence of str
        Names of the sensors, in the order of the readings.
    faults : sequence of SensorFault
        Faults; several on one sensor act in the order given.

    Raises
    ------
    ValueError
        If a fault names a sensor that does not exist.
    """

    def __init__(self, sensors: Sequence[str], faults: Sequence[SensorFault]) -> None:
        index = {name: i for i, name in enumerate(sensors)}
        unknown = [fault.sensor for fault in faults if fault.sensor not in index]
        if unknown:
            raise ValueError(
                f'sensor faults: expected sensors among {sensors[0]} to {sensors[-1]} '
                f'but found {", ".join(unknown)}'
            )
        self._faults = [(index[fault.sensor], fault) for fault in faults]
        self._held: dict[int, float] = {}

    def apply(self, time: float, readings: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the readings as the faulty sensors give them.

        Parameters
        ----------
        time : float
            Time of the readings after the start of the run [s]; calls go forward in time.
        readings : ndarray, shape (sensors,)
            Healthy readings [degC]; not changed.

        Returns
        -------
        ndarray, shape (sensors,)
            Readings [degC] with the faults that have begun.
        """
        faulty = readings.copy()
        for number, (sensor, fault) in enumerate(self._faults):
            if time < fault.start:
                continue
            if fault.kind == 'dead':
                faulty[sensor] = np.nan
            elif fault.kind == 'stuck':
                faulty[sensor] = self._held.setdefault(number, float(faulty[sensor]))
            elif fault.value is not None:
                hours = (time - fault.start) / 3600.0 if fault.kind == 'drift' else 1.0
                faulty[sensor] += fault.value * hours
        return faulty
