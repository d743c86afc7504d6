# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a comparison of models."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.thermal import comparison as shown
from fuzzycnc_ros.studies.thermal.comparison_plots import plot_residuals, plot_traces
from fuzzycnc_ros.studies.thermal.summary import candidate_label

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
