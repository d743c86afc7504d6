# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Models side by side on what they never saw: tables, marks and figures for a document."""

from collections.abc import Collection, Mapping, Sequence
from math import inf, isfinite, isnan
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from fuzzycnc_ros.core.thermal.candidate import COMPARED_ONLY, DEFAULT, UNCOMPENSATED
from fuzzycnc_ros.studies.page.drawing import AFTER, BEFORE, LIMIT, WARNING
from fuzzycnc_ros.studies.page.html import Remark
from fuzzycnc_ros.studies.page.table import Column, Table, tied
from fuzzycnc_ros.studies.thermal.judged import (
    loss_remarks,
    plain_remarks,
    remarks_on,
    run_band_remark,
    training_remark,
    worse_than_none,
    worse_than_plain,
)
from fuzzycnc_ros.studies.thermal.summary import candidate_label, has_diverged, micrometres

if TYPE_CHECKING:
    import numpy as np

    from fuzzycnc_ros.core.thermal.fit.comparison import Comparison, HeldOut
    from fuzzycnc_ros.core.thermal.fit.evaluation import Evaluation

    Figures = Mapping[str, NDArray[np.float64]]

MARK = ' *'
"""Stands behind the label of a candidate that is refused."""

COMPARED_MARK = ' \u2020'
"""Stands behind the label of a candidate that is only compared."""

COMPARED_LINE = f'{COMPARED_MARK.strip()} only compared: it cannot be saved or deployed'
"""Meaning of that mark."""

BARS_MEAN = (
    'the rms, beside the largest of its column; orange without compensation, blue less than '
    'that, red more, yellow not to be trusted'
)
"""Meaning of the bars in a table of residuals."""

LEFT = 'residual thermal error'
"""Caption of a table."""

POOLED = 'All held-out runs'
"""Heading of what is taken over all of them."""


def residual_table(
    title: str,
    channel: Sequence[str],
    rms: 'Figures',
    largest: 'Figures',
    refused: Collection[str] = (),
    in_use: Sequence[str] | None = None,
) -> Table:
    """Return root mean square and largest residual of every row and channel [um].

    Parameters
    ----------
    title : str
        What was judged.
    channel : sequence of str, length c
        Channels.
    rms, largest : mapping of str to ndarray, shape (c,)
        Residuals of 'uncompensated', candidates and 'default' [m].
    refused : collection of str
        Candidates that are marked, and never the best.
    in_use : sequence of str, length c, optional
        Candidate of each channel that is strong, instead of the best of each column.

    Returns
    -------
    Table
        Uncompensated first, which competes for the best too, then what machines can run, what is
        only compared, which does not compete, and the default, highlighted.
        Where what is in use leaves more than there was without compensation its cells warn.
    """
    rows = row_order(rms)
    out = {*refused, *COMPARED_ONLY}
    columns = [Column('Model', numeric=False)]
    for name in channel:
        columns += [Column('rms', name), Column('max', name)]
    cells, strong = [], set()
    for name in rows:
        pairs = zip(rms[name], largest[name], strict=True)
        texts = [micrometres(value) for pair in pairs for value in pair]
        cells.append((marked_label(name, refused), *texts))
    for number in range(len(channel)):
        for offset, figures in enumerate((rms, largest)):
            if in_use is None:
                values = {name: float(figures[name][number]) for name in rows}
                bare = values.get(UNCOMPENSATED)
                competing = {
                    name: micrometres(value)
                    for name, value in values.items()
                    if name not in out and (name == UNCOMPENSATED or value != bare)
                }
                chosen = tied(competing, best_of(values, out))
            else:
                chosen = [in_use[number]]
            strong |= {(rows.index(name), 1 + 2 * number + offset) for name in chosen}
    warning = set()
    for number, label in enumerate(channel):
        used = DEFAULT if in_use is None else in_use[number]
        if used in rms and UNCOMPENSATED in rms and label in worse_than_none(channel, rms, used):
            row, column = rows.index(used), 1 + 2 * number
            warning |= {(row, 0), (row, column)}
            if largest[used][number] > largest[UNCOMPENSATED][number]:
                warning.add((row, column + 1))
    return Table(
        f'{title} [µm]',
        tuple(columns),
        tuple(cells),
        strong=frozenset(strong),
        warning=frozenset(warning),
        highlight=frozenset(row for row, name in enumerate(rows) if name == DEFAULT),
        bars=rms_bars({name: rms[name] for name in rows}, refused, range(1, 2 * len(channel), 2)),
        bars_mean=BARS_MEAN,
    )


