# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Page on a whole shift: the error of every job, before and after, and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from fuzzycnc_ros.studies.contour.contouring_page import plot_error_path, plot_speed
from fuzzycnc_ros.studies.page.drawing import (
    ACCENT,
    FAINT,
    INK,
    MUTED,
    SECOND,
    WARNING,
    add_legend,
    new_figure,
    plot_style,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.soft.foam_page import plot_tracks
from fuzzycnc_ros.studies.soft.pattern_page import AFTER, BEFORE, pattern_table

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.contour.contouring import FollowedPath
    from fuzzycnc_ros.studies.shift.whole_shift_log import WholeShift
    from fuzzycnc_ros.studies.soft.pattern import StitchedPattern


def job_table(before: WholeShift, after: WholeShift) -> Table:
    """Return the error of every job before and after, and where the rest comes from.

    Parameters
    ----------
    before, after : WholeShift
        The same jobs without compensation at the programmed feed, and with everything on.
    """
    columns = (
        Column('Job', numeric=False),
        Column('at [h]'),
        Column('before', 'part error [µm]'),
        Column('after', 'part error [µm]'),
        Column('thermal', 'before'),
        Column('axes', 'before'),
        Column('thermal', 'after'),
        Column('contour', 'after'),
        Column('position', 'after'),
        Column('before', 'time [s]'),
        Column('after', 'time [s]'),
    )
    rows = tuple(
        (
            new.name,
            f'{new.start / 3600.0:.2f}',
            _um(old.error),
            _um(new.error),
            _um(old.left),
            _um(old.own),
            _um(new.left),
            _um(new.contour),
            _um(new.positioning),
            f'{old.duration:.2f}',
            f'{new.duration:.2f}',
        )
        for old, new in zip(before.jobs, after.jobs, strict=True)
    )
    return Table(
        'Part error of each job [µm] and where it comes from, before and after', columns, rows
    )


def shift_page(
    before: WholeShift,
    after: WholeShift,
    patterns: Mapping[str, StitchedPattern],
    facts: Mapping[str, str],
) -> Page:
    """Return the page on a whole shift.

    Parameters
    ----------
    before, after : WholeShift
        As for `job_table`.
    patterns : mapping
        The track of the second machine, as for `pattern_table`.
    facts : mapping of str to str
        Provenance.
    """
    jobs = Section(
        'What became of the parts',
        texts=(
            'Part error is the largest thermal error while a job was done plus the largest error '
            'of the axes: at worst they add up. Contour errors count while the tool cuts; rapids '
            'leave no mark. Before: no compensation, and the programmed feed within the limits of '
            'the axes. A move takes the time until its axes are within 2 µm of the target for '
            'good.',
        ),
        tables=(job_table(before, after),),
        figures=(
            Figure(
                'Where the error of each part comes from',
                'Pairs of bars: the left, paler one before, the right one after. What is left '
                'after compensation comes from the axes, where friction holds them back.',
                plot_sources(before, after),
            ),
            Figure(
                'Thermal error over the shift',
                'Grey is what the machine measures without compensation, blue what the offsets '
                'in force leave of it; both of the worst channel. The bands show the spindle '
                'at work, the dotted lines the jobs.',
                plot_shift(after),
            ),
        ),
    )
    paths = {path.name.partition('_')[0]: path for path in reversed(after.paths)}
    cut = [
        Section(f'Path {name}', figures=tuple(_path_figures(path)))
        for name, path in sorted(paths.items())
    ]
    soft = Section(
        'The second machine: a pattern on a foam sheet',
        texts=(
            'Stitched at the same time in a namespace of its own. A first piece is stitched as '
            'drawn, and the gains of the model are fitted to it; a model as trained knows only '
            'the mean sheet of its samples. All runs draw the same stiffness, friction and noise.',
        ),
        tables=(pattern_table(patterns),),
        figures=(
            Figure(
                'The track',
                'Where the stitches are to lie, and where they lie once the sheet has relaxed.',
                plot_tracks(
                    {
                        patterns[AFTER].name: (
                            patterns[AFTER].nominal,
                            patterns[BEFORE].stitched,
                            patterns[AFTER].stitched,
                        )
                    }
                ),
            ),
        ),
    )
    return Page(
        title='One shift with everything on',
        summary='A simulated mill warms up and cools down over eight hours and cuts parts in '
        'between, while a second machine stitches a pattern on a foam sheet; live over DDS, in '
        'lock-step.',
        sections=(jobs, *cut, soft),
        facts=facts,
    )


def plot_sources(before: WholeShift, after: WholeShift) -> object:
    """Plot the error of each job as stacked bars by source, before and after."""
    with plot_style():
        figure = new_figure(3.6)
        axes = figure.subplots()
        place = np.arange(len(after.jobs), dtype=np.float64)
        handles, labels = [], []
        for shift, name, offset, alpha in (
            (before, 'before', -0.2, 0.45),
            (after, 'after', 0.2, 1.0),
        ):
            thermal = np.array([1e6 * job.left for job in shift.jobs])
            own = np.array([1e6 * job.own for job in shift.jobs])
            look = {'width': 0.36, 'alpha': alpha}
            handles += [
                axes.bar(place + offset, thermal, color=SECOND, **look)[0],
                axes.bar(place + offset, own, bottom=thermal, color=ACCENT, **look)[0],
            ]
            labels += [f'thermal, {name}', f'axes, {name}']
        names = [f'{_short(job.name)}\n{job.start / 3600.0:.1f} h' for job in after.jobs]
        axes.set_xticks(place, names)
        axes.set_ylabel('part error [µm]')
        axes.grid(visible=False, axis='x')
        add_legend(figure, handles, labels)
        return figure


def plot_shift(shift: WholeShift) -> object:
    """Plot thermal error, what is left of it, and the jobs over the shift."""
    run = shift.thermal
    measured, left = np.abs(run.measured), np.abs(run.residual())
    known = np.isfinite(measured).all(axis=1) & np.isfinite(left).all(axis=1)
    hours = run.time / 3600.0
    with plot_style():
        figure = new_figure(3.4)
        axes = figure.subplots()
        top = 1.08e6 * measured[known].max()
        handles, labels = [], []
        if run.spindle_speed is not None:
            share = np.abs(run.spindle_speed) / max(float(np.abs(run.spindle_speed).max()), 1.0)
            band = axes.fill_between(hours, 0.0, 0.15 * top * share, color=FAINT, alpha=0.25, lw=0)
            handles.append(band)
            labels.append('spindle speed')
        lines = (
            (measured, MUTED, 'without compensation'),
            (left, ACCENT, 'left'),
        )
        for values, colour, label in lines:
            handles += axes.plot(hours[known], 1e6 * values[known].max(axis=1), color=colour)
            labels.append(label)
        handles.append(axes.axhline(5.0, color=WARNING, linestyle='--', linewidth=1.0))
        labels.append('5 µm')
        for job in shift.jobs:
            axes.axvline(job.start / 3600.0, color=INK, linestyle=':', linewidth=0.7)
        axes.set_xlabel('time [h]')
        axes.set_ylabel('thermal error [µm]')
        axes.set_ylim(0.0, top)
        add_legend(figure, handles, labels)
        return figure


def _path_figures(path: FollowedPath) -> Iterator[Figure]:
    yield Figure(
        f'{path.name}: where the error is',
        'The path of the tool, rapids included, coloured by its contour error.',
        plot_error_path(path),
    )
    yield Figure(
        f'{path.name}: feed and speed',
        'The feed that the scheduler asks for (thin), the speed within the limits of path and '
        'axes (thick), and the speed of the slides.',
        plot_speed(path),
    )


def _short(name: str) -> str:
    return 'move' if ':' in name else name.partition('_')[0]


def _um(value: float) -> str:
    return f'{1e6 * value:.1f}' if np.isfinite(value) else '-'
