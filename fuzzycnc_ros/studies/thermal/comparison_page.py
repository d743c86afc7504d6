# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a comparison of models, and its plots."""

from collections.abc import Collection, Mapping, Sequence
from math import ceil, log10
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.thermal.candidate import DEFAULT, UNCOMPENSATED
from fuzzycnc_ros.studies.page.chart import Axis, Chart, Panel, Picture, Rule, Series, View
from fuzzycnc_ros.studies.page.drawing import (
    AFTER,
    BEFORE,
    FAINT,
    INK,
    LIMIT,
    MUTED,
    OTHER,
    WARNING,
    panel_grid,
    plot_style,
    time_axis,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.page.paper import plain_ticks
from fuzzycnc_ros.studies.thermal import comparison as shown
from fuzzycnc_ros.studies.thermal.summary import candidate_label, has_diverged

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from fuzzycnc_ros.core.thermal.fit.comparison import Comparison, HeldOut

HOW_TO_READ = (
    'The root mean square residual of each model; the further left, the better. Orange: the '
    'machine without compensation. Blue: less is left than that. Red: more is left. Strong '
    'colour: the automatic choice. Pale yellow, with a star: not to be trusted. Dots instead of '
    'bars: the axis is logarithmic. An arrow: diverged.'
)

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
        title='Thermal models, compared on what they have not seen',
        summary=f'Judged on {runs}. Each time, sensors, settings, models and the automatic '
        f'choice came from the other samples alone{copies}. By rmse, of those that are trusted on '
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
        figures=[
            _bars(
                shown.POOLED,
                comparison.channel,
                comparison.rms(),
                shown.refused_anywhere(comparison),
            )
        ],
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
        figures=[
            _bars(judged.run, judged.channel, judged.rms, shown.refused_on(item)),
            _traces(item),
        ],
    )


def _bars(
    name: str,
    channel: 'Sequence[str]',
    rms: 'shown.Figures',
    refused: 'Collection[str]',
) -> Figure:
    rows = {row: rms[row] for row in shown.row_order(rms)}
    labels = {row: shown.marked_label(row, refused) for row in rows}
    return Figure(
        f'{name}: what each model leaves',
        HOW_TO_READ,
        residuals_picture(channel, rows, labels, refused, DEFAULT),
    )


def _traces(item: 'HeldOut') -> Figure:
    judged = item.evaluation
    rows = [name for name in TRACED if name in judged.predicted]
    labels = {name: candidate_label(name) for name in rows}
    labels[DEFAULT] = f'{labels[DEFAULT]}: {shown.choice_text(item)}'
    return Figure(
        f'{judged.run}: error that is left over time',
        'Measured minus predicted; without compensation that is the measured error itself. What '
        'is left should have no slow swing: that would be heat that the model does not know.',
        traces_chart(
            judged.time,
            judged.channel,
            {name: judged.measured - judged.predicted[name] for name in rows},
            labels,
        ),
    )


COLUMNS_MAX = 5
"""Bar panels in a row: labels of models on the left leave room for no more."""

CURVES_MAX = 3
"""Curve panels in a row."""

LOG_RATIO = 12.0
"""Ratio of figures in one plot above which bars need a logarithmic scale [-]."""

ROW_HEIGHT = 0.19
"""Height of a bar with its gap [in]."""


