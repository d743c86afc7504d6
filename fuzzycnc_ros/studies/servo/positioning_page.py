# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A move of an axis: table, document, plots, page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.studies.page.drawing import (
    ACCENT,
    CLUSTER_COLOURS,
    FAINT,
    GRID,
    INK,
    MUTED,
    add_legend,
    new_figure,
    panel_grid,
    plot_style,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.requirement import require
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.programs.program_page import envelope

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


BAND = 2.0
"""Error within which an axis is settled [um]; the scale is linear there."""


def plot_run(run: PositioningRun) -> Any:
    """Plot position, error on a symmetric logarithmic scale, and duty."""
    with plot_style():
        figure = new_figure(6.4)
        place, error, duty = figure.subplots(3, 1, sharex=True, height_ratios=(2, 2, 1))
        place.plot(run.time, 1e3 * run.reference, color=MUTED, linewidth=1.0)
        place.plot(run.time, 1e3 * run.position, color=ACCENT)
        place.set_ylabel('position\n[mm]')
        wrong = 1e6 * run.error
        _error_axis(error, [wrong])
        _course(error, run.time, wrong, ACCENT, 1.4)
        error.set_ylabel('error\n[um]')
        _course(duty, run.time, 100.0 * run.duty, INK, 0.8)
        duty.set_ylabel('duty\n[%]')
        duty.set_xlabel('time [s]')
        figure.align_ylabels([place, error, duty])
        lines = place.get_lines()
        add_legend(figure, lines, ['reference', 'true position'])
        return figure


def plot_cases(
    runs: Mapping[str, Mapping[str, PositioningRun]],
    cases: Mapping[str, str],
    since: Mapping[str, float],
) -> Any:
    """Plot the errors of controllers on cases, one panel each.

    Parameters
    ----------
    runs : mapping
        Runs by controller and case.
    cases : mapping of str to str
        Cases that are drawn, and what they are called.
    since : mapping of str to float
        Time at which a panel begins [s]; 0 for those that are missing.
    """
    with plot_style():
        figure, panels = panel_grid(len(cases), columns=2, height=2.7)
        handles: dict[str, Any] = {}
        for axes, (case, label) in zip(panels, cases.items(), strict=True):
            first = since.get(case, 0.0)
            drawn = []
            for number, (name, made) in enumerate(runs.items()):
                run = made[case]
                part = run.time >= first
                wrong = 1e6 * run.error[part]
                drawn.append(wrong)
                colour = ACCENT if name == DEFAULT else CLUSTER_COLOURS[1 + number]
                handles[name] = _course(
                    axes, run.time[part], wrong, colour, 1.8 if name == DEFAULT else 1.0
                )
            _error_axis(axes, drawn)
            axes.set_title(label)
            axes.set_xlabel('time [s]')
        for axes in panels[::2]:
            axes.set_ylabel('error [um]')
        add_legend(figure, list(handles.values()), [LABELS[name] for name in handles])
        return figure


def plot_radius(course: Mapping[float, float], marked: Mapping[float, float]) -> Any:
    """Plot the spectral radius of the loop over factors on the axis' gain."""
    with plot_style():
        figure = new_figure(2.8)
        axes = figure.subplots()
        axes.plot(list(course), list(course.values()), color=ACCENT)
        axes.plot(list(marked), list(marked.values()), 'o', color=ACCENT, markersize=4.0)
        axes.axhline(1.0, color=INK, linewidth=0.8, linestyle=(0, (6, 3)))
        axes.annotate(
            'begins to swing', (0.01, 1.0), xycoords=('axes fraction', 'data'),
            xytext=(0.0, 3.0), textcoords='offset points', fontsize=7.5, color=MUTED,
        )  # fmt: skip
        axes.set_xlabel('gain of the axis, as multiple of the nominal one')
        axes.set_ylabel('largest magnitude\nof an eigenvalue')
        return figure


def _course(axes: Any, time: Array, values: Array, colour: str, width: float) -> Any:
    """Draw values over time, gathered where there are many."""
    when, low, high = envelope(time, values)
    if low is high:
        (line,) = axes.plot(when, low, color=colour, linewidth=width)
        return line
    axes.fill_between(when, low, high, color=colour, linewidth=0.4, alpha=0.7)
    (line,) = axes.plot(when, 0.5 * (low + high), color=colour, linewidth=width)
    return line


def _error_axis(axes: Any, values: Sequence[Array]) -> None:
    """Make the y axis one of errors [um]: linear within the band, decades beyond."""
    axes.set_yscale('symlog', linthresh=BAND, linscale=0.7)
    axes.axhspan(-BAND, BAND, color=GRID, alpha=0.7, linewidth=0.0, zorder=0)
    axes.axhline(0.0, color=FAINT, linewidth=0.6, zorder=0)
    low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    ticks = [0.0, BAND, -BAND]
    ticks += [sign * 10.0**power for power in range(1, 6) for sign in (1.0, -1.0)]
    bottom, top = min(1.6 * low, -1.5 * BAND), max(1.6 * high, 1.5 * BAND)
    shown = sorted(tick for tick in ticks if bottom <= tick <= top)
    axes.set_ylim(bottom, top)
    axes.yaxis.set_major_locator(require('matplotlib.ticker').FixedLocator(shown))
    axes.yaxis.set_major_formatter(require('matplotlib.ticker').FuncFormatter(_plain))
    axes.yaxis.set_minor_locator(require('matplotlib.ticker').NullLocator())


def _plain(value: float, _: int) -> str:
    return f'{np.round(value, 6):,g}' if abs(value) < 1e6 else f'{value:.0e}'
