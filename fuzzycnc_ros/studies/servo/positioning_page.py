# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A move of an axis: table, document, figures, page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.studies.page.chart import Axis, Band, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.drawing import (
    AFTER,
    CLUSTER_COLOURS,
    FAINT,
    LIMIT,
    MEASURED,
    OTHER,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table

if TYPE_CHECKING:
    from fuzzycnc_ros.core.arrays import Array
    from fuzzycnc_ros.simulation.servo.positioning import PositioningRun

LABELS = {
    'variable_universe_paper': 'as published',
    'variable_universe_static': 'published, floors raised',
    'fixed_universe_paper': 'fixed universe, published',
    'pid': 'PID',
    'variable_universe_model_free': 'variable, integral',
    'variable_universe': 'variable, observer (default)',
    'fixed_universe': 'fixed, observer',
    'cascade': 'P-PI cascade',
}
"""Controllers by name, as tables and plots call them, in the order of a comparison."""

DEFAULT = 'variable_universe'
"""Name of the controller in use."""

TOLERANCE = 2e-6
"""Distance to the target within which an axis is settled [m]."""

STEADY_SHARE = 0.75
"""Part of a run from which on the steady error counts."""


def microns(value: float) -> str:
    """Return a length [m] in um, with as many digits as are of use; from 1 mm on in mm."""
    size = 1e6 * abs(value)
    if not isfinite(size):
        return '-'
    if size >= 1000.0:
        return f'{1e3 * value:.2f} mm'
    return f'{1e6 * value:.0f}' if size >= 99.5 else f'{1e6 * value:.{1 if size >= 9.95 else 2}f}'


def seconds(value: float) -> str:
    """Return a settling time [s]; a dash if it never settled."""
    return f'{value:.3f}' if isfinite(value) else '-'


def positioning_table(run: PositioningRun, label: str, title: str) -> Table:
    """Return the figures of a move under a controller, as people call it."""
    since = STEADY_SHARE * _length(run)
    columns = (
        Column('Controller', numeric=False),
        Column('within 2 µm after [s]'),
        Column('overshoot [µm]'),
        Column(f'error after {since:.3g} s [µm]'),
        Column('largest duty [%]'),
    )
    row = (
        label,
        seconds(run.settle(TOLERANCE)),
        microns(run.overshoot),
        microns(run.steady_error(since)),
        f'{100.0 * float(abs(run.duty).max()):.0f}',
    )
    return Table(title, columns, (row,))


def _length(run: PositioningRun) -> float:
    """Return the length of a run, its last period included [s]."""
    return len(run.time) * float(run.time[1])


def positioning_remarks(run: PositioningRun) -> list[str]:
    """Return what a reader of the table has to know."""
    if run.fault:
        return [f'fault: {run.fault}; the duty is zero from then on']
    left = abs(float(run.target - run.position[-1]))
    if not isfinite(run.settle(TOLERANCE)):
        return [
            f'not settled: {microns(left)}{"" if left >= 1e-3 else " µm"} from the target after '
            f'{_length(run):g} s'
        ]
    return []


