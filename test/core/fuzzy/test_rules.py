# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Takagi-Sugeno inference and its hybrid learning."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.fuzzy.takagi_sugeno import (
    Premises,
    RuleSamples,
    log_firing,
    normalised_firing,
    step_factor,
    train_rules,
)
from fuzzycnc_ros.core.thermal.fit.anfis import cluster_premises, grid_premises
from fuzzycnc_ros.core.thermal.fit.linear import ridge_solution


def sets(seed=0, rules=3, inputs=3):
    """Return centres and reciprocal widths."""
    rng = np.random.default_rng(seed)
    shape = (rules, inputs)
    return rng.uniform(0.0, 10.0, shape), 1.0 / rng.uniform(0.5, 3.0, shape)


def cost_of(samples, premises, consequent):
    firing = samples.firing(premises)
    error = (firing * (consequent @ samples.extended)).sum(axis=0) - samples.target
    return float(np.mean(error**2))


@pytest.mark.parametrize('make', [lambda x: cluster_premises(x, 3, 0), grid_premises])
@pytest.mark.parametrize('seed', range(3))
def test_premise_gradient_is_the_numerical_one(make, seed):
    """Also where rules share their sets, as in a grid."""
    rng = np.random.default_rng(seed)
    inputs = rng.normal(size=(80, 3))
    samples = RuleSamples.of(inputs, np.sin(inputs.sum(axis=1)))
    premises = make(inputs)
    epoch = samples.fit(premises, 1e-3)
    consequent = epoch.consequent
    found = samples.gradient(epoch)
    for name, gradient in zip(('center', 'width'), found, strict=True):
        values = getattr(premises, name)
        for at in np.ndindex(values.shape):
            tip = 1e-5 * np.eye(values.size)[np.ravel_multi_index(at, values.shape)]
            tip = tip.reshape(values.shape)
            high = cost_of(samples, replace(premises, **{name: values + tip}), consequent)
            low = cost_of(samples, replace(premises, **{name: values - tip}), consequent)
            assert gradient[at] == pytest.approx((high - low) / 2e-5, abs=1e-6 * abs(high))


@given(
    at=st.lists(st.floats(-1e100, 1e100), min_size=3, max_size=3),
    seed=st.integers(0, 20),
)
def test_strengths_sum_to_one_however_far_away(at, seed):
    firing = normalised_firing(log_firing(np.array(at), *sets(seed)))
    assert np.isfinite(firing).all()
    assert (firing >= 0.0).all()
    assert np.abs(firing.sum(axis=-1) - 1.0).max() <= 1e-12


def test_far_from_all_sets_the_plain_quotient_is_none():
    """Without logarithms every strength underflows here."""
    center, inverse_width = sets()
    far = np.full(3, 1e4)
    assert np.exp(-0.5 * ((far - center) * inverse_width) ** 2).prod(axis=1).sum() == 0.0
    firing = normalised_firing(log_firing(far, center, inverse_width))
    assert firing.sum() == pytest.approx(1.0, abs=1e-12)


def test_equally_far_rules_share():
    firing = normalised_firing(np.array([-1e200, -1e200, -2e200]))
    assert firing.tolist() == [0.5, 0.5, 0.0]


@pytest.mark.parametrize('make', [lambda x: cluster_premises(x, 3, 0), grid_premises])
def test_training_and_inference_fire_alike(make):
    """Training expands the square of eq. (1), inference does not."""
    inputs = np.random.default_rng(4).uniform(0.0, 4.0, (100, 3))
    premises = make(inputs)
    center, width = premises.of_rules()
    inferred = normalised_firing(log_firing(inputs, center, 1.0 / width))
    trained = RuleSamples.of(inputs, np.zeros(100)).firing(premises)
    assert np.abs(trained - inferred.T).max() <= 1e-12


