# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzy clustering: c-means, and Gustafson-Kessel with an ellipsoidal norm for each cluster.

References
----------
[bezdek1981], [xie1991], [gustafson1978], [babuska2002]
"""

from abc import ABC, abstractmethod
from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array, Seed
from fuzzycnc_ros.core.estimator import ClusterEstimator, check_features, check_fitted

FUZZIFIER_MAX = 50.0
"""Largest fuzzifier; far above any use, and the powers of small memberships stay numbers."""
_ROWS = 4
"""Points whose products with all others are taken in one go."""


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
    """True if equal samples count once for the largest number of clusters."""

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
        return _memberships_by_distance(self._squared_distances(samples), self.m)[0].T

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


def _raised(membership: Array, m: float) -> Array:
    return np.square(membership) if m == 2.0 else portable.power(membership, m)


def _memberships_by_distance(distance: Array, m: float) -> tuple[Array, Array]:
    """Return memberships by squared distances (..., c, n), [ding_zeng] eq. (7), and their powers.

    With nearness q, d_min over d, memberships are q^(1/(m-1)) / S, so that their m-th powers are
    they themselves times q / S^(m-1).
    """
    nearness = distance.min(axis=-2, keepdims=True) / distance
    share = nearness if m == 2.0 else portable.power(nearness, 1.0 / (m - 1.0))
    total = share.sum(axis=-2, keepdims=True)
    membership = share / total
    if m == 2.0:
        return membership, np.square(membership)
    return membership, membership * (nearness / portable.power(total, m - 1.0))


@dataclass(eq=False, repr=False)
class FuzzyCMeans(FuzzyPartition):
    """Fuzzy c-means, [bezdek1981].

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
        Objective J of the kept start, [ding_zeng] eq. (8), in squared units of the samples.
    objective_history_ : ndarray, shape (n_iter_,)
        J after each iteration; it never increases.
    n_iter_ : int
        Iterations of the kept start.
    partition_coefficient_ : float
        Mean squared membership sum, in [1/n_clusters, 1]; 1 is crisp, 1/n_clusters collapsed.
    xie_beni_ : float
        Compactness over separation, [xie1991]; smaller is better, NaN if two centres coincide.

    Notes
    -----
    Only distances enter the equations, and centres are sums of samples: of samples with more
    features than there are samples, their products with each other suffice.  All starts iterate
    together.

    Examples
    --------
    >>> model = FuzzyCMeans(2, random_state=0).fit([[0.0], [0.1], [5.0], [5.1]])
    >>> sorted(model.cluster_centers_.round(2).ravel().tolist())
    [0.05, 5.05]
    """

    n_clusters: int = 5
    _: KW_ONLY
    m: float = 2.0
    n_init: int = 5
    max_iter: int = 300
    tol: float = 1e-6
    random_state: Seed = None

    _DISTINCT: ClassVar = False

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
        starts = rng.dirichlet(np.ones(self.n_clusters), (self.n_init, len(centred)))
        membership, history = _iterate(
            centred, starts.transpose(0, 2, 1), self.m, self.max_iter, self.tol
        )
        weight = _raised(membership, self.m)
        centers = portable.matmul(weight, centred) / weight.sum(axis=1, keepdims=True)
        self._keep(membership, centers + mean, history)
        self.partition_coefficient_ = float((membership * membership).sum() / len(centred))
        self.xie_beni_ = _xie_beni(self.objective_, centers, len(centred))
        return self

    def _squared_distances(self, samples: Array) -> Array:
        # Centred so that samples far from the origin keep their digits.
        mean = self.cluster_centers_.mean(axis=0)
        points, centers = samples - mean, self.cluster_centers_ - mean
        square = np.einsum('np,np->n', points, points)
        own = np.einsum('cp,cp->c', centers, centers)
        return _squared_distance(
            square, portable.matmul(centers, points.T), own, _least_distance(square)
        )


def _iterate(
    points: Array, starts: Array, m: float, max_iter: int, tol: float
) -> tuple[Array, Array]:
    """Alternate [ding_zeng] eqs. (9) and (7) from all starts (r, c, n).

    Return the best and its history.
    """
    square = np.einsum('np,np->n', points, points)
    least = _least_distance(square)
    by_products = len(points) <= 2 * points.shape[1]
    table = _products(points) if by_products else np.ascontiguousarray(points.T)
    membership = starts
    weight = _raised(membership, m)
    active = np.arange(len(starts))
    history: list[list[float]] = [[] for _ in starts]
    final = np.empty_like(starts)
    for _ in range(max_iter):
        share = weight / weight.sum(axis=2, keepdims=True)
        if by_products:
            product = portable.matmul(share, table)
            own = np.einsum('rcn,rcn->rc', product, share)
        else:
            centers = np.einsum('rcn,pn->rcp', share, table)
            product = portable.matmul(centers, table)
            own = np.einsum('rcp,rcp->rc', centers, centers)
        distance = _squared_distance(square, product, own, least)
        updated, weight = _memberships_by_distance(distance, m)
        objective = np.einsum('rcn,rcn->r', weight, distance)
        change = np.abs(updated - membership).max(axis=(1, 2))
        membership = updated
        for start, value in zip(active.tolist(), objective.tolist(), strict=True):
            history[start].append(value)
        going = change > tol
        if not going.all():
            final[active] = membership
            membership, weight, active = membership[going], weight[going], active[going]
        if not len(active):
            break
    final[active] = membership
    best = min(range(len(starts)), key=lambda start: history[start][-1])
    return final[best], np.array(history[best])


def _products(points: Array) -> Array:
    """Return the products of points with each other, shape (n, n), each of which is taken once."""
    found = np.empty((len(points), len(points)))
    for first in range(0, len(points), _ROWS):
        part = np.einsum('np,mp->nm', points[first : first + _ROWS], points[first:])
        found[first : first + _ROWS, first:] = part
        found[first:, first : first + _ROWS] = part.T
    return found


def _least_distance(square: Array) -> float:
    """Return a floor of squared distances, about what rounding leaves of the squared lengths.

    A sample that sits on a centre does not divide by zero, and centres that coincide share it.
    """
    return float(np.finfo(np.float64).eps) * max(float(square.max(initial=0.0)), 1e-300)


def _squared_distance(square: Array, product: Array, own: Array, least: float) -> Array:
    """Return squared distances of points to centres, shape (..., c, n).

    Parameters
    ----------
    square : ndarray, shape (n,)
        Squared lengths of the points.
    product : ndarray, shape (..., c, n)
        Products of centres and points.
    own : ndarray, shape (..., c)
        Squared lengths of the centres.
    least : float
        Floor of what is returned.
    """
    distance = square - 2.0 * product
    distance += own[..., np.newaxis]
    return np.maximum(distance, least, out=distance)


def _xie_beni(objective: float, centers: Array, samples: int) -> float:
    if len(centers) < 2:
        return float('nan')
    difference = centers[:, np.newaxis] - centers
    separation = np.einsum('ijp,ijp->ij', difference, difference)
    closest = float(separation[~np.eye(len(centers), dtype=bool)].min())
    return objective / (samples * closest) if closest > 0.0 else float('nan')


_CONDITION_MAX = 1e8
"""Largest ratio of the eigenvalues of a cluster's covariance, [babuska2002]."""

