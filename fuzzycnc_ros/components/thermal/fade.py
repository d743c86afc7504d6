# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values that move to their targets along a straight line, so that nothing on a machine steps."""

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array


class Fade:
    """Move values linearly to a target in a given time.

    Parameters
    ----------
    value : array_like, shape (n,)
        Values to begin with, in any unit; they stand still until `to` is called.

    Raises
    ------
    ValueError
        If a value is not finite.

    Notes
    -----
    Time reaches a fade only as what has elapsed: its state holds no date, and a checkpoint of it
    can be resumed at any later time.

    Examples
    --------
    >>> from fuzzycnc_ros.components.thermal.fade import Fade
    >>> fade = Fade([0.0])
    >>> fade.to([8.0], duration=60.0)
    >>> [float(fade.advance(30.0)[0]) for _ in range(3)]
    [4.0, 8.0, 8.0]
    """

    def __init__(self, value: ArrayLike) -> None:
        self._value = _finite('value', value)
        self._target = self._value
        self._remaining = 0.0

    @property
    def value(self) -> Array:
        """Values now, shape (n,)."""
        return self._value.copy()

    @property
    def target(self) -> Array:
        """Values that are moved to, shape (n,)."""
        return self._target.copy()

    @property
    def remaining(self) -> float:
        """Time until the target is reached [s]; 0 at rest."""
        return self._remaining

    def to(self, target: ArrayLike, duration: float) -> None:
        """Begin to move, from the values now, to a target within `duration` [s].

        Raises
        ------
        ValueError
            If the target has another shape or is not finite, or the duration is not positive;
            the move under way then goes on.
        """
        wanted = _finite('target', target)
        if wanted.shape != self._value.shape:
            raise ValueError(
                f'target: expected shape {self._value.shape}, but found {wanted.shape}'
            )
        if not (np.isfinite(duration) and duration > 0.0):
            raise ValueError(f'duration: expected a positive number of s, but found {duration}')
        self._target = wanted
        self._remaining = 0.0 if np.array_equal(wanted, self._value) else float(duration)

    def advance(self, elapsed: float) -> Array:
        """Return the values, shape (n,), after another `elapsed` [s].

        Raises
        ------
        ValueError
            If time goes back.
        """
        if not elapsed >= 0.0:
            raise ValueError(f'elapsed: expected 0 s or more, but found {elapsed}')
        if elapsed >= self._remaining:
            self._value, self._remaining = self._target, 0.0
        else:
            share = elapsed / self._remaining
            self._value = self._value + share * (self._target - self._value)
            self._remaining -= elapsed
        return self.value

    @property
    def state(self) -> Array:
        """Flat array of doubles: time left [s], values, targets; shape (1 + 2n,)."""
        return np.concatenate([[self._remaining], self._value, self._target])

    @state.setter
    def state(self, values: ArrayLike) -> None:
        size = len(self._value)
        state = _finite('state', values)
        if state.shape != (1 + 2 * size,) or state[0] < 0.0:
            raise ValueError(
                f'state: expected a time left and {2 * size} values, but found {state.tolist()}'
            )
        self._remaining = float(state[0])
        self._value, self._target = state[1 : 1 + size], state[1 + size :]


def _finite(name: str, values: ArrayLike) -> Array:
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 or not np.isfinite(array).all():
        raise ValueError(f'{name}: expected a list of finite numbers, but found {array.tolist()}')
    return array
