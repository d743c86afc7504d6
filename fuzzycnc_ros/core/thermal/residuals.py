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


def largest_of(residual: Array) -> Array:
    """Return the largest size in each column (n, c) of what is not NaN, NaN if nothing is."""
    measured = ~np.isnan(residual)
    highest = np.where(measured, np.abs(residual), 0.0).max(axis=0)
    return np.where(measured.any(axis=0), highest, np.nan)
