# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Takagi-Sugeno rules with Gaussian sets: inference, and hybrid learning.

Each epoch solves all consequents by one ridge regression and takes one gradient step on the
Gaussian sets [jang1993].

References
----------
[jang1993], [takagi1985]
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array


def log_firing(inputs: Array, center: Array, inverse_width: Array) -> Array:
    """Return the logarithm of the firing strengths, the product of [ding_zeng] eqs. (1)-(3).

    Parameters
    ----------
    inputs : ndarray, shape (..., p)
        Inputs; leading axes broadcast with those of the rules.
    center : ndarray, shape (..., r, p)
        Centres of the Gaussian sets, in the units of the inputs.
    inverse_width : ndarray, shape (..., r, p)
        Reciprocal of their standard deviations, positive.

    Returns
    -------
    ndarray, shape (..., r)
        Logarithms, 0 or less.
    """
    apart = (inputs[..., np.newaxis, :] - center) * inverse_width
    # On arrays this small a product and a sum are faster than einsum.
    return np.asarray(-0.5 * (apart * apart).sum(axis=-1))


def normalised_firing(logarithm: Array, axis: int = -1) -> Array:
    """Return firing strengths, [ding_zeng] eq. (4); they sum to 1 over the rules along `axis`.

    The strongest rule is taken out before the exponential: far from all sets every strength
    underflows, and 0/0 would follow.
    """
    strength = portable.exp(logarithm - logarithm.max(axis=axis, keepdims=True))
    return np.asarray(strength / strength.sum(axis=axis, keepdims=True))


STEP_GROWTH, STEP_CUT = 1.1, 0.9
"""Factors of the step length after four falls in a row, and after two up and down."""

MEMORY = 5
"""Costs that the step length is judged by: four changes."""


@dataclass(frozen=True, eq=False)
class Premises:
    """Gaussian sets of each input, and the set of each input that each rule takes.

    Parameters
    ----------
    center, width : ndarray, shape (s, p)
        Centre and standard deviation of the sets of each input.
    index : ndarray, shape (r, p)
        Number of the set of each input in each rule; several rules may share a set.
    """

    center: Array
    width: Array
    index: NDArray[np.int64]

    def of_rules(self) -> tuple[Array, Array]:
        """Return centre and width rule by rule, each of shape (r, p)."""
        column = np.arange(self.center.shape[1])
        return self.center[self.index, column], self.width[self.index, column]

    def collect(self, values: Array) -> Array:
        """Return the sums over the rules that share a set, shape (s, p), of values (r, p)."""
        sets, columns = self.center.shape
        place = self.index * columns + np.arange(columns)
        total = np.bincount(place.ravel(), values.ravel(), minlength=sets * columns)
        return np.asarray(total, dtype=np.float64).reshape(sets, columns)


@dataclass(frozen=True, eq=False)
class TrainedRules:
    """Rules of the best epoch.

    Parameters
    ----------
    premises : Premises
        Learnt sets.
    slope : ndarray, shape (r, p)
        Consequent weights p, q, ... of [ding_zeng] eq. (5), per unit of each input.
    offset : ndarray, shape (r,)
        Consequent constants r of [ding_zeng] eq. (5).
    support : ndarray, shape (r,)
        Sum of the normalised firing strengths over the training samples [-].
    cost : ndarray, shape (epochs + 1,)
        Mean square error plus penalty before each step, and after the last.
    """

    premises: Premises
    slope: Array
    offset: Array
    support: Array
    cost: Array


def train_rules(
    inputs: Array,
    target: Array,
    premises: Premises,
    *,
    ridge: float,
    epochs: int,
    step: float,
    width_min: float,
) -> TrainedRules:
    """Learn rules from samples by hybrid learning.

    Parameters
    ----------
    inputs : ndarray, shape (n, p)
        Inputs, scaled to about 1.
    target : ndarray, shape (n,)
        Target, scaled to about 1.
    premises : Premises
        Sets to start from.
    ridge : float
        Penalty on the consequents per sample [-], positive.
    epochs : int
        Number of gradient steps; 0 fits the consequents only.
    step : float
        Length of the first step in the space of all centres and widths.
    width_min : float
        Floor of the widths, without which a set may close around one sample.

    Returns
    -------
    TrainedRules
        The epoch of least cost.
    """
    samples = RuleSamples.of(inputs, target)
    best = present = samples.fit(premises, ridge)
    history, judged = [best.cost], [best.cost]
    for _ in range(epochs):
        by_center, by_width = samples.gradient(present)
        norm = float(np.sqrt((by_center**2).sum() + (by_width**2).sum()))
        if norm == 0.0:
            break
        premises = replace(
            premises,
            center=premises.center - step / norm * by_center,
            width=np.maximum(premises.width - step / norm * by_width, width_min),
        )
        present = samples.fit(premises, ridge)
        if present.cost < best.cost:
            best = present
        history.append(present.cost)
        judged.append(present.cost)
        factor = step_factor(judged)
        if factor != 1.0:
            step *= factor
            # The next change of the step waits for as many new costs.
            judged = judged[-1:]
    return TrainedRules(
        premises=best.premises,
        slope=best.consequent[:, 1:],
        offset=best.consequent[:, 0],
        support=best.firing.sum(axis=1),
        cost=np.array(history),
    )


