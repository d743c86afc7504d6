# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Days of a mill whose ball screws warm up: error along the travel, before and after."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.components.machine.simulated_machine_config import MACHINE_DUTIES
from fuzzycnc_ros.components.thermal.axis_trust import CAUTIOUS
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import WIDTH
from fuzzycnc_ros.core.thermal.places import LINE_RMS
from fuzzycnc_ros.runtime.records import SECOND
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES
from fuzzycnc_ros.simulation.thermal.mill_screws import MillScrews, screw_configs
from fuzzycnc_ros.studies.evaluated_graph import judged_graph
from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Series
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table, case_table
from fuzzycnc_ros.studies.shift.shift_log import ShiftLog
from fuzzycnc_ros.studies.shift.thermal_shift import (
    Calibration,
    record_calibration,
    shift_components,
)

if TYPE_CHECKING:
    from fuzzycnc_ros.runtime.graph import Sink
    from fuzzycnc_ros.simulation.thermal.duties import Duty

CALIBRATION = ('axis_A', 'axis_B')
"""Duties of two calibration runs."""

WORK = 'axis_work'
"""Duty that no model has seen."""

TRAVEL = (-0.5, 0.0)
"""Travel of each axis [m]."""

PLACES = np.linspace(*TRAVEL, 11)
"""Positions at which the true error is judged [m]."""

SCREWS = ('Y:fixed_free', 'Z:fixed_free')
SENSORS = (
    *('T5', 'T18', 'T36', 'T58', 'T72'),
    *(f'{axis}_{place}' for axis in MILL_AXES for place in ('bearing', 'nut', 'table')),
)
"""Sensors as a shop has them: five of the mill, three of each axis."""

PROBE_EVERY, PROBE_NOISE = 3600.0, 0.5e-6
"""Time between probes [s] and their standard deviation [m]."""


TICK, INTERVAL = 10.0, 20.0
"""Machine time between two readings, and between two samples [s]: in a minute the far end of a
screw that begins to work moves by 7 um."""


def machine_parameters(
    screws: Sequence[str] = SCREWS, places: Sequence[float] = (*TRAVEL,)
) -> dict[str, Any]:
    """Return the parameters of a simulated machine with ball screws, probed at places [m]."""
    return {
        'screws': tuple(screws),
        'sensors': SENSORS,
        'displacement_positions': tuple(places),
        'tick_period': TICK,
        'offset_max': 300e-6,
        'slope_max': 600e-6,
    }


def calibrated(
    seed: int = 0, screws: Sequence[str] = SCREWS, duties: Sequence[str] = CALIBRATION
) -> Calibration:
    """Return calibration runs, measured at both ends and the middle each minute."""
    middle = 0.5 * (TRAVEL[0] + TRAVEL[1])
    machine = machine_parameters(screws, (TRAVEL[0], middle, TRAVEL[1]))
    parameters = {
        'simulated_machine': machine,
        'temperature_acquisition': {'interval': INTERVAL},
    }
    return record_calibration(duties, seed, parameters=parameters)


def day_parameters(
    duties: Sequence[str],
    seed: int = 0,
    *,
    screws: Sequence[str] = SCREWS,
    probed: bool = False,
    places: Sequence[float] = (*TRAVEL,),
    cautious: bool = True,
) -> dict[str, dict[str, Any]]:
    """Return the parameters by node of the whole graph that differ from their defaults.

    Parameters
    ----------
    duties : sequence of str
        Duties, one a day.
    seed : int
        Seed of all measuring noise.
    screws : sequence of str
        Axes and how their screws are mounted.
    probed : bool
        Whether the error is probed once an hour, and learnt from; else a model has to know it.
    places : sequence of float
        Where that is probed [m].
    cautious : bool
        Whether an axis waits until probes have confirmed an offset, where it is learnt.
    """
    learnt = tuple(f'{axis}:' + ':'.join(f'{place:g}' for place in places) for axis in MILL_AXES)
    travel = tuple(f'{axis}:{TRAVEL[0]:g}:{TRAVEL[1]:g}' for axis in MILL_AXES)
    limits = {'travel': travel, 'offset_max': 300e-6, 'error_max': 600e-6, 'slope_max': 600e-6}
    learning = {'learn': True, 'probe_noise': PROBE_NOISE, 'learn_axes': MILL_AXES}
    probing = {
        'displacement_interval': PROBE_EVERY,
        'displacement_noise': PROBE_NOISE,
        'displacement_compensated': True,
    }
    return {
        'temperature_acquisition': {'interval': INTERVAL},
        'thermal_predictor': {**learning, 'learn_places': learnt} if probed else {},
        'compensator': {'axes': MILL_AXES, **limits, **(CAUTIOUS if probed and cautious else {})},
        'simulated_machine': {
            'duties': tuple(duties),
            'seed': seed,
            **machine_parameters(screws, places),
            **(probing if probed else {'displacement_interval': PROBE_EVERY}),
        },
    }


