# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Many judged runs in one table: each, their median and the worst of them."""

from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.thermal.candidate import DEFAULT, UNCOMPENSATED
from fuzzycnc_ros.studies.page.table import Column, Table
from fuzzycnc_ros.studies.thermal.comparison import marked_label, row_order
from fuzzycnc_ros.studies.thermal.judged import worse_than_none
from fuzzycnc_ros.studies.thermal.summary import micrometres

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.fit.evaluation import Evaluation
    from fuzzycnc_ros.studies.thermal.probed import ProbedEvaluation

    Residuals = Sequence[Evaluation] | Sequence[ProbedEvaluation]

Floats = NDArray[np.float64]


def runs_table(judged: 'Sequence[Evaluation]') -> Table:
    """Return what the default model left of each run [um], a row per run, median and worst last.

    Where it left more, in root mean square, than there was without compensation its cells warn.

    Parameters
    ----------
    judged : sequence of Evaluation
        Runs of the same channels, one at least.
    """
    columns = [Column('Run', numeric=False), Column('from s'), Column('to s')]
    columns += [Column('samples'), Column('in domain %')]
    first = len(columns)
    for name in judged[0].channel:
        columns += [Column('uncompensated', name), Column('rms', name), Column('max', name)]
    figures = np.array([_figures(item) for item in judged])
    rows = [
        (
            item.run,
            f'{item.time[0]:g}',
            f'{item.time[-1]:g}',
            '/'.join(map(str, dict.fromkeys(item.samples))),
            f'{100.0 * item.in_domain:.0f}',
            *map(micrometres, line),
        )
        for item, line in zip(judged, figures, strict=True)
    ]
    rows.append(('Median', *[''] * (first - 1), *map(micrometres, median_of(figures))))
    rows.append(('Worst', *[''] * (first - 1), *map(micrometres, worst_of(figures))))
    warning = set()
    for row, item in enumerate(judged):
        lost = worse_than_none(item.channel, item.rms)
        # The root mean square stands behind what there was without compensation.
        rms = [first + 3 * item.channel.index(name) + 1 for name in lost]
        warning |= {(row, column) for column in (rms and [0, *rms])}
    return Table(
        f'Residual thermal error of {len(judged)} runs: largest uncompensated, rms and max with '
        'the default model [µm]',
        tuple(columns),
        tuple(rows),
        highlight=frozenset({len(rows) - 2, len(rows) - 1}),
        warning=frozenset(warning),
    )


def overall_table(judged: 'Residuals', refused: Collection[str] = ()) -> Table:
    """Return median and worst of the root mean square and the largest residual, per candidate.

    Parameters
    ----------
    judged : sequence of Evaluation or ProbedEvaluation
        Runs of the same channels, one at least.
    refused : collection of str
        Candidates that are marked.
    """
    columns = [Column('Model', numeric=False)]
    for name in judged[0].channel:
        columns += [
            Column(heading, name)
            for heading in ('median rms', 'worst rms', 'median max', 'worst max')
        ]
    names = _common(judged)
    rows = tuple(
        (
            marked_label(name, refused),
            *(micrometres(value) for each in _overall(judged, name) for value in each),
        )
        for name in names
    )
    highlight = frozenset(row for row, name in enumerate(names) if name == DEFAULT)
    title = f'Over {len(judged)} runs: residual thermal error [µm]'
    return Table(title, tuple(columns), rows, highlight=highlight)


def overall_document(
    judged: 'Residuals',
) -> dict[str, dict[str, dict[str, float]]]:
    """Return candidate -> channel -> `median_rms_um`, `worst_rms_um`, and of the max.

    Candidates that not all runs could be judged with are left out.
    """
    keys = ('median_rms_um', 'worst_rms_um', 'median_max_um', 'worst_max_um')
    return {
        name: {
            channel: dict(zip(keys, (1e6 * float(value) for value in each), strict=True))
            for channel, each in zip(judged[0].channel, _overall(judged, name), strict=True)
        }
        for name in _common(judged)
    }


def median_of(figures: Floats) -> Floats:
    """Return the median over rows; what diverged counts as infinite, NaN not at all."""
    return _over_rows(figures, lambda column: float(np.median(column)))


def worst_of(figures: Floats) -> Floats:
    """Return the largest of all rows; NaN does not count."""
    return _over_rows(figures, lambda column: float(column.max()))


def _over_rows(figures: Floats, what: Callable[[Floats], float]) -> Floats:
    columns = (column[~np.isnan(column)] for column in figures.T)
    return np.array([what(column) if len(column) else np.nan for column in columns])


def _figures(item: 'Evaluation') -> list[float]:
    """Return the cells of a run, channel by channel [m]."""
    parts = (item.largest[UNCOMPENSATED], item.rms[DEFAULT], item.largest[DEFAULT])
    return [float(value) for each in zip(*parts, strict=True) for value in each]


def _common(judged: 'Residuals') -> list[str]:
    """Return the candidates of all runs in the order of tables."""
    every = row_order(judged[0].rms)
    return [name for name in every if all(name in item.rms for item in judged)]


def _overall(judged: 'Residuals', name: str) -> Floats:
    """Return median and worst rms, median and worst largest residual per channel, (c, 4) [m]."""
    rms = np.array([item.rms[name] for item in judged])
    largest = np.array([item.largest[name] for item in judged])
    return np.column_stack([median_of(rms), worst_of(rms), median_of(largest), worst_of(largest)])
