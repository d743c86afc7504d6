# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What every simulated linear axis is: a plant that holds a duty for one control period."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from math import copysign, exp, isfinite

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.axis import LinearAxis


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
