# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Gate before a model is used: process values it was not trained on are refused."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array

TOLERANCE = 1e-6
"""What the box is widened by [deg, mm]: directions of a path are rounded."""

SUPPORT_QUANTILE = 0.01
"""Share of the training samples whose support lies below the least that is let pass."""


@dataclass(frozen=True, eq=False)
class Gate:
    """Box of the training samples and the least support; method sheet 000 section 6.4.

    Support alone is no guard: it is a sum over single inputs, and a deep foot in a thin sheet has
    an ordinary depth and an ordinary thickness.  So the box bounds depth over thickness as well.

    Parameters
    ----------
    low, high : ndarray, shape (5,)
        Least and largest process values.
    ratio_low, ratio_high : float
        Least and largest depth over thickness [-].
    support_min : float
        Least logarithm of the support by the rules.
    """

    low: Array
    high: Array
    ratio_low: float
    ratio_high: float
    support_min: float

    @staticmethod
    def of_training(x: Array, support: Array, quantile: float = SUPPORT_QUANTILE) -> 'Gate':
        """Return the gate of training samples (k, 5) and the logarithm of their support (k,)."""
        ratio = x[:, 1] / x[:, 4]
        return Gate(
            x.min(axis=0),
            x.max(axis=0),
            float(ratio.min()),
            float(ratio.max()),
            float(np.quantile(support, quantile)),
        )

    def inside(self, x: Array) -> NDArray[np.bool_]:
        """Return whether rows of process values (k, 5) lie in the box; NaN does not."""
        within = ((x >= self.low - TOLERANCE) & (x <= self.high + TOLERANCE)).all(axis=1)
        depth, kind, thickness = x[:, 1], x[:, 2], x[:, 4]
        within &= (kind == 1.0) | (kind == 2.0)
        # Products, not ratios: a thickness of 0 is refused without a division.
        within &= depth >= self.ratio_low * thickness - TOLERANCE
        within &= depth <= self.ratio_high * thickness + TOLERANCE
        return np.asarray(within)

    def accepts(self, x: Array, support: Array) -> NDArray[np.bool_]:
        """Return whether rows lie in the box and have support enough, shape (k,)."""
        return np.asarray(self.inside(x) & (support >= self.support_min))

    def clip(self, x: Array) -> Array:
        """Return the rows with each value, and depth over thickness, cut at the box."""
        cut = np.clip(x, self.low, self.high)
        cut[:, 1] = np.clip(cut[:, 1], self.ratio_low * cut[:, 4], self.ratio_high * cut[:, 4])
        return np.asarray(cut)
