# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position controllers by name, and the way from what is known of an axis to its controller.

The four for any axis know the same of it: its nominal model, its friction and its sensor.  All
feed velocity, acceleration and friction of the reference forward.  They differ in the law that
closes the loop, and their settings mean the same: how fast it is, how well damped, and how fast
what the model does not know is found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from math import inf, pi, sqrt
from types import MappingProxyType
from typing import Any, NamedTuple

from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.core.servo.axis import LinearAxis, response_lag, velocity_lag
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.observer import ObserverNoise
from fuzzycnc_ros.core.servo.params import VariableUniverseParams, default_crossover
from fuzzycnc_ros.core.servo.pid_cascade import CascadeController, PidController
from fuzzycnc_ros.core.servo.rule_table import RuleTable
from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams
from fuzzycnc_ros.core.servo.variable_universe import (
    FixedSurface,
    LinearSurface,
    VariableUniverseController,
)

SETTINGS: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        'bandwidth': (0.01, 12.0, 2.0),
        'damping': (0.5, 2.5, 1.0),
        'estimator': (0.2, 8.0, 3.0),
    }
)
"""Settings by name: lowest, highest, and what is taken without tuning.

`bandwidth`: natural frequency of the closed loop, as multiple of `default_crossover`.  `damping`:
its damping.  `estimator`: natural frequency of the disturbance observer over the bandwidth; of the
PID, three times the rate at which its integral acts over the bandwidth.
"""

_SLOWEST = 0.25
"""Lowest bandwidth that is searched on an axis of which no more than a model is known [-]."""

_FRICTION = (0.0, 1.0, 1.0)
"""Likewise of `friction`: share of the known Coulomb friction that is fed forward [-]."""

UNIVERSES = (
    'error_range',
    'rate_range',
    'error_exponent',
    'rate_exponent',
    'error_floor',
    'rate_floor',
    'output_gain',
)
"""Settings that stand for a number of `VariableUniverseParams`, in SI."""

DISTURBANCE = 'disturbance'
"""Setting for what the observer expects of the disturbance, as `ObserverNoise`."""

_ELASTIC = 4.0
"""By how much more than its rigid model an elastic axis may accelerate [-]."""


_BELOW_RESONANCE, _BELOW_UNKNOWN = 20.0, 10.0
"""By how much an untuned loop stays below a resonance, and below where an unknown one may begin
[-].

Of twelve axes with two masses, drawn at random (40 to 300 Hz, damping 3 to 10 %, dead times to
2 ms, gains from half to twice), none swung with 20, three of 36 cases did with 16, 16 with 10.
"""


Options = dict[str, Any]


def make_controller(
    name: str,
    axis: LinearAxis,
    settings: Mapping[str, float] | None = None,
    rules: RuleTable | None = None,
    **options: Any,
) -> AxisController:
    """Return the controller of a name, with the numbers that were found on the lathe axis.

    Parameters
    ----------
    name : str
        Of `CONTROLLERS`.
    axis : LinearAxis
        Nominal model of the axis.
    settings : mapping of str to float, optional
        Of `UNIVERSES`, or `DISTURBANCE`, instead of those numbers.
    rules : RuleTable, optional
        Rules instead of the published ones.
    **options
        What the controller takes beside: `duty_max`, `duty_slew` and `limits` all do.

    Raises
    ------
    ValueError
        If the name is unknown, the controller has no universes to set, or a number is out of its
        range.

    Examples
    --------
    >>> lags = {'amplifier': 8e-4, 'torque': 1.5e-3}
    >>> axis = LinearAxis.chain(0.286, lags, 0.017, sensor_lag=6e-3, period=1e-3)
    >>> type(make_controller('cascade', axis)).__name__
    'CascadeController'
    """
    if name not in CONTROLLERS:
        raise ValueError(
            f'controller: expected one of {", ".join(CONTROLLERS)} but found {name!r}'
        )
    make = CONTROLLERS[name].make
    if settings or rules is not None:
        if name not in WITH_PARAMS:
            raise ValueError(
                f'settings: expected one of the controllers {", ".join(WITH_PARAMS)} but found '
                f'{name}, which has no such numbers'
            )
        plain: Any = make(axis)
        options |= _set({'params': plain.params, 'noise': ObserverNoise()}, settings or {}, rules)
    return make(axis, **options)


