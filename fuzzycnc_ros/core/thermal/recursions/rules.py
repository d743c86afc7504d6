# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Takagi-Sugeno rules at run time: what an adaptive neuro-fuzzy system has learnt."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.fuzzy.takagi_sugeno import log_firing, normalised_firing
from fuzzycnc_ros.core.thermal.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, check_shapes


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
