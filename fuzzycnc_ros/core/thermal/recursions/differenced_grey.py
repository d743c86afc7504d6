# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Grey models with constants at run time: their accumulated equation solved and differenced."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, check_shapes
from fuzzycnc_ros.core.thermal.recursions.linear import first_order_lags


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
