# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors of a machine at rest: which of them differ, by how much, and how surely."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array

HOUR = 3600.0
REST_WINDOW = 1800.0
"""Time that is judged, of a longer recording the quietest such time [s]."""
SPAN = 2.0 * HOUR
"""Time over which drift is looked at, up to the end of the window [s]: over a short one noise may
hide it."""
REST_WINDOW_MIN = 120.0
"""Shortest time that tells drift from noise [s]."""
READINGS_MIN = 10
"""Fewest readings of a sensor in the window."""
DRIFT_MAX = 0.5
"""Drift from which a sensor is plainly not at rest [K/h]."""
LAG = 2.0
"""Time by which parts of a machine follow the air apart from each other, at most [h]."""
SPINDLE_STOOD = 2.0 * HOUR
"""Time for which the spindle has to have stood before the window, as far as it is known [s]."""
AGREE = 2.0
"""Distance from the median within which a sensor of a machine at one temperature reads [K]."""
OFFSET_MAX = 5.0
"""Largest difference that an offset mends; beyond it something else is wrong [K]."""
SURE = 2.0
"""Standard errors that an uncertainty spans."""
MISTAKEN_UNITS = {
    'kelvin': (1.0, -273.15),
    'degF': (5.0 / 9.0, -160.0 / 9.0),
    'tenths of a degree': (0.1, 0.0),
    'hundredths of a degree': (0.01, 0.0),
}
"""Factor and offset to degC of units that are taken for it."""


class NotAtRestError(ValueError):
    """The sensors cannot be compared; the message says why and what to do."""


@dataclass(frozen=True)
class SensorAtRest:
    """A sensor in the window.

    Parameters
    ----------
    sensor : str
        Its name.
    temperature : float
        Mean [degC].
    difference : float
        Mean above the reference [K].
    uncertainty : float
        Of the difference: noise, resolution, and the drift that there may be, times `LAG` [K].
    drift : float
        Slope of its readings [K/h].
    verdict : str
        `agrees`, `differs`, `moves`, `missing` or the unit that its readings seem to have.
    """

    sensor: str
    temperature: float
    difference: float
    uncertainty: float
    drift: float
    verdict: str

    @property
    def offset(self) -> float:
        """Correction to add to the sensor's offset [K]; 0 where that would mend nothing."""
        return -self.difference if self.verdict == 'differs' else 0.0


@dataclass(frozen=True)
class RestCheck:
    """Sensors compared.

    Parameters
    ----------
    start, stop : float
        Window [s].
    readings : int
        Sets of readings in it.
    reference : float
        Temperature that they are compared with [degC].
    reference_sensor : str
        The sensor that reads it; empty for the median of those that agree.
    quiet : float
        Time for which the spindle is known to have stood until the end of the window [s]; NaN
        where nothing is known of it.
    sensors : tuple of SensorAtRest
        The sensors.
    """

    start: float
    stop: float
    readings: int
    reference: float
    reference_sensor: str
    quiet: float
    sensors: tuple[SensorAtRest, ...]


def check_at_rest(
    time: Array,
    temperature: Array,
    sensor: Sequence[str],
    speed: Array | None = None,
    reference: str = '',
    tolerance: float = 0.3,
) -> RestCheck:
    """Compare sensors that all are at one temperature, as after a night.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Times of the readings [s], increasing.
    temperature : ndarray, shape (n, k)
        Readings [degC], NaN where there is none.
    sensor : sequence of str
        Their names.
    speed : ndarray, shape (n,), optional
        Spindle speed [rad/s], NaN where it is not known.
    reference : str
        Sensor to compare with; empty for the median, which needs three sensors.
    tolerance : float
        Difference that is none [K].

    Raises
    ------
    NotAtRestError
        If the readings are too few, or plainly are not of a machine at one temperature.
    """
    _check_enough(time, sensor, reference)
    turning = None if speed is None else time[np.nan_to_num(speed) != 0.0]
    inside, slope, error = _quietest(time, temperature, turning)
    start, stop = float(time[inside][0]), float(time[inside][-1])
    chosen = temperature[inside]
    counts = np.isfinite(chosen).sum(axis=0)
    there = counts >= READINGS_MIN
    moves = there & (np.abs(slope) - SURE * error > DRIFT_MAX)
    still = there & ~moves
    if 2 * moves.sum() > there.sum() or still.sum() < 2:
        drifts = ', '.join(
            f'{name} {value:+.2g}' for name, value in zip(sensor, slope, strict=True) if value
        )
        raise NotAtRestError(
            f'expected at least two sensors, and most, that drift by less than {DRIFT_MAX:g} K/h '
            f'but in the quietest time, {start:.6g} to {stop:.6g} s, they drift by {drifts} K/h; '
            'switch the machine off, leave it over night, and read before anything is switched on'
        )
    mean = np.array([_mean(column) for column in chosen.T])
    level, source = _reference(mean, still, sensor, reference)
    noise = np.array([_noise(column) for column in chosen.T])
    common = float(np.median(slope[still]))
    drift = np.maximum(np.abs(slope), np.maximum(abs(common), np.abs(slope - common)))
    unsure = LAG * (drift + error) + SURE * noise / np.sqrt(np.maximum(counts, 1))
    rows = []
    for place, name in enumerate(sensor):
        difference = float(mean[place] - level)
        if not there[place]:
            verdict = 'missing'
        elif abs(difference) > OFFSET_MAX:
            verdict = _unit(float(mean[place]), level) or ('moves' if moves[place] else 'wrong')
        elif moves[place]:
            verdict = 'moves'
        else:
            far = abs(difference) > max(tolerance, float(unsure[place]))
            verdict = 'differs' if far else 'agrees'
        rows.append(
            SensorAtRest(
                name,
                float(mean[place]),
                difference,
                float(unsure[place]),
                float(slope[place]),
                verdict,
            )
        )
    quiet = np.nan
    if turning is not None:
        before = turning[turning < start]
        quiet = stop - float(before[-1] if len(before) else time[0])
    return RestCheck(start, stop, int(inside.sum()), level, source, quiet, tuple(rows))


