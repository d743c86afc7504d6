# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.estimator import NotFittedError
from fuzzycnc_ros.core.thermal.fit import hybrid
from fuzzycnc_ros.core.thermal.fit.hybrid import Feedback, HybridFilterNetwork
from fuzzycnc_ros.papers.networks import Arma, DynamicNetwork, LinearNetwork, StaticNetwork

ESTIMATORS = [Arma, DynamicNetwork, HybridFilterNetwork, LinearNetwork, StaticNetwork]
RUNS = np.repeat([0, 1], 150)


def machine(seed=0, noise=0.0):
    """Return rises of two runs and a deformation that lags behind them."""
    rng = np.random.default_rng(seed)
    rise, target = [], []
    for load in (1.0, 0.6):
        time = np.arange(150.0)
        warm = load * np.column_stack(
            [
                10.0 - 10.0 * np.exp(-time / 20.0),
                6.0 - 6.0 * np.exp(-time / 60.0),
                2.0 * np.sin(time / 40.0),
            ]
        )
        late = np.vstack([np.zeros((2, 3)), warm[:-2]])
        rise.append(warm)
        target.append(1e-6 * (late @ (1.0, -2.0, 0.5)))
    stacked = np.concatenate(target)
    return np.concatenate(rise), stacked + noise * rng.normal(size=len(stacked))


def make(kind, **settings):
    return kind(**settings) if kind is Arma else kind(**{'hidden': 6, **settings})


@pytest.mark.parametrize('kind', ESTIMATORS)
def test_training_is_reproduced_and_repeatable(kind):
    rise, target = machine(noise=2e-8)
    model = make(kind).fit(rise, target, runs=RUNS)
    again = make(kind).fit(rise, target, runs=RUNS)
    predicted = model.predict(rise, runs=RUNS)
    assert np.sqrt(((predicted - target) ** 2).mean()) <= 0.5e-6
    assert np.array_equal(predicted, again.predict(rise, runs=RUNS))
    assert model.problems_ == ()


@pytest.mark.parametrize('kind', ESTIMATORS)
def test_stream_and_batch_agree_to_the_last_digits(kind):
    rise, target = machine()
    model = make(kind).fit(rise, target, runs=RUNS)
    model.start()
    steps = np.array([model.step(sample) for sample in rise[:150]])
    batch = model.predict(rise[:150])
    assert np.abs(steps - batch).max() <= 1e-12 * np.abs(batch).max()


@pytest.mark.parametrize('kind', ESTIMATORS)
def test_each_run_starts_anew(kind):
    rise, target = machine()
    model = make(kind).fit(rise, target, runs=RUNS)
    together = model.predict(rise, runs=RUNS)
    apart = np.concatenate([model.predict(rise[RUNS == run]) for run in (0, 1)])
    assert np.array_equal(together, apart)


