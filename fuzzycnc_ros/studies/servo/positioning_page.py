# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A move of an axis: table, document, page."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table

if TYPE_CHECKING:
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


def positioning_table(run: PositioningRun, name: str, title: str) -> Table:
    """Return the figures of a move."""
    since = STEADY_SHARE * _length(run)
    columns = (
        Column('Controller', numeric=False),
        Column('within 2 um after [s]'),
        Column('overshoot [um]'),
        Column(f'error after {since:.3g} s [um]'),
        Column('largest duty [%]'),
    )
    row = (
        LABELS[name],
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
            f'not settled: {microns(left)}{"" if left >= 1e-3 else " um"} from the target after '
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
    run: PositioningRun, name: str, table: Table, facts: Mapping[str, str]
) -> Page:
    """Return the page of a move."""
    from fuzzycnc_ros.studies.servo.positioning_plots import plot_run

    course = Figure(
        'Position, error and duty over time',
        'Error: reference less true position; linear within the band of 2 um that counts as '
        'settled, logarithmic beyond. The sensor sees it in counts and with noise. Duty is the '
        'share of the full drive.',
        plot_run(run),
    )
    return Page(
        title='One move of an axis',
        summary=f'{LABELS[name][0].upper()}{LABELS[name][1:]}: simulated axis, true positions.',
        sections=[
            Section('Figures', tables=[table], remarks=positioning_remarks(run)),
            Section('Course', figures=[course]),
        ],
        facts=facts,
    )
