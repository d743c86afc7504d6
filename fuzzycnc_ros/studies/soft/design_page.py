# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Page on a design: as planned, as the sheet would show it, and compensated, at true scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fuzzycnc_ros.core.deformation.stitch_design import NeighbourGap, PlacedRun, neighbour_gaps
from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Series
from fuzzycnc_ros.studies.page.drawing import AFTER, BEFORE, MUTED
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table, case_table

ROWS = 10
"""Gaps that are listed."""


def design_page(runs: Sequence[PlacedRun], lines: Sequence[str], facts: Mapping[str, str]) -> Page:
    """Return the page on a design.

    Parameters
    ----------
    runs : sequence of PlacedRun
        Its runs.
    lines : sequence of str
        What is to be said of it.
    facts : mapping of str to str
        Provenance.
    """
    gaps = neighbour_gaps(runs)
    section = Section(
        'The design',
        texts=(
            *lines,
            'Without compensation the sheet would show the orange stitches, as far as the model '
            'knows it; with it, about those that were planned. The rest is the grid of the '
            'file, and the limits of the offsets.',
        ),
        tables=(gap_table(gaps),) if gaps else (),
        figures=(
            Figure(
                'True scale',
                'Printed at 100 % it has the size of the design: planned, as it would be '
                'stitched, and as it is commanded.',
                design_chart(runs),
            ),
        ),
    )
    return Page(
        title='A design on soft material',
        summary='Stitches as planned, as the model expects the sheet to show them without '
        'compensation, and as they are commanded so that it shows the plan.',
        sections=(section,),
        facts=facts,
    )


def gap_table(gaps: Sequence[NeighbourGap]) -> Table:
    """Return the largest gaps between neighbouring runs, by how much they open."""
    return case_table(
        'Largest gaps between neighbouring runs',
        zip(gaps[:ROWS]),
        {
            Column('Runs', numeric=False): lambda gap: f'{gap.runs[0] + 1} and {gap.runs[1] + 1}',
            Column('place [mm]', numeric=False): lambda gap: (
                f'{1e3 * gap.place[0]:.1f}, {1e3 * gap.place[1]:.1f}'
            ),
            Column('planned', 'gap [mm]'): lambda gap: f'{1e3 * gap.planned:.2f}',
            Column('without', 'gap [mm]'): lambda gap: f'{1e3 * gap.before:.2f}',
            Column('compensated', 'gap [mm]'): lambda gap: f'{1e3 * gap.after:.2f}',
        },
    )


def design_chart(runs: Sequence[PlacedRun]) -> Chart:
    """Declare the runs of a design at true scale."""
    series = []
    for name, shapes, colour, width in (
        ('planned', [run.planned for run in runs], MUTED, 1.6),
        ('as it would be stitched', [run.planned - run.offset for run in runs], BEFORE, 0.7),
        ('commanded', [run.commanded for run in runs], AFTER, 0.7),
    ):
        broken = [np.concatenate([points, [[np.nan, np.nan]]]) for points in shapes]
        x, y = 1e3 * np.concatenate(broken).T
        series.append(Series(name, y, colour, width, x=x))
    panel = Panel(np.empty(0), Axis('Y', 'mm'), series, plane=1.0, true_scale=True)
    return Chart(Axis('X', 'mm'), [panel])
