# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The grey model GM(1,N) at run time: published time response, exact solution, differenced."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, check_shapes, first_order_lags


@dataclass(frozen=True, eq=False)
class GreyRecursion(Recursion):
    """Grey model of each channel, method sheet 001 eqs. (15)-(16) or their exact solution.

    Parameters
    ----------
    a : ndarray, shape (c,)
        Development coefficient of each channel [-].
    b : ndarray, shape (c, p)
        Driving coefficients [m/K].
    initial : ndarray, shape (c,)
        First value y(1) of each channel [m].
    exact : bool
        True solves eq. (12) as a recursion; False is the published time response (15), which
        takes the drivers' sum for constant.

    Notes
    -----
    The state is the sample number, then the accumulated drive and the previous value of each
    channel (accumulated for the published form, plain for the exact one).
    """

    FORM: ClassVar[str] = 'grey'

    a: Array
    b: Array
    initial: Array
    exact: bool

    def __post_init__(self) -> None:
        """Refuse shapes that disagree."""
        channels = len(self.a)
        check_shapes(self, a=(channels,), b=(channels, self.b.shape[-1]), initial=(channels,))

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return int(self.b.shape[1])

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return len(self.a)

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

    def channel(self, channel: int) -> 'GreyRecursion':
        """Return the recursion of one channel out of several."""
        one = slice(channel, channel + 1)
        return replace(self, a=self.a[one], b=self.b[one], initial=self.initial[one])

    @classmethod
    def merge(cls, items: Sequence['GreyRecursion']) -> 'GreyRecursion | None':
        """Return one recursion for all channels, None if solutions are mixed."""
        if len({item.exact for item in items}) > 1:
            return None
        return GreyRecursion(
            a=np.concatenate([item.a for item in items]),
            b=np.concatenate([item.b for item in items]),
            initial=np.concatenate([item.initial for item in items]),
            exact=items[0].exact,
        )

    def document(self) -> dict[str, Any]:
        """Return the numbers as JSON values."""
        return {
            'exact': self.exact,
            'a': self.a.tolist(),
            'b': self.b.tolist(),
            'initial': self.initial.tolist(),
        }

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'GreyRecursion':
        """Return the recursion of a document."""
        return cls(
            a=node.get('a').vector(),
            b=node.get('b').matrix(inputs),
            initial=node.get('initial').vector(),
            exact=node.get('exact').boolean(),
        )


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
    averaged : bool
        Whether a driver acts as the mean of two samples, as the trapezium rule has it.

    Notes
    -----
    Accumulated constants act once only, since differences remove them: they are in `start`.
    The state is whether a sample was seen, then what the past adds to the next value.
    """

    FORM: ClassVar[str] = 'differenced_grey'

    pole: Array
    gain: Array
    constant: Array
    start: Array
    initial: Array
    averaged: bool

    def __post_init__(self) -> None:
        """Refuse shapes that disagree."""
        one = (len(self.pole),)
        check_shapes(
            self,
            pole=one,
            gain=(len(self.pole), self.gain.shape[-1]),
            constant=one,
            start=one,
            initial=one,
        )

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return int(self.gain.shape[1])

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return len(self.pole)

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

    def channel(self, channel: int) -> 'DifferencedGreyRecursion':
        """Return the recursion of one channel out of several."""
        one = slice(channel, channel + 1)
        return replace(
            self,
            pole=self.pole[one],
            gain=self.gain[one],
            constant=self.constant[one],
            start=self.start[one],
            initial=self.initial[one],
        )

    @classmethod
    def merge(
        cls, items: Sequence['DifferencedGreyRecursion']
    ) -> 'DifferencedGreyRecursion | None':
        """Return one recursion for all channels, None if only some average their drivers."""
        if len({item.averaged for item in items}) > 1:
            return None
        return DifferencedGreyRecursion(
            pole=np.concatenate([item.pole for item in items]),
            gain=np.concatenate([item.gain for item in items]),
            constant=np.concatenate([item.constant for item in items]),
            start=np.concatenate([item.start for item in items]),
            initial=np.concatenate([item.initial for item in items]),
            averaged=items[0].averaged,
        )

    def document(self) -> dict[str, Any]:
        """Return the numbers as JSON values."""
        return {
            'averaged': self.averaged,
            'pole': self.pole.tolist(),
            'gain': self.gain.tolist(),
            'constant': self.constant.tolist(),
            'start': self.start.tolist(),
            'initial': self.initial.tolist(),
        }

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'DifferencedGreyRecursion':
        """Return the recursion of a document."""
        return cls(
            pole=node.get('pole').vector(),
            gain=node.get('gain').matrix(inputs),
            constant=node.get('constant').vector(),
            start=node.get('start').vector(),
            initial=node.get('initial').vector(),
            averaged=node.get('averaged').boolean(),
        )
