# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a comparison of models, and its plots."""

from collections.abc import Mapping, Sequence
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.thermal.candidate import DEFAULT, UNCOMPENSATED
from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.drawing import (
    AFTER,
    BEFORE,
    FAINT,
    MUTED,
    OTHER,
    time_axis,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.thermal import comparison as shown
from fuzzycnc_ros.studies.thermal.summary import candidate_label

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.fit.comparison import Comparison, HeldOut

TRACED = (UNCOMPENSATED, 'static_ridge', DEFAULT)
"""Rows that are drawn over time: the machine as it is, a plain model, the automatic choice."""


def comparison_page(comparison: 'Comparison', facts: Mapping[str, str]) -> Page:
    """Return the page of a comparison: all held-out runs together, then one by one."""
    count = len(comparison.held_out)
    best = '; '.join(shown.best_lines(comparison))
    sections = [_run_section(item) for item in comparison.held_out]
    if count > 1:
        sections.insert(0, _pooled_section(comparison))
    runs = f'{count} held-out runs' if count > 1 else 'one held-out run'
    known = [item.evaluation.run for item in comparison.held_out if item.evaluation.trained_on]
    copies = f', but for {", ".join(known)}: see there' if known else ''
    return Page(
        title='Thermal models compared on unseen runs',
        summary=f'Judged on {runs}. Each time, sensors, settings, models and the automatic '
        f'choice came from the other samples alone{copies}. By rms, of those that are trusted on '
        f'every run, {best}. {shown.COMPARED_LINE[0].upper() + shown.COMPARED_LINE[1:]}.',
        sections=sections,
        facts={'Judged': _spans(comparison), **facts},
    )


def _spans(comparison: 'Comparison') -> str:
    """Return what is held out, each with its window [s]."""
    judged = [item.evaluation for item in comparison.held_out]
    return '; '.join(f'{one.run}: {one.time[0]:,.0f} to {one.time[-1]:,.0f} s' for one in judged)


def _pooled_section(comparison: 'Comparison') -> Section:
    return Section(
        heading=shown.POOLED,
        tables=[shown.pooled_table(comparison)],
        judged=shown.pooled_remarks(comparison),
        remarks=shown.pooled_refusal_lines(comparison),
    )


def _run_section(item: 'HeldOut') -> Section:
    judged = item.evaluation
    return Section(
        heading=f'Held out: {judged.run}',
        texts=[
            f'Sensors: {", ".join(item.inputs)}.',
            f'Automatic choice, the default: {shown.choice_text(item)}.',
        ],
        judged=shown.held_out_remarks(item),
        tables=[shown.held_out_table(item)],
        remarks=shown.refusal_lines(item),
        figures=[_traces(item)],
    )


def _traces(item: 'HeldOut') -> Figure:
    judged = item.evaluation
    rows = [name for name in TRACED if name in judged.predicted]
    labels = {name: candidate_label(name) for name in rows}
    labels[DEFAULT] = f'{labels[DEFAULT]}: {shown.choice_text(item)}'
    return Figure(
        f'{judged.run}: remaining error over time',
        'Measured minus predicted; without compensation that is the measured error itself. A '
        'slow swing in it means heat that the model has no input for.',
        traces_chart(
            judged.time,
            judged.channel,
            {name: judged.measured - judged.predicted[name] for name in rows},
            labels,
        ),
    )


CURVES_MAX = 3
"""Curve panels in a row."""


def traces_chart(
    time: NDArray[np.float64],
    channel: Sequence[str],
    left: Mapping[str, NDArray[np.float64]],
    labels: Mapping[str, str],
) -> Chart:
    """Declare what up to three models leave of the error over time, a panel per channel.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Time of each sample [s].
    channel : sequence of str, length c
        Channels.
    left : mapping of str to ndarray, shape (n, c)
        Residual of each model [m], the most important one last; NaN leaves a gap.
    labels : mapping of str to str
        Name of each model for people.
    """
    x, unit = time_axis(time)
    colours = {UNCOMPENSATED: BEFORE, DEFAULT: AFTER}
    panels = [
        Panel(
            x,
            Axis('remaining error', 'µm'),
            [
                Series(labels[name], 1e6 * residual[:, c], colours.get(name, OTHER), 1.2)
                for name, residual in left.items()
            ],
            title=title,
            rules=[Rule(0.0, MUTED)],
        )
        for c, title in enumerate(channel)
    ]
    return Chart(Axis('time', unit), panels, columns=_even(len(channel), CURVES_MAX), height=2.3)


def sensor_counts_chart(
    count: Sequence[int],
    channel: Sequence[str],
    mean: NDArray[np.float64],
    worst: NDArray[np.float64],
    largest: NDArray[np.float64],
) -> Chart:
    """Declare residuals on held-out runs against the number of sensors, a panel per channel.

    Parameters
    ----------
    count : sequence of int, length k
        Numbers of sensors, increasing.
    channel : sequence of str, length c
        Channels.
    mean, worst : ndarray, shape (k, c)
        Root mean square residual [m], mean over the held-out runs and on the worst of them.
    largest : ndarray, shape (k, c)
        Largest residual on any of them [m].
    """
    x = np.array(count, dtype=np.float64)
    panels = [
        Panel(
            x,
            Axis('residual', 'µm', low=0.0),
            [
                Series(label, 1e6 * values[:, c], colour, dashes=dashes, kind='both')
                for values, label, colour, dashes in (
                    (largest, 'largest residual', FAINT, (2.0, 2.0)),
                    (worst, 'rms, worst held-out run', OTHER, ()),
                    (mean, 'rms, mean over the held-out runs', AFTER, ()),
                )
            ],
            title=title,
        )
        for c, title in enumerate(channel)
    ]
    columns = _even(len(channel), CURVES_MAX)
    return Chart(Axis('number of sensors', ticks=tuple(x)), panels, columns=columns, height=2.6)


def _even(panels: int, most: int) -> int:
    """Return how many panels stand in a row, so that no row is left nearly empty."""
    return ceil(panels / ceil(panels / most))