def positioning_document(
    run: PositioningRun, name: str, settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the figures of a move in SI.

    Returns
    -------
    dict
        `controller`, `settings`, `target` [m], `settle` [s] or None, `overshoot` and
        `steady_error` [m], `steady_since` [s], `duty_max` [-], `fault`.
    """
    since = STEADY_SHARE * _length(run)
    return {
        'controller': name,
        'settings': dict(settings),
        'target': run.target,
        'settle': run.settle(TOLERANCE),
        'overshoot': run.overshoot,
        'steady_error': run.steady_error(since),
        'steady_since': since,
        'duty_max': float(abs(run.duty).max()),
        'fault': run.fault,
    }


def positioning_page(
    run: PositioningRun, label: str, table: Table, facts: Mapping[str, str]
) -> Page:
    """Return the page of a move under a controller, as people call it."""
    course = Figure(
        'Position, error and duty over time',
        'Error: reference less true position; linear within the band of 2 µm that counts as '
        'settled, logarithmic beyond. The sensor sees it in counts and with noise. Duty is the '
        'share of the full drive.',
        run_chart(run),
    )
    return Page(
        title='One move of an axis',
        summary=f'{label[0].upper()}{label[1:]}: simulated axis, true positions.',
        sections=[
            Section('Figures', tables=[table], remarks=positioning_remarks(run)),
            Section('Course', figures=[course]),
        ],
        facts={'Machine': 'simulated', 'Judged': f'0 to {_length(run):g} s', **facts},
    )


BAND = 2.0
"""Error within which an axis is settled [um]; the scale is linear there."""

_ERROR = Axis(
    'error',
    'µm',
    'symlog',
    linear_to=BAND,
    ticks=(
        *(-(10.0**n) for n in range(6, 0, -1)),
        *(-BAND, 0.0, BAND),
        *(10.0**n for n in range(1, 7)),
    ),
)


def run_chart(run: PositioningRun) -> Chart:
    """Declare position, error on a symmetric logarithmic scale, and duty."""
    return Chart(
        Axis('time', 's'),
        [
            Panel(
                run.time,
                Axis('position', 'mm'),
                [
                    Series('reference', 1e3 * run.reference, OTHER, 1.0),
                    Series('true position', 1e3 * run.position, AFTER),
                ],
            ),
            _error_panel(run.time, [Series('error', 1e6 * run.error, AFTER)]),
            Panel(
                run.time,
                Axis('duty', '%'),
                [Series('duty', 100.0 * run.duty, MEASURED, 0.8)],
                share=0.5,
            ),
        ],
        height=2.6,
    )


def cases_chart(
    runs: Mapping[str, Mapping[str, PositioningRun]],
    cases: Mapping[str, str],
    since: Mapping[str, float],
) -> Chart:
    """Declare the errors of controllers on cases, one panel each.

    Parameters
    ----------
    runs : mapping
        Runs by controller and case.
    cases : mapping of str to str
        Cases that are drawn, and what they are called.
    since : mapping of str to float
        Time at which a panel begins [s]; 0 for those that are missing.
    """
    panels = []
    for case, label in cases.items():
        time = next(iter(runs.values()))[case].time
        part = time >= since.get(case, 0.0)
        series = [
            Series(
                LABELS[name],
                1e6 * made[case].error[part],
                AFTER if name == DEFAULT else CLUSTER_COLOURS[1 + number],
                1.8 if name == DEFAULT else 1.0,
            )
            for number, (name, made) in enumerate(runs.items())
        ]
        panels.append(_error_panel(time[part], series, label))
    return Chart(Axis('time', 's'), panels, columns=2, height=2.7)


def radius_chart(course: Mapping[float, float], marked: Mapping[float, float]) -> Chart:
    """Declare the spectral radius of the loop over factors on the axis' gain."""
    gain, radius = np.array(list(course)), np.array(list(course.values()))
    panel = Panel(
        gain,
        Axis('largest magnitude of an eigenvalue'),
        [
            Series('spectral radius', radius, AFTER),
            Series(
                'in the table',
                np.array([marked[factor] for factor in sorted(marked)]),
                AFTER,
                kind='dots',
                x=np.array(sorted(marked)),
            ),
        ],
        rules=[Rule(1.0, LIMIT, 'begins to swing', (6.0, 3.0))],
    )
    return Chart(Axis('gain of the axis, as multiple of the nominal one'), [panel], height=2.8)


def _error_panel(time: Array, series: Sequence[Series], title: str = '') -> Panel:
    """Return a panel of errors [um]: linear within the band, decades beyond."""
    ends = np.full(len(time), BAND)
    band = Band(f'within {BAND:g} µm', -ends, ends, FAINT)
    return Panel(time, _ERROR, series, title, bands=[band])
