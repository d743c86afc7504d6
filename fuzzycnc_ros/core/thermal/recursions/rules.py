# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Takagi-Sugeno rules at run time: what an adaptive neuro-fuzzy system has learnt."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import LENGTH_MIN, Array
from fuzzycnc_ros.core.fuzzy.takagi_sugeno import log_firing, normalised_firing
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, axes, part

COMPOUND = ('bounded', 'corrected', 'parallel', 'series')
"""Forms made of others, which are no parts here: a document must not nest without end."""

_WITHOUT_PARTS = 'a recursion without parts'


FADE_MIN = 1e-6
"""Least Mahalanobis distance in which a corrector fades out [-]."""


@dataclass(frozen=True, eq=False)
class CorrectedRecursion(Recursion):
    """Sum of a base and of a corrector that fades with the distance from its training data.

    Parameters
    ----------
    base : Recursion
        What speaks everywhere.
    corrector : Recursion
        What is added inside the domain; of the same inputs and channels.
    mean : ndarray, shape (c, p)
        Mean rise of the training samples of each channel [K].
    whitening : ndarray, shape (c, p, p)
        Matrix that takes apart from that mean [K] to a vector as long as the Mahalanobis
        distance [-].
    inner, outer : ndarray, shape (c,)
        Mahalanobis distances [-] up to which the corrector is fully on and from which it is
        off; between both its weight falls linearly, so that it never steps.
    """

    FORM: ClassVar[str] = 'corrected'
    GROUP: ClassVar[str] = 'domain'

    base: Recursion = field(metadata=part(*COMPOUND, but=_WITHOUT_PARTS))
    corrector: Recursion = field(metadata=part(*COMPOUND, but=_WITHOUT_PARTS))
    mean: Array = field(metadata=axes('c p'))
    whitening: Array = field(metadata=axes('c p p'))
    inner: Array = field(metadata=axes('c', 0.0))
    outer: Array = field(metadata=axes('c', 0.0))

    def _check(self) -> None:
        if not (self.outer - self.inner >= FADE_MIN).all():
            raise ValueError(
                f'outer: expected distances beyond the inner ones {self.inner} by {FADE_MIN:g} or '
                f'more, but found {self.outer}'
            )

    @cached_property
    def _stacked(self) -> Array:
        return self.whitening.reshape(-1, self.inputs)

    @cached_property
    def _center(self) -> Array:
        return np.asarray(np.einsum('cij,cj->ci', self.whitening, self.mean).ravel())

    @cached_property
    def _cut(self) -> int:
        return len(self.base.initial_state())

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        value, first = self.base.step(rise, state[: self._cut])
        correction, second = self.corrector.step(rise, state[self._cut :])
        return value + self.weight(rise) * correction, np.concatenate([first, second])

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        return self.base.run(rise) + self.weight(rise) * self.corrector.run(rise)

    def weight(self, rise: Array) -> Array:
        """Return the weight of the corrector in each channel, (..., c), at rises (..., p)."""
        shape = (*rise.shape[:-1], self.channels, self.inputs)
        apart = (portable.matmul(rise, self._stacked.T) - self._center).reshape(shape)
        distance = np.sqrt((apart * apart).sum(axis=-1))
        inside = (self.outer - distance) / (self.outer - self.inner)
        return np.asarray(np.minimum(np.maximum(inside, 0.0), 1.0))


@dataclass(frozen=True, eq=False)
class RulesRecursion(Recursion):
    """Rules of each channel on the rises, [ding_zeng] eqs. (1)-(6); it has no memory.

    Parameters
    ----------
    center, width : ndarray, shape (c, r, p)
        Centre and standard deviation of the Gaussian set of each rule and input [K].
    slope : ndarray, shape (c, r, p)
        Consequent of each rule, per kelvin of each rise [m/K].
    offset : ndarray, shape (c, r)
        Constant of each rule's consequent [m].
    """

    FORM: ClassVar[str] = 'rules'
    GROUP: ClassVar[str] = 'channels'
    STATIC: ClassVar[bool] = True

    center: Array = field(metadata=axes('c r p'))
    width: Array = field(metadata=axes('c r p', LENGTH_MIN))
    slope: Array = field(metadata=axes('c r p'))
    offset: Array = field(metadata=axes('c r'))

    def _check(self) -> None:
        if self.offset.shape[1] < 1:
            raise ValueError('offset: expected one rule or more, but found none')

    @cached_property
    def _inverse_width(self) -> Array:
        return 1.0 / self.width

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        firing = normalised_firing(log_firing(rise, self.center, self._inverse_width))
        return (firing * (portable.matmul(self.slope, rise) + self.offset)).sum(axis=-1), state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        values = np.empty((len(rise), self.channels))
        for channel in range(self.channels):
            logarithm = log_firing(rise, self.center[channel], self._inverse_width[channel])
            output = portable.matmul(rise, self.slope[channel].T) + self.offset[channel]
            values[:, channel] = (normalised_firing(logarithm) * output).sum(axis=-1)
        return values