@dataclass(frozen=True, eq=False)
class AxisDay:
    """A day of one axis.

    Parameters
    ----------
    duty, axis : str
        What was done, and the axis.
    time : ndarray, shape (n,)
        Time since the cold start [s].
    error : ndarray, shape (n, p)
        True error without compensation at `PLACES` [m].
    offset : ndarray, shape (n, p)
        Offsets that stand there [m].
    predicted, deviation : ndarray, shape (n, p)
        Published error there and its standard deviation [m]; NaN where none was valid.
    told : ndarray, shape (n,)
        What a line leaves, as it is published [m]; NaN where that is unknown.
    """

    duty: str
    axis: str
    time: Array
    error: Array
    offset: Array
    predicted: Array
    deviation: Array
    told: Array

    @property
    def best(self) -> Array:
        """Largest distance of the true error from its best line at each time, shape (n,) [m]."""
        line = np.polynomial.polynomial.polyfit(PLACES, self.error.T, 1)
        rest = self.error - np.polynomial.polynomial.polyval(PLACES, line)
        return np.asarray(np.abs(rest).max(axis=1))

    def figures(self, since: float = 0.0) -> dict[str, float]:
        """Return the figures of what comes after a time [s]."""
        rows = self.time >= since
        left = np.abs(self.error + self.offset).max(axis=1)[rows]
        known = np.isfinite(self.predicted) & rows[:, np.newaxis]
        inside = np.abs(self.error - self.predicted) <= WIDTH * self.deviation
        return {
            'uncompensated_max_um': 1e6 * float(np.abs(self.error[rows]).max()),
            'best_line_max_um': 1e6 * float(self.best[rows].max()),
            'left_max_um': 1e6 * float(left.max()),
            'beyond_best_line_max_um': 1e6 * float((left - self.best[rows]).max()),
            'in_band': float(inside[known].mean()) if known.any() else float('nan'),
            'line_leaves_told_um': 1e6 * float(self.told[rows][self.best[rows].argmax()]),
        }


