# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The report as one self-contained HTML page: no script, no request to anywhere."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.studies.page.drawing import (
    ACCENT,
    CLUSTER_COLOURS,
    FAINT,
    INK,
    MUTED,
    SECOND,
    THIRD,
    WARNING,
    add_legend,
    new_figure,
    panel_grid,
    plot_style,
    time_axis,
)
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.thermal.report_data import (
    CompensationRun,
    Latency,
    ReportData,
    Score,
    SensorCountCurve,
)
from fuzzycnc_ros.studies.thermal.summary import candidate_label, micrometres, summary_table


@dataclass(frozen=True)
class _KeyFigure:
    """What compensation made of one channel of one run, as text."""

    label: str
    before: str
    after: str
    rms: str
    remaining: str
    worse: bool


def report_page(data: ReportData) -> Page:
    """Return the page of a report.

    Parameters
    ----------
    data : ReportData
        Runs, curves, latency and facts.
    """
    return Page(
        title=data.title,
        summary=data.summary,
        sections=_sections(data),
        facts=data.facts,
        notes=data.notes,
        template='report.html',
        values={
            'judged': data.judged,
            'key_figures': [figure for run in data.runs for figure in _key_figures(run)],
            'table': summary_table(data.runs),
            'default_labels': ', '.join(
                dict.fromkeys(candidate_label(name) for run in data.runs for name in run.default)
            ),
        },
    )


def _key_figures(run: CompensationRun) -> Iterator[_KeyFigure]:
    scores = run.scores()
    before_and_after = zip(scores[UNCOMPENSATED], run.scores_in_use(), strict=True)
    for channel, (before, after) in zip(run.channel, before_and_after, strict=True):
        yield _KeyFigure(
            label=f'{run.name} {channel}',
            before=micrometres(before.max),
            after=micrometres(after.max),
            rms=micrometres(after.rms),
            remaining=_remaining(before, after),
            worse=after.rms > before.rms,
        )


def _remaining(before: Score, after: Score) -> str:
    if not (np.isfinite(after.max) and before.max > 0.0):
        return ''
    return f'{100.0 * after.max / before.max:.0f}\u00a0%'


def _sections(data: ReportData) -> list[Section]:
    """Draw all figures, by section."""
    sections = [Section(f'Run {run.name}', figures=[*_run_figures(run)]) for run in data.runs]
    sections += data.sections
    general = []
    if data.sensor_count_curve is not None:
        general.append(_sensor_count_figure(data.sensor_count_curve))
    if data.latency is not None:
        general.append(_latency_figure(data.latency))
    if general:
        sections.append(Section('Sensors and latency', figures=general))
    return sections


def _run_figures(run: CompensationRun) -> Iterator[Figure]:
    """Yield the figures of a run."""
    yield Figure(
        f'{run.name}: temperatures by cluster',
        f'All {len(run.sensor)} sensors, one panel per cluster, each with its own scale; the '
        f'{len(run.chosen)} chosen ones, which the model reads, are drawn thick. The lines of a '
        'panel should move together: then the chosen sensor speaks for its cluster, and a '
        'neighbour can stand in for it when it fails.',
        plot_temperatures(run),
    )
    yield Figure(
        f'{run.name}: measured and predicted error',
        'Dots are the error without compensation. The model in use (thick) should run through '
        'them, above all where the spindle speed changes. A curve that leaves the frame is off '
        'by more than the frame shows.',
        plot_prediction(run),
    )
    yield Figure(
        f'{run.name}: error that is left',
        f'The blue line is the error {_left_by(run)}, the grey one the error without '
        f'compensation.{_band_text(run)}{_domain_text(run)}',
        plot_residual(run),
    )
    if run.offset is not None:
        yield Figure(
            f'{run.name}: compensation and its limits',
            f'Offsets added to the commanded position; they are minus the predicted error.'
            f'{_limit_text(run)}',
            plot_compensation(run),
        )


def _left_by(run: CompensationRun) -> str:
    if run.applied is None:
        return 'left by the prediction'
    return 'left by the offsets in force on the machine'


