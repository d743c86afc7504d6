# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzy partitions: what clusterings share in which each sample belongs to every cluster."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array, Seed
from fuzzycnc_ros.core.estimator import ClusterEstimator, check_features, check_fitted

FUZZIFIER_MAX = 50.0
"""Largest fuzzifier; far above any use, and the powers of small memberships stay numbers."""


class FuzzyPartition(ClusterEstimator, ABC):
    """Base of fuzzy clusterings from random starts; they differ in the distances that count."""

    n_clusters: int
    m: float
    n_init: int
    max_iter: int
    tol: float
    random_state: Seed
    cluster_centers_: Array

    _DISTINCT: ClassVar[bool]
    """Whether equal samples count once for the largest number of clusters."""

    def predict_membership(self, X: ArrayLike) -> Array:  # noqa: N803
        """Return the memberships of new samples in the learnt clusters.

        Parameters
        ----------
        X : array_like, shape (n, p)
            Samples by rows.

        Returns
        -------
        ndarray, shape (n, n_clusters)
            Memberships [-]; rows sum to 1.
        """
        check_fitted(self, 'cluster_centers_')
        samples = check_features(self, X, reset=False)
        return np.asarray(memberships_by_distance(self._squared_distances(samples), self.m).T)

    def predict(self, X: ArrayLike) -> NDArray[np.int64]:  # noqa: N803
        """Return the cluster of highest membership of each sample, shape (n,)."""
        return np.asarray(self.predict_membership(X).argmax(axis=1), dtype=np.int64)

    @abstractmethod
    def _squared_distances(self, samples: Array) -> Array:
        """Return squared distances above 0 of samples (n, p) to the clusters, shape (c, n)."""

    def _begin(self, samples: ArrayLike) -> tuple[Array, Array, np.random.Generator]:
        """Return checked samples about their mean, that mean, and the generator of the starts."""
        checked = check_features(self, samples, reset=True)
        self._check_parameters(checked)
        mean = checked.mean(axis=0)
        return checked - mean, mean, np.random.default_rng(self.random_state)

    def _check_parameters(self, samples: Array) -> None:
        most, kind = len(samples), 'samples'
        if self._DISTINCT:
            most, kind = len(np.unique(samples, axis=0)), 'distinct samples'
        if not 1 <= self.n_clusters <= most:
            raise ValueError(
                f'n_clusters: expected 1 to {most} (the number of {kind}; n_samples='
                f'{len(samples)}), but found {self.n_clusters}'
            )
        if not 1.0 < self.m <= FUZZIFIER_MAX:
            raise ValueError(
                f'm: expected a fuzzifier above 1 and at most {FUZZIFIER_MAX:g}, '
                f'but found {self.m}'
            )
        for name, value in (('n_init', self.n_init), ('max_iter', self.max_iter)):
            if value < 1:
                raise ValueError(f'{name}: expected at least 1, but found {value}')
        if not self.tol >= 0.0:
            raise ValueError(f'tol: expected 0 or more, but found {self.tol}')

    def _keep(self, membership: Array, centers: Array, history: Array) -> None:
        """Keep memberships (c, n), centres and objectives of the best start."""
        self.membership_ = membership.T
        self.cluster_centers_ = centers
        self.labels_: NDArray[np.int64] = membership.argmax(axis=0)
        self.objective_history_ = history
        self.objective_ = float(history[-1])
        self.n_iter_ = len(history)


def memberships_by_distance(distance: Array, m: float) -> Array:
    """Return memberships by squared distances (..., c, n); method sheet 001 eq. (7)."""
    nearness = distance.min(axis=-2, keepdims=True) / distance
    if m != 2.0:
        nearness **= 1.0 / (m - 1.0)
    return np.asarray(nearness / nearness.sum(axis=-2, keepdims=True))