def residuals_picture(
    heading: Sequence[str],
    rows: Mapping[str, NDArray[np.float64]],
    labels: Mapping[str, str],
    refused: Collection[str] = (),
    default: str | None = None,
) -> Picture:
    """Draw a residual of many models, a panel per column.

    Bars begin at zero; where figures differ too much for that, dots stand on a logarithmic axis.

    Parameters
    ----------
    heading : sequence of str, length c
        What the columns are, such as channels.
    rows : mapping of str to array, shape (c,)
        Residuals of each model [m]; NaN where there is none.
    labels : mapping of str to str
        Name of each model for people.
    refused : collection of str
        Models that are drawn pale.
    default : str, optional
        Model that is drawn in front.

    Notes
    -----
    What leaves more than the row 'uncompensated' is drawn in the colour of limits.
    """
    with plot_style():
        names = list(rows)
        values = 1e6 * np.array([rows[name] for name in names])
        shown = np.array([[not np.isnan(v) and not has_diverged(1e-6 * v) for v in row]
                          for row in values])  # fmt: skip
        in_row = _even(len(heading), COLUMNS_MAX)
        height = 0.62 + ROW_HEIGHT * len(names)
        figure, panels = panel_grid(len(heading), columns=in_row, height=height)
        known = values[shown]
        logarithmic = bool(known.size and known.max() > LOG_RATIO * max(known.min(), 1e-3))
        place = np.arange(len(names))
        bare = 1e6 * rows.get(UNCOMPENSATED, np.full(len(heading), np.nan))
        for c, axes in enumerate(panels):
            axes.set_title(heading[c])
            low, high = _limits(values[:, c][shown[:, c]], logarithmic)
            if logarithmic:
                axes.set_xscale('log')
            for row, name in enumerate(names):
                colour = _colour(name, refused, default, values[row, c], bare[c])
                _mark(axes, row, values[row, c], (low, high), colour)
            axes.set_xlim(low, high)
            axes.set_ylim(len(names) - 0.4, -0.6)
            axes.grid(visible=logarithmic, axis='y')
            axes.tick_params(axis='y', length=0.0)
            first = axes.get_subplotspec().is_first_col()
            axes.set_yticks(place, [labels[name] for name in names] if first else [])
            if logarithmic:
                span = log10(high / low)
                steps = (1, 2, 5) if span < 1.5 else (1, 3) if span < 2.5 else (1,)
                plain_ticks(axes.xaxis, low, high, steps)
            else:
                axes.locator_params(axis='x', nbins=4)
            axes.set_xlabel('rmse [µm]')
        model = [labels[name] for name in names]
        columns = {f'{name} rmse [µm]': values[:, c] for c, name in enumerate(heading)}
        views = [
            View(axes, column, place, read={'model': model, 'rmse [µm]': column})
            for axes, column in zip(panels, np.where(shown, values, np.nan).T, strict=True)
        ]
        return Picture(figure, {'model': model, **columns}, views)


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
            Axis('error left', 'µm'),
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
                    (worst, 'rmse, worst held-out run', OTHER, ()),
                    (mean, 'rmse, mean over the held-out runs', AFTER, ()),
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


def _limits(values: NDArray[np.float64], logarithmic: bool) -> tuple[float, float]:
    """Return the ends of an axis, with room for a number behind the longest bar [um]."""
    if not values.size:
        return (0.1, 1.0) if logarithmic else (0.0, 1.0)
    high = float(values.max())
    if not logarithmic:
        return 0.0, 1.38 * (high or 1.0)
    low = 0.6 * max(float(values.min()), 1e-3)
    return low, high * (high / low) ** 0.38


def _mark(
    axes: Any, row: int, value: float, limits: tuple[float, float], colour: tuple[str, float]
) -> None:
    """Draw a bar, or a dot on a logarithmic axis, with its number; an arrow for what diverged."""
    low, high = limits
    if np.isnan(value):
        return
    diverged = has_diverged(1e-6 * value)
    if diverged:
        axes.plot(high, row, '>', color=colour[0], markersize=6.0, clip_on=False)
    elif low > 0.0:
        axes.plot(value, row, 'o', color=colour[0], alpha=colour[1], markersize=5.5)
    else:
        axes.barh(row, value, height=0.66, color=colour[0], alpha=colour[1], linewidth=0.0)
    axes.annotate(
        'diverged' if diverged else f'{value:.1f}' if value >= 1.0 else f'{value:.2f}',
        (high if diverged else value, row),
        xytext=(-6.0 if diverged else 5.0 if low > 0.0 else 3.0, 0.0),
        textcoords='offset points',
        ha='right' if diverged else 'left',
        va='center',
        fontsize=7.0,
        color=INK,
    )


def _colour(
    name: str, refused: Collection[str], default: str | None, value: float, bare: float
) -> tuple[str, float]:
    """Return colour and opacity of a model's mark, beside what there is without a model."""
    if name == UNCOMPENSATED or value == bare:
        return BEFORE, 0.75
    if name in refused:
        return WARNING, 0.4
    return LIMIT if value > bare else AFTER, 1.0 if name == default else 0.5
