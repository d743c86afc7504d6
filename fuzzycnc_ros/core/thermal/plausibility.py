# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What looks like a mistake in a recording, though no value of it is impossible."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.ranking import correlation_of
from fuzzycnc_ros.core.thermal.run import SAMPLES_MIN, ThermalRun

TEMPERATURE_STEP = 2.0
"""Change between two readings that is never a mistake [K]; `noise_band` of the acquisition."""

DISPLACEMENT_STEP = 5e-6
"""Change between two probes that is never a mistake [m]."""

NOISE_FACTOR = 10.0
"""Change over the scatter of the other samples from which one stands alone [-]."""

TELLING = 0.5
"""Least size of a correlation that says which way a channel moves [-]."""

RISE_TELLING, MOTION_TELLING = 2.0, 2e-6
"""Least range of rises [K] and displacements [m] that says so."""

SHIFTED = 15.0
"""Difference to the other sensors at the start of a run, against other runs, that is odd [K]."""

RUNS_MIN = 3
"""Least number of runs that tell what is usual."""

WARM = 5.0
"""Least range of a sensor that shows how fast a machine warms [K]; below it may be noise."""


class Lone(NamedTuple):
    """A value that stands alone: both neighbours agree, and are far off.

    Parameters
    ----------
    row, column : int
        Its place.
    before, value, behind : float
        The values; at an end both neighbours are those of the one side.
    """

    row: int
    column: int
    before: float
    value: float
    behind: float


def lone_values(values: Array, step: float) -> Iterator[Lone]:
    """Yield the values (n, w) that stand alone, column by column.

    Parameters
    ----------
    values : ndarray, shape (n, w)
        Readings; NaN where one is missing: the neighbours are the next that there are.
    step : float
        Difference to both neighbours that is never a mistake.

    Notes
    -----
    A value stands alone if it differs from both neighbours to the same side by more than `step`
    and ten times the scatter of the column, and these from each other by no more than half as
    much.  The scatter is that of second differences, by their median: a slope is none, and a few
    spikes do not raise it.
    """
    for column, readings in enumerate(values.T):
        rows = np.flatnonzero(np.isfinite(readings))
        if len(rows) < SAMPLES_MIN:
            continue
        own = readings[rows]
        bend = own[1:-1] - 0.5 * (own[:-2] + own[2:])
        limit = max(step, NOISE_FACTOR * 1.4826 * float(np.median(np.abs(bend))))
        before = np.concatenate([own[[2]], own[:-1]])
        behind = np.concatenate([own[1:], own[[-3]]])
        left, right = own - before, own - behind
        apart = np.minimum(np.abs(left), np.abs(right))
        lone = (
            ((left > 0.0) == (right > 0.0))
            & (apart > limit)
            & (np.abs(before - behind) < 0.5 * apart)
        )
        for at in np.flatnonzero(lone):
            yield Lone(int(rows[at]), column, float(before[at]), float(own[at]), float(behind[at]))


def half_rise_time(time: Array, temperature: Array) -> float:
    """Return the least time in which the sensor that warms most gains half of its range [s].

    Parameters
    ----------
    time : ndarray, shape (n,)
        Times [s].
    temperature : ndarray, shape (n, s)
        Temperatures [degC], NaN where missing.

    Returns
    -------
    float
        NaN where no sensor rises by half of its range, or none ranges over 5 K.
    """
    known = temperature[:, np.isfinite(temperature).sum(axis=0) >= SAMPLES_MIN]
    if not known.shape[1]:
        return np.nan
    span = np.nanmax(known, axis=0) - np.nanmin(known, axis=0)
    column = int(np.argmax(span))
    rows = np.isfinite(known[:, column])
    readings, at = known[rows, column], time[rows]
    if span[column] < WARM:
        return np.nan
    lag = 1
    while lag < len(readings):
        gained = readings[lag:] - readings[:-lag] >= 0.5 * span[column]
        if gained.any():
            return float((at[lag:] - at[:-lag])[gained].min())
        lag = max(lag + 1, round(1.1 * lag))
    return np.nan


