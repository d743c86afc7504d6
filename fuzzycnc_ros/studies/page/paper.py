# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A declared figure on paper, and where scripts do not run: drawn by matplotlib."""

from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np

from fuzzycnc_ros.studies.page.chart import DOTS_MAX, Axis, Chart, Panel, Series, Span
from fuzzycnc_ros.studies.page.drawing import INK, MUTED, add_legend, new_figure, plot_style
from fuzzycnc_ros.studies.requirement import require

ROWS = 1000
"""Rows of a series on paper: no printer shows more extremes."""
_ROWS, _POINTS, _ROWS_MIN = 240, 1200, 60
"""Rows of a series in a page of text, and those of all series of a panel, which make its size."""

_CHARACTER = 0.062
"""Width of a character of a stretch's name, about [in]."""

_DOT = 3.0
"""Size of a dot [pt]."""


def drawn(chart: Chart) -> Any:
    """Return the matplotlib figure of a chart."""
    with plot_style():
        rows = ceil(len(chart.panels) / chart.columns)
        figure = new_figure(0.3 + chart.height * rows)
        stacked = chart.columns == 1 and rows > 1
        shares = [panel.share for panel in chart.panels] if stacked else None
        grid = figure.subplots(
            rows,
            chart.columns,
            squeeze=False,
            sharex=chart.linked and stacked,
            gridspec_kw={'height_ratios': shares},
        )
        places = list(grid.flat)
        for axes in places[len(chart.panels) :]:
            axes.remove()
        handles: dict[str, Any] = {}
        for number, (axes, panel) in enumerate(zip(places, chart.panels, strict=False)):
            most = max(_ROWS_MIN, min(_ROWS, _POINTS // max(1, len(panel.series))))
            for name, handle in draw_panel(axes, panel, chart.x_axis, most).items():
                handles.setdefault(name, handle)
            if not (stacked and chart.linked) or number == rows - 1:
                axes.set_xlabel(chart.x_axis.label)
        if stacked:
            figure.align_ylabels(places)
        add_legend(figure, list(handles.values()), list(handles))
        return figure


def plain_ticks(axis: Any, low: float, high: float, every: tuple[int, ...] = (1, 2, 5)) -> None:
    """Mark a logarithmic axis in plain numbers, at steps of each decade."""
    ticks = [step * 10.0**power for power in range(-9, 10) for step in every]
    ticks = [tick for tick in ticks if low <= tick <= high]
    axis.set_ticks(ticks, [f'{tick:g}' for tick in ticks])
    axis.set_ticks([], minor=True)


def draw_panel(axes: Any, panel: Panel, x_axis: Axis, most: int = ROWS) -> dict[str, Any]:
    """Draw a panel into axes, each series in `most` rows; return what its legend names."""
    # With an x of its own each series keeps its own extremes.
    apart = [replace(item, x=panel.x) if item.x is None else item for item in panel.series]
    panel = replace(panel, series=apart).thinned(most)
    handles: dict[str, Any] = {}
    axes.set_title(panel.title)
    axes.set_ylabel(panel.y_axis.label)
    for span in panel.spans:
        axes.axvspan(span.low, span.high, color=span.colour, alpha=0.14, linewidth=0.0, zorder=0)
        if _room(axes, panel, span) < _CHARACTER * len(span.name):
            continue
        axes.annotate(
            span.name,
            (span.low, 0.99),
            xycoords=('data', 'axes fraction'),
            xytext=(2.0, -2.0),
            textcoords='offset points',
            va='top',
            fontsize=7.0,
            color=MUTED,
        )
    for band in panel.bands:
        handles[band.name] = axes.fill_between(
            panel.x, band.low, band.high, color=band.colour, alpha=0.2, linewidth=0.0
        )
    for series in panel.series:
        handle = _series(axes, panel, series)
        if not series.quiet:
            handles[series.name] = handle
    for rule in panel.rules:
        line = axes.axvline if rule.upright else axes.axhline
        line(rule.at, color=rule.colour, linewidth=0.9, linestyle=_dashes(rule.dashes), zorder=1)
        if rule.name:
            axes.annotate(
                rule.name,
                (rule.at, 0.99) if rule.upright else (0.005, rule.at),
                xycoords=('data', 'axes fraction') if rule.upright else ('axes fraction', 'data'),
                xytext=(3.0, -2.0) if rule.upright else (0.0, 2.0),
                textcoords='offset points',
                va='top' if rule.upright else 'bottom',
                fontsize=7.5,
                color=MUTED,
            )
    _scale(axes.xaxis, x_axis, axes.set_xscale, axes.set_xlim)
    _scale(axes.yaxis, panel.y_axis, axes.set_yscale, axes.set_ylim)
    courses = any(series.kind in ('line', 'steps') for series in panel.series)
    if courses and x_axis.scale == 'linear' and len(panel.x) > 1 and x_axis.low is None:
        axes.set_xlim(panel.x[0], panel.x[-1])
    return handles


def _room(axes: Any, panel: Panel, span: Span) -> float:
    """Return how wide a stretch is on paper, about [in]."""
    width = axes.get_position().width * axes.get_figure().get_figwidth()
    low, high = (float(panel.x[row]) for row in (0, -1)) if len(panel.x) else (0.0, 0.0)
    return width * (span.high - span.low) / (high - low) if high > low else width


def _series(axes: Any, panel: Panel, series: Series) -> Any:
    x = panel.x if series.x is None else series.x
    if series.kind == 'flag':
        return _flag(axes, x, series)
    known, every = np.full(len(x), True), None
    if series.kind == 'dots':
        known = np.isfinite(series.y)
        every = max(1, int(known.sum()) // DOTS_MAX)
    (line,) = axes.plot(
        x[known],
        series.y[known],
        color=series.colour,
        alpha=0.35 if series.quiet else None,
        linewidth=0.7 if series.quiet else series.width,
        linestyle='none' if series.kind == 'dots' else _dashes(series.dashes),
        drawstyle='steps-post' if series.kind == 'steps' else 'default',
        marker='o' if series.kind in ('dots', 'both') else '',
        markersize=_DOT,
        markeredgewidth=0.0,
        markevery=every,
    )
    for place, value, text in zip(x, series.y, series.text, strict=False):
        if text and np.isfinite(value):
            axes.annotate(
                text, (place, value), xytext=(6, 4), textcoords='offset points', color=INK
            )
    return line


def _flag(axes: Any, x: Any, series: Series) -> Any:
    """Draw a bar at the bottom where a series is not 0."""
    # Each sample stands for the time half-way to its neighbours, so that one alone shows too.
    edge = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    change = np.flatnonzero(np.diff(np.concatenate([[0], np.nan_to_num(series.y) != 0, [0]])))
    return axes.broken_barh(
        [(edge[first], edge[last] - edge[first]) for first, last in change.reshape(-1, 2)],
        (0.0, 0.03),
        transform=axes.get_xaxis_transform(),
        color=series.colour,
        linewidth=0.0,
    )


def _scale(axis: Any, shown: Axis, set_scale: Any, set_limits: Any) -> None:
    """Give an axis its scale, ends and marks."""
    if shown.scale == 'symlog':
        set_scale('symlog', linthresh=shown.linear_to, linscale=0.7)
    elif shown.scale == 'log':
        set_scale('log')
    if shown.low is not None or shown.high is not None:
        set_limits(shown.low, shown.high)
    low, high = axis.get_view_interval()
    if shown.ticks:
        ticks = [tick for tick in shown.ticks if low <= tick <= high]
        axis.set_ticks(ticks, [f'{tick:,g}' for tick in ticks])
        axis.set_ticks([], minor=True)
    elif shown.scale == 'log':
        plain_ticks(axis, low, high)
    elif shown.scale == 'symlog':
        axis.set_major_formatter(require('matplotlib.ticker').FuncFormatter(_plain))


def _plain(value: float, _: int) -> str:
    return f'{np.round(value, 6):,g}'


def _dashes(dashes: tuple[float, ...]) -> Any:
    return (0, dashes) if dashes else '-'
