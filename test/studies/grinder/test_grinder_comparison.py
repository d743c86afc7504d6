# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import json

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.fit import StaticRidge
from fuzzycnc_ros.simulation.thermal.grinder_runs import (
    FLUX_CASES,
    record_flux_case,
    record_grinder,
)
from fuzzycnc_ros.studies.grinder.grinder_comparison import (
    NOISES,
    compare_on_grinder,
    grinder_trials,
)
from fuzzycnc_ros.studies.grinder.grinder_rivals import RIVALS, Rival
from fuzzycnc_ros.studies.thermal.report_data import UNCOMPENSATED
from fuzzycnc_ros.studies.thermal.summary import candidate_label

RIDGE = Rival('ridge', lambda seed: StaticRidge(ridge=1e-2))


class Spy:
    """Learns nothing and predicts what it is told; keeps the arguments of its fits."""

    def __init__(self, predicted=0.0):
        self.predicted, self.fits, self.seeds = predicted, [], []

    def make(self, seed):
        self.seeds.append(seed)
        return self

    def fit(self, rise, target, *, runs):
        self.fits.append((rise, target, runs))
        return self

    def predict(self, rise):
        return np.full(len(rise), self.predicted)


def rival(spy, name='spy'):
    return Rival(name, spy.make)


def refused(seed):
    raise ValueError('lags: expected more samples')


def test_trials_are_the_sheets():
    trials = {trial.name: trial for trial in grinder_trials(3)}
    held = {
        name: (
            [run.name for run in trial.train],
            list(trial.judged),
            {len(run.sensor) for run in (*trial.train, *trial.judged.values())},
        )
        for name, trial in trials.items()
    }
    flux = ['0 %', '2 %', '5 %', '10 %']
    assert held == {
        'one_run': (['E1'], ['E1', 'E2', 'E3'], {38}),
        'one_run_machine_sensors': (['E1'], ['E1', 'E2', 'E3'], {28}),
        'two_runs': (['E1', 'E3'], ['E2'], {38}),
        'varying_flux': (['regular'], flux, {28}),
        'noisy_flux': (['regular'], flux, {28}),
        'constant_flux': (['constant1'], flux, {28}),
    }
    np.testing.assert_array_equal(
        trials['two_runs'].judged['E2'].temperature, record_grinder(['E2'], 3)['E2'].temperature
    )
    for noise, run in zip(NOISES, trials['varying_flux'].judged.values(), strict=True):
        expected = record_flux_case('random', noise, 3)
        np.testing.assert_array_equal(run.temperature, expected.temperature)
    for name, noise in (('varying_flux', 0.0), ('noisy_flux', 0.02)):
        expected = record_flux_case('regular', noise, 3)
        np.testing.assert_array_equal(trials[name].train[0].temperature, expected.temperature)
    assert {trial.train[0].name for trial in trials.values()} - {'E1'} <= set(FLUX_CASES)


def test_models_get_rises_over_the_first_reading_and_the_runs_apart():
    spy, seed = Spy(), 4
    compare_on_grinder(seed=seed, rivals=[rival(spy)], trials=grinder_trials(seed)[2:3])
    first, second = record_grinder(['E1', 'E3'], seed).values()
    assert spy.seeds == [seed, seed]
    for axis, (rise, target, runs) in enumerate(spy.fits):
        np.testing.assert_array_equal(
            rise,
            np.concatenate([run.temperature - run.temperature[0] for run in (first, second)]),
        )
        np.testing.assert_array_equal(
            target, np.concatenate([first.displacement[:, axis], second.displacement[:, axis]])
        )
        np.testing.assert_array_equal(runs, np.repeat([0, 1], [481, 301]))


def test_scores_are_those_of_the_residual():
    result = compare_on_grinder(rivals=[RIDGE, rival(Spy(1e-6))], trials=grinder_trials()[:1])
    runs = record_grinder()
    for name, run in runs.items():
        for axis, displacement in zip('YZ', run.displacement.T, strict=True):
            raw = result.score('one_run', UNCOMPENSATED, f'{name} {axis}')
            assert raw.rms == pytest.approx(np.sqrt(np.mean(displacement**2)))
            assert raw.largest == pytest.approx(np.abs(displacement).max())
            constant = result.score('one_run', 'spy', f'{name} {axis}')
            assert constant.rms == pytest.approx(np.sqrt(np.mean((1e-6 - displacement) ** 2)))
    train, test = runs['E1'], runs['E2']
    model = StaticRidge(ridge=1e-2).fit(
        train.temperature - train.temperature[0], train.displacement[:, 1]
    )
    left = model.predict(test.temperature - test.temperature[0]) - test.displacement[:, 1]
    assert result.score('one_run', 'ridge', 'E2 Z').rms == pytest.approx(np.sqrt(np.mean(left**2)))


