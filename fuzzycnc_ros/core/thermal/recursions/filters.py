# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Models on delayed rises and on their own past outputs at run time: moving average, network."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, check_shapes, clipped

_Self = TypeVar('_Self', bound='_DelayedRecursion')

DELAY_MAX = 1440
"""Longest delay [samples], a day of minutes; all rises since then are part of the state."""

STATE_MAX = 1_000_000
"""Most past rises in a state, 8 MB; a day of minutes of 76 sensors are 110,000."""


@dataclass(frozen=True, eq=False)
class _DelayedRecursion(Recursion):
    """Delayed rises and past outputs, mapped linearly and then by whatever the form adds.

    Parameters
    ----------
    delay : ndarray of int, shape (m,)
        Delays of the rises, ascending, 0 is the present sample [samples].

    Notes
    -----
    The state is the rises of the samples that some delay still asks for, newest first, then the
    outputs of the last K samples, newest first, each of all channels.  Before a run every rise
    and every output is zero.
    """

    delay: NDArray[np.int64]

    @property
    @abstractmethod
    def history(self) -> int:
        """Number K of past outputs that feed back."""

    @abstractmethod
    def _linear(self) -> tuple[Array, Array]:
        """Return the map (r, m p + K c) of delayed rises and history, and its constants (r,)."""

    @abstractmethod
    def _output(self, activation: Array) -> Array:
        """Return the thermal errors (..., c) [m] of the mapped values (..., r)."""

    @cached_property
    def _map(self) -> tuple[Array, Array]:
        weight, constant = self._linear()
        return np.ascontiguousarray(weight), constant

    @cached_property
    def _kept(self) -> int:
        """Number of values of past rises in the state."""
        return int(self.delay[-1]) * self.inputs

    @cached_property
    def _picked(self) -> NDArray[np.int64] | None:
        """Which of the present rises and the state the map reads; None if all of them."""
        inputs = self.inputs
        size = self._kept + inputs + self.history * self.channels
        rises = self.delay[:, np.newaxis] * inputs + np.arange(inputs)
        picked = np.concatenate([rises.ravel(), np.arange(self._kept + inputs, size)])
        return None if len(picked) == size else picked

    def initial_state(self) -> Array:
        """Return the state before the first sample of a run, all zero."""
        return np.zeros(self._kept + self.history * self.channels)

    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""
        known = np.concatenate((rise, state))
        weight, constant = self._map
        read = known if self._picked is None else known[self._picked]
        value = self._output(weight @ read + constant)
        kept = self._kept
        if not self.history:
            return value, known[:kept]
        past = known[kept + len(rise) : len(known) - len(value)]
        return value, np.concatenate((known[:kept], value, past))

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        weight, constant = self._map
        columns = len(self.delay) * self.inputs
        drive = delayed_rises(rise, [slice(0, len(rise))], self.delay) @ weight[:, :columns].T
        drive += constant
        if not self.history:
            return self._output(drive)
        feedback = np.ascontiguousarray(weight[:, columns:])
        past = np.zeros(feedback.shape[1])
        values = np.empty((len(rise), self.channels))
        for k, sample in enumerate(drive):
            values[k] = self._output(sample + feedback @ past)
            past = np.concatenate((values[k], past[: -self.channels]))
        return values

    def with_interval(self: _Self, ratio: float) -> _Self:
        """Return the recursion for another interval: only a static one has a meaning there."""
        if self.history or self.delay[-1] > 0:
            return super().with_interval(ratio)
        return self


def delayed_rises(rise: Array, rows: Sequence[slice], delay: NDArray[np.int64]) -> Array:
    """Return the rises at each delay side by side; before its first sample a run's rise is zero.

    Parameters
    ----------
    rise : ndarray, shape (n, p)
        Rises [K].
    rows : sequence of slice
        Rows of each run; delays never cross from one run into another.
    delay : ndarray of int, shape (m,)
        Delays, 0 or more [samples].

    Returns
    -------
    ndarray, shape (n, m p)
        All rises at the first delay, then at the second, and so on [K].
    """
    samples, inputs = rise.shape
    delayed = np.zeros((samples, len(delay), inputs))
    for run in rows:
        for column, lag in enumerate(delay):
            length = run.stop - run.start
            delayed[run.start + min(lag, length) : run.stop, column] = rise[
                run.start : run.start + max(length - lag, 0)
            ]
    return delayed.reshape(samples, -1)


def _own_history_columns(feedback: Array) -> Array:
    """Return the part of the linear map that reads the history.

    Parameters
    ----------
    feedback : ndarray, shape (c, h, K)
        Weight of each past output of a channel in each of its h mapped values.

    Returns
    -------
    ndarray, shape (c h, K c)
        Zero where a channel would read the history of another.
    """
    channels, rows, history = feedback.shape
    columns = np.zeros((channels, rows, history, channels))
    for channel in range(channels):
        columns[channel, :, :, channel] = feedback[channel]
    return columns.reshape(channels * rows, history * channels)


def _check_delay(delay: NDArray[np.int64], columns: int) -> None:
    """Refuse delays that are negative, too long, not ascending, or ask for too large a state.

    Parameters
    ----------
    delay : ndarray of int
        Delays [samples].
    columns : int
        Columns of the map, one per delay and input.
    """
    ascending = delay.ndim == 1 and len(delay) > 0 and bool((np.diff(delay) > 0).all())
    if not ascending or delay[0] < 0 or delay[-1] > DELAY_MAX:
        raise ValueError(
            f'delay: expected ascending delays from 0 to {DELAY_MAX}, but found {delay}'
        )
    kept = int(delay[-1]) * (columns // len(delay))
    if kept > STATE_MAX:
        raise ValueError(
            f'delay: expected a state of at most {STATE_MAX} numbers, but found {kept}'
        )


def _read_delay(node: Node) -> NDArray[np.int64]:
    """Return the delays of a document; fractions and delays that fill the memory are refused."""
    delay = node.vector()
    if (delay != np.rint(delay)).any() or (np.abs(delay) > DELAY_MAX).any():
        node.refuse(f'whole numbers of at most {DELAY_MAX} samples')
    return delay.astype(np.int64)


@dataclass(frozen=True, eq=False)
class MovingAverageRecursion(_DelayedRecursion):
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
        _check_delay(self.delay, columns)
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
        past = _own_history_columns(self.feedback[:, np.newaxis, :])
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
        delay = _read_delay(node.get('delay'))
        feedback = node.get('feedback').list()
        history = len(feedback[0].list()) if feedback else 0
        return cls(
            delay=delay,
            drive=node.get('drive').matrix(len(delay) * inputs),
            feedback=node.get('feedback').matrix(history),
            offset=node.get('offset').vector(),
            limit=node.get('limit').vector(),
        )


@dataclass(frozen=True, eq=False)
class FilterNetworkRecursion(_DelayedRecursion):
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
        _check_delay(self.delay, self.inner.shape[-1])
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
        return np.hstack([rises, _own_history_columns(self.feedback)]), self.bias.ravel()

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
        delay = _read_delay(node.get('delay'))
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
