# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position controllers side by side: tables, document, page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.servo.positioning_page import DEFAULT, LABELS, microns, seconds

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.servo.servo_cases import RandomFigures, ServoComparison

SELECTING = '-50'
"""Case that a controller has to settle in to be drawn."""

DRAWN = {
    '-50': '-50 mm, with friction',
    'load +10 %': 'load of +10 % of the drive at 2 s',
    'sine': 'sine of 10 mm, 0.5 Hz',
    '20 um': 'step of 20 µm',
}
"""Cases that are drawn, and what they are called."""

SINCE = {'load +10 %': 1.9, 'sine': 2.0}
"""Begin of a drawing [s]."""


def moves_table(comparison: ServoComparison) -> Table:
    """Return settling time, overshoot and steady error of all moves to a target."""
    columns = [Column('Controller', numeric=False)]
    columns += [Column(label) for label in comparison.cases.values()]
    rows = []
    for name, figures in comparison.figures.items():
        moves = [figures.steps[case] for case in comparison.cases]
        cells = [
            ' / '.join((seconds(move.settle), microns(move.overshoot), microns(move.steady_error)))
            for move in moves
        ]
        rows.append((LABELS[name], *cells))
    return Table(
        'Moves: within 2 µm for good after [s] / overshoot [µm] / error after 2 s [µm]',
        tuple(columns),
        tuple(rows),
        highlight=_highlight(comparison),
    )


def others_table(comparison: ServoComparison) -> Table:
    """Return what a load, a sine, a circle and random moves leave."""
    kinds = ('moderate', 'hard') if comparison.moves else ()
    columns = (
        Column('Controller', numeric=False),
        Column('load: dip [µm] / back after [s]'),
        Column('sine: max / rms [µm]'),
        Column('circle: rms [µm]'),
        *(Column(f'{kind}: within 1 µm / 2 µm [%] / max [µm]') for kind in kinds),
    )
    rows = []
    for name, figures in comparison.figures.items():
        row = [
            LABELS[name],
            f'{microns(figures.dip)} / {seconds(figures.recovery)}',
            ' / '.join(map(microns, figures.sine)),
            microns(figures.circle[1]),
        ]
        for kind in kinds:
            found = figures.random.get(kind)
            row.append('' if found is None else _random_cell(found))
        rows.append(tuple(row))
    title = 'Load of ±10 % of the drive; sine of 10 mm, 0.5 Hz; circle of R20 mm at 40 mm/s'
    if comparison.moves:
        title += f'; {comparison.moves} random moves with moderate and with hard friction'
    return Table(title, columns, tuple(rows), highlight=_highlight(comparison))


def _random_cell(found: RandomFigures) -> str:
    shares = f'{100.0 * found.within_1:.1f} / {100.0 * found.within_2:.1f}'
    return f'{shares} / {microns(found.error_max)}'


def comparison_remarks(comparison: ServoComparison) -> list[str]:
    """Return what a reader of the tables has to know."""
    lines = [
        'lathe axis, friction of 2 % of the drive and 3 % at breakaway where nothing else is '
        'said; - : never within 2 µm. Moves without friction are waited for up to 40 s, the '
        'others 4 s',
        'sine and circle are fed forward by those that can: not by those as published and on '
        'fixed published scales',
    ]
    if comparison.moves and any(not found.random for found in comparison.figures.values()):
        lines.append('random moves: not made by those that do not settle with friction at all')
    gave_up = {
        name: [case for case, run in found.runs.items() if run.fault]
        for name, found in comparison.figures.items()
    }
    lines += [f'{name} gave up on: {", ".join(some)}' for name, some in gave_up.items() if some]
    for name, found in comparison.figures.items():
        faults = sum(kind.faults for kind in found.random.values())
        if faults:
            lines.append(f'{name} gave up on {faults} random moves')
    return lines


def comparison_document(comparison: ServoComparison) -> dict[str, Any]:
    """Return all figures in SI: by controller `steps`, `load`, `sine`, `circle`, `random`."""
    return {
        'seed': comparison.seed,
        'random_moves': comparison.moves,
        'controllers': {
            name: {
                'steps': found.steps,
                'load': {'dip': found.dip, 'recovery': found.recovery},
                'sine': {'max': found.sine[0], 'rms': found.sine[1]},
                'circle': {'max': found.circle[0], 'rms': found.circle[1]},
                'random': found.random,
            }
            for name, found in comparison.figures.items()
        },
    }


def comparison_page(
    comparison: ServoComparison,
    tables: Sequence[Table],
    remarks: Sequence[str],
    facts: Mapping[str, str],
) -> Page:
    """Return the page of a comparison."""
    from fuzzycnc_ros.studies.servo.positioning_page import cases_chart

    drawn = {
        name: found.runs
        for name, found in comparison.figures.items()
        if isfinite(found.runs[SELECTING].settle())
    }
    sections = [Section('Figures', tables=tables, remarks=remarks)]
    if drawn:
        courses = Figure(
            'Error over time',
            'Reference less true position, of the controllers that settle with friction; the '
            'errors of others would hide theirs. Linear within the 2 µm that count as settled, '
            'which are shaded, logarithmic beyond.',
            cases_chart(drawn, DRAWN, SINCE),
        )
        sections.append(Section('Courses', figures=[courses]))
    return Page(
        title='Position controllers of the lathe axis, side by side',
        summary='All controllers on the same simulated axis, with the same noise. All are tuned '
        'on it by the same means, but those as published; small differences mean nothing.',
        sections=sections,
        facts={'Machine': 'simulated', 'Judged': 'each case from its start to its end', **facts},
    )


def _highlight(comparison: ServoComparison) -> frozenset[int]:
    return frozenset(i for i, name in enumerate(comparison.figures) if name == DEFAULT)
