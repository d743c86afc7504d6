# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Models on delayed rises and on their own past outputs at run time."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.recursions.base import Recursion, axes

_Self = TypeVar('_Self', bound='DelayedRecursion')

DELAY_MAX = 1440
"""Longest delay [samples], a day of minutes; all rises since then are part of the state."""

STATE_MAX = 1_000_000
"""Most past rises in a state, 8 MB; a day of minutes of 76 sensors are 110,000."""


@dataclass(frozen=True, eq=False)
class DelayedRecursion(Recursion):
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

    delay: NDArray[np.int64] = field(metadata=axes('m'))

    def _check(self) -> None:
        """Refuse delays that are negative, too long, not ascending, or fill the memory."""
        delay, columns = self.delay, self._sizes['mp']
        ascending = len(delay) > 0 and bool((np.diff(delay) > 0).all())
        if not ascending or delay[0] < 0 or delay[-1] > DELAY_MAX:
            raise ValueError(
                f'delay: expected ascending delays from 0 to {DELAY_MAX}, but found {delay}'
            )
        if columns % len(delay):
            raise ValueError(
                f'delay: expected a multiple of {len(delay)} columns, one per delay and input, '
                f'but found {columns}'
            )
        kept = int(delay[-1]) * self.inputs
        if kept > STATE_MAX:
            raise ValueError(
                f'delay: expected a state of at most {STATE_MAX} numbers, but found {kept}'
            )

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return self._sizes['mp'] // len(self.delay)

    @property
    def history(self) -> int:
        """Number K of past outputs that feed back."""
        return self._sizes['k']

    @classmethod
    def _read_array(
        cls, name: str, node: Node, names: tuple[str, ...], sizes: dict[str, int]
    ) -> Array:
        """Return an array of a document; delays are whole and do not fill the memory."""
        values = super()._read_array(name, node, names, sizes)
        if name != 'delay':
            return values
        if (values != np.rint(values)).any() or (np.abs(values) > DELAY_MAX).any():
            node.refuse(f'whole numbers of at most {DELAY_MAX} samples')
        return values.astype(np.int64)

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
        value = self._output(portable.matmul(weight, read) + constant)
        kept = self._kept
        if not self.history:
            return value, known[:kept]
        past = known[kept + len(rise) : len(known) - len(value)]
        return value, np.concatenate((known[:kept], value, past))

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        weight, constant = self._map
        columns = len(self.delay) * self.inputs
        drive = portable.matmul(
            delayed_rises(rise, [slice(0, len(rise))], self.delay), weight[:, :columns].T
        )
        drive += constant
        if not self.history:
            return self._output(drive)
        feedback = np.ascontiguousarray(weight[:, columns:])
        past = np.zeros(feedback.shape[1])
        values = np.empty((len(rise), self.channels))
        for k, sample in enumerate(drive):
            values[k] = self._output(sample + portable.matmul(feedback, past))
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


def own_history_columns(feedback: Array) -> Array:
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


@dataclass(frozen=True, eq=False)
class FilterNetworkRecursion(DelayedRecursion):
    """Network with one hidden layer on delayed rises and past outputs [kang2007].

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

    inner: Array = field(metadata=axes('c h mp'))
    feedback: Array = field(metadata=axes('c h k'))
    bias: Array = field(metadata=axes('c h'))
    outer: Array = field(metadata=axes('c h'))
    offset: Array = field(metadata=axes('c'))
    scale: Array = field(metadata=axes('c', 1e-12))

    def _linear(self) -> tuple[Array, Array]:
        rises = self.inner.reshape(self.bias.size, -1)
        return np.hstack([rises, own_history_columns(self.feedback)]), self.bias.ravel()

    @cached_property
    def _outer(self) -> Array:
        # Here, since nodes without a model do without: they start sooner.
        from scipy.linalg import block_diag

        return np.ascontiguousarray(block_diag(*self.outer))

    def _output(self, activation: Array) -> Array:
        hidden = portable.tanh(activation)
        return np.asarray(
            self.scale * portable.tanh(portable.matmul(hidden, self._outer.T) + self.offset)
        )
