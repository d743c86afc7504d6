# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position and velocity loop of an axis, identified from commanded and actual positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log, sqrt
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter
from scipy.stats import t as student

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.identify.axis_fit import Parameter

_BLOCKS = 20
"""Blocks of a recording over which the uncertainty is judged."""

_DELAY_MAX = 0.05
"""Longest dead time that is looked for [s]."""


@dataclass(frozen=True)
class LoopFit:
    """Loops of an axis that follows a path.

    Attributes
    ----------
    position_gain : float
        Velocity asked for per position error [1/s].
    velocity_bandwidth : float
        Bandwidth of the velocity loop [rad/s].
    feedforward : float
        Share of the path's velocity that is fed forward [-].
    delay : float
        Dead time [s].
    parameters : tuple of Parameter
        The same with their 95 % intervals.
    rms, held_out_rms : float
        Error of the simulated position on all data, and on halves that a fit had not seen [m].
    """

    position_gain: float
    velocity_bandwidth: float
    feedforward: float
    delay: float
    parameters: tuple[Parameter, ...]
    rms: float
    held_out_rms: float

    @property
    def contour_constant(self) -> float:
        """Contour error per normal acceleration, C = (1 - f^2)/(2 Kv^2) - 1/(Kv w) [s^2].

        Negative where the axes overshoot a circle.
        """
        gain = self.position_gain
        own = 0.5 * (1.0 - self.feedforward**2) / gain**2
        return own - 1.0 / (gain * self.velocity_bandwidth)


_NAMES = ('position_gain', 'velocity_bandwidth', 'feedforward', 'delay')


def fit_loop(commanded: Array, actual: Array, period: float) -> LoopFit:
    """Identify how an axis follows its commanded positions, by output error.

    A proportional position loop around a first-order velocity loop, with velocity feedforward and
    a dead time.

    Parameters
    ----------
    commanded, actual : ndarray, shape (n,)
        Positions [m], a period apart.
    period : float
        Time between two samples [s].

    Raises
    ------
    ValueError
        If there are fewer than 200 samples, or the axis does not move.

    Examples
    --------
    >>> time = 1e-3 * np.arange(4000)
    >>> path = 0.02 * np.sin(3.0 * time)
    >>> found = fit_loop(path, following(path, 1e-3, (40.0, 250.0, 0.0, 2e-3)), 1e-3)
    >>> f'{found.contour_constant:.2e}'
    '2.12e-04'
    """
    if len(commanded) < 200:
        raise ValueError(f'expected 200 samples or more but found {len(commanded)}')
    if not np.ptp(commanded) > 0.0:
        raise ValueError('commanded: expected positions that change but found one throughout')
    if not np.ptp(actual) > 0.2 * float(np.ptp(commanded)):
        raise ValueError(
            f'actual: expected an axis that follows {1e3 * np.ptp(commanded):.4g} mm of commands '
            f'but found {1e3 * np.ptp(actual):.4g} mm of motion; is the unit the same?'
        )
    middle = len(commanded) // 2
    errors = []
    for train, judge in (
        (slice(0, middle), slice(middle, None)),
        (slice(middle, None), slice(0, middle)),
    ):
        point = _search(commanded[train], actual[train], period)
        errors.append(_error(point, commanded[judge], actual[judge], period))
    point = _search(commanded, actual, period)
    error = _error(point, commanded, actual, period)
    values = _values(point)
    return LoopFit(
        *values,
        parameters=_parameters(point, commanded, actual, period),
        rms=float(np.sqrt((error**2).mean())),
        held_out_rms=sqrt(float(np.mean(np.concatenate(errors) ** 2))),
    )


