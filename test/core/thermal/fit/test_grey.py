# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
from functools import partial

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.thermal.fit import GreyModel
from fuzzycnc_ros.core.thermal.recursions.base import first_order_lags
from fuzzycnc_ros.papers.grey import GreyVariant

EVERY_KIND = [partial(form, kind) for form in (GreyModel, GreyVariant) for kind in form.kinds()]


def dynamic_data(pole=0.9, samples=150, inputs=2, seed=0, noise=0.0):
    """Return rises and the error of one common lag, in two runs."""
    rng = np.random.default_rng(seed)
    runs = np.repeat([0, 1], samples)
    rise = np.concatenate(
        [np.cumsum(rng.normal(0.05, 0.2, (samples, inputs)), axis=0) for _ in range(2)]
    )
    weight = 1e-6 * np.arange(1, inputs + 1)
    lagged = np.concatenate(
        [first_order_lags(np.array(pole), (1 - pole) * rise[runs == run]) for run in range(2)]
    )
    target = lagged @ weight + noise * rng.normal(size=2 * samples)
    return rise, target, runs, weight


def accumulated_solution(a, b, rise, initial):
    """Solve eq. (12) in the accumulated domain, step by step."""
    drive = np.cumsum(rise, axis=0) @ b
    total = [initial]
    for k in range(1, len(rise)):
        total.append((total[-1] * (1.0 - a / 2.0) + drive[k]) / (1.0 + a / 2.0))
    return np.diff(total, prepend=0.0)


@settings(deadline=None)
@given(seed=st.integers(0, 200), initial=st.sampled_from([0.0, 3e-6]), inputs=st.integers(1, 4))
def test_derived_recursion_solves_the_grey_equation(seed, initial, inputs):
    rise, target, runs, _ = dynamic_data(seed=seed, inputs=inputs, noise=1e-7)
    model = GreyModel('derived').fit(rise, target, runs=runs)
    assume(model.stable_)
    predicted = model.predict(rise[runs == 1], initial=initial)
    expected = accumulated_solution(model.a_, model.b_, rise[runs == 1], initial)
    # In the unit of 1 um, so that the bound 1e-9 max(1, max|y|) means something.
    scale = max(1.0, np.abs(expected * 1e6).max())
    assert np.abs((predicted - expected) * 1e6).max() <= 1e-9 * scale


def test_static_data_give_a_pole_of_zero():
    rng = np.random.default_rng(0)
    rise = np.cumsum(rng.uniform(0.0, 0.3, (60, 3)), axis=0)
    truth = np.array([2e-6, -1e-6, 0.5e-6])
    model = GreyModel('classical').fit(rise, rise @ truth)
    assert model.a_ == pytest.approx(2.0, abs=1e-8)
    assert model.phi_ == pytest.approx(0.0, abs=1e-8)
    assert np.allclose(model.b_, 2.0 * truth, rtol=1e-7)
    assert model.reliable_


def test_the_published_response_is_static_once_its_exponential_has_died():
    rise, target, runs, _ = dynamic_data()
    model = GreyModel('classical').fit(rise, target, runs=runs)
    constant = np.tile(rise[-1], (3000, 1))
    assert model.predict(constant)[-1] == pytest.approx(rise[-1] @ model.b_ / model.a_, rel=1e-6)


def test_growing_solutions_are_flagged():
    time = np.arange(30.0)[:, np.newaxis]
    model = GreyModel('classical').fit(np.ones_like(time), 1e-6 * np.exp(0.1 * time[:, 0]))
    assert model.a_ < 0.0
    assert not model.stable_
    assert not model.reliable_
    assert 'not positive' in model.problems_[0]
    growing = np.abs(model.predict(np.ones((400, 1))))
    assert growing[-1] > 1e3 * growing[30]


def test_divergence_beyond_numbers_is_shown_not_raised():
    time = np.arange(30.0)[:, np.newaxis]
    model = GreyModel('classical').fit(np.ones_like(time), 1e-6 * np.exp(0.1 * time[:, 0]))
    assert not np.isfinite(model.predict(np.ones((20000, 1)))[-1])


def test_collinear_drivers_are_flagged():
    rise, target, runs, _ = dynamic_data(inputs=1)
    twice = np.hstack([rise, rise * (1.0 + 1e-9)])
    model = GreyModel('classical').fit(twice, target, runs=runs)
    assert model.condition_ > 1e6
    assert any('collinear' in problem for problem in model.problems_)


