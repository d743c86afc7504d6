# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Linear model of a driven axis: what its controllers and observers know of it."""

from __future__ import annotations

from dataclasses import dataclass
from math import frexp, isfinite

import numpy as np

from fuzzycnc_ros.core import portable
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
        held = exponential(whole * self.period)
        return held[:size, :size], held[:size, size], held[:size, size + 1]


_TERMS = 20
"""Terms of the series, of which the last is below 1e-24 for a matrix of half."""


def exponential(matrix: Array) -> Array:
    """Return the exponential of a matrix: of a small part by its series, squared up again."""
    halvings = max(0, frexp(float(np.abs(matrix).sum(axis=1).max()))[1] + 1)
    part = np.ldexp(matrix, -halvings)
    found = term = np.eye(len(matrix))
    for order in range(1, _TERMS):
        term = portable.matmul(term, part) / order
        found = found + term
    for _ in range(halvings):
        found = portable.matmul(found, found)
    return found


def velocity_lag(axis: LinearAxis) -> float:
    """Return the time constant of an axis' mechanics [s]."""
    velocity = axis.states.index('velocity')
    return -1.0 / float(axis.a[velocity, velocity])


def response_lag(axis: LinearAxis) -> float:
    """Return the lags of drive and sensor together [s]."""
    lags = [-1.0 / float(rate) for rate in np.diag(axis.a) if rate]
    return sum(lags) - velocity_lag(axis)
