# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a fitted model is at run time: a recursion from rises to thermal error.

Every model ends up as a recursion, so that batch prediction, streaming, the model file and the
conversion between sampling intervals are written once.  Batch and stream execute the same
operations and therefore agree to the last digits.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.document import Node

Self = TypeVar('Self', bound='Recursion')


class Recursion(ABC):
    """A fitted model of one or more channels: numbers only, no training data, no estimator.

    A subclass is a frozen dataclass of arrays.  It refuses arrays that do not fit together in
    `__post_init__`, since they may come from a file.
    """

    FORM: ClassVar[str]
    """Name of the form in model files."""

    @property
    @abstractmethod
    def inputs(self) -> int:
        """Number p of inputs."""

    @property
    @abstractmethod
    def channels(self) -> int:
        """Number c of channels."""

    @abstractmethod
    def initial_state(self) -> Array:
        """Return the state before the first sample of a run, where every rise is zero, flat."""

    @abstractmethod
    def step(self, rise: Array, state: Array) -> tuple[Array, Array]:
        """Return the thermal errors (c,) [m] and the next state for one sample of rises (p,)."""

    def run(self, rise: Array) -> Array:
        """Return the thermal errors (n, c) [m] of a whole run of rises (n, p) [K]."""
        state = self.initial_state()
        values = np.empty((len(rise), self.channels))
        for k, sample in enumerate(rise):
            values[k], state = self.step(sample, state)
        return values

    def standard_deviation(self, rise: Array) -> Array:
        """Return what the form itself says of its deviation.

        Parameters
        ----------
        rise : ndarray, shape (..., p)
            Rises [K].

        Returns
        -------
        ndarray, shape (..., c)
            Standard deviation [m]; NaN where it says nothing, as most forms do.
        """
        return np.full((*rise.shape[:-1], self.channels), np.nan)

    def with_interval(self: Self, ratio: float) -> Self:
        """Return the recursion for an interval `ratio` times as long.

        Raises
        ------
        ValueError
            If the form has no meaning at another interval.
        """
        raise ValueError(
            f'interval: expected the interval of the training, but found {ratio:g} times that; '
            f'a model of the form {self.FORM!r} holds for one interval: train it anew'
        )

    @abstractmethod
    def channel(self: Self, channel: int) -> Self:
        """Return the recursion of one channel out of several."""

    @classmethod
    def merge(cls: type[Self], items: Sequence[Self]) -> Self | None:
        """Return one recursion for the channels of several of this form, None if it cannot be.

        The inputs are the same.  What cannot be merged runs side by side.
        """
        return None

    @abstractmethod
    def document(self) -> dict[str, Any]:
        """Return the numbers as JSON values; `read` takes them back."""

    @classmethod
    @abstractmethod
    def read(cls: type[Self], node: Node, inputs: int) -> Self:
        """Return the recursion of a document, believing nothing in it.

        Raises
        ------
        ModelFileError, ValueError
            If a value is missing, of another type or shape, or not finite.
        """


class Stream:
    """One pass of a recursion over samples as they come.

    Parameters
    ----------
    recursion : Recursion
        What to run.
    """

    def __init__(self, recursion: Recursion) -> None:
        self._recursion = recursion
        self._state = recursion.initial_state()

    def step(self, rise: ArrayLike) -> Array:
        """Take one sample of rises, shape (p,) [K], and return the thermal errors, shape (c,) [m].

        Raises
        ------
        ValueError
            If the sample has another length or holds NaN; the state then stays as it was.
        """
        sample = np.asarray(rise, dtype=np.float64)
        if sample.shape != (self._recursion.inputs,):
            raise ValueError(
                f'rise: expected {self._recursion.inputs} values, but found shape {sample.shape}'
            )
        # One sum is far cheaper than a test of each element; it is finite if all of them are.
        if not np.isfinite(sample.sum()):
            raise ValueError(f'rise: expected finite values, but found {sample}')
        value, self._state = self._recursion.step(sample, self._state)
        return value

    @property
    def state(self) -> Array:
        """Copy of the state, a flat array of doubles."""
        return np.array(self._state)

    @state.setter
    def state(self, values: ArrayLike) -> None:
        state = np.array(values, dtype=np.float64)
        if state.shape != self._state.shape or not np.isfinite(state).all():
            raise ValueError(
                f'state: expected {self._state.size} finite numbers, but found {state.tolist()}'
            )
        self._state = state


def clipped(values: Array, bound: Array) -> Array:
    """Return values cut at plus and minus a bound."""
    # np.clip takes four times as long on arrays as small as these.
    return np.asarray(np.minimum(np.maximum(values, -bound), bound))


def run_slices(runs: ArrayLike | None, samples: int) -> list[slice]:
    """Return the rows of each run.

    Parameters
    ----------
    runs : array_like, shape (n,), or None
        Label of the run that each sample belongs to; None is one run.
    samples : int
        Number n of samples.

    Raises
    ------
    ValueError
        If the length differs or the samples of one run do not lie together.
    """
    if runs is None:
        return [slice(0, samples)]
    labels: NDArray[np.generic] = np.asarray(runs)
    if labels.shape != (samples,):
        raise ValueError(f'runs: expected {samples} labels, but found shape {labels.shape}')
    cuts = [0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist(), samples]
    if len(cuts) - 1 != len(np.unique(labels)):
        raise ValueError('runs: expected the samples of each run together, but found them split')
    return [slice(first, last) for first, last in pairwise(cuts)]


def check_shapes(owner: object, **shapes: tuple[int, ...]) -> None:
    """Refuse arrays of other shapes or with values that are not finite.

    Raises
    ------
    ValueError
        The message names the array.
    """
    for name, shape in shapes.items():
        values = getattr(owner, name)
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError(
                f'{name}: expected finite numbers of shape {shape}, but found shape {values.shape}'
            )


def check_interval(interval: float) -> None:
    """Refuse an interval that is not a positive number of seconds."""
    if not (np.isfinite(interval) and interval > 0.0):
        raise ValueError(f'interval: expected a positive number of s, but found {interval}')
