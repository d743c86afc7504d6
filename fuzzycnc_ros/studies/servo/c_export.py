# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Controllers of axes as C99: one file from a tuned one, equal to it to the last bit."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from importlib import resources
from math import isinf
from typing import Any, NamedTuple

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.servo import feedback_watch as watching
from fuzzycnc_ros.core.servo import growing_swing as swinging
from fuzzycnc_ros.core.servo import variable_universe
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.pid_cascade import CascadeController, PidController
from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams
from fuzzycnc_ros.core.servo.variable_universe import (
    ContractedSurface,
    LinearSurface,
    VariableUniverseController,
)
from fuzzycnc_ros.studies.requirement import require

RECORDED = 400
"""Steps of the self-test."""


class Constant(NamedTuple):
    """One constant of a file."""

    name: str
    text: str
    unit: str
    comment: str


def c_controller(
    controller: AxisController, *, name: str, title: str, source: str, machine_hash: str
) -> str:
    """Return a controller as a C99 file.

    Parameters
    ----------
    controller : AxisController
        As it was tuned; a copy of its state is not part of the file.
    name : str
        Beginning of all names of the file that a program sees.
    title, source, machine_hash : str
        For its header.

    Raises
    ------
    ValueError
        If the controller is of a kind that cannot be exported, or the name is none of C.
    """
    if not re.fullmatch('[a-z][a-z0-9_]*', name):
        raise ValueError(f'name: expected letters, digits and _ but found {name!r}')
    values: dict[str, Any] = {'name': name, 'rows': [], 'rest': []}
    constants = _common(controller)
    if isinstance(controller, PidController):
        values['law'] = 'pid'
        constants += _pid(controller)
    elif isinstance(controller, CascadeController):
        values['law'] = 'cascade'
        constants += _cascade(controller)
        values |= _observer(controller)
    elif isinstance(controller, VariableUniverseController) and controller._observer:
        values['law'] = 'rules'
        constants += _rules(controller)
        values |= _observer(controller) | _surface(controller)
    else:
        raise ValueError(
            'controller: expected a pid, a cascade, or a variable universe or its tangent with '
            f'observer but found {type(controller).__name__}, mode '
            f'{getattr(controller, "mode", "none")}'
        )
    counts = _counts(controller)
    settles = [int(controller._settles(share)) for share in (0.5, 0.25, 0.125)]
    text = repr((constants, counts, settles, sorted(values.items(), key=str)))
    values |= {
        'title': title,
        'source': source,
        'machine_hash': machine_hash,
        'controller_hash': hashlib.sha256(text.encode()).hexdigest(),
        'constants': constants,
        'counts': counts,
        'settles': settles,
        'recorded': [[_number(one) for one in row] for row in _recorded(controller)],
    }
    jinja2 = require('jinja2')
    template = resources.files('fuzzycnc_ros.studies.servo') / 'templates' / 'controller.c'
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, keep_trailing_newline=True)
    return str(environment.from_string(template.read_text(encoding='utf-8')).render(**values))


def _number(value: float) -> str:
    """Return a number as C reads it back to the last bit."""
    value = float(value)
    if isinf(value):
        return 'HUGE_VAL' if value > 0.0 else '-HUGE_VAL'
    return 'NAN' if value != value else repr(value)


def _constants(*rows: tuple[str, float, str, str]) -> list[Constant]:
    return [Constant(name, _number(value), unit, text) for name, value, unit, text in rows]


def _common(controller: AxisController) -> list[Constant]:
    watch, known = controller.watch, controller._known
    limits, swing = watch.limits, watch.swing
    return _constants(
        ('PERIOD', controller.period, 's', 'Control period'),
        ('DUTY_MAX', controller.duty_max, '-', 'Largest magnitude of duty'),
        ('DUTY_CHANGE_MAX', controller._change_max, '-', 'Largest change of duty in a period'),
        ('DIRECTION', controller._direction, '-', 'Sign of the velocity of a positive duty'),
        ('FRICTION_FORWARD', known._forward if known else 0.0, '-', 'Duty of friction, forward'),
        ('FRICTION_BACKWARD', known._backward if known else 0.0, '-', 'The same, backward'),
        ('ERROR_MAX', limits.error_max, 'm', 'Largest believable error'),
        ('LOAD', limits.load, '-', 'Largest load that is believed, as duty'),
        ('JUMP', watch._jump, 'm', 'Surprise of a reading that is believed'),
        ('LEAP', watch._leap, 'm', 'Way of the fastest axis in two periods'),
        ('PER_COUNT', watch._per_count, '1/m', 'Counts of the sensor per length; 0 for none'),
        ('FULL_DUTY', watch._full, '-', 'Duty from which on it is at its end'),
        ('ANSWER_SHARE', watch._fade, '-', 'Share of a new duty in the one that is answered'),
        ('STILL_CHANGE', watch._still, 'm', 'Way in a period that is rest'),
        ('SPEED_SHARE', watching._SPEED_SHARE, '-', 'Share of a new reading in the speed'),
        ('SWING_SHARE', swing._share, '-', 'Share of a new error in its mean'),
        ('SWING_LEAST', swing._least, 'm', 'Peak from which on a swing counts'),
        ('SWING_STEADY', swinging._STEADY, 'm', 'Change of pace of a reference that is none'),
        ('SWING_ALIKE', swinging._ALIKE, '-', 'Ratio of times of swings that are alike'),
        ('SWING_GROWS', swinging._GROWS, '-', 'Ratio of sizes from which on a swing grows'),
        ('SWING_DIES', swinging._DIES, '-', 'Ratio of sizes up to which it is over'),
        ('SWING_GROWN', swinging._GROWN, '-', 'Ratio of the last to the first that grew'),
        ('SWING_STAYS', swinging._STAYS, '-', 'Ratio of sizes from which on it does not die'),
    )


