# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of residuals with gaps."""

import numpy as np

from fuzzycnc_ros.core.arrays import Array


def mean_of_square(residual: Array) -> Array:
    """Return the mean square of each column (n, c) over what is not NaN, NaN if nothing is."""
    measured = ~np.isnan(residual)
    total = np.where(measured, residual, 0.0)
    count = measured.sum(axis=0)
    return np.where(count > 0, (total**2).sum(axis=0) / np.maximum(count, 1), np.nan)
