# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The figures of a report: one table and one document from the same scores."""

from collections.abc import Sequence
from math import inf, isfinite, isnan
from typing import Any

from fuzzycnc_ros.core.thermal.candidate import DRIVES_SUFFIX, SPEED_SUFFIX, UNCOMPENSATED
from fuzzycnc_ros.studies.page.document import to_document
from fuzzycnc_ros.studies.page.table import Column, Table, tied
from fuzzycnc_ros.studies.thermal.report_data import APPLIED, CompensationRun, Score

_LABELS = {
    UNCOMPENSATED: 'Uncompensated',
    'least_squares': 'Static least squares',
    'static_ridge': 'Static ridge',
    'lag_ridge': 'LagRidge',
    'classical_grey': 'Classical GM(1,N)',
    'convolution_grey': 'Convolution GMC(1,N)',
    'optimised_grey': 'Optimised OGM(1,N)',
    'discrete_grey': 'Discrete DGM(1,N)',
    'stable_grey': 'Stable grey model',
    'anfis': 'ANFIS',
    'grey_anfis': 'Stable grey + ANFIS',
    'arma': 'ARMA',
    'static_network': 'Network, static',
    'dynamic_network': 'Network, dynamic',
    'linear_network': 'LR + network',
    'hybrid_network': 'Hybrid filter network',
    'gaussian_process': 'Gaussian process',
    'mlp': 'MLP',
    APPLIED: 'As applied on the machine',
    'unprobed': 'Default, not probed',
    'held': 'Last probe held, no model',
    'learnt': 'Default, learnt from the probes',
}

_LARGEST_SHOWN = 999.9e-6


def candidate_label(name: str) -> str:
    """Return a candidate's name for people: the known label, else its words.

    Examples
    --------
    >>> candidate_label('mlp'), candidate_label('mlp_speed'), candidate_label('best_guess')
    ('MLP', 'MLP with speed', 'Best guess')
    """
    if name.endswith(SPEED_SUFFIX):
        return f'{candidate_label(name.removesuffix(SPEED_SUFFIX))} with speed'
    if name.endswith(DRIVES_SUFFIX):
        return f'{candidate_label(name.removesuffix(DRIVES_SUFFIX))} with drives'
    return _LABELS.get(name) or name.replace('_', ' ').capitalize()


def has_diverged(length: float) -> bool:
    """Return whether a residual [m] is beyond anything that a machine does; NaN is not."""
    return not isnan(length) and not abs(length) <= _LARGEST_SHOWN


def micrometres(length: float) -> str:
    """Show a length [m] as micrometres with one decimal.

    Examples
    --------
    >>> micrometres(2.44e-6), micrometres(float('inf')), micrometres(float('nan'))
    ('2.4', 'diverged', '-')
    """
    if isnan(length):
        return '-'
    if has_diverged(length):
        return 'diverged'
    return f'{1e6 * length:.1f}'


def summary_table(runs: Sequence[CompensationRun]) -> Table:
    """Compare all candidates on all runs: largest and rms residual per channel.

    Parameters
    ----------
    runs : sequence of CompensationRun
        Held-out runs.

    Returns
    -------
    Table
        One row per candidate; the best of each column is strong, for which the uncompensated
        machine competes; the candidate that compensated is highlighted, and warns where it left
        more, in root mean square, than there was without.
    """
    scores = {run.name: run.scores() for run in runs}
    names = list(dict.fromkeys(name for of_run in scores.values() for name in of_run))
    if APPLIED in names:  # what the machine did comes after what could have been done
        names.append(names.pop(names.index(APPLIED)))
    columns, values = [Column('Model', numeric=False)], []
    for run in runs:
        for c, channel in enumerate(run.channel):
            for figure in ('max', 'rms'):
                columns.append(Column(figure, f'{run.name} {channel}'))
                values.append([_figure(scores[run.name].get(name), c, figure) for name in names])
    rows = tuple(
        (candidate_label(name), *(micrometres(column[r]) for column in values))
        for r, name in enumerate(names)
    )
    bare = names.index(UNCOMPENSATED)
    candidates = [r for r, name in enumerate(names) if name != APPLIED]
    strong = set()
    for c, column in enumerate(values):
        best = min(_comparable(column[i]) for i in candidates)
        equal = [r for r in candidates if isfinite(column[r]) and column[r] == best]
        # Who leaves everything as it is has not beaten the machine without compensation.
        strong |= {
            (r, c + 1)
            for r in tied(
                {r: rows[r][c + 1] for r in candidates if r == bare or column[r] != column[bare]},
                [bare] if bare in equal else equal,
            )
        }
    warning: set[tuple[int, int]] = set()
    in_use = [name for run in runs for name in run.default]
    for number, used in enumerate(in_use):
        row, highest, rms = names.index(used), 2 * number, 2 * number + 1
        if values[rms][row] > values[rms][bare]:
            warning |= {(row, 0), (row, rms + 1)}
            if values[highest][row] > values[highest][bare]:
                warning.add((row, highest + 1))
    defaults = set(in_use)
    return Table(
        title='Residual thermal error [µm]',
        columns=tuple(columns),
        rows=rows,
        strong=frozenset(strong),
        highlight=frozenset(r for r, name in enumerate(names) if name in defaults),
        warning=frozenset(warning),
    )


def _figure(scores: tuple[Score, ...] | None, channel: int, figure: str) -> float:
    """Return one figure [m]; NaN where a run does not have the candidate."""
    return float('nan') if scores is None else float(getattr(scores[channel], figure))


def _comparable(value: float) -> float:
    return inf if isnan(value) else value


def summary_document(runs: Sequence[CompensationRun]) -> dict[str, Any]:
    """Return the same figures for a JSON file.

    Parameters
    ----------
    runs : sequence of CompensationRun
        Held-out runs.

    Returns
    -------
    dict
        run -> candidate -> channel in lower case -> `max_um` and `rms_um`; None where it
        diverged or nothing was measured, since JSON knows no infinity.

    Notes
    -----
    `summary_document(runs)['T2']['lag_ridge']['y']` is like `{'max_um': 2.4, 'rms_um': 0.9}`.
    """
    figures = {
        run.name: {
            name: dict(zip(map(str.lower, run.channel), of_channels, strict=True))
            for name, of_channels in run.scores().items()
        }
        for run in runs
    }
    document: dict[str, Any] = to_document(figures)
    return document
