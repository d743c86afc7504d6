# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Watch over slow sensor faults: what is learnt, what is found, what is never held against one."""

import json
from dataclasses import replace

import numpy as np
import pytest
from benches.watch_rig import SENSORS, STEP, recordings, rises
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.document import Node
from fuzzycnc_ros.core.thermal.fit.selection import all_sensors
from fuzzycnc_ros.core.thermal.fit.training import learn_watch
from fuzzycnc_ros.core.thermal.sensor_watch import (
    PERSISTENCE,
    RETURN_TIME,
    Leverage,
    MateEstimate,
    SensorWatch,
    SensorWatchModel,
    agreed,
    mate_weights,
    moment_of,
    unexplained,
    voter_weights,
)


@pytest.fixture(scope='module')
def runs():
    return recordings()


@pytest.fixture(scope='module')
def model(runs):
    return learn_watch(runs, all_sensors(runs), STEP)


def play(watch, rise, step=STEP):
    """Return which inputs were declared faulty at each sample, shape (n, p)."""
    declared = []
    for sample in rise:
        watch.update(sample, step)
        declared.append(watch.faulty)
    return np.array(declared)


# What mates say


def test_weights_solve_the_ridge_problem():
    """Residual of the normal equations, in scaled rises."""
    rise = rises()
    moment = moment_of(rise) / len(rise)
    mates = np.array([1, 4, 6])
    weights = mate_weights(moment, 0, mates)
    scale = np.sqrt((rise[:, mates] ** 2).mean(axis=0))
    columns = rise[:, mates] / scale
    theta = weights * scale
    slope = columns.T @ (rise[:, 0] - columns @ theta) / len(rise)
    np.testing.assert_allclose(slope, 1e-4 * theta, rtol=1e-9)
    missed = np.sqrt(((rise[:, 0] - rise[:, mates] @ weights) ** 2).mean())
    assert unexplained(moment, 0, mates, weights) == pytest.approx(missed, rel=1e-9)


def test_voters_share_no_sensor_and_never_read_the_target():
    rise = rises()
    moment = moment_of(rise) / len(rise)
    targets = np.array([2, 5])
    weights = voter_weights(moment, targets, np.arange(8))
    assert weights.shape == (2, 2, 8)
    assert not ((weights[0] != 0.0) & (weights[1] != 0.0)).any()
    assert (weights[:, [0, 1], targets] == 0.0).all()
    assert ((weights != 0.0).any(axis=0).sum(axis=1) == 7).all()
    few = voter_weights(moment, targets, np.array([2, 3]))
    assert np.isnan(few[:, 0]).all()
    assert np.isfinite(voter_weights(moment, targets, np.array([0, 1]))).all()


@given(
    st.lists(st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)), min_size=1, max_size=5).map(
        np.array
    )
)
def test_voters_agree_on_the_smaller_miss_of_the_same_side(pairs):
    found = agreed(pairs.T)
    for (one, other), value in zip(pairs, found, strict=True):
        same = np.sign(one) == np.sign(other) != 0.0
        assert value == (np.sign(one) * min(abs(one), abs(other)) if same else 0.0)
    assert np.array_equal(agreed(-pairs.T), -found)


def test_leverage_does_not_see_the_target_itself():
    """It equals the distance of the other sensors alone."""
    rise = rises()
    moment = moment_of(rise) / len(rise)
    whole = Leverage(moment, np.arange(8), np.arange(8))
    sample = rise[50]
    for target in range(8):
        others = np.delete(np.arange(8), target)
        alone = Leverage(moment, np.array([target]), others).of(sample * (np.arange(8) != target))
        moved = sample + 5.0 * (np.arange(8) == target)
        assert whole.of(sample)[target] == pytest.approx(float(alone[0]), rel=1e-9)
        assert whole.of(moved)[target] == pytest.approx(float(alone[0]), rel=1e-9)


# What is learnt


def test_learning_keeps_the_document_and_the_numbers(runs, model):
    text = json.dumps(model.document(), allow_nan=False)
    again = SensorWatchModel.read(Node(json.loads(text), 'watch'))
    assert (again.sensor, again.input) == (model.sensor, model.input)
    for name in ('moment', 'missed', 'leverage'):
        assert np.array_equal(getattr(again, name), getattr(model, name))
    assert json.dumps(learn_watch(runs, all_sensors(runs), STEP).document()) == text


def test_what_is_missed_was_held_out(runs, model):
    """A sensor that follows the others in two runs only is known badly."""
    assert (model.missed < 0.3).all()
    odd = runs[2].temperature.copy()
    odd[:, 3] += 2.0 * np.sin(runs[2].time / 3000.0)
    changed = [*runs[:2], replace(runs[2], temperature=odd)]
    learnt = learn_watch(changed, all_sensors(changed), STEP)
    assert learnt.missed[3] > 1.0
    assert learnt.missed[3] == learnt.missed.max()