def make_axis_controller(
    data: AxisData,
    name: str = '',
    settings: Mapping[str, float] | None = None,
    rules: RuleTable | None = None,
) -> AxisController:
    """Return a controller for an axis of a machine file.

    Parameters
    ----------
    data : AxisData
        The axis, with a plant.
    name : str
        Of `AXIS_CONTROLLERS`; by default the axis' own, else `UNTUNED_CONTROLLER`.
    settings : mapping of str to float, optional
        Of `SETTINGS`; by default those of the axis, if its own controller is made.  What is left
        out is not tuned.
    rules : RuleTable, optional
        Rules of `WITH_RULES` instead of the published ones.

    Raises
    ------
    ValueError
        If the axis has no plant, a name or setting is unknown or out of its range, or there are
        rules for a controller that has none.
    """
    chosen = name or data.controller or UNTUNED_CONTROLLER
    if chosen not in AXIS_CONTROLLERS:
        raise ValueError(
            f'controller: expected one of {", ".join(AXIS_CONTROLLERS)} but found {chosen!r}'
        )
    # Settings are tuned for the controller that the axis has, and for that one alone.
    own = data.settings if name in ('', data.controller) else {}
    known = _checked(chosen, own if settings is None else settings)
    if rules is not None and chosen != WITH_RULES:
        raise ValueError(
            f'rules: expected none for {chosen}, which has none, but found some; they are for '
            f'{WITH_RULES}'
        )
    axis, common = _common(data, known['friction'])
    if not (data.knowledge.known_to and 'bandwidth' in (own if settings is None else settings)):
        known |= _below_resonance(data, axis, known)
    fit = CONTROLLERS[chosen].fit
    assert fit is not None
    options = fit(data, axis, known)
    if 'params' in options:
        options = _set(options, known, rules)
    return CONTROLLERS[chosen].make(axis, **options, **common)


def _set(options: Options, settings: Mapping[str, float], rules: RuleTable | None) -> Options:
    """Return options of the variable universe with numbers and rules of their own."""
    numbers: dict[str, Any] = {key: settings[key] for key in UNIVERSES if key in settings}
    if rules is not None:
        numbers['rules'] = rules
    found = {**options, 'params': replace(options['params'], **numbers)}
    if DISTURBANCE in settings:
        found['noise'] = replace(options['noise'], disturbance=settings[DISTURBANCE])
    return found


def _checked(name: str, given: Mapping[str, float]) -> dict[str, float]:
    """Return all settings of a controller; refuses what it has not, or what is out of range."""
    further = (*UNIVERSES, DISTURBANCE) if name in WITH_PARAMS else ()
    for key, value in given.items():
        if key in further:
            continue
        if key not in SETTINGS and key != 'friction':
            raise ValueError(
                f'settings: expected {", ".join((*SETTINGS, "friction", *further))} for {name} '
                f'but found {key!r}'
            )
        low, high, _ = SETTINGS.get(key, _FRICTION)
        if not (isinstance(value, (int, float)) and low <= value <= high):
            raise ValueError(
                f'settings: expected {key} from {low:g} to {high:g} but found {value!r}'
            )
    plain = {key: value for key, (_, _, value) in {**SETTINGS, 'friction': _FRICTION}.items()}
    return plain | dict(given)


def setting_ranges(
    data: AxisData, name: str, search: Iterable[str]
) -> dict[str, tuple[float, float, float]]:
    """Return lowest, highest and untuned value of settings, as `SETTINGS` has them.

    Numbers of the universes are searched from a third to three times the untuned one.

    Raises
    ------
    ValueError
        If the controller has no such setting.
    """
    plain = _checked(name, {})
    found: dict[str, tuple[float, float, float]] = {}
    for key in search:
        if key in SETTINGS:
            low, high, untuned = SETTINGS[key]
            if key == 'bandwidth' and not data.knowledge.known_to:
                low = _SLOWEST
            found[key] = low, high, untuned
            continue
        _checked(name, {key: 1.0})
        axis = data.known_plant().linear()
        options = _universes(data, axis, plain | _below_resonance(data, axis, plain))
        value = options['noise' if key == DISTURBANCE else 'params']
        untuned = float(getattr(value, key))
        most = 1.0 if key.endswith('exponent') else 3.0 * untuned
        found[key] = (untuned / 3.0, most, untuned)
    return found


