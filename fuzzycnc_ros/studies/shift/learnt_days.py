# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Days of a machine without any model, which learns its thermal error from a probe an hour."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.components.machine.simulated_machine_config import MACHINE_DUTIES
from fuzzycnc_ros.components.thermal.axis_trust import CAUTIOUS
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import WIDTH, coverage, mean_of_square
from fuzzycnc_ros.runtime.records import SECOND
from fuzzycnc_ros.simulation.thermal.duties import simulate_duty
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES
from fuzzycnc_ros.studies.evaluated_graph import judged_graph
from fuzzycnc_ros.studies.page.chart import Axis, Chart, Rule, Series
from fuzzycnc_ros.studies.page.drawing import ANOTHER, MUTED
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table, case_table
from fuzzycnc_ros.studies.shift.shift_log import ShiftLog, offsets_of
from fuzzycnc_ros.studies.shift.thermal_shift import shift_components
from fuzzycnc_ros.studies.thermal.learnt import learnt_panel

if TYPE_CHECKING:
    from fuzzycnc_ros.runtime.graph import Sink

DAYS = ('T1', 'T2', 'T3')
"""Duties of the days, each from a cold machine."""

EVERY = 3600.0
"""Time between two probes [s]."""

NOISE = 0.5e-6
"""Standard deviation of a probe [m]."""


@dataclass(frozen=True, eq=False)
class LearntDay:
    """A day of a machine that is compensated by what its probes have taught so far.

    Parameters
    ----------
    name : str
        Name of its duty.
    time : ndarray, shape (n,)
        Time of each sample since the cold start [s].
    error : ndarray, shape (n, c)
        True thermal error without compensation, on `MILL_AXES` [m].
    applied : ndarray, shape (n, c)
        Offsets in force [m].
    predicted, deviation : ndarray, shape (n, c)
        Published error and its standard deviation [m]; NaN where none was valid.
    probed : ndarray, shape (n, c)
        Probed error at the samples with a probe, offsets in force taken off [m]; NaN else.
    """

    name: str
    time: Array
    error: Array
    applied: Array
    predicted: Array
    deviation: Array
    probed: Array

    @property
    def held(self) -> Array:
        """Error by the last probe before each sample, shape (n, c) [m]; 0 before the first."""
        taken = np.flatnonzero(~np.isnan(self.probed[:, 0]))
        at = np.searchsorted(taken, np.arange(len(self.time)))
        return np.vstack([np.zeros(len(MILL_AXES)), self.probed[taken]])[at]

    def figures(self) -> dict[str, dict[str, float]]:
        """Return the figures of each axis: root mean squares, coverage and width of the band."""
        left = {
            'uncompensated': self.error,
            'last_probe_held': self.error - self.held,
            'learnt': self.error - np.nan_to_num(self.predicted),
            'applied': self.error + self.applied,
        }
        found = {f'{name}_rms_um': _rms(values) for name, values in left.items()}
        found['applied_max_um'] = 1e6 * np.abs(left['applied']).max(axis=0)
        found['in_band'] = coverage(self.error - self.predicted, self.deviation)
        found['half_width_at_end_um'] = 1e6 * WIDTH * self.deviation[-1]
        return {
            axis: {name: float(values[c]) for name, values in found.items()}
            for c, axis in enumerate(MILL_AXES)
        }


def _rms(values: Array) -> Array:
    return np.asarray(1e6 * np.sqrt(mean_of_square(values)))


def learning_parameters(days: Sequence[str] = DAYS, seed: int = 0) -> dict[str, dict[str, Any]]:
    """Return the parameters by node of the whole graph that differ from their defaults.

    Parameters
    ----------
    days : sequence of str
        Duties of the simulated mill, one a day.
    seed : int
        Seed of all measuring noise.
    """
    return {
        'temperature_acquisition': {},
        'thermal_predictor': {'learn': True, 'learn_axes': MILL_AXES, 'probe_noise': NOISE},
        'compensator': {'axes': MILL_AXES, **CAUTIOUS},
        'simulated_machine': {
            'duties': tuple(days),
            'seed': seed,
            'displacement_interval': EVERY,
            'displacement_noise': NOISE,
            'displacement_compensated': True,
        },
    }


