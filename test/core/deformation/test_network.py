# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys

import numpy as np
import pytest
from foam_splits import grouped_split
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import check_grad

from fuzzycnc_ros.core.deformation.features import looks_like_radians
from fuzzycnc_ros.core.deformation.model import Antecedent
from fuzzycnc_ros.core.deformation.network import (
    TooFewSamplesError,
    TSFuzzyNetwork,
    samples_needed,
)
from fuzzycnc_ros.core.deformation.training import (
    DivergedError,
    TrainingSamples,
    cost_and_gradient,
    descend,
    equal_rows,
    grouped_folds,
    initial_weights,
    levenberg_marquardt,
    project,
)
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples, true_compensation

KINDS = [('nts', 'load'), ('sts', 'load'), ('nts', 'paper'), ('sts', 'thickness')]


@pytest.fixture(scope='module')
def data():
    return foam_samples(21)


@pytest.fixture(scope='module')
def trained(data):
    return {
        kind: TSFuzzyNetwork(kind[0], features=kind[1], ridge=0.03).fit(data.x, data.s)
        for kind in KINDS
    }


def problem(seed=0, count=60, inputs=3, rules=4):
    """Return scaled samples of one output, and weights."""
    rng = np.random.default_rng(seed)
    scaled = rng.normal(size=(count, inputs))
    fitness = rng.dirichlet(np.ones(rules), count)
    extended = np.concatenate([np.ones((count, 1)), scaled], axis=1)
    target = np.tanh(scaled[:, 0]) * fitness[:, 0] + 0.3 * scaled[:, 1]
    return TrainingSamples(extended, fitness, target), initial_weights(5, inputs, rules, rng)


def cost_of(weights, samples, ridge=1e-2):
    return cost_and_gradient(weights, samples, ridge)[0]


@pytest.mark.parametrize('ridge', [0.0, 0.3])
def test_gradient_agrees_with_differences(ridge):
    samples, weights = problem()
    flat = weights.flat()

    def cost(values):
        return cost_and_gradient(weights.like(values), samples, ridge)[0]

    _, gradient = cost_and_gradient(weights, samples, ridge)
    step = 1e-5
    moved = step * np.eye(flat.size)
    difference = [(cost(flat + row) - cost(flat - row)) / (2.0 * step) for row in moved]
    assert np.abs(gradient.flat() - difference).max() < 1e-6
    assert (
        check_grad(
            cost, lambda v: cost_and_gradient(weights.like(v), samples, ridge)[1].flat(), flat
        )
        < 1e-4
    )


def test_every_training_lowers_the_cost():
    samples, start = problem()
    before = cost_of(start, samples)
    for trained in (
        project(samples, start, 1e-2),
        levenberg_marquardt(samples, start, 1e-2),
        descend(samples, start, np.random.default_rng(0), rate=0.05, epochs=30),
    ):
        assert cost_of(trained, samples) < 0.5 * before


def test_hybrid_and_levenberg_marquardt_end_where_the_gradient_is_small():
    samples, start = problem()
    for trained in (
        project(samples, start, 1e-1, iterations=400),
        levenberg_marquardt(samples, start, 1e-1, iterations=400),
    ):
        _, gradient = cost_and_gradient(trained, samples, 1e-1)
        assert np.abs(gradient.flat()).max() < 5e-3


def test_steepest_descent_that_runs_away_says_so():
    samples, start = problem()
    with pytest.raises(DivergedError, match='take a smaller one'):
        descend(samples, start, np.random.default_rng(0), rate=40.0)


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**31),
    inputs=st.integers(1, 100),
    power=st.sampled_from([1, 2]),
    far=st.floats(0.0, 1e4),
)
def test_fitness_sums_to_one_however_far_the_inputs_lie(seed, inputs, power, far):
    rng = np.random.default_rng(seed)
    rules = Antecedent.of_clusters(
        rng.normal(size=(5, inputs)),
        np.full(inputs, 2.0),
        width_floor=0.05,
        decay=2.0,
        power=power,
    )
    scaled = rng.normal(size=(7, inputs)) + far
    fitness = rules.fitness(scaled)
    assert np.abs(fitness.sum(axis=1) - 1.0).max() <= 1e-12
    assert np.isfinite(rules.support(scaled)).all()
    plain = -2.0 * (np.abs(scaled[:, None] - rules.center) / rules.width) ** power
    assert np.allclose(rules.log_fitness(scaled), plain.sum(axis=-1), rtol=1e-12)


