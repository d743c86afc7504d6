# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Controllers of axes as C99: one file from a tuned one, equal to it to the last bit."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fuzzycnc_ros.components.servo.servo_trial import (
    AT_LIMIT,
    CHATTER,
    FAST,
    LONGEST,
    OVER,
    VALIDITY,
)
from fuzzycnc_ros.core.servo.constants import Constant
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.course import REST
from fuzzycnc_ros.core.servo.pid_cascade import CascadeController, PidController
from fuzzycnc_ros.core.servo.variable_universe import (
    ContractedSurface,
    LinearSurface,
    VariableUniverseController,
)
from fuzzycnc_ros.studies.servo.c_text import (
    ExportOrigin,
    number,
    portable_numbers,
    rendered,
)

RECORDED = 400
"""Steps of the self-test."""

TRIED = (
    *('PROPORTIONAL', 'DERIVATIVE', 'INTEGRAL', 'POSITION_GAIN', 'VELOCITY_GAIN'),
    *('ERROR_GAIN', 'RATE_GAIN', 'OUTPUT_SCALE', 'PER_ERROR', 'PER_RATE'),
    *('SETTLE_PERIODS', 'DISTURBANCE_GAIN'),
)
"""Constants that the settings of a law decide, beside the gains of its observer."""


def c_controller(controller: AxisController, origin: ExportOrigin) -> str:
    """Return a controller as a C99 file; a copy of its state is not part of it.

    Raises
    ------
    ValueError
        If the controller is of a kind that cannot be exported, or the name is none of C.
    """
    recorded = [[number(one) for one in row] for row in _recorded(controller)]
    return rendered(
        'controller.c', _values(controller), origin, scope='', recorded=recorded, tried=()
    )


def hal_controller(controller: AxisController, origin: ExportOrigin) -> str:
    """Return a controller as a component of LinuxCNC's HAL, the source that halcompile takes.

    Raises
    ------
    ValueError
        If the controller is of a kind that cannot be exported, or the name is none of C.
    """
    values = _values(controller)
    constants = values['constants']
    values['constants'] = [item for item in constants if item.name not in TRIED]
    return rendered(
        'axis.comp',
        values,
        origin,
        scope='static ',
        recorded=(),
        tried=[item for item in constants if item.name in TRIED],
        numbers=len(_tried(constants, values['rows'])),
        silence=round(VALIDITY * 1e-9 / controller.period),
        rest_periods=round(REST / controller.period),
        longest=round(LONGEST / controller.period),
        at_limit=round(AT_LIMIT / controller.period),
        chatter=number(CHATTER),
        fast=number(controller.period / FAST),
        over=number(controller.period / OVER),
        stream=int(hashlib.sha256(origin.name.encode()).hexdigest()[:7], 16),
    )


def controller_hash(controller: AxisController) -> str:
    """Return the hash of a controller that its export has."""
    return str(_values(controller)['controller_hash'])


def trial_numbers(exported: AxisController, tried: AxisController) -> list[float]:
    """Return what a component needs for a trial of another controller.

    Parameters
    ----------
    exported, tried : AxisController
        The controller that it was exported with, and the other one.

    Raises
    ------
    ValueError
        If they differ by more than a trial changes.
    """
    fixed, numbers = [], []
    for controller in (exported, tried):
        values = _values(controller)
        constants, rows = values.pop('constants'), values.pop('rows')
        numbers = _tried(constants, rows)
        for name in ('controller_hash', 'settles'):
            del values[name]
        rest = [(item.name, repr(item.value)) for item in constants if item.name not in TRIED]
        rows = [{**row, 'gain': ''} for row in rows]
        fixed.append({**dict(rest), **values, 'observer': rows})
    for name, value in fixed[0].items():
        if fixed[1].get(name) != value:
            raise ValueError(
                'trial: expected a controller that differs in bandwidth, damping and estimator '
                f'alone from the one that was exported but found another {name}'
            )
    return numbers


