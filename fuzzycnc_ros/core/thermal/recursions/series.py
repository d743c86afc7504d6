# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One recursion after another: the first makes the inputs of the second."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion
from fuzzycnc_ros.core.thermal.recursions.linear import LinearRecursion
from fuzzycnc_ros.core.thermal.recursions.parallel import (
    combine,
    read_recursion,
    write_recursion,
)


@dataclass(frozen=True, eq=False)
class SeriesRecursion(Recursion):
    """A bank of lags, or a choice of inputs, in front of a model.

    Parameters
    ----------
    bank : LinearRecursion
        Its outputs are the inputs of the model.
    model : Recursion
        Any form but this one.
    """

    FORM: ClassVar[str] = 'series'

    bank: LinearRecursion
    model: Recursion

    def __post_init__(self) -> None:
        """Refuse parts that do not fit together."""
        if self.model.inputs != self.bank.channels:
            raise ValueError(
                f'model: expected {self.bank.channels} inputs, as many as the bank has outputs, '
                f'but found {self.model.inputs}'
            )

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return self.bank.inputs

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return self.model.channels

    def initial_state(self) -> Array:
        """Return the states of the bank and the model, one after the other."""
        return np.concatenate([self.bank.initial_state(), self.model.initial_state()])

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of inputs (p,)."""
        cut = len(self.bank.pole)
        made, before = self.bank.step(rise, state[:cut])
        value, after = self.model.step(made, state[cut:])
        return value, np.concatenate([before, after])

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of inputs (n, p)."""
        return self.model.run(self.bank.run(rise))

    def standard_deviation(self, rise: Array) -> Array:
        """Return what the model says of its deviation, NaN behind lags, shape (..., c) [m]."""
        if len(self.bank.pole):
            return super().standard_deviation(rise)
        return self.model.standard_deviation(rise @ self.bank.direct.T + self.bank.offset)

    def with_interval(self, ratio: float) -> 'SeriesRecursion':
        """Return the recursion for an interval `ratio` times as long."""
        return SeriesRecursion(self.bank.with_interval(ratio), self.model.with_interval(ratio))

    def channel(self, channel: int) -> 'SeriesRecursion':
        """Return the recursion of one channel out of several."""
        return SeriesRecursion(self.bank, self.model.channel(channel))

    @classmethod
    def merge(cls, items: Sequence['SeriesRecursion']) -> 'SeriesRecursion | None':
        """Return one recursion for all channels if they share a bank."""
        bank = items[0].bank
        if any(item.bank.document() != bank.document() for item in items[1:]):
            return None
        return cls(bank, combine([item.model for item in items]))

    def document(self) -> dict[str, Any]:
        """Return the parts as JSON values."""
        return {'bank': self.bank.document(), 'model': write_recursion(self.model)}

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'SeriesRecursion':
        """Return the recursion of a document."""
        bank = LinearRecursion.read(node.get('bank'), inputs)
        model = node.get('model')
        if model.get('form').value == cls.FORM:
            model.refuse('a recursion that is no series')
        return cls(bank, read_recursion(model, bank.channels))


def leading(recursion: Recursion, inputs: int) -> Recursion:
    """Return a recursion that reads the first of `inputs` inputs and ignores the others."""
    ignored = inputs - recursion.inputs
    if not ignored:
        return recursion
    if isinstance(recursion, LinearRecursion):
        return replace(
            recursion,
            drive=np.pad(recursion.drive, ((0, 0), (0, ignored))),
            direct=np.pad(recursion.direct, ((0, 0), (0, ignored))),
        )
    bank = LinearRecursion(
        pole=np.empty(0),
        drive=np.empty((0, inputs)),
        readout=np.empty((recursion.inputs, 0)),
        direct=np.eye(recursion.inputs, inputs),
        offset=np.zeros(recursion.inputs),
    )
    return SeriesRecursion(bank, recursion)
