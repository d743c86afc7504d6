# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""PID controller and P-PI cascade of an axis.

Their defaults are for the lathe axis of [long2014]: found by differential evolution on steps
from 20 um to 190 mm with friction, gains from half to one and a half times nominal and a step of
load, then rounded, the PID's integral band widened to be above the dip under that load.  The
settings of the published comparators are not known.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.core.servo.constants import Constant
from fuzzycnc_ros.core.servo.controller import AxisController, ControllerStatus
from fuzzycnc_ros.core.servo.filtered_rate import STILL, FilteredRate, Integrator, differenced_law
from fuzzycnc_ros.core.servo.observer import DisturbanceObserver, ObserverNoise, observed_law


class PidController(AxisController):
    """Proportional, integral, derivative, with filtered rate and conditional integration.

    Parameters
    ----------
    axis : LinearAxis
        Nominal model, for period, direction and limits alone.
    proportional : float
        Duty per error [1/m].
    integral : float
        Duty per error and time [1/(m s)]; errors of a single count are not integrated.
    derivative : float
        Duty per error rate [s/m].
    rate_lag : float
        Filter of the rate [s].
    integral_band : float
        Error beyond which nothing is integrated [m].
    feedforward : bool
        Whether velocity and acceleration of the reference are fed forward.
    sensor_lag : float
        Lag of the sensor that is made up for [s]: an axis that follows well is read late by it.
    **limits
        As `AxisController`.
    """

    def __init__(
        self,
        axis: LinearAxis,
        *,
        proportional: float = 295.0,
        integral: float = 2990.0,
        derivative: float = 5.5,
        rate_lag: float = 1.1e-3,
        integral_band: float = 4e-4,
        feedforward: bool = True,
        sensor_lag: float = 0.0,
        **limits: Any,
    ) -> None:
        for name, value in (
            ('proportional', proportional),
            ('integral', integral),
            ('derivative', derivative),
        ):
            if not (isfinite(value) and value >= 0.0):
                raise ValueError(f'{name}: expected 0 or more but found {value}')
        super().__init__(axis, **limits)
        self._proportional = self._direction * proportional
        self._derivative = self._direction * derivative
        self._rate = FilteredRate(rate_lag, axis.period)
        self._integral = Integrator(
            self._direction * integral,
            axis.period,
            dead_zone=1.12 * self.watch.limits.count,
            band=integral_band,
            still=STILL,
        )
        self._late = sensor_lag
        self._per_velocity = 1.0 / axis.gain if feedforward else 0.0
        self._per_acceleration = axis.lag * self._per_velocity
        self._error = self._error_rate = 0.0

    def feedback_law(self) -> tuple[Array, Array, Array, float]:
        """Return the law from reading to duty; see `AxisController`."""
        return differenced_law(
            self._rate, self._integral, self._proportional, self._derivative, self.period
        )

    def constants(self) -> list[Constant]:
        """Return the numbers that the controller computes with."""
        return [
            *super().constants(),
            Constant('PROPORTIONAL', self._proportional, '1/m', 'Duty per error'),
            Constant('DERIVATIVE', self._derivative, 's/m', 'Duty per error rate'),
            Constant('SENSOR_LAG', self._late, 's', 'Lag of the sensor that is made up for'),
            Constant(
                'PER_VELOCITY', self._per_velocity, 's/m', 'Duty per velocity of the reference'
            ),
            Constant('PER_ACCELERATION', self._per_acceleration, 's2/m', 'Duty per acceleration'),
            *self._integral.constants(),
            *self._rate.constants(),
        ]

    @property
    def status(self) -> ControllerStatus:
        """State in the last period; `disturbance` is the integral."""
        return self._plain_status(self._error, self._error_rate, self._integral.value)

    def _restart(self, position: float, duty: float) -> None:
        self._rate.reset(position)
        self._integral.reset(duty)

    def _wanted(
        self, reference: float, position: float, velocity: float, acceleration: float
    ) -> float:
        if self._known is not None:
            self._friction = self._known.of(velocity, acceleration, self._error)
        if self._late:
            reference -= self._late * velocity
        error = self._error = reference - position
        rate = self._error_rate = velocity - self._rate.of(position)
        return (
            self._proportional * error
            + self._derivative * rate
            + self._integral.value
            + velocity * self._per_velocity
            + acceleration * self._per_acceleration
            + self._friction
        )

    def _commit(self, duty: float, position: float) -> None:
        self._integral.add(self._error, self._rate.value, self._saturated, duty)

    def _bridge(self, duty: float) -> None:
        self._rate.coast()


