# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Time against contour error of scheduling methods: table, figure, page, document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.studies.page.drawing import (
    ACCENT,
    CLUSTER_COLOURS,
    FAINT,
    INK,
    MUTED,
    SECOND,
    new_figure,
    plot_style,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.pareto.pareto import Pareto

DEFAULT, PUBLISHED, REFINED = 'log_fuzzy', 'fuzzy', 'refined'
"""The default method, the published one, and the practical bound."""

LABELS: Mapping[str, str] = {
    'constant': 'constant feed',
    'fuzzy': 'published fuzzy',
    'log_fuzzy': 'log-fuzzy (default)',
    'normal_acceleration': 'normal acceleration',
    'chord_error': 'chord error',
    'look_ahead': 'look-ahead',
    'jerk_limited': 'jerk-limited',
    'refined': 'refined by measured error',
}
"""Methods for people."""

_LINES: Mapping[str, tuple[str, Any, str]] = {
    'constant': (MUTED, '-', 's'),
    'fuzzy': (SECOND, '-', 'D'),
    'log_fuzzy': (ACCENT, '-', 'o'),
    'normal_acceleration': (CLUSTER_COLOURS[2], '-', '^'),
    'chord_error': (CLUSTER_COLOURS[3], (0, (1, 3)), 'x'),
    'look_ahead': (CLUSTER_COLOURS[4], (1.5, (1, 3)), '+'),
    'jerk_limited': (CLUSTER_COLOURS[7], '-', 'v'),
    'refined': (INK, (0, (4, 2)), ''),
}
"""Colour, dashes and marker; what nearly coincides is drawn as points on a line."""


def millimetres(length: float) -> str:
    """Return a length as people give it, such as 0.05 [mm]."""
    return f'{1e3 * length:.6g}'


def pareto_table(pareto: Pareto, knobs: Mapping[str, str]) -> Table:
    """Return the time of each method at equal largest contour error.

    Parameters
    ----------
    pareto : Pareto
        What was measured.
    knobs : mapping of str to str
        Parameter that each method is turned by.
    """
    columns = [Column('Method', numeric=False), Column('turned by', numeric=False)]
    columns += [Column(f'{millimetres(error)} mm', 'time [s] at') for error in pareto.errors]
    names = list(pareto.methods)
    rows, strong = [], set()
    for name in names:
        times = [pareto.methods[name].at_error[error] for error in pareto.errors]
        cells = ['-' if time is None else f'{time:.2f}' for time in times]
        rows.append((name, knobs[name], *cells))
    for column, error in enumerate(pareto.errors, start=2):
        # the bound is refined on the very path, so it does not compete
        known = {
            row: pareto.methods[name].at_error[error]
            for row, name in enumerate(names)
            if name != REFINED and pareto.methods[name].at_error[error] is not None
        }
        if known:
            strong.add((min(known, key=lambda row: known[row] or 0.0), column))
    highlight = frozenset({names.index(DEFAULT)} if DEFAULT in names else ())
    title = f'Time at equal largest contour error: {pareto.path}'
    return Table(title, tuple(columns), tuple(rows), frozenset(strong), highlight)


def pareto_lines(pareto: Pareto) -> list[str]:
    """Return what the table does not say: the limits alone, reasons, the default's saving."""
    limits = pareto.limits
    lines = [
        f'full feed everywhere, braked by the path acceleration alone: {limits.duration:.2f} s, '
        f'which leaves {millimetres(round(limits.error, 8))} mm'
    ]
    for name, method in pareto.methods.items():
        for error, reason in method.reasons.items():
            lines.append(f'{name} at {millimetres(error)} mm: {reason}')
    if DEFAULT in pareto.methods:
        for error in pareto.errors:
            lines += _saving(pareto, error)
    return lines


def _saving(pareto: Pareto, error: float) -> list[str]:
    """Say how the default compares at an error."""
    time = pareto.methods[DEFAULT].at_error[error]
    found = []
    for name, text in ((PUBLISHED, '{:.0f} % less time than {}'), (REFINED, '{:.2f} times {}')):
        other = pareto.methods[name].at_error[error] if name in pareto.methods else None
        if time is None or other is None:
            continue
        figure = time / other if name == REFINED else 100.0 * (1.0 - time / other)
        found.append(text.format(figure, name))
    return [f'{DEFAULT} at {millimetres(error)} mm: {", ".join(found)}'] if found else []


