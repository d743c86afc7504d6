# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What every simulated linear axis is: a plant that holds a duty for one control period."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from math import copysign, exp, isfinite

import numpy as np
from scipy.linalg import expm

from fuzzycnc_ros.core.arrays import Array


@dataclass(frozen=True, eq=False)
class LinearAxis:
    """Nominal linear model of an axis: dx/dt = a x + b duty + e disturbance, measured = c x.

    Attributes
    ----------
    a : ndarray, shape (n, n)
        Dynamics [1/s].
    b : ndarray, shape (n,)
        Entry of the duty.
    c : ndarray, shape (n,)
        Row that gives the measured position [m].
    disturbance : ndarray, shape (n,)
        Entry of a disturbance in units of duty: a steady disturbance of 0.1 is held by a duty
        that is larger by 0.1.
    states : tuple of str
        Names of the states; `velocity` [m/s] and `position` [m] are always among them.
    period : float
        Control period [s].
    gain : float
        Steady velocity per duty [m/s], negative where positive duty drives to negative positions.
    lag : float
        Sum of the lags between duty and velocity [s], so that the duty for a motion is
        (velocity + lag * acceleration) / gain.
    """

    a: Array
    b: Array
    c: Array
    disturbance: Array
    states: tuple[str, ...]
    period: float
    gain: float
    lag: float

    @classmethod
    def chain(
        cls,
        gain: float,
        drive_lags: dict[str, float],
        velocity_lag: float,
        *,
        sensor_lag: float = 0.0,
        period: float,
    ) -> LinearAxis:
        """Return the model of first-order lags in a row, an integrator and a sensor.

        Parameters
        ----------
        gain : float
            Steady velocity per duty [m/s]; not zero.
        drive_lags : dict of str to float
            Names and time constants of the lags ahead of the mechanics [s], in order; positive.
        velocity_lag : float
            Time constant of the mechanics, where friction and load enter [s]; positive.
        sensor_lag : float
            Time constant of the sensor [s]; 0 leaves its state out.
        period : float
            Control period [s]; positive.

        Returns
        -------
        LinearAxis
            Model with the states `*drive_lags`, `velocity`, `position` and, if it lags, `sensor`.

        Raises
        ------
        ValueError
            If the gain is zero or a time is out of its range.

        Examples
        --------
        >>> axis = LinearAxis.chain(0.286, {'amplifier': 8e-4}, 0.017, period=1e-3)
        >>> axis.states
        ('amplifier', 'velocity', 'position')
        >>> axis.a[1].round(3).tolist()
        [16.824, -58.824, 0.0]
        """
        if not (isfinite(gain) and gain):
            raise ValueError(f'gain: expected a finite number other than 0 but found {gain} m/s')
        times = {**drive_lags, 'velocity_lag': velocity_lag, 'period': period}
        for name, time in times.items():
            if not (isfinite(time) and time > 0.0):
                raise ValueError(f'{name}: expected more than 0 s but found {time} s')
        if not (isfinite(sensor_lag) and sensor_lag >= 0.0):
            raise ValueError(f'sensor_lag: expected 0 s or more but found {sensor_lag} s')
        names = (*drive_lags, 'velocity', 'position', *(['sensor'] if sensor_lag else []))
        size, velocity = len(names), len(drive_lags)
        a, b, c, disturbance = np.zeros((size, size)), *np.zeros((3, size))
        for index, time in enumerate((*drive_lags.values(), velocity_lag)):
            strength = (gain if index == velocity else 1.0) / time
            a[index, index] = -1.0 / time
            if index:
                a[index, index - 1] = strength
            else:
                b[0] = strength
        disturbance[velocity] = -gain / velocity_lag
        a[velocity + 1, velocity] = 1.0
        if sensor_lag:
            a[-1, -2:] = 1.0 / sensor_lag, -1.0 / sensor_lag
        c[-1] = 1.0
        lag = sum(drive_lags.values()) + velocity_lag
        return cls(a, b, c, disturbance, names, period, gain, lag)

    def discrete(self) -> tuple[Array, Array, Array]:
        """Return dynamics, duty entry and disturbance entry of one period, inputs held.

        Returns
        -------
        dynamics : ndarray, shape (n, n)
            Exact transition over a period.
        duty, disturbance : ndarray, shape (n,)
            What a duty or disturbance held over the period adds.

        Examples
        --------
        >>> axis = LinearAxis.chain(0.286, {}, 0.017, period=1e-3)
        >>> dynamics, duty, disturbance = axis.discrete()
        >>> f'{dynamics[0, 0]:.6f} {duty[0]:.6f} {disturbance[0]:.6f}'
        '0.942873 0.016338 -0.016338'
        """
        size = len(self.a)
        whole = np.zeros((size + 2, size + 2))
        whole[:size, :size] = self.a
        whole[:size, size], whole[:size, size + 1] = self.b, self.disturbance
        held = expm(whole * self.period)
        return held[:size, :size], held[:size, size], held[:size, size + 1]


