# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Time against contour error of scheduling methods: table, figure, page, document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.drawing import (
    AFTER,
    BEFORE,
    CLUSTER_COLOURS,
    FAINT,
    INK,
    LIMIT,
    MUTED,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table, tied

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

BEST = (
    'least time, as shown, of the methods that can be used on any path; the refined one is a '
    'bound and does not compete'
)
"""Meaning of the marks in the table."""

_LINES: Mapping[str, tuple[str, tuple[float, ...]]] = {
    'constant': (MUTED, ()),
    'fuzzy': (BEFORE, ()),
    'log_fuzzy': (AFTER, ()),
    'normal_acceleration': (CLUSTER_COLOURS[2], ()),
    'chord_error': (CLUSTER_COLOURS[3], (1.0, 3.0)),
    'look_ahead': (CLUSTER_COLOURS[4], (2.0, 4.0)),
    'jerk_limited': (CLUSTER_COLOURS[7], ()),
    'refined': (INK, (4.0, 2.0)),
}
"""Colour and dashes; what nearly coincides is drawn as points on a dotted line."""


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
    rows = []
    for name in names:
        times = [pareto.methods[name].at_error[error] for error in pareto.errors]
        cells = ['-' if time is None else f'{time:.2f}' for time in times]
        rows.append((name, knobs[name], *cells))
    strong = set()
    for column in range(2, len(columns)):
        # the bound is refined on the very path, so it does not compete
        competing = {
            row: cells[column]
            for row, (name, cells) in enumerate(zip(names, rows, strict=True))
            if name != REFINED and cells[column] != '-'
        }
        if competing:
            least = min(competing, key=lambda row: float(competing[row]))
            strong |= {(row, column) for row in tied(competing, [least])}
    highlight = frozenset({names.index(DEFAULT)} if DEFAULT in names else ())
    title = f'Time at equal largest contour error: {pareto.path}'
    return Table(
        title, tuple(columns), tuple(rows), frozenset(strong), highlight, strong_means=BEST
    )


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


def pareto_chart(pareto: Pareto) -> Chart:
    """Declare time against largest contour error, both logarithmic."""
    shown = [name for name in pareto.methods if pareto.methods[name].points]
    series = []
    # the default lies on top
    for name in sorted(shown, key=lambda name: name == DEFAULT):
        points = sorted(pareto.methods[name].points, key=lambda point: point.error)
        colour, dashes = _LINES[name]
        series.append(
            Series(
                LABELS[name],
                np.array([point.duration for point in points]),
                colour,
                width=2.2 if name == DEFAULT else 1.2,
                dashes=dashes,
                kind='both',
                x=np.array([1e3 * point.error for point in points]),
            )
        )
    rules = [Rule(1e3 * error, FAINT, '', (2.0, 3.0), upright=True) for error in pareto.errors]
    limits = pareto.limits.duration
    name = f'full feed within the path acceleration, {limits:.2f} s'
    rules.append(Rule(limits, LIMIT, name, (6.0, 3.0)))
    panel = Panel(np.empty(0), Axis('time', 's', 'log'), series, rules=rules)
    return Chart(Axis('largest contour error', 'mm', 'log'), [panel], height=5.2)


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
        pareto_chart(pareto),
    )
    return Page(
        title='What a contour tolerance costs in time',
        summary=f'{pareto.path[0].upper()}{pareto.path[1:]}. The same simulated machine drives '
        'the schedules of all methods.',
        sections=[
            Section('At equal largest contour error', tables=[table], remarks=remarks),
            Section('Over all errors', figures=[figure]),
        ],
        facts={'Machine': 'simulated', 'Judged': f'the whole of {pareto.path}', **facts},
    )
