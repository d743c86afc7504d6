# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The report as one self-contained HTML page: no request goes anywhere."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.studies.page.chart import Axis, Band, Chart, Panel, Rule, Series
from fuzzycnc_ros.studies.page.drawing import (
    AFTER,
    ANOTHER,
    BEFORE,
    CLUSTER_COLOURS,
    FAINT,
    LIMIT,
    MEASURED,
    MUTED,
    OTHER,
    WARNING,
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
    """Effect of compensation on one channel of one run, as text."""

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
        temperatures_chart(run),
    )
    yield Figure(
        f'{run.name}: measured and predicted error',
        'Dots are the error without compensation. The model in use (thick) should run through '
        'them, above all where the spindle speed changes. Curves leaving '
        'the plot exceed its range.',
        prediction_chart(run),
    )
    yield Figure(
        f'{run.name}: remaining error',
        f'The blue line is the error {_left_by(run)}, the orange one the error without '
        f'compensation.{_band_text(run)}{_domain_text(run)}',
        residual_chart(run),
    )
    if run.offset is not None:
        yield Figure(
            f'{run.name}: compensation and its limits',
            f'Offsets added to the commanded position; they are minus the predicted error.'
            f'{_limit_text(run)}',
            compensation_chart(run),
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
        f' {100.0 * inside.mean():.0f}\u00a0% of the residuals are within the band of two '
        'standard deviations; about 95\u00a0% would, were the band exact.'
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
        f'{curve.model}, trained anew on so many sensors: largest residual on the held-out run '
        f'{curve.run} against their number. Where the curve turns flat, more sensors add cost '
        'and failures but no accuracy.',
        sensor_count_chart(curve),
    )


def _latency_figure(latency: Latency) -> Figure:
    return Figure(
        'From a temperature sample to its compensation',
        f'{len(latency.sample)} samples, wall-clock time between publishing the temperatures and '
        f'receiving the compensation: median {1e3 * latency.median:.2f} ms, 99th percentile '
        f'{1e3 * latency.p99:.2f} ms, longest {1e3 * latency.sample.max():.2f} ms.',
        latency_chart(latency),
    )


_COMPARED = ('classical_grey', 'static_ridge', 'least_squares')  # first choice for comparison

_ERROR = Axis('thermal error', 'µm')

_DOTTED, _DASHED = (2.0, 2.0), (6.0, 3.0)


def temperatures_chart(run: CompensationRun) -> Chart:
    """Declare the temperatures of each cluster, its chosen sensors in front, and the speed."""
    labels = sorted(set(run.cluster), key=lambda label: (label < 0, label))
    x, unit = time_axis(run.time)
    panels = [_cluster_panel(run, x, label) for label in labels]
    if run.spindle_speed is not None:
        panels.append(_speed_panel(x, run.spindle_speed))
    return Chart(Axis('time', unit), panels, columns=min(3, len(panels)), height=2.0)


def prediction_chart(run: CompensationRun) -> Chart:
    """Declare measured against predicted error, the default model in front."""
    compared = _compared(run)
    predicted = run.prediction()

    def panel(c: int, x: NDArray[np.float64]) -> Panel:
        others = [
            Series(candidate_label(name), 1e6 * run.predicted[name][:, c], colour, width=1.0)
            for name, colour in zip(compared, (OTHER, ANOTHER), strict=False)
        ]
        measured = 1e6 * run.measured[:, c]
        return Panel(
            x,
            _scaled_to(_ERROR, measured),
            [
                *others,
                Series('model in use', 1e6 * predicted[:, c], AFTER, width=2.0),
                Series('measured', measured, MEASURED, kind='dots'),
            ],
            title=f'{run.channel[c]}: {candidate_label(run.default[c])} in use',
        )

    return _by_channel(run, panel)


def residual_chart(run: CompensationRun) -> Chart:
    """Declare the error that is left with its band, the uncompensated error behind it."""
    residual = 1e6 * run.residual()
    before, after = run.scores()[UNCOMPENSATED], run.scores_in_use()

    def panel(c: int, x: NDArray[np.float64]) -> Panel:
        measured = 1e6 * run.measured[:, c]
        bands = []
        if run.standard_deviation is not None:
            width = 2e6 * run.standard_deviation[:, c]
            bands.append(Band('band of two standard deviations', -width, width, AFTER))
        series = [
            Series('before: uncompensated', measured, BEFORE, width=0.9),
            Series('after: residual', residual[:, c], AFTER),
        ]
        if run.in_domain is not None and not run.in_domain.all():
            outside = np.where(run.in_domain, 0.0, 1.0)
            series.append(Series('outside the training domain', outside, WARNING, kind='flag'))
        return Panel(
            x,
            _scaled_to(_ERROR, np.concatenate([measured, residual[:, c]])),
            series,
            title=f'{run.channel[c]}: at most {micrometres(after[c].max)} µm of '
            f'{micrometres(before[c].max)} µm',
            bands=bands,
            rules=[Rule(0.0, MUTED)],
        )

    return _by_channel(run, panel)


