# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Clustering, training and choice of the penalty: samples of features to a `RuleNetwork`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.antecedent import Antecedent
from fuzzycnc_ros.core.deformation.consequents import (
    HiddenWeights,
    Samples,
    linear_weights,
)
from fuzzycnc_ros.core.deformation.rule_network import RuleNetwork
from fuzzycnc_ros.core.deformation.training import Method, initial_weights, train_hidden
from fuzzycnc_ros.core.fuzzy.gustafson_kessel import (
    ClassValues,
    GustafsonKessel,
    class_values,
    grow_clusters,
)

STARTS = 1
"""Random starts of the clustering: at 10 rules they end within 3 % of each other."""

TOLERANCE = 1e-2
"""Change of a membership that ends the clustering.

The clustering takes most of a training: with two starts and 1e-3 it is twice as long, and the
held-out error, mean of data seeds 20 to 29, 0.287 instead of 0.277 mm.
"""


@dataclass(frozen=True)
class Recipe:
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
class Rows:
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

    def take(self, rows: NDArray[np.bool_]) -> 'Rows':
        """Return some of the samples."""
        return Rows(self.inputs[rows], self.output[rows], self.load[rows])

    def square_error(self, network: RuleNetwork) -> float:
        """Return the sum of squared errors of the compensations."""
        error = (network.values(self.inputs) - self.output) * self.load[:, np.newaxis]
        return float((error**2).sum())


@dataclass(frozen=True, eq=False)
class Clustered:
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
    samples: list[Samples]
    input_scale: tuple[Array, Array]
    output_scale: tuple[Array, Array]
    values: ClassValues
    problems: tuple[str, ...]


def cluster(rows: Rows, recipe: Recipe, rng: np.random.Generator) -> Clustered:
    """Return rules from a clustering of inputs and outputs joined, sections 3.1 to 3.3."""
    scaled, input_scale = _standardised(rows.inputs)
    output, output_scale = _standardised(rows.output)
    joined = np.concatenate([scaled, output], axis=1)
    joined = joined[:, np.ptp(joined, axis=0) > 0.0]
    compensation = rows.output * rows.load[:, np.newaxis]
    model = GustafsonKessel(
        recipe.n_rules,
        tol=TOLERANCE,
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
        weight @ scaled / weight.sum(axis=1, keepdims=True),
        np.maximum(np.ptp(scaled, axis=0), np.finfo(float).tiny),
        width_floor=recipe.width_floor,
        decay=recipe.decay,
        power=recipe.power,
    )
    extended = np.concatenate([np.ones((len(scaled), 1)), scaled], axis=1)
    fitness = antecedent.fitness(scaled)
    return Clustered(
        antecedent,
        [Samples(extended, fitness, target) for target in output.T],
        input_scale,
        output_scale,
        ClassValues(*(value[used] for value in values)),
        tuple(problems),
    )


def train(rules: Clustered, recipe: Recipe, ridge: float, rng: np.random.Generator) -> RuleNetwork:
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


def choose_ridge(
    rows: Rows,
    held_out: Sequence[NDArray[np.bool_]],
    recipe: Recipe,
    ridges: Sequence[float],
    seed: int,
) -> float:
    """Return the penalty with the least error on parts that are held out in turn.

    The middle three are compared, then further ones as long as the error falls.  A single member
    is trained for each.

    Parameters
    ----------
    rows : Rows
        All samples.
    held_out : sequence of ndarray of bool, each of shape (k,)
        The parts.
    recipe : Recipe
        Settings.
    ridges : sequence of float
        Penalties, in order.
    seed : int
        Seed of all trainings: penalties are compared from the same random weights.
    """
    recipe = replace(recipe, members=1)
    parts = [
        (rows.take(part), cluster(rows.take(~part), recipe, np.random.default_rng(seed)))
        for part in held_out
    ]
    known: dict[int, float] = {}

    def error(at: int) -> float:
        if at not in known:
            known[at] = sum(
                unseen.square_error(
                    train(rules, recipe, ridges[at], np.random.default_rng([seed, 1]))
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
    bias = weights[..., 0] - slope @ mean
    return np.concatenate([bias[..., np.newaxis], slope], axis=-1)


def _joined(members: Sequence[HiddenWeights]) -> HiddenWeights:
    """Return the mean of networks as one network."""
    return HiddenWeights(
        np.concatenate([item.inner for item in members]),
        np.concatenate([item.outer for item in members]) / len(members),
    )
