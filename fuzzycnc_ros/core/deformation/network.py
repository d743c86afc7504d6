# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The T-S fuzzy neural network as an estimator.

References
----------
[deng2014]
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array, Seed, check_matrix
from fuzzycnc_ros.core.deformation.features import (
    check_process_values,
    direction_doubts,
    feature_set,
    folded_samples,
    lapped,
    load,
)
from fuzzycnc_ros.core.deformation.model import (
    SUPPORT_QUANTILE,
    Antecedent,
    AxisGain,
    DeformationModel,
    Gate,
    RuleNetwork,
)
from fuzzycnc_ros.core.deformation.training import (
    METHODS,
    HiddenWeights,
    Method,
    TrainingSamples,
    equal_rows,
    grouped_folds,
    initial_weights,
    linear_weights,
    train_hidden,
)
from fuzzycnc_ros.core.estimator import RegressionEstimator, check_fitted
from fuzzycnc_ros.core.fuzzy.clustering import (
    ClassValues,
    GustafsonKessel,
    class_values,
    grow_clusters,
)
from fuzzycnc_ros.core.threads import single_threaded

STARTS = 1
"""Random starts of the clustering: at 10 rules they end within 3 % of each other."""

_TOLERANCE = 1e-2
"""Change of a membership that ends the clustering.

The clustering takes most of a training: with two starts and 1e-3 it is twice as long, and the
held-out error, mean of data seeds 20 to 29, 0.287 instead of 0.277 mm.
"""


@dataclass(frozen=True)
class _Recipe:
    """Settings of a training, as of `TSFuzzyNetwork`; no `training` stands for linear rules."""

    training: Method | None
    n_rules: int
    hidden: int
    members: int
    variance_max: float | None
    width_floor: float
    decay: float
    power: int
    regularisation: float
    starts: int = STARTS


@dataclass(frozen=True, eq=False)
class _Rows:
    """Samples of features.

    Parameters
    ----------
    inputs : ndarray, shape (k, n)
        Features.
    output : ndarray, shape (k, r)
        Compensation per load.
    load : ndarray, shape (k,)
        Load.
    """

    inputs: Array
    output: Array
    load: Array

    def take(self, rows: NDArray[np.bool_]) -> '_Rows':
        """Return some of the samples."""
        return _Rows(self.inputs[rows], self.output[rows], self.load[rows])

    def square_error(self, network: RuleNetwork) -> float:
        """Return the sum of squared errors of the compensations."""
        error = (network.values(self.inputs) - self.output) * self.load[:, np.newaxis]
        return float((error * error).sum())


@dataclass(frozen=True, eq=False)
class _Clustered:
    """Rules found in samples, and the samples scaled for training.

    Parameters
    ----------
    antecedent : Antecedent
        Rules in scaled inputs.
    samples : list of Samples
        Scaled samples of each output.
    input_scale, output_scale : tuple of ndarray
        Mean and standard deviation of the inputs and of the outputs.
    values : ClassValues
        What the rules say of the compensations.
    problems : tuple of str
        What is to be said about the clustering.
    """

    antecedent: Antecedent
    samples: list[TrainingSamples]
    input_scale: tuple[Array, Array]
    output_scale: tuple[Array, Array]
    values: ClassValues
    problems: tuple[str, ...]


def _cluster(rows: _Rows, recipe: _Recipe, rng: np.random.Generator) -> _Clustered:
    """Return rules from a clustering of inputs and outputs joined [deng2014]."""
    scaled, input_scale = _standardised(rows.inputs)
    output, output_scale = _standardised(rows.output)
    joined = np.concatenate([scaled, output], axis=1)
    joined = joined[:, np.ptp(joined, axis=0) > 0.0]
    compensation = rows.output * rows.load[:, np.newaxis]
    model = GustafsonKessel(
        recipe.n_rules,
        tol=_TOLERANCE,
        regularisation=recipe.regularisation,
        n_init=recipe.starts,
        random_state=rng,
    )
    if recipe.variance_max is None:
        model.fit(joined)
    else:
        model = grow_clusters(joined, compensation, recipe.variance_max, model)
    problems = []
    if not model.converged_:
        problems.append(f'the clustering did not come to rest in {model.n_iter_} iterations')
    values = class_values(model.membership_, compensation)
    if recipe.variance_max is not None and values.variance.max() > recipe.variance_max:
        problems.append(
            f'a class variance is {values.variance.max():.3g}, above the '
            f'{recipe.variance_max:g} asked for, with all {recipe.n_rules} rules'
        )
    # A cluster that is no sample's first choice has no samples to learn a consequent from.
    used = np.bincount(model.labels_, minlength=model.n_clusters) > 0
    weight = model.membership_.T[used] ** model.m
    antecedent = Antecedent.of_clusters(
        portable.matmul(weight, scaled) / weight.sum(axis=1, keepdims=True),
        np.maximum(np.ptp(scaled, axis=0), np.finfo(float).tiny),
        width_floor=recipe.width_floor,
        decay=recipe.decay,
        power=recipe.power,
    )
    extended = np.concatenate([np.ones((len(scaled), 1)), scaled], axis=1)
    fitness = antecedent.fitness(scaled)
    return _Clustered(
        antecedent,
        [TrainingSamples(extended, fitness, target) for target in output.T],
        input_scale,
        output_scale,
        ClassValues(*(value[used] for value in values)),
        tuple(problems),
    )


