# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Likely mistakes in a recording, though no value of it is impossible."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.run import SAMPLES_MIN, ThermalRun

TEMPERATURE_STEP = 2.0
"""Change between two readings that is never a mistake [K]; `noise_band` of the acquisition."""

DISPLACEMENT_STEP = 5e-6
"""Change between two probes that is never a mistake [m]."""

NOISE_FACTOR = 10.0
"""Change over the scatter of the other samples from which one stands alone [-]."""

MOTION_TELLING = 2e-6
"""Least size of a displacement that tells anything [m]."""

OFFSET_SHARE = 0.1
"""Share of the range from which a displacement does not begin at zero [-]."""

WARMING_MIN, WARMING_MAX = 180.0, 3.0 * 86400.0
"""Times between which a machine gains half of its rise [s]."""

PACE_MARGIN = 5.0
"""Margin on these times for the others where two sensors or probes are outside [-]."""

SHIFTED = 15.0
"""Difference to the other sensors at the start of a run, against other runs, that is odd [K]."""

RUNS_MIN = 3
"""Least number of runs that tell what is usual."""

WARM = 2.0
"""Least range of a sensor that shows how fast a machine warms [K]."""


class Outlier(NamedTuple):
    """A value that stands alone: both neighbours agree, and are far off.

    Parameters
    ----------
    row, column : int
        Its place, or its first one.
    before, value, behind : float
        The values; at an end both neighbours are those of the one side.
    place : {'between', 'before', 'behind'}
        Where the value is to these neighbours.
    held : int
        Readings in a row that have exactly this value.
    """

    row: int
    column: int
    before: float
    value: float
    behind: float
    place: str
    held: int = 1

    def neighbours(self, scale: float) -> str:
        """Return where the value stands, the neighbours multiplied by a scale."""
        return f'{self.place} {self.before * scale:.4g} and {self.behind * scale:.4g}'


def lone_values(values: Array, step: float, held: float = np.inf) -> Iterator[Outlier]:
    """Yield the values (n, w) that stand alone, column by column.

    Parameters
    ----------
    values : ndarray, shape (n, w)
        Readings; NaN where one is missing: the neighbours are the next that there are.
    step : float
        Difference to both neighbours that is never a mistake.
    held : float
        The same for several readings in a row of exactly one value.

    Notes
    -----
    A value, however many readings in a row have it, stands alone if it differs from both
    neighbours to the same side by more than `step` and ten times the scatter of the column, and
    these from each other by no more than half as much; at an end, where both are of one side and a
    fast rise looks alike, by no more than a tenth.  The scatter is that of second differences, by
    their median: a slope is none, and a few
    spikes do not raise it.
    """
    for column, readings in enumerate(values.T):
        rows = np.flatnonzero(np.isfinite(readings))
        if len(rows) < SAMPLES_MIN:
            continue
        own = readings[rows]
        bend = own[1:-1] - 0.5 * (own[:-2] + own[2:])
        limit = max(step, NOISE_FACTOR * 1.4826 * float(np.median(np.abs(bend))))
        first = np.flatnonzero(np.diff(own, prepend=np.nan) != 0.0)
        if len(first) < 3:
            continue
        count = np.diff(first, append=len(own))
        rows, own = rows[first], own[first]
        before = np.concatenate([own[[2]], own[:-1]])
        behind = np.concatenate([own[1:], own[[-3]]])
        left, right = own - before, own - behind
        apart = np.minimum(np.abs(left), np.abs(right))
        share = np.full(len(own), 0.5)
        share[[0, -1]] = 0.1
        lone = (
            ((left > 0.0) == (right > 0.0))
            & (apart > np.where(count > 1, max(limit, held), limit))
            & (np.abs(before - behind) < share * apart)
        )
        for at in np.flatnonzero(lone).tolist():
            place = {0: 'before', len(own) - 1: 'behind'}.get(at, 'between')
            near = (own[1], own[2]) if at == 0 else (before[at], behind[at])
            near = (own[-3], own[-2]) if at == len(own) - 1 else near
            yield Outlier(
                int(rows[at]),
                column,
                float(near[0]),
                float(own[at]),
                float(near[1]),
                place,
                int(count[at]),
            )


def half_change_times(time: Array, values: Array, least: float) -> Array:
    """Return the least time in which each column changes by half of its range, shape (w,) [s].

    Parameters
    ----------
    time : ndarray, shape (n,)
        Times [s].
    values : ndarray, shape (n, w)
        Readings, NaN where missing.
    least : float
        Least range of a column that shows how fast it changes.

    Returns
    -------
    ndarray
        NaN for a column that ranges over less, or over less than twenty times its noise, or has
        less than eight readings.
    """
    return np.array([_half_change(time, column, least) for column in values.T])


def _half_change(time: Array, values: Array, least: float) -> float:
    rows = np.isfinite(values)
    readings, at = values[rows], time[rows]
    if len(readings) < SAMPLES_MIN or np.ptp(readings) < max(least, 20.0 * _noise(readings)):
        return np.nan
    half = 0.5 * float(np.ptp(readings))
    lag = 1
    while lag < len(readings):
        changed = np.abs(readings[lag:] - readings[:-lag]) >= half
        if changed.any():
            return float((at[lag:] - at[:-lag])[changed].min())
        lag = max(lag + 1, round(1.1 * lag))
    return np.nan


def _noise(readings: Array) -> float:
    """Return the standard deviation of the noise of readings, by their second differences."""
    return float(np.median(np.abs(np.diff(readings, 2))) / (0.6745 * np.sqrt(6.0)))