@dataclass(frozen=True, eq=False)
class Epoch:
    """Consequents fitted to fixed sets, and what they give.

    Parameters
    ----------
    premises : Premises
        Sets.
    consequent : ndarray, shape (r, 1 + p)
        Consequents, constants first.
    firing, output : ndarray, shape (r, n)
        Normalised firing strength, and value f of each rule's consequent.
    error : ndarray, shape (n,)
        Inferred value minus target.
    cost : float
        Mean square error plus penalty.
    """

    premises: Premises
    consequent: Array
    firing: Array
    output: Array
    error: Array
    cost: float


@dataclass(frozen=True, eq=False)
class RuleSamples:
    """Training samples by columns: with few rules, sums over rules are then long and fast.

    Parameters
    ----------
    extended : ndarray, shape (1 + p, n)
        Ones, then the inputs.
    square : ndarray, shape (p, n)
        Squares of the inputs.
    target : ndarray, shape (n,)
        Target.
    """

    extended: Array
    square: Array
    target: Array

    @staticmethod
    def of(inputs: Array, target: Array) -> 'RuleSamples':
        """Take inputs (n, p) and target (n,)."""
        extended = np.concatenate([np.ones((1, len(inputs))), inputs.T])
        return RuleSamples(extended, extended[1:] ** 2, target)

    def firing(self, premises: Premises) -> Array:
        """Return the normalised firing strengths, shape (r, n).

        Training inputs are scaled, so that the expanded square loses no digits that matter.
        """
        center, width = premises.of_rules()
        precision = width**-2.0
        constant = -0.5 * (center**2 * precision).sum(axis=1, keepdims=True)
        linear = np.concatenate([constant, center * precision], axis=1)
        return normalised_firing(linear @ self.extended - 0.5 * precision @ self.square, axis=0)

    def fit(self, premises: Premises, ridge: float) -> Epoch:
        """Return the consequents that fit best for fixed sets.

        They minimise the mean square error plus `ridge` times the sum of their squares.
        """
        firing = self.firing(premises)
        rules, count = firing.shape
        columns = len(self.extended)
        features = (firing[:, np.newaxis, :] * self.extended).reshape(rules * columns, count)
        normal = features @ features.T
        normal.flat[:: len(normal) + 1] += ridge * count
        solution = np.linalg.solve(normal, features @ self.target)
        consequent = np.asarray(solution, dtype=np.float64).reshape(rules, columns)
        output = consequent @ self.extended
        error = (firing * output).sum(axis=0) - self.target
        cost = float(error @ error) / count + ridge * float((consequent**2).sum())
        return Epoch(premises, consequent, firing, output, error, cost)

    def gradient(self, epoch: Epoch) -> tuple[Array, Array]:
        """Return the gradient of the mean square error by centres and by widths, each (s, p)."""
        center, width = epoch.premises.of_rules()
        inferred = epoch.error + self.target
        pull = (epoch.output - inferred) * epoch.firing
        pull *= 2.0 / len(inferred) * epoch.error
        # Sums over the samples of g, g x and g x^2 give both gradients without an (n, r, p) array.
        sums = pull @ self.extended.T
        total, first, second = sums[:, :1], sums[:, 1:], pull @ self.square.T
        by_center = (first - center * total) / width**2
        by_width = (second - 2.0 * center * first + center**2 * total) / width**3
        return epoch.premises.collect(by_center), epoch.premises.collect(by_width)


def step_factor(cost: list[float]) -> float:
    """Return the factor of the step length that the last costs ask for."""
    if len(cost) < MEMORY:
        return 1.0
    falls = np.diff(cost[-MEMORY:]) < 0.0
    if falls.all():
        return STEP_GROWTH
    if (falls[1:] != falls[:-1]).all():
        return STEP_CUT
    return 1.0