def _train(
    rules: _Clustered, recipe: _Recipe, ridge: float, rng: np.random.Generator
) -> RuleNetwork:
    """Return the rules with trained consequents, in the units of the samples."""
    mean, deviation = rules.input_scale
    inner, outer = [], []
    for samples in rules.samples:
        if recipe.training is None:
            coefficient = linear_weights(samples, ridge)
            outer.append(_unscaled(coefficient, mean, deviation).T)
            continue
        shape = (recipe.hidden, samples.extended.shape[1] - 1, samples.fitness.shape[1])
        members = [
            train_hidden(
                samples,
                initial_weights(*shape, rng),
                method=recipe.training,
                ridge=ridge,
                rng=rng,
            )
            for _ in range(recipe.members)
        ]
        whole = _joined(members)
        inner.append(_unscaled(whole.inner, mean, deviation))
        outer.append(whole.outer)
    center, spread = rules.output_scale
    antecedent = replace(
        rules.antecedent,
        center=mean + rules.antecedent.center * deviation,
        width=rules.antecedent.width * deviation,
    )
    weights = np.stack(outer) * spread[:, np.newaxis, np.newaxis]
    return RuleNetwork(antecedent, np.stack(inner) if inner else None, weights, center)


def _choose_ridge(
    rows: _Rows,
    held_out: Sequence[NDArray[np.bool_]],
    recipe: _Recipe,
    ridges: Sequence[float],
    seed: int,
) -> float:
    """Return the penalty with the least error on parts that are held out in turn.

    The middle three are compared, then further ones as long as the error falls.  A single member
    is trained for each.

    Parameters
    ----------
    rows : _Rows
        All samples.
    held_out : sequence of ndarray of bool, each of shape (k,)
        The parts.
    recipe : _Recipe
        Settings.
    ridges : sequence of float
        Penalties, in order.
    seed : int
        Seed of all trainings: penalties are compared from the same random weights.
    """
    recipe = replace(recipe, members=1)
    parts = [
        (rows.take(part), _cluster(rows.take(~part), recipe, np.random.default_rng(seed)))
        for part in held_out
    ]
    known: dict[int, float] = {}

    def error(at: int) -> float:
        if at not in known:
            known[at] = sum(
                unseen.square_error(
                    _train(rules, recipe, ridges[at], np.random.default_rng([seed, 1]))
                )
                for unseen, rules in parts
            )
        return known[at]

    middle = len(ridges) // 2
    best = min((middle - 1, middle, middle + 1), key=error)
    way = best - middle
    while way and 0 <= best + way < len(ridges) and error(best + way) < error(best):
        best += way
    return ridges[best]


def _standardised(values: Array) -> tuple[Array, tuple[Array, Array]]:
    """Return scaled columns, and their means and deviations; constant ones stay unscaled."""
    mean, deviation = values.mean(axis=0), values.std(axis=0)
    deviation = np.where(np.ptp(values, axis=0) > 0.0, deviation, 1.0)
    return (values - mean) / deviation, (mean, deviation)


def _unscaled(weights: Array, mean: Array, deviation: Array) -> Array:
    """Return weights (..., n + 1) on scaled inputs as weights on the inputs themselves."""
    slope = weights[..., 1:] / deviation
    bias = weights[..., 0] - portable.matmul(slope, mean)
    return np.concatenate([bias[..., np.newaxis], slope], axis=-1)


def _joined(members: Sequence[HiddenWeights]) -> HiddenWeights:
    """Return the mean of networks as one network."""
    return HiddenWeights(
        np.concatenate([item.inner for item in members]),
        np.concatenate([item.outer for item in members]) / len(members),
    )


_RIDGES = (1e-3, 1e-2, 3e-2, 1e-1, 1.0)
"""Penalties that are compared; the search begins in the middle."""

FOLDS = 3
"""Parts of the comparison of penalties."""


