# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Which model a channel gets, when it gets none, and what had no say in that."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.band import better, log_residual, worth_using
from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED, Candidate
from fuzzycnc_ros.core.thermal.fit import evaluate, train_model
from fuzzycnc_ros.core.thermal.fit.candidates import (
    CONTENDERS,
    JudgedCandidate,
    preferred,
    unseen_residual,
)
from fuzzycnc_ros.core.thermal.fit.comparison import judge, splits
from fuzzycnc_ros.core.thermal.fit.training_set import TrainingSet
from fuzzycnc_ros.core.thermal.moments import Fold
from fuzzycnc_ros.core.thermal.recursions.base import LinearRecursion
from fuzzycnc_ros.core.thermal.run import ThermalDataError
from fuzzycnc_ros.simulation.thermal.duties import record_runs

PLAIN = ('static_ridge', 'lag_ridge', 'stable_grey')
TRAINING = ('D0', 'T1', 'D0b', 'T2')


@pytest.fixture(scope='module')
def runs():
    mill = record_runs(seed=3)
    return [mill[name] for name in TRAINING]


def folds_of(number, tests=None):
    tests = tests or [(fold,) for fold in range(number)]
    return [Fold(tuple(set(range(number)) - set(test)), test) for test in tests]


def data_of(folds, samples=4):
    blocks = 1 + max(max(fold.test) for fold in folds)
    count = samples * blocks
    return TrainingSet(
        rise=np.zeros((count, 1)),
        drive=np.zeros((count, 0)),
        displacement=np.ones((count, 2)),
        trained=np.ones(count, dtype=bool),
        label=np.zeros(count, dtype=np.int64),
        rows=[slice(0, count)],
        interval=60.0,
        block=np.repeat(np.arange(blocks), samples),
        folds=folds,
    )


def judged(name, fold_error):
    """Return a candidate that leaves these mean squares in each fold and channel."""
    errors = np.array(fold_error, dtype=float)
    recursion = LinearRecursion(
        np.empty(0), np.empty((0, 1)), np.empty((2, 0)), np.ones((2, 1)), np.zeros(2)
    )
    rms = np.sqrt(errors.mean(axis=0))
    candidate = Candidate(name, ({}, {}), recursion, (), rms, rms)
    residual = [np.tile(np.sqrt(row), (4, 1)) for row in errors]
    return JudgedCandidate(candidate, errors, residual, CONTENDERS.get(name))


def test_the_overall_best_is_kept_unless_a_rival_is_better_beyond_chance():
    best = judged('lag_ridge', [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]])
    lucky = judged('stable_grey', [[0.1, 9.0], [1.6, 9.0], [1.2, 9.0]])
    better_one = judged('stable_grey', [[0.3, 9.0], [0.35, 9.0], [0.3, 9.0]])
    little = judged('stable_grey', [[0.9, 9.0], [0.9, 9.0], [0.9, 9.0]])
    data = data_of(folds_of(3))
    assert preferred([best, lucky], data) == ('lag_ridge', 'lag_ridge')
    assert preferred([best, better_one], data) == ('stable_grey', 'lag_ridge')
    # Better for sure, but by 5 % only: not worth another model.
    assert preferred([best, little], data) == ('lag_ridge', 'lag_ridge')


def test_overlapping_folds_count_once():
    best = judged('lag_ridge', [[1.0, 1.0]] * 12)
    rival = judged('hybrid_network', [[0.1, 0.1], [1.2, 1.2], [0.2, 0.2], [1.1, 1.1]] * 3)
    apart = data_of(folds_of(12))
    overlapping = data_of(folds_of(12, [tuple(range(k, 12, 4)) for k in range(4)] * 3))
    assert preferred([best, rival], apart)[0] == 'hybrid_network'
    assert preferred([best, rival], overlapping)[0] == 'lag_ridge'


@pytest.mark.parametrize('name', ['hybrid_network', 'stable_grey', 'least_squares'])
def test_another_form_than_ridge_must_win_beyond_chance(name):
    data = data_of(folds_of(3))
    usual = judged('lag_ridge', [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]])
    lucky = judged(name, [[0.2, 0.2], [1.1, 1.1], [1.0, 1.0]])
    winner = judged(name, [[0.3, 0.3], [0.35, 0.35], [0.3, 0.3]])
    assert preferred([lucky, usual], data) == ('lag_ridge', 'lag_ridge')
    assert preferred([winner, usual], data) == (name, name)


def test_ridge_has_lags_and_speed_where_that_leaves_less():
    data = data_of(folds_of(3))
    without = judged('lag_ridge', [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]])
    lucky = [[0.2, 0.2], [1.1, 1.1], [1.0, 1.0]]
    with_speed = judged('lag_ridge_speed', lucky)
    assert preferred([without, with_speed], data) == ('lag_ridge_speed', 'lag_ridge_speed')
    # Without lags it is the same form.
    static = judged('static_ridge', [[0.1, 0.1], [1.1, 1.1], [1.0, 1.0]])
    assert preferred([without, with_speed, static], data) == ('static_ridge', 'static_ridge')
    # Where it was not fitted one of the others has to be taken: the best linear one.
    plain = judged('least_squares', [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]])
    grey = judged('stable_grey', lucky)
    network = judged('hybrid_network', [[0.2, 0.2], [1.0, 1.0], [0.9, 0.9]])
    assert preferred([network, plain, grey], data) == ('stable_grey', 'stable_grey')