class WarmingRate(NamedTuple):
    """Rate at which a machine warms and moves.

    Parameters
    ----------
    time : float
        Time in which a sensor or probe changes by half of its range, by their median [s].
    agreeing, witnesses : int
        How many of them are outside what machines do, to the same side, and of how many.
    """

    time: float
    agreeing: int
    witnesses: int


def odd_pace(time: Array, temperature: Array, displacement: Array) -> WarmingRate | None:
    """Return how fast a machine warms and moves where that is faster or slower than machines do.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Times [s].
    temperature : ndarray, shape (n, s)
        Temperatures [degC], NaN where missing.
    displacement : ndarray, shape (n, c)
        Displacements [m], NaN where missing.

    Notes
    -----
    Sensors that range over 2 K count, and channels that range over 5 um.  One sensor close to a
    heater may warm in a minute: two have to be outside what machines do, and all others near it.
    Where there is one alone, it decides, and says little.
    """
    found = np.concatenate(
        [
            half_change_times(time, temperature, WARM),
            half_change_times(time, displacement, DISPLACEMENT_STEP),
        ]
    )
    if not np.isfinite(found[: temperature.shape[1]]).any():
        return None
    found = found[np.isfinite(found)]
    needed = min(2, len(found))
    fast, slow = int((found < WARMING_MIN).sum()), int((found > WARMING_MAX).sum())
    if fast >= needed and found.max() < PACE_MARGIN * WARMING_MIN:
        return WarmingRate(float(np.median(found)), fast, len(found))
    if slow >= needed and found.min() > WARMING_MAX / PACE_MARGIN:
        return WarmingRate(float(np.median(found)), slow, len(found))
    return None


def offset_channels(displacement: Array, begin: int) -> list[tuple[int, float, float]]:
    """Return the channels that do not begin at zero: column, first value and range [m].

    Parameters
    ----------
    displacement : ndarray, shape (n, c)
        Displacements [m], NaN where missing.
    begin : int
        Number of first rows over which temperatures are zeroed.

    Notes
    -----
    The first value is the smallest of the first rows, so that a machine that moves at once is
    not doubted.  It must be larger than a tenth of the range, 2 um, and five times the noise;
    a larger range says how much the model has to explain.
    """
    found = []
    for column, values in enumerate(displacement.T):
        first = values[:begin][np.isfinite(values[:begin])]
        known = values[np.isfinite(values)]
        if not len(first) or len(known) < SAMPLES_MIN:
            continue
        span = float(np.ptp(known))
        same_side = bool((first > 0.0).all() or (first < 0.0).all())
        least = float(np.abs(first).min())
        if same_side and least > max(
            OFFSET_SHARE * span, MOTION_TELLING, NOISE_FACTOR * _noise(known) / 2
        ):
            found.append((column, float(first.mean()), span))
    return found


class _Shifted(NamedTuple):
    """A sensor that is far off in some runs.

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
    """Yield the sensors that alone begin some runs far off the others, and stay so.

    What counts is the first reading less the median of all sensors, against the median of this
    over the runs.  A warm start moves several sensors; one is alone if no other is half as far
    off.  One sensor that was warm at the start comes back to the others; one that is broken stays
    off: the median over the run has to be off by half as much.  More than a third of the runs are
    no exception, and neither is one of runs that do not agree among themselves.
    """
    names = [
        name
        for name in runs[0].sensor
        if all(name in run.sensor for run in runs) and any(_read(run, name) for run in runs)
    ]
    if len(runs) < RUNS_MIN or len(names) < RUNS_MIN:
        return
    first = np.array([_first(run, names) for run in runs])
    off = _against_usual(first)
    stays = _against_usual(np.array([_middle(run, names) for run in runs]))
    size = np.abs(off)
    alone = size > 2.0 * np.sort(size, axis=1)[:, [-2]]
    lasting = (stays * np.sign(off)) > 0.5 * SHIFTED
    for column, name in enumerate(names):
        where = alone[:, column] & (size[:, column] > SHIFTED) & lasting[:, column]
        odd = np.flatnonzero(where).tolist()
        agree = (size[~where, column] < 0.5 * SHIFTED).all()
        if odd and agree and 3 * len(odd) <= len(runs):
            start = {runs[row].name: float(first[row, column]) for row in odd}
            yield _Shifted(name, start, float(off[odd[size[odd, column].argmax()], column]))


def _against_usual(values: Array) -> Array:
    """Return temperatures of runs and sensors less those of the others and of other runs [K]."""
    apart = values - np.nanmedian(values, axis=1, keepdims=True)
    return np.asarray(np.nan_to_num(apart - np.nanmedian(apart, axis=0)))


def _read(run: ThermalRun, name: str) -> bool:
    return bool(np.isfinite(run.temperature[:, run.sensor.index(name)]).any())


def _middle(run: ThermalRun, names: Sequence[str]) -> Array:
    """Return the median over the run of each sensor [degC]; NaN of one that has none."""
    values = run.temperature[:, [run.sensor.index(name) for name in names]]
    middle = np.full(len(names), np.nan)
    there = np.isfinite(values).any(axis=0)
    middle[there] = np.nanmedian(values[:, there], axis=0)
    return middle


def _first(run: ThermalRun, names: Sequence[str]) -> Array:
    """Return the first reading of each sensor [degC]; NaN of one that has none."""
    values = run.temperature[:, [run.sensor.index(name) for name in names]]
    first: Array = values[np.isfinite(values).argmax(axis=0), np.arange(len(names))]
    return first