def _band_text(run: CompensationRun) -> str:
    """Say how much of the residual lies in the band, so that the band can be judged."""
    if run.standard_deviation is None:
        return ''
    residual = run.residual()
    judged = np.isfinite(residual) & np.isfinite(run.standard_deviation)
    if not judged.any():
        return ''
    inside = np.abs(residual[judged]) <= 2.0 * run.standard_deviation[judged]
    return (
        f' {100.0 * inside.mean():.0f}\u00a0% of what is left lies in the band of two standard '
        'deviations; about 95\u00a0% would, were the band exact.'
    )


def _domain_text(run: CompensationRun) -> str:
    if run.in_domain is None:
        return ''
    outside = 1.0 - float(run.in_domain.mean())
    if outside == 0.0:
        return ' All samples lie within the training domain.'
    return (
        f' The bar at the bottom marks the {100.0 * outside:.0f}\u00a0% of samples outside the '
        'training domain, where the band is widened.'
    )


def _limit_text(run: CompensationRun) -> str:
    if run.offset is None or not np.isfinite(run.offset).any():
        return ''
    largest = float(np.nanmax(np.abs(run.offset)))
    text = f' The largest is {micrometres(largest)} µm'
    if run.offset_limit is None:
        return text + '.'
    if largest < run.offset_limit * (1.0 - 1e-9):
        return text + f', {100.0 * largest / run.offset_limit:.0f}\u00a0% of the limit (dashed).'
    at_limit = np.abs(run.offset) >= run.offset_limit * (1.0 - 1e-9)
    share = 100.0 * float(at_limit.any(axis=1).mean())
    return text + f': the limit (dashed) cut it in {share:.0f}\u00a0% of the samples.'


def _sensor_count_figure(curve: SensorCountCurve) -> Figure:
    return Figure(
        'How many sensors are worth having',
        f'Largest residual on the held-out run {curve.run} against the number of sensors that '
        'the model reads. Where the curve turns flat, more sensors add cost and failures but no '
        'accuracy.',
        plot_sensor_count(curve),
    )


def _latency_figure(latency: Latency) -> Figure:
    return Figure(
        'From a temperature sample to its compensation',
        f'{len(latency.sample)} samples, wall-clock time between publishing the temperatures and '
        f'receiving the compensation: median {1e3 * latency.median:.2f} ms, 99th percentile '
        f'{1e3 * latency.p99:.2f} ms, longest {1e3 * latency.sample.max():.2f} ms.',
        plot_latency(latency),
    )


_BACKGROUND_ROWS = 160  # rows of a line that only gives the picture its background
_DOTS = 140  # measured points that are drawn as dots
_COMPARED = ('classical_grey', 'static_ridge', 'least_squares')  # first choice for comparison


def plot_temperatures(run: CompensationRun) -> Any:
    """Plot the temperatures of each cluster, its chosen sensors in front, and the speed."""
    with plot_style():
        labels = sorted(set(run.cluster), key=lambda label: (label < 0, label))
        has_speed = run.spindle_speed is not None
        figure, panels = panel_grid(len(labels) + has_speed, columns=3, height=2.0)
        x, x_label = time_axis(run.time)
        for axes, label in zip(panels, labels, strict=False):
            _draw_cluster(axes, run, x, label)
            first = axes.get_subplotspec().is_first_col()
            _label_axes(axes, x, x_label, 'temperature [°C]' if first else '')
        if run.spindle_speed is not None:
            _draw_speed(panels[-1], x, run.spindle_speed)
            _label_axes(panels[-1], x, x_label, 'speed [rpm]')
        return figure