def test_widths_have_a_floor_where_centres_share_a_coordinate():
    rules = Antecedent.of_clusters(
        np.array([[0.0, 1.0], [3.0, 1.0]]),
        np.array([4.0, 2.0]),
        width_floor=0.5,
        decay=2.0,
        power=1,
    )
    assert rules.width.tolist() == [[3.0, 1.0], [3.0, 1.0]]


@pytest.mark.parametrize('kind', KINDS, ids=str)
def test_one_call_is_one_row_of_a_batch(data, trained, kind):
    model = trained[kind].model_
    many = np.tile(data.x, (3, 1))
    predicted, support = model.predict(many), model.support(many)
    for at in range(0, len(many), 37):
        one, evidence = model.predict_one(many[at].tolist())
        assert one == pytest.approx(predicted[at], rel=1e-10, abs=1e-10)
        assert evidence == pytest.approx(support[at], rel=1e-10, abs=1e-10)


def test_members_together_are_the_mean_of_networks(data):
    model = TSFuzzyNetwork(ridge=0.03, members=3).fit(data.x, data.s)
    network = model.model_.network
    assert network.inner.shape == (2, 33, 7)
    assert network.outer.shape == (2, 33, 10)


def test_same_seed_same_network_whatever_the_global_state(data):
    first = TSFuzzyNetwork(ridge=0.03, random_state=3).fit(data.x, data.s)
    np.random.seed(1)  # noqa: NPY002 - the very state that must not matter
    second = TSFuzzyNetwork(ridge=0.03, random_state=3).fit(data.x, data.s)
    assert np.array_equal(first.predict(data.x), second.predict(data.x))


def test_membership_power_and_growth_are_choices(data):
    squared = TSFuzzyNetwork(ridge=0.03, membership_power=2, members=1).fit(data.x, data.s)
    one, _ = squared.model_.predict_one(data.x[5].tolist())
    assert one == pytest.approx(squared.predict(data.x[5:6])[0])
    grown = TSFuzzyNetwork('sts', ridge=0.03, variance_max=1.3, n_rules=4).fit(data.x, data.s)
    assert any('above the 1.3 asked for' in text for text in grown.problems_)
    loose = TSFuzzyNetwork('sts', ridge=0.03, variance_max=1e3, n_rules=4).fit(data.x, data.s)
    assert len(loose.model_.network.offset) == 2
    assert len(loose.rule_values_.center) == 2


def test_lines_only_drop_the_type_and_say_so(data):
    lines = data.x[:, 2] == 2
    model = TSFuzzyNetwork(ridge=0.03).fit(data.x[lines], data.s[lines])
    assert 'kind is constant and was left out' in model.problems_
    assert np.isfinite(model.predict(data.x[lines])).all()
    one, _ = model.model_.predict_one(data.x[lines][3].tolist())
    assert one == pytest.approx(model.predict(data.x[lines][3:4])[0])
    assert not model.model_.accepts(data.x[~lines]).any()


def test_what_looks_like_radians_is_named(data):
    x = data.x.copy()
    x[:, 0] = np.radians(x[:, 0])
    model = TSFuzzyNetwork('sts', ridge=0.03).fit(x, data.s)
    assert any('directions as radians' in problem for problem in model.problems_)


def test_small_directions_are_no_radians():
    """Degrees within a turn of radians: honest ones are never suspected, their copies always."""
    samples = foam_samples(21)  # the limit was not chosen on it
    rng = np.random.default_rng(0)
    for trial in range(60):
        rows = rng.choice(len(samples.x), 40, replace=False)
        x, s = samples.x[rows].copy(), samples.s[rows]
        assert not looks_like_radians(x, s)
        in_radians = x.copy()
        in_radians[:, 0] = np.radians(x[:, 0])
        assert looks_like_radians(in_radians, s), trial
        x[:, 0] = rng.uniform(-6.0, 6.0, 40)
        assert not looks_like_radians(x, true_compensation(x) + rng.normal(0.0, 0.05, (40, 2)))


