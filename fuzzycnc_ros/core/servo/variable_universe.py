# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The variable-universe fuzzy position controller of Long, Yuan, Xu and Du (2014), repaired.

Error and rate are each divided by a scale that shrinks with them, so that the same 36 rules zoom
in near the target.  Each surface of duty over error and rate is there twice, for arrays and as a
function of two numbers for the control loop, where numpy would take longer than the rules.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.core.servo.constants import Constant
from fuzzycnc_ros.core.servo.controller import AxisController, ControllerStatus
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.filtered_rate import STILL, FilteredRate, Integrator, differenced_law
from fuzzycnc_ros.core.servo.friction import MovingDisturbance
from fuzzycnc_ros.core.servo.observer import DisturbanceObserver, ObserverNoise, observed_law
from fuzzycnc_ros.core.servo.params import VariableUniverseParams, default_crossover
from fuzzycnc_ros.core.servo.stick_slip import StickSlipParams, StickSlipRelief

Law = Callable[[float, float], float]
"""Duty [-] at an error [m] and error rate [m/s]."""


class ContractedSurface:
    """The rules on universes that shrink with what lies on them.

    Parameters
    ----------
    params : VariableUniverseParams
        Universes and rules.
    direction : float
        Sign of the axis' gain; 1 or -1.

    Attributes
    ----------
    law : callable
        The surface at one error [m] and error rate [m/s].
    """

    CONTRACTS = True

    def __init__(self, params: VariableUniverseParams, direction: float) -> None:
        self._params = params
        # the table is written for an axis that positive duty drives to negative positions
        self._scale = -direction * params.output_gain
        self.law = self._law()

    def inputs(self, error: ArrayLike, rate: ArrayLike) -> tuple[Array, Array]:
        """Return errors [m] and error rates [m/s] on their universes [-]."""
        p = self._params
        e = np.clip(np.asarray(error, dtype=np.float64) / p.error_range, -1.0, 1.0)
        c = np.clip(np.asarray(rate, dtype=np.float64) / p.rate_range, -1.0, 1.0)
        return (
            np.asarray(e / (portable.power(np.abs(e), p.error_exponent) + p.error_floor)),
            np.asarray(c / (portable.power(np.abs(c), p.rate_exponent) + p.rate_floor)),
        )

    def duty(self, error: ArrayLike, rate: ArrayLike) -> Array:
        """Return the duties [-] at errors [m] and error rates [m/s], which broadcast."""
        return np.asarray(self._scale * self._params.rules.surface(*self.inputs(error, rate)))

    def constants(self) -> list[Constant]:
        """Return the numbers that it computes with."""
        p = self._params
        return [
            Constant('OUTPUT_SCALE', self._scale, '-', 'Duty of the whole output, with its sign'),
            Constant('PER_ERROR', 1.0 / p.error_range, '1/m', 'Error on its universe'),
            Constant('PER_RATE', 1.0 / p.rate_range, 's/m', 'Rate on its universe'),
            Constant(
                'ERROR_EXPONENT', p.error_exponent, '-', 'How the universe of the error shrinks'
            ),
            Constant('RATE_EXPONENT', p.rate_exponent, '-', 'How that of the rate does'),
            Constant('ERROR_FLOOR', p.error_floor, '-', 'Least of the universe of the error'),
            Constant('RATE_FLOOR', p.rate_floor, '-', 'Least of that of the rate'),
        ]

    def _law(self) -> Law:
        p, scale = self._params, self._scale
        infer = p.rules.infer
        per_error, per_rate = 1.0 / p.error_range, 1.0 / p.rate_range
        error_exponent, rate_exponent = p.error_exponent, p.rate_exponent
        error_floor, rate_floor = p.error_floor, p.rate_floor

        def law(error: float, rate: float) -> float:
            e = error * per_error
            e = 1.0 if e > 1.0 else -1.0 if e < -1.0 else e
            c = rate * per_rate
            c = 1.0 if c > 1.0 else -1.0 if c < -1.0 else c
            x = e / (portable.power(abs(e), error_exponent) + error_floor)
            return scale * infer(x, c / (portable.power(abs(c), rate_exponent) + rate_floor))

        return law


