# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a scheduled program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite

from fuzzycnc_ros.core.feedrate.gcode.blocks import Note
from fuzzycnc_ros.studies.page.html import Figure, Page, Remark, Section
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.pareto.pareto_page import LABELS
from fuzzycnc_ros.studies.programs.program_drive import (
    AFTER_STOP,
    DURATION_MAX,
    EVEN,
    METHODS,
    PROGRAMMED,
    MethodDrive,
)
from fuzzycnc_ros.studies.programs.schedule_plots import plot_motion, plot_path
from fuzzycnc_ros.studies.programs.schedule_tables import ScheduleFigures, schedule_table, speed
from fuzzycnc_ros.studies.programs.schedule_trace import PathTrace


def methods_table(found: Mapping[str, MethodDrive], method: str, tolerance: float) -> Table:
    """Return time and simulated contour error of every method on a stretch of a program."""
    columns = (
        Column('Method', numeric=False),
        Column('made for the tolerance', numeric=False),
        Column('time [s]'),
        Column('away from stops', 'largest contour error [mm]'),
        Column('anywhere', 'largest contour error [mm]'),
    )
    rows: list[tuple[str, ...]] = []
    highlight: set[int] = set()
    for name in (PROGRAMMED, EVEN, *METHODS):
        if name not in found:
            continue
        one = found[name]
        errors = ('-', '-')
        if one.drive is not None:
            errors = _millimetres(one.drive.error_away), _millimetres(one.drive.error)
        duration = f'{one.duration:,.2f}' if one.drive else f'more than {one.duration:,.0f}'
        label = {
            PROGRAMMED: 'as programmed',
            EVEN: f'one feed for all, {speed(one.feed)}',
        }.get(name) or LABELS[name]
        if name == method:
            highlight.add(len(rows))
        rows.append((label, 'yes' if one.knows_tolerance else 'no', duration, *errors))
    return Table(
        f'Tolerance {1e3 * tolerance:g} mm: the same stretch on the simulated machine',
        columns,
        tuple(rows),
        highlight=frozenset(highlight),
    )


def schedule_page(
    figures: ScheduleFigures,
    trace: PathTrace,
    found: Mapping[str, MethodDrive],
    stretch: str,
    facts: Mapping[str, str],
) -> Page:
    """Return the page of a scheduled program.

    Parameters
    ----------
    figures : ScheduleFigures
        What became of it.
    trace : PathTrace
        Its path by feed.
    found : mapping of str to MethodDrive
        Methods on a stretch of it, driven on the simulated machine.
    stretch : str
        Which stretch that is.
    facts : mapping of str to str
        Provenance.
    """
    name = figures.method
    label = LABELS.get(name, name)
    path = Figure(
        'The path by feed',
        'The feed that each block asks for; starts, stops and braking come on top. '
        + (
            f'Thinned out: each edge stands for up to {trace.stride} blocks or pieces of arcs.'
            if trace.stride > 1
            else 'Rapids and blocks that keep their feed are left out.'
        ),
        plot_path(trace),
    )
    sections = [
        Section(
            'Times within the limits of the machine',
            judged=[] if figures.kept else [Remark(figures.verdict, warning=True)],
            tables=[schedule_table(figures)],
            remarks=[
                *figures.remarks(),
                'The bound is no forecast: bends shorter than the machine reacts, such as rounded '
                'corners, leave less.',
            ],
            figures=[path],
        ),
        _methods_section(figures, found, stretch, name, label),
    ]
    if figures.notes:
        sections.append(_notes_section(figures.notes))
    return Page(
        title='Feeds that keep a contour tolerance',
        summary=f'{figures.program}, scheduled by {label} for a contour error of no more than '
        f'{1e3 * figures.tolerance:g} mm.',
        sections=sections,
        facts=facts,
    )


def _methods_section(
    figures: ScheduleFigures,
    found: Mapping[str, MethodDrive],
    stretch: str,
    name: str,
    label: str,
) -> Section:
    """Return the section that compares the methods."""
    plots = []
    chosen, own = found[name].drive, found[PROGRAMMED].drive
    if chosen is not None:
        plots.append(
            Figure(
                'Motion over time',
                f'Along the path, on {stretch}: the reference that the machine is given, within '
                'its limits. Without a limit of jerk the acceleration jumps. Where there are too '
                'many samples, a band spans the values about each moment.',
                plot_motion(chosen, own, (label, 'as programmed')),
            )
        )
    return Section(
        'Methods side by side',
        texts=[
            f'On {stretch}, rapids and what keeps its feed left out, each schedule was driven on '
            'the simulated machine. The published fuzzy method, constant feed and chord error '
            'know no tolerance: they are shown at the same upper bound of the feed. One feed for '
            'all is the largest that keeps the tolerance in the sharpest bend.'
        ],
        tables=[methods_table(found, name, figures.tolerance)],
        remarks=[
            f'Away from stops: later than {AFTER_STOP:g} delays of the machine after an exact '
            'stop, where the error depends on acceleration and rest (parameter settle), not on '
            'the feed; - where stops follow each other too closely.',
            f'More than {DURATION_MAX:.0f} s are not driven.',
        ],
        figures=plots,
    )


def _notes_section(notes: Sequence[Note]) -> Section:
    return Section(
        'Passed through untouched',
        texts=['These lines came out as they went in; what follows from them for the times:'],
        remarks=[str(note) for note in notes],
    )


def _millimetres(error: float) -> str:
    return f'{1e3 * error:.4f}' if isfinite(error) else '-'