def test_consequents_are_the_ridge_solution():
    rng = np.random.default_rng(0)
    inputs, target = rng.normal(size=(60, 2)), rng.normal(size=60)
    premises = cluster_premises(inputs, 3, 0)
    samples = RuleSamples.of(inputs, target)
    firing = samples.firing(premises)
    features = np.hstack([strength[:, np.newaxis] * samples.extended.T for strength in firing])
    expected = ridge_solution(features, target, 1e-2).reshape(3, 3)
    assert np.allclose(samples.fit(premises, 1e-2).consequent, expected, rtol=1e-9)


@pytest.mark.parametrize('make', [lambda x: cluster_premises(x, 4, 0), grid_premises])
def test_the_best_epoch_is_kept(make):
    rng = np.random.default_rng(3)
    inputs = rng.uniform(-2.0, 2.0, (200, 2))
    target = np.sin(2.0 * inputs[:, 0]) + 0.1 * rng.normal(size=200)
    # A first step that is far too long makes some epochs worse than the one before.
    trained = train_rules(
        inputs, target, make(inputs), ridge=1e-4, epochs=60, step=0.3, width_min=0.2
    )
    samples = RuleSamples.of(inputs, target)
    consequent = np.column_stack([trained.offset, trained.slope])
    kept = cost_of(samples, trained.premises, consequent) + 1e-4 * float((consequent**2).sum())
    assert len(trained.cost) == 61
    assert (np.diff(trained.cost) > 0.0).any()
    assert kept == pytest.approx(trained.cost.min(), rel=1e-9)
    assert kept < 0.8 * trained.cost[0]
    assert trained.premises.width.min() >= 0.2


def test_learning_finds_the_rules_that_made_the_data():
    rng = np.random.default_rng(1)
    inputs = rng.uniform(-2.0, 2.0, (400, 1))
    index = np.array([[0], [1]])
    truth = Premises(np.array([[-1.0], [1.0]]), np.array([[0.6], [0.6]]), index)
    firing = RuleSamples.of(inputs, np.zeros(400)).firing(truth)
    target = (firing * np.array([[1.0], [-2.0]])).sum(axis=0) + firing[1] * inputs[:, 0]
    start = replace(truth, center=np.array([[-0.6], [1.5]]), width=np.array([[0.9], [0.4]]))
    trained = train_rules(inputs, target, start, ridge=1e-9, epochs=300, step=0.01, width_min=0.05)
    assert trained.cost[0] > 1e-3
    assert trained.cost.min() < 1e-3 * trained.cost[0]


def test_step_length_follows_the_costs():
    assert step_factor([5.0, 4.0, 3.0, 2.0, 1.0]) == 1.1
    assert step_factor([1.0, 2.0, 1.0, 2.0, 1.0]) == 0.9
    assert step_factor([2.0, 1.0, 2.0, 1.0, 2.0]) == 0.9
    assert step_factor([5.0, 4.0, 3.0, 2.0]) == 1.0
    assert step_factor([5.0, 4.0, 3.0, 4.0, 3.0]) == 1.0
    assert step_factor([9.0, 9.0, 4.0, 3.0, 2.0]) == 1.0


def test_a_step_grows_once_for_each_four_costs_that_fall():
    """From far away the sets move straight on, so that they go as far as the steps are long."""
    inputs = np.linspace(-2.0, 2.0, 200)[:, np.newaxis]
    index = np.array([[0], [1]])
    start = Premises(np.array([[-1.0], [1.0]]), np.array([[0.6], [0.6]]), index)
    trained = train_rules(
        inputs,
        np.tanh(3.0 * inputs[:, 0] - 1.5),
        start,
        ridge=1e-3,
        epochs=20,
        step=1e-4,
        width_min=0.05,
    )
    assert (np.diff(trained.cost) < 0.0).all()
    way = np.hypot(
        np.linalg.norm(trained.premises.center - start.center),
        np.linalg.norm(trained.premises.width - start.width),
    )
    assert way == pytest.approx(1e-4 * sum(1.1 ** (n // 4) for n in range(20)), rel=1e-3)
