# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Where a model has been trained, so that it can say when it extrapolates."""

from dataclasses import dataclass, field, replace

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
    drive : ndarray, shape (d,)
        Largest driver that it was trained on [-]; empty where the model reads none.
    """

    mean: Array
    inverse_covariance: Array
    limit: float
    drive: Array = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        """Refuse numbers that would put every sample into the domain, or none."""
        if not self.limit > 0.0:
            raise ValueError(f'limit: expected a positive distance, but found {self.limit}')
        if not (self.drive >= 0.0).all():
            raise ValueError(f'drive: expected 0 or more, but found {self.drive}')
        inverse = 0.5 * (self.inverse_covariance + self.inverse_covariance.T)
        if not (np.linalg.eigvalsh(inverse) > 0.0).all():
            raise ValueError(
                'inverse_covariance: expected a positive definite matrix but found another; '
                'train the model anew'
            )

    @staticmethod
    def of(rise: Array, drive: Array | None = None) -> 'Domain':
        """Describe the training rises (n, p) [K] and drivers (n, d) [-]."""
        mean: Array = np.asarray(rise.mean(axis=0), dtype=np.float64)
        covariance = np.atleast_2d(np.cov(rise, rowvar=False))
        # Collinear sensors differ by less than their noise, which says nothing of the domain.
        noise = RISE_NOISE**2 * np.eye(len(mean))
        inverse = np.asarray(np.linalg.inv(covariance + noise), dtype=np.float64)
        domain = Domain(mean, inverse, np.inf)
        limit = float(np.quantile(domain.distance(rise), DOMAIN_QUANTILE))
        largest = np.empty(0) if drive is None else np.asarray(drive.max(axis=0))
        return replace(domain, limit=limit, drive=largest)

    def distance(self, samples: Array) -> Array:
        """Return the distance [-] of rises [K] and, behind them, drivers [-] from the training.

        Parameters
        ----------
        samples : ndarray, shape (..., p) or (..., p + d)
            Rises, or rises and drivers.

        Returns
        -------
        ndarray, shape (...)
            Mahalanobis distance of the rises, or `limit` times the largest ratio of a driver to
            the largest that it was trained on, whichever is more.
        """
        inputs = len(self.mean)
        apart = samples[..., :inputs] - self.mean
        square = ((apart @ self.inverse_covariance) * apart).sum(axis=-1)
        distance = np.sqrt(np.maximum(square, 0.0))
        if samples.shape[-1] == inputs or not len(self.drive):
            return np.asarray(distance)
        ratio = samples[..., inputs:] / np.where(self.drive > 0.0, self.drive, np.inf)
        return np.asarray(np.maximum(distance, self.limit * ratio.max(axis=-1)))