def _universes(data: AxisData, axis: LinearAxis, settings: Mapping[str, float]) -> Options:
    bandwidth, observer = _bandwidths(axis, settings)
    plant = data.known_plant()
    return {
        'params': VariableUniverseParams.for_axis(
            axis, bandwidth, damping=_damping(axis, bandwidth, settings)
        ),
        'noise': ObserverNoise.of_bandwidth(axis, observer, _reading_error(data)),
        'settle': 3.0 / observer,
        'stick_slip': StickSlipParams.for_sensor(plant.count, plant.noise),
    }


def _cascade(data: AxisData, axis: LinearAxis, settings: Mapping[str, float]) -> Options:
    bandwidth, observer = _bandwidths(axis, settings)
    damping = _damping(axis, bandwidth, settings)
    return {
        'position_gain': 0.5 * bandwidth / damping,
        'velocity_gain': 2.0 * damping * bandwidth * velocity_lag(axis) - 1.0,
        'velocity_max': 1.2 * data.limits.velocity,
        'noise': ObserverNoise.of_bandwidth(axis, observer, _reading_error(data)),
    }


def _pid(data: AxisData, axis: LinearAxis, settings: Mapping[str, float]) -> Options:
    bandwidth, estimator = _bandwidths(axis, settings)
    lag, gain = velocity_lag(axis), abs(axis.gain)
    proportional = bandwidth * bandwidth * lag / gain
    sensor = axis.states.index('sensor') if 'sensor' in axis.states else None
    return {
        'proportional': proportional,
        'integral': proportional * estimator / 3.0,
        'derivative': (2.0 * _damping(axis, bandwidth, settings) * bandwidth * lag - 1.0) / gain,
        'rate_lag': max(0.2 * response_lag(axis), axis.period),
        'integral_band': inf,
        'sensor_lag': 0.0 if sensor is None else -1.0 / float(axis.a[sensor, sensor]),
    }


class Kind(NamedTuple):
    """A controller: its maker with the lathe's numbers, and those for another axis, if any do."""

    make: Callable[..., AxisController]
    fit: Callable[[AxisData, LinearAxis, Mapping[str, float]], Options] | None = None


_variable = VariableUniverseController

CONTROLLERS: Mapping[str, Kind] = MappingProxyType(
    {
        'pid': Kind(PidController, _pid),
        'cascade': Kind(CascadeController, _cascade),
        'linear_tangent': Kind(partial(_variable, surface=LinearSurface), _universes),
        'variable_universe': Kind(_variable, _universes),
        'variable_universe_model_free': Kind(partial(_variable, observer=False)),
        'variable_universe_static': Kind(partial(_variable, mode='static')),
        'variable_universe_paper': Kind(partial(_variable, mode='paper_literal')),
        'fixed_universe': Kind(
            partial(
                _variable,
                params=VariableUniverseParams(
                    error_range=0.025, rate_range=0.246, output_gain=3.37
                ),
                surface=FixedSurface,
            )
        ),
        'fixed_universe_paper': Kind(
            partial(
                _variable,
                params=VariableUniverseParams.published(),
                mode='static',
                surface=FixedSurface,
            )
        ),
    }
)
"""Controllers by name, the simplest first.

`variable_universe` is the repaired form with observer and feedforward, `_model_free` the same with
filtered differences and an integral, `_static` the published surface alone, `_paper` the published
recursion as printed.  `linear_tangent` is its tangent at the target, `fixed_universe` has
universes that do not contract, `fixed_universe_paper` the published rules on the published ones.
"""