DISTANCE_MIN = 1e-12
"""Floor of the squared distances: a sample may lie on a centre."""


@dataclass(eq=False, repr=False)
class GustafsonKessel(FuzzyPartition):
    """Regularised Gustafson-Kessel clustering, [gustafson1978] with [babuska2002].

    Parameters
    ----------
    n_clusters : int
        Number of clusters, 1 to the number of distinct samples.
    m : float
        Fuzzifier [-], above 1, at most 50.
    regularisation : float
        Share of the covariance of all samples, made round, in that of each cluster [-], 0 to 1.
        Without any the norm of a cluster that lies in a plane does not exist.
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
    norm_matrices_ : ndarray, shape (n_clusters, p, p)
        Matrices M of the clusters' norms, of determinant 1.
    labels_ : ndarray, shape (n,)
        Cluster of highest membership of each sample.
    objective_ : float
        Objective J of the kept start.
    objective_history_ : ndarray, shape (n_iter_,)
        J after each iteration.  With regularisation it may rise by about 1e-4 of itself.
    n_iter_ : int
        Iterations of the kept start.
    converged_ : bool
        Whether the kept start came to rest before `max_iter`.

    Notes
    -----
    Distances depend on the units of the columns: scale them first, and leave constant columns out.
    All starts iterate together.

    Examples
    --------
    >>> lines = [[t, 0.0] for t in range(5)] + [[2.0, 10.0 + t] for t in range(5)]
    >>> model = GustafsonKessel(2, random_state=0).fit(lines)
    >>> sorted(model.cluster_centers_.round(1).tolist())
    [[2.0, 0.0], [2.0, 12.0]]
    """

    n_clusters: int = 10
    _: KW_ONLY
    m: float = 2.0
    regularisation: float = 0.02
    n_init: int = 4
    max_iter: int = 400
    tol: float = 1e-5
    random_state: Seed = None

    _DISTINCT: ClassVar = True

    def fit(self, X: ArrayLike, y: Any = None) -> 'GustafsonKessel':  # noqa: N803
        """Cluster the samples.

        Parameters
        ----------
        X : array_like, shape (n, p)
            Samples by rows.
        y : None
            Ignored; part of scikit-learn's convention.

        Returns
        -------
        GustafsonKessel
            The estimator.

        Raises
        ------
        ValueError
            If a parameter is out of range, or there are fewer distinct samples than clusters.
        """
        points, mean, rng = self._begin(X)
        seeds = np.stack([_spread_seeds(points, self.n_clusters, rng) for _ in range(self.n_init)])
        found = _iterate_with_norms(
            points, seeds, self.m, _round_covariance(points, self.regularisation),
            self.regularisation, self.max_iter, self.tol,
        )  # fmt: skip
        self._keep(found.membership, found.center + mean, found.history)
        self.norm_matrices_ = found.norm
        self.converged_ = found.converged
        return self

    def _squared_distances(self, samples: Array) -> Array:
        apart = samples - self.cluster_centers_[:, np.newaxis]
        distance = np.einsum('cnp,cpq,cnq->cn', apart, self.norm_matrices_, apart)
        return np.asarray(np.maximum(distance, DISTANCE_MIN))

    def _check_parameters(self, samples: Array) -> None:
        super()._check_parameters(samples)
        if not 0.0 <= self.regularisation <= 1.0:
            raise ValueError(f'regularisation: expected 0 to 1, but found {self.regularisation}')