def rms_bars(
    rms: Mapping[str, Sequence[float] | NDArray[Any]],
    refused: Collection[str],
    columns: Sequence[int],
) -> dict[tuple[int, int], tuple[float, str]]:
    """Return the bars of a table of residuals.

    Parameters
    ----------
    rms : mapping of str to sequence of float, length c
        Residuals [m] of each row of the table, in their order.
    refused : collection of str
        Rows that are not to be trusted.
    columns : sequence of int, length c
        Columns of the table that hold them.
    """
    bars = {}
    for number, column in enumerate(columns):
        values = {name: float(found[number]) for name, found in rms.items()}
        bare = values.get(UNCOMPENSATED, inf)
        top = max((value for value in values.values() if not _lost(value)), default=1.0)
        for row, (name, value) in enumerate(values.items()):
            if isnan(value):
                continue
            colour = LIMIT if value > bare else AFTER
            if value == bare:
                colour = BEFORE
            elif name in refused:
                colour = WARNING
            bars[row, column] = (1.0 if _lost(value) else value / (top or 1.0), colour)
    return bars


def _lost(value: float) -> bool:
    return isnan(value) or has_diverged(value)


def marked_label(name: str, refused: Collection[str]) -> str:
    """Return a candidate's label, marked if it is refused or only compared."""
    compared = COMPARED_MARK if name in COMPARED_ONLY else ''
    return candidate_label(name) + compared + (MARK if name in refused else '')


def best_of(figures: Mapping[str, float], refused: Collection[str] = ()) -> list[str]:
    """Return the candidates with the least figure, more than one if they are equal.

    The uncompensated machine competes, the automatic choice, which is one of them, does not, and
    nothing that is refused.
    """
    competing = {
        name: value
        for name, value in figures.items()
        if _competes(name, refused) and isfinite(value)
    }
    least = min(competing.values(), default=inf)
    best = [name for name, value in competing.items() if value == least]
    # Who leaves everything as it is has not beaten the machine without compensation.
    return [UNCOMPENSATED] if UNCOMPENSATED in best else best


def refused_on(item: 'HeldOut') -> dict[str, str]:
    """Return the candidates that do not count on a held-out run, and why.

    Those that training refused or could not fit, and those that diverged on the run.
    """
    found = dict(item.refused)
    for name, values in item.evaluation.largest.items():
        if name != UNCOMPENSATED and _competes(name, found) and any(map(has_diverged, values)):
            found[name] = 'its prediction diverged'
    return found


def refused_anywhere(comparison: 'Comparison') -> dict[str, dict[str, str]]:
    """Return candidate -> held-out run -> why it is refused there."""
    found: dict[str, dict[str, str]] = {}
    for item in comparison.held_out:
        for name, reason in refused_on(item).items():
            found.setdefault(name, {})[item.evaluation.run] = reason
    return found


def best_candidates(
    comparison: 'Comparison', without: Collection[str] = COMPARED_ONLY
) -> dict[str, str | None]:
    """Return the candidate of each channel with the least rms over all held-out samples.

    It is the uncompensated machine where no candidate that is trusted on every run beats it; None
    where nothing was measured.

    Parameters
    ----------
    comparison : Comparison
        What was held out.
    without : collection of str
        Candidates that do not compete: those that no machine runs, by default.
    """
    rms, refused = comparison.rms(), {*refused_anywhere(comparison), *without}
    best = {}
    for number, channel in enumerate(comparison.channel):
        found = best_of({name: float(values[number]) for name, values in rms.items()}, refused)
        best[channel] = found[0] if found else None
    return best