AXIS_CONTROLLERS = tuple(name for name, kind in CONTROLLERS.items() if kind.fit)
"""Those for any axis."""

LATHE_CONTROLLERS = (*list(CONTROLLERS)[3:], 'cascade', 'pid')
"""Those with numbers found on the lathe axis, the default first."""

FOR_USE = tuple(name for name in LATHE_CONTROLLERS if name != 'fixed_universe_paper')
"""Those of them that a node offers; the one left out stops far short, for comparison alone."""

WITH_PARAMS = tuple(name for name in CONTROLLERS if name.startswith(('variable', 'linear')))
"""Controllers that `VariableUniverseParams` are for."""

WITH_RULES = 'variable_universe'
"""The one for any axis that has rules."""

UNTUNED_CONTROLLER = 'pid'
"""Controller of an axis that nothing is said about and that nothing was tuned on."""


def _common(data: AxisData, friction: float) -> tuple[LinearAxis, Options]:
    """Return the nominal model, and what all controllers are told alike."""
    plant = data.known_plant()
    axis = plant.linear()
    limits = FeedbackLimits.of(
        axis,
        count=plant.count,
        noise=plant.noise,
        travel=data.limits.travel_high - data.limits.travel_low,
        load=min(max(data.limits.load + data.limits.friction, 0.2), 1.0),
    )
    # An encoder at the motor sees it swing against its load, with its own mass alone.
    limits = replace(limits, acceleration_max=_ELASTIC * limits.acceleration_max)
    forward, backward = _friction(data)
    return axis, {
        'duty_max': plant.duty_max,
        'limits': limits,
        'friction': (friction * forward, friction * backward),
        'keeps_gain': data.limits.vertical,
    }


def untuned_settings(data: AxisData) -> dict[str, float]:
    """Return the settings that an axis has without tuning, below a resonance."""
    plain = {key: value for key, (_, _, value) in SETTINGS.items()}
    return plain | _below_resonance(data, data.known_plant().linear(), plain)


def _below_resonance(
    data: AxisData, axis: LinearAxis, settings: Mapping[str, float]
) -> dict[str, float]:
    """Return bandwidth and estimator that stay well below a resonance, known or not."""
    known = data.knowledge
    most = inf
    if data.limits.resonance:
        most = 2.0 * pi * data.limits.resonance / _BELOW_RESONANCE
    elif known.known_to and not known.mode_high:
        most = 2.0 * pi * known.mode_low / _BELOW_UNKNOWN
    unit = default_crossover(axis)
    wanted = settings['bandwidth'] * unit
    # What is damped more acts as fast as the damping says.
    bandwidth = min(wanted, most / max(settings['damping'], 1.0))
    observer = min(settings['estimator'] * wanted, 3.0 * most)
    if bandwidth == wanted and observer == settings['estimator'] * wanted:
        return {}
    return {'bandwidth': bandwidth / unit, 'estimator': observer / bandwidth}


def _bandwidths(axis: LinearAxis, settings: Mapping[str, float]) -> tuple[float, float]:
    """Return the natural frequencies of loop and observer [rad/s]."""
    bandwidth = settings['bandwidth'] * default_crossover(axis)
    return bandwidth, settings['estimator'] * bandwidth


def _damping(axis: LinearAxis, bandwidth: float, settings: Mapping[str, float]) -> float:
    """Return the damping [-]: at least what the axis has by itself, and a little."""
    return max(settings['damping'], 1.05 * 0.5 / (bandwidth * velocity_lag(axis)))


def _friction(data: AxisData) -> tuple[float, float]:
    """Return what friction takes in positive and negative motion [-], as duty."""
    plant = data.known_plant()
    if isinstance(plant, LatheAxisConfig):
        return plant.coulomb, plant.coulomb
    full = plant.force_max
    return plant.coulomb_forward / full, plant.coulomb_backward / full


def _reading_error(data: AxisData) -> float:
    """Return the RMS of a reading's error [m]."""
    plant = data.known_plant()
    return sqrt(plant.count * plant.count / 12.0 + plant.noise * plant.noise) or 1e-8
