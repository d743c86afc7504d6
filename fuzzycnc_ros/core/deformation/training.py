# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Consequents of the T-S fuzzy neural network: their cost, its gradient, and their training.

Inputs are scaled and extended by a one in front; `e` is the value less its target.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.special import expit, stdtrit

from fuzzycnc_ros.core.arrays import Array


@dataclass(frozen=True, eq=False)
class TrainingSamples:
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

    def take(self, rows: slice | Array) -> 'TrainingSamples':
        """Return some of the samples."""
        return TrainingSamples(self.extended[rows], self.fitness[rows], self.target[rows])


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


def _linear_regressor(samples: TrainingSamples) -> Array:
    """Return the regressor of linear consequents, shape (k, c (n + 1)), rules first."""
    product = samples.fitness[:, :, np.newaxis] * samples.extended[:, np.newaxis]
    return product.reshape(len(product), -1)


def _hidden_regressor(hidden: Array, fitness: Array) -> Array:
    """Return the regressor of w_jk, shape (k, m c), from hidden outputs (k, m)."""
    return (hidden[:, :, np.newaxis] * fitness[:, np.newaxis]).reshape(len(hidden), -1)


def _ridge_solution(regressor: Array, target: Array, ridge: float) -> Array:
    """Return what minimises 1/2 |A w - b|^2 + ridge/2 |w|^2."""
    normal = regressor.T @ regressor
    normal.flat[:: len(normal) + 1] += ridge
    solution = cho_solve(
        cho_factor(normal, check_finite=False), regressor.T @ target, check_finite=False
    )
    return np.asarray(solution)


def linear_weights(samples: TrainingSamples, ridge: float) -> Array:
    """Return linear consequents p, shape (c, n + 1), by ridge regression."""
    solution = _ridge_solution(_linear_regressor(samples), samples.target, ridge)
    return solution.reshape(samples.fitness.shape[1], -1)


def cost_and_gradient(
    weights: HiddenWeights, samples: TrainingSamples, ridge: float = 0.0
) -> tuple[float, HiddenWeights]:
    """Return E = 1/2 sum e^2 + ridge/2 |w|^2 and its gradient by all weights."""
    hidden = expit(samples.extended @ weights.inner.T)
    pull = samples.fitness @ weights.outer.T
    error = (hidden * pull).sum(axis=1) - samples.target
    inner, outer = _gradient(hidden, pull, error, samples)
    cost = 0.5 * float(error @ error)
    if ridge:
        cost += 0.5 * ridge * float((weights.inner**2).sum() + (weights.outer**2).sum())
    return cost, HiddenWeights(inner + ridge * weights.inner, outer + ridge * weights.outer)


