# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Identified model of an axis: tables, sentences, JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from math import isfinite
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.studies.page.html import Remark
from fuzzycnc_ros.studies.page.table import Column, Table

if TYPE_CHECKING:
    from fuzzycnc_ros.core.identify.axis_data import IdentifiedAxis
    from fuzzycnc_ros.core.identify.loop_fit import LoopFit

_MEANING = {
    'gain': ('acceleration at full duty', 'm/s²', 1.0),
    'viscous': ('viscous friction over mass', '1/s', 1.0),
    'viscous_forward': ('viscous friction over mass, forward', '1/s', 1.0),
    'viscous_backward': ('viscous friction over mass, backward', '1/s', 1.0),
    'coulomb': ('Coulomb friction over mass', 'm/s²', 1.0),
    'offset': ('steady deceleration', 'm/s²', 1.0),
    'delay': ('dead time', 'ms', 1e3),
    'position_gain': ('position gain', '1/s', 1.0),
    'velocity_bandwidth': ('velocity bandwidth', 'rad/s', 1.0),
    'feedforward': ('velocity feedforward', '-', 1.0),
}


def axis_fit_table(found: IdentifiedAxis, title: str) -> Table:
    """Return the parameters with their intervals."""
    columns = (
        Column('Parameter', numeric=False),
        Column('value'),
        Column('95 % interval'),
        Column('unit', numeric=False),
    )
    rows = []
    for one in found.fit.parameters:
        meaning, unit, factor = _MEANING[one.name]
        rows.append(
            (
                meaning,
                'unknown' if one.why_not else f'{factor * one.value:.4g}',
                f'{factor * one.low:.4g} to {factor * one.high:.4g}',
                unit,
            )
        )
    linear = found.linear
    if linear is None:
        rows += [('dead time', 'unknown', '', 'ms'), ('lowest resonance', 'unknown', '', 'Hz')]
    else:
        late = linear.late
        rows.append(
            (
                'dead time, with lags',
                f'{500.0 * (late.low + late.high):.3g}' if _told(found) else 'unknown',
                f'{1e3 * late.low:.3g} to {1e3 * late.high:.3g}',
                'ms',
            )
        )
        mode = linear.mode
        rows.append(
            (
                'lowest resonance',
                f'{linear.model.mode:.3g}',
                f'{mode.low:.3g} to {mode.high:.3g}',
                'Hz',
            )
            if linear.resonance_known
            else ('lowest resonance', 'unknown', f'above {mode.low:.3g}', 'Hz')
        )
        rows.append(('response known up to', f'{linear.known_to:.3g}', '', 'Hz'))
    rows.append(('backlash', 'unknown', '', 'µm'))
    return Table(f'{title}: {found.fit.structure}', columns, tuple(rows))


_TOLD, _PERIODS = 4.0, 0.5
"""Ratio of the ends of an interval up to which a dead time is told, and its upper end in periods
up to which it is as good as none."""


def _told(found: IdentifiedAxis) -> bool:
    """Return True if dead time and lags are told."""
    if found.linear is None:
        return False
    late = found.linear.late
    return late.high <= _TOLD * late.low or late.high < _PERIODS * found.period


def axis_fit_remarks(found: IdentifiedAxis, force: float | None) -> list[Remark]:
    """Return how good the model is, what the data cannot tell, and what to record for that."""
    fit, linear, known = found.fit, found.linear, found.data.knowledge
    share = 100.0 * fit.held_out_rms / fit.held_out_span
    lines = [
        Remark(
            f'open loop: {1e3 * fit.rms:.3g} mm rms over the whole recording, '
            f'{1e3 * fit.held_out_rms:.3g} mm on halves that the fit had not seen '
            f'({share:.2g} % of the way)'
        ),
        Remark(f'unexplained: {100.0 * known.unexplained:.2g} % of the acceleration'),
    ]
    rubs = found.friction
    if rubs is not None:
        factors = ', '.join(f'{factor:.2g}' for factor in rubs.factors)
        taken = f'times {rubs.latest:.2g}' if rubs.latest != 1.0 else 'of all recordings'
        lines.append(
            Remark(
                f'friction of each recording over that of all: {factors}; learnt from the one '
                f'before, it takes the open-loop error of the next from {1e3 * rubs.plain:.3g} to '
                f'{1e3 * rubs.learnt:.3g} mm rms; the file has that {taken}'
            )
        )
    if share > 10.0:
        lines.append(
            Remark(
                f'{share:.0f} % of the way is unexplained: nothing holds an open-loop simulation, '
                'but check columns, unit and --reversed',
                warning=True,
            )
        )
    if known.not_fit_for_control:
        lines.append(Remark(f'not fit for control: {known.not_fit_for_control}', warning=True))
    for one in fit.parameters:
        if one.why_not:
            lines.append(Remark(f'{_MEANING[one.name][0]}: {one.why_not}', warning=True))
    if linear is None or not linear.resonance_known:
        lines.append(
            Remark(
                'lowest resonance: the recording moves the axis too little at its frequency, and '
                'what moves by itself says nothing of the drive; the chirp of duties that '
                '`fuzzycnc machine excite --duty` writes would show it',
                warning=True,
            )
        )
    if linear is not None and not _told(found):
        lines.append(
            Remark(
                f'dead time: anything up to {1e3 * linear.delay.high:.2g} ms, which is '
                'allowed for; the chirp of duties that `fuzzycnc machine excite --duty` writes '
                'would show it',
                warning=True,
            )
        )
    lines.append(
        Remark(
            'backlash: duty and position of one sensor do not show it; measure it with a dial '
            'gauge, both ways, and keep the accuracy that you ask for above it'
        )
    )
    if force is None:
        lines.append(
            Remark(
                'mass: unknown without --force, the force at full duty; it is taken as 1 kg, '
                'and forces scale with it'
            )
        )
    return lines


