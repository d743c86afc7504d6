# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Steady-state Kalman predictor of an axis and of the disturbance that acts on its drive.

The disturbance is a random walk in units of duty; load, friction and a changed gain all end up in
it.  One period is plain arithmetic, written out for the axes that there are: numpy starts up anew
for every product of a small matrix, and loops over its rows take five times what the products
take.  The axis is a chain, in which nothing acts on what lies ahead of it: its dynamics are a
lower triangle, and the sums over its rows can be written out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, sqrt

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.axis import LinearAxis, velocity_lag
from fuzzycnc_ros.core.servo.constants import Constant

Predict = Callable[[tuple[float, ...], float, float], tuple[float, ...]]
"""Predictor of one period: states with the disturbance last, duty and reading in, states out."""


_Rows = list[list[float]]


def predictor(dynamics: Array, duty: Array, reading: Array, gain: Array) -> Predict:
    """Return x -> dynamics x + duty u + gain (y - reading x) as a function of tuples.

    Parameters
    ----------
    dynamics : ndarray, shape (n, n)
        Transition of one period; the disturbance is the last state.
    duty, reading, gain : ndarray, shape (n,)
        Entry of the duty, row that gives the reading, and what a difference between reading and
        prediction adds.

    Returns
    -------
    callable
        Written out for chains of 2 to 5 states that are read at their end; loops for others.

    Examples
    --------
    >>> dynamics = np.array([[0.9, 0.0, -0.1], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]])
    >>> duty, reading, gain = np.array([0.1, 0.0, 0.0]), np.eye(3)[1], np.array([0.0, 0.5, 0.0])
    >>> step = predictor(dynamics, duty, reading, gain)
    >>> step((1.0, 0.0, 2.0), 3.0, 4.0)
    (1.0, 2.5, 2.0)
    """
    size = len(dynamics) - 1
    unit = np.eye(size + 1)
    chain = (
        size in _CHAINS
        and not np.triu(dynamics[:-1, :-1], 1).any()
        and np.array_equal(dynamics[-1], unit[-1])
        and np.array_equal(reading, unit[-2])
        and not duty[-1]
    )
    if not chain:
        return _loops(dynamics, duty, reading, gain)
    # per row: what the states up to it, disturbance, duty and difference add
    columns = np.column_stack([dynamics[:-1, -1], duty[:-1], gain[:-1]]).tolist()
    rows = [[*dynamics[i, : i + 1].tolist(), *columns[i]] for i in range(size)]
    return _CHAINS[size](rows, float(gain[-1]))


def _loops(dynamics: Array, duty: Array, reading: Array, gain: Array) -> Predict:
    """Return the predictor of any model."""
    inner = dynamics - np.outer(gain, reading)
    rows = np.column_stack([inner, duty, gain]).tolist()

    def step(state: tuple[float, ...], u: float, y: float) -> tuple[float, ...]:
        known = (*state, u, y)
        return tuple(sum(k * x for k, x in zip(row, known, strict=True)) for row in rows)

    return step


def _chain_2(rows: _Rows, wander: float) -> Predict:
    a00, d0, u0, g0 = rows[0]
    a10, a11, d1, u1, g1 = rows[1]

    def step(state: tuple[float, ...], u: float, y: float) -> tuple[float, ...]:
        x0, x1, d = state
        s = y - x1
        return (
            a00 * x0 + d0 * d + u0 * u + g0 * s,
            a10 * x0 + a11 * x1 + d1 * d + u1 * u + g1 * s,
            d + wander * s,
        )

    return step


def _chain_3(rows: _Rows, wander: float) -> Predict:
    a00, d0, u0, g0 = rows[0]
    a10, a11, d1, u1, g1 = rows[1]
    a20, a21, a22, d2, u2, g2 = rows[2]

    def step(state: tuple[float, ...], u: float, y: float) -> tuple[float, ...]:
        x0, x1, x2, d = state
        s = y - x2
        return (
            a00 * x0 + d0 * d + u0 * u + g0 * s,
            a10 * x0 + a11 * x1 + d1 * d + u1 * u + g1 * s,
            a20 * x0 + a21 * x1 + a22 * x2 + d2 * d + u2 * u + g2 * s,
            d + wander * s,
        )

    return step