def learn_days(
    days: Sequence[str] = DAYS,
    seed: int = 0,
    *,
    sink: Sink | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[LearntDay, ...]:
    """Run days of the simulated mill in one process, from no model at all.

    Parameters
    ----------
    days, seed
        As for `learning_parameters`.
    sink : callable, optional
        Takes every published record, configurations, requests and turns included.
    progress : callable, optional
        Told ticks done and in all.

    Raises
    ------
    ValueError
        If a duty is unknown.
    """
    machine, acquisition, _, predictor, compensator = shift_components(
        days, seed, parameters=learning_parameters(days, seed)
    )
    log = ShiftLog()
    graph = judged_graph(machine, [acquisition, predictor, compensator], log, sink)
    graph.request('compensator', 'activate')
    graph.run(progress)
    return learnt_days(log, days)


def learnt_days(log: ShiftLog, days: Sequence[str]) -> tuple[LearntDay, ...]:
    """Judge the days of a log by the true error of the simulated mill.

    Raises
    ------
    ValueError
        If the log has another number of days.
    """
    return tuple(_day(log, *item) for item in zip(days, log.spans(), strict=True))


def _day(log: ShiftLog, name: str, span: tuple[int, int]) -> LearntDay:
    start = span[0]
    found = log.records('thermal_error', *span)
    time = np.array([item.stamp - start for item in found]) / SECOND
    true = simulate_duty(MACHINE_DUTIES[name])
    nothing = np.full(len(MILL_AXES), np.nan)
    applied = offsets_of(found, log.records('compensation_applied', *span), MILL_AXES)
    moved = {item.stamp: item.displacement for item in log.records('displacement', *span)}
    probes = np.array([moved.get(item.stamp, nothing) for item in found])
    return LearntDay(
        name=name,
        time=time,
        error=np.column_stack([np.interp(time, true.time, row) for row in true.displacement.T]),
        applied=applied,
        predicted=np.array([item.error if item.valid else nothing for item in found]),
        deviation=np.array([item.standard_deviation if item.valid else nothing for item in found]),
        probed=probes - applied,
    )


def days_table(days: Sequence[LearntDay]) -> Table:
    """Return what is left in each way to use the probes, a row per day and axis."""

    def micrometres(key: str) -> Callable[..., str]:
        return lambda day, axis, figures: f'{figures[key]:.1f}'

    return case_table(
        'Thermal error, root mean square [µm], and the share in the band',
        (
            (f'{number} ({day.name})', *of_axis)
            for number, day in enumerate(days, 1)
            for of_axis in day.figures().items()
        ),
        {
            Column('Day', numeric=False): lambda day, axis, figures: day,
            Column('Axis', numeric=False): lambda day, axis, figures: axis,
            Column('uncompensated'): micrometres('uncompensated_rms_um'),
            Column('last probe held'): micrometres('last_probe_held_rms_um'),
            Column('learnt'): micrometres('learnt_rms_um'),
            Column('applied'): micrometres('applied_rms_um'),
            Column('in band %'): lambda day, axis, figures: f'{100.0 * figures["in_band"]:.0f}',
            Column('± µm at the end'): micrometres('half_width_at_end_um'),
        },
    )


def days_line(days: Sequence[LearntDay]) -> str:
    """Return in one sentence what the probes were worth on the last day."""
    later = list(days[-1].figures().values())
    before, held, left = (
        max(figures[f'{name}_rms_um'] for figures in later)
        for name in ('uncompensated', 'last_probe_held', 'applied')
    )
    when = f'On day {len(days)}'
    return (
        f'{when}, what one probe an hour has taught leaves at most {left:.1f} of {before:.1f} µm '
        f'(rms) on an axis; the same probes, each held until the next, leave {held:.1f} µm.'
    )


def joined(days: Sequence[LearntDay]) -> LearntDay:
    """Return all days in one, their time that of operation; a row of NaN parts two days."""
    parts: list[tuple[Array, ...]] = []
    begin = 0.0
    for day in days:
        gap = np.full((1, len(MILL_AXES)), np.nan)
        values = day.error, day.applied, day.predicted, day.deviation, day.probed
        time = begin + np.append(0.0, day.time)
        parts.append((time, *(np.concatenate([gap, value]) for value in values)))
        begin = time[-1]
    whole = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return LearntDay(', '.join(day.name for day in days), *whole)


def days_chart(days: Sequence[LearntDay]) -> Chart:
    """Declare error, prediction with its band, probes, and what is left, a panel per axis."""
    whole = joined(days)
    ends = np.cumsum([day.time[-1] for day in days]) / 3600.0
    rules = [
        Rule(begin, MUTED, f'day {number}', (1.0, 2.0), upright=True)
        for number, begin in enumerate([0.0, *ends[:-1]], 1)
    ]
    panels = []
    for c, axis in enumerate(MILL_AXES):
        panel = learnt_panel(
            whole.time / 3600.0,
            axis,
            whole.error[:, c],
            (whole.predicted[:, c], whole.deviation[:, c]),
            whole.probed[:, c],
            rules,
        )
        left = Series('left', 1e6 * (whole.error + whole.applied)[:, c], ANOTHER, 1.2)
        panels.append(replace(panel, series=[*panel.series, left]))
    return Chart(Axis('time in operation', 'h'), panels, height=3.0)


def days_page(days: Sequence[LearntDay], facts: Mapping[str, str]) -> Page:
    """Return the page on the days.

    Parameters
    ----------
    days : sequence of LearntDay
        The days.
    facts : mapping of str to str
        Provenance.
    """
    return Page(
        title='A mill that learns its thermal error from a probe an hour',
        summary=days_line(days),
        sections=(
            Section(
                'Day by day',
                tables=(days_table(days),),
                remarks=(
                    'Judged by the true error of the simulated mill, of which the nodes see the '
                    'probes alone. What is learnt is carried from day to day; a held probe '
                    'begins each day at zero, as the machine is cold.',
                    'An axis is followed once its band is narrower than its error: one after the '
                    'other, the first half of it, until a probe has seen that offset.',
                    'Learnt: the error less all of the prediction; applied: the error that the '
                    'offsets in force leave. In band: share of the samples within two predicted '
                    'standard deviations of '
                    'the prediction; ±: half the width of that band after the last sample.',
                ),
                figures=(
                    Figure(
                        'Error, its prediction, and the residual',
                        'The area is the band of two predicted standard deviations about the '
                        'prediction. Dots are probes of the machine as it is, from which the '
                        'offsets in force are taken off by their read-back.',
                        days_chart(days),
                    ),
                ),
            ),
        ),
        facts={'Judged': ', '.join(day.name for day in days), **facts},
    )
