# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Delayed rises and own past outputs in one linear equation, its output clipped, at run time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import check_shapes, clipped
from fuzzycnc_ros.core.thermal.recursions.delayed import (
    DelayedRecursion,
    check_delay,
    own_history_columns,
    read_delay,
)


@dataclass(frozen=True, eq=False)
class MovingAverageRecursion(DelayedRecursion):
    """Autoregressive model with moving averages of the rises, method sheet 003 section 2.

    y(n) = drive x + feedback y(n-1..n-K) + offset, cut at the limit, where x holds the rises at
    all delays.  The cut output is what feeds back: nothing else bounds a recursion that is not
    stable.

    Parameters
    ----------
    delay : ndarray of int, shape (m,)
        Delays of the rises, ascending, 0 is the present sample [samples].
    drive : ndarray, shape (c, m p)
        Weight of each delayed rise [m/K].
    feedback : ndarray, shape (c, K)
        Weight of each past output [-].
    offset : ndarray, shape (c,)
        Constant [m].
    limit : ndarray, shape (c,)
        Largest output [m].
    """

    FORM: ClassVar[str] = 'moving_average'

    drive: Array
    feedback: Array
    offset: Array
    limit: Array

    def __post_init__(self) -> None:
        """Refuse shapes that disagree."""
        channels, columns = self.drive.shape
        check_delay(self.delay, columns)
        if columns % len(self.delay):
            raise ValueError(
                f'drive: expected a multiple of {len(self.delay)} columns, one per delay and '
                f'input, but found {columns}'
            )
        check_shapes(
            self,
            drive=(channels, columns),
            feedback=(channels, self.feedback.shape[-1]),
            offset=(channels,),
            limit=(channels,),
        )
        if not (self.limit > 0.0).all():
            raise ValueError(f'limit: expected positive numbers, but found {self.limit}')

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return int(self.drive.shape[-1]) // len(self.delay)

    @property
    def channels(self) -> int:
        """Number c of channels."""
        return len(self.limit)

    @property
    def history(self) -> int:
        """Number K of past outputs that feed back."""
        return int(self.feedback.shape[-1])

    def _linear(self) -> tuple[Array, Array]:
        past = own_history_columns(self.feedback[:, np.newaxis, :])
        return np.hstack([self.drive, past]), self.offset

    def _output(self, activation: Array) -> Array:
        return clipped(activation, self.limit)

    def channel(self, channel: int) -> 'MovingAverageRecursion':
        """Return the recursion of one channel out of several."""
        one = slice(channel, channel + 1)
        return replace(
            self,
            drive=self.drive[one],
            feedback=self.feedback[one],
            offset=self.offset[one],
            limit=self.limit[one],
        )

    @classmethod
    def merge(cls, items: Sequence['MovingAverageRecursion']) -> 'MovingAverageRecursion | None':
        """Return one recursion for all channels, None if delays or sizes differ."""
        first = items[0]
        if any(
            item.history != first.history or not np.array_equal(item.delay, first.delay)
            for item in items
        ):
            return None
        return cls(
            delay=first.delay,
            drive=np.concatenate([item.drive for item in items]),
            feedback=np.concatenate([item.feedback for item in items]),
            offset=np.concatenate([item.offset for item in items]),
            limit=np.concatenate([item.limit for item in items]),
        )

    def document(self) -> dict[str, Any]:
        """Return the numbers as JSON values."""
        return {
            'delay': self.delay.tolist(),
            'drive': self.drive.tolist(),
            'feedback': self.feedback.tolist(),
            'offset': self.offset.tolist(),
            'limit': self.limit.tolist(),
        }

    @classmethod
    def read(cls, node: Node, inputs: int) -> 'MovingAverageRecursion':
        """Return the recursion of a document."""
        delay = read_delay(node.get('delay'))
        feedback = node.get('feedback').list()
        history = len(feedback[0].list()) if feedback else 0
        return cls(
            delay=delay,
            drive=node.get('drive').matrix(len(delay) * inputs),
            feedback=node.get('feedback').matrix(history),
            offset=node.get('offset').vector(),
            limit=node.get('limit').vector(),
        )