def _counts(controller: AxisController) -> list[Constant]:
    watch = controller.watch
    rows = [
        ('KEEPS_GAIN', controller._keeps_gain, 'Whether a swing that grows is a fault at once'),
        ('FRICTION_KNOWN', controller._known is not None, 'Whether friction is fed forward'),
        ('BAD_MAX', watch.limits.bad_max, 'Bad readings in a row that are bridged'),
        ('RUNAWAY_PERIODS', watch.limits.runaway_periods, 'Periods of gaining speed against duty'),
        ('END_PERIODS', watch._swing_periods, 'Longest time between two ends of the duty'),
        ('ENDS_MAX', watching._SWINGS, 'Changes from end to end of a loop that swings'),
        ('ENDS_BEFORE_LOSS', watching._SWINGS_BEFORE_LOSS, 'Those that explain a lost reading'),
        ('COUNT_CHANGES', watching._INCREMENTS, 'Changes after which their divisor is judged'),
        ('COUNT_KINDS', watching._KINDS, 'Different sizes among them; at most 8'),
        ('SWING_HALVES', swinging._HALVES, 'Half swings in a row that have to grow'),
        ('SWING_LASTS', swinging._LASTS, 'Swings in a row that last'),
    ]
    if isinstance(controller, VariableUniverseController):
        relief = controller._relief
        numbers = (
            (relief._still_count, relief._patience, relief._half, relief._settled)
            if relief is not None
            else (1, 0, 1, 0)
        )
        rows += [
            (
                'SETTLE_PERIODS',
                controller._moving._settle,
                'Motion before that is seen',
            ),
            ('RELIEVES', relief is not None, 'Whether an axis that is stuck is helped'),
            ('STILL_COUNT', numbers[0], 'Periods after which a still axis is judged'),
            ('PATIENCE', numbers[1], 'Periods for which it may be stuck off its target'),
            ('HALF_WAVE', numbers[2], 'Periods of half a wave of the dither'),
            ('SETTLED', numbers[3], 'Periods near the target after which it ends'),
        ]
    if not isinstance(controller, PidController):
        design = controller._observer.design  # type: ignore[attr-defined]
        rows += [
            ('POSITION', design.position, 'Place of the position among the states'),
            ('VELOCITY', design.velocity, 'Place of the velocity'),
        ]
    return [Constant(name, str(int(value)), '', text) for name, value, text in rows]


def _pid(law: PidController) -> list[Constant]:
    integral = law._integral
    return _constants(
        ('PROPORTIONAL', law._proportional, '1/m', 'Duty per error'),
        ('DERIVATIVE', law._derivative, 's/m', 'Duty per error rate'),
        ('INTEGRAL', integral.gain, '1/m', 'What an error adds to the integral in a period'),
        ('DEAD_ZONE', integral._dead_zone, 'm', 'Error within which nothing is added'),
        ('INTEGRAL_BAND', integral._band, 'm', 'Error beyond which nothing is added in motion'),
        ('STUCK_SPEED', integral._still, 'm/s', 'Speed up to which the axis counts as stuck'),
        ('FREQUENCY', law._rate._frequency, '1/s', 'Control periods in a second'),
        ('RATE_SHARE', law._rate.share, '-', 'Share of a new difference in the rate'),
        ('SENSOR_LAG', law._late, 's', 'Lag of the sensor that is made up for'),
        ('PER_VELOCITY', law._per_velocity, 's/m', 'Duty per velocity of the reference'),
        ('PER_ACCELERATION', law._per_acceleration, 's2/m', 'Duty per acceleration'),
    )


