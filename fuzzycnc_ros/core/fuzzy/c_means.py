# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzy c-means clustering.

References
----------
.. [1] J. C. Bezdek, "Pattern Recognition with Fuzzy Objective Function Algorithms", 1981.
.. [2] X. L. Xie, G. Beni, "A validity measure for fuzzy clustering", 1991.
"""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array, Seed
from fuzzycnc_ros.core.fuzzy.partition import FuzzyPartition, memberships_by_distance


class FuzzyCMeans(FuzzyPartition):
    """Fuzzy c-means, [1]_; method sheet 001 eqs. (7)-(9).

    Parameters
    ----------
    n_clusters : int
        Number of clusters, 1 to the number of samples.
    m : float
        Fuzzifier [-], above 1, at most 50; towards 1 the memberships become crisp.
    n_init : int
        Number of random starts; the one with the least objective is kept.
    max_iter : int
        Largest number of iterations of one start.
    tol : float
        Largest change of a membership [-] that counts as converged.
    random_state : int, numpy.random.Generator or None
        Seed of the starts.

    Attributes
    ----------
    membership_ : ndarray, shape (n, n_clusters)
        Degree to which each sample belongs to each cluster [-]; rows sum to 1.
    cluster_centers_ : ndarray, shape (n_clusters, p)
        Cluster centres in the units of the samples.
    labels_ : ndarray, shape (n,)
        Cluster of highest membership of each sample.
    objective_ : float
        Objective J of the kept start, eq. (8), in squared units of the samples.
    objective_history_ : ndarray, shape (n_iter_,)
        J after each iteration; it never increases.
    n_iter_ : int
        Iterations of the kept start.
    partition_coefficient_ : float
        Mean squared membership sum, in [1/n_clusters, 1]; 1 is crisp, 1/n_clusters collapsed.
    xie_beni_ : float
        Compactness over separation, [2]_; smaller is better, NaN if two centres coincide.

    Notes
    -----
    Only distances enter the equations, so samples with more features than there are samples are
    first turned, without loss, into as many coordinates as there are samples.  All starts
    iterate together.

    Examples
    --------
    >>> model = FuzzyCMeans(2, random_state=0).fit([[0.0], [0.1], [5.0], [5.1]])
    >>> sorted(model.cluster_centers_.round(2).ravel().tolist())
    [0.05, 5.05]
    """

    _DISTINCT: ClassVar = False

    def __init__(
        self,
        n_clusters: int = 5,
        *,
        m: float = 2.0,
        n_init: int = 5,
        max_iter: int = 300,
        tol: float = 1e-6,
        random_state: Seed = None,
    ) -> None:
        self.n_clusters = n_clusters
        self.m = m
        self.n_init = n_init
        self.max_iter = max_iter
        self.tol = tol
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: Any = None) -> 'FuzzyCMeans':  # noqa: N803
        """Cluster the samples.

        Parameters
        ----------
        X : array_like, shape (n, p)
            Samples by rows.
        y : None
            Ignored; part of scikit-learn's convention.

        Returns
        -------
        FuzzyCMeans
            The estimator.

        Raises
        ------
        ValueError
            If a parameter is out of range, or there are fewer samples than clusters.
        """
        centred, mean, rng = self._begin(X)
        points = centred
        if points.shape[1] > points.shape[0]:
            points = np.transpose(np.linalg.qr(points.T, mode='r'))
        starts = rng.dirichlet(np.ones(self.n_clusters), (self.n_init, len(points)))
        membership, history = _iterate(
            points, starts.transpose(0, 2, 1), self.m, self.max_iter, self.tol
        )
        weight = membership**self.m
        centers = weight @ centred / weight.sum(axis=1, keepdims=True)
        self._keep(membership, centers + mean, history)
        self.partition_coefficient_ = float((membership**2).sum() / len(points))
        self.xie_beni_ = _xie_beni(self.objective_, centers, len(points))
        return self

    def _squared_distances(self, samples: Array) -> Array:
        # Centred so that samples far from the origin keep their digits.
        mean = self.cluster_centers_.mean(axis=0)
        return np.asarray(
            _squared_distance(samples - mean, (self.cluster_centers_ - mean)[np.newaxis])[0]
        )


def _iterate(
    points: Array, starts: Array, m: float, max_iter: int, tol: float
) -> tuple[Array, Array]:
    """Alternate eqs. (9) and (7) from all starts (r, c, n); return the best and its history."""
    membership = starts
    active = np.arange(len(starts))
    history: list[list[float]] = [[] for _ in starts]
    final = np.empty_like(starts)
    for _ in range(max_iter):
        weight = membership**m
        centers = weight @ points / weight.sum(axis=2, keepdims=True)
        distance = _squared_distance(points, centers)
        updated = memberships_by_distance(distance, m)
        objective = np.einsum('rcn,rcn->r', updated**m, distance)
        change = np.abs(updated - membership).max(axis=(1, 2))
        membership = updated
        final[active] = updated
        for start, value in zip(active, objective, strict=True):
            history[start].append(float(value))
        going = change > tol
        if not going.all():
            membership, active = membership[going], active[going]
        if not len(active):
            break
    best = min(range(len(starts)), key=lambda start: history[start][-1])
    return final[best], np.array(history[best])


def _squared_distance(points: Array, centers: Array) -> Array:
    """Return the squared distances of points (n, p) to centres (r, c, p), shape (r, c, n)."""
    square = np.einsum('np,np->n', points, points)
    distance = centers @ points.T
    distance *= -2.0
    distance += square
    distance += np.einsum('rcp,rcp->rc', centers, centers)[..., np.newaxis]
    # Rounding leaves about 1e-16 of the square; a floor there keeps a sample that sits on a
    # centre from dividing by zero, and lets centres that coincide share it equally.
    floor = np.finfo(np.float64).eps * max(float(square.max(initial=0.0)), 1e-300)
    return np.asarray(np.maximum(distance, floor))


def _xie_beni(objective: float, centers: Array, samples: int) -> float:
    if len(centers) < 2:
        return float('nan')
    difference = centers[:, np.newaxis] - centers
    separation = np.einsum('ijp,ijp->ij', difference, difference)
    closest = float(separation[~np.eye(len(centers), dtype=bool)].min())
    return objective / (samples * closest) if closest > 0.0 else float('nan')