def best_lines(comparison: 'Comparison') -> list[str]:
    """Return the best candidate that a machine can run, and what is better but only compared."""
    lines = [f'best candidate: {by_channel(best_candidates(comparison))}']
    rms, ours = comparison.rms(), best_candidates(comparison)
    better = []
    for number, (channel, name) in enumerate(best_candidates(comparison, ()).items()):
        if name not in COMPARED_ONLY:
            continue
        left = micrometres(rms[name][number])
        own = micrometres(rms[ours[channel] or UNCOMPENSATED][number])
        if left != own:
            better.append(
                f'{candidate_label(name)} on {channel}, {left} \u00b5m instead of {own} \u00b5m'
            )
    if better:
        lines.append(f'better, but only compared, as no machine runs it: {"; ".join(better)}')
    return lines


def held_out_table(item: 'HeldOut') -> Table:
    """Return the table of one held-out run."""
    judged = item.evaluation
    return residual_table(
        f'{judged.run}: {LEFT}',
        judged.channel,
        judged.rms,
        judged.largest,
        refused_on(item),
    )


def pooled_table(comparison: 'Comparison') -> Table:
    """Return the table of all held-out samples together."""
    return residual_table(
        f'{POOLED}: {LEFT}',
        comparison.channel,
        comparison.rms(),
        comparison.largest(),
        refused_anywhere(comparison),
    )


def choice_text(item: 'HeldOut') -> str:
    """Return what the automatic choice was, without having seen the run."""
    judged = item.evaluation
    return by_channel(dict(zip(judged.channel, judged.default, strict=True)))


def by_channel(chosen: Mapping[str, str | None]) -> str:
    """Return which candidate each channel has; one name if all have the same.

    Examples
    --------
    >>> by_channel({'X': 'mlp', 'Y': 'mlp'}), by_channel({'X': 'mlp', 'Y': 'arma', 'Z': 'mlp'})
    ('MLP', 'MLP (X, Z), ARMA (Y)')
    >>> by_channel({'X': 'mlp', 'Y': 'uncompensated'})
    'MLP (X), none (Y)'
    """
    channels: dict[str, list[str]] = {}
    for channel, name in chosen.items():
        label = 'none' if name in (None, UNCOMPENSATED) else candidate_label(name)
        channels.setdefault(label, []).append(channel)
    if len(channels) == 1:
        return next(iter(channels))
    return ', '.join(f'{label} ({", ".join(members)})' for label, members in channels.items())


def held_out_remarks(item: 'HeldOut') -> list[Remark]:
    """Return what a reader of a held-out run has to know."""
    judged = item.evaluation
    remarks = remarks_on(judged, run_band_remark(judged), refused_on(item))
    if judged.trained_on:
        # A copy of the run was trained on under another name.
        remarks.insert(1, training_remark(judged.run, judged.trained_on, True, ()))
    return remarks


def pooled_remarks(comparison: 'Comparison') -> list[Remark]:
    """Return where the default is worse than none, or plain, over all held-out samples."""
    refused = refused_anywhere(comparison)
    return [
        *loss_remarks(POOLED, comparison.channel, comparison.rms()),
        *plain_remarks(POOLED, comparison.channel, comparison.rms(), refused),
    ]


def refusal_lines(item: 'HeldOut') -> list[str]:
    """Return why candidates are marked in the table of a held-out run, a line each."""
    return [
        refusal_line(name, reason, in_table=name in item.evaluation.rms)
        for name, reason in refused_on(item).items()
    ]


def refusal_line(name: str, reason: str, *, in_table: bool) -> str:
    """Return why a candidate is refused; one that was fitted is in the table, and marked."""
    verdict = 'is not to be trusted' if in_table else 'was left out'
    return f'{candidate_label(name)} {verdict}: {reason}'


