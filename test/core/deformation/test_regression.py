# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Ridge regression, Gaussian process and no correction, as models that a machine runs."""

import numpy as np
import pytest

from fuzzycnc_ros.core.deformation.model import read_model, write_model
from fuzzycnc_ros.core.deformation.regression import (
    gaussian_process,
    no_correction,
    outlying,
    ridge_regression,
)
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples, true_compensation

MAKERS = {'none': no_correction, 'ridge': ridge_regression, 'process': gaussian_process}


@pytest.fixture(scope='module')
def data():
    return foam_samples(3)


@pytest.fixture(scope='module', params=MAKERS)
def model(request, data):
    return MAKERS[request.param](*data)


def test_a_model_is_the_same_from_its_file(model, data):
    again = read_model(write_model(model))
    np.testing.assert_array_equal(again.predict(data.x), model.predict(data.x))
    np.testing.assert_array_equal(again.accepts(data.x), model.accepts(data.x))
    assert again.corrects == model.corrects
    assert write_model(again) == write_model(model)


def test_one_primitive_is_predicted_as_among_many(model, data):
    for row in data.x[::20]:
        values, support = model.predict_one(row.tolist())
        np.testing.assert_allclose(values, model.predict(row[np.newaxis])[0], atol=1e-9)
        assert support == pytest.approx(model.support(row[np.newaxis])[0], abs=1e-9)


def test_samples_are_let_pass_and_other_sheets_are_not(model, data):
    assert model.accepts(data.x).mean() > 0.95
    for column, factor in ((0, 2.0), (4, 2.0)):
        other = data.x.copy()
        other[:, column] = factor * data.x[:, column].max()
        assert not model.accepts(other).any()


@pytest.mark.parametrize(('maker', 'limit'), [(ridge_regression, 0.45), (gaussian_process, 0.25)])
def test_true_compensations_are_predicted(maker, limit, data):
    x = foam_samples(50).x
    error = maker(*data).predict(x) - true_compensation(x)
    assert np.sqrt((error**2).mean()) < limit


def test_light_loads_are_taken_to_be_measured_no_better_than_heavy_ones():
    x, judged = foam_samples(0).x[::2], foam_samples(50).x
    s = true_compensation(x) + np.random.default_rng(0).normal(0.0, 0.5, (len(x), 2))
    error = gaussian_process(x, s).predict(judged) - true_compensation(judged)
    assert np.sqrt((error**2).mean()) < 0.33  # 0.44 with the same noise per load for all


def test_ridge_regression_is_for_one_direction_too():
    x = np.tile([20.0, 6.0, 2.0, 3.0, 15.0], (20, 1))
    x[:, 1] = np.linspace(5.0, 8.0, 20)
    s = true_compensation(x)
    error = ridge_regression(x, s).predict(x) - s
    assert np.abs(error).max() < 0.2 * np.abs(s).max()


def test_outliers_cost_next_to_nothing(data):
    x = foam_samples(50).x
    true = true_compensation(x)
    rng = np.random.default_rng(0)
    wrong = rng.permutation(len(data.x))[:13]
    s = data.s.copy()
    s[wrong] += rng.choice([-1.0, 1.0], (13, 2)) * rng.uniform(3.0, 8.0, (13, 2))
    out = outlying(data.x, s)
    assert out[wrong].mean() > 0.9
    assert out.sum() - out[wrong].sum() <= 3
    clean, dirty, kept = (
        np.sqrt(((gaussian_process(*part).predict(x) - true) ** 2).mean())
        for part in (data, (data.x, s), (data.x[~out], s[~out]))
    )
    assert dirty > 3.0 * clean
    assert kept < 1.3 * clean


def test_two_outliers_among_twenty_samples_do_not_hide_each_other():
    found = wrongly = 0
    for seed in range(440, 444):
        x, s = foam_samples(seed)
        rng = np.random.default_rng(seed)
        some = rng.permutation(len(x))[:20]
        x, s = x[some], s[some].copy()
        angle, away = rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(3.0, 10.0, 2)
        s[:2] += np.column_stack([away * np.cos(angle), away * np.sin(angle)])
        out = outlying(x, s)
        found += out[:2].sum()
        wrongly += out[2:].sum()
    assert found >= 7
    assert wrongly <= 2


def test_honest_samples_are_hardly_ever_outliers():
    for seed in (4, 5):
        assert outlying(*foam_samples(seed)).sum() <= 2


@pytest.mark.parametrize(('seed', 'count'), [(40, 20), (56, 60)])
def test_samples_without_noise_do_not_contradict_each_other(seed, count):
    x = foam_samples(seed).x
    x = x[np.random.default_rng(seed).permutation(len(x))[:count]]
    assert not outlying(x, true_compensation(x)).any()


def test_contradicting_samples_have_no_outliers(data):
    s = data.s.copy()
    s[::3] = -s[::3]
    assert not outlying(data.x, s).any()
    assert not outlying(data.x[:5], data.s[:5]).any()