def _gradient(
    hidden: Array, pull: Array, error: Array, samples: TrainingSamples
) -> tuple[Array, Array]:
    """Return the gradients of 1/2 sum e^2 by w_ij and w_jk [deng2014].

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


def _jacobian(weights: HiddenWeights, samples: TrainingSamples) -> tuple[Array, Array]:
    """Return the errors (k,) and their derivatives by all weights, shape (k, m (n + 1) + m c)."""
    hidden = expit(samples.extended @ weights.inner.T)
    pull = samples.fitness @ weights.outer.T
    slope = hidden * (1.0 - hidden) * pull
    inner = (slope[:, :, np.newaxis] * samples.extended[:, np.newaxis]).reshape(len(slope), -1)
    outer = _hidden_regressor(hidden, samples.fitness)
    error = (hidden * pull).sum(axis=1) - samples.target
    return error, np.concatenate([inner, outer], axis=1)


Method = Literal['hybrid', 'steepest_descent', 'levenberg_marquardt']

METHODS = ('hybrid', 'steepest_descent', 'levenberg_marquardt')

RATE = 0.4
"""Step u of steepest descent as published."""

EPOCHS = 600
"""Epochs of steepest descent as published."""

ITERATIONS = 60
"""Iterations of the hybrid method and of Levenberg-Marquardt."""

DAMPING_MAX = 1e10
"""Damping at which Levenberg-Marquardt gives up: no step lowers the cost any more."""


class DivergedError(ArithmeticError):
    """A training left the numbers."""


def initial_weights(
    hidden: int, inputs: int, rules: int, rng: np.random.Generator
) -> HiddenWeights:
    """Return random weights, w_ij ~ N(0, 1) and w_jk ~ N(0, 0.3^2)."""
    inner = rng.normal(0.0, 1.0, (hidden, inputs + 1))
    return HiddenWeights(inner, rng.normal(0.0, 0.3, (hidden, rules)))


def train_hidden(
    samples: TrainingSamples,
    start: HiddenWeights,
    *,
    method: Method,
    ridge: float,
    rng: np.random.Generator,
) -> HiddenWeights:
    """Return trained weights.

    Parameters
    ----------
    samples : Samples
        Scaled training samples.
    start : HiddenWeights
        Weights to start from.
    method : {'hybrid', 'steepest_descent', 'levenberg_marquardt'}
        Method.
    ridge : float
        Penalty on all weights, in 1/2 sum e^2 + ridge/2 |w|^2; positive.  Steepest descent has
        none, as published.
    rng : numpy.random.Generator
        Order of the samples in steepest descent.

    Raises
    ------
    DivergedError
        If steepest descent runs away.
    """
    if method == 'steepest_descent':
        return descend(samples, start, rng)
    if method == 'levenberg_marquardt':
        return levenberg_marquardt(samples, start, ridge)
    return project(samples, start, ridge)


def project(
    samples: TrainingSamples, start: HiddenWeights, ridge: float, iterations: int = ITERATIONS
) -> HiddenWeights:
    """Return the weights of variable projection, w_ij by L-BFGS."""
    shape = start.inner.shape

    def outer_of(hidden: Array) -> Array:
        regressor = _hidden_regressor(hidden, samples.fitness)
        return _ridge_solution(regressor, samples.target, ridge).reshape(start.outer.shape)

    def cost(flat: Array) -> tuple[float, Array]:
        inner = flat.reshape(shape)
        hidden = expit(samples.extended @ inner.T)
        outer = outer_of(hidden)
        pull = samples.fitness @ outer.T
        error = (hidden * pull).sum(axis=1) - samples.target
        # At the best w_jk the cost does not change with them: this is the whole gradient.
        slope, _ = _gradient(hidden, pull, error, samples)
        penalty = float(flat @ flat) + float((outer**2).sum())
        total = 0.5 * float(error @ error) + 0.5 * ridge * penalty
        return total, (slope + ridge * inner).ravel()

    found = minimize(
        cost,
        start.inner.ravel(),
        jac=True,
        method='L-BFGS-B',
        options={'maxiter': iterations, 'maxcor': 20},
    )
    inner = np.asarray(found.x).reshape(shape)
    return HiddenWeights(inner, outer_of(expit(samples.extended @ inner.T)))


def descend(
    samples: TrainingSamples,
    start: HiddenWeights,
    rng: np.random.Generator,
    *,
    rate: float = RATE,
    epochs: int = EPOCHS,
) -> HiddenWeights:
    """Return the weights of online steepest descent, sample by sample in random order."""
    inner, outer = start.inner.copy(), start.outer.copy()
    with np.errstate(over='ignore', invalid='ignore'):
        for _ in range(epochs):
            for at in rng.permutation(len(samples.target)):
                extended, fitness = samples.extended[at], samples.fitness[at]
                hidden = expit(inner @ extended)
                pull = outer @ fitness
                step = rate * (hidden @ pull - samples.target[at])
                outer -= step * hidden[:, np.newaxis] * fitness
                inner -= (step * pull * hidden * (1.0 - hidden))[:, np.newaxis] * extended
            if not (np.isfinite(inner).all() and np.isfinite(outer).all()):
                raise DivergedError(
                    f'steepest_descent: expected a falling cost, but found weights that are no '
                    f"numbers at the step {rate:g}; take a smaller one or 'hybrid'"
                )
    return HiddenWeights(inner, outer)


def levenberg_marquardt(
    samples: TrainingSamples, start: HiddenWeights, ridge: float, iterations: int = ITERATIONS
) -> HiddenWeights:
    """Return the weights of Levenberg-Marquardt on the penalised cost."""
    weights, damping = start, 1e-2
    cost, _ = cost_and_gradient(weights, samples, ridge)
    for _ in range(iterations):
        error, derivative = _jacobian(weights, samples)
        flat = weights.flat()
        normal = derivative.T @ derivative + ridge * np.eye(flat.size)
        slope = derivative.T @ error + ridge * flat
        while damping <= DAMPING_MAX:
            step = np.linalg.solve(normal + damping * np.eye(flat.size), slope)
            tried = weights.like(flat - step)
            tried_cost, _ = cost_and_gradient(tried, samples, ridge)
            if tried_cost < cost:
                break
            damping *= 4.0
        else:
            return weights
        weights, cost, damping = tried, tried_cost, max(damping / 4.0, 1e-12)
    return weights


def beyond_chance(gain: Array, chance: float) -> bool:
    """Return whether gains are positive beyond a chance, by Student's t test.

    Parameters
    ----------
    gain : ndarray, shape (k,)
        Gains of independent groups, two or more.
    chance : float
        Probability with which gains without any cause pass [-].
    """
    limit = float(stdtrit(len(gain) - 1, 1.0 - chance))
    return bool(gain.mean() > limit * gain.std(ddof=1) / np.sqrt(len(gain)))


_RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector of two normal numbers, over their standard deviation [-]."""


def robust_deviation(distance: Array) -> float:
    """Return the standard deviation, along each axis, of vectors of these lengths, by a median."""
    return float(np.median(distance)) / _RAYLEIGH_MEDIAN


def equal_rows(inputs: Array) -> NDArray[np.int64]:
    """Return a group number for each row, (k,); rows that are equal but for rounding have one."""
    _, group = np.unique(np.round(inputs, 9), axis=0, return_inverse=True)
    return np.asarray(group.ravel(), dtype=np.int64)


def grouped_folds(
    groups: NDArray[np.int64], count: int, rng: np.random.Generator
) -> list[NDArray[np.bool_]]:
    """Return masks of the held-out rows of each fold; no group is split between folds.

    Parameters
    ----------
    groups : ndarray of int, shape (k,)
        Sheet, or other unit, of each row.
    count : int
        Number of folds; fewer where there are fewer groups.
    rng : numpy.random.Generator
        Order of the groups.
    """
    names, group = np.unique(groups, return_inverse=True)
    fold = np.empty(len(names), dtype=np.int64)
    fold[rng.permutation(len(names))] = np.arange(len(names)) % min(count, len(names))
    return [fold[group.ravel()] == number for number in range(min(count, len(names)))]