def _chain_4(rows: _Rows, wander: float) -> Predict:
    a00, d0, u0, g0 = rows[0]
    a10, a11, d1, u1, g1 = rows[1]
    a20, a21, a22, d2, u2, g2 = rows[2]
    a30, a31, a32, a33, d3, u3, g3 = rows[3]

    def step(state: tuple[float, ...], u: float, y: float) -> tuple[float, ...]:
        x0, x1, x2, x3, d = state
        s = y - x3
        return (
            a00 * x0 + d0 * d + u0 * u + g0 * s,
            a10 * x0 + a11 * x1 + d1 * d + u1 * u + g1 * s,
            a20 * x0 + a21 * x1 + a22 * x2 + d2 * d + u2 * u + g2 * s,
            a30 * x0 + a31 * x1 + a32 * x2 + a33 * x3 + d3 * d + u3 * u + g3 * s,
            d + wander * s,
        )

    return step


def _chain_5(rows: _Rows, wander: float) -> Predict:
    a00, d0, u0, g0 = rows[0]
    a10, a11, d1, u1, g1 = rows[1]
    a20, a21, a22, d2, u2, g2 = rows[2]
    a30, a31, a32, a33, d3, u3, g3 = rows[3]
    a40, a41, a42, a43, a44, d4, u4, g4 = rows[4]

    def step(state: tuple[float, ...], u: float, y: float) -> tuple[float, ...]:
        x0, x1, x2, x3, x4, d = state
        s = y - x4
        return (
            a00 * x0 + d0 * d + u0 * u + g0 * s,
            a10 * x0 + a11 * x1 + d1 * d + u1 * u + g1 * s,
            a20 * x0 + a21 * x1 + a22 * x2 + d2 * d + u2 * u + g2 * s,
            a30 * x0 + a31 * x1 + a32 * x2 + a33 * x3 + d3 * d + u3 * u + g3 * s,
            a40 * x0 + a41 * x1 + a42 * x2 + a43 * x3 + a44 * x4 + d4 * d + u4 * u + g4 * s,
            d + wander * s,
        )

    return step


_CHAINS: dict[int, Callable[[_Rows, float], Predict]] = {
    2: _chain_2,
    3: _chain_3,
    4: _chain_4,
    5: _chain_5,
}


@dataclass(frozen=True, kw_only=True)
class ObserverNoise:
    """Noise levels of the observer; its gain depends on their ratios alone.

    Parameters
    ----------
    sensor : float
        RMS of the reading's error [m]; for a sensor that counts, count / sqrt(12) and its noise
        together.
    disturbance : float
        How fast the disturbance wanders [1/sqrt(s)], as duty.
    velocity : float
        How fast the velocity wanders for other reasons [m/s/sqrt(s)].

    Raises
    ------
    ValueError
        If `sensor` or `disturbance` is not positive or `velocity` is negative.

    Notes
    -----
    The defaults give the gain that the controller's defaults were tuned with, to 2e-4.
    """

    sensor: float = 2.0628e-7
    disturbance: float = 4.3765e-3
    velocity: float = 8.5984e-5

    def __post_init__(self) -> None:
        for name in ('sensor', 'disturbance'):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0.0):
                raise ValueError(f'{name}: expected a positive number but found {value}')
        if not (isfinite(self.velocity) and self.velocity >= 0.0):
            raise ValueError(f'velocity: expected 0 or more but found {self.velocity} m/s/sqrt(s)')

    @classmethod
    def for_axis(
        cls, axis: LinearAxis, crossover: float, *, count: float, noise: float = 0.0
    ) -> ObserverNoise:
        """Return what gives the observer of an axis the bandwidth that suits its controller.

        Parameters
        ----------
        axis : LinearAxis
            Nominal model.
        crossover : float
            Natural frequency of the position loop [rad/s]; the observer gets 3.2 times that,
            as on the lathe axis of [long2014].
        count, noise : float
            One count of the sensor and RMS of its noise [m]; not both 0.

        Examples
        --------
        >>> lags = {'amplifier': 8e-4, 'torque': 1.5e-3}
        >>> axis = LinearAxis.chain(0.286, lags, 0.017, sensor_lag=6e-3, period=1e-3)
        >>> found = ObserverNoise.for_axis(axis, 69.2, count=0.625e-6, noise=0.1e-6)
        >>> f'{found.disturbance:.1e} {found.velocity:.1e}'
        '4.2e-03 1.3e-03'
        """
        return cls.of_bandwidth(axis, 3.2 * crossover, sqrt(count * count / 12.0 + noise * noise))

    @classmethod
    def of_bandwidth(
        cls, axis: LinearAxis, bandwidth: float, sensor: float = 1e-8
    ) -> ObserverNoise:
        """Return what an observer of an axis expects if it is to have a bandwidth.

        The disturbance wanders as fast as makes the observer of a plain mass a Butterworth filter
        of that bandwidth, and the velocity as fast as twice the bandwidth needs: believing the
        model's velocity alone costs the closed loop 15 degrees of its phase margin.

        Parameters
        ----------
        axis : LinearAxis
            Nominal model.
        bandwidth : float
            Natural frequency of the observer [rad/s]; positive.
        sensor : float
            RMS of the reading's error [m]; positive.  The observer's gain does not depend on it.

        Raises
        ------
        ValueError
            If the bandwidth or the sensor's error is not positive.

        Examples
        --------
        >>> axis = LinearAxis.chain(1.73, {}, 0.467, period=1e-3)
        >>> found = ObserverNoise.of_bandwidth(axis, 240.0, 5e-8 / 12**0.5)
        >>> f'{found.disturbance:.2e} {found.velocity:.2e}'
        '1.70e-03 1.05e-04'
        """
        if not (isfinite(bandwidth) and bandwidth > 0.0):
            raise ValueError(f'bandwidth: expected a positive number but found {bandwidth} rad/s')
        density = sensor * sqrt(axis.period)
        acceleration = abs(axis.gain) / velocity_lag(axis)  # per duty
        return cls(
            sensor=sensor,
            disturbance=bandwidth * bandwidth * bandwidth * density / acceleration,
            velocity=4.0 * bandwidth * bandwidth * density,
        )