class LinearSurface(ContractedSurface):
    """The tangent of the contracted surface at the target: proportional and derivative action.

    It is what the rules come down to near the target.
    """

    def duty(self, error: ArrayLike, rate: ArrayLike) -> Array:
        """Return the duties [-] at errors [m] and error rates [m/s], which broadcast."""
        p, way = self._params, -np.sign(self._scale)
        return np.asarray(
            way * (p.error_gain * np.asarray(error) + p.rate_gain * np.asarray(rate))
        )

    def constants(self) -> list[Constant]:
        """Return the numbers that it computes with."""
        p, way = self._params, -np.sign(self._scale).item()
        return [
            Constant('ERROR_GAIN', way * p.error_gain, '1/m', 'Duty per error'),
            Constant('RATE_GAIN', way * p.rate_gain, 's/m', 'Duty per error rate'),
        ]

    def _law(self) -> Law:
        way = -np.sign(self._scale).item()
        per_error, per_rate = way * self._params.error_gain, way * self._params.rate_gain
        return lambda error, rate: per_error * error + per_rate * rate


class FixedSurface(ContractedSurface):
    """The rules on universes that do not shrink; floors and exponents are of no use here.

    What the contraction is worth shows beside it: an ablation.
    """

    CONTRACTS = False

    def inputs(self, error: ArrayLike, rate: ArrayLike) -> tuple[Array, Array]:
        """Return errors [m] and error rates [m/s] on their universes [-]."""
        p = self._params
        return (
            np.clip(np.asarray(error, dtype=np.float64) / p.error_range, -1.0, 1.0),
            np.clip(np.asarray(rate, dtype=np.float64) / p.rate_range, -1.0, 1.0),
        )

    def _law(self) -> Law:
        p, scale = self._params, self._scale
        rules = p.rules
        per_error, per_rate = 1.0 / p.error_range, 1.0 / p.rate_range
        return lambda error, rate: scale * rules(error * per_error, rate * per_rate)


MODES = ('production', 'static', 'paper_literal')
"""Modes of the controller; the first is the default."""

_MOVING = 1e-3
"""Velocity above which an axis is surely in motion [m/s]."""

_HIDDEN = 2.0
"""Friction that is believed to hide forces at rest over the known one [-]."""

_RELIEF = StickSlipParams()