def _tried(constants: Sequence[Constant], rows: Sequence[Mapping[str, str]]) -> list[float]:
    """Return the numbers of a trial, in the order of the component."""
    known = [float(item.value) for item in constants if item.name in TRIED]
    return known + [float(row['gain']) for row in rows]


def _values(controller: AxisController) -> dict[str, Any]:
    """Return what the templates need of a controller."""
    values: dict[str, Any] = {'rows': [], 'rest': []}
    if isinstance(controller, PidController):
        values['law'] = 'pid'
    elif isinstance(controller, CascadeController):
        values['law'] = 'cascade'
        values |= _observer(controller)
    elif isinstance(controller, VariableUniverseController) and controller.observer:
        values['law'] = 'rules'
        values |= _observer(controller) | _surface(controller)
    else:
        raise ValueError(
            'controller: expected a pid, a cascade, or a variable universe or its tangent with '
            f'observer but found {type(controller).__name__}, mode '
            f'{getattr(controller, "mode", "none")}'
        )
    values |= {
        'constants': controller.constants(),
        'settles': [int(controller.settles(share)) for share in (0.5, 0.25, 0.125)],
    }
    text = repr(sorted(values.items(), key=str))
    return {**values, 'controller_hash': hashlib.sha256(text.encode()).hexdigest()}


def _surface(law: VariableUniverseController) -> dict[str, Any]:
    """Return the rule table, and the digits of the powers that shrink its universes."""
    rules, kind = law.params.rules, law.surface_type
    if kind not in (ContractedSurface, LinearSurface):
        raise ValueError(f'controller: expected a contracted or linear surface but found {kind}')
    return {
        'contracts': kind is ContractedSurface,
        'cuts': [number(cut) for cut in rules.centres[1:-1]],
        'cells': [[[number(one) for one in cell] for cell in row] for row in rules.cells],
        **portable_numbers(),
    }


def _observer(law: CascadeController | VariableUniverseController) -> dict[str, Any]:
    """Return the observer of a chain: rows that nothing ahead of them acts on."""
    observer = law.observer
    assert observer is not None, 'only those with one are exported'
    design = observer.design
    size = len(design.dynamics) - 1
    unit = np.eye(size + 1)
    chain = (
        2 <= size <= 5
        and not np.triu(design.dynamics[:-1, :-1], 1).any()
        and np.array_equal(design.reading, unit[-2])
    )
    if not chain:
        raise ValueError('axis: expected a chain of 2 to 5 states that is read at its end')
    rows = [
        {
            'states': [number(one) for one in design.dynamics[row, :size]],
            'disturbance': number(design.dynamics[row, -1]),
            'duty': number(design.duty[row]),
            'gain': number(design.gain[row]),
        }
        for row in range(size)
    ]
    at_rest = {'velocity': '0.0', 'position': 'position', 'sensor': 'position'}
    return {'rows': rows, 'rest': [at_rest.get(name, 'duty') for name in law.axis.states]}


def _recorded(controller: AxisController) -> Sequence[Sequence[float]]:
    """Return steps of the controller on its own nominal axis: a move, gaps and a load."""
    held, entry, load = controller.axis.discrete()
    state, place = np.zeros(len(held)), controller.axis.c
    rng = np.random.default_rng(0)
    count = controller.watch.limits.count or 1e-9
    top = 0.1 * abs(controller.axis.gain)
    controller.reset()
    rows, reference, velocity = [], 0.0, 0.0
    for step in range(RECORDED):
        acceleration = top * 20.0 if step < 50 else -top * 20.0 if 150 <= step < 200 else 0.0
        velocity += acceleration * controller.period
        velocity = 0.0 if step >= 200 else velocity
        reference += velocity * controller.period
        reading = count * round(float(place @ state) / count)
        if rng.random() < 0.01:
            reading = float('nan')
        duty = controller.step(reference, reading, velocity, acceleration)
        rows.append((reference, reading, velocity, acceleration, duty))
        state = held @ state + entry * duty + load * (-0.05 if step > 300 else 0.0)
    controller.reset()
    return rows
