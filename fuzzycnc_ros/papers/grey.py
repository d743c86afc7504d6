# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Grey models with constants: GMC(1,N), OGM(1,N) and DGM(1,N).

References
----------
[tien2012] for GMC(1,N), [zeng2016] for OGM(1,N), [xie2009] for DGM(1,N).
"""

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.fit.grey import GreyModel
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, axes, first_order_lags
from fuzzycnc_ros.core.thermal.recursions.grey import development_of, pole_of


@dataclass(frozen=True, eq=False)
class DifferencedGreyRecursion(Recursion):
    """Grey model with constants of each channel.

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
        """Return the recursion for an interval `ratio` times as long.

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


class GreyVariant(GreyModel):
    """Grey model with constants.

    Parameters
    ----------
    kind : {'convolution', 'optimised', 'discrete'}
        'convolution' is GMC(1,N): averaged drivers, a constant, solved by the trapezium rule;
        'optimised' is OGM(1,N): [ding_zeng] eq. (12) plus h1 (k-1) + h2, solved exactly;
        'discrete' is DGM(1,N): the next accumulated value is regressed on the present one.
    interval : float
        Sampling interval of the training samples [s].

    Attributes
    ----------
    a_, b_, phi_, condition_, stable_, problems_, reliable_
        As of `GreyModel`; the pole of the convolution form is exp(-a).
    constants_ : ndarray, shape (1,) or (2,)
        u of the convolution form, h1 and h2 of the optimised and discrete ones [m].
    """

    CONSTANTS: ClassVar[dict[str, int]] = {'convolution': 1, 'optimised': 2, 'discrete': 2}

    def __init__(self, kind: str = 'convolution', *, interval: float = 60.0) -> None:
        self.kind = kind
        self.interval = interval

    @classmethod
    def kinds(cls) -> tuple[str, ...]:
        """Return the kinds that there are."""
        return tuple(cls.CONSTANTS)

    def _run_equations(self, drivers: Array, target: Array) -> tuple[Array, Array]:
        total = np.cumsum(target)
        driver = np.cumsum(drivers, axis=0)
        if self.kind == 'convolution':
            driver = (driver + np.concatenate([driver[:1], driver[:-1]])) / 2.0
        if self.kind == 'discrete':
            past, left = total[:-1], total[1:]
        else:
            past, left = -0.5 * (total[1:] + total[:-1]), target[1:]
        number = np.arange(1.0, len(total))
        constants = (number, np.ones_like(number))[2 - self.CONSTANTS[self.kind] :]
        return np.column_stack([past, driver[1:], *constants]), left

    def _take(self, solution: Array, unit: float) -> None:
        lead, others = float(solution[0]), solution[1:] * unit
        if self.kind == 'discrete':
            # Its equation is the optimised one, divided by 1 + a/2.
            with np.errstate(divide='ignore'):
                lead = float(development_of(np.array(lead)))
            others = others * (1.0 + lead / 2.0)
        drivers = len(others) - self.CONSTANTS[self.kind]
        self.a_, self.b_, self.constants_ = lead, others[:drivers], others[drivers:]
        averaged = self.kind == 'convolution'
        self.phi_ = float(np.exp(-lead) if averaged else pole_of(np.array(lead)))

    def solution(self, initial: float) -> Recursion:
        """Return the fitted form from a first value y(1) [m]."""
        if self.kind == 'convolution':
            gain, constant = self.b_ / 2.0, 0.0
            start = initial * (self.phi_ - 1.0) + self.constants_[0] * (1.0 + self.phi_) / 2.0
        else:
            half = 1.0 + self.a_ / 2.0
            gain, constant = self.b_ / half, float(self.constants_[0]) / half
            start = (self.constants_.sum() - self.a_ * initial) / half
        return DifferencedGreyRecursion(
            averaged=self.kind == 'convolution',
            pole=np.array([self.phi_]),
            gain=gain[np.newaxis],
            constant=np.array([constant]),
            start=np.array([start]),
            initial=np.array([initial]),
        )