def compensation_chart(run: CompensationRun) -> Chart:
    """Declare commanded and applied offsets with their limits.

    Raises
    ------
    ValueError
        If the run has no commanded offsets.
    """
    offset, limit = run.offset, run.offset_limit
    if offset is None:
        raise ValueError(f'run {run.name}: expected commanded offsets but found none')
    rules = [Rule(0.0, MUTED)]
    if limit is not None:
        rules += [
            Rule(1e6 * limit, LIMIT, f'limit ±{1e6 * limit:g} µm', _DASHED),
            Rule(-1e6 * limit, LIMIT, '', _DASHED),
        ]
    bound = None if limit is None else 1.15e6 * limit

    def panel(c: int, x: NDArray[np.float64]) -> Panel:
        series = [Series('commanded', 1e6 * offset[:, c], MEASURED, width=1.0)]
        if run.applied is not None:
            applied = 1e6 * run.applied[:, c]
            series.insert(0, Series('in force on the machine', applied, AFTER, width=3.0))
        axis = Axis('offset', 'µm', low=None if bound is None else -bound, high=bound)
        return Panel(x, axis, series, title=run.channel[c], rules=rules)

    return _by_channel(run, panel)


def sensor_count_chart(curve: SensorCountCurve) -> Chart:
    """Declare the largest residual on a held-out run against the number of sensors."""
    count = np.array(curve.count, dtype=np.float64)
    rules = []
    if curve.chosen_count is not None:
        name = f'in use: {curve.chosen_count}'
        rules.append(Rule(float(curve.chosen_count), MUTED, name, _DOTTED, upright=True))
    series = [
        Series(
            channel,
            1e6 * curve.residual_max[:, c],
            CLUSTER_COLOURS[c % len(CLUSTER_COLOURS)],
            kind='both',
        )
        for c, channel in enumerate(curve.channel)
    ]
    axis = Axis(f'largest residual on {curve.run}', 'µm', low=0.0)
    panel = Panel(count, axis, series, rules=rules)
    return Chart(Axis('number of sensors', ticks=tuple(count)), [panel], height=2.9)


def latency_chart(latency: Latency) -> Chart:
    """Declare the share of samples whose compensation came within a time."""
    milliseconds = 1e3 * np.sort(latency.sample)
    share = 100.0 * np.arange(1, len(milliseconds) + 1) / len(milliseconds)
    rules = [
        Rule(1e3 * value, colour, f'{name} {1e3 * value:.2f} ms', _DASHED, upright=True)
        for name, value, colour in (
            ('median', latency.median, MUTED),
            ('99th percentile', latency.p99, WARNING),
        )
    ]
    series = [Series('compensated within that time', share, AFTER, kind='steps')]
    panel = Panel(
        milliseconds, Axis('share of samples', '%', low=0.0, high=108.0), series, rules=rules
    )
    return Chart(Axis('latency', 'ms', 'log'), [panel], height=2.5)


def _by_channel(run: CompensationRun, panel: Callable[[int, NDArray[np.float64]], Panel]) -> Chart:
    """Return a chart with one panel per channel, two in a row."""
    x, unit = time_axis(run.time)
    count = len(run.channel)
    panels = [panel(c, x) for c in range(count)]
    return Chart(Axis('time', unit), panels, columns=min(2, count), height=2.9)


def _compared(run: CompensationRun) -> list[str]:
    """Return the two candidates drawn beside the model in use."""
    others = [name for name in run.predicted if name not in run.default]
    first = [name for name in _COMPARED if name in others]
    return (first + [name for name in others if name not in first])[:2]


def _cluster_panel(run: CompensationRun, x: NDArray[np.float64], label: int) -> Panel:
    colour = FAINT if label < 0 else CLUSTER_COLOURS[label % len(CLUSTER_COLOURS)]
    members = [name for name, other in zip(run.sensor, run.cluster, strict=True) if other == label]
    chosen = [name for name in members if name in run.chosen]
    series = [
        Series(
            name, run.temperature[:, run.sensor.index(name)], colour, 1.6, quiet=name not in chosen
        )
        for name in sorted(members, key=lambda name: name in chosen)
    ]
    count = f'{len(members)} sensor' + ('s' if len(members) > 1 else '')
    title = f'Cluster {label + 1}: {count}' if label >= 0 else f'Left out: {count}'
    if chosen:
        title += f', {", ".join(chosen)} chosen'
    return Panel(x, Axis('temperature', '°C'), series, title=title)


def _speed_panel(x: NDArray[np.float64], speed: NDArray[np.float64]) -> Panel:
    rpm = speed * 60.0 / (2.0 * np.pi)
    top = 1.15 * max(1.0, float(np.nanmax(rpm, initial=0.0)))
    series = Series('spindle speed', rpm, MEASURED, width=1.2, kind='steps')
    return Panel(x, Axis('speed', 'rpm', low=0.0, high=top), [series], title='Spindle speed')


def _scaled_to(axis: Axis, values: NDArray[np.float64]) -> Axis:
    """Let these values set the ends, so that a diverging curve leaves the picture instead."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return axis
    low, high = min(0.0, float(finite.min())), max(0.0, float(finite.max()))
    margin = 0.15 * (high - low) or 1.0
    return replace(axis, low=low - margin, high=high + margin)
