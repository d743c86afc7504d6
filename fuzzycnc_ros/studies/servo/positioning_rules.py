# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Learnt rules and the stability of a position loop, as tables; at what gains it swings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from math import isfinite, pi
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.core.servo.stability import spectral_radii
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.servo.positioning_page import microns

if TYPE_CHECKING:
    from fuzzycnc_ros.core.servo.rule_learning import LearnedRules
    from fuzzycnc_ros.core.servo.stability import StabilityReport

GAIN_SPREAD = (0.5, 0.75, 1.0, 1.25, 1.5)
"""Gains of the axis, as multiples of the nominal one, at which the loop has to settle."""

MARKS = {'data': '', 'mirrored': '*', 'filled': '~'}
"""Mark behind a consequent, by its origin."""


def rules_table(learned: LearnedRules, sets: tuple[str, ...]) -> Table:
    """Return consequents with marks of where they are from; records and conflicts behind."""
    columns = [Column('error \\ rate', numeric=False), *(Column(name) for name in sets)]
    columns += [Column('records'), Column('conflicts')]
    rows = []
    for i, name in enumerate(sets):
        cells = [
            f'{learned.values[i, j]:.3f}{MARKS[learned.source[i][j]]}' for j in range(len(sets))
        ]
        records, conflicts = int(learned.count[i].sum()), int(learned.conflicts[i].sum())
        rows.append((name, *cells, f'{records:,}', f'{conflicts:,}'))
    title = 'Learnt rules; * = from the opposite cell, ~ = no data, from its neighbours'
    return Table(title, tuple(columns), tuple(rows))


def rules_document(learned: LearnedRules) -> dict[str, Any]:
    """Return the rules and how well the records cover them."""
    return asdict(learned) | {'coverage': learned.coverage}


def stability_table(report: StabilityReport, title: str) -> Table:
    """Return the margins of a loop."""
    low, high = report.gain_margin
    above = f'x{high:.2f}' if isfinite(high) else 'none'
    swing = 'none'
    if report.limit_cycle:
        size = microns(report.limit_cycle)
        size += '' if report.limit_cycle >= 1e-3 else ' µm'
        swing = f'{size} at {report.limit_cycle_frequency / (2.0 * pi):.1f} Hz'
    rows = [
        ('gain of the error at the target', f'{1e-3 * report.error_gain:.4g} 1/mm'),
        ('gain of the rate at the target', f'{1e-3 * report.rate_gain:.4g} s/mm'),
        ('gain that swings without rate action', f'{1e-3 * report.ultimate_gain:.4g} 1/mm'),
        ('least floor of the error without rate action', f'{report.error_floor_min:.3g}'),
        ('gain of the axis at which it swings, above', above),
        ('gain of the axis at which it swings, below', f'x{low:.2f}' if low else 'none'),
        ('phase margin', f'{180.0 / pi * report.phase_margin:.1f}°'),
        ('crossover', f'{report.crossover:.0f} rad/s'),
        *(
            (f'spectral radius, gain x{gain:g}', f'{radius:.4f}{" swings" if radius >= 1 else ""}')
            for gain, radius in report.spectral_radius.items()
        ),
        ('lasting oscillation (describing function)', swing),
    ]
    return Table(title, (Column('Quantity', numeric=False), Column('value')), tuple(rows))


def stability_page(
    report: StabilityReport,
    course: Mapping[float, float],
    table: Table,
    facts: Mapping[str, str],
) -> Page:
    """Return the page of a loop; `course` is its spectral radius over many gains."""
    from fuzzycnc_ros.studies.servo.positioning_page import radius_chart

    figure = Figure(
        'Spectral radius over the gain of the axis',
        'Largest magnitude of an eigenvalue of the sampled loop near the target, axis and '
        'observer together. Below 1 it settles; the lower, the faster.',
        radius_chart(course, report.spectral_radius),
    )
    return Page(
        title='What a position loop has to spare',
        summary='Near the target the controller is linear; farther out the describing function '
        'stands for the contracted surface.',
        sections=[Section('Margins', tables=[table]), Section('Gain', figures=[figure])],
        facts={'Judged': 'the linear loop near the target', **facts},
    )


def swinging(controller: VariableUniverseController) -> list[str]:
    """Return at what gains of half to one and a half times nominal a loop swings."""
    return [
        f"note: at x{gain:g} of the axis' gain the loop swings, spectral radius {size:.5f}; "
        'friction may hide it in a move'
        for gain, size in spectral_radii(controller, GAIN_SPREAD).items()
        if size >= 1.0
    ]
