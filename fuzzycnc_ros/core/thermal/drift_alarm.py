# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Tell from probes when a machine is no longer the one that its model was trained on."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import Band

ALLOWANCE = 1.5
"""Size of a normalised residual that is no sign of drift [-].

Residuals of a healthy model are no white noise: between two probes of one warm-up they hardly
change.  With 1.0 the sums of 6 % of 48 runs of mixed duty reached `LIMIT`, with 1.5 none."""

LIMIT = 4.0
"""Sum of the excess at which the model no longer fits [-]."""


GROWTH = 1.75
"""Widening of what a probe may miss at the border of the domain [-]."""


class DriftAlarm:
    """Two-sided cumulative sum of normalised probe residuals (Page's CUSUM).

    high(k) = max(0, high(k-1) + z(k) - 1.5),  low(k) = max(0, low(k-1) - z(k) - 1.5);
    an alarm is raised when one of them exceeds 4 and stays until a new model is in use.

    Parameters
    ----------
    channels : int
        Number c of channels.
    limit : float
        Sum at which the alarm is raised [-].

    References
    ----------
    E. S. Page, Continuous inspection schemes, Biometrika 41 (1954) 100-115.

    Examples
    --------
    >>> from fuzzycnc_ros.core.thermal.drift_alarm import DriftAlarm
    >>> alarm = DriftAlarm(1)
    >>> [bool(alarm.update([z])[0]) for z in (1.0, -0.5, 4.0, 4.0)]
    [False, False, False, True]
    """

    def __init__(self, channels: int, limit: float = LIMIT) -> None:
        if channels < 1 or not limit > 0.0:
            raise ValueError(
                'expected 1 or more channels and a limit above 0, but found '
                f'{channels} channels and {limit}'
            )
        self.limit = limit
        self._sums = np.zeros((2, channels))
        self._counts = np.zeros((2, channels))
        self.alarmed: NDArray[np.bool_] = np.zeros(channels, dtype=np.bool_)
        """Which channels have drifted, shape (c,)."""

    @property
    def sums(self) -> Array:
        """Excess to the high and to the low side, shape (2, c) [-]."""
        return self._sums.copy()

    @property
    def mean(self) -> Array:
        """Mean normalised residual since each larger sum began, shape (c,) [-]; 0 if none has."""
        side = np.argmax(self._sums, axis=0)
        columns = np.arange(len(side))
        count = self._counts[side, columns]
        sign = np.where(side == 0, 1.0, -1.0)
        mean = self._sums[side, columns] / np.maximum(count, 1.0) + ALLOWANCE
        return np.where(count > 0.0, sign * mean, 0.0)

    @property
    def probes(self) -> NDArray[np.int64]:
        """Number of probes since each larger sum began, shape (c,)."""
        side = np.argmax(self._sums, axis=0)
        return np.asarray(self._counts[side, np.arange(len(side))], dtype=np.int64)

    def update(self, residual: ArrayLike) -> NDArray[np.bool_]:
        """Take the residuals of one probe and return which channels have drifted, shape (c,).

        Parameters
        ----------
        residual : array_like, shape (c,)
            Measured minus predicted error, before any correction by probes, over its standard
            deviation [-]; NaN where nothing was probed.
        """
        value = np.asarray(residual, dtype=np.float64)
        if value.shape != self.alarmed.shape or np.isinf(value).any():
            raise ValueError(
                f'residual: expected {len(self.alarmed)} numbers or NaN, but found {value}'
            )
        known = np.isfinite(value)
        # Cut so that one probe, which may have met a chip, never raises the alarm alone.
        value = np.clip(value, -self.limit, self.limit)
        excess = np.where(known, np.stack([value, -value]) - ALLOWANCE, 0.0)
        self._sums = np.maximum(0.0, self._sums + excess)
        self._counts = np.where(self._sums > 0.0, self._counts + known, 0.0)
        self.alarmed = self.alarmed | (self._sums > self.limit).any(axis=0)
        return self.alarmed.copy()

    @property
    def state(self) -> Array:
        """Flat array of doubles: sums, counts, alarms; shape (5c,)."""
        return np.concatenate([self._sums.ravel(), self._counts.ravel(), self.alarmed])

    @state.setter
    def state(self, values: ArrayLike) -> None:
        state, channels = np.array(values, dtype=np.float64), len(self.alarmed)
        if state.shape != (5 * channels,) or not np.isfinite(state).all() or (state < 0.0).any():
            raise ValueError(
                f'state: expected {5 * channels} numbers of 0 or more, but found {state.tolist()}'
            )
        self._sums = state[: 2 * channels].reshape(2, channels)
        self._counts = state[2 * channels : 4 * channels].reshape(2, channels)
        self.alarmed = state[4 * channels :] > 0.0


def drift_deviation(residual: Array, distance: float, noise: Array) -> Array:
    """Return by what a probe may miss a healthy model, shape (c,) [m].

    Parameters
    ----------
    residual : ndarray, shape (c,)
        Root mean square that the model left on held-out samples [m].
    distance : float
        Distance of the rises from the training data, 1 at the border of the domain [-].
    noise : ndarray, shape (c,)
        Standard deviation of the probe [m].

    Notes
    -----
    It grows with the distance: a duty far from the training must not be taken for a machine that
    has changed.
    """
    return np.asarray(np.hypot(Band(residual, GROWTH).at(np.array(distance)), noise))
