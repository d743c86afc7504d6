# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Page on paths that a machine followed: feed, speed and contour error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Rule, Series, Shades
from fuzzycnc_ros.studies.page.drawing import (
    AFTER,
    BEFORE,
    FAINT,
    LIMIT,
    MEASURED,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table, case_table

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.contour.contouring import FollowedPath

Floats = NDArray[np.float64]


PIECES = 2000
"""Pieces in which a path is drawn at most, about: more make a page large and slow, not better."""

PALE = '#a9cdf2'
"""Colour of no error."""


def contouring_table(paths: Sequence[FollowedPath]) -> Table:
    """Return time and contour error of paths as a table."""
    return case_table(
        'Contour error of the followed paths',
        zip(paths),
        {
            Column('Path', numeric=False): lambda path: path.name,
            Column('method', numeric=False): lambda path: path.method,
            Column('tolerance [µm]'): lambda path: (
                f'{1e6 * path.tolerance:.1f}' if np.isfinite(path.tolerance) else '-'
            ),
            Column('time [s]'): lambda path: f'{path.duration:.3f}',
            Column('largest error [µm]'): lambda path: f'{1e6 * path.error_max:.2f}',
            Column('mean error [µm]'): lambda path: f'{1e6 * path.error_mean:.2f}',
        },
    )


def contouring_page(
    title: str, summary: str, paths: Sequence[FollowedPath], facts: Mapping[str, str]
) -> Page:
    """Return the page on followed paths.

    Parameters
    ----------
    title, summary : str
        Headline and the sentences under it.
    paths : sequence of FollowedPath
        Paths with their samples.
    facts : mapping of str to str
        Provenance.
    """
    first = Section(
        'Time and contour error',
        texts=(
            'The contour error is the distance from the tool to the nearest point of the path, '
            'taken from the first sample on it to the end of the run-out; the mean excludes '
            'the run-out.',
        ),
        tables=(contouring_table(paths),),
    )
    rest = [Section(f'Path {path.name}', figures=tuple(_figures(path))) for path in paths]
    window = 'from the first sample on a path to the end of its run-out'
    return Page(
        title=title,
        summary=summary,
        sections=(first, *rest),
        facts={'Judged': window, **facts},
    )


def _figures(path: FollowedPath) -> Iterator[Figure]:
    yield Figure(
        f'{path.name}: where the error is',
        'The path of the tool, coloured by its contour error: blue within the tolerance, red '
        'beyond it. A good schedule leaves about the same error everywhere it is limited by the '
        'tolerance, and less where the limits of the axes hold it back.',
        error_path_chart(path),
    )
    yield Figure(
        f'{path.name}: feed and speed',
        'The feed that the scheduler asks for (thin), the speed within the limits of path and '
        'axes (thick), and the speed of the tool itself, later by the delay of the axes.',
        speed_chart(path),
    )
    yield Figure(
        f'{path.name}: contour error over time',
        'The dashed line is the tolerance that the feed was chosen for.',
        error_chart(path),
    )


def error_path_chart(path: FollowedPath) -> Chart:
    """Declare the path of the tool in its first two axes, coloured by contour error."""
    on = path.time >= 0.0
    return path_chart(path.position[on][:, :2], path.error[on], path.axis[:2], path.tolerance)


def path_chart(
    point: Floats, error: Floats, axis: Sequence[str], tolerance: float = np.nan
) -> Chart:
    """Declare a path coloured by its error: blue within the tolerance, red beyond it.

    Parameters
    ----------
    point : ndarray, shape (n, 2)
        Places of the tool [m]; NaN where the path is interrupted.
    error : ndarray, shape (n,)
        Error there [m].
    axis : sequence of str, length 2
        Names of the axes.
    tolerance : float
        Largest error wanted [m]; NaN if none was named.
    """
    # Of a long path each piece shows the largest error of a few samples.
    begin = np.arange(0, max(len(error) - 1, 1), 1 + len(error) // PIECES)
    error = 1e6 * np.maximum(
        np.maximum.reduceat(error, begin), np.append(error[begin[1:]], error[-1])
    )
    point = 1e3 * point[np.append(begin, len(point) - 1)]
    largest, bound = float(error.max(initial=1e-3)), 1e6 * tolerance
    stops = [(0.0, PALE), (bound if np.isfinite(bound) else largest, AFTER)]
    if largest > bound:
        stops += [(bound, BEFORE), (max(largest, 1.2 * bound), LIMIT)]
    mark = (bound, 'tolerance') if np.isfinite(bound) else None
    level = np.append(np.nan, error)
    series = Series('tool', point[:, 1], AFTER, 1.8, x=point[:, 0], level=level)
    panel = Panel(
        np.empty(0),
        Axis(axis[1], 'mm'),
        [series],
        plane=1.0,
        shades=Shades(Axis('contour error', 'µm'), stops, mark),
    )
    return Chart(Axis(axis[0], 'mm'), [panel], height=5.6)


def speed_chart(path: FollowedPath) -> Chart:
    """Declare the scheduled feed, the speed within the limits and that of the tool over time."""
    on = path.time >= 0.0
    time = path.time[on]
    told = np.gradient(path.reference[on], time, axis=0)
    series = []
    if path.schedule is not None:
        # Where the commanded point is, so that feeds by place become feeds by time
        step = np.linalg.norm(np.diff(path.reference[on], axis=0), axis=1)
        way = np.append(0.0, np.cumsum(step))
        feed = np.interp(way, path.schedule.arc_length, path.schedule.feed)
        series.append(Series('scheduled feed', 1e3 * feed, FAINT, 0.8))
    series += [
        Series('speed within the limits', 1e3 * np.linalg.norm(told, axis=1), AFTER),
        Series(
            'speed of the tool', 1e3 * np.linalg.norm(path.velocity[on], axis=1), MEASURED, 0.8
        ),
    ]
    panel = Panel(time, Axis('speed', 'mm/s', low=0.0), series)
    return Chart(Axis('time', 's'), [panel], height=3.4)


def error_chart(path: FollowedPath) -> Chart:
    """Declare the contour error over time."""
    on = path.time >= 0.0
    series = Series('contour error', 1e6 * path.error[on], MEASURED, 0.9)
    rules = []
    if np.isfinite(path.tolerance):
        rules.append(Rule(1e6 * path.tolerance, LIMIT, 'tolerance', (6.0, 3.0)))
    top = max(1e6 * float(path.error[on].max()), *(rule.at for rule in rules), 1e-9)
    axis = Axis('contour error', 'µm', low=0.0, high=1.1 * top)
    return Chart(Axis('time', 's'), [Panel(path.time[on], axis, [series], rules=rules)])
