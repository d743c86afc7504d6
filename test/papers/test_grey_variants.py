# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""GMC(1,N), OGM(1,N) and DGM(1,N) [tien2012], [zeng2016], [xie2009]."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import trapezoid

from fuzzycnc_ros.core.thermal.fit import GreyModel
from fuzzycnc_ros.core.thermal.recursions.base import (
    ParallelRecursion,
    Stream,
    combine,
)
from fuzzycnc_ros.papers.grey import DifferencedGreyRecursion, GreyVariant

VARIANTS = ('convolution', 'optimised', 'discrete')
CONSTANTS = {**GreyModel.CONSTANTS, **GreyVariant.CONSTANTS}


def made(kind, **options):
    return (GreyVariant if kind in VARIANTS else GreyModel)(kind, **options)


def drivers(samples=80, inputs=2, seed=0):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.uniform(0.0, 0.3, (samples, inputs)), axis=0)


def coefficients(kind, a=0.2, seed=0, inputs=2):
    rng = np.random.default_rng(seed)
    b, constants = rng.normal(size=inputs), rng.normal(size=CONSTANTS[kind])
    model = GreyVariant(kind)
    model.a_, model.b_, model.constants_ = a, 1e-6 * b, 1e-6 * constants
    model.phi_ = np.exp(-a) if kind == 'convolution' else (1.0 - a / 2.0) / (1.0 + a / 2.0)
    return model


def convolution(model, rise, initial):
    """Solve GMC(1,N) in the accumulated domain by the trapezium rule, as it is defined."""
    drive = np.cumsum(rise, axis=0) @ model.b_ + model.constants_[0]
    total = [initial]
    for k in range(1, len(rise)):
        decay = np.exp(-model.a_ * (k - np.arange(k + 1)))
        total.append(initial * decay[0] + trapezoid(decay * drive[: k + 1]))
    return np.diff(total, prepend=0.0)


def optimised(model, rise, initial):
    """Solve OGM(1,N) in the accumulated domain, equation by equation."""
    drive = np.cumsum(rise, axis=0) @ model.b_
    h1, h2 = model.constants_
    total = [initial]
    for k in range(1, len(rise)):
        right = drive[k] + h1 * k + h2 + (1.0 - model.a_ / 2.0) * total[-1]
        total.append(right / (1.0 + model.a_ / 2.0))
    return np.diff(total, prepend=0.0)


def discrete(model, rise, initial):
    """Solve DGM(1,N), whose own coefficients are those of OGM(1,N) over 1 + a/2."""
    half = 1.0 + model.a_ / 2.0
    beta1 = (1.0 - model.a_ / 2.0) / half
    drive = np.cumsum(rise, axis=0) @ (model.b_ / half)
    beta_k, beta0 = model.constants_ / half
    total = [initial]
    for k in range(1, len(rise)):
        total.append(beta1 * total[-1] + drive[k] + beta_k * k + beta0)
    return np.diff(total, prepend=0.0)


SOLVED = {'convolution': convolution, 'optimised': optimised, 'discrete': discrete}


@settings(deadline=None)
@given(
    kind=st.sampled_from(VARIANTS),
    a=st.floats(0.01, 3.0),
    initial=st.sampled_from([0.0, 3e-6]),
    seed=st.integers(0, 50),
)
def test_recursions_solve_their_equation(kind, a, initial, seed):
    model = coefficients(kind, a, seed)
    rise = drivers(seed=seed)
    expected = SOLVED[kind](model, rise, initial)
    found = model.solution(initial).run(rise)[:, 0]
    assert np.abs(found - expected).max() <= 1e-9 * max(1e-6, np.abs(expected).max())


@pytest.mark.parametrize('kind', ['optimised', 'discrete'])
@pytest.mark.parametrize('initial', [0.0, 2e-6])
def test_noise_free_data_give_their_coefficients_back(kind, initial):
    truth = coefficients(kind, a=0.3)
    rise = np.concatenate([drivers(seed=1), drivers(seed=2)])
    runs = np.repeat([0, 1], 80)
    target = np.concatenate([SOLVED[kind](truth, rise[runs == run], initial) for run in (0, 1)])
    model = made(kind).fit(rise, target, runs=runs)
    assert model.a_ == pytest.approx(0.3, rel=1e-6)
    assert np.allclose(model.b_, truth.b_, rtol=1e-6)
    assert np.allclose(model.constants_, truth.constants_, rtol=1e-5, atol=1e-12)
    assert model.phi_ == pytest.approx((1.0 - 0.15) / (1.0 + 0.15), rel=1e-6)
    assert np.allclose(model.predict(rise, runs=runs, initial=initial), target, atol=1e-12)


def test_a_convolution_is_found_where_samples_are_dense():
    """Its regression and its solution are two discretisations, equal only for small a."""
    truth = coefficients('convolution', a=0.01)
    rise = drivers(400)
    model = GreyVariant('convolution').fit(rise, convolution(truth, rise, 0.0))
    assert model.a_ == pytest.approx(0.01, rel=1e-3)
    assert np.allclose(model.b_, truth.b_, rtol=1e-3)
    assert model.phi_ == pytest.approx(np.exp(-model.a_))


@pytest.mark.parametrize('kind', CONSTANTS)
def test_fits_leave_no_residual_along_their_regressors(kind):
    rise = drivers(inputs=3)
    target = 1e-6 * (rise @ np.ones(3)) + 1e-7 * np.random.default_rng(0).normal(size=80)
    used = np.ones(80, bool)
    model = made(kind).fit(rise, target)
    matrix, left = model.equations(rise, target, [slice(0, 80)], used)
    half = 1.0 + model.a_ / 2.0
    constants = getattr(model, 'constants_', [])
    solution = np.concatenate([[model.a_], model.b_, constants])
    if kind == 'discrete':
        solution = np.concatenate([[model.phi_], solution[1:] / half])
    residual = left - matrix @ solution
    scale = np.linalg.norm(matrix, axis=0) * np.linalg.norm(left)
    assert (np.abs(matrix.T @ residual) <= 1e-9 * scale).all()


