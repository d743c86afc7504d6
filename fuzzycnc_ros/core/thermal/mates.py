# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the other sensors of a machine, the mates, say of a sensor's rise.

All mates share one matrix of moments; the weights of any set of them follow from a part of it.
So a mate that fails is left out at run time and the others take its place, without training.
"""

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array

RIDGE = 1e-4
"""Penalty on the weights of mates that are scaled to a mean square of 1 [-].

On duties that no figure is quoted for, 1e-3 missed the spindle's sensors by up to 1.2 K where
1e-4 missed them by 1.0 K, as it shrinks towards zero what rises by 13 K."""

LEVERAGE_RIDGE = 0.1
"""Penalty in the distance of a sample from the training samples [-]: the noise of a sensor that
hardly warms, a mean square of about 0.004 when scaled, must not count as distance."""

VOTERS = 2
"""Groups of mates that judge a sensor, each on its own."""

Indices = NDArray[np.int64]


def moment_of(rise: Array) -> Array:
    """Return the sums of products of rises (n, s) [K], shape (s, s) [K^2]."""
    return np.asarray(rise.T @ rise)


def scale_of(moment: Array) -> Array:
    """Return the root mean square of each sensor's rise, 1 for one that never rose, shape (s,)."""
    scale = np.sqrt(np.diag(moment))
    return np.where(scale > 0.0, scale, 1.0)


def ranked_mates(moment: Array, target: int, usable: Indices) -> Indices:
    """Return the usable sensors but the target, the one most alike first."""
    alike = moment[target] / scale_of(moment)
    mates = usable[usable != target]
    return np.asarray(mates[np.argsort(-alike[mates], kind='stable')])


def mate_weights(moment: Array, target: int, mates: Indices) -> Array:
    """Return the weights of mates in the ridge estimate of a target's rise, shape (k,) [-].

    Parameters
    ----------
    moment : ndarray, shape (s, s)
        Mean products of the rises in training [K^2].
    target : int
        Sensor to estimate.
    mates : ndarray of int, shape (k,)
        Sensors to estimate it from.
    """
    scale = scale_of(moment)[mates]
    alike = moment[np.ix_(mates, mates)] / np.outer(scale, scale)
    own = moment[target, mates] / scale
    return np.asarray(np.linalg.solve(alike + RIDGE * np.eye(len(mates)), own) / scale)


def unexplained(moment: Array, target: int, mates: Indices, weights: Array) -> float:
    """Return the root mean square of what an estimate misses in training [K]."""
    seen = moment[target, mates] @ weights
    square = moment[target, target] - 2.0 * seen
    square += weights @ moment[np.ix_(mates, mates)] @ weights
    return float(np.sqrt(max(square, 0.0)))


def voter_weights(moment: Array, targets: Indices, usable: Indices) -> Array:
    """Return what each voter expects of each target per kelvin of each sensor.

    The mates are dealt out to the voters in turn, best first, so that each voter has some from
    every part of the machine and no sensor speaks twice.

    Parameters
    ----------
    moment : ndarray, shape (s, s)
        Mean products of the rises in training [K^2].
    targets : ndarray of int, shape (p,)
        Sensors that are judged; they need not be usable.
    usable : ndarray of int
        Sensors that can be mates.

    Returns
    -------
    ndarray, shape (voters, p, s)
        Weights [-]; all NaN for a target with fewer usable mates than voters.
    """
    weights = np.zeros((VOTERS, len(targets), len(moment)))
    for row, target in enumerate(targets):
        mates = ranked_mates(moment, int(target), usable)
        if len(mates) < VOTERS:
            weights[:, row] = np.nan
            continue
        for voter in range(VOTERS):
            group = mates[voter::VOTERS]
            weights[voter, row, group] = mate_weights(moment, int(target), group)
    return weights


def agreed(residual: Array) -> Array:
    """Return what both voters miss to the same side: the smaller of the two, else 0.

    Parameters
    ----------
    residual : ndarray, shape (..., 2, p)
        What each voter misses [K].

    Returns
    -------
    ndarray, shape (..., p)
        What they agree on [K].
    """
    one, other = residual[..., 0, :], residual[..., 1, :]
    low, high = np.minimum(one, other), np.maximum(one, other)
    return np.asarray(np.maximum(low, 0.0) + np.minimum(high, 0.0))


class Leverage:
    """How far a sample of rises lies from the training samples, as its mates see it.

    Parameters
    ----------
    moment : ndarray, shape (s, s)
        Mean products of the rises in training [K^2].
    targets : ndarray of int, shape (p,)
        Sensors that are judged.
    usable : ndarray of int
        Sensors that may be read.
    """

    def __init__(self, moment: Array, targets: Indices, usable: Indices) -> None:
        scale = scale_of(moment)[usable]
        alike = moment[np.ix_(usable, usable)] / np.outer(scale, scale)
        inverse = np.linalg.inv(alike + LEVERAGE_RIDGE * np.eye(len(usable)))
        self.metric = np.zeros_like(moment)
        """Inverse of the penalised moments, shape (s, s) [1/K^2]; 0 for what is not usable."""
        self.metric[np.ix_(usable, usable)] = inverse / np.outer(scale, scale)
        self._targets = targets
        own = np.diag(self.metric)[targets]
        # A target that is not usable is no part of the distance: nothing is to be taken off.
        self._share = np.where(own > 0.0, 1.0 / np.where(own > 0.0, own, 1.0), 0.0)

    def of(self, rise: Array) -> Array:
        """Return the squared distance of rises (..., s) [K] without each target, (..., p) [-]."""
        return self.without_targets(rise, rise @ self.metric)

    def without_targets(self, rise: Array, pulled: Array) -> Array:
        """Return what `of` does, from the product of rises and `metric` that is known already.

        It is the distance of all sensors less what the target adds to it, given the others.
        """
        whole = np.add.reduce(pulled * rise, axis=-1, keepdims=True)
        return np.asarray(whole - self._share * pulled[..., self._targets] ** 2)
