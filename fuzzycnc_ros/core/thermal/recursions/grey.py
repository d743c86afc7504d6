# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The grey model GM(1,N) at run time: published time response and exact solution."""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, axes, first_order_lags


@dataclass(frozen=True, eq=False)
class GreyRecursion(Recursion):
    """Grey model of each channel, [ding_zeng] eqs. (15)-(16) or their exact solution.

    Parameters
    ----------
    exact : bool
        True solves [ding_zeng] eq. (12) as a recursion; False is the published response, eq. (15),
        which takes the drivers' sum for constant.
    a : ndarray, shape (c,)
        Development coefficient of each channel [-].
    b : ndarray, shape (c, p)
        Driving coefficients [m/K].
    initial : ndarray, shape (c,)
        First value y(1) of each channel [m].

    Notes
    -----
    The state is the sample number, then the accumulated drive and the previous value of each
    channel (accumulated for the published form, plain for the exact one).
    """

    FORM: ClassVar[str] = 'grey'

    exact: bool
    a: Array = field(metadata=axes('c'))
    b: Array = field(metadata=axes('c p'))
    initial: Array = field(metadata=axes('c'))

    def initial_state(self) -> Array:
        """Return the state before the first sample, shape (1 + 2c,)."""
        return np.zeros(1 + 2 * self.channels)

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        drive = portable.matmul(self.b, rise)
        number = state[0] + 1.0
        total = state[1 : 1 + self.channels] + drive
        previous = state[1 + self.channels :]
        # A form that diverges is meant to show it, as infinity, not to stop an evaluation.
        with np.errstate(all='ignore'):
            if self.exact:
                value = self._exact(number, drive, total, previous)
                kept = value
            else:
                steady = total / self.a
                kept = (self.initial - steady) * portable.exp(-self.a * (number - 1.0)) + steady
                value = kept - previous
        return value, np.concatenate([[number], total, kept])

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        drive = portable.matmul(rise, self.b.T)
        total = np.cumsum(drive, axis=0)
        with np.errstate(all='ignore'):
            if not self.exact:
                steady = total / self.a
                decay = portable.exp(-self.a * np.arange(len(rise))[:, np.newaxis])
                accumulated = (self.initial - steady) * decay + steady
                return np.diff(accumulated, axis=0, prepend=np.zeros((1, self.channels)))
            half = 1.0 + self.a / 2.0
            forced = drive / half
            forced[:1] = self.initial
            # The second value follows from eq. (12) itself, not from the difference form.
            start = (total[1:2] - self.a * self.initial) / half
            forced[1:2] = start - pole_of(self.a) * self.initial
            return first_order_lags(pole_of(self.a), forced)

    def with_interval(self, ratio: float) -> 'GreyRecursion':
        """Return the recursion for an interval `ratio` times as long.

        Raises
        ------
        ValueError
            If the pole of the exact form is negative: it alternates from sample to sample and
            has no meaning at another interval.
        """
        if not self.exact:
            return replace(self, a=self.a * ratio, b=self.b * ratio)
        pole = pole_of(self.a)
        if (pole < 0.0).any():
            raise ValueError(
                f'interval: expected a model with poles of 0 or more, but found {pole.min():.3g}; '
                'fit the model anew at the other interval'
            )
        a = development_of(portable.power(pole, ratio))
        gain = (
            (1.0 - portable.power(pole, ratio))
            / (1.0 - pole)
            * (1.0 + a / 2.0)
            / (1.0 + self.a / 2.0)
        )
        return replace(self, a=a, b=self.b * gain[:, np.newaxis])

    def _exact(self, number: float, drive: Array, total: Array, previous: Array) -> Array:
        half = 1.0 + self.a / 2.0
        if number == 1.0:
            return self.initial.copy()
        if number == 2.0:
            return np.asarray((total - self.a * self.initial) / half)
        return np.asarray(pole_of(self.a) * previous + drive / half)


def pole_of(a: Array) -> Array:
    """Return the pole (1 - a/2) / (1 + a/2) of a grey model."""
    with np.errstate(divide='ignore'):
        return np.asarray((1.0 - a / 2.0) / (1.0 + a / 2.0))


def development_of(pole: Array) -> Array:
    """Return the development coefficient a of a pole, the inverse of `pole_of`."""
    return np.asarray(2.0 * (1.0 - pole) / (1.0 + pole))
