# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Page on a design: as planned, as the sheet would show it, and compensated, at true scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fuzzycnc_ros.core.deformation.stitch_design import NeighbourGap, PlacedRun, neighbour_gaps
from fuzzycnc_ros.studies.page.chart import Picture, View
from fuzzycnc_ros.studies.page.drawing import AFTER, BEFORE, MUTED, plot_style
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.requirement import require

ROWS = 10
"""Gaps that are listed."""
SHOWN = 20_000
"""Most stitches of which the page has the figures."""
_MARGIN = 8e-3
_INCH = 25.4e-3


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
            'knows it; with it, about those that were planned. What is left is the grid of the '
            'file, and the limits of the offsets.',
        ),
        tables=(gap_table(gaps),) if gaps else (),
        figures=(
            Figure(
                'True scale',
                'Printed at 100 % it has the size of the design: planned, as it would be '
                'stitched, and as it is commanded.',
                design_picture(runs),
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
    columns = (
        Column('Runs', numeric=False),
        Column('place [mm]', numeric=False),
        Column('planned', 'gap [mm]'),
        Column('without', 'gap [mm]'),
        Column('compensated', 'gap [mm]'),
    )
    rows = tuple(
        (
            f'{gap.runs[0] + 1} and {gap.runs[1] + 1}',
            f'{1e3 * gap.place[0]:.1f}, {1e3 * gap.place[1]:.1f}',
            *(f'{1e3 * value:.2f}' for value in (gap.planned, gap.before, gap.after)),
        )
        for gap in gaps[:ROWS]
    )
    return Table('Largest gaps between neighbouring runs', columns, rows)


def design_picture(runs: Sequence[PlacedRun]) -> Picture:
    """Draw the runs of a design at true scale."""
    layers = (
        ('planned', [run.planned for run in runs], MUTED, 1.6),
        ('as it would be stitched', [run.planned - run.offset for run in runs], BEFORE, 0.7),
        ('commanded', [run.commanded for run in runs], AFTER, 0.7),
    )
    everything = np.concatenate([points for _, shapes, *_ in layers for points in shapes])
    low, high = everything.min(axis=0) - _MARGIN, everything.max(axis=0) + _MARGIN
    low[1] -= _MARGIN  # for the legend
    width, height = np.maximum(high - low, 0.07)
    planned = np.concatenate([run.planned for run in runs])
    kept = np.unique(np.linspace(0, len(planned) - 1, min(len(planned), SHOWN)).astype(int))
    columns: dict[str, Any] = {
        'run': np.repeat(np.arange(1, len(runs) + 1), [len(run.planned) for run in runs])[kept]
    }
    with plot_style():
        figure = require('matplotlib.figure').Figure(figsize=(width / _INCH, height / _INCH))
        figure.patch.set_alpha(0.0)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        for name, shapes, colour, line in layers:
            broken = [np.concatenate([points, [[np.nan, np.nan]]]) for points in shapes]
            x, y = 1e3 * np.concatenate(broken).T
            axes.plot(x, y, color=colour, linewidth=line, label=name)
            flat = 1e3 * np.concatenate(shapes)[kept]
            columns |= {f'{name} X [mm]': flat[:, 0], f'{name} Y [mm]': flat[:, 1]}
        axes.set_xlim(1e3 * low[0], 1e3 * (low[0] + width))
        axes.set_ylim(1e3 * low[1], 1e3 * (low[1] + height))
        axes.legend(loc='lower left', ncols=3, fontsize=7.0, borderpad=0.2)
        view = View(axes, 1e3 * planned[kept, 0], 1e3 * planned[kept, 1])
        return Picture(figure, columns, (view,), true_scale=True)