@pytest.mark.parametrize('kind', ESTIMATORS)
def test_what_was_not_measured_does_not_matter(kind):
    """Held-out judging: a run without measurements leaves the fit as if it were not there."""
    rise, target = machine(noise=2e-8)
    held_out = np.where(RUNS == 0, target, np.nan)
    one = make(kind).fit(rise, held_out, runs=RUNS)
    other = make(kind).fit(rise[RUNS == 0], target[RUNS == 0])
    assert np.allclose(one.predict(rise), other.predict(rise), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize('kind', ESTIMATORS)
def test_gaps_in_the_measurement_are_left_out(kind):
    rise, target = machine()
    sparse = np.where(np.arange(300) % 7 == 3, np.nan, target)
    model = make(kind).fit(rise, sparse, runs=RUNS)
    apart = model.predict(rise, runs=RUNS) - target
    assert np.sqrt((apart**2).mean()) <= 0.6e-6


def test_rare_probes_train_a_hybrid_but_no_arma():
    """With every sixth sample there is no measured history: LR stands in for it."""
    rise, target = machine()
    sparse = np.where(np.arange(300) % 6 == 0, target, np.nan)
    model = make(HybridFilterNetwork).fit(rise, sparse, runs=RUNS)
    apart = model.predict(rise, runs=RUNS) - target
    assert np.sqrt((apart**2).mean()) <= 0.6e-6
    with pytest.raises(ValueError, match='probe every sample'):
        Arma().fit(rise, sparse, runs=RUNS)


@pytest.mark.parametrize('kind', ESTIMATORS)
def test_a_sensor_that_stood_still_is_ignored(kind):
    rise, target = machine()
    still = np.column_stack([rise, np.full(300, 0.3)])
    model = make(kind).fit(still, target, runs=RUNS)
    moved = still + np.array([0.0, 0.0, 0.0, 7.0])
    assert np.array_equal(model.predict(still), model.predict(moved))
    if kind is not Arma:
        assert model.idle_.tolist() == [3]


@pytest.mark.parametrize('kind', ESTIMATORS)
def test_too_large_a_deformation_widens_the_range(kind):
    """Above 45 of 50 um the scale of the network is raised, the target is never cut."""
    rise, target = machine()
    model = make(kind).fit(rise, 16.0 * target, runs=RUNS)
    largest = 16.0 * np.abs(target).max()
    assert largest > 50e-6
    predicted = model.predict(rise, runs=RUNS)
    assert np.abs(predicted).max() == pytest.approx(largest, rel=0.05)
    if kind is not Arma:
        assert model.scale_ == pytest.approx(2.0 * largest)
        assert make(kind).fit(rise, target, runs=RUNS).scale_ == 50e-6


@pytest.mark.parametrize('kind', ESTIMATORS)
def test_units_do_not_matter(kind):
    rise, target = machine(noise=2e-8)
    one = make(kind).fit(rise, target, runs=RUNS).predict(rise, runs=RUNS)
    scaled = make(kind, output_range=50.0).fit(rise, 1e6 * target, runs=RUNS)
    assert np.allclose(1e6 * one, scaled.predict(rise, runs=RUNS), rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize('moving_average', ['sum', 'first'])
def test_readings_of_the_moving_average(moving_average):
    rise, target = machine(noise=2e-8)
    model = make(HybridFilterNetwork, moving_average=moving_average).fit(rise, target, runs=RUNS)
    assert len(model.moving_.weight) == {'sum': 9, 'first': 3}[moving_average]
    assert model.network_.inner.shape == (6, 3)
    assert model.recursion_.delay.tolist() == (
        [0, 1] if moving_average == 'first' else [0, 1, 2, 3]
    )
    apart = model.predict(rise, runs=RUNS) - target
    assert np.sqrt((apart**2).mean()) <= 0.5e-6


def test_filters_and_network_are_what_runs():
    """The recursion, written out from the learnt parts, sample by sample."""
    rise, target = machine(noise=2e-8)
    model = make(HybridFilterNetwork, anchored=False, history=2, delays=(1, 4)).fit(
        rise, target, runs=RUNS
    )
    rows = rise[:150]
    predicted = model.predict(rows)
    weights = model.recursion_
    padded = np.vstack([np.zeros((4, 3)), rows])
    own = [0.0, 0.0]
    for n in range(150):
        seen = np.concatenate([padded[n + 4], padded[n + 3], padded[n]])
        hidden = np.tanh(
            weights.inner[0] @ seen + weights.feedback[0] @ (own[-1], own[-2]) + weights.bias[0]
        )
        own.append(model.scale_ * np.tanh(weights.outer[0] @ hidden + weights.offset[0]))
    assert np.allclose(predicted, own[2:], rtol=1e-10)
    # The first input of the network is LR; what it does not explain came through AR alone.
    through_first = np.outer(model.network_.inner[:, 0], model.linear_.weight / model.scale_)
    rest = weights.inner[0][:, :3] - through_first
    assert np.linalg.matrix_rank(rest, tol=1e-10) == 1


def test_anchored_filters_are_zero_at_zero_rise():
    rise, target = machine()
    model = make(HybridFilterNetwork).fit(rise, target, runs=RUNS)
    assert [item.offset for item in (model.linear_, model.moving_)] == [0.0, 0.0]
    free = make(HybridFilterNetwork, anchored=False).fit(rise, target + 3e-6, runs=RUNS)
    assert free.linear_.offset != 0.0


@given(seed=st.integers(0, 100), bound=st.just(0.0) | st.floats(1e-6, 0.95))
@settings(deadline=None, max_examples=40)
def test_bounded_feedback_is_positive_and_below_its_bound(seed, bound):
    rng = np.random.default_rng(seed)
    history, front = rng.normal(size=(60, 3)), rng.normal(size=(60, 2))
    target = history @ rng.normal(size=3) + front @ (1.0, 2.0)
    fitted = Feedback.fitted(history, front, target, 1e-6, True, bound)
    assert (fitted.past >= 0.0).all()
    assert fitted.past.sum() <= bound * (1.0 + 1e-12)
    # The other filters are fitted to what the feedback leaves.
    residual = target - fitted(history, front)
    assert np.abs(front.T @ residual).max() <= 1e-3
    free = Feedback.fitted(history, front, target, 1e-9, True, None)
    assert np.abs(target - free(history, front)).max() <= 1e-4


def test_feedback_within_its_bound_is_left_as_fitted():
    rng = np.random.default_rng(0)
    history, front = rng.normal(size=(60, 1)), rng.normal(size=(60, 2))
    target = 0.4 * history[:, 0] + front @ (1.0, 2.0)
    free = Feedback.fitted(history, front, target, 1e-6, True, None)
    held = Feedback.fitted(history, front, target, 1e-6, True, 0.95)
    assert np.array_equal(free.past, held.past)
    assert np.array_equal(free.front, held.front)


def test_guard_takes_the_feedback_back_and_then_out(monkeypatch):
    rise, target = machine(noise=2e-8)
    free = make(HybridFilterNetwork).fit(rise, target, runs=RUNS)
    assert free.feedback_.sum() > 0.0
    monkeypatch.setattr(hybrid, '_GAIN_MAX', 0.9 * free.loop_gain_)
    held = make(HybridFilterNetwork).fit(rise, target, runs=RUNS)
    assert 0.0 < held.loop_gain_ < 0.9 * free.loop_gain_
    assert held.feedback_.sum() < free.feedback_.sum()
    assert held.problems_ == ()
    assert not held.recursion_off_
    monkeypatch.setattr(hybrid, '_GAIN_MAX', 1e-6)
    off = make(HybridFilterNetwork).fit(rise, target, runs=RUNS)
    assert off.feedback_.sum() == off.loop_gain_ == 0.0
    assert off.recursion_off_
    assert off.problems_ == ()
    apart = off.predict(rise, runs=RUNS) - target
    assert np.sqrt((apart**2).mean()) <= 0.6e-6


def test_a_filter_beyond_the_range_is_flagged():
    rise, target = machine()
    half = np.abs(target) <= 0.5 * np.abs(target).max()
    cool = np.where(half, 44e-6 / np.abs(target[half]).max() * target, np.nan)
    model = make(HybridFilterNetwork).fit(rise, cool, runs=RUNS)
    assert model.scale_ == 50e-6
    assert 'takes up 1.' in model.problems_[0]
    assert make(HybridFilterNetwork, output_range=200e-6).fit(rise, cool).problems_ == ()


def test_seeds_matter_and_generators_are_taken():
    rise, target = machine(noise=5e-8)
    first, second, third = (
        make(HybridFilterNetwork, random_state=seed).fit(rise, target, runs=RUNS).predict(rise)
        for seed in (0, 1, np.random.default_rng(1))
    )
    assert not np.array_equal(first, second)
    assert np.array_equal(second, third)


def test_arma_recovers_its_own_coefficients():
    rise, _ = machine()
    target = np.zeros(300)
    for n in range(300):
        if n % 150 > 0:
            target[n] = 0.5 * target[n - 1] + 2e-6 * rise[n - 1, 0] - 1e-6 * rise[n - 1, 2]
    model = Arma(history=1, delays=(1,), ridge=0.0).fit(rise, target, runs=RUNS)
    assert model.feedback_ == pytest.approx([0.5], abs=1e-6)
    assert model.coef_[0] == pytest.approx([2e-6, 0.0, -1e-6], abs=1e-11)
    assert np.allclose(model.predict(rise, runs=RUNS), target, atol=1e-11)


@pytest.mark.parametrize(
    ('kind', 'settings', 'message'),
    [
        (HybridFilterNetwork, {'moving_average': 'all'}, 'moving_average: expected one of sum'),
        (HybridFilterNetwork, {'solver': 'adam'}, 'solver: expected one of lm, lbfgs'),
        (HybridFilterNetwork, {'hidden': 0}, 'hidden: expected 1'),
        (HybridFilterNetwork, {'history': 0}, 'history: expected 1'),
        (HybridFilterNetwork, {'refits': -1}, 'refits: expected 0'),
        (HybridFilterNetwork, {'feedback_max': 1.0}, r'feedback_max: expected a number in \(0, 1'),
        (HybridFilterNetwork, {'delays': (0, 1)}, 'delays: expected ascending .* from 1'),
        (HybridFilterNetwork, {'delays': (2, 1)}, 'delays: expected ascending'),
        (HybridFilterNetwork, {'delays': ()}, 'delays: expected ascending'),
        (HybridFilterNetwork, {'delays': (1.5,)}, 'delays: expected ascending whole'),
        (HybridFilterNetwork, {'delays': (1, 9999)}, 'delays: expected ascending .* to 1440'),
        (HybridFilterNetwork, {'ridge': -1e-3}, 'ridge: expected 0 or a positive number'),
        (HybridFilterNetwork, {'output_range': 0.0}, 'output_range: expected a positive'),
        (LinearNetwork, {'ridge': np.nan}, 'ridge: expected 0 or a positive number'),
        (StaticNetwork, {'hidden': -3}, 'hidden: expected 1'),
        (DynamicNetwork, {'delays': (-1, 0)}, 'delays: expected ascending .* from 0'),
        (Arma, {'history': 0}, 'history: expected 1'),
        (Arma, {'ridge': np.inf}, 'ridge: expected 0 or a positive number'),
    ],
)
def test_refusals_name_the_parameter(kind, settings, message):
    rise, target = machine()
    with pytest.raises(ValueError, match=message):
        kind(**settings).fit(rise, target, runs=RUNS)


@pytest.mark.parametrize(
    ('kind', 'least'),
    [
        (HybridFilterNetwork, 22),
        (Arma, 28),
        (DynamicNetwork, 19),
        (LinearNetwork, 10),
        (StaticNetwork, 10),
    ],
)
def test_too_few_samples_are_refused(kind, least):
    """3 (K + J) + 10."""
    rise, target = machine()
    with pytest.raises(ValueError, match=f'at least {least} measured samples'):
        make(kind).fit(rise[: least - 1], target[: least - 1])
    few = np.where(np.arange(300) < least - 1, target, np.nan)
    with pytest.raises(ValueError, match=f'at least {least} measured samples'):
        make(kind).fit(rise, few)


def test_no_penalty_with_more_columns_than_samples_is_refused():
    rng = np.random.default_rng(0)
    rise, target = rng.normal(size=(40, 14)), rng.normal(0.0, 1e-6, 40)
    for model in (HybridFilterNetwork(ridge=0.0), Arma(ridge=0.0)):
        with pytest.raises(ValueError, match='take 1e-3'):
            model.fit(rise, target)


@pytest.mark.parametrize('kind', ESTIMATORS)
def test_unfitted_and_other_width_are_refused(kind):
    rise, target = machine()
    with pytest.raises(NotFittedError):
        make(kind).predict(rise)
    model = make(kind).fit(rise, target, runs=RUNS)
    with pytest.raises(ValueError, match='features'):
        model.predict(rise[:, :2])
    with pytest.raises(ValueError, match='together'):
        make(kind).fit(rise, target, runs=np.arange(300) % 2)


def test_only_networks_without_memory_take_another_interval():
    rise, target = machine()
    for kind in (StaticNetwork, LinearNetwork):
        model = make(kind).fit(rise, target, runs=RUNS)
        other = model.with_interval(10.0)
        assert np.array_equal(other.predict(rise), model.predict(rise))
    for kind in (HybridFilterNetwork, DynamicNetwork, Arma):
        with pytest.raises(ValueError, match='train it anew'):
            make(kind).fit(rise, target, runs=RUNS).with_interval(10.0)


def test_networks_work_the_same_without_scikit_learn():
    program = """
import sys
sys.modules['sklearn'] = None
import numpy as np
from fuzzycnc_ros.core.thermal.fit.hybrid import HybridFilterNetwork
from fuzzycnc_ros.papers.networks import Arma
time = np.arange(100.0)
rise = np.column_stack([time / 10.0, np.sin(time / 20.0)])
target = 1e-6 * rise[:, 0]
for model in (Arma(), HybridFilterNetwork(hidden=4)):
    model.fit(rise, target)
    assert np.abs(model.predict(rise) - target).max() < 1e-6
    print(model)
"""
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert 'HybridFilterNetwork(' in done.stdout