def test_enough_samples_are_those_that_every_part_leaves():
    x, s = foam_samples(2)
    rng = np.random.default_rng(4)
    few = rng.choice(len(x), samples_needed(10), replace=False)
    TSFuzzyNetwork('sts').fit(x[few], s[few])
    with pytest.raises(TooFewSamplesError, match='at least 10 that differ'):
        TSFuzzyNetwork('sts').fit(x[few[:-1]], s[few[:-1]])


@pytest.mark.parametrize(
    ('column', 'value', 'message'),
    [
        (0, np.nan, 'finite numbers'),
        (1, 0.0, 'row 4: expected depth more than 0 mm'),
        (2, 3.0, r'row 4: expected kind 1 \(arc\) or 2 \(line\), but found 3'),
        (3, 0.0, 'row 4: expected step more than 0 mm'),
        (4, -1.0, 'row 4: expected thickness more than 0 mm'),
        (1, 4.5, r'depth / thickness at most 0.8 \(the foot goes through the sheet\)'),
    ],
)
def test_rows_of_no_primitive_are_refused(data, trained, column, value, message):
    x = data.x.copy()
    x[4, column] = value
    with pytest.raises(ValueError, match=message):
        TSFuzzyNetwork().fit(x, data.s)
    with pytest.raises(ValueError, match=message):
        trained['nts', 'load'].predict(x)
    assert not trained['nts', 'load'].model_.accepts(x)[4]


@pytest.mark.parametrize(
    ('params', 'message'),
    [
        ({'consequent': 'tsk'}, 'consequent: expected one of'),
        ({'training': 'adam'}, 'training: expected one of'),
        (
            {'features': 'all'},
            'features: expected one of load, directions, physical, thickness, paper',
        ),
        ({'ridge': 0.0}, 'ridge: expected more than 0'),
        ({'width_floor': 0.0}, 'width_floor: expected more than 0'),
        ({'n_rules': 0}, 'n_rules: expected at least 1'),
        ({'n_rules': 1000, 'ridge': 0.1}, 'at least 1000 that differ'),
    ],
)
def test_parameters_out_of_range_are_refused(data, params, message):
    with pytest.raises(ValueError, match=message):
        TSFuzzyNetwork(**params).fit(data.x, data.s)


def test_shapes_that_do_not_match_are_refused(data):
    with pytest.raises(ValueError, match='expected one per row'):
        TSFuzzyNetwork().fit(data.x, data.s[:-1])
    with pytest.raises(ValueError, match='expected 5 columns'):
        TSFuzzyNetwork().fit(data.x[:, :4], data.s)
    with pytest.raises(ValueError, match='expected at least 2 to choose the ridge'):
        TSFuzzyNetwork().fit(data.x, data.s, groups=np.zeros(len(data.x), int))
    with pytest.raises(ValueError, match='only equal rows'):
        TSFuzzyNetwork().fit(np.tile(data.x[:1], (40, 1)), data.s[:40])


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**31), groups=st.integers(2, 30))
def test_no_group_is_on_both_sides(seed, groups):
    rng = np.random.default_rng(seed)
    group = rng.integers(groups, size=80)
    folds = grouped_folds(group, 5, rng)
    assert (np.sum(folds, axis=0) == 1).all()
    for part in (*folds, grouped_split(group, 20, rng)):
        assert not set(group[part]) & set(group[~part])


def test_equal_rows_are_one_group():
    assert equal_rows(np.array([[1.0, 2.0], [0.0, 2.0], [1.0, 2.0]])).tolist() == [1, 0, 1]


def test_a_model_runs_without_scikit_learn():
    program = """
import sys
sys.modules['sklearn'] = None
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.model import read_model, write_model
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
x, s = foam_samples(0)
model = TSFuzzyNetwork('sts', ridge=0.1).fit(x, s).model_
assert (read_model(write_model(model)).predict(x) == model.predict(x)).all()
"""
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
