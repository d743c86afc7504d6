# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a comparison of models, and its plots."""

from collections.abc import Collection, Mapping, Sequence
from math import ceil, floor, log10
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.studies.page.drawing import (
    ACCENT,
    FAINT,
    INK,
    MUTED,
    SECOND,
    WARNING,
    add_legend,
    panel_grid,
    plot_style,
    time_axis,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.thermal import comparison as shown
from fuzzycnc_ros.studies.thermal.summary import candidate_label, has_diverged

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from fuzzycnc_ros.core.thermal.fit.comparison import Comparison, HeldOut

HOW_TO_READ = (
    'Bars show the root mean square residual of each model; the shorter, the better. Grey: the '
    'machine without compensation. Blue: less is left than that. Yellow: more is left. Strong '
    'colour: the automatic choice. Palest yellow, with a star: not to be trusted. A bar that '
    'fades across the whole panel has diverged.'
)

TRACED = (UNCOMPENSATED, 'static_ridge', shown.DEFAULT)
"""Rows that are drawn over time: the machine as it is, a plain model, the automatic choice."""


def comparison_page(comparison: 'Comparison', facts: Mapping[str, str]) -> Page:
    """Return the page of a comparison: all held-out runs together, then one by one."""
    count = len(comparison.held_out)
    best = shown.by_channel(shown.best_candidates(comparison))
    sections = [_run_section(item) for item in comparison.held_out]
    if count > 1:
        sections.insert(0, _pooled_section(comparison))
    runs = f'{count} held-out runs' if count > 1 else 'one held-out run'
    known = [item.evaluation.run for item in comparison.held_out if item.evaluation.trained_on]
    copies = f', but for {", ".join(known)}: see there' if known else ''
    return Page(
        title='Thermal models, compared on what they have not seen',
        summary=f'Judged on {runs}. Each time, sensors, settings, models and the automatic '
        f'choice came from the other samples alone{copies}. Best candidate by rmse, of those that '
        f'are trusted on every run: {best}.',
        sections=sections,
        facts=facts,
    )


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
        plot_residuals(channel, rows, labels, refused, shown.DEFAULT),
    )


