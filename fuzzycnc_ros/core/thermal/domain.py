# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Where a model has been trained, so that it can say when it extrapolates."""

from dataclasses import dataclass, replace

import numpy as np

from fuzzycnc_ros.core.arrays import Array

DOMAIN_QUANTILE = 0.99
"""Share of the training samples that lie in the domain."""

RISE_NOISE = 0.1
"""Standard deviation below which differences between sensors are noise [K]."""


@dataclass(frozen=True, eq=False)
class Domain:
    """Rises that the model was trained on, as an ellipsoid.

    Parameters
    ----------
    mean : ndarray, shape (p,)
        Mean rise of each input [K].
    inverse_covariance : ndarray, shape (p, p)
        Inverse covariance of the rises [1/K^2].
    limit : float
        Mahalanobis distance that 99 % of the training samples stay below [-].
    """

    mean: Array
    inverse_covariance: Array
    limit: float

    @staticmethod
    def of(rise: Array) -> 'Domain':
        """Describe the training rises (n, p) [K]."""
        mean: Array = np.asarray(rise.mean(axis=0), dtype=np.float64)
        covariance = np.atleast_2d(np.cov(rise, rowvar=False))
        # Collinear sensors differ by less than their noise, which says nothing of the domain.
        noise = RISE_NOISE**2 * np.eye(len(mean))
        inverse = np.asarray(np.linalg.inv(covariance + noise), dtype=np.float64)
        domain = Domain(mean, inverse, np.inf)
        limit = float(np.quantile(domain.distance(rise), DOMAIN_QUANTILE))
        return replace(domain, limit=limit)

    def distance(self, rise: Array) -> Array:
        """Return the Mahalanobis distance [-] of rises (..., p) [K] from the mean."""
        apart = rise - self.mean
        square = ((apart @ self.inverse_covariance) * apart).sum(axis=-1)
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))
