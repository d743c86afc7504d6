# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Requirements on a set of training runs."""

from collections.abc import Sequence

import numpy as np

from fuzzycnc_ros.core.remedies import Remedy
from fuzzycnc_ros.core.thermal.run import (
    GAP_MAX,
    JITTER_MAX,
    RISE_MIN,
    RISE_RATE_MAX,
    SAMPLES_MIN,
    SETTLE_TIME,
    Gap,
    ThermalDataError,
    ThermalRun,
    without_sensors,
)

_SENSORS_MAX = 500
"""Most sensors that are clustered: every pair of them is compared, and no machine has so many."""


GAPS_NAMED = 3
"""Gaps that a refusal names."""


def check_training_runs(runs: Sequence[ThermalRun]) -> None:
    """Refuse runs from which nothing sound can be learnt.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Runs of one machine; sensors, channels, axes and interval must agree.

    Raises
    ------
    ThermalDataError
        If there is no run, runs disagree or have over 500 sensors, a temperature is NaN, rises
        faster than 10 K per minute, no sensor warms by 0.5 K, or a channel was never measured.
        A gap that `ThermalRun.bridged` fills is none: see that first.
    """
    if not runs:
        raise ThermalDataError('runs: expected at least one run, but found none')
    first = runs[0]
    if len(first.sensor) > _SENSORS_MAX:
        raise ThermalDataError(
            f'run {first.name!r}: expected at most {_SENSORS_MAX} sensors, but found '
            f'{len(first.sensor)}; record those of one machine'
        )
    names = [run.name for run in runs]
    if len(set(names)) != len(names):
        raise ThermalDataError(f'runs: expected each name once, but found {", ".join(names)}')
    for run in runs:
        _check_same(first, run)
    check_gaps(runs)
    for run in runs:
        check_rise(run)
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


def check_gaps(runs: Sequence[ThermalRun]) -> None:
    """Refuse runs whose sensors have gaps that were not bridged.

    Raises
    ------
    ThermalDataError
        It names sensors and times, and what helps for all of the runs: the sensors to leave out,
        and the window between the gaps.
    """
    lost = [(run, gap) for run in runs for gap in run.gaps()]
    if not lost:
        return
    texts = [
        f'{gap.sensor} of run {run.name!r} from {gap.start:.6g} to {gap.stop:.6g} s'
        for run, gap in lost
    ]
    more = f', and {len(texts) - GAPS_NAMED} more' if len(texts) > GAPS_NAMED else ''
    remedies = []
    sensors = tuple(dict.fromkeys(gap.sensor for _, gap in lost))
    if len(sensors) < len(runs[0].sensor):
        remedies.append(without_sensors(*sensors))
    remedies += _window_between([gap for _, gap in lost], runs)
    raise ThermalDataError(
        f'runs: expected readings of every sensor at most {GAP_MAX / 60.0:g} min apart, and one '
        f'of the first three, but found none of {", ".join(texts[:GAPS_NAMED])}{more}',
        *(remedies or [Remedy('record anew', {})]),
    )


def _window_between(gaps: Sequence[Gap], runs: Sequence[ThermalRun]) -> list[Remedy]:
    """Return the longest window without gaps as a remedy; none if a run has too little in it.

    Behind a gap it begins when the history of before no longer matters.
    """
    first = min(float(run.time[0]) for run in runs)
    last = max(float(run.time[-1]) for run in runs)
    free, best = first, (first, first)
    for gap in [*sorted(gaps, key=lambda gap: gap.start), Gap('', 0, last, last)]:
        best = max(best, (free, gap.start), key=lambda window: window[1] - window[0])
        free = max(free, gap.stop + SETTLE_TIME)
    if min(int(run.inside(*best).sum()) for run in runs) < SAMPLES_MIN:
        return []
    words, arguments = ['use the part with all readings'], {}
    if best[0] > first:
        arguments['start'] = f'{best[0]:.10g}'
        words.append(f'from {best[0]:.10g} s')
    if best[1] < last:
        arguments['end'] = f'{best[1]:.10g}'
        words.append(f'up to {best[1]:.10g} s')
    return [Remedy(' '.join(words), arguments)]


def _check_names(first: ThermalRun, run: ThermalRun) -> None:
    for field in ('sensor', 'channel', 'axis'):
        expected, found = getattr(first, field), getattr(run, field)
        if expected != found:
            raise ThermalDataError(
                f'run {run.name!r}: expected {field} {", ".join(expected)} as in run '
                f'{first.name!r}, but found {", ".join(found)}'
            )


def _check_same(first: ThermalRun, run: ThermalRun) -> None:
    _check_names(first, run)
    if abs(run.interval - first.interval) > JITTER_MAX * first.interval:
        raise ThermalDataError(
            f'run {run.name!r}: expected the interval {first.interval:.6g} s of run '
            f'{first.name!r}, but found {run.interval:.6g} s; resample the runs to one interval'
        )


def unlike_most(runs: Sequence[ThermalRun]) -> dict[int, str]:
    """Return the runs with other sensors, channels or axes than over half of them, and why so."""
    layouts = [(run.sensor, run.channel, run.axis) for run in runs]
    usual = max(layouts, key=layouts.count, default=None)
    if usual is None or 2 * layouts.count(usual) <= len(runs):
        return {}
    odd = {}
    for place, run in enumerate(runs):
        try:
            _check_names(runs[layouts.index(usual)], run)
        except ThermalDataError as error:
            odd[place] = str(error)
    return odd


def check_rise(run: ThermalRun) -> None:
    """Refuse a run in which a temperature changes by over 10 K in a minute.

    Raises
    ------
    ThermalDataError
        It names the sensor and the sample.
    """
    minute = max(1, round(60.0 / run.interval))
    if minute >= len(run.time):
        return
    change = np.abs(run.temperature[minute:] - run.temperature[:-minute])
    span = minute * run.interval
    per_minute = 60.0 * run.limits.values('rate_max', run.sensor, RISE_RATE_MAX / 60.0)
    limit = per_minute * span / 60.0
    if (change > limit).any():
        row, column = np.unravel_index(int(np.argmax(change - limit)), change.shape)
        rate = float(change[row, column]) / span
        raise ThermalDataError(
            f'run {run.name!r}: expected at most {per_minute[column]:g} K per minute, but '
            f'found {change[row, column]:.3g} K within {span:.3g} s of sensor '
            f'{run.sensor[column]!r} at sample {row}; check its plug; import the run without a '
            'single odd reading',
            without_sensors(run.sensor[column]),
            Remedy(
                f'if {run.sensor[column]} is heated so fast, give it limits of its own',
                {'sensor_limits': f'{run.sensor[column]}:rate_max:{1.2 * rate:.2g}'},
            ),
        )
