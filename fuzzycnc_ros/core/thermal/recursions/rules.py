# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Takagi-Sugeno rules at run time: what an adaptive neuro-fuzzy system has learnt."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.fuzzy.takagi_sugeno import log_firing, normalised_firing
from fuzzycnc_ros.core.thermal.recursions.base import (
    ParallelRecursion,
    Recursion,
    check_shapes,
    combine,
    read_recursion,
    write_recursion,
)

COMPOUND = ('bounded', 'corrected', 'parallel', 'series')
"""Forms made of others, which are no parts here: a document must not nest without end."""


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

    base: Recursion
    corrector: Recursion
    mean: Array
    whitening: Array
    inner: Array
    outer: Array

    def __post_init__(self) -> None:
        """Refuse parts that do not belong together."""
        shape = (self.base.channels, self.base.inputs)
        if (self.corrector.channels, self.corrector.inputs) != shape:
            raise ValueError(
                f'corrector: expected {shape[0]} channels and {shape[1]} inputs as the base has, '
                f'but found {self.corrector.channels} and {self.corrector.inputs}'
            )
        channels, inputs = shape
        check_shapes(
            self,
            mean=shape,
            whitening=(channels, inputs, inputs),
            inner=(channels,),
            outer=(channels,),
        )
        if not ((self.inner >= 0.0) & (self.outer > self.inner)).all():
            raise ValueError(
                f'outer: expected distances beyond the inner ones {self.inner}, but found '
                f'{self.outer}'
            )

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return self.base.inputs

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return self.base.channels

    @cached_property
    def _stacked(self) -> Array:
        return self.whitening.reshape(-1, self.inputs)

    @cached_property
    def _center(self) -> Array:
        return np.asarray(np.einsum('cij,cj->ci', self.whitening, self.mean).ravel())

    @cached_property
    def _cut(self) -> int:
        return len(self.base.initial_state())

    def initial_state(self) -> Array:
        """Return the state of the base, then that of the corrector."""
        return np.concatenate([self.base.initial_state(), self.corrector.initial_state()])

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
        apart = (rise @ self._stacked.T - self._center).reshape(shape)
        distance = np.sqrt((apart * apart).sum(axis=-1))
        inside = (self.outer - distance) / (self.outer - self.inner)
        return np.asarray(np.minimum(np.maximum(inside, 0.0), 1.0))

    def with_interval(self, ratio: float) -> 'CorrectedRecursion':
        """Return the recursion for an interval `ratio` times as long."""
        return replace(
            self,
            base=self.base.with_interval(ratio),
            corrector=self.corrector.with_interval(ratio),
        )

    def channel(self, channel: int) -> 'CorrectedRecursion':
        """Return the recursion of one channel out of several."""
        one = slice(channel, channel + 1)
        return CorrectedRecursion(
            base=self.base.channel(channel),
            corrector=self.corrector.channel(channel),
            mean=self.mean[one],
            whitening=self.whitening[one],
            inner=self.inner[one],
            outer=self.outer[one],
        )

    @classmethod
    def merge(cls, items: Sequence['CorrectedRecursion']) -> 'CorrectedRecursion | None':
        """Return one recursion for all channels, None if the parts are of different forms."""
        base = combine([item.base for item in items])
        corrector = combine([item.corrector for item in items])
        if isinstance(base, ParallelRecursion) or isinstance(corrector, ParallelRecursion):
            return None
        return CorrectedRecursion(
            base=base,
            corrector=corrector,
            mean=np.concatenate([item.mean for item in items]),
            whitening=np.concatenate([item.whitening for item in items]),
            inner=np.concatenate([item.inner for item in items]),
            outer=np.concatenate([item.outer for item in items]),
        )

    def document(self) -> dict[str, Any]:
        """Return the parts as JSON values."""
        return {
            'base': write_recursion(self.base),
            'corrector': write_recursion(self.corrector),
            'domain': [
                {
                    'mean': mean.tolist(),
                    'whitening': whitening.tolist(),
                    'inner': float(inner),
                    'outer': float(outer),
                }
                for mean, whitening, inner, outer in zip(
                    self.mean, self.whitening, self.inner, self.outer, strict=True
                )
            ],
        }

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'CorrectedRecursion':
        """Return the recursion of a document."""
        for key in ('base', 'corrector'):
            if node.get(key).get('form').value in COMPOUND:
                node.get(key).refuse('a recursion without parts')
        domains = node.get('domain').list()
        if not domains:
            node.get('domain').refuse('the domain of at least one channel')
        return cls(
            base=read_recursion(node.get('base'), inputs),
            corrector=read_recursion(node.get('corrector'), inputs),
            mean=np.array([item.get('mean').vector() for item in domains]),
            whitening=np.array([item.get('whitening').matrix(inputs) for item in domains]),
            inner=np.array([item.get('inner').number() for item in domains]),
            outer=np.array([item.get('outer').number() for item in domains]),
        )


