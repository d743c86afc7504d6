# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Linear filters that feed a small tanh network, at run time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import block_diag

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import check_shapes
from fuzzycnc_ros.core.thermal.recursions.delayed import (
    DelayedRecursion,
    check_delay,
    own_history_columns,
    read_delay,
)


@dataclass(frozen=True, eq=False)
class FilterNetworkRecursion(DelayedRecursion):
    """Network with one hidden layer on delayed rises and past outputs, method sheet 003, 3.

    y(n) = scale tanh(outer tanh(inner x + feedback y(n-1..n-K) + bias) + offset), where x holds
    the rises at all delays.  Linear filters in front of the network are part of `inner` and
    `feedback`: a product of two linear maps is one.

    Parameters
    ----------
    delay : ndarray of int, shape (m,)
        Delays of the rises, ascending, 0 is the present sample [samples].
    inner : ndarray, shape (c, h, m p)
        Weight of each delayed rise in each hidden node [1/K].
    feedback : ndarray, shape (c, h, K)
        Weight of each past output in each hidden node [1/m].
    bias : ndarray, shape (c, h)
        Constant of each hidden node [-].
    outer : ndarray, shape (c, h)
        Weight of each hidden node [-].
    offset : ndarray, shape (c,)
        Constant of the output node [-].
    scale : ndarray, shape (c,)
        Largest output, 1 / C_Y [m].
    """

    FORM: ClassVar[str] = 'filter_network'

    inner: Array
    feedback: Array
    bias: Array
    outer: Array
    offset: Array
    scale: Array

    def __post_init__(self) -> None:
        """Refuse shapes that disagree."""
        check_delay(self.delay, self.inner.shape[-1])
        channels, hidden = self.bias.shape
        columns, history = self.inner.shape[-1], self.feedback.shape[-1]
        if columns % len(self.delay):
            raise ValueError(
                f'inner: expected a multiple of {len(self.delay)} columns, one per delay and '
                f'input, but found {columns}'
            )
        check_shapes(
            self,
            inner=(channels, hidden, columns),
            feedback=(channels, hidden, history),
            bias=(channels, hidden),
            outer=(channels, hidden),
            offset=(channels,),
            scale=(channels,),
        )
        if not (self.scale > 0.0).all():
            raise ValueError(f'scale: expected positive numbers, but found {self.scale}')

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return int(self.inner.shape[-1]) // len(self.delay)

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return len(self.scale)

    @property
    def history(self) -> int:
        """Number K of past outputs that feed back."""
        return int(self.feedback.shape[-1])

    def _linear(self) -> tuple[Array, Array]:
        rises = self.inner.reshape(self.bias.size, -1)
        return np.hstack([rises, own_history_columns(self.feedback)]), self.bias.ravel()

    @cached_property
    def _outer(self) -> Array:
        return np.ascontiguousarray(block_diag(*self.outer))

    def _output(self, activation: Array) -> Array:
        hidden = np.tanh(activation)
        return np.asarray(self.scale * np.tanh(hidden @ self._outer.T + self.offset))

    def channel(self, channel: int) -> 'FilterNetworkRecursion':
        """Return the recursion of one channel out of several."""
        one = slice(channel, channel + 1)
        return replace(
            self,
            inner=self.inner[one],
            feedback=self.feedback[one],
            bias=self.bias[one],
            outer=self.outer[one],
            offset=self.offset[one],
            scale=self.scale[one],
        )

    @classmethod
    def merge(cls, items: Sequence['FilterNetworkRecursion']) -> 'FilterNetworkRecursion | None':
        """Return one recursion for all channels, None if delays or sizes differ."""
        first = items[0]
        if any(
            item.inner.shape[1:] != first.inner.shape[1:]
            or item.history != first.history
            or not np.array_equal(item.delay, first.delay)
            for item in items
        ):
            return None
        return cls(
            delay=first.delay,
            inner=np.concatenate([item.inner for item in items]),
            feedback=np.concatenate([item.feedback for item in items]),
            bias=np.concatenate([item.bias for item in items]),
            outer=np.concatenate([item.outer for item in items]),
            offset=np.concatenate([item.offset for item in items]),
            scale=np.concatenate([item.scale for item in items]),
        )

    def document(self) -> dict[str, Any]:
        """Return the numbers as JSON values."""
        return {
            'delay': self.delay.tolist(),
            'inner': self.inner.tolist(),
            'feedback': self.feedback.tolist(),
            'bias': self.bias.tolist(),
            'outer': self.outer.tolist(),
            'offset': self.offset.tolist(),
            'scale': self.scale.tolist(),
        }

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'FilterNetworkRecursion':
        """Return the recursion of a document."""
        delay = read_delay(node.get('delay'))
        # Each channel has its own matrix; the first tells how many outputs feed back.
        feedback = node.get('feedback').list()
        history = len(feedback[0].list()[0].list()) if feedback and feedback[0].list() else 0
        outer = node.get('outer').list()
        hidden = len(outer[0].list()) if outer else 0
        inner = [item.matrix(len(delay) * inputs) for item in node.get('inner').list()]
        return cls(
            delay=delay,
            inner=_stack(inner, len(delay) * inputs),
            feedback=_stack([item.matrix(history) for item in feedback], history),
            bias=node.get('bias').matrix(hidden),
            outer=node.get('outer').matrix(hidden),
            offset=node.get('offset').vector(),
            scale=node.get('scale').vector(),
        )


def _stack(matrices: Sequence[Array], columns: int) -> Array:
    """Return matrices of one shape as one array; others are refused."""
    if len({matrix.shape for matrix in matrices}) != 1:
        raise ValueError(
            f'channels: expected matrices of one shape with {columns} columns, but found '
            f'{[matrix.shape for matrix in matrices]}'
        )
    return np.stack(matrices)