@dataclass(frozen=True, eq=False)
class ObserverDesign:
    """Discrete model of an axis with its disturbance, and the predictor's gain.

    Attributes
    ----------
    dynamics : ndarray, shape (n, n)
        Transition of one period; the disturbance is the last state.
    duty : ndarray, shape (n,)
        Entry of the duty held over a period.
    reading : ndarray, shape (n,)
        Row that gives the measured position.
    gain : ndarray, shape (n,)
        What a metre between reading and prediction adds to the next prediction.
    position, velocity : int
        Places of the two among the states.
    """

    dynamics: Array
    duty: Array
    reading: Array
    gain: Array
    position: int
    velocity: int

    @classmethod
    def of(cls, axis: LinearAxis, noise: ObserverNoise | None = None) -> ObserverDesign:
        """Return the design for an axis: exact discretisation, gain from the Riccati equation.

        Examples
        --------
        >>> lags = {'amplifier': 8e-4, 'torque': 1.5e-3}
        >>> axis = LinearAxis.chain(0.286, lags, 0.017, sensor_lag=6e-3, period=1e-3)
        >>> ObserverDesign.of(axis).gain[2:].round(2).tolist()
        [89.6, 0.73, 0.37, -558.61]
        """
        expected = noise or ObserverNoise()
        held, duty, disturbance = axis.discrete()
        size = len(held) + 1
        dynamics = np.eye(size)
        dynamics[:-1, :-1], dynamics[:-1, -1] = held, disturbance
        reading, entry = np.append(axis.c, 0.0), np.append(duty, 0.0)
        position, velocity = axis.states.index('position'), axis.states.index('velocity')
        wander = np.zeros((size, size))
        wander[-1, -1] = expected.disturbance * expected.disturbance * axis.period
        wander[velocity, velocity] = expected.velocity * expected.velocity * axis.period
        # solved in units in which the reading's error is 1: micrometres squared underflow
        unit = expected.sensor
        covariance = _prediction_covariance(dynamics, reading, wander / (unit * unit))
        seen = portable.matmul(covariance, reading)
        gain = portable.matmul(dynamics, seen) / (portable.matmul(reading, seen) + 1.0)
        return cls(dynamics, entry, reading, gain, position, velocity)

    def constants(self) -> list[Constant]:
        """Return the numbers that it computes with."""
        return [
            Constant('DISTURBANCE_GAIN', self.gain[-1], '1/m', 'Correction of disturbance'),
            Constant('POSITION', self.position, '', 'Place of the position among the states'),
            Constant('VELOCITY', self.velocity, '', 'Place of the velocity'),
        ]


