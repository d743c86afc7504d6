# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position controllers for an axis of a machine file, four kinds with three settings each.

All of them know the same of the axis: its nominal model, its friction and its sensor.  All feed
velocity, acceleration and friction of the reference forward.  They differ in the law that closes
the loop, and their settings mean the same: how fast it is, how well damped, and how fast what the
model does not know is found.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf, pi, sqrt
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.core.servo.axis import LinearAxis, response_lag, velocity_lag
from fuzzycnc_ros.core.servo.baselines import CascadeController, PidController
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.friction import FrictionFedController, ReferenceFriction
from fuzzycnc_ros.core.servo.observer import ObserverNoise
from fuzzycnc_ros.core.servo.params import (
    VariableUniverseParams,
    default_crossover,
)
from fuzzycnc_ros.core.servo.rule_table import RuleTable
from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams
from fuzzycnc_ros.core.servo.variable_universe import ContractedSurface, Law

SETTINGS: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        'bandwidth': (0.25, 12.0, 2.0),
        'damping': (0.5, 2.5, 1.0),
        'estimator': (0.2, 8.0, 3.0),
    }
)
"""Settings by name: lowest, highest, and what is taken without tuning.

`bandwidth`: natural frequency of the closed loop, as multiple of `default_crossover`.  `damping`:
its damping.  `estimator`: natural frequency of the disturbance observer over the bandwidth; of the
PID, three times the rate at which its integral acts over the bandwidth.
"""


_ELASTIC = 4.0
"""By how much more than its rigid model an elastic axis may accelerate [-]."""


_BELOW_RESONANCE = 20.0
"""By how much the loop has to stay below a resonance [-].

Of twelve axes with two masses, drawn at random (40 to 300 Hz, damping 3 to 10 %, dead times to
2 ms, gains from half to twice), none swung with 20, three of 36 cases did with 16, 16 with 10.
"""


class _LinearSurface(ContractedSurface):
    """The tangent of the contracted surface at the target: proportional and derivative action."""

    def duty(self, error: ArrayLike, rate: ArrayLike) -> Array:
        """Return the duties [-] at errors [m] and error rates [m/s], which broadcast."""
        p, way = self._params, -np.sign(self._scale)
        return np.asarray(
            way * (p.error_gain * np.asarray(error) + p.rate_gain * np.asarray(rate))
        )

    def _law(self) -> Law:
        way = -np.sign(self._scale).item()
        per_error, per_rate = way * self._params.error_gain, way * self._params.rate_gain
        return lambda error, rate: per_error * error + per_rate * rate


class _LinearTangentController(FrictionFedController):
    """The variable-universe controller with the tangent of its surface: linear state feedback.

    It is what the rules come down to near the target; parameters as `FrictionFedController`.
    """

    def _on_universes(self) -> _LinearSurface:
        return _LinearSurface(self.params, self._direction)


class _FrictionFedCascade(CascadeController):
    """The cascade with the friction of the reference's motion fed forward.

    Parameters
    ----------
    axis : LinearAxis
        Nominal model.
    friction : ReferenceFriction
        Friction of the axis.
    **options
        As `CascadeController`.
    """

    def __init__(self, axis: LinearAxis, friction: ReferenceFriction, **options: Any) -> None:
        super().__init__(axis, **options)
        self._known, self._friction = friction, 0.0

    def _restart(self, position: float, duty: float) -> None:
        self._known.reset()
        self._friction = 0.0
        super()._restart(position, duty)

    def _wanted(
        self, reference: float, position: float, velocity: float, acceleration: float
    ) -> float:
        self._friction = self._known.of(velocity, acceleration, self._error)
        return super()._wanted(reference, position, velocity, acceleration) + self._friction

    def _commit(self, duty: float, position: float) -> None:
        super()._commit(duty - self._friction, position)

    def _bridge(self, duty: float) -> None:
        super()._bridge(duty - self._friction)


class _FrictionFedPid(PidController):
    """The PID with velocity, acceleration and friction of the reference fed forward.

    Parameters
    ----------
    axis : LinearAxis
        Nominal model.
    friction : ReferenceFriction
        Friction of the axis.
    **options
        As `PidController`.
    """

    def __init__(self, axis: LinearAxis, friction: ReferenceFriction, **options: Any) -> None:
        super().__init__(axis, **options)
        self._known = friction
        # An axis that follows well is read late, by this time.
        sensor = axis.states.index('sensor') if 'sensor' in axis.states else None
        self._late = 0.0 if sensor is None else -1.0 / float(axis.a[sensor, sensor])

    def _restart(self, position: float, duty: float) -> None:
        self._known.reset()
        super()._restart(position, duty)

    def _wanted(
        self, reference: float, position: float, velocity: float, acceleration: float
    ) -> float:
        friction = self._known.of(velocity, acceleration, self._error)
        seen = reference - self._late * velocity
        return super()._wanted(seen, position, velocity, acceleration) + friction


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
    given = own if settings is None else settings
    for key, value in given.items():
        if key not in SETTINGS:
            raise ValueError(
                f'settings: expected {", ".join(SETTINGS)} but found {key!r}; settings of '
                '`servo tune` without a machine file are for the lathe axis'
            )
        low, high, _ = SETTINGS[key]
        if not low <= value <= high:
            raise ValueError(
                f'settings: expected {key} from {low:g} to {high:g} but found {value}'
            )
    known = {key: plain for key, (_, _, plain) in SETTINGS.items()} | dict(given)
    if rules is None:
        return AXIS_CONTROLLERS[chosen](data, known)
    if chosen != WITH_RULES:
        raise ValueError(
            f'rules: expected none for {chosen}, which has none, but found some; they are for '
            f'{WITH_RULES}'
        )
    return _friction_fed(FrictionFedController, data, known, rules)


