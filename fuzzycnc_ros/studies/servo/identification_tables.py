# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What was identified from a recording: tables, sentences, JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from math import isfinite
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.studies.page.html import Remark
from fuzzycnc_ros.studies.page.table import Column, Table

if TYPE_CHECKING:
    from fuzzycnc_ros.core.identify.axis_fit import AxisFit
    from fuzzycnc_ros.core.identify.frequency import FrequencyResponse
    from fuzzycnc_ros.core.identify.loop_fit import LoopFit

_MEANING = {
    'gain': ('acceleration at full duty', 'm/s²', 1.0),
    'viscous': ('viscous friction over mass', '1/s', 1.0),
    'viscous_forward': ('viscous friction over mass, forward', '1/s', 1.0),
    'viscous_backward': ('viscous friction over mass, backward', '1/s', 1.0),
    'coulomb': ('Coulomb friction over mass', 'm/s²', 1.0),
    'offset': ('steady deceleration', 'm/s²', 1.0),
    'delay': ('dead time', 'ms', 1e3),
    'drive_lag': ('lag of the drive', 'ms', 1e3),
    'position_gain': ('position gain', '1/s', 1.0),
    'velocity_bandwidth': ('velocity bandwidth', 'rad/s', 1.0),
    'feedforward': ('velocity feedforward', '-', 1.0),
}


def axis_fit_table(
    fit: AxisFit, response: FrequencyResponse, dead_time: tuple[float, str], axis: str
) -> Table:
    """Return the parameters with their intervals."""
    columns = (
        Column('Parameter', numeric=False),
        Column('value'),
        Column('95 % interval'),
        Column('unit', numeric=False),
    )
    rows = []
    for one in fit.parameters:
        meaning, unit, factor = _MEANING[one.name]
        rows.append(
            (
                meaning,
                'cannot be told' if one.why_not else f'{factor * one.value:.4g}',
                f'{factor * one.low:.4g} to {factor * one.high:.4g}',
                unit,
            )
        )
    delay, source = dead_time
    if source == 'phase':
        _, error = response.dead_time
        rows.append(
            (
                'dead time, by the phase',
                f'{1e3 * delay:.3g}',
                f'{1e3 * (delay - 2.0 * error):.3g} to {1e3 * (delay + 2.0 * error):.3g}',
                'ms',
            )
        )
    resonance = response.resonance
    rows.append(('lowest resonance', f'{resonance:.0f}' if resonance else 'none seen', '', 'Hz'))
    return Table(f'{axis}: {fit.structure}', columns, tuple(rows))


def axis_fit_remarks(
    fit: AxisFit, response: FrequencyResponse, force: float | None
) -> list[Remark]:
    """Return how good the model is, and what the data cannot tell."""
    share = 100.0 * fit.held_out_rms / fit.held_out_span
    lines = [
        Remark(
            f'open loop: {1e3 * fit.rms:.3g} mm rms over the whole recording, '
            f'{1e3 * fit.held_out_rms:.3g} mm on halves that the fit had not seen '
            f'({share:.2g} % of the way)'
        )
    ]
    if share > 20.0:
        lines.append(
            Remark(
                'the model explains little of the motion: check columns, unit and --reversed',
                warning=True,
            )
        )
    for one in fit.parameters:
        if one.why_not:
            lines.append(Remark(f'{_MEANING[one.name][0]}: {one.why_not}', warning=True))
    delay, _ = response.dead_time
    if not isfinite(delay) and not any(one.name == 'delay' for one in fit.parameters):
        lines.append(
            Remark(
                'dead time: these data cannot tell it; steps of the command, or faster '
                'reversals, would',
                warning=True,
            )
        )
    if force is None:
        lines.append(
            Remark(
                'mass: cannot be told without --force, the force at full duty; it is called 1 kg, '
                'and forces go with it'
            )
        )
    return lines


def axis_fit_document(
    fit: AxisFit, response: FrequencyResponse, dead_time: tuple[float, str]
) -> dict[str, Any]:
    """Return all figures in SI."""
    return {
        'structure': fit.structure,
        'parameters': fit.parameters,
        'rms': fit.rms,
        'held_out_rms': fit.held_out_rms,
        'structures': fit.trials,
        'resonance': response.resonance,
        'dead_time': dead_time[0],
        'dead_time_by': dead_time[1],
    }


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
            'cannot be told'
            if known[name].why_not
            else f'{_MEANING[name][2] * known[name].value:.4g}'
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
                        f'{axis}: {_MEANING[one.name][0]}: {one.why_not}; the contour constant '
                        'is told by the data all the same',
                        warning=True,
                    )
                )
        if loop.contour_constant <= 0.0:
            lines.append(
                Remark(
                    f'{axis}: it overshoots bends: the contour constant is not above 0, and feeds '
                    'have nothing to gain from it',
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
                    'no feed mends; match the gains',
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