def following(commanded: Array, period: float, values: Sequence[float]) -> Array:
    """Return where an axis is that follows commanded positions, at rest before the first one.

    Parameters
    ----------
    commanded : ndarray, shape (n,)
        Positions [m].
    period : float
        Time between two of them [s].
    values : sequence of float, length 4
        Position gain [1/s], velocity bandwidth [rad/s], feedforward [-], dead time [s].
    """
    gain, bandwidth, forward, delay = values
    # without any feedforward SciPy warns of a numerator that begins with 0
    system = (
        [max(forward, 1e-9) * bandwidth, gain * bandwidth],
        [1.0, bandwidth, gain * bandwidth],
    )
    discrete: Any = cont2discrete
    numerator, denominator, _ = discrete(system, period, method='foh')
    whole, part = divmod(delay / period, 1.0)
    start = commanded[0]
    late = np.concatenate([np.zeros(int(whole) + 1), commanded - start])
    size = len(commanded)
    held = (1.0 - part) * late[1 : size + 1] + part * late[:size]
    return np.asarray(lfilter(numerator[0], denominator, held) + start)


def _error(point: Array, commanded: Array, actual: Array, period: float) -> Array:
    """Return actual less simulated positions, but for the beginning, where motion is unknown."""
    skip = min(len(commanded) // 10, round(0.3 / period))
    return np.asarray(actual - following(commanded, period, _values(point)))[skip:]


def _microns(point: Array, commanded: Array, actual: Array, period: float) -> Array:
    """Return the error in um: SciPy ends a search where numbers are small."""
    return 1e6 * _error(point, commanded, actual, period)


def _values(point: Array) -> tuple[float, float, float, float]:
    gain, bandwidth, forward, delay = point.tolist()
    return exp(gain), exp(bandwidth), forward, delay


_LOW = np.array([log(1.0), log(5.0), 0.0, 0.0])
_HIGH = np.array([log(2000.0), log(2e4), 1.0, _DELAY_MAX])


def _search(commanded: Array, actual: Array, period: float) -> Array:
    best: Any = None
    for gain, forward in ((40.0, 0.01), (40.0, 0.9)):
        start = np.array([log(gain), log(6.0 * gain), forward, period])
        search: Any = least_squares
        found = search(
            _microns,
            start,
            bounds=(_LOW, _HIGH),
            x_scale=[0.1, 0.1, 0.1, 1e-3],
            diff_step=1e-5,
            max_nfev=100,
            args=(commanded, actual, period),
        )
        if best is None or found.cost < best.cost:
            best = found
    return np.asarray(best.x)


def _parameters(
    point: Array, commanded: Array, actual: Array, period: float
) -> tuple[Parameter, ...]:
    """Return the parameters with 95 % intervals, errors of one block going together."""
    steps = np.array([1e-4, 1e-4, 1e-4, 1e-3 * period])
    columns = []
    for index, step in enumerate(steps.tolist()):
        above, below = point.copy(), point.copy()
        above[index] = min(point[index] + step, _HIGH[index])
        below[index] = max(point[index] - step, _LOW[index])
        pair = [_error(one, commanded, actual, period) for one in (above, below)]
        columns.append((pair[0] - pair[1]) / (above[index] - below[index]))
    slope, error = np.column_stack(columns), _error(point, commanded, actual, period)
    blocks = np.array_split(np.arange(len(error)), _BLOCKS)
    bread = np.linalg.pinv(slope.T @ slope, hermitian=True)
    pull = np.array([slope[rows].T @ error[rows] for rows in blocks])
    covariance = bread @ (pull.T @ pull) @ bread
    half = float(student.ppf(0.975, _BLOCKS - 1)) * np.sqrt(np.diag(covariance))
    found = []
    for index, (name, value, width) in enumerate(
        zip(_NAMES, point.tolist(), half.tolist(), strict=True)
    ):
        ends = (value - width, value, value + width)
        low, centre, high = (exp(min(end, 50.0)) for end in ends) if index < 2 else ends
        why = ''
        if index < 2 and high > 3.0 * max(low, 1e-12):
            why = 'these data do not show it; faster bends, or sharper corners, would'
        found.append(Parameter(name, centre, low, high, why))
    return tuple(found)