def _variable_universe(data: AxisData, settings: Mapping[str, float]) -> AxisController:
    return _friction_fed(FrictionFedController, data, settings)


def _linear_tangent(data: AxisData, settings: Mapping[str, float]) -> AxisController:
    return _friction_fed(_LinearTangentController, data, settings)


def _friction_fed(
    kind: type[FrictionFedController],
    data: AxisData,
    settings: Mapping[str, float],
    rules: RuleTable | None = None,
) -> AxisController:
    axis, common = _common(data)
    forward, backward = _friction(data)
    bandwidth, observer = _bandwidths(data, axis, settings)
    params = VariableUniverseParams.for_axis(
        axis, bandwidth, damping=_damping(axis, bandwidth, settings)
    )
    return kind(
        axis,
        forward=forward,
        backward=backward,
        observer_bandwidth=observer,
        params=params if rules is None else replace(params, rules=rules),
        noise=ObserverNoise.of_bandwidth(axis, observer, _reading_error(data)),
        stick_slip=_relief(data),
        **common,
    )


def _cascade(data: AxisData, settings: Mapping[str, float]) -> AxisController:
    axis, common = _common(data)
    bandwidth, observer = _bandwidths(data, axis, settings)
    damping = _damping(axis, bandwidth, settings)
    return _FrictionFedCascade(
        axis,
        _reference_friction(data, axis),
        position_gain=0.5 * bandwidth / damping,
        velocity_gain=2.0 * damping * bandwidth * velocity_lag(axis) - 1.0,
        velocity_max=1.2 * data.limits.velocity,
        noise=ObserverNoise.of_bandwidth(axis, observer, _reading_error(data)),
        **common,
    )


def _pid(data: AxisData, settings: Mapping[str, float]) -> AxisController:
    axis, common = _common(data)
    bandwidth, estimator = _bandwidths(data, axis, settings)
    lag, gain = velocity_lag(axis), abs(axis.gain)
    proportional = bandwidth * bandwidth * lag / gain
    return _FrictionFedPid(
        axis,
        _reference_friction(data, axis),
        proportional=proportional,
        integral=proportional * estimator / 3.0,
        derivative=(2.0 * _damping(axis, bandwidth, settings) * bandwidth * lag - 1.0) / gain,
        rate_lag=max(0.2 * response_lag(axis), axis.period),
        integral_band=inf,
        **common,
    )


AXIS_CONTROLLERS: Mapping[str, Callable[[AxisData, Mapping[str, float]], AxisController]] = (
    MappingProxyType(
        {
            'pid': _pid,
            'cascade': _cascade,
            'linear_tangent': _linear_tangent,
            'variable_universe': _variable_universe,
        }
    )
)
"""Controllers for any axis by name, the simplest first."""

WITH_RULES = 'variable_universe'
"""The one among them that has rules."""

UNTUNED_CONTROLLER = 'pid'
"""Controller of an axis that nothing is said about and that nothing was tuned on."""


def _common(data: AxisData) -> tuple[LinearAxis, dict[str, Any]]:
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
    return axis, {'duty_max': plant.duty_max, 'limits': limits}


def _bandwidths(
    data: AxisData, axis: LinearAxis, settings: Mapping[str, float]
) -> tuple[float, float]:
    """Return the natural frequencies of loop and observer, below a resonance [rad/s]."""
    bandwidth = settings['bandwidth'] * default_crossover(axis)
    observer = settings['estimator'] * bandwidth
    if data.limits.resonance:
        most = 2.0 * pi * data.limits.resonance / _BELOW_RESONANCE
        # What is damped more acts as fast as the damping says.
        bandwidth = min(bandwidth, most / max(settings['damping'], 1.0))
        observer = min(observer, 3.0 * most)
    return bandwidth, observer


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


def _reference_friction(data: AxisData, axis: LinearAxis) -> ReferenceFriction:
    sign = 1.0 if axis.gain > 0.0 else -1.0
    forward, backward = _friction(data)
    return ReferenceFriction(sign * forward, sign * backward)


def _reading_error(data: AxisData) -> float:
    """Return the RMS of a reading's error [m]."""
    plant = data.known_plant()
    return sqrt(plant.count * plant.count / 12.0 + plant.noise * plant.noise) or 1e-8


def _relief(data: AxisData) -> StickSlipParams:
    plant = data.known_plant()
    return StickSlipParams.for_sensor(plant.count, plant.noise)