def test_stable_form_finds_lag_and_gains():
    rise, target, runs, weight = dynamic_data(pole=0.9)
    model = GreyModel('stable', ridge=1e-9).fit(rise, target, runs=runs)
    assert model.phi_ == 0.9
    assert np.allclose(model.b_ / model.a_, weight, rtol=1e-4)
    assert model.reliable_
    assert model.a_ == pytest.approx(2.0 * 0.1 / 1.9)


def test_stable_form_is_the_recursion_of_its_a_and_b():
    rise, target, runs, _ = dynamic_data(pole=0.9)
    model = GreyModel('stable').fit(rise, target, runs=runs)
    forced = rise[runs == 0] @ (model.b_ / (1.0 + model.a_ / 2.0))
    expected = first_order_lags(np.array(model.phi_), forced)
    assert np.allclose(model.predict(rise[runs == 0]), expected, rtol=1e-9, atol=1e-15)


def test_a_lag_beyond_the_grid_is_flagged():
    rise, target, runs, _ = dynamic_data(pole=0.999)
    model = GreyModel('stable').fit(rise, target, runs=runs)
    assert model.phi_ == 0.99
    assert 'end of the grid' in model.problems_[0]


def test_poles_keep_their_time_constants_at_another_interval():
    rise, target, runs, _ = dynamic_data(pole=0.9)
    fast = GreyModel('stable').fit(rise, target, runs=runs)
    slow = GreyModel('stable', interval=120.0)
    slow.fit(rise[::2], target[::2], runs=runs[::2])
    assert slow.phi_ == pytest.approx(fast.phi_**2)
    converted = fast.with_interval(120.0)
    assert converted.recursion_.pole[0] == pytest.approx(slow.phi_)
    assert fast.interval == 60.0


@pytest.mark.parametrize('make', EVERY_KIND)
def test_scaling_units_scales_the_prediction(make):
    rise, target, runs, _ = dynamic_data(noise=1e-8)
    one = make().fit(rise, target, runs=runs).predict(rise, runs=runs)
    other = make().fit(rise, 1e6 * target, runs=runs).predict(rise, runs=runs)
    assert np.allclose(1e6 * one, other, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize('make', EVERY_KIND)
def test_each_run_starts_anew(make):
    rise, target, runs, _ = dynamic_data()
    model = make().fit(rise, target, runs=runs)
    together = model.predict(rise, runs=runs)
    apart = np.concatenate([model.predict(rise[runs == run]) for run in (0, 1)])
    assert np.array_equal(together, apart)


def test_samples_out_of_use_do_not_matter():
    rise, target, runs, _ = dynamic_data(noise=1e-7)
    use = runs == 0
    disturbed = np.where(use, target, 1e-3)
    for make in EVERY_KIND:
        one = make().fit(rise, disturbed, runs=runs, use=use)
        other = make().fit(rise[use], target[use])
        assert one.a_ == pytest.approx(other.a_)
        assert np.allclose(one.b_, other.b_)


def test_refusals():
    rise, target, _, _ = dynamic_data()
    with pytest.raises(ValueError, match=r"kind: expected one of .* found 'grey'"):
        GreyModel('grey').fit(rise, target)
    with pytest.raises(ValueError, match='use the stable form'):
        GreyModel('classical').fit(rise, np.where(np.arange(300) == 5, np.nan, target))
    with pytest.raises(ValueError, match='more than 3 measured samples'):
        GreyModel('classical').fit(rise[:3], target[:3])
    for poles in ((0.5, 1.0), ()):
        with pytest.raises(ValueError, match='one pole or more'):
            GreyModel('stable', poles=poles).fit(rise, target)
    with pytest.raises(ValueError, match='ridge'):
        GreyModel('stable', ridge=0.0).fit(rise, target)
    with pytest.raises(ValueError, match='initial'):
        GreyModel('stable').fit(rise, target).predict(rise, initial=1.0)
    with pytest.raises(ValueError, match='switches'):
        GreyModel('stable').fit(rise, target, use=[True])
    with pytest.raises(ValueError, match='use: expected a measured sample'):
        GreyModel('stable').fit(rise, target, use=np.zeros(300, bool))


def test_probing_gaps_are_ignored_by_the_stable_form():
    rise, target, runs, weight = dynamic_data()
    sparse = np.where(np.arange(300) % 10 == 0, target, np.nan)
    model = GreyModel('stable', ridge=1e-9).fit(rise, sparse, runs=runs)
    assert model.phi_ == 0.9
    assert np.allclose(model.b_ / model.a_, weight, rtol=1e-3)
