# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Whether one model is better than another by more than chance: a moderated t-test.

Held-out folds are few, so the scatter that they show is moderated by what is expected of it
beforehand [1]_.  Residuals are compared by the logarithm of their ratio.

References
----------
.. [1] G. K. Smyth, "Linear models and empirical Bayes methods for assessing differential
   expression in microarray experiments", Statistical Applications in Genetics and Molecular
   Biology 3(1), 2004, article 3, doi:10.2202/1544-6115.1027.
"""

import numpy as np
from scipy.special import stdtrit

from fuzzycnc_ros.core.arrays import Array

CONFIDENCE = 0.95
"""Confidence at which one model is better than another [-]; shared by all that compete."""

WORTH_CONFIDENCE = 0.8
"""Confidence at which a model is better than none [-]: temperatures do move machines."""

SCATTER = 0.3
"""Scatter of the gain from fold to fold that is expected beforehand [-]."""

SCATTER_WEIGHT = 3.0
"""How many folds this expectation is worth [-]."""

GAIN_MIN = 0.1
"""Least gain that is worth another model [-]: the natural logarithm of the residuals' ratio."""

GAIN_MAX = float(np.log(2.0))
"""Most that one fold may say for or against a model at all [-]: it halves the error."""

RESIDUAL_MIN = 1e-12
"""Residual below which all models are equally good [m]."""


def log_residual(square: Array) -> Array:
    """Return the logarithm of the residual over all folds.

    Parameters
    ----------
    square : ndarray, shape (..., folds, c)
        Mean square of each fold and channel [m^2]; NaN where nothing was measured.

    Returns
    -------
    ndarray, shape (..., c)
        Logarithm of the root mean square.
    """
    return np.asarray(0.5 * np.log(np.maximum(np.nanmean(square, axis=-2), RESIDUAL_MIN**2)))


def better(square: Array, other: Array, independent: int, rivals: int = 1) -> bool:
    """Return whether a model is better than another by a tenth, and beyond chance.

    The ratio of the residuals over all folds is tested on its jackknife pseudo-values.

    Parameters
    ----------
    square, other : ndarray, shape (folds, c)
        Mean squares of both [m^2]; the logarithms of the ratios are averaged over the channels.
    independent : int
        Number of folds that share no sample.
    rivals : int
        How many models the first was picked from as the best (Bonferroni).
    """
    measured = ~np.isnan(other).all(axis=1)
    square, other = square[measured], other[measured]
    gain = _gain(square, other)
    if not np.isfinite(gain):
        return gain == np.inf
    folds = len(square)
    variance = 0.0
    if folds > 1:
        kept = [np.delete(np.arange(folds), fold) for fold in range(folds)]
        without = np.array([_gain(square[rows], other[rows]) for rows in kept])
        variance = float((folds * gain - (folds - 1) * without).var(ddof=1))
    error = (1.0 - CONFIDENCE) / rivals
    return gain > GAIN_MIN and _significant(gain, variance, min(folds, independent), error)


def worth_using(square: Array, none: Array, independent: int) -> bool:
    """Return whether a model is better than none by a tenth, and beyond chance.

    Over all folds it has to leave less.  In the test every fold counts alike, whatever its size,
    and says at most that the error is halved or doubled: how much better a model is must not
    count as scatter against it.

    Parameters
    ----------
    square, none : ndarray, shape (folds,)
        Mean squares with the model and without [m^2].
    independent : int
        Number of folds that share no sample.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        gain = 0.5 * np.log(
            np.maximum(none, RESIDUAL_MIN**2) / np.maximum(square, RESIDUAL_MIN**2)
        )
    gain = np.clip(gain[~np.isnan(none)], -GAIN_MAX, GAIN_MAX)
    if np.isnan(gain).any() or not len(gain):
        return False
    if not _gain(square[:, np.newaxis], none[:, np.newaxis]) > GAIN_MIN:
        return False
    variance = float(gain.var(ddof=1)) if len(gain) > 1 else 0.0
    mean, count = float(gain.mean()), min(len(gain), independent)
    return _significant(mean, variance, count, 1.0 - WORTH_CONFIDENCE)


def _gain(square: Array, other: Array) -> float:
    with np.errstate(invalid='ignore'):
        return float(np.nanmean(log_residual(other) - log_residual(square)))


def _significant(gain: float, variance: float, count: int, error: float) -> bool:
    """Return whether a mean gain is above zero, given the variance of single ones."""
    if not np.isfinite(variance):
        return False
    count = max(1, count)
    freedom = SCATTER_WEIGHT + count - 1
    moderated = (SCATTER_WEIGHT * SCATTER**2 + (count - 1) * variance) / freedom
    return bool(gain > float(stdtrit(freedom, 1.0 - error)) * np.sqrt(moderated / count))