def test_sensors_that_never_warm_are_no_mates(runs):
    cold = [
        replace(run, temperature=np.where(np.arange(8) == 6, 20.0, run.temperature))
        for run in runs
    ]
    model = learn_watch(cold, all_sensors(cold), STEP)
    assert 's6' not in model.sensor
    assert len(model.sensor) == len(model.input) == 7


def test_a_single_run_is_held_out_in_stretches(runs):
    model = learn_watch(runs[:1], all_sensors(runs[:1]), STEP)
    assert (model.missed > 0.0).all()
    assert not play(SensorWatch(model), rises(seed=8)).any()


# What is found


def test_healthy_sensors_are_trusted(model):
    for seed in range(5):
        rise = rises(seed=10 + seed, phase=0.3 * seed)
        assert not play(SensorWatch(model), rise).any()


@pytest.mark.parametrize('number', range(8))
def test_a_jump_is_found_in_the_second_sample_and_no_other_sensor_suffers(model, number):
    rise = rises(seed=20)
    rise[100:, number] -= 5.0
    faulty = play(SensorWatch(model), rise)
    assert faulty[:, number].argmax() == 101
    assert np.flatnonzero(faulty.any(axis=0)).tolist() == [number]


@pytest.mark.parametrize('rate', [2.0, -2.0])
def test_a_drift_is_found_and_no_other_sensor_suffers(model, rate):
    for number in range(8):
        rise = rises(seed=21)
        rise[60:, number] += rate * np.arange(140) / 60.0
        faulty = play(SensorWatch(model), rise)
        assert 60 < faulty[:, number].argmax() <= 100
        assert np.flatnonzero(faulty.any(axis=0)).tolist() == [number]


def test_a_spike_of_one_sample_is_forgiven(model):
    rise = rises(seed=22)
    rise[100, 2] += 50.0
    assert not play(SensorWatch(model), rise).any()


def test_a_spike_is_not_used_though_nothing_is_declared(model):
    rise = rises(seed=22)
    rise[100, 2] += 50.0
    watch = SensorWatch(model)
    unused = np.array([watch.update(sample, STEP).copy() for sample in rise])
    assert unused[100].tolist() == [column == 2 for column in range(unused.shape[1])]
    assert not unused[:100].any()
    assert not unused[101:].any()
    assert not watch.faulty.any()


def test_a_mate_that_nobody_watches_cannot_vote_a_healthy_sensor_out(runs, model):
    """It speaks in one group, the other one contradicts it."""
    some = SensorWatchModel(
        model.sensor, model.input[:3], model.moment, model.missed[:3], model.leverage[:3]
    )
    for mate in range(3, 8):
        rise = rises(seed=23)
        rise[50:, mate] += 6.0
        assert not play(SensorWatch(some), rise).any()


def test_two_faults_one_after_the_other_are_both_found(model):
    rise = rises(seed=24)
    rise[60:, 1] += 4.0
    rise[90:, 6] -= 4.0
    faulty = play(SensorWatch(model), rise)
    assert faulty[:, 1].argmax() < 70
    assert 90 <= faulty[:, 6].argmax() < 100
    assert np.flatnonzero(faulty.any(axis=0)).tolist() == [1, 6]


def test_never_more_than_half_of_the_inputs_are_voted_out(model):
    """If all sensors part, the machine has changed."""
    rise = rises(seed=25)
    rise[60:] += 6.0 * np.random.default_rng(0).choice([-1.0, 1.0], 8)
    faulty = play(SensorWatch(model), rise)
    assert 1 <= faulty.sum(axis=1).max() <= 4


def test_the_only_input_of_a_model_may_be_voted_out(model):
    alone = SensorWatchModel(
        model.sensor, model.input[:1], model.moment, model.missed[:1], model.leverage[:1]
    )
    rise = rises(seed=24)
    rise[60:, 0] += 4.0
    assert 60 <= play(SensorWatch(alone), rise)[:, 0].argmax() < 70


def test_a_sensor_returns_when_its_mates_agree_for_long(model):
    rise = rises(seed=26, samples=400)
    rise[60:120, 4] += 5.0
    faulty = play(SensorWatch(model), rise)[:, 4]
    assert faulty[61:119].all()
    back = 120 + (~faulty[120:]).argmax()
    assert RETURN_TIME / STEP - 1 <= back - 120 <= RETURN_TIME / STEP + 10
    assert not faulty[back:].any()


def test_persistence_of_zero_switches_the_watch_off(model):
    rise = rises(seed=27)
    rise[60:, 4] += 50.0
    assert not play(SensorWatch(model, persistence=0.0), rise).any()


