# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Gain per axis that a model's outputs are multiplied by, learnt from measured compensations."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array

GAIN_MIN, GAIN_MAX = 0.5, 2.0
"""Bounds of a gain [-]: beyond them the model is to be trained anew."""

PRIOR_VARIANCE = 0.1
"""Variance of a gain before anything was measured [-]."""

NOISE_VARIANCE = 0.25
"""Variance of a measured compensation about the scaled prediction [mm^2 per (50 mm)^2]."""


@dataclass(frozen=True, eq=False)
class AxisGain:
    """Gains k with s = k s_model, by scalar recursive least squares; method sheet 000 section 6.6.

    Parameters
    ----------
    value : ndarray, shape (r,)
        Gain of each output [-], within 0.5 and 2.
    variance : ndarray, shape (r,)
        Variance of each gain [-].

    Examples
    --------
    >>> gain = AxisGain.unit(2)
    >>> for _ in range(5):
    ...     gain = gain.updated([4.0, 2.0], [5.0, 2.5])
    >>> gain.value.round(2).tolist()
    [1.24, 1.22]
    """

    value: Array
    variance: Array

    @staticmethod
    def unit(outputs: int) -> 'AxisGain':
        """Return the gains of a model that nothing was measured against."""
        return AxisGain(np.ones(outputs), np.full(outputs, PRIOR_VARIANCE))

    def updated(self, predicted: ArrayLike, measured: ArrayLike) -> 'AxisGain':
        """Return the gains after one sample.

        Parameters
        ----------
        predicted : array_like, shape (r,)
            Output of the model without gain [mm per 50 mm].
        measured : array_like, shape (r,)
            Compensation that was needed [mm per 50 mm].

        Raises
        ------
        ValueError
            If a value is not finite or their number is not that of the gains.
        """
        pair = np.array([predicted, measured], dtype=np.float64)
        if pair.shape != (2, len(self.value)) or not np.isfinite(pair).all():
            raise ValueError(
                f'gain: expected {len(self.value)} finite predictions and measurements, '
                f'but found {predicted!r} and {measured!r}'
            )
        correction = self.variance * pair[0] / (NOISE_VARIANCE + self.variance * pair[0] ** 2)
        value = self.value + correction * (pair[1] - self.value * pair[0])
        variance = (1.0 - correction * pair[0]) * self.variance
        return AxisGain(np.clip(value, GAIN_MIN, GAIN_MAX), variance)