class _Shifted(NamedTuple):
    """A sensor that begins some runs far off.

    Parameters
    ----------
    sensor : str
        The sensor.
    start : dict of str to float
        First temperature in these runs, by name [degC].
    off : float
        Largest difference to what is usual, against the other sensors [K].
    """

    sensor: str
    start: dict[str, float]
    off: float


def shifted_sensors(runs: Sequence[ThermalRun]) -> Iterator[_Shifted]:
    """Yield the sensors that alone begin some runs far off the others, and other runs not.

    What counts is the first reading less the median of all sensors, against the median of this
    over the runs.  A warm start moves several sensors; one is alone if no other is half as far
    off.
    """
    names = [
        name
        for name in runs[0].sensor
        if all(name in run.sensor for run in runs) and any(_read(run, name) for run in runs)
    ]
    if len(runs) < RUNS_MIN or len(names) < RUNS_MIN:
        return
    first = np.array([_first(run, names) for run in runs])
    apart = first - np.nanmedian(first, axis=1, keepdims=True)
    off = np.nan_to_num(apart - np.nanmedian(apart, axis=0))
    size = np.abs(off)
    alone = size > 2.0 * np.sort(size, axis=1)[:, [-2]]
    for column, name in enumerate(names):
        odd = np.flatnonzero(alone[:, column] & (size[:, column] > SHIFTED)).tolist()
        if odd:
            start = {runs[row].name: float(first[row, column]) for row in odd}
            yield _Shifted(name, start, float(off[odd[size[odd, column].argmax()], column]))


def _read(run: ThermalRun, name: str) -> bool:
    return bool(np.isfinite(run.temperature[:, run.sensor.index(name)]).any())


def _first(run: ThermalRun, names: Sequence[str]) -> Array:
    """Return the first reading of each sensor [degC]; NaN of one that has none."""
    values = run.temperature[:, [run.sensor.index(name) for name in names]]
    first: Array = values[np.isfinite(values).argmax(axis=0), np.arange(len(names))]
    return first


class _Turned(NamedTuple):
    """A channel that moves with the temperatures in some runs and against them in others.

    Parameters
    ----------
    channel : str
        The channel.
    against : dict of str to float
        Correlation in the runs that are fewer, by name; where there are as many of both, in
        those in which it is negative.
    others : dict of str to float
        Correlation in the others.
    """

    channel: str
    against: dict[str, float]
    others: dict[str, float]


def turned_channels(runs: Sequence[ThermalRun]) -> Iterator[_Turned]:
    """Yield the channels whose sign differs between runs of one machine.

    The sign is that of the correlation with the mean rise of all sensors; runs in which it tells
    little, or that hardly warm or move, are left out.
    """
    for channel in runs[0].channel:
        found = {run.name: _correlation(run, channel) for run in runs if channel in run.channel}
        told = {name: value for name, value in found.items() if abs(value) >= TELLING}
        falling = {name: value for name, value in told.items() if value < 0.0}
        rising = {name: value for name, value in told.items() if value > 0.0}
        if falling and rising:
            yield _Turned(channel, *sorted((falling, rising), key=len))


def _correlation(run: ThermalRun, channel: str) -> float:
    """Return the correlation of a channel with the mean rise; 0 where it tells nothing."""
    moved = run.displacement[:, run.channel.index(channel)]
    rise = run.bridged().rise()
    rise = rise[:, np.isfinite(rise).all(axis=0)].mean(axis=1, keepdims=True)
    rows = np.isfinite(moved) & np.isfinite(rise[:, 0])
    if rows.sum() < SAMPLES_MIN:
        return 0.0
    moved, rise = moved[rows], rise[rows]
    if np.ptp(rise) < RISE_TELLING or np.ptp(moved) < MOTION_TELLING:
        return 0.0
    return float(correlation_of(rise, moved[:, np.newaxis])[0, 0])