@pytest.mark.parametrize('kind', VARIANTS)
def test_growing_solutions_are_flagged(kind):
    time = np.arange(30.0)
    rise = np.sin(time)[:, np.newaxis]
    model = made(kind).fit(rise, 1e-6 * np.exp(0.1 * time))
    assert model.a_ < 0.0
    assert model.phi_ > 1.0
    assert not model.stable_
    assert not model.reliable_
    assert 'not positive' in model.problems_[0]
    far = model.predict(np.ones((30000, 1)))
    assert not np.isfinite(far[-1])


@pytest.mark.parametrize('kind', VARIANTS)
@pytest.mark.parametrize(('a', 'trusted'), [(0.015, True), (0.005, False)])
def test_poles_beyond_the_slowest_of_the_stable_form_are_flagged(kind, a, trusted):
    """0.99 at one sample a minute, 0.99^2 at one in two minutes."""
    truth, rise = coefficients(kind, a), drivers(400)
    target = SOLVED[kind](truth, rise, 0.0)
    assert made(kind).fit(rise, target).reliable_ == trusted
    slower = made(kind, interval=120.0).fit(rise, target)
    assert slower.phi_ > 0.99**2
    assert 'the slowest that is trusted' in slower.problems_[0]


@pytest.mark.parametrize('kind', VARIANTS)
def test_collinear_drivers_are_flagged(kind):
    rise = drivers(inputs=1)
    twice = np.hstack([rise, rise * (1.0 + 1e-9)])
    model = made(kind).fit(twice, 1e-6 * rise[:, 0] + 1e-9 * rise[:, 0] ** 2)
    assert model.condition_ > 1e6
    assert any('collinear' in problem for problem in model.problems_)


@pytest.mark.parametrize('kind', CONSTANTS)
def test_runs_without_a_measurement_are_left_out(kind):
    rise = np.concatenate([drivers(seed=1), drivers(seed=2)])
    runs = np.repeat([0, 1], 80)
    target = 1e-6 * rise.sum(axis=1) + 1e-9 * np.random.default_rng(1).normal(size=160)
    one = made(kind).fit(rise, np.where(runs == 0, target, np.nan), runs=runs)
    other = made(kind).fit(rise[runs == 0], target[runs == 0])
    assert np.array_equal(one.predict(rise, runs=runs), other.predict(rise, runs=runs))


@pytest.mark.parametrize('kind', VARIANTS)
def test_refusals(kind):
    rise = drivers()
    target = 1e-6 * rise.sum(axis=1)
    with pytest.raises(ValueError, match=r'found 1 NaN; .* use the stable form'):
        made(kind).fit(rise, np.where(np.arange(80) == 5, np.nan, target))
    least = 3 + CONSTANTS[kind]
    with pytest.raises(ValueError, match=f'more than {least} measured samples'):
        made(kind).fit(rise[:least], target[:least])
    with pytest.raises(ValueError, match=r'GM\(1,1\)'):
        made(kind).fit(None, target)


RECURSIONS = [coefficients(kind, seed=seed).solution(1e-6) for seed, kind in enumerate(VARIANTS)]


@pytest.mark.parametrize('recursion', RECURSIONS)
def test_stream_and_batch_agree(recursion):
    batch = recursion.run(drivers())
    stream = Stream(recursion)
    steps = np.array([stream.step(sample) for sample in drivers()])
    assert np.abs(steps - batch).max() <= 1e-12 * np.abs(batch).max()


def test_channels_are_joined_where_they_are_of_one_kind():
    one, two, three = RECURSIONS
    joined = combine([two, three])
    assert isinstance(joined, DifferencedGreyRecursion)
    expected = np.hstack([two.run(drivers()), three.run(drivers())])
    assert np.allclose(joined.run(drivers()), expected, rtol=1e-12)
    assert np.allclose(joined.channel(1).run(drivers()), expected[:, 1:], rtol=1e-12)
    assert isinstance(combine([one, two]), ParallelRecursion)


@settings(deadline=None)
@given(finer=st.sampled_from([2, 5]), kind=st.sampled_from(VARIANTS), seed=st.integers(0, 20))
def test_conversion_keeps_steady_state_and_decay(finer, kind, seed):
    recursion = coefficients(kind, a=0.05, seed=seed).solution(0.0)
    other = recursion.with_interval(1.0 / finer)
    last = recursion.run(np.ones((600, 2)))[-1]
    assert other.run(np.ones((600 * finer, 2)))[-1] == pytest.approx(last, rel=1e-6, abs=1e-15)
    # Without drivers only start and constant are left: equal at equal times from the second on.
    coarse = recursion.run(np.zeros((50, 2)))
    fine = other.run(np.zeros((50 * finer, 2)))[::finer]
    assert np.allclose(coarse[1:], fine[1:], rtol=1e-9, atol=1e-18)
    back = other.with_interval(finer)
    assert np.allclose(back.run(drivers()), recursion.run(drivers()), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize('a', [2.0, 2.5, 0.0])
def test_poles_without_a_time_constant_cannot_be_converted(a):
    recursion = coefficients('optimised', a=a).solution(0.0)
    with pytest.raises(ValueError, match='fit the model anew'):
        recursion.with_interval(2.0)
