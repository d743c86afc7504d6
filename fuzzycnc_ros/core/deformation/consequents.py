# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Consequents of the T-S fuzzy neural network, their cost and its gradient.

Method sheet 000 sections 3.4 and 3.5.  Inputs are scaled and extended by a one in front; `e` is
the value less its target.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import expit

from fuzzycnc_ros.core.arrays import Array


@dataclass(frozen=True, eq=False)
class Samples:
    """Training samples of one output.

    Parameters
    ----------
    extended : ndarray, shape (k, n + 1)
        Ones, then the scaled inputs.
    fitness : ndarray, shape (k, c)
        Normalised fitness of the rules.
    target : ndarray, shape (k,)
        Scaled target.
    """

    extended: Array
    fitness: Array
    target: Array

    def take(self, rows: slice | Array) -> 'Samples':
        """Return some of the samples."""
        return Samples(self.extended[rows], self.fitness[rows], self.target[rows])


@dataclass(frozen=True, eq=False)
class HiddenWeights:
    """Weights of one output of the network with a hidden layer.

    Parameters
    ----------
    inner : ndarray, shape (m, n + 1)
        w_ij, from extended inputs to hidden nodes; biases first.
    outer : ndarray, shape (m, c)
        w_jk, from hidden nodes to rule outputs.
    """

    inner: Array
    outer: Array

    def value(self, extended: Array, fitness: Array) -> Array:
        """Return the values, shape (k,)."""
        return np.asarray((expit(extended @ self.inner.T) * (fitness @ self.outer.T)).sum(axis=1))

    def flat(self) -> Array:
        """Return all weights in one vector."""
        return np.concatenate([self.inner.ravel(), self.outer.ravel()])

    def like(self, flat: Array) -> 'HiddenWeights':
        """Return weights of the same shapes from one vector."""
        cut = self.inner.size
        return HiddenWeights(
            flat[:cut].reshape(self.inner.shape), flat[cut:].reshape(self.outer.shape)
        )


def linear_regressor(samples: Samples) -> Array:
    """Return the regressor of linear consequents, shape (k, c (n + 1)), rules first."""
    product = samples.fitness[:, :, np.newaxis] * samples.extended[:, np.newaxis]
    return product.reshape(len(product), -1)


def hidden_regressor(hidden: Array, fitness: Array) -> Array:
    """Return the regressor of w_jk, shape (k, m c), from hidden outputs (k, m)."""
    return (hidden[:, :, np.newaxis] * fitness[:, np.newaxis]).reshape(len(hidden), -1)


def ridge_solution(regressor: Array, target: Array, ridge: float) -> Array:
    """Return what minimises 1/2 |A w - b|^2 + ridge/2 |w|^2."""
    normal = regressor.T @ regressor
    normal.flat[:: len(normal) + 1] += ridge
    solution = cho_solve(
        cho_factor(normal, check_finite=False), regressor.T @ target, check_finite=False
    )
    return np.asarray(solution)


def linear_weights(samples: Samples, ridge: float) -> Array:
    """Return linear consequents p, shape (c, n + 1), by ridge regression."""
    solution = ridge_solution(linear_regressor(samples), samples.target, ridge)
    return solution.reshape(samples.fitness.shape[1], -1)


def cost_and_gradient(
    weights: HiddenWeights, samples: Samples, ridge: float = 0.0
) -> tuple[float, HiddenWeights]:
    """Return E = 1/2 sum e^2 + ridge/2 |w|^2 and its gradient by all weights."""
    hidden = expit(samples.extended @ weights.inner.T)
    pull = samples.fitness @ weights.outer.T
    error = (hidden * pull).sum(axis=1) - samples.target
    inner, outer = gradient(hidden, pull, error, samples)
    cost = 0.5 * float(error @ error)
    if ridge:
        cost += 0.5 * ridge * float((weights.inner**2).sum() + (weights.outer**2).sum())
    return cost, HiddenWeights(inner + ridge * weights.inner, outer + ridge * weights.outer)


def gradient(hidden: Array, pull: Array, error: Array, samples: Samples) -> tuple[Array, Array]:
    """Return the gradients of 1/2 sum e^2 by w_ij and w_jk, section 3.5.

    Parameters
    ----------
    hidden, pull : ndarray, shape (k, m)
        Hidden outputs h, and g_j = sum_k w_jk ubar_k.
    error : ndarray, shape (k,)
        e.
    samples : Samples
        Samples.
    """
    outer = (error[:, np.newaxis] * hidden).T @ samples.fitness
    slope = hidden * (1.0 - hidden)
    slope *= error[:, np.newaxis] * pull
    return slope.T @ samples.extended, outer


def jacobian(weights: HiddenWeights, samples: Samples) -> tuple[Array, Array]:
    """Return the errors (k,) and their derivatives by all weights, shape (k, m (n + 1) + m c)."""
    hidden = expit(samples.extended @ weights.inner.T)
    pull = samples.fitness @ weights.outer.T
    slope = hidden * (1.0 - hidden) * pull
    inner = (slope[:, :, np.newaxis] * samples.extended[:, np.newaxis]).reshape(len(slope), -1)
    outer = hidden_regressor(hidden, samples.fitness)
    error = (hidden * pull).sum(axis=1) - samples.target
    return error, np.concatenate([inner, outer], axis=1)
