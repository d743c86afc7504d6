# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Page on a whole shift: the error of every job, before and after, and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.studies.contour.contouring_page import error_path_picture, speed_chart
from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Picture, Rule, Series, View
from fuzzycnc_ros.studies.page.drawing import (
    AFTER,
    BEFORE,
    INK,
    LIMIT,
    MEASURED,
    add_legend,
    new_figure,
    plot_style,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.soft import pattern_page
from fuzzycnc_ros.studies.soft.foam_page import tracks_picture
from fuzzycnc_ros.studies.soft.pattern_page import pattern_table

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
                'Pairs of bars: the left one before, the right one after; strong what comes from '
                'heat, pale what comes from the axes. What is left after compensation comes from '
                'the axes, where friction holds them back.',
                sources_picture(before, after),
            ),
            Figure(
                'Thermal error over the shift',
                'Orange is what the machine measures without compensation, blue what the offsets '
                'in force leave of it; both of the worst channel. The dotted lines are the jobs.',
                shift_chart(after),
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
                tracks_picture(
                    {
                        patterns[pattern_page.AFTER].name: (
                            patterns[pattern_page.AFTER].nominal,
                            patterns[pattern_page.BEFORE].stitched,
                            patterns[pattern_page.AFTER].stitched,
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
        facts={
            'Machine': 'a mill and a quilter, both simulated',
            'Judged': f'{len(after.jobs)} jobs, each from its start to its end',
            **facts,
        },
    )


def sources_picture(before: WholeShift, after: WholeShift) -> Picture:
    """Draw the error of each job as stacked bars by source, before and after."""
    columns: dict[str, Any] = {
        'job': [job.name for job in after.jobs],
        'at [h]': [job.start / 3600.0 for job in after.jobs],
    }
    with plot_style():
        figure = new_figure(3.6)
        axes = figure.subplots()
        place = np.arange(len(after.jobs), dtype=np.float64)
        handles, labels = [], []
        for shift, name, offset, colour in (
            (before, 'before', -0.2, BEFORE),
            (after, 'after', 0.2, AFTER),
        ):
            thermal = np.array([1e6 * job.left for job in shift.jobs])
            own = np.array([1e6 * job.own for job in shift.jobs])
            look = {'width': 0.36, 'color': colour}
            handles += [
                axes.bar(place + offset, thermal, **look)[0],
                axes.bar(place + offset, own, bottom=thermal, alpha=0.45, **look)[0],
            ]
            labels += [f'thermal, {name}', f'axes, {name}']
            columns |= {f'thermal, {name} [µm]': thermal, f'axes, {name} [µm]': own}
        names = [f'{_short(job.name)}\n{job.start / 3600.0:.1f} h' for job in after.jobs]
        axes.set_xticks(place, names)
        axes.set_ylabel('part error [µm]')
        axes.grid(visible=False, axis='x')
        add_legend(figure, handles, labels)
        tops = [np.array([1e6 * (job.left + job.own) for job in s.jobs]) for s in (before, after)]
        view = View(
            axes,
            np.concatenate([place - 0.2, place + 0.2]),
            np.concatenate(tops),
            rows=np.tile(np.arange(len(place)), 2),
        )
        return Picture(figure, columns, [view])


def shift_chart(shift: WholeShift) -> Chart:
    """Declare thermal error, what is left of it, and the jobs over the shift."""
    run = shift.thermal
    measured, left = np.abs(run.measured), np.abs(run.residual())
    known = np.isfinite(measured).all(axis=1) & np.isfinite(left).all(axis=1)
    hours = run.time[known] / 3600.0
    top = 1.08e6 * measured[known].max()
    rules = [Rule(5.0, LIMIT, '5 µm', (6.0, 3.0))]
    rules += [Rule(job.start / 3600.0, INK, '', (1.0, 2.0), upright=True) for job in shift.jobs]
    panel = Panel(
        hours,
        Axis('thermal error', 'µm', low=0.0, high=top),
        [
            Series('before: without compensation', 1e6 * measured[known].max(axis=1), BEFORE),
            Series('after: left', 1e6 * left[known].max(axis=1), AFTER),
        ],
        rules=rules,
    )
    panels = [panel]
    if run.spindle_speed is not None:
        rpm = np.abs(run.spindle_speed[known]) * 60.0 / (2.0 * np.pi)
        speed = Series('spindle speed', rpm, MEASURED, kind='steps')
        panels.append(Panel(hours, Axis('speed', 'rpm', low=0.0), [speed], share=0.5))
    return Chart(Axis('time', 'h'), panels, height=3.0)


def _path_figures(path: FollowedPath) -> Iterator[Figure]:
    yield Figure(
        f'{path.name}: where the error is',
        'The path of the tool, rapids included, coloured by its contour error.',
        error_path_picture(path),
    )
    yield Figure(
        f'{path.name}: feed and speed',
        'The feed that the scheduler asks for (thin), the speed within the limits of path and '
        'axes (thick), and the speed of the slides.',
        speed_chart(path),
    )


def _short(name: str) -> str:
    return 'move' if ':' in name else name.partition('_')[0]


def _um(value: float) -> str:
    return f'{1e6 * value:.1f}' if np.isfinite(value) else '-'
