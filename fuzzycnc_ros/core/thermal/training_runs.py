# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a set of runs must fulfil before anything is learnt from it."""

from collections.abc import Sequence

import numpy as np

from fuzzycnc_ros.core.thermal.run import (
    JITTER_MAX,
    RISE_MIN,
    RISE_RATE_MAX,
    SAMPLES_MIN,
    ThermalDataError,
    ThermalRun,
)

SENSORS_MAX = 500
"""Most sensors that are clustered: every pair of them is compared, and no machine has so many."""


def check_training_runs(runs: Sequence[ThermalRun]) -> None:
    """Refuse runs from which nothing sound can be learnt, method sheet 001 section 6.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Runs of one machine; sensors, channels, axes and interval must agree.

    Raises
    ------
    ThermalDataError
        If there is no run, runs disagree or have over 500 sensors, a temperature is NaN, rises
        faster than 10 K per minute, no sensor warms by 0.5 K, or a channel was never measured.
    """
    if not runs:
        raise ThermalDataError('runs: expected at least one run, but found none')
    first = runs[0]
    if len(first.sensor) > SENSORS_MAX:
        raise ThermalDataError(
            f'run {first.name!r}: expected at most {SENSORS_MAX} sensors, but found '
            f'{len(first.sensor)}; record those of one machine'
        )
    names = [run.name for run in runs]
    if len(set(names)) != len(names):
        raise ThermalDataError(f'runs: expected each name once, but found {", ".join(names)}')
    for run in runs:
        _check_same(first, run)
        _check_rise(run)
    if max(float(np.ptp(run.temperature, axis=0).max()) for run in runs) < RISE_MIN:
        raise ThermalDataError(
            f'runs: expected a sensor that warms by {RISE_MIN} K, but found none; '
            'nothing can be learnt from a machine that stayed cold'
        )
    measured = np.sum([np.isfinite(run.displacement).sum(axis=0) for run in runs], axis=0)
    for channel, count in zip(first.channel, measured, strict=True):
        if count < SAMPLES_MIN:
            raise ThermalDataError(
                f'channel {channel!r}: expected at least {SAMPLES_MIN} measured displacements, '
                f'but found {count}'
            )


def _check_same(first: ThermalRun, run: ThermalRun) -> None:
    for field in ('sensor', 'channel', 'axis'):
        expected, found = getattr(first, field), getattr(run, field)
        if expected != found:
            raise ThermalDataError(
                f'run {run.name!r}: expected {field} {", ".join(expected)} as in run '
                f'{first.name!r}, but found {", ".join(found)}'
            )
    if abs(run.interval - first.interval) > JITTER_MAX * first.interval:
        raise ThermalDataError(
            f'run {run.name!r}: expected the interval {first.interval:.6g} s of run '
            f'{first.name!r}, but found {run.interval:.6g} s; resample the runs to one interval'
        )


def _check_rise(run: ThermalRun) -> None:
    lost = np.atleast_1d(np.isnan(run.temperature).any(axis=0))
    if lost.any():
        names = [run.sensor[column] for column in np.flatnonzero(lost)]
        raise ThermalDataError(
            f'run {run.name!r}: expected a temperature in every sample, but found gaps in '
            f'{", ".join(names)}; leave these sensors out of the training'
        )
    minute = max(1, round(60.0 / run.interval))
    if minute >= len(run.time):
        return
    change = np.abs(run.temperature[minute:] - run.temperature[:-minute])
    limit = RISE_RATE_MAX * minute * run.interval / 60.0
    if change.max() > limit:
        row, column = np.unravel_index(int(np.argmax(change)), change.shape)
        raise ThermalDataError(
            f'run {run.name!r}: expected at most {RISE_RATE_MAX:g} K per minute, but found '
            f'{change[row, column]:.3g} K within {minute * run.interval:.3g} s of sensor '
            f'{run.sensor[column]!r} at sample {row}; check its plug or leave it out'
        )
