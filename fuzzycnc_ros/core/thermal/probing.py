# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Correct a prediction by occasional probes, method sheet 001 section 8.D.

Both corrections are of the form error = prediction + offset + gain * prediction, per channel.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array

GATE = 4.0
"""Standard deviations beyond which a probe is doubted [-]."""

JUMP_MAX = 10e-6
"""Difference to the expected value that is never doubted [m]; a chip under the probe is larger."""


class Verdict(IntEnum):
    """What became of a probe."""

    ABSENT = 0
    """Nothing was measured in this channel."""
    ACCEPTED = 1
    REJECTED = 2
    """Far from the expected value, and no probe before it agrees."""


@dataclass(frozen=True)
class ProbeVariances:
    """How much of a model's error is offset, how much is gain, and how fast both wander.

    Parameters
    ----------
    offset, gain : float
        Variance before the first probe [m^2, -].
    offset_rate, gain_rate : float
        Growth of the variances with time [m^2/s, 1/s].
    """

    offset: float = 4e-12
    gain: float = 0.02
    offset_rate: float = 0.05e-12 / 60.0
    gain_rate: float = 1e-4 / 60.0

    def __post_init__(self) -> None:
        """Refuse variances that are negative or not finite."""
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f'{name}: expected a variance of 0 or more, but found {value}')