def velocity_lag(axis: LinearAxis) -> float:
    """Return the time constant of an axis' mechanics [s]."""
    velocity = axis.states.index('velocity')
    return -1.0 / float(axis.a[velocity, velocity])


def response_lag(axis: LinearAxis) -> float:
    """Return the lags of drive and sensor together [s]."""
    lags = [-1.0 / float(rate) for rate in np.diag(axis.a) if rate]
    return sum(lags) - velocity_lag(axis)


class DutyDelay:
    """Dead time between the duty that is commanded and the one that drives.

    A dead time that is no whole number of periods takes the mean of the two duties that act in a
    period, weighted by how long each does.

    Parameters
    ----------
    delay : float
        Dead time [s]; not negative.
    period : float
        Control period [s].

    Examples
    --------
    >>> delay = DutyDelay(1.5e-3, 1e-3)
    >>> [delay.of(duty) for duty in (1.0, 1.0, 1.0, 1.0)]
    [0.0, 0.5, 1.0, 1.0]
    """

    def __init__(self, delay: float, period: float) -> None:
        whole, part = divmod(delay / period, 1.0)
        self._part = part if part > 1e-9 else 0.0
        size = round(whole) + 1 + (self._part > 0.0)
        self._held = deque([0.0] * size, maxlen=size)

    def of(self, duty: float) -> float:
        """Return what drives in the period for which a duty [-] is commanded."""
        held = self._held
        held.append(duty)
        if not self._part:
            return held[0]
        return self._part * held[0] + (1.0 - self._part) * held[1]


class AxisPlant(ABC):
    """One driven linear axis; a control period is `measure`, then `drive`.

    The course of positions depends on the configuration, its seed and the duties alone.

    Attributes
    ----------
    period : float
        Control period [s].
    duty_max : float
        Largest magnitude of duty that the drive takes [-]; more is cut.
    """

    period: float
    duty_max: float

    @property
    @abstractmethod
    def position(self) -> float:
        """True position of the slide [m]."""

    @property
    @abstractmethod
    def velocity(self) -> float:
        """True velocity of the slide [m/s]."""

    @abstractmethod
    def measure(self) -> float:
        """Return the position as the sensor gives it now [m]; NaN while it gives none.

        Asked again before the next `drive` it says the same.
        """

    @abstractmethod
    def drive(self, duty: float) -> None:
        """Hold a duty for one period.

        Parameters
        ----------
        duty : float
            Share of the drive's range [-]; cut at `duty_max`.

        Raises
        ------
        ValueError
            If the duty is not finite.  The state is unchanged.
        """

    @abstractmethod
    def linear(self) -> LinearAxis:
        """Return the nominal linear model: without friction, load, faults and gain changes."""

    def _cut(self, duty: float) -> float:
        """Return a duty within the drive's range."""
        if not isfinite(duty):
            raise ValueError(f'duty: expected a finite number but found {duty}')
        return min(max(duty, -self.duty_max), self.duty_max)


def stribeck_friction(
    velocity: float, drive: float, coulomb: float, breakaway: float, stribeck_velocity: float
) -> float:
    """Return what friction takes from the drive, in the drive's unit.

    At rest friction balances any drive up to the breakaway value; in motion, or above it, it is
    (coulomb + (breakaway - coulomb) exp(-(v/vs)^2)) against the motion.

    Parameters
    ----------
    velocity : float
        Velocity v [m/s]; exactly 0 is rest.
    drive : float
        What drives the axis, load already taken off.
    coulomb, breakaway : float
        Friction in fast motion and at the onset of motion, in the drive's unit; not negative.
    stribeck_velocity : float
        Velocity vs over which friction falls from one to the other [m/s]; positive.

    Returns
    -------
    float
        Friction, to be subtracted from the drive; the drive itself while the axis sticks.

    Examples
    --------
    >>> stribeck_friction(0.0, -0.025, 0.02, 0.03, 2e-3)
    -0.025
    >>> stribeck_friction(0.0, 0.04, 0.02, 0.03, 2e-3)
    0.03
    >>> round(stribeck_friction(-2e-3, 0.0, 0.02, 0.03, 2e-3), 6)
    -0.023679
    """
    if velocity == 0.0:
        return drive if abs(drive) <= breakaway else copysign(breakaway, drive)
    ratio = velocity / stribeck_velocity
    return copysign(coulomb + (breakaway - coulomb) * exp(-ratio * ratio), velocity)


def stribeck_frictions(
    velocity: Array, drive: Array, coulomb: Array, breakaway: Array, stribeck_velocity: Array
) -> Array:
    """Return `stribeck_friction` of many axes at once; all arguments of shape (cases,)."""
    ratio = velocity / stribeck_velocity
    moving = np.copysign(coulomb + (breakaway - coulomb) * np.exp(-ratio * ratio), velocity)
    return np.where(velocity == 0.0, np.clip(drive, -breakaway, breakaway), moving)
