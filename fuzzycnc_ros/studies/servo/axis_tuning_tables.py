# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Controllers of an axis after tuning with equal effort: table, sentences, JSON."""

from __future__ import annotations

from dataclasses import asdict
from statistics import median
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.studies.page.html import Remark
from fuzzycnc_ros.studies.page.table import Column, Table

if TYPE_CHECKING:
    from fuzzycnc_ros.simulation.servo.axis_tuning import AxisTuning, TunedController

LABELS = {
    'pid': 'PID with feedforward',
    'cascade': 'P-PI cascade with observer',
    'linear_tangent': 'linear tangent of the rules',
    'variable_universe': 'variable universe',
}
"""Names of the controllers for readers."""


def axis_tuning_table(found: AxisTuning, axis: str) -> Table:
    """Return the controllers, the winner standing out."""
    columns = (
        Column('Controller', numeric=False),
        Column('rms', 'following error [µm]'),
        Column('largest', 'following error [µm]'),
        Column('at rest [µm]'),
        Column('gave up'),
        Column('against the best'),
    )
    rows, warning = [], set()
    for place, one in enumerate(found.controllers):
        whole = [item for item in one.held_out if not item.fault]
        figures = (
            [f'{1e6 * median(getattr(item, name) for item in whole):.3g}' for name in FIGURES]
            if whole
            else ['-'] * len(FIGURES)
        )
        ratio, spread = one.against(found.best)
        against = 'best' if one is found.best else f'x{ratio:.2f} ({spread:.2f})'
        if not one.robust:
            against += ', no margin'
        label = LABELS[one.name]
        if found.controllers[0].trials and not one.trials:
            label += ', untuned'
        rows.append((label, *figures, f'{one.faults} of {len(one.held_out)}', against))
        if one.faults:
            warning.add((place, 4))
        if not one.robust:
            warning.add((place, 5))
    winner = found.controllers.index(found.winner)
    return Table(
        f'{axis}: medians of {len(found.held_out)} cases that nothing was tuned on, after '
        f'{found.controllers[0].trials} trials each; in parentheses the factor of one standard '
        'error',
        columns,
        tuple(rows),
        highlight=frozenset({winner}),
        warning=frozenset(warning),
    )


def axis_trials_table(found: AxisTuning, axis: str) -> Table:
    """Return the best of each kind of controller that was tried on an axis."""
    gains = [case.gain for case in found.held_out]
    rows = tuple(
        (
            LABELS[one.name] + ('' if one.trials else ', as it was'),
            *(f'{1e6 * item.rms:.3g}' for item in one.held_out),
            *(f'{1e6 * item.largest:.3g}' for item in one.held_out),
            f'x{one.against(found.best)[0]:.2f}',
        )
        for one in found.controllers
    )
    columns = (
        Column('Controller', numeric=False),
        *(Column(f'rms x{gain:g}', 'following error [µm]') for gain in gains),
        *(Column(f'largest x{gain:g}', 'following error [µm]') for gain in gains),
        Column('against the best'),
    )
    winner = found.controllers.index(found.winner)
    title = f'{axis}: tried on the axis itself, with factors on the duty'
    return Table(title, columns, rows, highlight=frozenset({winner}))


FIGURES = ('rms', 'largest', 'rest')
"""Figures of a case that are shown."""


def axis_tuning_remarks(found: AxisTuning) -> list[Remark]:
    """Return which controller is recommended on the axis, and by how much."""
    winner, best = found.winner, found.best
    others = [one for one in found.controllers if one is not winner]
    nearest = min(others, key=lambda one: (not one.robust, one.against(winner)[0]))
    ratio, spread = nearest.against(winner)
    told = f'recommended on your axis: {LABELS[winner.name]}'
    if not winner.robust:
        told = 'recommended on your axis: none, as none is stable over all that it may be'
    elif winner is not best:
        told += (
            f'; {LABELS[best.name]} is no better by more than 5 %, and among equals the '
            'simpler one is chosen'
        )
    elif nearest.robust:
        apart = 'beyond chance' if ratio > spread**2 else 'not beyond chance'
        told += (
            f'; {LABELS[nearest.name]} comes next with {100.0 * (ratio - 1.0):.0f} % larger '
            f'errors, {apart}'
        )
    else:
        told += '; no other has a margin on what is unknown of the axis'
    lines = [Remark(told, warning=not winner.robust)]
    lines.append(_fuzzy(found))
    if winner.faults:
        lines.append(
            Remark(
                f'{LABELS[winner.name]} gave up {winner.faults} of {len(found.held_out)} cases: '
                'its limits or loads exceed the drive',
                warning=True,
            )
        )
    return lines


def _fuzzy(found: AxisTuning) -> Remark:
    """Return what the rules are worth beside their own tangent."""
    one: dict[str, TunedController] = {}
    for item in found.controllers:
        one.setdefault(item.name, item)
    ratio, spread = one['linear_tangent'].against(one['variable_universe'])
    if max(ratio, 1.0 / ratio) <= spread**2:
        return Remark('the rules and their linear tangent are equal here, but for chance')
    share = 100.0 * (max(ratio, 1.0 / ratio) - 1.0)
    if ratio > 1.0:
        return Remark(
            f'the rules are better than their tangent, whose errors are {share:.0f} % larger'
        )
    return Remark(
        f'the linear tangent is better than the rules, whose errors are {share:.0f} % larger'
    )


def axis_tuning_document(found: AxisTuning) -> dict[str, Any]:
    """Return all figures in SI."""
    return {
        'winner': found.winner.name,
        'best': found.best.name,
        'cases': found.held_out,
        'controllers': [
            asdict(one) | {'against_best': one.against(found.best)} for one in found.controllers
        ],
    }