def _traces(item: 'HeldOut') -> Figure:
    judged = item.evaluation
    rows = [name for name in TRACED if name in judged.predicted]
    labels = {name: candidate_label(name) for name in rows}
    labels[shown.DEFAULT] = f'{labels[shown.DEFAULT]}: {shown.choice_text(item)}'
    return Figure(
        f'{judged.run}: error that is left over time',
        'Measured minus predicted; without compensation that is the measured error itself. What '
        'is left should have no slow swing: that would be heat that the model does not know.',
        plot_traces(
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


def plot_residuals(
    heading: Sequence[str],
    rows: Mapping[str, NDArray[np.float64]],
    labels: Mapping[str, str],
    refused: Collection[str] = (),
    default: str | None = None,
) -> Any:
    """Plot a residual of many models as bars, a panel per column.

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
    What leaves more than the row 'uncompensated' is drawn in the colour of warnings.
    """
    with plot_style():
        names = list(rows)
        values = 1e6 * np.array([rows[name] for name in names])
        shown = np.array([[not np.isnan(v) and not has_diverged(1e-6 * v) for v in row]
                          for row in values])  # fmt: skip
        columns = _even(len(heading), COLUMNS_MAX)
        height = 0.62 + ROW_HEIGHT * len(names)
        figure, panels = panel_grid(len(heading), columns=columns, height=height)
        span = values[shown]
        logarithmic = bool(span.size and span.max() > LOG_RATIO * max(span.min(), 1e-3))
        place = np.arange(len(names))
        bare = 1e6 * rows.get(UNCOMPENSATED, np.full(len(heading), np.nan))
        for c, axes in enumerate(panels):
            axes.set_title(heading[c])
            low, high = _limits(values[:, c][shown[:, c]], logarithmic)
            if logarithmic:
                axes.set_xscale('log')
            for row, name in enumerate(names):
                colour = _colour(name, refused, default, values[row, c], bare[c])
                _bar(axes, row, values[row, c], (low, high), colour)
            axes.set_xlim(low, high)
            axes.set_ylim(len(names) - 0.4, -0.6)
            axes.grid(visible=False, axis='y')
            axes.tick_params(axis='y', length=0.0)
            first = axes.get_subplotspec().is_first_col()
            axes.set_yticks(place, [labels[name] for name in names] if first else [])
            _plain_ticks(axes, low, high, logarithmic)
            axes.set_xlabel('rmse [µm]')
        return figure


def plot_traces(
    time: NDArray[np.float64],
    channel: Sequence[str],
    left: Mapping[str, NDArray[np.float64]],
    labels: Mapping[str, str],
) -> Any:
    """Plot what up to three models leave of the error over time, a panel per channel.

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
    with plot_style():
        columns = _even(len(channel), CURVES_MAX)
        figure, panels = panel_grid(len(channel), columns=columns, height=2.3)
        x, x_label = time_axis(time)
        colours = (FAINT, SECOND, ACCENT)[-len(left) :]
        for c, axes in enumerate(panels):
            axes.set_title(channel[c])
            axes.axhline(0.0, color=MUTED, linewidth=0.7)
            for (name, residual), colour in zip(left.items(), colours, strict=True):
                drawn = np.where(np.isfinite(residual[:, c]), 1e6 * residual[:, c], np.nan)
                axes.plot(x, drawn, color=colour, linewidth=1.2, label=labels[name])
            axes.set_xlim(x[0], x[-1])
            axes.set_xlabel(x_label)
            if axes.get_subplotspec().is_first_col():
                axes.set_ylabel('error left [µm]')
        add_legend(figure, *panels[0].get_legend_handles_labels())
        return figure


def plot_sensor_counts(
    count: Sequence[int],
    channel: Sequence[str],
    mean: NDArray[np.float64],
    worst: NDArray[np.float64],
    largest: NDArray[np.float64],
) -> Any:
    """Plot residuals on held-out runs against the number of sensors, a panel per channel.

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
    with plot_style():
        figure, panels = panel_grid(
            len(channel), columns=_even(len(channel), CURVES_MAX), height=2.6
        )
        for c, axes in enumerate(panels):
            axes.set_title(channel[c])
            for values, label, colour, line in (
                (largest, 'largest residual', FAINT, (0, (2, 2))),
                (worst, 'rmse, worst held-out run', SECOND, '-'),
                (mean, 'rmse, mean over the held-out runs', ACCENT, '-'),
            ):
                drawn = np.where(np.isfinite(values[:, c]), 1e6 * values[:, c], np.nan)
                axes.plot(
                    count, drawn, color=colour, linestyle=line, marker='o', markersize=4.0,
                    label=label,
                )  # fmt: skip
            axes.set_xticks(count)
            axes.set_ylim(bottom=0.0)
            axes.set_xlabel('number of sensors')
            if axes.get_subplotspec().is_first_col():
                axes.set_ylabel('residual [µm]')
        handles, labels = panels[0].get_legend_handles_labels()
        add_legend(figure, handles[::-1], labels[::-1])
        return figure


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


def _bar(
    axes: Any, row: int, value: float, limits: tuple[float, float], colour: tuple[str, float]
) -> None:
    """Draw a bar with its number; one that has diverged runs out of the picture."""
    low, high = limits
    if np.isnan(value):
        return
    diverged = has_diverged(1e-6 * value)
    axes.barh(
        row,
        (high if diverged else value) - low,
        left=low,
        height=0.66,
        color=colour[0],
        alpha=colour[1] * (0.35 if diverged else 1.0),
        linewidth=0.0,
    )
    axes.annotate(
        'diverged' if diverged else f'{value:.1f}' if value >= 1.0 else f'{value:.2f}',
        (low if diverged else value, row),
        xytext=(3.0, 0.0),
        textcoords='offset points',
        va='center',
        fontsize=7.0,
        color=INK,
    )


def _colour(
    name: str, refused: Collection[str], default: str | None, value: float, bare: float
) -> tuple[str, float]:
    """Return colour and opacity of a model's bar, beside what there is without a model."""
    if name == UNCOMPENSATED or value == bare:
        return MUTED, 0.75
    if name in refused:
        return WARNING, 0.3
    return WARNING if value > bare else ACCENT, 1.0 if name == default else 0.5


def _plain_ticks(axes: Any, low: float, high: float, logarithmic: bool) -> None:
    """Mark a logarithmic axis in plain numbers, as many as fit."""
    if not logarithmic:
        axes.locator_params(axis='x', nbins=4)
        return
    decades = range(floor(log10(low)), ceil(log10(high)) + 1)
    span = log10(high / low)
    steps = (1, 2, 5) if span < 1.5 else (1, 3) if span < 2.5 else (1,)
    ticks = [step * 10.0**power for power in decades for step in steps]
    ticks = [tick for tick in ticks if low <= tick <= high]
    axes.set_xticks(ticks, [f'{tick:g}' for tick in ticks])
    axes.set_xticks([], minor=True)
