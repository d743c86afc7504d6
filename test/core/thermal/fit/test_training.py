# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Selection, training and evaluation on a small machine with three heated parts."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.candidate import STANDARD
from fuzzycnc_ros.core.thermal.fit import (
    GreyModel,
    evaluate,
    select_sensors,
    sensor_count_curve,
    train_model,
)
from fuzzycnc_ros.core.thermal.fit.candidates import (
    DIVERGED,
)
from fuzzycnc_ros.core.thermal.fit.folds import (
    selection_folds,
    training_folds,
)
from fuzzycnc_ros.core.thermal.fit.refinement import REFINE_SWEEPS
from fuzzycnc_ros.core.thermal.model import ModelMismatchError
from fuzzycnc_ros.core.thermal.ranking import grey_relational_grade
from fuzzycnc_ros.core.thermal.recursions.base import first_order_lags
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun
from fuzzycnc_ros.core.thermal.sensor_watch import SensorWatch
from fuzzycnc_ros.papers.thermal import ALL_CONTENDERS

PARTS = (300.0, 1800.0, 14400.0)
SENSORS = (*(f'{part}{number}' for part in 'ABC' for number in range(4)), 'cold')


def machine_run(name, seed, samples=150, interval=60.0, probing=1):
    """Return a run of a machine whose three parts warm up at different speeds."""
    rng = np.random.default_rng(seed)
    heat = np.repeat(rng.choice([0.0, 0.5, 1.0, 1.5], samples // 15 + 1), 15)[:samples]
    pole = np.exp(-interval / np.array(PARTS))
    parts = first_order_lags(pole, (1.0 - pole) * heat[:, np.newaxis] * [12.0, 8.0, 40.0])
    gains = np.repeat([[1.0, 0.95, 0.9, 0.85]], 3, axis=0).ravel()
    rise = np.repeat(parts, 4, axis=1) * gains
    displacement = np.column_stack([parts @ [1e-6, 0.5e-6, 2e-6], parts @ [0.2e-6, 1e-6, -1e-6]])
    displacement += 0.1e-6 * rng.normal(size=displacement.shape)
    displacement[np.arange(samples) % probing != 0] = np.nan
    return ThermalRun(
        name=name,
        time=interval * np.arange(samples),
        sensor=SENSORS,
        temperature=np.column_stack(
            [20.0 + rise + 0.05 * rng.normal(size=rise.shape), np.full(samples, 20.0)]
        ),
        channel=('Y', 'Z'),
        axis=('Y', 'Z'),
        displacement=displacement,
    )


@pytest.fixture(scope='module')
def runs():
    return [machine_run(name, seed) for seed, name in enumerate(('a', 'b', 'c'))]


@pytest.fixture(scope='module')
def unseen():
    return machine_run('unseen', 9)


def test_clusters_are_the_machine_s_parts(runs):
    selection = select_sensors(runs, n_clusters=3)
    groups = sorted({''.join(sorted({n[0] for n in c.member})) for c in selection.clusters})
    assert groups == ['A', 'B', 'C']
    assert selection.dropped == ('cold',)
    assert selection.calibration == ('a', 'b', 'c')
    for cluster in selection.clusters:
        assert cluster.chosen in cluster.member
        assert list(cluster.score) == sorted(cluster.score, reverse=True)
        assert set(cluster.substitute) == set(cluster.member) - {cluster.chosen}
        assert list(cluster.correlation) == sorted(cluster.correlation, reverse=True)


def test_gains_turn_a_mate_into_the_chosen_sensor(runs):
    for cluster in select_sensors(runs, n_clusters=3).clusters:
        for mate, gain in zip(cluster.substitute, cluster.gain, strict=True):
            rise = np.concatenate([run.rise() for run in runs])
            own = rise[:, SENSORS.index(cluster.chosen)]
            other = rise[:, SENSORS.index(mate)]
            assert np.sqrt(np.mean((own - gain * other) ** 2)) < 0.2
            assert gain == pytest.approx(other @ own / (other @ other))


@pytest.mark.parametrize('method', ['correlation', 'grey_grade'])
def test_sensor_order_does_not_matter(runs, method):
    order = np.random.default_rng(0).permutation(len(SENSORS))
    shuffled = [
        ThermalRun(
            run.name,
            run.time,
            [SENSORS[i] for i in order],
            run.temperature[:, order],
            run.channel,
            run.axis,
            run.displacement,
        )
        for run in runs
    ]
    one = select_sensors(runs, n_clusters=3, method=method)
    other = select_sensors(shuffled, n_clusters=3, method=method)
    assert {frozenset(c.member) for c in one.clusters} == {
        frozenset(c.member) for c in other.clusters
    }
    assert set(one.chosen) == set(other.chosen)


def test_refinement_never_raises_the_held_out_error(runs):
    def held_out(selection):
        total = 0.0
        for left_out in runs:
            rest = [run for run in runs if run is not left_out]
            rise = np.concatenate([r.rise()[:, r.columns(selection.chosen)] for r in rest])
            label = np.repeat(np.arange(len(rest)), [len(r.time) for r in rest])
            for channel in range(2):
                y = np.concatenate([r.displacement[:, channel] for r in rest])
                model = GreyModel('stable').fit(rise, y, runs=label)
                unseen = left_out.rise()[:, left_out.columns(selection.chosen)]
                residual = left_out.displacement[:, channel] - model.predict(unseen)
                total += float(np.mean(residual**2))
        return total

    plain = held_out(select_sensors(runs, n_clusters=4, refine=False))
    assert held_out(select_sensors(runs, n_clusters=4)) <= plain * (1.0 + 1e-9)


def test_grey_grade_prefers_the_same_shape():
    time = np.linspace(0.0, 1.0, 50)
    series = np.column_stack([time, -time, time**3, np.sin(12.0 * time)])
    grade = grey_relational_grade(series, 5.0 * time + 2.0)
    assert grade[0] == grade[1] == pytest.approx(1.0)
    assert 1.0 > grade[2] > grade[3] > 0.0


def test_selection_refusals(runs):
    with pytest.raises(ValueError, match='method: expected one of'):
        select_sensors(runs, method='best')
    with pytest.raises(ThermalDataError, match=r'n_clusters: expected 1 to 12 .* found 13'):
        select_sensors(runs, n_clusters=13)
    with pytest.raises(ValueError, match='m: expected a fuzzifier above 1'):
        select_sensors(runs, m=1.0)


def test_count_curve_falls_where_sensors_help(runs, unseen):
    told = []
    curve = sensor_count_curve(
        runs, unseen, counts=(1, 3), progress=lambda *args: told.append(args)
    )
    assert [point.count for point in curve] == [1, 3]
    assert [len(point.chosen) for point in curve] == [1, 3]
    assert (curve[1].rms < 0.6 * curve[0].rms).all()
    assert (curve[0].largest >= curve[0].rms).all()
    assert told == [('sensor_count', '1', 1, 2), ('sensor_count', '3', 2, 2)]


def test_folds_never_judge_on_what_they_trained(runs):
    for cut in (selection_folds, training_folds):
        for group in (runs, runs[:1]):
            block, folds = cut(group)
            assert len(block) == sum(len(run.time) for run in group)
            for fold in folds:
                assert not set(fold.train) & set(fold.test)
    _, forward = selection_folds(runs[:1])
    assert all(max(fold.train) < min(fold.test) for fold in forward)
    block, folds = training_folds(runs)
    assert [fold.test for fold in folds] == [(0,), (1,), (2,)]


def test_training_beats_the_uncompensated_machine_on_an_unseen_run(runs, unseen):
    model = train_model(runs, n_clusters=3, sensors='clusters')
    result = evaluate(model, unseen)
    fitted = {name for name in STANDARD if not name.endswith('_speed')}
    assert set(result.rms) == {'uncompensated', 'default', *fitted}
    assert (result.rms['default'] < 0.1 * result.rms['uncompensated']).all()
    assert (result.rms['default'] <= result.largest['default']).all()
    assert model.inputs == model.selection.chosen
    assert model.runs == ('a', 'b', 'c')
    # Residuals of unseen samples stay near what held-out runs promised.
    assert (result.rms['default'] < 3.0 * model.band.deviation).all()


def test_few_sensors_are_all_used(runs):
    model = train_model(runs)
    assert model.selection.method == 'all'
    assert model.inputs == SENSORS[:-1]
    assert all(len(cluster.substitute) <= 4 for cluster in model.selection.clusters)


def test_a_single_run_suffices(runs, unseen):
    model = train_model(runs[:1], n_clusters=3, sensors='clusters')
    result = evaluate(model, unseen)
    assert (result.rms['default'] < 0.3 * result.rms['uncompensated']).all()


def test_states_warm_up_before_the_judged_window(runs):
    model = train_model(runs, n_clusters=3, sensors='clusters')
    whole = evaluate(model, runs[0])
    late = evaluate(model, runs[0], start=3000.0, stop=6000.0)
    assert late.samples == (51, 51)
    rise = model.rises(runs[0])
    inside = runs[0].inside(3000.0, 6000.0)
    residual = (model.predict(rise) - runs[0].displacement)[inside]
    assert np.allclose(late.rms['default'], np.sqrt((residual**2).mean(axis=0)))
    assert (late.largest['default'] <= whole.largest['default']).all()


def test_faster_runs_are_averaged(runs):
    fast = [machine_run(run.name, seed, 600, 15.0) for seed, run in enumerate(runs)]
    model = train_model(fast, n_clusters=3, sensors='clusters')
    assert model.interval == pytest.approx(60.0)
    assert evaluate(model, fast[0]).samples == (150, 150)


@pytest.mark.slow
def test_slower_runs_are_trained_at_their_interval_and_refused_at_a_shorter_one():
    slow = [machine_run('slow', 0, interval=600.0)]
    assert train_model(slow).interval == pytest.approx(600.0)
    with pytest.raises(ThermalDataError, match=r'every 60 s.*one every 600 s.*interval of 600 s'):
        train_model(slow, interval=60.0)


def test_sparse_probing_trains_all_but_the_forms_that_accumulate():
    runs = [machine_run(name, seed, 300, probing=10) for seed, name in enumerate('abc')]
    model = train_model(runs, n_clusters=3, sensors='clusters')
    assert 'use the stable form' in model.omitted['classical_grey']
    assert {'stable_grey', 'lag_ridge'} <= set(model.candidates)
    result = evaluate(model, machine_run('unseen', 9, 300, probing=10))
    assert (result.rms['default'] < 0.1 * result.rms['uncompensated']).all()
    with pytest.raises(ThermalDataError, match="'classical_grey': y: expected a value in every"):
        train_model(runs, model='classical_grey', sensors='clusters', n_clusters=3)
    with pytest.raises(ValueError, match=r'classical_grey.*left out'):
        model.start('classical_grey')


def hidden(run, channel):
    """Return a run in which a channel was not measured."""
    displacement = run.displacement.copy()
    displacement[:, channel] = np.nan
    return replace(run, displacement=displacement)


@pytest.mark.parametrize('sensors', ['all', 'clusters'])
def test_channels_may_be_measured_in_different_runs(runs, unseen, sensors):
    four = [*runs, machine_run('d', 3)]
    names = ('static_ridge', 'lag_ridge', 'stable_grey')
    options = {'sensors': sensors, 'n_clusters': 3, 'candidates': names}
    whole = evaluate(train_model(four, **options), unseen).rms
    parts = [hidden(run, number % 2) for number, run in enumerate(four)]
    model = train_model(parts, **options)
    found = evaluate(model, unseen).rms
    assert (found['lag_ridge'] < 1.5 * whole['lag_ridge']).all()
    for name in names:
        assert np.isfinite(model.candidates[name].held_out_rms).all()
    judged = evaluate(model, hidden(unseen, 0))
    assert judged.samples == (0, 150)
    assert np.isnan(judged.rms['default'][0])
    (point,) = sensor_count_curve(parts, hidden(unseen, 1), counts=(2,))
    assert np.isfinite(point.rms).tolist() == [True, False]


def test_a_channel_must_be_measured_where_it_is_judged_too(runs):
    once = [runs[0], *(hidden(run, 1) for run in runs[1:])]
    with pytest.raises(ThermalDataError, match=r'channel Z: .* but found 150 in all; probe more'):
        train_model(once, candidates=('static_ridge',))


def test_samples_count_where_something_was_measured(runs):
    model = train_model(runs, candidates=('static_ridge',))
    row = np.arange(150)
    displacement = runs[0].displacement.copy()
    displacement[row % 3 != 0, 0] = np.nan
    displacement[row % 3 != 1, 1] = np.nan
    result = evaluate(model, replace(runs[0], displacement=displacement), stop=60.0 * 89)
    assert result.samples == (30, 30)


def test_a_named_model_is_used_for_every_channel(runs):
    for name in ('lag_ridge', 'stable_grey', 'static_ridge', 'least_squares'):
        assert train_model(runs, model=name, candidates=()).default == (name, name)
    with pytest.raises(ValueError, match=r"model: expected auto or one of .* found 'best'"):
        train_model(runs, model='best')
    with pytest.raises(ValueError, match=r"candidates: expected some of .* found 'best'"):
        train_model(runs, candidates=('lag_ridge', 'best'))
    with pytest.raises(ValueError, match='sensors: expected auto, clusters or all'):
        train_model(runs, sensors='some')


def test_an_unstable_model_is_flagged_and_refused():
    time = 60.0 * np.arange(60)
    growing = ThermalRun(
        'growing',
        time,
        ('T',),
        20.0 + np.minimum(time, 600.0)[:, np.newaxis] / 600.0,
        ('Y',),
        ('Y',),
        1e-6 * np.exp(time / 900.0)[:, np.newaxis],
    )
    model = train_model([growing], sensors='all', candidates=('static_ridge', 'classical_grey'))
    assert 'not positive' in model.candidates['classical_grey'].problems[0]
    assert 'classical_grey' not in model.default
    # A single sensor has no mates: it lies at no distance from them, and is judged by nobody.
    assert model.watch.leverage.tolist() == [0.0]
    watch = SensorWatch(model.watch)
    for _ in range(100):
        assert not watch.update([50.0], 60.0).any()
    with pytest.raises(ThermalDataError, match=r"'classical_grey' is refused: a = -"):
        train_model([growing], model='classical_grey', sensors='all', candidates=())
    with pytest.raises(ThermalDataError, match='expected a candidate that can be chosen'):
        train_model([growing], sensors='all', candidates=('classical_grey',))


def test_progress_is_told_to_the_end(runs):
    told = []
    train_model(runs, n_clusters=3, sensors='clusters', progress=lambda *step: told.append(step))
    selecting = [step for step in told if step[0] == 'select_sensors']
    fitting = [step for step in told if step[0] == 'fit']
    assert selecting[-1][2] == selecting[-1][3] == REFINE_SWEEPS * 12
    names = list(dict.fromkeys(step[1] for step in fitting))
    assert names == [name for name in STANDARD if not name.endswith('_speed')]
    # Every single fit is told, so that a training can be cancelled soon.
    assert sum(step[1] == 'hybrid_network' for step in fitting) >= 2 * (len(runs) + 1)
    assert [step[2] for step in fitting] == sorted(step[2] for step in fitting)
    assert fitting[-1][2] == fitting[-1][3] == len(STANDARD)


def test_cancelling_comes_through_and_changes_nothing(runs):
    class CancelledError(Exception):
        pass

    def cancel(stage, candidate, done, total):
        if stage == 'fit':
            raise CancelledError

    before = [run.temperature.copy() for run in runs]
    with pytest.raises(CancelledError):
        train_model(runs, progress=cancel)
    assert all(np.array_equal(b, run.temperature) for b, run in zip(before, runs, strict=True))


def test_training_is_reproducible(runs):
    one = train_model(runs, n_clusters=3, sensors='clusters')
    other = train_model(runs, n_clusters=3, sensors='clusters')
    assert one.to_json() == other.to_json()


def test_evaluation_refusals(runs, unseen):
    model = train_model(runs, n_clusters=3, sensors='clusters')
    with pytest.raises(ThermalDataError, match='measured displacements in the window'):
        evaluate(model, unseen, start=1e6)
    other = ThermalRun(
        'other',
        unseen.time,
        [f'other {name}' if name == model.inputs[0] else name for name in SENSORS],
        unseen.temperature,
        ('Y', 'Z'),
        ('Y', 'Z'),
        unseen.displacement,
    )
    with pytest.raises(ModelMismatchError, match=f'no {model.inputs[0]}'):
        evaluate(model, other)
    renamed = ThermalRun(
        'renamed',
        unseen.time,
        SENSORS,
        unseen.temperature,
        ('Y', 'X'),
        ('Y', 'X'),
        unseen.displacement,
    )
    with pytest.raises(ThermalDataError, match='expected the channels Y, Z'):
        evaluate(model, renamed)


def test_a_model_that_does_not_hold_where_it_was_not_fitted_is_refused(runs):
    model = train_model(
        runs,
        candidates=('lag_ridge', 'arma'),
        contenders=ALL_CONTENDERS,
        sensors='clusters',
        n_clusters=3,
    )
    for name, item in model.candidates.items():
        bare = max(float(np.abs(run.displacement).max()) for run in runs)
        diverged = not (item.held_out_max < DIVERGED * bare).all()
        assert diverged == any('on held-out samples' in text for text in item.problems), name