class ClassValues(NamedTuple):
    """Output values of the clusters [deng2014].

    Parameters
    ----------
    center, variance : ndarray, shape (c, q)
        Weighted mean and variance of each output in each cluster.
    decision : ndarray, shape (c, q)
        The recorded value closest to the mean.
    """

    center: Array
    variance: Array
    decision: Array


def class_values(membership: Array, outputs: Array, m: float = 2.0) -> ClassValues:
    """Return centre, variance and decision value of outputs (n, q) by memberships (n, c)."""
    weight = _raised(membership.T, m)
    weight /= weight.sum(axis=1, keepdims=True)
    center = portable.matmul(weight, outputs)
    apart = outputs - center[:, np.newaxis]
    variance = np.einsum('cn,cnq->cq', weight, apart * apart)
    nearest = np.abs(apart).argmin(axis=1)
    return ClassValues(center, variance, np.take_along_axis(outputs, nearest, axis=0))


def grow_clusters(
    samples: Array, outputs: Array, variance_max: float, model: GustafsonKessel
) -> GustafsonKessel:
    """Return the clustering with the fewest clusters, from 2, whose outputs vary little enough.

    Parameters
    ----------
    samples : ndarray, shape (n, p)
        Scaled samples to cluster.
    outputs : ndarray, shape (n, q)
        Outputs that the variance is taken of.
    variance_max : float
        Largest variance of any output in any cluster, in squared units of the outputs.
    model : GustafsonKessel
        Settings; its number of clusters is the most that is tried, and kept if none suffices.
    """
    params = model.get_params()
    for count in range(2, model.n_clusters):
        grown = GustafsonKessel(**(params | {'n_clusters': count})).fit(samples)
        if class_values(grown.membership_, outputs, model.m).variance.max() <= variance_max:
            return grown
    return model.fit(samples)


