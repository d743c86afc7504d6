# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bounded adaptation of a model's gain, from what probes of many runs have in common."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.probing import OffsetGainFilter, ProbeVariances

FORGET_AFTER = 30 * 86400.0
"""Time [s] in which the gain of a machine may wander through its whole bound."""


class GainAdaptation:
    """Learn slowly, and within a bound, by which factor a machine exceeds its model.

    The residual of a probe is split into an offset, which belongs to the run and is forgotten at
    the next thermal reference, and a gain, which belongs to the machine and stays.  Only the gain
    adapts the model: error = (1 + gain) * prediction.

    Parameters
    ----------
    channels : int
        Number c of channels.
    bound : float
        Largest size of the gain, in (0, 1) [-].

    Raises
    ------
    ValueError
        If the bound lies outside.
    """

    def __init__(self, channels: int, bound: float) -> None:
        if not 0.0 < bound < 1.0:
            raise ValueError(f'bound: expected a fraction in (0, 1), but found {bound}')
        self._bound = bound
        # Two standard deviations reach the bound: larger gains are not expected at all.
        variance = (0.5 * bound) ** 2
        self._filter = OffsetGainFilter(
            channels, ProbeVariances(gain=variance, gain_rate=variance / FORGET_AFTER)
        )

    @property
    def gain(self) -> Array:
        """Gain in force, within the bound, shape (c,) [-]."""
        return np.clip(self._filter.estimate[:, 1], -self._bound, self._bound)

    def elapse(self, time: float) -> None:
        """Let `time` [s] pass."""
        self._filter.elapse(time)

    def update(self, predicted: Array, measured: Array, noise: Array) -> NDArray[np.int64]:
        """Take one probe and return the verdict on each channel, as `OffsetGainFilter.update`.

        Parameters
        ----------
        predicted, measured : ndarray, shape (c,)
            Error that the model predicts, not adapted, and probed error [m]; NaN where nothing
            was measured.
        noise : ndarray, shape (c,)
            By what a probe may miss a healthy model [m]: what the model cannot know within one
            run must not be learnt as a gain.
        """
        return self._filter.update(predicted, measured, noise)

    def begin(self) -> None:
        """Begin a new run: keep the gain, forget the offset."""
        self._filter.forget(keep_gain=True)

    @property
    def state(self) -> Array:
        """Flat array of finite doubles, shape (8c,)."""
        return self._filter.state

    @state.setter
    def state(self, values: ArrayLike) -> None:
        self._filter.state = np.asarray(values, dtype=np.float64)