_DOUBLINGS = 40
"""Most doublings; an hour at a period of 1 ms are 22."""


def _prediction_covariance(dynamics: Array, reading: Array, wander: Array) -> Array:
    """Return the covariance of the steady Kalman predictor for a reading of variance 1.

    It solves the discrete Riccati equation by doubling: after k steps it is that of 2^k periods.

    Notes
    -----
    Chu, Fan, Lin and Wang, Structure-preserving algorithms for periodic discrete-time algebraic
    Riccati equations, Int. J. Control 77 (2004): algorithm SDA.
    """
    one = np.eye(len(dynamics))
    onward, known, covariance = dynamics.T, np.outer(reading, reading), wander
    for _ in range(_DOUBLINGS):
        both = portable.solve(one + portable.matmul(known, covariance), np.hstack([onward, known]))
        later, told = both[:, : len(one)], both[:, len(one) :]
        known = known + portable.matmul(portable.matmul(onward, told), onward.T)
        more = portable.matmul(portable.matmul(onward.T, covariance), later)
        onward = portable.matmul(onward, later)
        covariance = covariance + 0.5 * (more + more.T)
        if np.abs(more).max() <= 1e-17 * np.abs(covariance).max():
            break
    return covariance


def observed_law(
    design: ObserverDesign, error_gain: float, rate_gain: float
) -> tuple[Array, Array, Array, float]:
    """Return the law of gains on an observer's states; see `AxisController.feedback_law`.

    Parameters
    ----------
    design : ObserverDesign
        The observer.
    error_gain, rate_gain : float
        Duty per error [1/m] and error rate [s/m], with the sign of the axis.
    """
    row = np.zeros(len(design.duty))
    row[design.position], row[design.velocity], row[-1] = -error_gain, -rate_gain, 1.0
    inner = design.dynamics - np.outer(design.gain, design.reading)
    return inner + np.outer(design.duty, row), design.gain, row, 0.0


class DisturbanceObserver:
    """Running predictor; `position`, `velocity` and `disturbance` hold at the next reading.

    Parameters
    ----------
    axis : LinearAxis
        Nominal model.
    noise : ObserverNoise, optional
        What to expect.

    Attributes
    ----------
    state : tuple of float
        Predicted states, in the order of the axis, and last the disturbance.
    position_place, velocity_place : int
        Places of the two in `state`, for loops in which a property's call counts.

    Examples
    --------
    >>> axis = LinearAxis.chain(0.286, {}, 0.017, period=1e-3)
    >>> observer = DisturbanceObserver(axis)
    >>> observer.reset(0.05, 0.0)
    >>> observer.advance(0.0, 0.05)
    >>> round(observer.position, 12), observer.velocity
    (0.05, 0.0)
    """

    def __init__(self, axis: LinearAxis, noise: ObserverNoise | None = None) -> None:
        self.design = ObserverDesign.of(axis, noise)
        design = self.design
        model = design.dynamics, design.duty, design.reading
        self._advance = predictor(*model, design.gain)
        self._coast = predictor(*model, np.zeros_like(design.gain))
        self._axis = axis
        self.position_place, self.velocity_place = self.design.position, self.design.velocity
        self.reset(0.0, 0.0)

    @property
    def position(self) -> float:
        """Predicted position [m]."""
        return self.state[self.design.position]

    @property
    def velocity(self) -> float:
        """Predicted velocity [m/s]."""
        return self.state[self.design.velocity]

    @property
    def disturbance(self) -> float:
        """Predicted disturbance [-], as duty."""
        return self.state[-1]

    def reset(self, position: float, duty: float) -> None:
        """Start at rest at a position [m], where a duty [-] just holds the disturbance."""
        axis = self._axis
        # at rest the drive's own states stand where the held duty puts them
        rest = []
        for name in axis.states:
            if name == 'velocity':
                rest.append(0.0)
            elif name in ('position', 'sensor'):
                rest.append(position)
            else:
                rest.append(duty)
        self.state = (*rest, duty)

    def advance(self, duty: float, reading: float) -> None:
        """Predict one period further from the duty [-] that is held and the reading [m]."""
        self.state = self._advance(self.state, duty, reading)

    def coast(self, duty: float) -> None:
        """Predict one period further without a reading."""
        self.state = self._coast(self.state, duty, 0.0)
