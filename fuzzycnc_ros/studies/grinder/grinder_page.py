# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page of the comparison on the simulated grinder."""

import numpy as np

from fuzzycnc_ros import __version__
from fuzzycnc_ros.studies.grinder.grinder_comparison import GrinderComparison, TrialResult
from fuzzycnc_ros.studies.grinder.grinder_rivals import RIVALS
from fuzzycnc_ros.studies.page.html import Figure, Page, Section
from fuzzycnc_ros.studies.thermal.comparison import MARK, refusal_line
from fuzzycnc_ros.studies.thermal.comparison_plots import plot_residuals
from fuzzycnc_ros.studies.thermal.summary import candidate_label


def grinder_page(comparison: GrinderComparison) -> Page:
    """Return the page of the comparison, a section per trial."""
    tables = comparison.tables()
    return Page(
        title='Thermal models, compared on a simulated grinder',
        summary='Every model is trained on some runs and judged on others. The grinder is a '
        'simulation: what is fair between the models need not hold for a machine.',
        sections=[
            Section(
                heading=f'Grinder, {result.title}',
                tables=[table],
                remarks=grinder_remarks(result),
                figures=[_bars(result)],
            )
            for table, result in zip(tables, comparison.trials, strict=True)
        ],
        facts={'Noise seed': str(comparison.seed), 'fuzzycnc': __version__},
    )


def grinder_remarks(result: TrialResult) -> list[str]:
    """Return what is wrong with models in a trial, a line each."""
    return [
        refusal_line(name, '; '.join(problems), in_table=name in result.scores)
        for name, problems in result.problems.items()
    ]


def _bars(result: TrialResult) -> Figure:
    columns = list(next(iter(result.scores.values())))
    labels = {rival.name: rival.label for rival in RIVALS}
    seen = [name for name in columns if name.rpartition(' ')[0] in result.trained_on]
    note = f' {", ".join(seen)} are training runs.' if seen else ''
    return Figure(
        f'Grinder, {result.title}: what each model leaves',
        'Bars show the root mean square residual; the shorter, the better. Yellow: not to be '
        f'trusted. A bar that fades across the whole panel has diverged.{note}',
        plot_residuals(
            columns,
            {
                name: np.array([scores[column].rms for column in columns])
                for name, scores in result.scores.items()
            },
            {
                name: (labels.get(name) or candidate_label(name))
                + (MARK if name in result.problems else '')
                for name in result.scores
            },
            refused=result.problems,
        ),
    )
