# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The grey model GM(1,N) at run time: published time response, exact solution, differenced."""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, axes, first_order_lags


@dataclass(frozen=True, eq=False)
class GreyRecursion(Recursion):
    """Grey model of each channel, method sheet 001 eqs. (15)-(16) or their exact solution.

    Parameters
    ----------
    exact : bool
        True solves eq. (12) as a recursion; False is the published time response (15), which
        takes the drivers' sum for constant.
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
        drive = self.b @ rise
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
                kept = (self.initial - steady) * np.exp(-self.a * (number - 1.0)) + steady
                value = kept - previous
        return value, np.concatenate([[number], total, kept])

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        drive = rise @ self.b.T
        total = np.cumsum(drive, axis=0)
        with np.errstate(all='ignore'):
            if not self.exact:
                steady = total / self.a
                decay = np.exp(-self.a * np.arange(len(rise))[:, np.newaxis])
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
        """Return the recursion for an interval `ratio` times as long, method sheet 001, 3.1.

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
        a = development_of(pole**ratio)
        gain = (1.0 - pole**ratio) / (1.0 - pole) * (1.0 + a / 2.0) / (1.0 + self.a / 2.0)
        return replace(self, a=a, b=self.b * gain[:, np.newaxis])

    def _exact(self, number: float, drive: Array, total: Array, previous: Array) -> Array:
        half = 1.0 + self.a / 2.0
        if number == 1.0:
            return self.initial.copy()
        if number == 2.0:
            return np.asarray((total - self.a * self.initial) / half)
        return np.asarray(pole_of(self.a) * previous + drive / half)


def pole_of(a: Array) -> Array:
    """Return the pole (1 - a/2) / (1 + a/2) of a grey model, method sheet 001 section 3.1."""
    with np.errstate(divide='ignore'):
        return np.asarray((1.0 - a / 2.0) / (1.0 + a / 2.0))


def development_of(pole: Array) -> Array:
    """Return the development coefficient a of a pole, the inverse of `pole_of`."""
    return np.asarray(2.0 * (1.0 - pole) / (1.0 + pole))


@dataclass(frozen=True, eq=False)
class DifferencedGreyRecursion(Recursion):
    """Grey model with constants of each channel, method sheet 001 section 3.2.

    y(k) = pole y(k-1) + gain x(k) + constant for k >= 3, with pole gain x(k-1) on top if drivers
    are averaged; y(1) = initial, y(2) = start + gain x(1) + gain x(2), likewise.

    Parameters
    ----------
    averaged : bool
        Whether a driver acts as the mean of two samples, as the trapezium rule has it.
    pole : ndarray, shape (c,)
        Pole of each channel [-].
    gain : ndarray, shape (c, p)
        Weight of each rise [m/K].
    constant : ndarray, shape (c,)
        What each sample from the third on adds [m].
    start : ndarray, shape (c,)
        What the second sample has beside its drivers [m].
    initial : ndarray, shape (c,)
        First value y(1) [m].

    Notes
    -----
    Accumulated constants act once only, since differences remove them: they are in `start`.
    The state is whether a sample was seen, then what the past adds to the next value.
    """

    FORM: ClassVar[str] = 'differenced_grey'

    averaged: bool
    pole: Array = field(metadata=axes('c'))
    gain: Array = field(metadata=axes('c p'))
    constant: Array = field(metadata=axes('c'))
    start: Array = field(metadata=axes('c'))
    initial: Array = field(metadata=axes('c'))

    def initial_state(self) -> Array:
        """Return the state before the first sample, shape (1 + c,)."""
        return np.zeros(1 + self.channels)

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        drive = self.gain @ rise
        lagged = self.pole * drive if self.averaged else 0.0
        # A form that diverges is meant to show it, as infinity, not to stop an evaluation.
        with np.errstate(all='ignore'):
            if state[0] == 0.0:
                value = self.initial.copy()
                past = self.start + drive + lagged
            else:
                value = state[1:] + drive
                past = self.pole * value + lagged + self.constant
        return value, np.concatenate([[1.0], past])

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        drive = rise @ self.gain.T
        forced = drive + self.constant
        if self.averaged:
            forced[1:] += self.pole * drive[:-1]
        forced[:1] = self.initial
        forced[1:2] += drive[:1] + self.start - self.constant - self.pole * self.initial
        with np.errstate(all='ignore'):
            return first_order_lags(self.pole, forced)

    def with_interval(self, ratio: float) -> 'DifferencedGreyRecursion':
        """Return the recursion for an interval `ratio` times as long, method sheet 001, 3.1.

        Time constants, steady state and the decay of the start remain.

        Raises
        ------
        ValueError
            If a pole is not positive, or is 1: it then tells no time constant.
        """
        if not ((self.pole > 0.0) & (self.pole != 1.0)).all():
            raise ValueError(
                f'interval: expected a model with positive poles other than 1, but found '
                f'{self.pole}; fit the model anew at the other interval'
            )
        pole = self.pole**ratio
        share = (1.0 - pole) / (1.0 - self.pole)
        spread = (1.0 + self.pole) / (1.0 + pole) if self.averaged else 1.0
        constant = self.constant * share
        return replace(
            self,
            pole=pole,
            gain=self.gain * (share * spread)[:, np.newaxis],
            constant=constant,
            start=constant + (self.start - self.constant) * pole / self.pole,
        )
