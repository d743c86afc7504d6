# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the variable-universe controller and their checks [long2014]."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from math import isfinite

import numpy as np

from fuzzycnc_ros.core.servo.axis import LinearAxis, response_lag, velocity_lag
from fuzzycnc_ros.core.servo.rule_table import RuleTable, published_rules

_DAMPING = 1.32
"""Damping of the loop of the lathe axis under the production parameters [-]."""

_RATE_PER_SPEED = 0.94036 / 0.286
"""Rate range over speed at full duty of the production parameters [-]."""


class ServoParamsWarning(UserWarning):
    """Parameters that are allowed, but that an axis may not settle with."""


@dataclass(frozen=True, kw_only=True)
class VariableUniverseParams:
    """Universes, contraction and rules of the controller.

    An input s on its universe from -1 to 1 is contracted to s / (|s|^exponent + floor).

    Parameters
    ----------
    error_range, rate_range : float
        Error [m] and error rate [m/s] at the ends of the universes; beyond they count as that.
    error_exponent, rate_exponent, output_exponent : float
        Exponents of the contraction, above 0, at most 1.
    error_floor, rate_floor, output_floor : float
        Its floors, above 0.  `output_exponent` and `output_floor` matter to the published
        recursion alone.
    output_gain : float
        Duty per output of the rules [-]; the duty is cut afterwards.
    rules : RuleTable
        Consequents.

    Raises
    ------
    ValueError
        If a number is out of its range.

    Notes
    -----
    The defaults were found by differential evolution on the
    lathe axis with gains from half to one and a half times nominal.  `published` gives the
    source's own numbers, `minimal` the smallest change of them that settles without friction.
    """

    error_range: float = 0.190
    rate_range: float = 0.94036
    error_exponent: float = 0.68588
    rate_exponent: float = 0.92834
    error_floor: float = 0.072693
    rate_floor: float = 0.19040
    output_gain: float = 2.58666
    output_exponent: float = 0.9
    output_floor: float = 1e-4
    rules: RuleTable = field(default_factory=published_rules)

    def __post_init__(self) -> None:
        for name in ('error_range', 'rate_range', 'error_floor', 'rate_floor', 'output_floor'):
            self._check(name, 0.0 < getattr(self, name), 'a positive number')
        for name in ('error_exponent', 'rate_exponent', 'output_exponent'):
            self._check(name, 0.0 < getattr(self, name) <= 1.0, 'more than 0, at most 1,')
        self._check('output_gain', self.output_gain > 0.0, 'a positive number')

    def _check(self, name: str, good: bool, expected: str) -> None:
        """Refuse a number that is out of its range or not finite."""
        value = getattr(self, name)
        if not (good and isfinite(value)):
            raise ValueError(
                f'VariableUniverseParams: {name}: expected {expected} but found {value}'
            )

    @classmethod
    def published(cls, rules: RuleTable | None = None) -> VariableUniverseParams:
        """Return the published numbers of [long2014]; the rate range per second."""
        return cls(
            rate_range=0.2587,
            error_exponent=0.9,
            rate_exponent=0.9,
            error_floor=1e-4,
            rate_floor=1e-4,
            output_gain=1.0,
            rules=rules or published_rules(),
        )

    @classmethod
    def minimal(cls) -> VariableUniverseParams:
        """Return the published numbers with floors that settle."""
        return replace(cls.published(), error_floor=0.04, rate_floor=0.5)

    @classmethod
    def model_free(cls) -> VariableUniverseParams:
        """Return settings for rate and integral from readings alone.

        Found by differential evolution on steps of the lathe axis with friction, gains from half
        to one and a half times nominal and a step of load.
        """
        return cls(
            rate_range=0.168,
            error_exponent=0.584,
            rate_exponent=0.593,
            error_floor=0.0349,
            rate_floor=0.868,
            output_gain=2.345,
        )

    @classmethod
    def for_axis(
        cls, axis: LinearAxis, crossover: float | None = None, *, damping: float = _DAMPING
    ) -> VariableUniverseParams:
        """Return the production parameters with universes that fit another axis.

        Near the target the controller is a proportional-derivative one, which closes the loop of
        the axis, taken as gain and lag, at a crossover.  The rate's universe is as wide against
        the speed at full duty as on the lathe axis: a narrower one cannot tell fast from faster
        and brakes too late (on the EMPS axis a step of 10 mm then overshoots by 5.7 mm, with
        this one not at all).  Exponents, floors and rules stay.

        Parameters
        ----------
        axis : LinearAxis
            Nominal model.
        crossover : float, optional
            Natural frequency of the closed loop [rad/s]; by default `default_crossover`.
        damping : float
            Its damping [-].

        Raises
        ------
        ValueError
            If the lag of the axis alone damps the loop more than that.

        Examples
        --------
        >>> lags = {'amplifier': 8e-4, 'torque': 1.5e-3}
        >>> axis = LinearAxis.chain(0.286, lags, 0.017, sensor_lag=6e-3, period=1e-3)
        >>> params = VariableUniverseParams.for_axis(axis, 69.2)
        >>> f'{params.error_range:.2f} {params.rate_range:.2f} {params.output_gain:.1f}'
        '0.19 0.94 2.6'
        """
        crossover = default_crossover(axis) if crossover is None else crossover
        lag = velocity_lag(axis)
        per_error = crossover * crossover * lag / abs(axis.gain)
        per_rate = (2.0 * damping * crossover * lag - 1.0) / abs(axis.gain)
        if not per_rate > 0.0:
            raise ValueError(
                f'crossover: expected more than {0.5 / (damping * lag):.4g} rad/s but found '
                f'{crossover} rad/s; the axis damps itself more than asked for'
            )
        plain = cls()
        error_slope, rate_slope = plain.rules.slopes
        rate_range = _RATE_PER_SPEED * abs(axis.gain)
        output_gain = per_rate * rate_range * plain.rate_floor / rate_slope
        return replace(
            plain,
            error_range=error_slope * output_gain / (plain.error_floor * per_error),
            rate_range=rate_range,
            output_gain=output_gain,
        )

    @property
    def error_gain(self) -> float:
        """Duty per error at the origin [1/m]."""
        slope = self.rules.slopes[0] * self.output_gain
        return slope / (self.error_range * self.error_floor)

    @property
    def rate_gain(self) -> float:
        """Duty per error rate at the origin [s/m]."""
        slope = self.rules.slopes[1] * self.output_gain
        return slope / (self.rate_range * self.rate_floor)

    def warn_about(self, axis: LinearAxis) -> None:
        """Warn where the parameters do not suit an axis.

        Warns
        -----
        ServoParamsWarning
            If the rate range looks like a displacement per sample, or the linear loop at the
            origin swings.
        """
        if settles(axis, self.error_gain, self.rate_gain):
            return
        if self.rate_range < 0.2 * abs(axis.gain):
            warnings.warn(
                f'rate_range: expected at least a fifth of the speed at full duty, '
                f'{abs(axis.gain):.4g} m/s, but found {self.rate_range:.4g} m/s; is it a '
                'displacement per sample?',
                ServoParamsWarning,
                stacklevel=3,
            )
            return
        floor = self.error_floor * self.error_gain / ultimate_gain(axis)
        warnings.warn(
            f'error_floor, rate_floor: expected a loop that settles near the target, but found '
            f'floors {self.error_floor} and {self.rate_floor}; without rate action the first '
            f'has to be {floor:.3g} or more',
            ServoParamsWarning,
            stacklevel=3,
        )


