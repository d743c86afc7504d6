# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Page on paths that a machine followed: feed, speed and contour error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.studies.page.drawing import (
    ACCENT,
    FAINT,
    INK,
    SECOND,
    WARNING,
    add_legend,
    new_figure,
    plot_style,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.requirement import require
from fuzzycnc_ros.studies.page.table import Column, Table

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.contour.contouring import FollowedPath

Floats = NDArray[np.float64]


PIECES = 4000
"""Pieces in which a path is drawn at most, about: more make a page large and slow, not better."""


def contouring_table(paths: Sequence[FollowedPath]) -> Table:
    """Return time and contour error of paths as a table."""
    columns = (
        Column('Path', numeric=False),
        Column('method', numeric=False),
        Column('tolerance [µm]'),
        Column('time [s]'),
        Column('largest error [µm]'),
        Column('mean error [µm]'),
    )
    rows = tuple(
        (
            path.name,
            path.method,
            f'{1e6 * path.tolerance:.1f}' if np.isfinite(path.tolerance) else '-',
            f'{path.duration:.3f}',
            f'{1e6 * path.error_max:.2f}',
            f'{1e6 * path.error_mean:.2f}',
        )
        for path in paths
    )
    return Table(title='Contour error of the followed paths', columns=columns, rows=rows)


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
            'taken from the first sample on it to the end of the run-out; the mean leaves '
            'the run-out away.',
        ),
        tables=(contouring_table(paths),),
    )
    rest = [Section(f'Path {path.name}', figures=tuple(_figures(path))) for path in paths]
    return Page(title=title, summary=summary, sections=(first, *rest), facts=facts)


def _figures(path: FollowedPath) -> Iterator[Figure]:
    yield Figure(
        f'{path.name}: where the error is',
        'The path of the tool, coloured by its contour error. A good schedule leaves about the '
        'same error everywhere it is limited by the tolerance, and less where the limits of the '
        'axes hold it back.',
        plot_error_path(path),
    )
    yield Figure(
        f'{path.name}: feed and speed',
        'The feed that the scheduler asks for (thin), the speed within the limits of path and '
        'axes (thick), and the speed of the tool itself, later by the delay of the axes.',
        plot_speed(path),
    )
    yield Figure(
        f'{path.name}: contour error over time',
        'The dashed line is the tolerance that the feed was chosen for.',
        plot_error(path),
    )


def plot_error_path(path: FollowedPath) -> Any:
    """Plot the path of the tool in its first two axes, coloured by contour error."""
    on = path.time >= 0.0
    point, error = path.position[on][:, :2], path.error[on]
    # Of a long path each piece shows the largest error of a few samples.
    begin = np.arange(0, max(len(error) - 1, 1), 1 + len(error) // PIECES)
    error = np.maximum(np.maximum.reduceat(error, begin), np.append(error[begin[1:]], error[-1]))
    point = point[np.append(begin, len(point) - 1)]
    with plot_style():
        figure = new_figure(5.6)
        axes = figure.subplots()
        ends = np.stack([point[:-1], point[1:]], axis=1)
        lines = require('matplotlib.collections').LineCollection(
            1e3 * ends, cmap='turbo', linewidths=1.6, capstyle='round'
        )
        lines.set_array(1e6 * error)
        axes.add_collection(lines)
        axes.autoscale_view()
        axes.set_aspect('equal', adjustable='datalim')
        axes.set_xlabel(f'{path.axis[0]} [mm]')
        axes.set_ylabel(f'{path.axis[1]} [mm]')
        figure.colorbar(lines, ax=axes, label='contour error [µm]', shrink=0.8, pad=0.02)
        return figure


def plot_speed(path: FollowedPath) -> Any:
    """Plot the scheduled feed, the speed within the limits and that of the tool over time."""
    on = path.time >= 0.0
    time = path.time[on]
    told = np.gradient(path.reference[on], time, axis=0)
    with plot_style():
        figure = new_figure(3.4)
        axes = figure.subplots()
        handles, labels = [], []
        if path.schedule is not None:
            # Where the commanded point is, so that feeds by place become feeds by time
            step = np.linalg.norm(np.diff(path.reference[on], axis=0), axis=1)
            way = np.append(0.0, np.cumsum(step))
            feed = np.interp(way, path.schedule.arc_length, path.schedule.feed)
            handles += axes.plot(time, 1e3 * feed, color=FAINT, linewidth=0.8)
            labels.append('scheduled feed')
        handles += axes.plot(time, 1e3 * np.linalg.norm(told, axis=1), color=ACCENT)
        labels.append('speed within the limits')
        actual = np.linalg.norm(path.velocity[on], axis=1)
        handles += axes.plot(time, 1e3 * actual, color=SECOND, linewidth=0.8)
        labels.append('speed of the tool')
        axes.set_xlabel('time [s]')
        axes.set_ylabel('speed [mm/s]')
        axes.set_ylim(bottom=0.0)
        add_legend(figure, handles, labels)
        return figure


def plot_error(path: FollowedPath) -> Any:
    """Plot the contour error over time."""
    on = path.time >= 0.0
    with plot_style():
        figure = new_figure(3.0)
        axes = figure.subplots()
        handles = axes.plot(path.time[on], 1e6 * path.error[on], color=INK, linewidth=0.9)
        labels = ['contour error']
        if np.isfinite(path.tolerance):
            handles.append(axes.axhline(1e6 * path.tolerance, color=WARNING, linestyle='--'))
            labels.append('tolerance')
        axes.set_xlabel('time [s]')
        axes.set_ylabel('contour error [µm]')
        axes.set_ylim(bottom=0.0)
        add_legend(figure, handles, labels)
        return figure