class OffsetGainFilter:
    """Kalman filter of two states per channel, offset [m] and gain [-].

    Parameters
    ----------
    channels : int
        Number c of channels, which are filtered apart.
    variances : ProbeVariances, optional
        Those of method sheet 001 section 8.D if absent.
    jump_max : float
        Difference to the expected value below which no probe is doubted [m].

    Examples
    --------
    >>> import numpy as np
    >>> from fuzzycnc_ros.core.thermal.probing import OffsetGainFilter
    >>> known = OffsetGainFilter(1)
    >>> known.update(np.array([20e-6]), np.array([26e-6]), np.array([0.7e-6]))
    array([1])
    >>> print(f'{1e6 * known.corrected(np.array([20e-6]))[0]:.1f} um')
    25.8 um
    """

    def __init__(
        self,
        channels: int,
        variances: ProbeVariances | None = None,
        jump_max: float = JUMP_MAX,
    ) -> None:
        if channels < 1:
            raise ValueError(f'channels: expected 1 or more, but found {channels}')
        self._variances = variances or ProbeVariances()
        self._jump_max = jump_max
        self.estimate: Array = np.zeros((channels, 2))
        """Offset [m] and gain [-] of each channel, shape (c, 2)."""
        self.covariance: Array = np.tile(self._prior(), (channels, 1, 1))
        """Their covariance, shape (c, 2, 2)."""
        self.probed: NDArray[np.bool_] = np.zeros(channels, dtype=np.bool_)
        """Whether a probe has been accepted, shape (c,)."""
        self._doubted = np.full(channels, np.nan)

    def elapse(self, time: float) -> None:
        """Let `time` [s] pass, in which offset and gain wander.

        Raises
        ------
        ValueError
            If time goes back.
        """
        if not time >= 0.0:
            raise ValueError(f'time: expected 0 s or more, but found {time}')
        growth = np.diag([self._variances.offset_rate, self._variances.gain_rate])
        self.covariance = self.covariance + time * growth

    def update(self, predicted: Array, measured: Array, noise: Array) -> NDArray[np.int64]:
        """Take one probe and return the verdict on each channel, shape (c,).

        A value further from the expected one than four standard deviations and than `jump_max`
        is rejected, unless the probe before was rejected too and both agree within `jump_max`:
        then the machine has jumped, and what was known of it is forgotten.

        Parameters
        ----------
        predicted : ndarray, shape (c,)
            Error that the model predicts for the time of the probe [m], without correction.
        measured : ndarray, shape (c,)
            Probed error [m]; NaN where nothing was measured.
        noise : ndarray, shape (c,)
            Standard deviation of the probe [m], of which the model's own scatter is a part.
        """
        verdict = np.full(len(self.probed), int(Verdict.ABSENT), dtype=np.int64)
        for channel in np.flatnonzero(np.isfinite(measured)):
            row = np.array([1.0, predicted[channel]])
            innovation = measured[channel] - predicted[channel] - row @ self.estimate[channel]
            variance = row @ self.covariance[channel] @ row + noise[channel] ** 2
            if abs(innovation) > max(self._jump_max, GATE * np.sqrt(variance)):
                # Not for NaN, of a channel whose last probe was not doubted.
                if not abs(innovation - self._doubted[channel]) <= self._jump_max:
                    self._doubted[channel] = innovation
                    verdict[channel] = Verdict.REJECTED
                    continue
                self.covariance[channel] = self._prior()
                # How far a jump goes, no variance of a healthy machine tells.
                self.covariance[channel, 0, 0] += innovation**2
            self._doubted[channel] = np.nan
            self._learn(int(channel), row, innovation, noise[channel] ** 2)
            self.probed[channel] = True
            verdict[channel] = Verdict.ACCEPTED
        return verdict

    def corrected(self, predicted: Array) -> Array:
        """Return predicted errors (c,) [m] with offset and gain."""
        return np.asarray(predicted + self.estimate[:, 0] + self.estimate[:, 1] * predicted)

    def deviation(self, predicted: Array) -> Array:
        """Return the standard deviation of the corrected errors, shape (c,) [m].

        It is NaN for a channel that was never probed.
        """
        rows = np.stack([np.ones_like(predicted), predicted], axis=1)
        variance = np.einsum('ci,cij,cj->c', rows, self.covariance, rows)
        return np.where(self.probed, np.sqrt(np.maximum(variance, 0.0)), np.nan)

    def forget(self, *, keep_gain: bool = False) -> None:
        """Begin anew at a thermal reference, where every offset is zero by definition.

        Parameters
        ----------
        keep_gain : bool
            Whether the gain, with its variance, is still believed.
        """
        gain, variance = self.estimate[:, 1].copy(), self.covariance[:, 1, 1].copy()
        self.estimate = np.zeros_like(self.estimate)
        self.covariance = np.tile(self._prior(), (len(self.probed), 1, 1))
        self.probed = np.zeros_like(self.probed)
        self._doubted = np.full_like(self._doubted, np.nan)
        if keep_gain:
            self.estimate[:, 1], self.covariance[:, 1, 1] = gain, variance

    def absorb(self, gain: Array, predicted: Array) -> None:
        """Give up what a change of the model's own gain (c,) has taken over.

        Parameters
        ----------
        gain : ndarray, shape (c,)
            Change of the gain outside this filter [-].
        predicted : ndarray, shape (c,)
            Predicted errors at the time of the change [m].
        """
        self.estimate[:, 1] -= gain

    @property
    def state(self) -> Array:
        """Flat array of finite doubles, shape (8c,): everything that later results rest on."""
        covariance = self.covariance[:, [0, 0, 1], [0, 1, 1]]
        doubted = np.isfinite(self._doubted)
        columns = [self.probed, doubted, np.where(doubted, self._doubted, 0.0)]
        return np.hstack([self.estimate, covariance, np.stack(columns, axis=1)]).ravel()

    @state.setter
    def state(self, values: ArrayLike) -> None:
        state, size = np.array(values, dtype=np.float64), 8 * len(self.probed)
        if state.shape != (size,) or not np.isfinite(state).all():
            raise ValueError(f'state: expected {size} finite numbers, but found {state.tolist()}')
        table = state.reshape(-1, 8)
        self.estimate = table[:, :2].copy()
        self.covariance = table[:, [2, 3, 3, 4]].reshape(-1, 2, 2)
        self.probed = table[:, 5] > 0.0
        self._doubted = np.where(table[:, 6] > 0.0, table[:, 7], np.nan)

    def _prior(self) -> Array:
        return np.diag([self._variances.offset, self._variances.gain])

    def _learn(self, channel: int, row: Array, innovation: float, noise_variance: float) -> None:
        covariance = self.covariance[channel]
        gain = covariance @ row / (row @ covariance @ row + noise_variance)
        self.estimate[channel] += gain * innovation
        updated = covariance - np.outer(gain, row @ covariance)
        # Rounding must not make the two cross terms differ.
        self.covariance[channel] = 0.5 * (updated + updated.T)


class OffsetReset(OffsetGainFilter):
    """Plain reset: after each probe the offset makes the corrected error what was measured.

    It has the same interface; the gain stays zero, and the variance is that of the probe, growing
    with the offset's rate.
    """

    def absorb(self, gain: Array, predicted: Array) -> None:
        """Give up by the offset what a change of the model's own gain (c,) has taken over."""
        self.estimate[:, 0] -= gain * predicted

    def _prior(self) -> Array:
        return np.diag([self._variances.offset, 0.0])

    def elapse(self, time: float) -> None:
        """Let `time` [s] pass, in which the offset wanders."""
        super().elapse(time)
        self.covariance[:, 1, 1] = 0.0

    def _learn(self, channel: int, row: Array, innovation: float, noise_variance: float) -> None:
        self.estimate[channel, 0] += innovation
        self.covariance[channel, 0, 0] = noise_variance
