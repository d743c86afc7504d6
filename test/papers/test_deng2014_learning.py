# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Clustering, networks, gate and gain on the samples of the simulated foam [deng2014].

Errors are root mean squares over both axes in mm per 50 mm of feed, on 32 samples that were held
out in whole groups of equal process values, means of five splits.  The default features and
settings were chosen on data seeds from 11 on, which are not used here.
"""

import numpy as np
import pytest
from foam_splits import grouped_split

from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.training import equal_rows
from fuzzycnc_ros.core.fuzzy.clustering import GustafsonKessel, class_values
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples

pytestmark = pytest.mark.paper

SPLITS = 5


def rms(error):
    return float(np.sqrt(np.mean(error**2)))


def held_out_error(seed, **settings):
    x, s = foam_samples(seed)
    errors = []
    for split in range(SPLITS):
        out = grouped_split(equal_rows(x), 32, np.random.default_rng([seed, split]))
        assert 28 <= out.sum() <= 32
        model = TSFuzzyNetwork(**settings).fit(x[~out], s[~out])
        errors.append(rms(model.predict(x[out]) - s[out]))
    return float(np.mean(errors))


def joined(seed, columns=5):
    x, s = foam_samples(seed)
    z = np.column_stack([x[:, :columns], s])
    return (z - z.mean(axis=0)) / z.std(axis=0)


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_objective_hardly_rises_and_memberships_sum_to_one(seed):
    model = GustafsonKessel(10, random_state=seed).fit(joined(0))
    history = model.objective_history_
    assert (np.diff(history) <= 1e-3 * history[:-1]).all()
    assert np.abs(model.membership_.sum(axis=1) - 1.0).max() <= 1e-12


@pytest.mark.parametrize(('columns', 'low', 'high'), [(4, 77.25, 78.82), (5, 69.67, 71.26)])
def test_objective_is_the_sheets(columns, low, high):
    found = GustafsonKessel(10, n_init=8, random_state=0).fit(joined(0, columns)).objective_
    assert 0.99 * low <= found <= 1.01 * high


def test_growth_rule_is_never_satisfied():
    s = foam_samples(0).s
    for count in (2, 4, 10):
        model = GustafsonKessel(count, n_init=2, random_state=0).fit(joined(0, 4))
        assert class_values(model.membership_, s).variance.max() > 10.0 * 1.3


@pytest.mark.slow
def test_errors_with_the_thickness_as_the_fifth_input():
    """The network with a hidden layer against linear rules, as the prototype set them.

    The mean of five data seeds, for single ones depend on a single sample: on data seed 3 the
    largest of all, 20.5 mm at the edge of what was sampled (thinnest sheet, deepest foot, shortest
    step), is held out in three splits of five and missed by 7 to 8 mm, which gives 0.96 mm;
    without the worst sample of each split it is 0.51 mm, like the others.
    """
    settings = {'features': 'thickness', 'ridge': 1e-2, 'members': 1, 'width_floor': 0.5}
    hidden = [held_out_error(seed, **settings) for seed in range(5)]
    linear = [held_out_error(seed, consequent='sts', **settings) for seed in range(5)]
    assert np.mean(hidden) <= 0.85
    assert np.mean(linear) <= 1.35
    assert np.mean(hidden) <= 0.80 * np.mean(linear)
    assert sorted(hidden)[3] <= 0.85  # all but one
    assert sorted(linear)[3] <= 1.35


@pytest.mark.slow
@pytest.mark.parametrize('seeds', [2, pytest.param(4, marks=pytest.mark.qualify)])
def test_errors_of_the_default(seeds):
    """With features that know the load of a stitch linear rules come close as well."""
    errors = [held_out_error(seed) for seed in range(seeds)]
    assert np.mean(errors) <= 0.35
    assert max(errors) <= 0.45
    linear = [held_out_error(seed, consequent='sts') for seed in range(seeds)]
    assert np.mean(errors) < np.mean(linear)


@pytest.mark.parametrize('features', ['load', 'thickness'])
def test_gate_refuses_what_was_not_trained_and_little_else(features):
    x, s = foam_samples(0)
    model = TSFuzzyNetwork(features=features, ridge=0.03).fit(x, s).model_
    fresh = np.concatenate([foam_samples(seed).x for seed in (4, 5, 6)])
    assert np.mean(~model.accepts(fresh)) <= 0.05
    thickness, ratio, angle = np.meshgrid(
        [5.0, 15.0, 20.0, 25.0, 35.0], np.linspace(0.601, 3.0, 20), np.linspace(-30.0, 149.0, 30)
    )
    rows = np.column_stack([v.ravel() for v in (angle, ratio * thickness, thickness)])
    for kind in (1.0, 2.0):
        for step in (2.0, 5.0):
            fixed = np.tile([kind, step], (len(rows), 1))
            deep = np.column_stack([rows[:, :2], fixed, rows[:, 2]])
            assert not model.accepts(deep).any()
            turned = deep.copy()
            turned[:, 1] = 0.4 * turned[:, 4]
            beyond = (turned[:, 0] < 0.0) | (turned[:, 0] > 60.0)
            assert beyond.any()
            assert not model.accepts(turned[beyond]).any()


def test_gate_refuses_a_thickness_that_was_never_seen():
    x, s = foam_samples(0)
    thin = x[:, 4] == 5.0
    model = TSFuzzyNetwork(ridge=0.03).fit(x[~thin], s[~thin]).model_
    assert not model.accepts(x[thin]).any()


def test_gain_follows_a_rise_of_friction():
    x, s = foam_samples(0)
    model = TSFuzzyNetwork(ridge=0.03).fit(x, s).model_
    now = foam_samples(7, friction=1.25)
    order = np.random.default_rng(0).permutation(len(now.x))
    seen, unseen = order[:20], order[20:]
    adapted = model.adapted(now.x[seen], now.s[seen])
    before = rms(model.predict(now.x[unseen]) - now.s[unseen])
    after = rms(adapted.predict(now.x[unseen]) - now.s[unseen])
    assert adapted.gain.value == pytest.approx([1.25, 1.25], abs=0.1)
    assert after <= 0.6 * before


@pytest.mark.slow
def test_published_steepest_descent_learns_but_is_not_better():
    """The published method, its sign put right, on one split."""
    x, s = foam_samples(0)
    out = grouped_split(equal_rows(x), 32, np.random.default_rng([0, 0]))
    settings = {'features': 'thickness', 'members': 1, 'ridge': 1e-2, 'width_floor': 0.5}
    errors = {}
    for training in ('hybrid', 'levenberg_marquardt', 'steepest_descent'):
        model = TSFuzzyNetwork(training=training, **settings).fit(x[~out], s[~out])
        errors[training] = rms(model.predict(x[out]) - s[out])
    assert max(errors.values()) <= 1.2
    assert errors['hybrid'] <= errors['steepest_descent']
