# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rises of a model's inputs: who stands in for a sensor that failed."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.components.thermal.sensor_substitution import RiseSource
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.model import ModelMismatchError, ThermalModel
from fuzzycnc_ros.core.thermal.sensor_watch import SensorWatch
from fuzzycnc_ros.runtime.records import (
    SensorCluster,
    SensorSelection,
    ThermalReference,
    nanoseconds,
)
from fuzzycnc_ros.simulation.thermal.duties import record_runs


@pytest.fixture(scope='module')
def runs():
    return record_runs(seed=0)


@pytest.fixture(scope='module')
def model(runs):
    return train_model([runs[name] for name in ('D0', 'D0b', 'T1')], model='lag_ridge')


@pytest.fixture(scope='module')
def run(runs):
    return runs['T2']


def reference_of(run, without=()):
    known = [name not in without for name in run.sensor]
    return ThermalReference(
        stamp=nanoseconds(120.0),
        frame_id='mill/machine',
        cold_since=0,
        set_by='test',
        sensor=tuple(np.array(run.sensor)[known].tolist()),
        temperature=run.reference()[known],
        samples=3,
    )


def published(chosen, mate, gain):
    return SensorSelection(
        stamp=1,
        frame_id='mill/machine',
        method='correlation',
        cluster=(
            SensorCluster(
                member=(chosen, mate),
                score=np.ones(2),
                chosen=chosen,
                substitute=(mate,),
                gain=np.array([gain]),
                correlation=np.ones(1),
            ),
        ),
        partition_coefficient=0.8,
        xie_beni=0.1,
        dropped=(),
        calibration=(),
    )


def good_without(run, *names):
    return ~np.isin(run.sensor, names)


def source_of(model, run, selection=None, watch=None, without=()):
    return RiseSource(model, run.sensor, reference_of(run, without), selection, watch)


def without_watch(model: ThermalModel) -> ThermalModel:
    """Return the model as a file of an earlier version gives it."""
    return replace(model, watch=None)


def test_a_stream_or_reference_without_the_inputs_is_refused(model, run):
    with pytest.raises(ModelMismatchError, match='expected the inputs'):
        RiseSource(model, run.sensor[:2], reference_of(run), None)
    cluster = model.selection.clusters[0]
    gone = (cluster.chosen, *cluster.substitute)
    with pytest.raises(ModelMismatchError, match=f'lacks {cluster.chosen} and all of its mates'):
        source_of(model, run, without=gone)


def test_healthy_sensors_speak_for_themselves(model, run):
    source = source_of(model, run, watch=SensorWatch(model.watch))
    everything = good_without(run)
    for row in range(len(run.time)):
        rise = source.rise(run.temperature[row], everything)
        assert np.array_equal(rise, run.rise()[row, run.columns(model.inputs)])
    assert source.substituted == source.substitute == source.lost == source.voted_out == ()


def test_all_other_sensors_estimate_a_lost_one(model, run):
    """As the best mate alone does where there is no watch; both within the limit of a fault."""
    missed = {True: [], False: []}
    for number, cluster in enumerate(model.selection.clusters):
        for known in (True, False):
            source = source_of(model if known else without_watch(model), run)
            for row in range(60, len(run.time)):
                rise = source.rise(run.temperature[row], good_without(run, cluster.chosen))
                assert source.substituted == (cluster.chosen,)
                assert source.substitute == cluster.substitute[:1]
                truth = run.rise()[row, run.columns(model.inputs)]
                others = np.arange(len(truth)) != number
                assert np.array_equal(rise[others], truth[others])
                missed[known].append(rise[number] - truth[number])
    ridge, mate = (np.sqrt(np.mean(np.square(missed[known]))) for known in (True, False))
    assert max(ridge, mate) < 0.4


def test_without_a_watch_the_best_mate_times_its_gain_stands_in(model, run):
    source = source_of(without_watch(model), run)
    cluster = model.selection.clusters[1]
    first, second = cluster.substitute[:2]
    rise = source.rise(run.temperature[100], good_without(run, cluster.chosen, first))
    assert source.substitute == (second,)
    expected = cluster.gain[1] * run.rise()[100, run.columns([second])[0]]
    assert rise[1] == pytest.approx(expected, rel=1e-12)


def test_a_published_selection_takes_precedence(model, run):
    chosen = model.inputs[0]
    mate = model.selection.clusters[0].substitute[3]
    source = source_of(model, run, published(chosen, mate, 0.7))
    rise = source.rise(run.temperature[100], good_without(run, chosen))
    assert source.substitute == (mate,)
    assert rise[0] == pytest.approx(0.7 * run.rise()[100, run.columns([mate])[0]], rel=1e-12)


def test_other_clusters_stand_in_only_where_they_know_the_sensor_well(model, run):
    """Training says how well; 0.5 K is what the watch would tolerate."""
    outcomes = set()
    for number, cluster in enumerate(model.selection.clusters):
        source = source_of(model, run)
        good = good_without(run, cluster.chosen, *cluster.substitute)
        rise = source.rise(run.temperature[100], good)
        outcomes.add(rise is not None)
        if rise is None:
            assert source.lost == (cluster.chosen,)
        else:
            assert source.substitute[0] not in cluster.member
            truth = run.rise()[100, run.columns([cluster.chosen])[0]]
            assert abs(rise[number] - truth) < 1.5
    assert True in outcomes
    source = source_of(model, run)
    assert source.rise(run.temperature[100], np.zeros(len(run.sensor), dtype=bool)) is None
    assert source.lost == model.inputs


def test_a_faulty_sensor_is_replaced_and_is_no_mate(model, run):
    sensor = model.inputs[0]
    column = run.columns([sensor])[0]
    source = source_of(model, run, watch=SensorWatch(model.watch))
    everything = good_without(run)
    for row in range(100):
        temperature = run.temperature[row].copy()
        temperature[column] += 5.0 * (row >= 60)
        rise = source.rise(temperature, everything)
        if row >= 61:
            assert source.voted_out == source.substituted == (sensor,)
            assert abs(rise[0] - run.rise()[row, column]) < 1.0
    # What another lost input is estimated from does not depend on the faulty one.
    other = model.inputs[1]
    results = []
    for offset in (5.0, 40.0):
        temperature = run.temperature[100].copy()
        temperature[column] += offset
        results.append(source.rise(temperature, good_without(run, other)))
        assert source.substituted == (sensor, other)
    assert np.array_equal(*results)


def test_sensors_that_the_stream_lacks_are_missing_mates(model, run):
    """A machine may lose a terminal with all its sensors; the rest goes on."""
    keep = [name for name in run.sensor if name in model.inputs or int(name[1:]) % 3]
    columns = run.columns(keep)
    source = RiseSource(model, tuple(keep), reference_of(run), None, SensorWatch(model.watch))
    for row in range(100):
        rise = source.rise(run.temperature[row, columns], ~np.isin(keep, model.inputs[:1]))
        assert rise is not None
        assert source.substituted == model.inputs[:1]
    assert source.voted_out == ()


@pytest.mark.parametrize('temperature', [1e300, -1e9, 1500.0])
def test_an_impossible_rise_is_substituted(model, run, temperature):
    source = source_of(model, run, watch=SensorWatch(model.watch))
    row = run.temperature[-1].copy()
    first = model.inputs[0]
    row[run.sensor.index(first)] = temperature
    rise = source.rise(row, good_without(run))
    assert source.substituted == (first,)
    assert np.abs(rise).max() < 100.0