def default_crossover(axis: LinearAxis) -> float:
    """Return a frequency that an unknown axis should stand [rad/s].

    0.15 over the lags of drive and sensor and one and a half periods of sampling and holding: a
    quarter of what the tuned lathe axis runs at.
    """
    return 0.15 / (response_lag(axis) + 1.5 * axis.period)


def settles(axis: LinearAxis, error_gain: float, rate_gain: float) -> bool:
    """Return True if the sampled loop around an axis settles.

    Parameters
    ----------
    axis : LinearAxis
        Nominal model.
    error_gain, rate_gain : float
        Duty per error [1/m] and per error rate [s/m] of the reading.
    """
    dynamics, duty, _ = axis.discrete()
    sign = 1.0 if axis.gain > 0.0 else -1.0
    feedback = sign * (error_gain * axis.c + rate_gain * (axis.c @ axis.a))
    closed = dynamics - np.outer(duty, feedback)
    return bool(np.abs(np.linalg.eigvals(closed)).max() < 1.0)


def ultimate_gain(axis: LinearAxis) -> float:
    """Return the proportional gain at which the sampled position loop begins to swing [1/m].

    Examples
    --------
    >>> lags = {'amplifier': 8e-4, 'torque': 1.5e-3}
    >>> axis = LinearAxis.chain(0.286, lags, 0.017, sensor_lag=6e-3, period=1e-3)
    >>> round(ultimate_gain(axis))
    497
    """
    low, high = 0.0, 1.0 / abs(axis.gain)
    while settles(axis, high, 0.0):
        low, high = high, 2.0 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if settles(axis, middle, 0.0) else (low, middle)
    return high
