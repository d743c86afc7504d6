# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How far a prediction may be off: held-out residuals, widened with the distance."""

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.residuals import mean_of_square

WIDTH = 2.0
"""Half width of the band in standard deviations [-]."""

COVERED = 0.95
"""Share of the held-out samples that the band must hold [-]; of a normal distribution 0.954."""

BORDER_FACTOR = 2.0
"""Widening of the band at the border of the domain, method sheet 001 section 8.E."""


@dataclass(frozen=True, eq=False)
class Band:
    """Standard deviation of a prediction, method sheet 001 section 8.E.

    Parameters
    ----------
    deviation : ndarray, shape (c,)
        Standard deviation amid the training samples [m], see `held_out_deviation`.
    limit : float
        Distance from the training up to which a sample lies in the domain [-].

    Notes
    -----
    The sheet doubles the deviation outside the domain.  Here it grows in proportion to the
    distance, from half the limit on: at the border it is doubled, twice as far out doubled again.
    Two deviations of lagged ridge, trained on the runs D0, T1 and D0b of the simulated mill, then
    hold 0.93 and 0.95 of the residuals on the unseen T2 and T3, with the sheet's factor 0.88 and
    0.82; on speeds that a real spindle had not been trained on, 0.93 of the residuals of three
    linear models in three cases, with the sheet's factor 0.64.  Where the distance of many alike
    sensors says little the band is wider than need be: on unseen runs of the simulated grinder
    the sheet's factor holds all residuals already.
    """

    deviation: Array
    limit: float

    def at(self, distance: Array, claimed: Array | None = None) -> Array:
        """Return the standard deviation of predictions.

        Parameters
        ----------
        distance : ndarray, shape (...)
            Distance of each sample from the training, in the units of `limit` [-].
        claimed : ndarray, shape (..., c), optional
            What the model itself says, as a Gaussian process does [m]; NaN where it says
            nothing.

        Returns
        -------
        ndarray, shape (..., c)
            Standard deviation [m], the larger one of both.
        """
        ratio = np.asarray(distance, dtype=np.float64)[..., np.newaxis] / self.limit
        own = np.maximum(1.0, BORDER_FACTOR * ratio) * self.deviation
        return np.asarray(own if claimed is None else np.fmax(own, claimed))


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
