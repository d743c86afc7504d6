# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.estimator import NotFittedError
from fuzzycnc_ros.core.thermal.fit import LagRidge, LeastSquares, StaticRidge
from fuzzycnc_ros.core.thermal.fit.linear import lag_features, poles_of_lags
from fuzzycnc_ros.core.thermal.moments import Moments, mean_square_error, ridge_from_sums

MODELS = [LeastSquares(), StaticRidge(), LagRidge(), LagRidge(fit_intercept=True)]


def data(seed=0, samples=120, inputs=3, noise=1e-7):
    rng = np.random.default_rng(seed)
    rise = np.cumsum(rng.normal(0.05, 0.3, (samples, inputs)), axis=0)
    target = rise @ np.linspace(1e-6, 2e-6, inputs) + noise * rng.normal(size=samples)
    return rise, target


def fitted(model, *args, **options):
    return type(model)(**model.get_params()).fit(*args, **options)


def test_least_squares_satisfies_the_normal_equations():
    rise, target = data()
    model = LeastSquares().fit(rise, target + 5e-6)
    residual = target + 5e-6 - model.predict(rise)
    assert np.abs(rise.T @ residual).max() < 1e-15 * np.abs(rise).sum()
    assert abs(residual.sum()) < 1e-15


@pytest.mark.parametrize('model', MODELS)
@settings(deadline=None, max_examples=20)
@given(scale=st.floats(1e-3, 1e6), seed=st.integers(0, 50))
def test_units_do_not_matter(model, scale, seed):
    rise, target = data(seed)
    one = fitted(model, rise, target).predict(rise)
    other = fitted(model, rise, scale * target).predict(rise)
    assert np.allclose(scale * one, other, rtol=1e-6, atol=1e-9 * scale * np.abs(one).max())


@pytest.mark.parametrize('model', MODELS)
def test_order_of_the_inputs_does_not_matter(model):
    rise, target = data()
    order = [2, 0, 1]
    one = fitted(model, rise, target).predict(rise)
    other = fitted(model, rise[:, order], target).predict(rise[:, order])
    assert np.allclose(one, other, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize('model', MODELS)
def test_missing_targets_are_ignored(model):
    rise, target = data()
    gappy = np.where(np.arange(len(target)) % 3 == 0, target, np.nan)
    predicted = fitted(model, rise, gappy).predict(rise)
    assert np.isfinite(predicted).all()
    assert np.abs(predicted - target).max() < 3e-6


@pytest.mark.parametrize('model', MODELS)
def test_runs_start_anew_and_streams_agree(model):
    rise, target = data()
    runs = np.repeat([0, 1], 60)
    model = fitted(model, rise, target, runs=runs)
    batch = model.predict(rise, runs=runs)
    for run in (0, 1):
        model.start()
        steps = np.array([model.step(sample) for sample in rise[runs == run]])
        assert np.abs(steps - batch[runs == run]).max() <= 1e-12 * np.abs(batch).max()


def test_lag_ridge_is_anchored_at_zero_rise():
    rise, target = data()
    assert fitted(LagRidge(), rise, target + 1e-5).start().step(np.zeros(3)) == 0.0


def test_lag_ridge_minimises_its_penalised_cost():
    rise, target = data(noise=1e-6)
    model = LagRidge(ridge=1e-2).fit(rise, target)
    features = lag_features(rise, [slice(0, len(rise))], poles_of_lags(model.lags, 60.0))
    scaled = features / features.std(axis=0)
    theta = model.coef_.ravel() * features.std(axis=0)
    gradient = scaled.T @ (target - scaled @ theta) / len(target) - 1e-2 * theta
    assert np.abs(gradient).max() < 1e-12 * np.abs(theta).max() + 1e-18


def test_lags_keep_their_time_constants_at_another_interval():
    rise, target = data()
    model = LagRidge(lags=(600.0,)).fit(rise, target)
    slow = model.with_interval(300.0)
    assert np.allclose(slow.recursion_.pole, np.exp(-0.5))
    constant = np.ones((2000, 3))
    assert slow.predict(constant)[-1] == pytest.approx(model.predict(constant)[-1], rel=1e-6)


def test_estimators_follow_the_conventions():
    model = LagRidge()
    assert model.get_params() == {
        'lags': (1200.0, 3600.0),
        'ridge': 1e-3,
        'interval': 60.0,
        'fit_intercept': False,
        'drivers': 0,
        'driver_lags': (1200.0, 3600.0, 14400.0),
    }
    assert model.set_params(ridge=0.1).ridge == 0.1
    assert model.fit(*data()) is model
    assert model.n_features_in_ == 3
    with pytest.raises(NotFittedError):
        LagRidge().predict([[1.0]])
    with pytest.raises(NotFittedError):
        LagRidge().step([1.0])


@pytest.mark.parametrize('model', MODELS)
def test_bad_samples_are_refused(model):
    rise, target = data()
    with pytest.raises(ValueError, match='NaN'):
        fitted(model, np.where(rise == rise[3, 1], np.nan, rise), target)
    with pytest.raises(ValueError, match='y: expected 120 values'):
        fitted(model, rise, target[:-1])
    with pytest.raises(ValueError, match='only NaN'):
        fitted(model, rise, np.full(120, np.nan))
    with pytest.raises(ValueError, match='infinity'):
        fitted(model, rise, np.full(120, np.inf))
    with pytest.raises(ValueError, match='features'):
        fitted(model, rise, target).predict(rise[:, :2])


def test_bad_parameters_are_refused():
    rise, target = data()
    with pytest.raises(ValueError, match='ridge: expected a positive'):
        LagRidge(ridge=-1.0).fit(rise, target)
    with pytest.raises(ValueError, match='lags: expected positive'):
        LagRidge(lags=(0.0,)).fit(rise, target)
    with pytest.raises(ValueError, match=r'interval: expected from 0\.001'):
        LagRidge(interval=0.0).fit(rise, target)
    with pytest.raises(ValueError, match=r'interval: expected from 0\.001'):
        LagRidge().fit(rise, target).with_interval(np.nan)
    with pytest.raises(ValueError, match='more than 4 measured samples'):
        LeastSquares().fit(rise[:4], target[:4])


@pytest.mark.parametrize('intercept', [True, False])
@pytest.mark.parametrize('ridge', [0.0, 1e-3, 0.1])
def test_sums_of_products_give_the_same_fit_as_the_samples(intercept, ridge):
    rise, target = data(noise=1e-6)
    block = np.repeat([0, 1, 2], 40)
    moments = Moments.of(rise, 1e6 * target[:, np.newaxis], block)
    sums = moments.over([0, 2])
    weight, constant = ridge_from_sums(sums, 3, ridge, intercept)
    used = block != 1
    scale = rise[used].std(axis=0)
    center = rise[used].mean(axis=0) * intercept
    level = 1e6 * target[used].mean() * intercept
    columns = (rise[used] - center) / scale
    normal = columns.T @ columns + ridge * used.sum() * np.eye(3)
    expected = np.linalg.solve(normal, columns.T @ (1e6 * target[used] - level)) / scale
    assert np.allclose(weight[:, 0], expected, rtol=1e-8)
    assert constant[0] == pytest.approx(level - center @ expected, rel=1e-8, abs=1e-9)
    held_out = moments.over([1])
    residual = 1e6 * target[~used] - rise[~used] @ weight[:, 0] - constant[0]
    assert mean_square_error(held_out, weight, constant)[0] == pytest.approx(
        (residual**2).mean(), rel=1e-7
    )
