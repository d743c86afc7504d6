# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Page on a whole shift: the error of every job, before and after, and where it comes from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from fuzzycnc_ros.studies.contour.contouring_page import error_path_chart, speed_chart
from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.drawing import (
    AFTER,
    BEFORE,
    INK,
    LIMIT,
    MEASURED,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.soft import pattern_page
from fuzzycnc_ros.studies.soft.foam_page import tracks_chart
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
    shares = [
        (old.error, new.error, old.left, old.own, new.left, new.contour, new.positioning)
        for old, new in zip(before.jobs, after.jobs, strict=True)
    ]
    top = max((max(row[:2]) for row in shares), default=0.0) or 1.0
    colours = (BEFORE, AFTER, BEFORE, BEFORE, AFTER, AFTER, AFTER)
    return Table(
        'Part error of each job [µm] and where it comes from, before and after',
        columns,
        rows,
        bars={
            (r, 2 + c): (value / top, colours[c])
            for r, row in enumerate(shares)
            for c, value in enumerate(row)
            if np.isfinite(value)
        },
        bars_mean='each error, beside the largest of a part; orange before, blue after',
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
                tracks_chart(
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
        error_path_chart(path),
    )
    yield Figure(
        f'{path.name}: feed and speed',
        'The feed that the scheduler asks for (thin), the speed within the limits of path and '
        'axes (thick), and the speed of the slides.',
        speed_chart(path),
    )


def _um(value: float) -> str:
    return f'{1e6 * value:.1f}' if np.isfinite(value) else '-'