def test_limits_follow_what_was_asked_for_and_what_was_learnt(model):
    known = replace(model, missed=np.linspace(0.0, 0.7, 8))
    np.testing.assert_allclose(
        SensorWatch(known, limit=0.4, tolerance=2.0).limit,
        np.maximum(0.4, 2.0 * known.missed),
    )
    rise = rises(seed=28)
    rise[60:, 4] += 2.0
    assert play(SensorWatch(model, limit=0.5), rise)[:, 4].any()
    assert not play(SensorWatch(model, limit=3.0), rise).any()


def test_far_from_the_training_more_is_allowed(model):
    """The same difference is a fault near the training and none at ten times its rises."""
    near, far = rises(seed=29), 10.0 * rises(seed=29, noise=0.0)
    for rise in (near, far):
        rise[100:, 5] += 2.0
    assert play(SensorWatch(model), near)[:, 5].any()
    assert not play(SensorWatch(model), far).any()


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_readings_that_are_missing_do_no_harm(seed):
    """Whatever is NaN, the watch stays finite and finds nothing in healthy sensors."""
    rng = np.random.default_rng(seed)
    rise = rises(seed=30)
    moment = moment_of(rise) / len(rise)
    model = SensorWatchModel(SENSORS, SENSORS[:4], moment, np.full(4, 0.2), np.full(4, 20.0))
    watch = SensorWatch(model)
    gone = rng.random(rise.shape) < rng.uniform(0.0, 1.0)
    gone[rng.integers(0, 150) :, rng.integers(0, 8)] = True
    assert not play(watch, np.where(gone, np.nan, rise)).any()
    assert np.isfinite(watch.state).all()


def test_a_fault_is_found_with_some_mates_missing(model):
    rise = rises(seed=31)
    rise[:, [0, 3]] = np.nan
    rise[60:, 4] += 5.0
    assert play(SensorWatch(model), rise)[:, 4].argmax() == 61


@pytest.mark.parametrize('sensors', [1, 2])
def test_too_few_sensors_judge_nobody(sensors):
    """Of two that differ nobody knows which is right."""
    model = SensorWatchModel(
        SENSORS[:sensors],
        SENSORS[:sensors],
        np.full((sensors, sensors), 4.0),
        np.zeros(sensors),
        np.ones(sensors),
    )
    rise = np.full((50, sensors), 2.0)
    rise[10:, 0] += 20.0
    watch = SensorWatch(model)
    assert not play(watch, rise).any()
    assert np.isfinite(watch.state).all()


def test_the_state_carries_on(model):
    rise = rises(seed=32)
    rise[60:, 4] += 2.0 * np.arange(140) / 60.0
    whole = SensorWatch(model)
    wanted = play(whole, rise)
    cut = int(wanted[:, 4].argmax()) - 3
    first, second = SensorWatch(model), SensorWatch(model)
    play(first, rise[:cut])
    assert 0.0 < first.state.max() < PERSISTENCE
    second.state = first.state
    assert np.array_equal(play(second, rise[cut:]), wanted[cut:])
    assert np.array_equal(second.state, whole.state)


def test_the_order_of_the_sensors_does_not_matter(runs):
    order = np.random.default_rng(5).permutation(8)
    turned = [
        replace(
            run,
            sensor=[run.sensor[column] for column in order],
            temperature=run.temperature[:, order],
        )
        for run in runs
    ]
    one, other = (learn_watch(some, all_sensors(some), STEP) for some in (runs, turned))
    rise = rises(seed=33)
    rise[60:, 4] += 2.0 * np.arange(140) / 60.0
    found = play(SensorWatch(one), rise)
    assert found.any()
    assert np.array_equal(play(SensorWatch(other), rise[:, order]), found[:, order])


# What stands in


def test_an_estimate_reads_all_that_can_be_read(model):
    rise = rises(seed=34, noise=0.0)[150]
    estimate = MateEstimate(model)
    for number in range(8):
        alone = np.where(np.arange(8) == number, np.nan, rise)
        found = estimate.of(number, alone)
        assert found.rise == pytest.approx(rise[number], abs=0.15)
        assert 0.0 < found.missed < 0.2
        assert found.mate in set(SENSORS) - {SENSORS[number]}
        fewer = np.where(np.isin(np.arange(8), [number, SENSORS.index(found.mate)]), np.nan, rise)
        again = estimate.of(number, fewer)
        assert again.mate not in ('', found.mate)
        assert again.missed >= found.missed
        assert estimate.of(number, rise + 9.0 * (np.arange(8) == number)).rise == pytest.approx(
            found.rise
        )


def test_without_mates_there_is_no_estimate(model):
    found = MateEstimate(model).of(0, np.full(8, np.nan))
    assert np.isnan(found.rise)
    assert found.missed == np.inf
    assert found.mate == ''
