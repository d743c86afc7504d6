# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.fit import evaluate, train_model
from fuzzycnc_ros.core.thermal.fit.comparison import Comparison, HeldOut, judge, splits
from fuzzycnc_ros.core.thermal.fit.folds import thermal_cycles, training_folds
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.recursions.base import Stream, first_order_lags
from fuzzycnc_ros.core.thermal.run import (
    SPINDLE_SPEED,
    ThermalDataError,
    ThermalRun,
    drivers_of,
    speed_drive,
)
from fuzzycnc_ros.simulation.thermal.duties import record_runs

RPM = 2.0 * np.pi / 60.0
PLAIN = ('static_ridge', 'lag_ridge', 'lag_ridge_speed')


def machine(name, seed, speeds, *, samples=100, speed=True):
    """A machine whose drift follows a sensor and, unseen by it, the square of the speed."""
    rng = np.random.default_rng(seed)
    rpm = np.repeat(np.column_stack([speeds, np.zeros(len(speeds))]).ravel(), samples)
    time = 60.0 * np.arange(len(rpm))
    heat = (rpm / 1000.0) ** 2
    pole = np.exp(-60.0 / np.array([1200.0, 3600.0]))
    lagged = first_order_lags(pole, (1.0 - pole) * heat[:, np.newaxis])
    room = np.sin(2.0 * np.pi * time / 86400.0 + seed)
    temperature = np.column_stack(
        [20 + 2 * lagged[:, 0] + room, 20 + lagged[:, 1] - room, 20 + room]
    )
    error = 1e-6 * (2.0 * lagged[:, 0] + 3.0 * lagged[:, 1] + 0.5 * heat + 2.0 * (room - room[0]))
    return ThermalRun(
        name,
        time,
        ('head', 'column', 'room'),
        temperature + rng.normal(0.0, 0.05, temperature.shape),
        ('Y',),
        ('Y',),
        (error + rng.normal(0.0, 0.1e-6, len(error)))[:, np.newaxis],
        rpm * RPM if speed else None,
    )


@pytest.fixture(scope='module')
def runs():
    return [machine(name, n, [1000 + 500 * n, 2000]) for n, name in enumerate('abc')]


def test_the_driver_is_the_squared_speed_in_thousand_rpm():
    assert speed_drive(np.array([0.0, -1000.0 * RPM, 3000.0 * RPM])).tolist() == pytest.approx(
        [0.0, 1.0, 9.0]
    )


def test_a_driver_needs_a_speed_that_is_known_and_changes(runs):
    assert drivers_of(runs) == (SPINDLE_SPEED,)
    gap = runs[0].spindle_speed.copy()
    gap[5] = np.nan
    for other in (None, gap, np.full(len(gap), 100.0)):
        one = replace(runs[0], spindle_speed=other)
        assert drivers_of([one]) == ()
        assert drivers_of([one, runs[1]]) == (
            (SPINDLE_SPEED,) if other is not None and np.isfinite(other).all() else ()
        )


def test_cycles_begin_where_the_spindle_starts_after_a_rest():
    run = machine('day', 0, [1000, 2000, 1500])
    assert np.bincount(thermal_cycles(run)).tolist() == [200, 200, 200]
    late = replace(run, spindle_speed=np.roll(run.spindle_speed, 30))
    assert np.bincount(thermal_cycles(late)).tolist() == [230, 200, 170]
    # A stop of a few minutes, to change a tool, begins nothing.
    speed = run.spindle_speed.copy()
    speed[50:60] = 0.0
    assert np.array_equal(thermal_cycles(replace(run, spindle_speed=speed)), thermal_cycles(run))
    assert not thermal_cycles(replace(run, spindle_speed=None)).any()
    assert not thermal_cycles(replace(run, spindle_speed=np.zeros(len(speed)))).any()


def test_a_single_run_is_judged_by_its_cycles():
    run = machine('day', 0, [1000, 2000, 1500])
    block, folds = training_folds([run])
    assert [fold.test for fold in folds] == [(0,), (1,), (2,)]
    hidden = run.displacement.copy()
    hidden[block == 1] = np.nan
    _, folds = training_folds([replace(run, displacement=hidden)])
    assert [fold.test for fold in folds] == [(0,), (2,)]


def test_reading_the_speed_wins_where_the_sensors_do_not_see_its_heat(runs):
    model = train_model(runs, candidates=PLAIN)
    assert model.default == ('lag_ridge_speed',)
    assert model.needs_speed
    assert model.drivers == (SPINDLE_SPEED,)
    held_out = {name: item.held_out_rms[0] for name, item in model.candidates.items()}
    assert held_out['lag_ridge_speed'] < 0.7 * held_out['lag_ridge']
    again = ThermalModel.from_json(model.to_json())
    assert again.to_json() == model.to_json()
    stream = Stream(again.recursion())
    rise = runs[0].rise()
    steps = [
        stream.step(np.concatenate([row, again.drive(speed)]))[0]
        for row, speed in zip(rise, runs[0].spindle_speed, strict=True)
    ]
    assert np.allclose(steps, model.predict(runs[0])[:, 0], rtol=1e-9, atol=1e-15)


def test_a_model_without_speed_ignores_what_it_is_told(runs):
    model = train_model(runs, model='lag_ridge', candidates=PLAIN)
    assert not model.needs_speed
    assert model.drive(float('nan')).tolist() == [0.0]
    unknown = replace(runs[0], spindle_speed=None)
    assert np.array_equal(model.predict(unknown), model.predict(runs[0]))
    plain = train_model(runs, candidates=PLAIN, spindle_speed=False)
    assert plain.drivers == ()
    assert 'lag_ridge_speed' not in plain.candidates


