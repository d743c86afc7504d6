# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rate and disturbance without a model: filtered differences and a conditional integral."""

from __future__ import annotations

from math import inf, isfinite

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.constants import Constant

STILL = 2e-3
"""Speed up to which an axis off its target counts as stuck [m/s]: three counts per period."""


class FilteredRate:
    """Rate of a reading, from its differences through a first-order filter.

    A count of 0.625 um in 1 ms is 0.625 mm/s, which contraction takes for a medium rate: raw
    differences must not reach the rules.

    Parameters
    ----------
    lag : float
        Time constant of the filter [s]; 0 for none.
    period : float
        Time between readings [s].

    Attributes
    ----------
    lag : float
        Time constant of the filter [s].
    share : float
        Share of a new difference in the rate [-].
    """

    def __init__(self, lag: float, period: float) -> None:
        if not (isfinite(lag) and lag >= 0.0):
            raise ValueError(f'rate_lag: expected 0 s or more but found {lag} s')
        self.lag = lag
        self.share = (1.0 - portable.exp(-period / lag)) if lag else 1.0
        self._frequency = 1.0 / period
        self._period = period
        self.reset(0.0)

    def reset(self, position: float) -> None:
        """Start at rest at a position [m]."""
        self._last, self._value = position, 0.0

    def of(self, position: float) -> float:
        """Return the rate [m/s] after one more reading [m]."""
        change = (position - self._last) * self._frequency
        self._last = position
        self._value += (change - self._value) * self.share
        return self._value

    @property
    def value(self) -> float:
        """Rate after the last reading [m/s]."""
        return self._value

    def constants(self) -> list[Constant]:
        """Return the numbers that it computes with."""
        return [
            Constant('FREQUENCY', self._frequency, '1/s', 'Control periods in a second'),
            Constant('RATE_SHARE', self.share, '-', 'Share of a new difference in the rate'),
        ]

    def coast(self) -> None:
        """Go on without a reading, at the same rate."""
        self._last += self._value * self._period


class Integrator:
    """Integral of the error that neither winds up nor chases single counts.

    Parameters
    ----------
    gain : float
        Duty per error and time [1/(m s)], with the sign of the axis; 0 for no integral.
    period : float
        Control period [s].
    dead_zone : float
        Error within which nothing is added [m].
    band : float
        Error beyond which nothing is added while the axis moves [m]: on a long way there is
        always an error.
    still : float
        Speed up to which an axis counts as stuck, so that errors beyond the band are added too
        [m/s].  Without that a load that pushes it out of the band leaves an offset for good.

    Attributes
    ----------
    value : float
        The integral [-], as duty.
    gain : float
        What an error adds per period [1/m].
    """

    def __init__(
        self,
        gain: float,
        period: float,
        *,
        dead_zone: float = 0.0,
        band: float = inf,
        still: float = 0.0,
    ) -> None:
        if not isfinite(gain):
            raise ValueError(f'integral_gain: expected a finite number but found {gain} 1/(m s)')
        self.gain = gain * period
        if not 0.0 <= dead_zone < band:
            raise ValueError(
                f'integral_band: expected more than the dead zone, {dead_zone} m, but found '
                f'{band} m'
            )
        self._dead_zone, self._band, self._still = dead_zone, band, still
        self.value = 0.0

    def reset(self, value: float) -> None:
        """Start from a value [-], as duty."""
        self.value = value

    def constants(self) -> list[Constant]:
        """Return the numbers that it computes with."""
        return [
            Constant(
                'INTEGRAL', self.gain, '1/m', 'What an error adds to the integral in a period'
            ),
            Constant('DEAD_ZONE', self._dead_zone, 'm', 'Error within which nothing is added'),
            Constant(
                'INTEGRAL_BAND', self._band, 'm', 'Error beyond which nothing is added in motion'
            ),
            Constant(
                'STUCK_SPEED', self._still, 'm/s', 'Speed up to which the axis counts as stuck'
            ),
        ]

    def add(self, error: float, speed: float, saturated: bool, duty: float) -> None:
        """Add an error [m] at a speed [m/s], unless that took a cut duty [-] even further."""
        size = abs(error)
        if size <= self._dead_zone or (size > self._band and abs(speed) > self._still):
            return
        growth = self.gain * error
        if not saturated or growth * duty < 0.0:
            self.value += growth


def differenced_law(
    rate: FilteredRate, integral: Integrator, error_gain: float, rate_gain: float, period: float
) -> tuple[Array, Array, Array, float]:
    """Return the law of a filtered rate and an integral; see `AxisController.feedback_law`.

    Parameters
    ----------
    rate, integral
        What the controller has; dead zone and band of the integral are left out.
    error_gain, rate_gain : float
        Duty per error [1/m] and error rate [s/m], with the sign of the axis.
    period : float
        Control period [s].
    """
    # states: last reading, filtered rate, integral
    share, grow = rate.share, integral.gain
    fast = share / period
    inner = np.array([[0.0, 0.0, 0.0], [-fast, 1.0 - share, 0.0], [0.0, 0.0, 1.0]])
    row = np.array([rate_gain * fast, -rate_gain * (1.0 - share), 1.0])
    entry, direct = np.array([1.0, fast, -grow]), -error_gain - rate_gain * fast
    kept = 3 if grow else 2
    return inner[:kept, :kept], entry[:kept], row[:kept], direct