def plot_prediction(run: CompensationRun) -> Any:
    """Plot measured against predicted error, the default model in front."""
    with plot_style():
        figure, panels = _channel_panels(run)
        x, x_label = time_axis(run.time)
        every = max(1, len(x) // _DOTS)
        compared = _compared(run)
        predicted = 1e6 * run.prediction()
        for c, axes in enumerate(panels):
            measured = 1e6 * run.measured[:, c]
            axes.set_title(f'{run.channel[c]}: {candidate_label(run.default[c])} in use')
            for name, colour in zip(compared, (SECOND, THIRD), strict=False):
                axes.plot(
                    x,
                    1e6 * run.predicted[name][:, c],
                    color=colour,
                    linewidth=1.0,
                    label=candidate_label(name),
                )
            axes.plot(
                x,
                predicted[:, c],
                color=ACCENT,
                linewidth=2.0,
                label='model in use',
            )
            axes.plot(
                x[::every],
                measured[::every],
                linestyle='none',
                marker='o',
                markersize=2.2,
                markeredgewidth=0.0,
                color=INK,
                label='measured',
            )
            _label_axes(axes, x, x_label, 'thermal error [µm]')
            _limit_to(axes, measured)
        handles, labels = panels[0].get_legend_handles_labels()
        add_legend(figure, handles[::-1], labels[::-1])  # what is drawn in front comes first
        return figure


def plot_residual(run: CompensationRun) -> Any:
    """Plot the error that is left with its band, the uncompensated error thin behind it."""
    with plot_style():
        figure, panels = _channel_panels(run)
        x, x_label = time_axis(run.time)
        residual = 1e6 * run.residual()
        before, after = run.scores()[UNCOMPENSATED], run.scores_in_use()
        for c, axes in enumerate(panels):
            measured = 1e6 * run.measured[:, c]
            axes.plot(x, measured, color=FAINT, linewidth=0.9, label='uncompensated')
            if run.standard_deviation is not None:
                band = 2e6 * run.standard_deviation[:, c]
                axes.fill_between(
                    x,
                    -band,
                    band,
                    color=ACCENT,
                    alpha=0.2,
                    linewidth=0.0,
                    label='band of the model (±2 standard deviations)',
                )
            axes.axhline(0.0, color=MUTED, linewidth=0.7)
            axes.plot(x, residual[:, c], color=ACCENT, linewidth=1.3, label='residual')
            _label_axes(axes, x, x_label, 'thermal error [µm]')
            _limit_to(axes, np.concatenate([measured, residual[:, c]]))
            _shade_out_of_domain(axes, x, run.in_domain)
            axes.set_title(
                f'{run.channel[c]}: at most {micrometres(after[c].max)} µm left of '
                f'{micrometres(before[c].max)} µm'
            )
        add_legend(figure, *panels[0].get_legend_handles_labels())
        return figure


def plot_compensation(run: CompensationRun) -> Any:
    """Plot commanded and applied offsets with their limits.

    Raises
    ------
    ValueError
        If the run has no commanded offsets.
    """
    if run.offset is None:
        raise ValueError(f'run {run.name}: expected commanded offsets but found none')
    with plot_style():
        figure, panels = _channel_panels(run)
        x, x_label = time_axis(run.time)
        for c, axes in enumerate(panels):
            if run.offset_limit is not None:
                limit = 1e6 * run.offset_limit
                for side, label in ((limit, f'limit ±{limit:g} µm'), (-limit, None)):
                    axes.axhline(side, color=WARNING, linestyle=(0, (5, 3)), label=label)
            axes.axhline(0.0, color=MUTED, linewidth=0.7)
            if run.applied is not None:
                axes.plot(
                    x,
                    1e6 * run.applied[:, c],
                    color=ACCENT,
                    linewidth=3.0,
                    alpha=0.45,
                    label='in force on the machine',
                )
            axes.plot(x, 1e6 * run.offset[:, c], color=INK, linewidth=1.0, label='commanded')
            _label_axes(axes, x, x_label, 'offset [µm]')
        add_legend(figure, *panels[0].get_legend_handles_labels())
        return figure


def plot_sensor_count(curve: SensorCountCurve) -> Any:
    """Plot the largest residual on a held-out run against the number of sensors."""
    with plot_style():
        figure = new_figure(2.9)
        axes = figure.subplots()
        colours = (ACCENT, SECOND, *CLUSTER_COLOURS[2:])
        for c, channel in enumerate(curve.channel):
            axes.plot(
                curve.count,
                1e6 * curve.residual_max[:, c],
                color=colours[c % len(colours)],
                marker='o',
                markersize=4.5,
                label=channel,
            )
        if curve.chosen_count is not None:
            axes.axvline(
                curve.chosen_count,
                color=MUTED,
                linestyle=(0, (2, 2)),
                linewidth=0.9,
                label=f'in use: {curve.chosen_count}',
            )
        axes.set_xticks(curve.count)
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel('number of sensors')
        axes.set_ylabel(f'largest residual on {curve.run} [µm]')
        add_legend(figure, *axes.get_legend_handles_labels())
        return figure


def plot_latency(latency: Latency) -> Any:
    """Plot how long it took from a temperature sample to its compensation."""
    with plot_style():
        figure = new_figure(2.5)
        axes = figure.subplots()
        milliseconds = 1e3 * latency.sample
        # One straggler must not squeeze all others into a single bar.
        edge = max(1.5e3 * latency.p99, float(milliseconds.min()) + 1e-3)
        axes.hist(
            np.minimum(milliseconds, edge),
            bins=np.linspace(0.0, edge, 61),
            color=ACCENT,
            alpha=0.55,
        )
        for value, label, colour in (
            (latency.median, 'median', INK),
            (latency.p99, '99th percentile', WARNING),
        ):
            axes.axvline(1e3 * value, color=colour, label=f'{label} {1e3 * value:.2f} ms')
        axes.set_xlim(0.0, edge)
        axes.set_xlabel('latency [ms]; the last bar holds all that is longer')
        axes.set_ylabel('samples')
        axes.grid(visible=False, axis='x')
        add_legend(figure, *axes.get_legend_handles_labels())
        return figure


def _channel_panels(run: CompensationRun) -> tuple[Any, list[Any]]:
    """Return a figure with one titled panel per channel, two in a row."""
    count = len(run.channel)
    figure, panels = panel_grid(count, columns=min(2, count), height=2.9)
    for axes, channel in zip(panels, run.channel, strict=True):
        axes.set_title(channel)
    return figure, panels


def _compared(run: CompensationRun) -> list[str]:
    """Return the two candidates drawn beside the model in use."""
    others = [name for name in run.predicted if name not in run.default]
    first = [name for name in _COMPARED if name in others]
    return (first + [name for name in others if name not in first])[:2]


def _cluster_colour(label: int) -> str:
    return FAINT if label < 0 else CLUSTER_COLOURS[label % len(CLUSTER_COLOURS)]


def _draw_cluster(axes: Any, run: CompensationRun, x: NDArray[np.float64], label: int) -> None:
    colour = _cluster_colour(label)
    thin = slice(None, None, max(1, len(x) // _BACKGROUND_ROWS))
    members = [name for name, other in zip(run.sensor, run.cluster, strict=True) if other == label]
    chosen = [name for name in members if name in run.chosen]
    for name in members:
        values = run.temperature[:, run.sensor.index(name)]
        if name in chosen:
            axes.plot(x, values, color=colour, linewidth=1.6, zorder=3)
        else:
            axes.plot(x[thin], values[thin], color=colour, linewidth=0.7, alpha=0.35)
    count = f'{len(members)} sensor' + ('s' if len(members) > 1 else '')
    title = f'Cluster {label + 1}: {count}' if label >= 0 else f'Left out: {count}'
    axes.set_title(f'{title}, {", ".join(chosen)} chosen' if chosen else title)


def _draw_speed(axes: Any, x: NDArray[np.float64], speed: NDArray[np.float64]) -> None:
    rpm = speed * 60.0 / (2.0 * np.pi)
    axes.fill_between(x, 0.0, rpm, step='post', color=MUTED, alpha=0.2, linewidth=0.0)
    axes.step(x, rpm, where='post', color=MUTED, linewidth=1.2)
    axes.set_ylim(0.0, 1.15 * max(1.0, float(np.nanmax(rpm, initial=0.0))))
    axes.set_title('Spindle speed')


def _label_axes(axes: Any, x: NDArray[np.float64], x_label: str, y_label: str) -> None:
    axes.set_xlim(x[0], x[-1])
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.margins(y=0.08)


def _limit_to(axes: Any, values: NDArray[np.float64]) -> None:
    """Let these values set the scale, so that a diverging curve leaves the picture instead."""
    finite = values[np.isfinite(values)]
    if finite.size:
        low, high = min(0.0, float(finite.min())), max(0.0, float(finite.max()))
        margin = 0.15 * (high - low) or 1.0
        axes.set_ylim(low - margin, high + margin)


def _shade_out_of_domain(
    axes: Any, x: NDArray[np.float64], in_domain: NDArray[np.bool_] | None
) -> None:
    if in_domain is None or in_domain.all():
        return
    # Each sample stands for the time half-way to its neighbours, so that one alone shows too.
    edge = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    change = np.flatnonzero(np.diff(np.concatenate([[0], ~in_domain, [0]])))
    axes.broken_barh(
        [(edge[first], edge[last] - edge[first]) for first, last in change.reshape(-1, 2)],
        (0.0, 0.03),
        transform=axes.get_xaxis_transform(),
        color=WARNING,
        linewidth=0.0,
        label='outside the training domain',
    )