class _BestPartition(NamedTuple):
    """Memberships (c, n), centres, norms and objectives of the best start."""

    membership: Array
    center: Array
    norm: Array
    history: Array
    converged: bool


def _spread_seeds(points: Array, count: int, rng: np.random.Generator) -> Array:
    """Return centres (c, p) drawn from the points far from each other, as k-means++ does."""
    chosen = [points[rng.integers(len(points))]]
    nearest = np.square(points - chosen[0]).sum(axis=1)
    while len(chosen) < count:
        # Squares of differences near 1e-200 are 0 although the points are distinct.
        weight = nearest if nearest.any() else np.ones(len(points))
        chosen.append(points[rng.choice(len(points), p=weight / weight.sum())])
        nearest = np.minimum(nearest, np.square(points - chosen[-1]).sum(axis=1))
    return np.stack(chosen)


def _round_covariance(points: Array, regularisation: float) -> Array:
    """Return the share g d0 I of the round covariance that is mixed into each cluster's."""
    size = points.shape[1]
    total = portable.matmul(points.T, points) / len(points)
    value = np.linalg.eigvalsh(total)
    if value[0] > value[-1] / _CONDITION_MAX:
        volume = float(portable.exp(portable.log(value).mean()))
    else:
        volume = float(value.sum()) / size
    return np.asarray(regularisation * volume * np.eye(size))


def _iterate_with_norms(
    points: Array, seeds: Array, m: float, mixed: Array, share: float, max_iter: int, tol: float
) -> _BestPartition:
    """Alternate memberships and centres [gustafson1978] (r, c, p); return the best start."""
    features = np.ascontiguousarray(points.T)
    apart = features - seeds[..., np.newaxis]
    distance = (apart * apart).sum(axis=-2)
    membership, weight = _memberships_by_distance(np.maximum(distance, DISTANCE_MIN), m)
    starts = len(seeds)
    active = np.arange(starts)
    history: list[list[float]] = [[] for _ in range(starts)]
    last: list[tuple[Array, Array, Array, bool]] = [(seeds[0], seeds[0], seeds[0], False)] * starts
    for _ in range(max_iter):
        total = weight.sum(axis=2, keepdims=True)
        center = np.einsum('rcn,pn->rcp', weight, features) / total
        apart = features - center[..., np.newaxis]
        scatter = np.einsum('rcpn,rcqn->rcpq', weight[:, :, np.newaxis] * apart, apart)
        factor = _norm_factor((1.0 - share) * scatter / total[..., np.newaxis] + mixed)
        along = np.einsum('rcpq,rcpn->rcqn', factor, apart)
        distance = np.maximum(np.square(along).sum(axis=-2), DISTANCE_MIN)
        updated, weight = _memberships_by_distance(distance, m)
        objective = (weight * distance).sum(axis=(1, 2))
        change = np.abs(updated - membership).max(axis=(1, 2))
        for at, start in enumerate(active):
            history[start].append(float(objective[at]))
            last[start] = (updated[at], center[at], factor[at], bool(change[at] <= tol))
        going = change > tol
        membership, weight, active = updated[going], weight[going], active[going]
        if not len(active):
            break
    best = min(range(starts), key=lambda start: history[start][-1])
    found, center, factor, converged = last[best]
    norm = portable.matmul(factor, factor.swapaxes(-1, -2))
    return _BestPartition(found, center, norm, np.array(history[best]), converged)


def _norm_factor(covariance: Array) -> Array:
    """Return factors A (..., p, p) of the norms M = A A^T of determinant 1."""
    value, vector = np.linalg.eigh(covariance)
    largest = np.maximum(value[..., -1:], DISTANCE_MIN)
    value = np.maximum(value, largest / _CONDITION_MAX)
    volume = portable.exp(0.5 * portable.log(value).mean(axis=-1, keepdims=True))
    return np.asarray(vector * (volume / np.sqrt(value))[..., np.newaxis, :])