def test_channels_that_no_fold_measured_have_no_residual():
    residual = log_residual(np.array([[1.0, np.nan], [4.0, np.nan]]))
    assert residual[0] == pytest.approx(0.5 * np.log(2.5))
    assert np.isnan(residual[1])


def test_no_compensation_wins_unless_it_is_beaten():
    data = data_of(folds_of(4))
    none = judged(UNCOMPENSATED, [[1.0, 1.0]] * 4)
    model = judged('lag_ridge', [[0.01, 0.9], [0.04, 1.3], [0.02, 0.8], [0.3, 1.1]])
    assert preferred([none, model], data) == ('lag_ridge', UNCOMPENSATED)
    assert preferred([none], data) == (UNCOMPENSATED, UNCOMPENSATED)
    # How much better a model is on one run must not count against it.
    assert worth_using(np.array([0.5, 0.5, 1e-4]), np.ones(3), 3)
    assert not worth_using(np.array([0.5, 2.0, 1.0]), np.ones(3), 3)
    assert not worth_using(np.array([np.inf, 0.1]), np.ones(2), 2)


def test_the_best_of_many_needs_more_evidence():
    square, other = np.array([[0.45], [0.7], [0.5], [0.65]]), np.ones((4, 1))
    assert better(square, other, 4, rivals=1)
    assert not better(square, other, 4, rivals=50)


def test_what_is_published_had_no_say_in_the_choice():
    data = data_of(folds_of(3))
    one = judged('lag_ridge', [[0.01, 0.01], [4.0, 4.0], [4.0, 4.0]])
    other = judged('stable_grey', [[9.0, 9.0], [1.0, 1.0], [1.0, 1.0]])
    residual = unseen_residual([one, other], data, ('stable_grey', 'stable_grey'))
    # The first fold itself would choose lag_ridge; the two others choose stable_grey for it.
    assert (residual[0] == 3.0).all()


def test_a_displacement_that_temperatures_do_not_tell_stays_uncompensated(runs):
    rng = np.random.default_rng(4)
    blind = []
    for run in runs:
        drift = 10e-6 * np.sin(2.0 * np.pi * run.time / rng.uniform(2000.0, 9000.0))
        moved = np.column_stack([run.displacement[:, 0], drift])
        blind.append(replace(run, displacement=moved))
    model = train_model(blind[:3], candidates=PLAIN)
    assert model.default[0] != UNCOMPENSATED
    assert model.default[1] == UNCOMPENSATED
    assert model.uncompensated == (runs[0].channel[1],)
    assert (model.predict(blind[3])[:, 1] == 0.0).all()
    assert not model.losing
    forced = train_model(blind[:3], model='static_ridge', candidates=PLAIN)
    ((left, none),) = forced.losing.values()
    assert list(forced.losing) == [runs[0].channel[1]]
    assert left >= none
    found = evaluate(model, blind[3])
    assert found.rms['default'][1] == found.rms[UNCOMPENSATED][1]


def test_a_held_out_stretch_may_be_shuffled(runs):
    """Its temperatures, targets and speed change nothing that is fitted, chosen or bounded."""
    run = runs[0]
    rng = np.random.default_rng(0)
    (split,) = splits([run], [(3000.0, 7200.0)])
    inside = np.flatnonzero(run.inside(3000.0, 7200.0))
    order = rng.permutation(inside)
    arrays = {}
    for field in ('temperature', 'displacement', 'spindle_speed'):
        values = getattr(run, field).copy()
        values[inside] = values[order]
        arrays[field] = values
    (shuffled,) = splits([replace(run, **arrays)], [(3000.0, 7200.0)])
    options = {'candidates': PLAIN, 'sensors': 'clusters'}
    first = train_model(split.training, **options)
    second = train_model(shuffled.training, **options)
    assert first.to_json() == second.to_json()


def test_a_held_out_run_may_be_shuffled(runs):
    order = np.random.default_rng(0).permutation(len(runs[1].time))
    mixed = replace(
        runs[1], temperature=runs[1].temperature[order], displacement=runs[1].displacement[order]
    )
    texts = []
    for second in (runs[1], mixed):
        split = splits([runs[0], second, *runs[2:]])[1]
        texts.append(train_model(split.training, candidates=PLAIN).to_json())
    assert texts[0] == texts[1]


def test_a_held_out_stretch_does_not_widen_the_domain(runs):
    """What `compare` calls in domain is what `evaluate` does for a model of the rest."""
    run = runs[0]
    (split,) = splits([run], [(6000.0, float(run.time[-1]))])
    compared = judge(split, candidates=PLAIN).evaluation
    trained = train_model([run.window(stop=5999.0)], candidates=PLAIN)
    alone = evaluate(trained, run, start=6000.0)
    assert compared.in_domain == pytest.approx(alone.in_domain, abs=0.05)


def test_a_copy_of_a_run_is_refused(runs):
    copied = replace(runs[0], name='copy')
    with pytest.raises(ThermalDataError, match=r"'copy'.*'D0'.*100 %.*leave one of them out"):
        train_model([*runs, copied], candidates=PLAIN)