@pytest.mark.parametrize('predicted', [np.nan, np.inf])
def test_a_prediction_that_left_the_numbers_is_infinitely_wrong(predicted):
    result = compare_on_grinder(rivals=[rival(Spy(predicted)), RIDGE], trials=grinder_trials()[:1])
    assert result.score('one_run', 'spy', 'E2 Y').rms == np.inf
    document = result.document()['trials']['one_run']['models']
    assert document['spy']['E2 Y'] == {'rms_um': None, 'max_um': None}
    row = next(row for row in result.tables()[0].rows if row[0] == 'Spy')
    assert set(row[1:]) == {'diverged'}


def test_a_model_that_cannot_be_fitted_is_reported_and_the_others_go_on():
    result = compare_on_grinder(
        rivals=[Rival('short', refused), RIDGE], trials=grinder_trials()[:1]
    )
    trial = result.trials[0]
    assert trial.problems == {'short': ('lags: expected more samples',)}
    assert list(trial.scores) == [UNCOMPENSATED, 'ridge']


def test_progress_is_told_and_can_end_the_comparison():
    told, trials = [], grinder_trials()[:2]
    compare_on_grinder(
        rivals=[RIDGE, rival(Spy())], trials=trials, progress=lambda *step: told.append(step)
    )
    assert told == [
        ('one_run', 'ridge', 0, 4),
        ('one_run', 'spy', 1, 4),
        ('one_run_machine_sensors', 'ridge', 2, 4),
        ('one_run_machine_sensors', 'spy', 3, 4),
        ('done', '', 4, 4),
    ]

    def stop(stage, name, done, total):
        if name == 'spy':
            raise KeyboardInterrupt

    spy = Spy()
    with pytest.raises(KeyboardInterrupt):
        compare_on_grinder(rivals=[RIDGE, rival(spy)], trials=trials, progress=stop)
    assert not spy.fits


def test_the_same_seed_gives_the_same_document():
    trials = [
        compare_on_grinder(seed=seed, rivals=[RIDGE], trials=grinder_trials(seed)[2:4]).document()
        for seed in (1, 1, 2)
    ]
    assert json.dumps(trials[0]) == json.dumps(trials[1])
    assert trials[0]['trials'] != trials[2]['trials']
    assert (trials[0]['seed'], list(trials[0]['trials'])) == (1, ['two_runs', 'varying_flux'])
    two_runs = trials[0]['trials']['two_runs']
    assert two_runs['trained_on'] == ['E1', 'E3']
    assert two_runs['sensors'] == 38
    assert list(two_runs['models']['ridge']) == ['E2 Y', 'E2 Z']


def test_table_marks_the_best_on_unseen_runs_only():
    result = compare_on_grinder(rivals=[RIDGE, rival(Spy())], trials=grinder_trials()[:1])
    (table,) = result.tables()
    assert [row[0] for row in table.rows] == ['Uncompensated', 'Ridge', 'Spy']
    assert [column.full_heading for column in table.columns[1:4]] == [
        'training E1 Y',
        'training E1 Z',
        'unseen E2 Y',
    ]
    assert table.strong == {(1, column) for column in (3, 4, 5, 6)}
    assert 'E1, all 38 sensors' in table.title


def test_a_model_with_problems_is_marked_and_never_the_best():
    problem = 'its pole is at the end of the grid'

    def flagged_ridge(seed):
        model = StaticRidge(ridge=1e-3)
        model.problems_ = (problem,)
        return model

    result = compare_on_grinder(
        rivals=[RIDGE, Rival('flagged', flagged_ridge)], trials=grinder_trials()[1:2]
    )
    assert result.trials[0].problems == {'flagged': (problem,)}
    ridge, flagged = (
        result.score('one_run_machine_sensors', name, 'E2 Y') for name in ('ridge', 'flagged')
    )
    assert flagged.rms < ridge.rms
    (table,) = result.tables()
    assert [row[0] for row in table.rows] == ['Uncompensated', 'Ridge', 'Flagged *']
    assert {row for row, _ in table.strong} == {1}


def test_names_of_the_models_are_unique():
    names = [rival.name for rival in RIVALS]
    labels = [rival.label or candidate_label(rival.name) for rival in RIVALS]
    assert len(set(names)) == len(set(labels)) == len(RIVALS)
    assert UNCOMPENSATED not in names
