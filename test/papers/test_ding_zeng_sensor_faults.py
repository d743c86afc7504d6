# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sensor faults, on runs that were never trained on.

Trained on D0, T1 and D0b, five of 76 sensors; judged on T2 and T3, 24 noise seeds.  A prototype's
detector raised false alarms in 4 % (T2) and 28 % (T3) of the runs.  Times in minutes.
"""

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.fit import LagRidge, select_sensors
from fuzzycnc_ros.core.thermal.fit.selection import all_sensors
from fuzzycnc_ros.core.thermal.fit.training import learn_watch
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.core.thermal.sensor_watch import MateEstimate, SensorWatch
from fuzzycnc_ros.simulation.thermal.duties import record_runs

TRAINING = ('D0', 'T1', 'D0b')
UNSEEN = ('T2', 'T3')
FAULTY_SEEDS = 6
STARTS = (60, 150)
TRAINING_ROWS = 5791


def field_of(run, model):
    return run.rise()[:, run.columns(model.sensor)]


def alarms(model, rise, interval=60.0):
    """Return which inputs were faulty at each sample, shape (n, p)."""
    watch = SensorWatch(model)
    return np.array([watch.update(sample, interval) for sample in rise])


def minutes_to_find(model, rise, number, start):
    """Return the samples from the start of a fault to its declaration, infinity if never."""
    faulty = alarms(model, rise)[:, number]
    assert not faulty[:start].any()
    return float(faulty.argmax() - start) if faulty.any() else np.inf


@pytest.fixture(
    scope='module',
    params=[
        pytest.param(range(3), id='3 seeds'),
        pytest.param(range(24), id='24 seeds', marks=pytest.mark.slow),
    ],
)
def noise_seeds(request):
    return request.param


@pytest.fixture(scope='module')
def recordings(noise_seeds):
    return [record_runs((*TRAINING, *UNSEEN), seed=seed) for seed in noise_seeds]


@pytest.fixture(scope='module')
def selections(recordings):
    return [select_sensors([runs[name] for name in TRAINING]) for runs in recordings]


@pytest.fixture(scope='module')
def watched(recordings, selections):
    """What was learnt, and the rises of the unseen runs, by seed."""
    cases = []
    for runs, selection in zip(recordings, selections, strict=True):
        model = learn_watch([runs[name] for name in TRAINING], selection, 60.0)
        cases.append((model, {name: field_of(runs[name], model) for name in UNSEEN}))
    return cases


@pytest.fixture(scope='module')
def drifts(watched):
    """Input, limit, run and time to find a drift of 2 K/h from minute 60 on, both ways."""
    found = []
    for model, fields in watched[:FAULTY_SEEDS]:
        limits = SensorWatch(model).limit
        for name, rise in fields.items():
            hours = np.maximum(np.arange(len(rise)) - STARTS[0], 0) / 60.0
            for number, column in enumerate(model.columns):
                for rate in (2.0, -2.0):
                    faulty = rise.copy()
                    faulty[:, column] += rate * hours
                    time = minutes_to_find(model, faulty, number, STARTS[0])
                    found.append((limits[number], name, time))
    return found


@pytest.mark.paper
@pytest.mark.parametrize('name', UNSEEN)
def test_healthy_sensors_are_trusted(watched, noise_seeds, name):
    seen = np.array([alarms(model, fields[name]).any(axis=0) for model, fields in watched])
    assert seen.shape == (len(noise_seeds), 5)
    assert seen.any(axis=1).mean() < 0.05
    assert seen.mean() < 0.05


@pytest.mark.paper
@pytest.mark.parametrize('step', [5.0, -5.0])
def test_a_jump_is_found_at_once(watched, step):
    samples = []
    for model, fields in watched[:FAULTY_SEEDS]:
        for rise in fields.values():
            for start in STARTS:
                for number, column in enumerate(model.columns):
                    faulty = rise[: start + 20].copy()
                    faulty[start:, column] += step
                    samples.append(1.0 + minutes_to_find(model, faulty, number, start))
    assert np.median(samples) <= 2.0
    assert max(samples) <= 5.0


@pytest.mark.paper
@pytest.mark.parametrize('name', UNSEEN)
def test_a_drift_is_found(drifts, name):
    times = np.array([time for _, run, time in drifts if run == name])
    assert np.median(times) <= 30.0
    assert np.mean(times <= 100.0) >= 0.9


@pytest.mark.paper
def test_a_drift_of_a_sensor_that_its_mates_know_is_found_within_half_an_hour(drifts):
    known = np.array([time for limit, _, time in drifts if limit <= 0.6])
    assert len(known) >= 0.5 * len(drifts)
    assert np.quantile(known, 0.75) <= 30.0
    # The spindle's three sensors have but two close mates, one for each group.
    assert known.max() <= 60.0


@pytest.mark.paper
@pytest.mark.parametrize('name', UNSEEN)
def test_a_stuck_sensor_is_found_when_it_matters(watched, name):
    """While nobody knows, it is rarely wrong by more than twice its limit for minutes."""
    longest = []
    for model, fields in watched[:FAULTY_SEEDS]:
        rise, limits = fields[name], SensorWatch(model).limit
        for start in STARTS:
            for number, column in enumerate(model.columns):
                faulty = rise.copy()
                faulty[start:, column] = rise[start, column]
                unknown = ~alarms(model, faulty)[:, number]
                wrong = np.abs(faulty - rise)[:, column] > 2.0 * limits[number]
                longest.append((wrong & unknown).sum())
    assert np.mean(np.array(longest) > 5) <= 0.2
    assert max(longest) <= 25


@pytest.mark.paper
def test_all_other_sensors_stand_in_for_a_dead_one(recordings, selections, watched):
    """Each of the five sensors dies at minute 60 of T2, ten seeds; largest residual Y/Z [um]."""
    ridge, mate = [], []
    for runs, selection, (model, fields) in list(
        zip(recordings, selections, watched, strict=True)
    )[:10]:
        columns = runs['T2'].columns(selection.chosen)
        rise = np.concatenate([runs[name].rise()[:, columns] for name in TRAINING])
        label = np.repeat(np.arange(3), [len(runs[name].time) for name in TRAINING])
        target = np.concatenate([runs[name].displacement for name in TRAINING])
        models = [LagRidge().fit(rise, values, runs=label) for values in target.T]
        run = runs['T2']
        estimate = MateEstimate(model)
        for number, cluster in enumerate(selection.clusters):
            dead = fields['T2'].copy()
            dead[:, model.columns[number]] = np.nan
            best = cluster.gain[0] * run.rise()[61:, run.columns(cluster.substitute[:1])[0]]
            for stand_in, found in (
                ([estimate.of(number, sample).rise for sample in dead[61:]], ridge),
                (best, mate),
            ):
                inputs = run.rise()[:, columns].copy()
                inputs[61:, number] = stand_in
                predicted = np.column_stack([item.predict(inputs) for item in models])
                found.append(1e6 * np.abs(predicted - run.displacement).max(axis=0))
    assert (np.max(ridge, axis=0) <= (6.0, 4.0)).all()
    assert (np.median(ridge, axis=0) <= (3.0, 2.5)).all()
    assert np.quantile(ridge, 0.9, axis=0).sum() <= np.quantile(mate, 0.9, axis=0).sum() + 0.2


@pytest.mark.paper
def test_no_false_alarm_on_a_real_spindle(data):
    """Trained on 24 h with three speeds, judged on a fourth; t16 jumps, t4 is a saw-tooth."""
    table = np.genfromtxt(
        data / 'spindle-thermal' / 'spindle_thermal.csv', delimiter=',', names=True
    )
    sensors = [f't{number}' for number in range(1, 17)]
    channels = [f'ch{number}' for number in range(1, 6)]
    run = ThermalRun(
        name='spindle',
        time=table['t'],
        sensor=sensors,
        temperature=np.column_stack([table[name] for name in sensors]),
        channel=channels,
        axis=('X', 'X', 'Y', 'Y', 'Z'),
        displacement=1e-6 * np.column_stack([table[name] for name in channels]),
    )
    training = run.window(stop=run.time[TRAINING_ROWS - 1]).resample(60.0)
    model = learn_watch([training], all_sensors([training]), 60.0)
    even = run.resample(60.0)
    rise = even.rise(training.reference())[:, even.columns(model.sensor)]
    unseen = even.time > run.time[TRAINING_ROWS - 1]
    assert len(model.input) == 16
    assert unseen.sum() >= 450
    assert not alarms(model, rise).any()
    times = []
    for number, column in enumerate(model.columns):
        faulty = rise[unseen]
        hours = np.maximum(np.arange(len(faulty)) - 60, 0) / 60.0
        faulty[:, column] += 2.0 * hours
        times.append(minutes_to_find(model, faulty, number, 60))
    # Five of the sixteen follow no other closely: a fan, a coolant line or a loose contact.
    assert np.median(times) <= 40.0
