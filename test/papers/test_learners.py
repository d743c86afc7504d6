# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.recursions.base import (
    ParallelRecursion,
    Stream,
    combine,
)
from fuzzycnc_ros.papers.learners import GaussianProcess, LayersRecursion, Mlp

processes = pytest.importorskip('sklearn.gaussian_process')
networks = pytest.importorskip('sklearn.neural_network')

MODELS = [GaussianProcess(samples_max=40), Mlp(hidden=(6,)), Mlp(hidden=(5, 4), activation='relu')]


def data(seed=0, samples=120, inputs=3):
    """Return rises and a mildly curved error with noise of 0.3 um."""
    rng = np.random.default_rng(seed)
    rise = np.cumsum(rng.normal(0.05, 0.3, (samples, inputs)), axis=0)
    error = rise @ np.linspace(1.0, 2.0, inputs) + 0.1 * rise[:, 0] ** 2
    return rise, 1e-6 * (error + 0.3 * rng.normal(size=samples))


def fitted(model, *arguments, **options):
    return type(model)(**model.get_params()).fit(*arguments, **options)


def test_the_process_predicts_what_scikit_learn_predicts():
    kernels = processes.kernels
    rise, target = data()
    model = GaussianProcess(samples_max=200).fit(rise, target)
    center, scale = rise.mean(axis=0), rise.std(axis=0)
    level, unit = target.mean(), target.std()
    kernel = (
        kernels.ConstantKernel() * kernels.DotProduct()
        + kernels.ConstantKernel() * kernels.RBF()
        + kernels.WhiteKernel(1e-2)
    )
    rival = processes.GaussianProcessRegressor(kernel)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        rival.fit((rise - center) / scale, (target - level) / unit)
    elsewhere = np.vstack([rise, 3.0 * rise, np.zeros((1, 3))])
    mean, deviation = rival.predict((elsewhere - center) / scale, return_std=True)
    assert np.allclose(model.predict(elsewhere), level + unit * mean, rtol=1e-8, atol=1e-13)
    assert np.allclose(model.standard_deviation(elsewhere), unit * deviation, rtol=1e-5)
    assert model.length_ == pytest.approx(rival.kernel_.k1.k2.k2.length_scale)


@pytest.mark.parametrize(('hidden', 'activation'), [((6,), 'tanh'), ((5, 4), 'relu')])
def test_the_perceptron_predicts_what_scikit_learn_predicts(hidden, activation):
    rise, target = data()
    model = Mlp(hidden=hidden, activation=activation, random_state=3).fit(rise, target)
    center, scale = rise.mean(axis=0), rise.std(axis=0)
    level, unit = target.mean(), target.std()
    rival = networks.MLPRegressor(
        hidden_layer_sizes=hidden,
        activation=activation,
        solver='lbfgs',
        alpha=1e-3 * len(rise),
        max_iter=2000,
        max_fun=200000,
        random_state=int(np.random.default_rng(3).integers(2**31)),
    ).fit((rise - center) / scale, (target - level) / unit)
    expected = level + unit * rival.predict((rise - center) / scale)
    assert np.allclose(model.predict(rise), expected, rtol=1e-8, atol=1e-13)


@pytest.mark.parametrize('model', MODELS, ids=repr)
def test_curved_errors_are_learnt(model):
    rise, target = data()
    model = fitted(model, rise, target)
    assert np.sqrt(np.mean((model.predict(rise) - target) ** 2)) < 0.5e-6
    assert model.problems_ == ()


@pytest.mark.parametrize('model', MODELS, ids=repr)
def test_rows_without_a_target_are_left_out(model):
    rise, target = data()
    measured = np.arange(len(target)) % 3 != 0
    gappy = np.where(measured, target, np.nan)
    one = fitted(model, rise, gappy).predict(rise)
    other = fitted(model, rise[measured], target[measured]).predict(rise)
    assert np.array_equal(one, other)


@pytest.mark.parametrize('model', MODELS, ids=repr)
def test_equal_input_gives_equal_models(model):
    rise, target = data()
    one, other = (fitted(model, rise, target) for _ in range(2))
    assert np.array_equal(one.predict(rise), other.predict(rise))


@pytest.mark.parametrize('model', MODELS, ids=repr)
def test_units_of_the_target_do_not_matter(model):
    rise, target = data()
    one = fitted(model, rise, target).predict(rise)
    # A power of two, which rounds nothing: the solvers take the same steps.
    other = fitted(model, rise, 2.0**20 * target).predict(rise)
    assert np.allclose(2.0**20 * one, other, rtol=1e-12, atol=0.0)


@pytest.mark.parametrize('model', MODELS, ids=repr)
def test_a_target_that_never_moves_is_learnt(model):
    rise, _ = data()
    predicted = fitted(model, rise, np.full(len(rise), 2e-6)).predict(rise)
    assert np.allclose(predicted, 2e-6, rtol=1e-6)


def test_kept_samples_are_bounded_and_evenly_picked():
    rise, target = data(samples=100)
    target[:20] = np.nan
    model = GaussianProcess(samples_max=9).fit(rise, target)
    kept = [
        int(np.flatnonzero((rise == point).all(axis=1))[0]) for point in model.recursion_.points
    ]
    assert len(kept) == 9
    assert (kept[0], kept[-1]) == (20, 99)
    assert set(np.diff(kept)) <= {9, 10}