class VariableUniverseController(AxisController):
    """Variable-universe fuzzy controller of one axis [long2014].

    Parameters
    ----------
    axis : LinearAxis
        Nominal model of the axis.
    params : VariableUniverseParams, optional
        Universes and rules; by default those of the mode.
    mode : {'production', 'static', 'paper_literal'}
        `production` adds what disturbs the axis and feeds the trajectory forward, and relieves
        stick-slip at rest.  `static` is the published surface alone, output unscaled.
        `paper_literal` is the published recursion, whose output scale follows the last output.
    observer : bool
        Whether `production` sees rate and disturbance through an observer of the axis, the
        default, or without any model: rate from filtered differences, disturbance from an
        integral.
    noise : ObserverNoise, optional
        What the observer expects.
    stick_slip : StickSlipParams or None
        Relief from stick-slip hunting in `production`; None for none.
    rate_lag : float, optional
        Filter of the differences [s]; of no use with the observer.  By default 1 ms, and none for
        `paper_literal`: the source has none, and so its figures come out.
    integral_gain, integral_band : float
        Gain of the integral [1/(m s)] and error up to which it acts [m]; of no use with the
        observer.
    surface : type of ContractedSurface
        What becomes of the rules.
    settle : float
        Time of motion after which the observer has found the disturbance [s].
    friction, duty_max, duty_slew, limits
        As `AxisController`.

    Attributes
    ----------
    axis, mode, params, period, duty_max
        As given.
    law : callable
        The surface at one error [m] and error rate [m/s], as `surface` gives it for arrays.
    watch : FeedbackWatch
        Judge of the readings.

    Raises
    ------
    ValueError
        If the mode is unknown or a number is out of its range.

    Warns
    -----
    ServoParamsWarning
        If the parameters do not suit the axis; not for the published numbers.

    Notes
    -----
    What is published: the rules, the contraction of both inputs and the recursion of the output.
    With the published floors the recursion crawls (11 s for 50 mm), and without it the axis swings
    by millimetres; there is no integral action, so friction and load leave it off target.
    `production` therefore has larger floors, no recursion, an observed disturbance and
    feedforward; the relief from stick-slip is our own.  With an observer the contraction is worth
    little: on a `FixedSurface` the same rules position as well, and `CascadeController` follows
    trajectories more closely.

    The observer is told of the friction that is fed forward: it sees the duty without it, so that
    only what the model does not know ends up in the observed disturbance.  Nothing is made up for
    twice, and at a reversal the observer need not first unlearn the friction of the way there.
    Where the reference sets off again the observer goes on from what it saw in motion of that
    direction, see `MovingDisturbance`; friction that differs from the known one is learnt by that,
    too.

    Duty has the sign of `axis.gain`: the source's positive duty drives to negative positions.

    Examples
    --------
    >>> lags = {'amplifier': 8e-4, 'torque': 1.5e-3}
    >>> axis = LinearAxis.chain(0.286, lags, 0.017, sensor_lag=6e-3, period=1e-3)
    >>> controller = VariableUniverseController(axis)
    >>> controller.reset(position=0.0)
    >>> controller.step(0.0, 0.0), controller.step(0.05, 0.0)
    (0.0, 1.0)
    """

    def __init__(
        self,
        axis: LinearAxis,
        params: VariableUniverseParams | None = None,
        *,
        mode: str = 'production',
        observer: bool = True,
        noise: ObserverNoise | None = None,
        stick_slip: StickSlipParams | None = _RELIEF,
        rate_lag: float | None = None,
        integral_gain: float = 2000.0,
        integral_band: float = 3e-4,
        surface: type[ContractedSurface] = ContractedSurface,
        settle: float = 0.0125,
        **limits: Any,
    ) -> None:
        if mode not in MODES:
            raise ValueError(f'mode: expected one of {", ".join(MODES)} but found {mode!r}')
        super().__init__(axis, **limits)
        self.mode = mode
        self.params = params or _default_params(mode, observer)
        if mode != 'paper_literal' and surface.CONTRACTS:  # the published ones do not suit
            self.params.warn_about(self.axis)
        production = mode == 'production'
        self.observer = DisturbanceObserver(axis, noise) if production and observer else None
        if rate_lag is None:
            rate_lag = 0.0 if mode == 'paper_literal' else 1e-3
        self._rate = FilteredRate(rate_lag, axis.period)
        self._integral = Integrator(
            self._direction * integral_gain if production and not observer else 0.0,
            axis.period,
            dead_zone=1.12 * self.watch.limits.count,
            band=integral_band,
            still=STILL,
        )
        self._relief = (
            StickSlipRelief(stick_slip, axis.period) if production and stick_slip else None
        )
        self._surface = surface(self.params, self._direction)
        self.law = self._surface.law
        self._per_velocity = 1.0 / axis.gain if production else 0.0
        self._per_acceleration = axis.lag * self._per_velocity
        self._error = self._error_rate = self._disturbance = self._output = 0.0
        self._hides = _HIDDEN * max(abs(one) for one in limits.get('friction', (0.0,)))
        self._going = 0  # direction of the reference in the last period
        self._moving = MovingDisturbance(axis.period, settle)
        self._first = True

    @classmethod
    def for_axis(
        cls,
        axis: LinearAxis,
        *,
        count: float,
        noise: float = 0.0,
        travel: float = 0.5,
        crossover: float | None = None,
        stick_slip: StickSlipParams | None = None,
        duty_max: float = 1.0,
    ) -> VariableUniverseController:
        """Return the production controller for an axis that nothing has been tuned on.

        Universes, observer and limits follow from the nominal model and the sensor.

        Parameters
        ----------
        axis : LinearAxis
            Nominal model.
        count, noise : float
            One count of the sensor and RMS of its noise [m]; not both 0.
        travel : float
            Travel of the axis [m].
        crossover : float, optional
            Natural frequency of the position loop [rad/s]; by default `default_crossover`.
        stick_slip : StickSlipParams, optional
            Relief from stick-slip; none by default, since its amplitudes and bands are a matter of
            friction and sensor, which the model does not know.
        duty_max : float
            Largest magnitude of duty [-].

        Examples
        --------
        >>> axis = LinearAxis.chain(1.73, {}, 0.467, period=1e-3)
        >>> controller = VariableUniverseController.for_axis(axis, count=5e-8)
        >>> round(controller.params.error_gain), round(controller.params.rate_gain)
        (2699, 71)
        """
        crossover = default_crossover(axis) if crossover is None else crossover
        return cls(
            axis,
            VariableUniverseParams.for_axis(axis, crossover),
            noise=ObserverNoise.for_axis(axis, crossover, count=count, noise=noise),
            stick_slip=stick_slip,
            limits=FeedbackLimits.of(axis, count=count, noise=noise, travel=travel),
            duty_max=duty_max,
        )

    @property
    def status(self) -> ControllerStatus:
        """State in the last period; `disturbance` is observed or integrated."""
        x, y = self.contracted(self._error, self._error_rate)
        cuts = self.params.rules.centres[1:-1]
        return ControllerStatus(
            error=self._error,
            error_rate=self._error_rate,
            contracted_error=float(x),
            contracted_rate=float(y),
            cell=(bisect_right(cuts, float(x)), bisect_right(cuts, float(y))),
            factor=self._factor() if self.mode == 'paper_literal' else 1.0,
            disturbance=self._disturbance,
            duty=self._duty,
            saturated=self._saturated,
            rest=self._relief.state if self._relief else '',
            bad=self.watch.bad,
            bad_total=self.watch.bad_total,
            fault=self.watch.fault,
        )

    def surface(self, error: ArrayLike, rate: ArrayLike) -> Array:
        """Return the duty of the rules alone, uncut and without the recursion.

        Parameters
        ----------
        error, rate : array_like
            Errors [m] and error rates [m/s]; their shapes broadcast.

        Returns
        -------
        ndarray
            Duties [-] in the shape of the inputs.
        """
        return self._surface.duty(error, rate)

    def feedforward(self, velocity: Array, acceleration: Array) -> Array:
        """Return the duties [-] for motions of the reference [m/s, m/s^2]; 0 in other modes."""
        return velocity * self._per_velocity + acceleration * self._per_acceleration

    def estimates(self, position: Array, duty: Array) -> tuple[Array, Array, Array]:
        """Return what the controller would have seen of a recorded run; its own state is kept.

        Parameters
        ----------
        position, duty : ndarray, shape (n,)
            Readings [m] and duties [-], one per control period, from rest.

        Returns
        -------
        position, velocity, disturbance : ndarray, shape (n,)
            Estimates [m, m/s, -]; without an observer the readings, their filtered differences
            and no disturbance.
        """
        readings, duties = position.tolist(), duty.tolist()
        if self.observer is None:
            rate = FilteredRate(self._rate.lag, self.period)
            rate.reset(readings[0])
            return position, np.array([rate.of(one) for one in readings]), np.zeros(len(readings))
        observer = copy(self.observer)
        observer.reset(readings[0], 0.0)
        rows = []
        for reading, held in zip(readings, duties, strict=True):
            rows.append((observer.position, observer.velocity, observer.disturbance))
            observer.advance(held, reading)
        place, speed, disturbance = np.array(rows).T
        return place, speed, disturbance

    def feedback_law(self) -> tuple[Array, Array, Array, float]:
        """Return the law near the target; see `AxisController`."""
        return self.linear_law(self.params.error_gain, self.params.rate_gain)

    def linear_law(self, error_gain: float, rate_gain: float) -> tuple[Array, Array, Array, float]:
        """Return the law from reading to duty with linear gains instead of the rules.

        Parameters
        ----------
        error_gain, rate_gain : float
            Duty per error [1/m] and error rate [s/m].

        Returns
        -------
        inner : ndarray, shape (k, k)
            Transition of the law's own states in a period.
        entry, row : ndarray, shape (k,)
            What a reading adds to them, and what duty they give.
        direct : float
            Duty that a reading gives at once [1/m].
        """
        error_gain, rate_gain = self._direction * error_gain, self._direction * rate_gain
        if self.observer is not None:
            return observed_law(self.observer.design, error_gain, rate_gain)
        return differenced_law(self._rate, self._integral, error_gain, rate_gain, self.period)

    def contracted(self, error: ArrayLike, rate: ArrayLike) -> tuple[Array, Array]:
        """Return errors [m] and error rates [m/s] on their contracted universes [-]."""
        return self._surface.inputs(error, rate)

    @property
    def surface_type(self) -> type[ContractedSurface]:
        """Kind of its surface."""
        return type(self._surface)

    def constants(self) -> list[Constant]:
        """Return the numbers that the controller computes with."""
        relief = self._relief or StickSlipRelief(StickSlipParams(amplitude_max=0.0), self.period)
        design = self.observer.design.constants() if self.observer is not None else []
        return [
            *super().constants(),
            Constant(
                'PER_VELOCITY', self._per_velocity, 's/m', 'Duty per velocity of the reference'
            ),
            Constant('PER_ACCELERATION', self._per_acceleration, 's2/m', 'Duty per acceleration'),
            Constant('HIDDEN', self._hides, '-', 'Disturbance that friction hides at rest'),
            Constant('MOVING', _MOVING, 'm/s', 'Speed from which on the axis moves'),
            Constant(
                'RELIEVES', self._relief is not None, '', 'Whether an axis that is stuck is helped'
            ),
            *self._surface.constants(),
            *self._moving.constants(),
            *relief.constants(),
            *design,
        ]

    def _restart(self, position: float, duty: float) -> None:
        """Begin at rest at a position [m] that a duty [-] holds."""
        self._error = self._error_rate = 0.0
        self._disturbance = self._output = duty
        self._first = True
        self._going = 0
        self._moving.reset(duty)
        self._rate.reset(position)
        self._integral.reset(duty)
        if self.observer is not None:
            self.observer.reset(position, duty)
        if self._relief is not None:
            self._relief.reset(position)

    def _wanted(
        self, reference: float, position: float, velocity: float, acceleration: float
    ) -> float:
        """Return the duty [-] that is wanted, whatever the limits."""
        observer = self.observer
        if self._known is not None:
            motion = velocity or acceleration
            self._friction = self._known.of(velocity, acceleration, self._error)
            if motion and observer is not None:
                self._learn(observer, self._known.way, velocity)
            self._going = self._known.way if motion else 0
        if observer is None:
            error = self._error = reference - position
            rate = self._error_rate = velocity - self._rate.of(position)
            if self.mode == 'paper_literal':
                return self._recursion(error, rate)
            disturbance = self._integral.value
        else:
            state = observer.state
            error = self._error = reference - state[observer.position_place]
            rate = self._error_rate = velocity - state[observer.velocity_place]
            disturbance = state[-1]
        self._disturbance = disturbance
        wanted = self.law(error, rate) + disturbance + self._friction
        relief = self._relief
        if velocity or acceleration:
            if relief is not None:
                relief.release()
            return wanted + velocity * self._per_velocity + acceleration * self._per_acceleration
        if relief is None:
            return wanted
        return relief.duty(reference, position, wanted, self._duty)

    def _learn(self, observer: DisturbanceObserver, way: int, velocity: float) -> None:
        """Have the observer set off with what was seen in motion, and see what there is to see."""
        if not self._going:
            # At rest the observer is off by what friction takes; a load beyond that is seen.
            seen, rest, hidden = self._moving.recall(way), observer.state[-1], self._hides
            observer.state = (*observer.state[:-1], min(max(seen, rest - hidden), rest + hidden))
        slowest = min(way * velocity, way * observer.state[observer.velocity_place])
        if slowest > _MOVING and self._going == way:
            self._moving.learn(way, observer.state[-1])
        else:
            self._moving.rest()

    def _recursion(self, error: float, rate: float) -> float:
        """Return the published output, scaled by a power of the last one."""
        if not self._first:
            output = self._factor() * self.law(error, rate)
        else:  # all three factors are 1
            p = self.params
            e, c = error / p.error_range, rate / p.rate_range
            output = -self._direction * p.output_gain * p.rules(e, c)
        self._first = False
        self._output = output
        return output

    def _factor(self) -> float:
        """Return the scale of the output's universe [-] that the next output gets."""
        return (
            portable.power(abs(self._output), self.params.output_exponent)
            + self.params.output_floor
        )

    def _commit(self, duty: float, position: float) -> None:
        """Go on to the next period, in which the duty [-] as limited is held."""
        if self.observer is not None:
            self.observer.advance(duty - self._friction, position)
        else:
            self._integral.add(self._error, self._rate.value, self._saturated, duty)

    def _bridge(self, duty: float) -> None:
        """Go on to the next period without a reading."""
        if self.observer is not None:
            self.observer.coast(duty - self._friction)
        else:
            self._rate.coast()


def _default_params(mode: str, observer: bool) -> VariableUniverseParams:
    """Return what a mode is meant to run with."""
    if mode == 'paper_literal':
        return VariableUniverseParams.published()
    if mode == 'static':
        return VariableUniverseParams.minimal()
    return VariableUniverseParams() if observer else VariableUniverseParams.model_free()