def test_a_model_that_needs_the_speed_refuses_a_run_without_it(runs):
    model = train_model(runs, model='lag_ridge_speed', candidates=PLAIN)
    with pytest.raises(ThermalDataError, match='expected a spindle speed in every sample'):
        model.predict(replace(runs[0], spindle_speed=None))
    with pytest.raises(ThermalDataError, match='expected a spindle speed that changes'):
        train_model([replace(run, spindle_speed=None) for run in runs], model='lag_ridge_speed')


def test_a_speed_beyond_training_is_out_of_domain(runs):
    model = train_model(runs, model='lag_ridge_speed', candidates=PLAIN)
    near = np.concatenate([model.domain.mean, model.drive(1000.0 * RPM)])
    far = np.concatenate([model.domain.mean, model.drive(6000.0 * RPM)])
    assert model.in_domain(near)
    assert not model.in_domain(far)
    assert model.standard_deviation(far)[0] > model.standard_deviation(near)[0]


def test_runs_are_held_out_one_by_one(runs):
    parts = splits(runs)
    assert [part.name for part in parts] == ['a', 'b', 'c']
    assert all(part.held_out not in part.training for part in parts)
    assert all(len(part.training) == 2 for part in parts)


def test_cycles_of_a_single_run_are_held_out_with_their_neighbours_unmixed():
    run = machine('day', 0, [1000, 2000, 1500])
    parts = splits([run])
    assert len(parts) == 3
    for part in parts:
        (seen,) = part.training
        inside = part.held_out.inside(part.start, part.stop)
        assert np.array_equal(np.isnan(seen.displacement[:, 0]), inside[: len(seen.time)])
        assert np.isfinite(seen.temperature).all()
        # What is held out is not there, and nothing is behind a stretch that ends the run.
        gone = np.flatnonzero(inside[3 : len(seen.time)]) + 3
        bent = np.diff(seen.temperature[gone], n=2, axis=0)
        assert np.abs(bent).max(initial=0.0) < 1e-9
    assert parts[-1].training[0].time[-1] < parts[-1].start
    window = splits([run], [(6000.0, 12000.0)])
    assert len(window) == 1
    assert np.isnan(window[0].training[0].displacement).sum() == 101


def test_a_single_run_without_speed_is_chained_forward():
    parts = splits([machine('day', 0, [1000, 2000, 1500], speed=False)])
    assert len(parts) == 2
    for part in parts:
        assert part.training[0].time[-1] < part.start <= part.stop


def test_the_choice_is_made_without_the_held_out_run(runs):
    held_out = [judge(part, candidates=PLAIN) for part in splits(runs)]
    comparison = Comparison(tuple(held_out))
    assert comparison.channel == ('Y',)
    assert comparison.names == ('uncompensated', *PLAIN, 'default')
    for item, part in zip(held_out, splits(runs), strict=True):
        alone = train_model(part.training, candidates=PLAIN)
        assert item.evaluation.default == alone.default
    pooled, largest = comparison.rms(), comparison.largest()
    each = np.array([item.evaluation.rms['lag_ridge'] for item in held_out])
    assert pooled['lag_ridge'] == pytest.approx(np.sqrt((each**2).mean(axis=0)))
    assert largest['lag_ridge'] == max(i.evaluation.largest['lag_ridge'] for i in held_out)
    assert pooled['lag_ridge_speed'] < pooled['lag_ridge'] < pooled['uncompensated']


def test_a_candidate_that_diverges_once_stays_infinite():
    run = machine('day', 0, [1000, 2000, 1500])
    item = judge(splits([run])[0], candidates=('static_ridge', 'lag_ridge'))
    broken = replace(
        item.evaluation,
        rms={**item.evaluation.rms, 'lag_ridge': np.array([np.inf])},
    )
    comparison = Comparison((item, HeldOut(broken, item.inputs, {'lag_ridge': 'it diverged'})))
    assert comparison.rms()['lag_ridge'] == np.inf
    assert np.isfinite(comparison.rms()['static_ridge'])
    assert comparison.refused == {'lag_ridge': 'it diverged'}


def test_refusals(runs):
    with pytest.raises(ThermalDataError, match='at least one run'):
        splits([])
    with pytest.raises(ThermalDataError, match='expected one run to cut, but found 3'):
        splits(runs, [(0.0, 600.0)])
    with pytest.raises(ThermalDataError, match='to hold out, but found'):
        splits(runs[:1], [(1e7, 2e7)])


def test_compare_and_evaluate_say_the_same_of_a_stretch():
    run = record_runs(['T2'])['T2']
    end = float(run.time[-1])
    (split,) = splits([run], [(7200.0, end)])
    compared = judge(split, candidates=('lag_ridge', 'static_ridge')).evaluation
    model = train_model([run.window(stop=7199.0)], candidates=('lag_ridge', 'static_ridge'))
    evaluated = evaluate(model, run, start=7200.0)
    assert compared.in_domain == evaluated.in_domain
    assert 0.0 < evaluated.in_domain < 1.0
    assert compared.warm == evaluated.warm == {}
    for name, values in compared.rms.items():
        np.testing.assert_array_equal(values, evaluated.rms[name])
    # A run that begins on the warm machine means other rises: nothing of it is in the domain.
    late = evaluate(model, run.window(start=7200.0))
    assert late.warm
    assert late.in_domain == 0.0
