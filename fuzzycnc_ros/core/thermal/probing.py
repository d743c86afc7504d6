# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Correct a prediction by occasional probes, and notice where the error drifts from it.

Both corrections are of the form error = prediction + offset + gain * prediction, per channel.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.band import Band

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
        Those measured on the simulated mill if absent.
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
            innovation = (
                measured[channel]
                - predicted[channel]
                - portable.matmul(row, self.estimate[channel])
            )
            variance = (
                portable.matmul(portable.matmul(row, self.covariance[channel]), row)
                + noise[channel] * noise[channel]
            )
            if abs(innovation) > max(self._jump_max, GATE * np.sqrt(variance)):
                # Not for NaN, of a channel whose last probe was not doubted.
                if not abs(innovation - self._doubted[channel]) <= self._jump_max:
                    self._doubted[channel] = innovation
                    verdict[channel] = Verdict.REJECTED
                    continue
                self.covariance[channel] = self._prior()
                # How far a jump goes, no variance of a healthy machine tells.
                self.covariance[channel, 0, 0] += innovation * innovation
            self._doubted[channel] = np.nan
            self._learn(int(channel), row, innovation, noise[channel] * noise[channel])
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
        gain = portable.matmul(covariance, row) / (
            portable.matmul(portable.matmul(row, covariance), row) + noise_variance
        )
        self.estimate[channel] += gain * innovation
        updated = covariance - np.outer(gain, portable.matmul(row, covariance))
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
        variance = 0.25 * bound * bound
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


ALLOWANCE = 1.5
"""Size of a normalised residual that is no sign of drift [-].

Residuals of a healthy model are no white noise: between two probes of one warm-up they hardly
change.  With 1.0 the sums of 6 % of 48 runs of mixed duty reached `CUSUM_LIMIT`, with 1.5 none."""

CUSUM_LIMIT = 4.0
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
    [page1954]

    Examples
    --------
    >>> from fuzzycnc_ros.core.thermal.probing import DriftAlarm
    >>> alarm = DriftAlarm(1)
    >>> [bool(alarm.update([z])[0]) for z in (1.0, -0.5, 4.0, 4.0)]
    [False, False, False, True]
    """

    def __init__(self, channels: int, limit: float = CUSUM_LIMIT) -> None:
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
