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
