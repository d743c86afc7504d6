# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A driven axis as it can be told from its command and its position: a mass with friction."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np
from scipy.signal import lfilter

from fuzzycnc_ros.core.arrays import Array


@dataclass(frozen=True, kw_only=True)
class AxisModel:
    """Motion per command: dv/dt = gain u - viscous v - coulomb sign(v) - offset.

    Forces are divided by the mass, which position and command alone do not tell.

    Attributes
    ----------
    gain : float
        Acceleration per command [m/s^2 per unit of the command].
    viscous_forward, viscous_backward : float
        Viscous friction over mass in positive and negative motion [1/s].
    coulomb : float
        Coulomb friction over mass [m/s^2].
    offset : float
        Steady deceleration, friction that differs by direction included [m/s^2].
    delay : float
        Dead time between command and force [s].
    drive_lag : float
        Time constant of the force [s].
    """

    gain: float
    viscous_forward: float
    viscous_backward: float
    coulomb: float
    offset: float
    delay: float = 0.0
    drive_lag: float = 0.0

    def simulate(
        self, command: Array, period: float, position: float = 0.0, velocity: float = 0.0
    ) -> Array:
        """Return the positions that a course of commands gives, open loop.

        Between two samples the linear part is followed exactly; Coulomb friction takes its
        impulse afterwards and stops the axis where it exceeds what is left.

        Parameters
        ----------
        command : ndarray, shape (n,)
            Commands, each held for a period.
        period : float
            Time between them [s].
        position, velocity : float
            Motion at the first sample [m, m/s].

        Returns
        -------
        ndarray, shape (n,)
            Positions at the samples [m].

        Examples
        --------
        >>> model = AxisModel(
        ...     gain=0.37, viscous_forward=2.1, viscous_backward=2.1, coulomb=0.21, offset=0.0
        ... )
        >>> f'{model.simulate(np.full(1001, 2.0), 1e-3)[-1]:.3f}'
        '0.147'
        """
        push = (self.gain * self._acting(command, period) - self.offset).tolist()
        forward = _held(self.viscous_forward, period)
        backward = _held(self.viscous_backward, period)
        half = 0.5 * period
        (keep_f, gain_f), (keep_b, gain_b) = forward, backward
        friction_f, friction_b = self.coulomb * gain_f, self.coulomb * gain_b
        place, speed = position, velocity
        course: list[float] = []
        add = course.append
        for force in push:
            add(place)
            if speed > 0.0 or (speed == 0.0 and force > 0.0):
                after, friction = speed * keep_f + force * gain_f, friction_f
            else:
                after, friction = speed * keep_b + force * gain_b, friction_b
            if after > friction:
                after -= friction
            elif after < -friction:
                after += friction
            else:
                after = 0.0
            place += half * (speed + after)
            speed = after
        return np.array(course)

    def _acting(self, command: Array, period: float) -> Array:
        """Return what drives in each period: the command after dead time and lag."""
        acting = np.asarray(command, dtype=np.float64)
        if self.delay > 0.0:
            whole, part = divmod(self.delay / period, 1.0)
            late = int(whole)
            padded = np.concatenate([np.full(late + 1, acting[0]), acting])
            acting = (1.0 - part) * padded[1 : 1 + len(acting)] + part * padded[: len(acting)]
        if self.drive_lag > 0.0:
            keep = exp(-period / self.drive_lag)
            mean = (1.0 - keep) * self.drive_lag / period
            start = acting[0]
            # the lagged value at the beginning of each period, then its mean over the period
            state = lfilter([0.0, 1.0 - keep], [1.0, -keep], acting - start) + start
            acting = acting + (state - acting) * mean
        return acting


def _held(viscous: float, period: float) -> tuple[float, float]:
    """Return what a period keeps of the velocity, and what an acceleration held for it adds."""
    if abs(viscous) * period < 1e-9:
        return 1.0, period
    keep = exp(-viscous * period)
    return keep, (1.0 - keep) / viscous