@dataclass(frozen=True, eq=False)
class RulesRecursion(Recursion):
    """Rules of each channel on the rises, method sheet 001 eqs. (1)-(6); it has no memory.

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

    center: Array
    width: Array
    slope: Array
    offset: Array

    def __post_init__(self) -> None:
        """Refuse shapes that disagree and widths that are not positive."""
        channels, rules = self.offset.shape
        shape = (channels, rules, self.center.shape[-1])
        check_shapes(self, center=shape, width=shape, slope=shape, offset=(channels, rules))
        if rules < 1 or not (self.width > 0.0).all():
            raise ValueError(
                f'width: expected one rule or more with positive widths, but found {rules} rules '
                f'and a least width of {self.width.min(initial=np.inf):g}'
            )

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return int(self.center.shape[2])

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return len(self.offset)

    @cached_property
    def _inverse_width(self) -> Array:
        return 1.0 / self.width

    def initial_state(self) -> Array:
        """Return the empty state."""
        return np.empty(0)

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        firing = normalised_firing(log_firing(rise, self.center, self._inverse_width))
        return (firing * (self.slope @ rise + self.offset)).sum(axis=-1), state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        values = np.empty((len(rise), self.channels))
        for channel in range(self.channels):
            logarithm = log_firing(rise, self.center[channel], self._inverse_width[channel])
            output = rise @ self.slope[channel].T + self.offset[channel]
            values[:, channel] = (normalised_firing(logarithm) * output).sum(axis=-1)
        return values

    def with_interval(self, ratio: float) -> 'RulesRecursion':
        """Return the rules themselves: without memory they hold at every interval."""
        return self

    def channel(self, channel: int) -> 'RulesRecursion':
        """Return the rules of one channel out of several."""
        one = slice(channel, channel + 1)
        return replace(
            self,
            center=self.center[one],
            width=self.width[one],
            slope=self.slope[one],
            offset=self.offset[one],
        )

    @classmethod
    def merge(cls, items: Sequence['RulesRecursion']) -> 'RulesRecursion | None':
        """Return one recursion for all channels, None if they have different numbers of rules."""
        if len({item.offset.shape[1] for item in items}) > 1:
            return None
        return RulesRecursion(
            center=np.concatenate([item.center for item in items]),
            width=np.concatenate([item.width for item in items]),
            slope=np.concatenate([item.slope for item in items]),
            offset=np.concatenate([item.offset for item in items]),
        )

    def document(self) -> dict[str, Any]:
        """Return the numbers as JSON values."""
        return {
            'channels': [
                {
                    'center': center.tolist(),
                    'width': width.tolist(),
                    'slope': slope.tolist(),
                    'offset': offset.tolist(),
                }
                for center, width, slope, offset in zip(
                    self.center, self.width, self.slope, self.offset, strict=True
                )
            ]
        }

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'RulesRecursion':
        """Return the recursion of a document."""
        channels = node.get('channels').list()
        if not channels:
            node.get('channels').refuse('the rules of at least one channel')
        rules = len(channels[0].get('offset').list())
        numbers: dict[str, list[Array]] = {}
        for item in channels:
            for key in ('center', 'width', 'slope', 'offset'):
                of_rules = item.get(key)
                values = of_rules.vector() if key == 'offset' else of_rules.matrix(inputs)
                if len(values) != rules:
                    of_rules.refuse(f'{rules} rules, as many as in the first channel')
                numbers.setdefault(key, []).append(values)
        return cls(**{key: np.array(values) for key, values in numbers.items()})
