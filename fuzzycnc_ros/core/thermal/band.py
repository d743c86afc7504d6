# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How far a prediction may be off: held-out residuals, widened with the distance."""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.chance import SCATTER_WEIGHT
from fuzzycnc_ros.core.thermal.residuals import mean_of_square

WIDTH = 2.0
"""Half width of the band in standard deviations [-]."""

COVERED = 0.95
"""Share of the held-out samples that the band must hold [-]; of a normal distribution 0.954."""

GROWTHS = (0.5, 1.0, 2.0)
"""Widenings of the band at the border of the domain that training chooses from [-]."""


@dataclass(frozen=True, eq=False)
class Band:
    """Standard deviation of a prediction, wider where the model was not trained.

    Parameters
    ----------
    deviation : ndarray, shape (c,)
        Standard deviation amid the training samples [m], see `fitted_band`.
    growth : float
        Widening at the border of the domain [-]: the deviation grows in proportion to the
        distance beyond the point at which growth * distance is 1.
    """

    deviation: Array
    growth: float

    def at(self, distance: Array, claimed: Array | None = None) -> Array:
        """Return the standard deviation of predictions.

        Parameters
        ----------
        distance : ndarray, shape (...)
            Distance of each sample from the training, 1 at the border of the domain [-].
        claimed : ndarray, shape (..., c), optional
            What the model itself says, as a Gaussian process does [m]; NaN where it says
            nothing.

        Returns
        -------
        ndarray, shape (..., c)
            Standard deviation [m], the larger one of both.
        """
        ratio = np.asarray(distance, dtype=np.float64)[..., np.newaxis]
        own = widening(ratio, self.growth) * self.deviation
        return np.asarray(own if claimed is None else np.fmax(own, claimed))


def widening(distance: Array, growth: float) -> Array:
    """Return the factor on the deviation at a distance from the training [-], 1 or more."""
    return np.maximum(1.0, growth * distance)


def fitted_band(residual: Array, distance: Array, folds: int) -> Band:
    """Return the band that residuals of unseen samples speak for.

    The growth is the one under which they are most likely, if they are normal; the deviation of
    each channel then is the least one whose band holds 95 % of them, as in split conformal
    prediction [1]_, times what few folds leave unknown of another run (Student's t).

    Parameters
    ----------
    residual : ndarray, shape (n, c)
        Residuals of samples that neither fit nor choice had seen [m]; NaN where nothing was
        measured, infinite where a prediction diverged.
    distance : ndarray, shape (n,)
        Their distance from what had been seen, 1 at the border of the domain [-].
    folds : int
        Number of folds that they come from and that share no sample.

    References
    ----------
    .. [1] J. Lei, M. G'Sell, A. Rinaldo, R. J. Tibshirani, L. Wasserman, "Distribution-free
       predictive inference for regression", Journal of the American Statistical Association
       113(523), 2018, pp. 1094-1111, doi:10.1080/01621459.2017.1307116.
    """
    bands = [
        Band(held_out_deviation(residual / widening(distance, growth)[:, np.newaxis]), growth)
        for growth in GROWTHS
    ]
    surprise = [_surprise(residual, band.at(distance)) for band in bands]
    best = bands[int(np.argmin(surprise))]
    # Samples of one run err alike: what counts is how many runs there were.
    unknown = stdtrit(SCATTER_WEIGHT + folds, 0.5 + 0.5 * COVERED) / WIDTH
    return Band(max(1.0, float(unknown)) * best.deviation, best.growth)


def _surprise(residual: Array, deviation: Array) -> float:
    """Return the negative logarithm of the likelihood per sample, up to a constant."""
    with np.errstate(over='ignore', invalid='ignore', divide='ignore'):
        values = 0.5 * (residual / deviation) ** 2 + np.log(deviation)
    values = values[np.isfinite(residual) & np.isfinite(values)]
    return float(values.mean()) if len(values) else 0.0


def held_out_deviation(residual: Array) -> Array:
    """Return the standard deviation that residuals of unseen samples speak for.

    Parameters
    ----------
    residual : ndarray, shape (n, c)
        Residuals of samples that the judged fits had not seen [m]; NaN where nothing was
        measured, infinite where a prediction diverged.

    Returns
    -------
    ndarray, shape (c,)
        Root mean square [m], or more where two of it hold less than 95 % of the residuals, as
        with a few large ones among many small.  NaN if nothing was measured.
    """
    with np.errstate(over='ignore'):
        rms = np.sqrt(mean_of_square(residual))
    quantile = [
        np.quantile(channel[~np.isnan(channel)], COVERED, method='higher')
        if np.isfinite(level)
        else level
        for channel, level in zip(np.abs(residual).T, rms, strict=True)
    ]
    return np.maximum(rms, np.array(quantile) / WIDTH)


def coverage(residual: Array, deviation: Array) -> Array:
    """Return the share of residuals within two standard deviations.

    Parameters
    ----------
    residual : ndarray, shape (n, c)
        Measured minus predicted or the reverse [m]; NaN where nothing was measured.
    deviation : ndarray, shape (n, c) or (c,)
        Standard deviation that was predicted [m].

    Returns
    -------
    ndarray, shape (c,)
        Share of the measured samples [-], NaN if there are none.
    """
    measured = ~np.isnan(residual)
    inside = measured & (np.abs(residual) <= WIDTH * deviation)
    count = measured.sum(axis=0)
    return np.where(count > 0, inside.sum(axis=0) / np.maximum(count, 1), np.nan)