class TooFewSamplesError(ValueError):
    """There are fewer samples than a training needs."""


def samples_needed(rules: int, folds: int = 1) -> int:
    """Return how many different samples a training needs at least.

    Parameters
    ----------
    rules : int
        Number of rules; each needs a sample of its own.
    folds : int
        Parts of which one is held out from the training to judge it; 1 for none.

    Examples
    --------
    >>> samples_needed(10), samples_needed(10, folds=5)
    (15, 19)
    """
    count = rules
    while True:
        trained = count - (-(-count // folds) if folds > 1 else 0)
        # The penalty is chosen on parts of what is left.
        if trained - -(-trained // FOLDS) >= rules:
            return count
        count += 1


@dataclass(eq=False, repr=False)
class TSFuzzyNetwork(RegressionEstimator):
    """T-S fuzzy neural network of feed compensation, [deng2014].

    Parameters
    ----------
    consequent : {'nts', 'sts'}
        'nts' has a sigmoid layer before the rule outputs, 'sts' linear rule outputs.
    features : {'load', 'physical', 'thickness', 'paper'}
        Inputs made of the process values, see `FEATURE_SETS`.  With 'load' the network learns the
        compensation per load of a stitch, which varies far less than the compensation.
    training : {'hybrid', 'steepest_descent', 'levenberg_marquardt'}
        Method for 'nts'; linear rule outputs have a direct solution.
    ridge : float or 'cv'
        Penalty on the scaled weights [-], in 1/2 sum e^2 + ridge/2 |w|^2; 'cv' compares some on
        parts of the samples.
    n_rules : int
        Number of rules; the most, with `variance_max`.
    hidden : int
        Hidden nodes of each output and member.
    members : int
        Networks from different random weights whose mean is taken; together they are one network
        with as many times the hidden nodes.
    variance_max : float or None
        xi: rules are added from 2 until no class variance of an output exceeds it
        [(mm per 50 mm)^2].  Without it there are `n_rules`, for the paper's 1.3 is never met.
    width_floor : float
        Least width of a membership as a share of the input's range [-].  The held-out error,
        mean of data seeds 20 to 25, was 0.35 mm with 0.5 and 0.31 mm with 1.
    decay : float
        gamma of the memberships [-].
    membership_power : {1, 2}
        1 for memberships as printed, 2 for squared ones.
    regularisation : float
        Of the clustering [-], see `GustafsonKessel`.
    support_quantile : float
        Share of the training samples with less support than the gate lets pass [-].
    random_state : int, numpy.random.Generator or None
        Seed of clustering, folds and weights.

    Attributes
    ----------
    model_ : DeformationModel
        The trained network, to be stored and run.
    ridge_ : float
        Penalty that was taken.
    rule_values_ : ClassValues
        Centre, variance and decision value of the outputs in each rule [mm per 50 mm].
    problems_ : tuple of str
        Why the fit is not to be trusted, or what was left out; empty if nothing was.

    Notes
    -----
    A Gaussian process on physical features predicts the simulated data better than the paper's
    network does; docs/explanation/methods/deformation.md says by how much.
    """

    consequent: Literal['nts', 'sts'] = 'nts'
    _: KW_ONLY
    features: str = 'load'
    training: Method = 'hybrid'
    ridge: float | Literal['cv'] = 'cv'
    n_rules: int = 10
    hidden: int = 11
    members: int = 1
    variance_max: float | None = None
    width_floor: float = 1.0
    decay: float = 2.0
    membership_power: Literal[1, 2] = 1
    regularisation: float = 0.02
    support_quantile: float = SUPPORT_QUANTILE
    random_state: Seed = 0

    @single_threaded
    def fit(self, x: ArrayLike, s: ArrayLike, groups: ArrayLike | None = None) -> 'TSFuzzyNetwork':
        """Train on samples.

        Parameters
        ----------
        x : array_like, shape (k, 5)
            Process values: direction [deg], depth [mm], type, step [mm], thickness [mm].
        s : array_like, shape (k, r)
            Compensations that were needed [mm per 50 mm]; those of a direction and of its
            opposite have opposite signs.
        groups : array_like of int, shape (k,), optional
            Sheet of each sample: samples of one sheet are never on both sides of a comparison.
            Left out, samples with equal process values belong together.

        Returns
        -------
        TSFuzzyNetwork
            The estimator.

        Raises
        ------
        ValueError
            If samples or a parameter cannot be used.
        """
        self._check_parameters()
        rows = check_process_values(x)
        target = check_matrix(s, 's')
        if len(target) == len(rows):
            rows, target = folded_samples(rows, target)
        group = equal_rows(rows) if groups is None else np.asarray(groups)
        if len(target) != len(rows) or group.shape != (len(rows),):
            raise ValueError(
                f's, groups: expected one per row of x ({len(rows)}), but found {len(target)} '
                f'and {group.shape}'
            )
        problems = list(direction_doubts(rows, target))
        given, (taken, rows, sign) = len(rows), lapped(rows)
        group, target = group[taken], target[taken] * sign[:, np.newaxis]
        features = feature_set(self.features)
        inputs = features.rows(rows)
        varies = np.ptp(inputs, axis=0) > 0.0
        columns = tuple(int(at) for at in np.flatnonzero(varies))
        for at in np.flatnonzero(~varies):
            problems.append(f'{features.names[at]} is constant and was left out')
        if not columns:
            raise TooFewSamplesError('x: expected samples that differ, but found only equal rows')
        weight = load(*rows[:, [1, 3, 4]].T) if features.loaded else np.ones(len(rows))
        samples = _Rows(inputs[:, varies], target / weight[:, np.newaxis], weight)
        self._check_enough(samples, np.ones(len(rows), bool))
        rng = np.random.default_rng(self.random_state)
        recipe = self._recipe()
        ridge = self._chosen_ridge(samples, group, recipe, rng)
        rules = _cluster(samples, recipe, rng)
        network = _train(rules, recipe, ridge, rng)
        problems += rules.problems
        count = len(network.antecedent.center)
        advised = 3 * (len(columns) + target.shape[1] + 1) * count
        if given < advised:
            problems.append(f'{given} samples, {advised} are advised for {count} rules')
        self.ridge_ = ridge
        self.rule_values_ = rules.values
        self.problems_ = tuple(problems)
        support = network.antecedent.support(samples.inputs)
        gate = Gate.of_training(rows[:given], support[:given], self.support_quantile)
        gain = AxisGain.unit(target.shape[1])
        self.model_ = DeformationModel(self.features, columns, network, gate, gain)
        return self

    def predict(self, x: ArrayLike) -> Array:
        """Return compensations, shape (k, r) [mm per 50 mm], of process values (k, 5)."""
        check_fitted(self, 'model_')
        return self.model_.predict(x)

    def support(self, x: ArrayLike) -> Array:
        """Return the logarithm of the rules' support, shape (k,), of process values (k, 5)."""
        check_fitted(self, 'model_')
        return self.model_.support(x)

    def _check_parameters(self) -> None:
        for name, choices in (
            ('consequent', ('nts', 'sts')),
            ('training', METHODS),
            ('membership_power', (1, 2)),
        ):
            if getattr(self, name) not in choices:
                raise ValueError(
                    f'{name}: expected one of {choices}, but found {getattr(self, name)!r}'
                )
        for name in ('n_rules', 'hidden', 'members'):
            if getattr(self, name) < 1:
                raise ValueError(f'{name}: expected at least 1, but found {getattr(self, name)}')
        for name in ('width_floor', 'decay', *(() if self.ridge == 'cv' else ('ridge',))):
            if not getattr(self, name) > 0.0:
                raise ValueError(f'{name}: expected more than 0, but found {getattr(self, name)}')

    def _check_enough(self, samples: _Rows, taken: NDArray[np.bool_]) -> None:
        """Refuse samples in which there are fewer different ones than rules."""
        joined = np.column_stack([samples.inputs, samples.output])[taken]
        found = len(np.unique(joined, axis=0))
        least = self.n_rules if self.variance_max is None else 2
        if found < least:
            raise TooFewSamplesError(
                f'samples: expected at least {least} that differ, one for each rule, beside '
                f'those that are held out, but found {found}; record more'
            )

    def _recipe(self) -> _Recipe:
        return _Recipe(
            training=self.training if self.consequent == 'nts' else None,
            n_rules=self.n_rules,
            hidden=self.hidden,
            members=self.members,
            variance_max=self.variance_max,
            width_floor=self.width_floor,
            decay=self.decay,
            power=self.membership_power,
            regularisation=self.regularisation,
        )

    def _chosen_ridge(
        self, samples: _Rows, group: NDArray[np.int64], recipe: _Recipe, rng: np.random.Generator
    ) -> float:
        if self.ridge != 'cv':
            return float(self.ridge)
        if recipe.training == 'steepest_descent':
            return 0.0  # it knows no penalty
        held_out = grouped_folds(group, FOLDS, rng)
        if len(held_out) < 2:
            raise ValueError(
                "groups: expected at least 2 to choose the ridge, but found 1; set 'ridge'"
            )
        for part in held_out:
            self._check_enough(samples, ~part)
        return _choose_ridge(samples, held_out, recipe, _RIDGES, int(rng.integers(2**32)))