def pareto_document(pareto: Pareto) -> dict[str, Any]:
    """Return all figures.

    Returns
    -------
    dict
        `methods`: method -> list of `error_mm` and `time_s`, by error; `equal_error`: error [mm]
        -> method -> time [s], None where the error cannot be reached.
    """
    return {
        'methods': {name: method.points for name, method in pareto.methods.items()},
        'equal_error': {
            millimetres(error): {
                name: method.at_error[error] for name, method in pareto.methods.items()
            }
            for error in pareto.errors
        },
    }


def plot_pareto(pareto: Pareto) -> Any:
    """Plot time against largest contour error, both logarithmic."""
    with plot_style():
        figure = new_figure(5.2)
        axes = figure.subplots()
        axes.set_xscale('log')
        axes.set_yscale('log')
        shown = [name for name in pareto.methods if pareto.methods[name].points]
        # the default lies on top
        for name in sorted(shown, key=lambda name: name == DEFAULT):
            points = pareto.methods[name].points
            colour, dashes, marker = _LINES[name]
            axes.plot(
                [1e3 * point.error for point in points],
                [point.duration for point in points],
                color=colour,
                linestyle=dashes,
                marker=marker,
                markersize=6.0 if marker in ('x', '+') else 4.0,
                linewidth=2.2 if name == DEFAULT else 1.2,
                label=LABELS[name],
            )
        for error in pareto.errors:
            axes.axvline(1e3 * error, color=FAINT, linewidth=0.7, linestyle=(0, (2, 3)))
        axes.axhline(pareto.limits.duration, color=MUTED, linewidth=0.8, linestyle=(0, (6, 3)))
        axes.annotate(
            f'full feed within the path acceleration, {pareto.limits.duration:.2f} s',
            (0.005, pareto.limits.duration),
            xycoords=('axes fraction', 'data'),
            xytext=(0.0, 3.0),
            textcoords='offset points',
            fontsize=7.5,
            color=MUTED,
        )
        _plain_ticks(axes.xaxis, axes.get_xlim())
        _plain_ticks(axes.yaxis, axes.get_ylim())
        axes.set_xlabel('largest contour error [mm]')
        axes.set_ylabel('time [s]')
        handles, labels = axes.get_legend_handles_labels()
        wanted = [labels.index(LABELS[name]) for name in shown]
        # every curve falls, so that this corner is free
        axes.legend(
            [handles[i] for i in wanted],
            [labels[i] for i in wanted],
            loc='upper right',
            ncol=2,
            columnspacing=1.6,
        )
        return figure


def _plain_ticks(axis: Any, limits: tuple[float, float]) -> None:
    """Mark a logarithmic axis at 1, 2 and 5 of each decade, in plain numbers."""
    ticks = [step * 10.0**power for power in range(-7, 5) for step in (1, 2, 5)]
    ticks = [tick for tick in ticks if limits[0] <= tick <= limits[1]]
    axis.set_ticks(ticks, [f'{tick:g}' for tick in ticks])
    axis.set_ticks([], minor=True)


def pareto_page(
    pareto: Pareto, table: Table, facts: Mapping[str, str], remarks: Sequence[str]
) -> Page:
    """Return the page of a comparison."""
    figure = Figure(
        'Time against largest contour error',
        'Each point is a schedule that was driven on the simulated machine; each method is turned '
        'by its own knob. Lower and further left is better. Dotted: the errors of the table. '
        'Refinement needs a machine that measures its error on this very path, and shows what '
        'can be had. Chord error and look-ahead lie on normal acceleration where neither the '
        'chord nor the path acceleration limits them.',
        plot_pareto(pareto),
    )
    return Page(
        title='What a contour tolerance costs in time',
        summary=f'{pareto.path[0].upper()}{pareto.path[1:]}. The same simulated machine drives '
        'the schedules of all methods.',
        sections=[
            Section('At equal largest contour error', tables=[table], remarks=remarks),
            Section('Over all errors', figures=[figure]),
        ],
        facts=facts,
    )