def _cascade(law: CascadeController) -> list[Constant]:
    return _constants(
        ('POSITION_GAIN', law._position_gain, '1/s', 'Velocity per error'),
        ('VELOCITY_GAIN', law._inner, 's/m', 'Duty per error of velocity'),
        ('VELOCITY_MAX', law._velocity_max, 'm/s', 'Velocity that the position loop asks for'),
        ('PER_VELOCITY', law._per_velocity, 's/m', 'Duty per velocity of the reference'),
        ('PER_ACCELERATION', law._per_acceleration, 's2/m', 'Duty per acceleration'),
        ('DISTURBANCE_GAIN', law._observer.design.gain[-1], '1/m', 'Correction of disturbance'),
    )


def _rules(law: VariableUniverseController) -> list[Constant]:
    p, relief, observer = law.params, law._relief, law._observer
    assert observer is not None, 'only those with one are exported'
    rest = relief.params if relief is not None else StickSlipParams(amplitude_max=0.0)
    steps = (relief._mean, relief._grow, relief._fade) if relief is not None else (0.0, 0.0, 0.0)
    found = _constants(
        ('DISTURBANCE_GAIN', observer.design.gain[-1], '1/m', 'Correction of disturbance'),
        ('PER_VELOCITY', law._per_velocity, 's/m', 'Duty per velocity of the reference'),
        ('PER_ACCELERATION', law._per_acceleration, 's2/m', 'Duty per acceleration'),
        ('HIDDEN', law._hides, '-', 'Disturbance that friction hides at rest'),
        ('MOVING', variable_universe._MOVING, 'm/s', 'Speed from which on the axis moves'),
        ('SEEN_SHARE', law._moving._share, '-', 'Share of a new disturbance in its mean'),
        ('STILL_BAND', rest.still_band, 'm', 'Way within which the axis is still'),
        ('PROOF', rest.proof, '-', 'Change of duty that proves friction'),
        ('HOLD_ERROR', rest.hold_error, 'm', 'Mean error up to which it is held'),
        ('LOOSE_ERROR', rest.loose_error, 'm', 'Mean error beyond which it is dithered loose'),
        ('REACHED_ERROR', rest.reached_error, 'm', 'Mean error at which dithering ends'),
        ('ZONE', rest.zone, 'm', 'Error up to which it is dithered at all'),
        ('START_AMPLITUDE', rest.start_amplitude, '-', 'Amplitude that the dither begins with'),
        ('AMPLITUDE_MAX', rest.amplitude_max, '-', 'Largest amplitude; 0 turns dithering off'),
        ('MEAN_SHARE', steps[0], '-', 'Share of a new value in mean error and duty'),
        ('AMPLITUDE_GROWTH', steps[1], '-', 'Growth of the amplitude in a period'),
        ('AMPLITUDE_DECAY', steps[2], '-', 'Its decay in a period'),
    )
    if isinstance(law._surface, LinearSurface):
        way = -1.0 if law._surface._scale > 0.0 else 1.0
        return found + _constants(
            ('ERROR_GAIN', way * p.error_gain, '1/m', 'Duty per error'),
            ('RATE_GAIN', way * p.rate_gain, 's/m', 'Duty per error rate'),
        )
    return found + _constants(
        ('OUTPUT_SCALE', law._surface._scale, '-', 'Duty of the whole output, with its sign'),
        ('PER_ERROR', 1.0 / p.error_range, '1/m', 'Error on its universe'),
        ('PER_RATE', 1.0 / p.rate_range, 's/m', 'Rate on its universe'),
        ('ERROR_EXPONENT', p.error_exponent, '-', 'How the universe of the error shrinks'),
        ('RATE_EXPONENT', p.rate_exponent, '-', 'How that of the rate does'),
        ('ERROR_FLOOR', p.error_floor, '-', 'Least of the universe of the error'),
        ('RATE_FLOOR', p.rate_floor, '-', 'Least of that of the rate'),
    )


def _surface(law: VariableUniverseController) -> dict[str, Any]:
    """Return the rule table, and the digits of the powers that shrink its universes."""
    rules, kind = law.params.rules, type(law._surface)
    if kind not in (ContractedSurface, LinearSurface):
        raise ValueError(f'controller: expected a contracted or linear surface but found {kind}')
    return {
        'contracts': kind is ContractedSurface,
        'cuts': [_number(cut) for cut in rules.centres[1:-1]],
        'cells': [[[_number(one) for one in cell] for cell in row] for row in rules.cells],
        'log': [_number(one) for one in portable._LOG],
        'exp': [_number(one) for one in portable._EXP],
        'root_half': _number(portable._ROOT_HALF),
        'ln2_high': _number(portable._LN2_HIGH),
        'ln2_low': _number(portable._LN2_LOW),
        'per_ln2': _number(portable._PER_LN2),
    }


def _observer(law: CascadeController | VariableUniverseController) -> dict[str, Any]:
    """Return the observer of a chain: rows that nothing ahead of them acts on."""
    observer = law._observer
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
            'states': [_number(one) for one in design.dynamics[row, :size]],
            'disturbance': _number(design.dynamics[row, -1]),
            'duty': _number(design.duty[row]),
            'gain': _number(design.gain[row]),
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