def test_the_band_covers_and_widens_away_from_the_samples():
    rise, target = data(samples=300)
    even = np.arange(300) % 2 == 0
    model = GaussianProcess().fit(rise[even], target[even])
    deviation = model.standard_deviation(rise[~even])
    residual = np.abs(model.predict(rise[~even]) - target[~even])
    assert 0.88 <= np.mean(residual <= 2.0 * deviation) <= 1.0
    assert 0.55 <= np.mean(residual <= deviation) <= 0.85
    assert (deviation >= model.noise_).all()
    away = rise[0] + np.outer([0.0, 10.0, 100.0], np.ones(3))
    assert (np.diff(model.standard_deviation(away)) > 0.0).all()
    assert model.noise_ == pytest.approx(0.3e-6, rel=0.2)


def two_channels(model):
    rise, target = data()
    return combine(
        [fitted(model, rise, target).recursion_, fitted(model, rise, -target).recursion_]
    )


@pytest.mark.parametrize('model', MODELS, ids=repr)
def test_channels_are_merged_and_taken_apart(model):
    recursion = two_channels(model)
    assert not isinstance(recursion, ParallelRecursion)
    rise, target = data()
    single = fitted(model, rise, target).predict(rise)
    batch = recursion.run(rise)
    assert np.allclose(batch[:, 0], single, rtol=1e-11, atol=1e-17)
    assert np.allclose(recursion.channel(0).run(rise)[:, 0], single, rtol=1e-11, atol=1e-17)
    stream = Stream(recursion)
    steps = np.array([stream.step(row) for row in rise])
    assert np.abs(steps - batch).max() <= 1e-12 * np.abs(batch).max()
    assert stream.state.size == 0
    assert np.array_equal(recursion.with_interval(10.0).run(rise), batch)


def test_channels_of_other_samples_or_layers_run_side_by_side():
    rise, target = data()
    gappy = np.where(np.arange(len(target)) < 60, np.nan, target)
    for one, other in (
        (MODELS[0], fitted(MODELS[0], rise, gappy)),
        (MODELS[1], fitted(MODELS[2], rise, target)),
    ):
        one = fitted(one, rise, target)
        both = combine([one.recursion_, other.recursion_])
        assert isinstance(both, ParallelRecursion)
        assert np.allclose(both.run(rise)[:, 1], other.predict(rise), rtol=1e-12, atol=0.0)


def test_the_band_of_two_channels_is_that_of_each():
    recursion = two_channels(MODELS[0])
    rise = data(seed=5)[0].reshape(12, 10, 3)
    band = recursion.standard_deviation(rise)
    assert band.shape == (12, 10, 2)
    alone = recursion.channel(1).standard_deviation(rise[3])
    assert np.allclose(band[3, :, 1], alone[:, 0], rtol=1e-12)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'length': np.zeros((2, 3))}, 'length: expected positive'),
        ({'noise': -np.ones(2)}, 'noise: expected positive'),
        ({'weight': np.full((2, 40), np.nan)}, 'weight: expected finite numbers'),
        ({'offset': np.zeros(1)}, r'offset: expected finite numbers of shape \(2,\)'),
    ],
)
def test_arrays_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(two_channels(MODELS[0]), **change)


def test_layers_that_do_not_follow_are_refused():
    one = (np.zeros((1, 4, 3)), np.zeros((1, 4)))
    for weights, biases, message in (
        ((one[0],), (one[1],), 'one output per channel'),
        ((one[0], np.zeros((1, 1, 5))), (one[1], np.zeros((1, 1))), 'in layer 1'),
        ((one[0],), (), 'as many layers as biases'),
    ):
        with pytest.raises(ValueError, match=message):
            LayersRecursion(weights, biases, 'tanh')
    with pytest.raises(ValueError, match='activation: expected one of tanh, relu'):
        LayersRecursion(*([item] for item in one), 'step')


def test_a_fit_that_was_stopped_is_flagged():
    model = Mlp(iterations_max=3).fit(*data())
    assert model.n_iter_ == 3
    assert 'stopped before it had converged' in model.problems_[0]


@pytest.mark.parametrize(
    ('model', 'message'),
    [
        (GaussianProcess(samples_max=1), 'samples_max: expected at least 2'),
        (GaussianProcess(interval=0.0), 'interval: expected from'),
        (Mlp(hidden=()), 'hidden: expected one or more layers'),
        (Mlp(hidden=(3, 0)), 'hidden: expected one or more layers'),
        (Mlp(activation='step'), 'activation: expected one of tanh, relu'),
        (Mlp(ridge=0.0), 'ridge: expected a positive'),
        (Mlp(iterations_max=0), 'iterations_max: expected at least 1'),
    ],
)
def test_bad_parameters_are_refused(model, message):
    with pytest.raises(ValueError, match=message):
        model.fit(*data())


@pytest.mark.parametrize('model', MODELS, ids=repr)
def test_one_measured_sample_is_too_few(model):
    rise, target = data()
    target[1:] = np.nan
    with pytest.raises(ValueError, match='found 1 sample;'):
        fitted(model, rise, target)


def test_without_scikit_learn_a_fit_names_it():
    program = """
import sys
sys.modules['sklearn'] = None
import numpy as np
from fuzzycnc_ros.papers.learners import Mlp
rise = np.arange(40.0)[:, np.newaxis]
try:
    Mlp().fit(rise, rise[:, 0])
except ImportError as error:
    print(error.name)
"""
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith('sklearn')