def _check_enough(time: Array, sensor: Sequence[str], reference: str) -> None:
    if reference and reference not in sensor:
        raise NotAtRestError(
            f'reference: expected one of {", ".join(sensor)} but found {reference!r}'
        )
    if len(sensor) < 2 or (len(sensor) < 3 and not reference):
        raise NotAtRestError(
            f'expected three sensors, or two and the one of them that is right as reference, but '
            f'found {len(sensor)}: of two that differ either may be wrong'
        )
    lasts = float(time[-1] - time[0]) if len(time) else 0.0
    if lasts < REST_WINDOW_MIN or len(time) < READINGS_MIN:
        raise NotAtRestError(
            f'expected readings over at least {REST_WINDOW_MIN:g} s, {READINGS_MIN} of them, but '
            f'found {len(time)} over {lasts:.6g} s; read for longer'
        )


def _quietest(
    time: Array, temperature: Array, turning: Array | None
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Return the window of the least drift, and the drifts and their errors there [K/h]."""
    lasts = float(time[-1] - time[0])
    starts = time[0] + np.arange(0.0, max(lasts - REST_WINDOW, 0.0) + 1.0, REST_WINDOW / 3.0)
    best: tuple[float, NDArray[np.bool_], Array, Array] | None = None
    turned = False
    for start in starts:
        end = start + REST_WINDOW
        inside = (time >= start) & (time <= end)
        if turning is not None and ((turning >= start - SPINDLE_STOOD) & (turning <= end)).any():
            turned = True
            continue
        if inside.sum() < READINGS_MIN:
            continue
        span = (time >= end - SPAN) & (time <= end)
        slope, error = _drift(time[span], temperature[span])
        # Of one that is broken each window has as much.
        drift = float(np.minimum(np.abs(slope) + error, DRIFT_MAX).mean())
        if best is None or drift < best[0]:
            best = (drift, inside, slope, error)
    if best is None and turned:
        raise NotAtRestError(
            f'expected {REST_WINDOW / 60.0:g} min with the spindle at rest, as it has been for '
            f'{SPINDLE_STOOD / HOUR:g} h, but found none; leave the machine off overnight'
        )
    if best is None:
        raise NotAtRestError(
            f'expected {READINGS_MIN} readings within {REST_WINDOW / 60.0:g} min but found fewer; '
            'read more often'
        )
    return best[1:]


def _drift(time: Array, temperature: Array) -> tuple[Array, Array]:
    """Return slopes and their standard errors [K/h], zero of a sensor with too few readings."""
    slope, error = np.zeros(temperature.shape[1]), np.zeros(temperature.shape[1])
    for place, column in enumerate(temperature.T):
        good = np.isfinite(column)
        count = int(good.sum())
        if count < READINGS_MIN:
            continue
        hours = (time[good] - time[good].mean()) / HOUR
        spread = float(np.sum(hours * hours))
        slope[place] = float(np.sum(hours * (column[good] - column[good].mean()))) / spread
        rest = column[good] - column[good].mean() - slope[place] * hours
        error[place] = float(np.sqrt(np.sum(rest * rest) / (count - 2) / spread))
    return slope, error


def _reference(
    mean: Array, still: NDArray[np.bool_], sensor: Sequence[str], reference: str
) -> tuple[float, str]:
    """Return what the sensors are compared with, and the sensor that reads it."""
    if reference:
        place = list(sensor).index(reference)
        if not still[place]:
            raise NotAtRestError(
                f'reference: expected a sensor at rest but {reference} moves or is missing'
            )
        return float(mean[place]), reference
    median = float(np.median(mean[still]))
    agree = still & (np.abs(mean - median) <= AGREE)
    if 2 * agree.sum() <= still.sum():
        read = ', '.join(f'{n} {v:.1f}' for n, v, s in zip(sensor, mean, still, strict=True) if s)
        raise NotAtRestError(
            f'expected most sensors within {AGREE:g} K of each other but they read {read} degC: '
            'the machine is not at one temperature, or most sensors are wrong; leave it over '
            'night, or name the one that is right as reference'
        )
    return float(np.median(mean[agree])), ''


def _mean(column: Array) -> float:
    good = column[np.isfinite(column)]
    return float(good.mean()) if len(good) else np.nan


def _noise(column: Array) -> float:
    """Return the standard error of one reading [K]: noise, or half of the smallest step."""
    good = column[np.isfinite(column)]
    if len(good) < 2:
        return np.nan
    steps = np.abs(np.diff(np.unique(good)))
    # Readings that share a step are wrong together: averaging does not help.
    coarse = 0.5 * float(steps.min()) * np.sqrt(len(good)) / SURE if len(steps) else 0.0
    return max(float(np.diff(good).std() / np.sqrt(2.0)), coarse)


def _unit(value: float, level: float) -> str:
    """Return the unit in which a value would be about the reference; empty if none fits."""
    near = [name for name, found in in_units(value).items() if abs(found - level) <= AGREE]
    return f'reads {near[0]}?' if near else ''


def in_units(value: float) -> dict[str, float]:
    """Return what a value taken for degC is [degC] if it is in another unit.

    Examples
    --------
    >>> round(in_units(295.15)['kelvin'], 2)
    22.0
    """
    return {name: factor * value + offset for name, (factor, offset) in MISTAKEN_UNITS.items()}
