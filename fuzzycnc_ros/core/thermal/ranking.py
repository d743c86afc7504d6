# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Relevance of a sensor to the thermal error: correlation and grey relational grade."""

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array

DISTINGUISHING_COEFFICIENT = 0.5
"""Distinguishing coefficient rho of the grey relational grade [-]."""


def grey_relational_grade(series: Array, target: Array) -> Array:
    """Return the grey relational grade of each series with a target [ding_zeng].

    Parameters
    ----------
    series : ndarray, shape (n, s)
        Compared series, none of them constant.
    target : ndarray, shape (n,)
        Reference series.

    Returns
    -------
    ndarray, shape (s,)
        Grades in (0, 1] [-], 1 for a series of the same shape.

    Notes
    -----
    Series are scaled to [0, 1] and turned over where they fall as the target rises; the least
    and the largest difference are taken over all series and samples.
    """
    sign = np.where(correlation_of(series, target[:, np.newaxis])[:, 0] < 0.0, -1.0, 1.0)
    difference = np.abs(_unit_range(series * sign) - _unit_range(target[:, np.newaxis]))
    least, most = float(difference.min()), float(difference.max())
    if most == 0.0:
        return np.ones(series.shape[1])
    scale = DISTINGUISHING_COEFFICIENT * most
    return np.asarray(((least + scale) / (difference + scale)).mean(axis=0))


def correlation_of(first: Array, second: Array) -> Array:
    """Return the correlations of columns, shape (s, t); 0 for a constant column."""
    one, two = first - first.mean(axis=0), second - second.mean(axis=0)
    norm = np.outer(np.linalg.norm(one, axis=0), np.linalg.norm(two, axis=0))
    return np.asarray(portable.matmul(one.T, two) / np.where(norm > 0.0, norm, 1.0))


def _unit_range(series: Array) -> Array:
    low, span = series.min(axis=0), np.ptp(series, axis=0)
    return np.asarray((series - low) / np.where(span > 0.0, span, 1.0))