class CascadeController(AxisController):
    """Position loop around a velocity loop, with feedforward and the observer's disturbance.

    The observed disturbance stands for the velocity loop's integral: it acts at once and is not
    wound up by a limit.

    Parameters
    ----------
    axis : LinearAxis
        Nominal model.
    position_gain : float
        Velocity per error [1/s].
    velocity_gain : float
        Duty per error of velocity, as multiple of 1 / gain of the axis [-].
    velocity_max : float
        Largest velocity that the position loop asks for [m/s].
    noise : ObserverNoise, optional
        What the observer expects.
    **limits
        As `AxisController`.
    """

    def __init__(
        self,
        axis: LinearAxis,
        *,
        position_gain: float = 28.3,
        velocity_gain: float = 4.58,
        velocity_max: float = 0.274,
        noise: ObserverNoise | None = None,
        **limits: Any,
    ) -> None:
        for name, value in (
            ('position_gain', position_gain),
            ('velocity_gain', velocity_gain),
            ('velocity_max', velocity_max),
        ):
            if not value > 0.0:
                raise ValueError(f'{name}: expected a positive number but found {value}')
        super().__init__(axis, **limits)
        self._position_gain, self._velocity_max = position_gain, velocity_max
        self._inner = velocity_gain / axis.gain
        self._per_velocity = 1.0 / axis.gain
        self._per_acceleration = axis.lag / axis.gain
        self.observer = DisturbanceObserver(axis, noise)
        self._error = self._error_rate = 0.0

    def feedback_law(self) -> tuple[Array, Array, Array, float]:
        """Return the law from reading to duty; see `AxisController`."""
        rate_gain = self._inner
        error_gain = self._position_gain * (self._inner + self._per_velocity)
        return observed_law(self.observer.design, error_gain, rate_gain)

    def constants(self) -> list[Constant]:
        """Return the numbers that the controller computes with."""
        return [
            *super().constants(),
            Constant('POSITION_GAIN', self._position_gain, '1/s', 'Velocity per error'),
            Constant('VELOCITY_GAIN', self._inner, 's/m', 'Duty per error of velocity'),
            Constant(
                'VELOCITY_MAX',
                self._velocity_max,
                'm/s',
                'Velocity that the position loop asks for',
            ),
            Constant(
                'PER_VELOCITY', self._per_velocity, 's/m', 'Duty per velocity of the reference'
            ),
            Constant('PER_ACCELERATION', self._per_acceleration, 's2/m', 'Duty per acceleration'),
            *self.observer.design.constants(),
        ]

    @property
    def status(self) -> ControllerStatus:
        """State in the last period."""
        return self._plain_status(self._error, self._error_rate, self.observer.disturbance)

    def _restart(self, position: float, duty: float) -> None:
        self.observer.reset(position, duty)

    def _wanted(
        self, reference: float, position: float, velocity: float, acceleration: float
    ) -> float:
        if self._known is not None:
            self._friction = self._known.of(velocity, acceleration, self._error)
        observer = self.observer
        state = observer.state
        error = self._error = reference - state[observer.position_place]
        self._error_rate = velocity - state[observer.velocity_place]
        top = self._velocity_max
        asked = velocity + min(max(self._position_gain * error, -top), top)
        return (
            self._inner * (asked - state[observer.velocity_place])
            + asked * self._per_velocity
            + acceleration * self._per_acceleration
            + state[-1]
            + self._friction
        )

    def _commit(self, duty: float, position: float) -> None:
        self.observer.advance(duty - self._friction, position)

    def _bridge(self, duty: float) -> None:
        self.observer.coast(duty - self._friction)