def run_axis_days(
    duties: Sequence[str],
    seed: int = 0,
    *,
    model: str = '',
    screws: Sequence[str] = SCREWS,
    places: Sequence[float] = (*TRAVEL,),
    cautious: bool = True,
    sink: Sink | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[list[AxisDay]]:
    """Run days in one process, compensated by a model or by what probes teach.

    Parameters
    ----------
    duties, seed, screws, places, cautious
        As for `day_parameters`.
    model : str
        Text of a model file; empty to learn from probes alone.
    sink : callable, optional
        Takes every published record.
    progress : callable, optional
        Told ticks done and in all.

    Returns
    -------
    list of list of AxisDay
        The axes of each day.
    """
    given = day_parameters(
        duties, seed, screws=screws, probed=not model, places=places, cautious=cautious
    )
    if model:
        given['thermal_predictor'] |= {'learn': True, 'probe_interval_min': 864000.0}
    machine, acquisition, _, predictor, compensator = shift_components(
        duties, seed, parameters=given
    )
    log = ShiftLog()
    graph = judged_graph(machine, [acquisition, predictor, compensator], log, sink)
    if model:
        graph.request('thermal_predictor', 'use_model', model=model)
    graph.request('compensator', 'activate')
    graph.run(progress)
    return axis_days(log, duties, screws)


def axis_days(log: ShiftLog, duties: Sequence[str], screws: Sequence[str]) -> list[list[AxisDay]]:
    """Judge the days of a log by the true error of the simulated mill."""
    days = []
    for name, (start, stop) in zip(duties, log.spans(), strict=True):
        found = log.records('thermal_error', start, stop)
        stamps = np.array([item.stamp for item in found])
        time = (stamps - start) / SECOND
        truth = true_errors(MACHINE_DUTIES[name], screws, time)
        told = {item.stamp: item for item in log.records('compensation_applied', start, stop)}
        day = []
        for axis in MILL_AXES:
            predicted = np.full((len(found), len(PLACES)), np.nan)
            deviation, offset = predicted.copy(), np.zeros_like(predicted)
            bend = np.full(len(found), np.nan)
            for row, item in enumerate(found):
                if item.stamp in told:
                    offset[row] = _offsets(told[item.stamp], axis)
                if item.valid:
                    predicted[row], deviation[row] = errors_along(item, axis, PLACES)
                    bend[row] = item.line_deviation[item.axis.index(axis)]
            values = truth[axis], offset, predicted, deviation, bend
            day.append(AxisDay(name, axis, time, *values))
        days.append(day)
    return days


def _offsets(applied: Any, axis: str) -> Array:
    """Return the offsets that a read-back tells along an axis [m]."""
    number = applied.axis.index(axis)
    way = np.nan_to_num(PLACES - applied.position[number])
    return np.asarray(applied.offset[number] + applied.slope[number] * way)


def errors_along(error: Any, axis: str, position: Array) -> tuple[Array, Array]:
    """Return a published error at positions of an axis [m], and its standard deviation [m]."""
    number = error.axis.index(axis)
    slope, steep, reference, bend = (
        float(getattr(error, name)[number])
        for name in ('slope', 'slope_deviation', 'reference_position', 'line_deviation')
    )
    way = np.nan_to_num(position - reference)
    value = error.error[number] + np.nan_to_num(slope) * way
    spread = np.hypot(error.standard_deviation[number], np.nan_to_num(steep) * way)
    return value, np.hypot(spread, LINE_RMS * np.nan_to_num(bend))


def true_errors(duty: Duty, screws: Sequence[str], time: Array) -> dict[str, Array]:
    """Return the true error of each axis at times of a duty [s] and `PLACES`, shape (n, p) [m]."""
    mill, moved = duty.mill(), MillScrews(screw_configs(screws, ()))
    moved.begin(mill.ambient(0.0), 0)
    found = {axis: np.zeros((len(time), len(PLACES))) for axis in MILL_AXES}
    now = 0.0
    for row, until in enumerate(time.tolist()):
        while now < until - 1e-6:
            step = min(12.0, until - now)
            moved.move(step, *duty.motion(now))
            mill.advance(step, duty.spindle_speed(now))
            moved.advance(step, mill.ambient)
            now += step
        bare = mill.displacement()
        for number, axis in enumerate(MILL_AXES):
            found[axis][row] = bare[number] + moved.error([axis] * len(PLACES), PLACES)
    return found


def axis_table(
    days: Sequence[Sequence[AxisDay]], since: Mapping[str, float] | None = None
) -> Table:
    """Return what is left along the travel, a row per day and axis."""

    def micrometres(key: str) -> Callable[..., str]:
        return lambda item, figures: f'{figures[key]:.1f}'

    return case_table(
        'Largest error along the travel [µm]',
        ((one, one.figures((since or {}).get(one.duty, 0.0))) for day in days for one in day),
        {
            Column('Day', numeric=False): lambda item, figures: item.duty,
            Column('Axis', numeric=False): lambda item, figures: item.axis,
            Column('uncompensated'): micrometres('uncompensated_max_um'),
            Column('best line'): micrometres('best_line_max_um'),
            Column('left'): micrometres('left_max_um'),
            Column('beyond it'): micrometres('beyond_best_line_max_um'),
            Column('in band %'): lambda item, figures: f'{100.0 * figures["in_band"]:.0f}',
        },
    )


TOLD = 6
"""Number of times that a family of curves shows."""


def axis_chart(days: Sequence[Sequence[AxisDay]]) -> Chart:
    """Declare the error along each axis at some times, before and after."""
    panels = []
    for item in (axis for day in days for axis in day):
        rows = np.linspace(0, len(item.time) - 1, TOLD + 1).astype(int)[1:]
        for title, values in (
            ('without compensation', item.error),
            ('with', item.error + item.offset),
        ):
            series = [
                Series(
                    f'{item.time[row] / 3600.0:.1f} h',
                    1e6 * values[row],
                    _shade(number / (TOLD - 1)),
                )
                for number, row in enumerate(rows)
            ]
            panels.append(
                Panel(
                    1e3 * PLACES,
                    Axis('error', 'µm', low=_low(item), high=_high(item)),
                    series,
                    title=f'{item.axis}, {title}',
                )
            )
    return Chart(Axis('position of the axis', 'mm'), panels, columns=2, height=3.0)


def _shade(share: float) -> str:
    """Return a colour from blue, early, to red, late."""
    red, blue = round(40 + 180 * share), round(220 - 180 * share)
    return f'#{red:02x}50{blue:02x}'


def _low(item: AxisDay) -> float:
    return 1e6 * float(min(item.error.min(), 0.0)) - 2.0


def _high(item: AxisDay) -> float:
    return 1e6 * float(max(item.error.max(), 0.0)) + 2.0


def axis_line(days: Sequence[Sequence[AxisDay]]) -> str:
    """Return in one sentence what compensation along the axes is worth."""
    figures = [item.figures() for day in days for item in day]
    before, best, left = (
        max(item[name] for item in figures)
        for name in ('uncompensated_max_um', 'best_line_max_um', 'left_max_um')
    )
    return (
        f'Of at most {before:.0f} µm along the travel of the axes {left:.1f} µm stay; the best '
        f'line in hindsight would leave {best:.1f} µm.'
    )


def axis_page(days: Sequence[Sequence[AxisDay]], facts: Mapping[str, str]) -> Page:
    """Return the page on the days.

    Parameters
    ----------
    days : sequence of sequence of AxisDay
        The axes of each day.
    facts : mapping of str to str
        Provenance.
    """
    return Page(
        title='A mill whose ball screws warm up',
        summary=axis_line(days),
        sections=(
            Section(
                'Along the travel',
                tables=(axis_table(days),),
                remarks=(
                    'Judged by the true error of the simulated mill. Best line: what the line of '
                    'least squares through the true error leaves. Beyond it: the most that is '
                    'left in excess of that at any time. In band: share of places and times '
                    'within two predicted standard deviations.',
                ),
                figures=(
                    Figure(
                        'Error along the travel over time',
                        'Each curve is the error at one time, from early in blue to late in red.',
                        axis_chart(days),
                    ),
                ),
            ),
        ),
        facts=facts,
    )
