# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The report as one self-contained HTML page: no script, no request to anywhere."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.thermal import report_plots as plots
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
        plots.plot_temperatures(run),
    )
    yield Figure(
        f'{run.name}: measured and predicted error',
        'Dots are the error without compensation. The model in use (thick) should run through '
        'them, above all where the spindle speed changes. A curve that leaves the frame is off '
        'by more than the frame shows.',
        plots.plot_prediction(run),
    )
    yield Figure(
        f'{run.name}: error that is left',
        f'The blue line is the error {_left_by(run)}, the grey one the error without '
        f'compensation.{_band_text(run)}{_domain_text(run)}',
        plots.plot_residual(run),
    )
    if run.offset is not None:
        yield Figure(
            f'{run.name}: compensation and its limits',
            f'Offsets added to the commanded position; they are minus the predicted error.'
            f'{_limit_text(run)}',
            plots.plot_compensation(run),
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
        plots.plot_sensor_count(curve),
    )


def _latency_figure(latency: Latency) -> Figure:
    return Figure(
        'From a temperature sample to its compensation',
        f'{len(latency.sample)} samples, wall-clock time between publishing the temperatures and '
        f'receiving the compensation: median {1e3 * latency.median:.2f} ms, 99th percentile '
        f'{1e3 * latency.p99:.2f} ms, longest {1e3 * latency.sample.max():.2f} ms.',
        plots.plot_latency(latency),
    )
