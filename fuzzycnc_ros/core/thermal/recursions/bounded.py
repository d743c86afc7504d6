# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A recursion whose output is kept near what was measured in training."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, check_shapes, clipped
from fuzzycnc_ros.core.thermal.recursions.parallel import (
    combine,
    read_recursion,
    write_recursion,
)

BOUND_FACTOR = 1.5
"""Bound of the output as a multiple of the largest deformation measured in training [-]."""


BOUND_MIN = 1e-9
"""What counts as the largest deformation of a channel that never moved [m]."""


@dataclass(frozen=True, eq=False)
class BoundedRecursion(Recursion):
    """A recursion whose output is cut at a bound.

    What feeds back inside the base is not cut: the bound changes what is published, never what
    the model believes, and lets go as soon as the base returns.

    Parameters
    ----------
    base : Recursion
        What is bounded; not itself bounded.
    bound : ndarray, shape (c,)
        Largest absolute output of each channel, positive [m].
    """

    FORM: ClassVar[str] = 'bounded'

    base: Recursion
    bound: Array

    def __post_init__(self) -> None:
        """Refuse bounds that are not one positive number per channel."""
        check_shapes(self, bound=(self.base.channels,))
        if not (self.bound > 0.0).all():
            raise ValueError(f'bound: expected positive numbers, but found {self.bound}')

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return self.base.inputs

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return self.base.channels

    def initial_state(self) -> Array:
        """Return the state of the base."""
        return self.base.initial_state()

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        value, state = self.base.step(rise, state)
        return clipped(value, self.bound), state

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        return clipped(self.base.run(rise), self.bound)

    def standard_deviation(self, rise: Array) -> Array:
        """Return what the base says of its deviation, shape (..., c) [m]."""
        return self.base.standard_deviation(rise)

    def with_interval(self, ratio: float) -> 'BoundedRecursion':
        """Return the recursion for an interval `ratio` times as long."""
        return BoundedRecursion(self.base.with_interval(ratio), self.bound)

    def channel(self, channel: int) -> 'BoundedRecursion':
        """Return the recursion of one channel out of several."""
        return BoundedRecursion(self.base.channel(channel), self.bound[channel : channel + 1])

    @classmethod
    def merge(cls, items: Sequence['BoundedRecursion']) -> 'BoundedRecursion':
        """Return one recursion for all channels."""
        return BoundedRecursion(
            combine([item.base for item in items]), np.concatenate([item.bound for item in items])
        )

    def document(self) -> dict[str, Any]:
        """Return base and bounds as JSON values."""
        return {'base': write_recursion(self.base), 'bound': self.bound.tolist()}

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'BoundedRecursion':
        """Return the recursion of a document."""
        base = node.get('base')
        if base.get('form').value == cls.FORM:
            base.refuse('a recursion that is not bounded')
        return cls(read_recursion(base, inputs), node.get('bound').vector())


def bound_of(displacement: Array) -> Array:
    """Return the bound of each channel, (c,) [m]: 1.5 times the largest measured in training.

    Parameters
    ----------
    displacement : ndarray, shape (n, c)
        Deformation measured in training, NaN where it was not [m]; each channel at least once.
    """
    return np.asarray(BOUND_FACTOR * np.fmax(np.nanmax(np.abs(displacement), axis=0), BOUND_MIN))