def axis_fit_document(found: IdentifiedAxis) -> dict[str, Any]:
    """Return all figures in SI."""
    fit, linear = found.fit, found.linear
    document: dict[str, Any] = {
        'structure': fit.structure,
        'parameters': fit.parameters,
        'rms': fit.rms,
        'held_out_rms': fit.held_out_rms,
        'structures': fit.trials,
        'friction_by_recording': found.friction and asdict(found.friction),
        'unexplained': found.data.knowledge.unexplained,
        'not_fit_for_control': found.data.knowledge.not_fit_for_control,
        'response': None,
    }
    if linear is not None:
        document['response'] = {
            **asdict(linear.model),
            'known_to': linear.known_to,
            'resonance_known': linear.resonance_known,
            'interval': {
                name: [one.low, one.high if isfinite(one.high) else None]
                for name, one in (
                    ('delay', linear.delay),
                    ('late', linear.late),
                    ('mode', linear.mode),
                )
            },
        }
    return document


def loop_table(loops: Mapping[str, LoopFit]) -> Table:
    """Return the loops of the axes."""
    columns = [Column('Axis', numeric=False)]
    columns += [
        Column(f'{meaning} [{unit}]') for meaning, unit, _ in (_MEANING[name] for name in _LOOP)
    ]
    columns += [Column('contour constant [s²]'), Column('error, unseen half [µm]')]
    rows = []
    for axis, loop in loops.items():
        known = {one.name: one for one in loop.parameters}
        cells = [
            'unknown' if known[name].why_not else f'{_MEANING[name][2] * known[name].value:.4g}'
            for name in _LOOP
        ]
        rows.append(
            (axis, *cells, f'{loop.contour_constant:.4g}', f'{1e6 * loop.held_out_rms:.3g}')
        )
    return Table('How the axes follow', tuple(columns), tuple(rows))


_LOOP = ('position_gain', 'velocity_bandwidth', 'feedforward', 'delay')


def loop_remarks(loops: Mapping[str, LoopFit]) -> list[Remark]:
    """Return what the data cannot tell, and whether the axes follow alike."""
    lines = []
    for axis, loop in loops.items():
        for one in loop.parameters:
            if one.why_not:
                lines.append(
                    Remark(
                        f'{axis}: {_MEANING[one.name][0]}: {one.why_not}; the data show '
                        'the contour constant all the same',
                        warning=True,
                    )
                )
        if loop.contour_constant <= 0.0:
            lines.append(
                Remark(
                    f'{axis}: it overshoots bends: the contour constant is not above 0, and a '
                    'change of feed would not help',
                    warning=True,
                )
            )
    lags = {axis: _lag(loop) for axis, loop in loops.items()}
    if len(lags) > 1:
        apart = max(lags.values()) - min(lags.values())
        if apart > 0.05 * max(lags.values()):
            said = ', '.join(f'{axis} {1e3 * lag:.3g} ms' for axis, lag in lags.items())
            lines.append(
                Remark(
                    f'the axes lag by different times ({said}): circles become ovals, which '
                    'no feed corrects; match the gains',
                    warning=True,
                )
            )
    return lines


def _lag(loop: LoopFit) -> float:
    return (1.0 - loop.feedforward) / loop.position_gain + loop.delay


def loop_document(loops: Mapping[str, LoopFit], constant: Mapping[str, float]) -> dict[str, Any]:
    """Return all figures in SI."""
    return {
        'axes': {
            axis: asdict(loop) | {'contour_constant': loop.contour_constant}
            for axis, loop in loops.items()
        },
        'contour_constant': dict(constant),
    }