def pooled_refusal_lines(comparison: 'Comparison') -> list[str]:
    """Return on which runs candidates were refused, a line each."""
    count, in_table = len(comparison.held_out), comparison.names
    return [
        refusal_line(
            name,
            f'refused on {len(runs)} of {count} held-out runs, {", ".join(runs)}',
            in_table=name in in_table,
        )
        for name, runs in refused_anywhere(comparison).items()
    ]


def residual_document(
    channel: Sequence[str], rms: 'Figures', largest: 'Figures'
) -> dict[str, dict[str, dict[str, float]]]:
    """Return row -> channel -> `rms_um` and `max_um`; infinite where it diverged."""
    return {
        name: {
            label: {'rms_um': 1e6 * float(root), 'max_um': 1e6 * float(most)}
            for label, root, most in zip(channel, rms[name], largest[name], strict=True)
        }
        for name in rms
    }


def judged_document(judged: 'Evaluation') -> dict[str, Any]:
    """Return what was judged and how far the model knew it.

    Returns
    -------
    dict
        `window_s`: first and last time; `samples`, `covered`, `half_width_um`, the number of
        `independent` residuals and their `band_ratio`: by channel; `false_band`: channels whose
        band holds far less;
        `in_domain`; `warm_K`: sensor -> difference to a cold start; `trained_on`: training run ->
        share of the judged samples; `worse_than_none`: channels in which the default leaves more
        than no compensation.
    """
    names = judged.channel
    return {
        'window_s': [float(judged.time[0]), float(judged.time[-1])],
        'samples': dict(zip(names, judged.samples, strict=True)),
        'in_domain': judged.in_domain,
        'warm_K': dict(judged.warm),
        'trained_on': dict(judged.trained_on),
        'covered': dict(zip(names, judged.covered, strict=True)),
        'half_width_um': dict(zip(names, 1e6 * judged.half_width, strict=True)),
        'independent': dict(zip(names, judged.independent, strict=True)),
        'band_ratio': dict(zip(names, judged.band_ratio, strict=True)),
        'false_band': list(judged.false_band()),
        'worse_than_none': worse_than_none(names, judged.rms),
    }


def comparison_document(comparison: 'Comparison') -> dict[str, Any]:
    """Return all figures of a comparison.

    Returns
    -------
    dict
        `held_out`: run -> what `judged_document` returns, `default`, `inputs`, `figures`,
        `refused`; `pooled`: candidate -> channel -> figures; `best`: channel -> candidate
        that a machine can run, 'uncompensated' where none beats it; `best_compared`: the same of
        all; `worse_than_plain`: channels in which the default leaves much more than plain least
        squares; `worse_than_none`: channels in which the default
        leaves more than no compensation, over all of them; `refused`: candidate -> run -> why.
    """
    return {
        'held_out': {
            item.evaluation.run: {
                **judged_document(item.evaluation),
                'default': dict(
                    zip(item.evaluation.channel, item.evaluation.default, strict=True)
                ),
                'inputs': list(item.inputs),
                'figures': residual_document(
                    item.evaluation.channel, item.evaluation.rms, item.evaluation.largest
                ),
                'refused': refused_on(item),
            }
            for item in comparison.held_out
        },
        'pooled': residual_document(comparison.channel, comparison.rms(), comparison.largest()),
        'best': best_candidates(comparison),
        'best_compared': best_candidates(comparison, ()),
        'worse_than_plain': list(
            worse_than_plain(comparison.channel, comparison.rms(), refused_anywhere(comparison))
        ),
        'worse_than_none': worse_than_none(comparison.channel, comparison.rms()),
        'refused': refused_anywhere(comparison),
    }


def row_order(rms: 'Figures') -> list[str]:
    """Return the rows of a table: uncompensated, candidates, what is only compared, default."""
    between = [name for name in rms if name not in (UNCOMPENSATED, DEFAULT)]
    between.sort(key=lambda name: name in COMPARED_ONLY)
    ends = [name for name in (UNCOMPENSATED, DEFAULT) if name in rms]
    return [*ends[:1], *between, *ends[1:]]


def _competes(name: str, refused: Collection[str]) -> bool:
    return name != DEFAULT and name not in refused
