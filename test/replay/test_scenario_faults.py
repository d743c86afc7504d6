# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What goes wrong in a shift, in the whole graph: sensors, models, speed, changes of models.

Trained on D0, D0b and T1, judged on T2 and T3, which no model has seen.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import groupby
from typing import Any

import numpy as np
import pytest
from stepped_shift import (
    ALARM_SEEDS,
    CANDIDATES,
    FAULT,
    FAULTY_SEEDS,
    HALF_HOURLY,
    HEALTHY_SEEDS,
    PROBE,
    UNWATCHED,
    Change,
    Shift,
    calibrated,
    cases,
    found_after,
    healthy,
    inputs_of,
    model_of,
    plain,
    speed_model,
    with_fault,
)
from tiers import rest_slow

from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.enums import CompensationState, Reason
from fuzzycnc_ros.runtime.records import Displacement, MachineState
from fuzzycnc_ros.simulation.thermal.duties import DUTIES
from fuzzycnc_ros.studies.shift.thermal_shift import run_shift


@pytest.mark.slow
@pytest.mark.parametrize(
    'seeds', [range(4), pytest.param(HEALTHY_SEEDS, marks=pytest.mark.qualify)], ids=len
)
def test_healthy_sensors_are_trusted(seeds):
    seen = [healthy(*case).said('substitution').any() for case in cases(seeds)]
    assert len(seen) == 2 * len(seeds)
    # A 5 % rate allows one.
    assert np.mean(seen) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize('step', [5.0, -5.0])
def test_a_jump_is_substituted_within_a_few_samples(step):
    found, moved = [], []
    for shift, sensor, beside in with_fault(f'jump:{{}}:{step}', FAULTY_SEEDS, samples=75):
        found.append(found_after(shift, sensor))
        assert shift.substituted(sensor)[FAULT + 4 :].all()
        assert shift.valid[2:].all()
        assert 'drifted away from its mates' in shift.health[-1]['substitution']
        applied = np.array(shift.applied)
        moved.append(np.abs(applied - beside.applied[: len(applied)]).max())
    assert len(found) == 20
    # Not used from the first sample on, declared in the second.
    assert np.median(found) <= 1.0
    assert max(found) <= 3.0
    assert max(moved) <= 3.0


@pytest.fixture(scope='module')
def drifts():
    """Samples to find a drift of 2 K/h, largest residual watched and unwatched [um], per case."""
    found, watched, unwatched = [], [], []
    for shift, sensor, _ in with_fault('drift:{}:2.0', FAULTY_SEEDS, samples=170):
        found.append(found_after(shift, sensor))
        watched.append(shift.largest)
        assert shift.valid[2:].all()
        # Nobody else is blamed.
        assert all(set(item.substituted) <= {sensor} for item in shift.errors)
    for shift, _, _ in with_fault('drift:{}:2.0', FAULTY_SEEDS, samples=170, **UNWATCHED):
        unwatched.append(shift.largest)
        assert not shift.said('substitution').any()
    return np.array(found), np.array(watched), np.array(unwatched)


@pytest.mark.slow
def test_a_drift_is_substituted(drifts):
    found, _, _ = drifts
    assert len(found) == 20
    assert np.median(found) <= 35.0
    assert np.mean(found <= 100.0) >= 0.9


@pytest.mark.slow
def test_a_drift_costs_far_less_than_without_the_watch(drifts):
    watched, unwatched = (largest.max(axis=1) for largest in drifts[1:])
    assert np.median(watched) < 0.5 * np.median(unwatched)
    assert watched.max() < 0.25 * unwatched.max()
    assert watched.max() <= 12.0
    # Where an input matters, in each single case; a small share of the model costs little anyway.
    matters = unwatched > 15.0
    assert matters.sum() >= 10
    assert (watched < 0.6 * unwatched)[matters].all()


@pytest.mark.slow
def test_candidates_are_judged_by_the_rises_that_were_read_instead():
    sensor = inputs_of(0)[1]
    (run,) = run_shift(model_of(0), duties=('T2',), faults=[f'{sensor}:drift:3600:2.0'])
    published = run.predicted['default']
    known = np.isfinite(published).all(axis=1)
    assert known[2:].all()
    for column, name in enumerate(load_model(model_of(0)).default):
        np.testing.assert_allclose(
            published[known, column], run.predicted[name][known, column], rtol=0, atol=1e-15
        )


@pytest.mark.slow
def test_a_stuck_sensor_is_found_by_its_readings_and_costs_little():
    for shift, sensor, beside in with_fault('stuck:{}', FAULTY_SEEDS, ['T2']):
        # Ten minutes without the change of a bit; the sample of the minute holds the last of them.
        assert found_after(shift, sensor) == 11.0
        assert (shift.largest <= (6.0, 4.0)).all()
        assert (shift.largest <= beside.largest + 3.0).all()


@pytest.mark.slow
def test_a_stuck_sensor_whose_readings_flicker_is_left_to_the_watch():
    """As if the readings did change by a bit: the acquisition does not look for stuck sensors."""
    watched, unwatched = (
        np.array(
            [
                shift.largest.max()
                for shift, _, _ in with_fault(
                    'stuck:{}', FAULTY_SEEDS, ['T2'], stuck_time=0.0, **parameters
                )
            ]
        )
        for parameters in ({}, UNWATCHED)
    )
    assert len(watched) == 10
    assert unwatched.max() > 20.0
    assert watched.max() <= 12.0
    assert watched.max() < 0.5 * unwatched.max()
    assert np.median(watched) < 0.6 * np.median(unwatched)


def scaled(text: str, factor: float) -> str:
    """Return a model file whose candidates say `factor` times as much."""
    document = json.loads(text)
    for candidate in document['candidates'].values():
        recursion = candidate['recursion']
        for name in ('readout', 'direct', 'offset'):
            recursion[name] = (factor * np.array(recursion[name])).tolist()
    for channel in document['channels']:
        channel['bound'] *= factor
    return json.dumps(document)


def minute_of(stamp: int) -> float:
    """Return a stamp in minutes since the start of the first duty."""
    return stamp / 6e10 - 360.0


def displacement_as(changed: Callable[[Any, float], Any], duration: float) -> Change:
    """Return a change of the displacements of a duty of a length in minutes."""

    def change(emission: Emission) -> Emission:
        record = emission.record
        if not isinstance(record, Displacement):
            return emission
        moved = changed(record.displacement, minute_of(record.stamp) / duration)
        return replace(emission, record=replace(record, displacement=moved))

    return change


CHANGED = {
    'the model says too much': (1.3, lambda moved, _: moved),
    'the machine moves more': (1.0, lambda moved, _: 1.3 * moved),
    'the machine wanders by 10 um': (1.0, lambda moved, progress: moved + 10e-6 * progress),
}
"""Factor on the model, and displacement [m] from that of the mill and the share of the duty."""


@pytest.mark.parametrize('seed', rest_slow(ALARM_SEEDS, 0))
@pytest.mark.parametrize('name', CHANGED)
def test_a_machine_that_has_changed_is_learnt_within_hours(name, seed):
    factor, changed = CHANGED[name]
    change = displacement_as(changed, DUTIES['T2'].duration / 60.0)
    text = scaled(model_of(seed), factor)
    left = []
    for learn in (True, False):
        parameters = {**HALF_HOURLY, 'learn': learn}
        shift = Shift(text, 'T2', seed=seed, change=change, **parameters).run()
        later = shift.residual[4 * PROBE :]
        left.append(np.sqrt(np.nanmean(later * later, axis=0)))
    assert (left[0] < np.maximum(0.6 * left[1], 1.5)).all()


@cache
def one_run_model() -> str:
    """Return a model of a single run; it has other inputs but for one."""
    return train_model(calibrated(0).runs[:1], candidates=CANDIDATES).to_json()


@cache
def swapped(*faults: str) -> Shift:
    """Return T2 with a model of one run, from sample 100 on fading to that of three."""
    shift = Shift(one_run_model(), faults=faults, swap_time=600.0).run(100)
    assert shift.use(model_of(0)).startswith('fading from ')
    return shift.run()


@pytest.mark.parametrize('place', rest_slow(range(5), 3))
@pytest.mark.parametrize('names', ['old', 'new'])
def test_a_sensor_that_dies_during_a_swap_makes_no_step(names, place):
    text = one_run_model() if names == 'old' else model_of(0)
    sensor = load_model(text).inputs[place]
    shift, beside = swapped(f'{sensor}:dead:6120'), swapped()
    assert shift.valid[2:].all()
    assert 'swap' not in shift.health[-1]
    np.testing.assert_array_equal(shift.error[2:101], beside.error[2:101])
    steps = np.abs(np.diff(shift.error[2:], axis=0)).max()
    assert steps <= np.abs(np.diff(beside.error[2:], axis=0)).max() + 0.6
    assert (shift.largest <= (6.0, 4.0)).all()
    # Who no longer speaks needs no stand-in.
    assert shift.substituted(sensor)[103:108].all()
    assert shift.substituted(sensor)[-1] == (sensor in inputs_of(0))


@pytest.mark.parametrize('place', rest_slow(range(1, 4), 0))
def test_a_new_model_knows_at_once_which_sensor_had_drifted(place):
    """Its own watch has judged the samples that it is given."""
    sensor = inputs_of(0)[place]
    assert sensor not in load_model(one_run_model()).inputs
    shift = swapped(f'{sensor}:drift:3600')
    found = shift.substituted(sensor)
    assert not found[:100].any()
    assert found[100:].all()
    assert (shift.largest <= (6.0, 4.0)).all()


@pytest.mark.parametrize('place', rest_slow(range(5), 3))
def test_a_dead_sensor_beside_a_model_with_spindle_speed(place):
    sensor = load_model(speed_model()).inputs[place]
    shift = Shift(speed_model(), faults=[f'{sensor}:dead:3600']).run()
    assert shift.valid[2:].all()
    assert shift.substituted(sensor)[FAULT + 1 :].all()
    assert (shift.largest <= (6.0, 4.0)).all()


SILENT = 90
"""Minute from which nobody tells the spindle speed."""


def silent(until: float, *, whole: bool) -> Change:
    """Return a change after which the speed, or the whole state, is not told for a while."""

    def change(emission: Emission) -> Emission | None:
        record = emission.record
        if not isinstance(record, MachineState):
            return emission
        if not SILENT < minute_of(record.stamp) <= until:
            return emission
        return None if whole else replace(emission, record=replace(record, spindle_speed=np.nan))

    return change


@pytest.mark.parametrize(
    ('whole', 'held_from', 'why'),
    [
        (False, 111.0, 'expired: thermal error invalid: sensor lost'),
        # The compensator believes a state for ten minutes only.
        (True, 101.0, 'expired: no fresh machine_state'),
    ],
)
def test_without_the_spindle_speed_the_error_ends_and_offsets_go_to_zero(whole, held_from, why):
    shift = Shift(speed_model(), change=silent(np.inf, whole=whole)).run()
    # gap_max is 20 min.
    assert shift.valid[2 : SILENT + 20].all()
    assert not shift.valid[SILENT + 20 :].any()
    assert {item.reason for item in shift.errors[SILENT + 20 :]} == {Reason.SENSOR_LOST}
    assert np.isnan(shift.error[SILENT + 20 :]).all()
    assert shift.health[-1]['prediction'] == (
        'the model reads the spindle speed but neither machine_state nor spindle_speed has told '
        'one for more than gap_max = 1200 s'
    )
    assert next(item.message for item in shift.compensator.health()) == why
    said = [item for item in shift.compensation if minute_of(item.stamp) > 3.0]
    states = [CompensationState(item.state) for item in said]
    assert [state for state, _ in groupby(states)] == [
        CompensationState.ACTIVE,
        CompensationState.HOLDING,
        CompensationState.RAMPING,
        CompensationState.EXPIRED,
    ]
    assert minute_of(said[states.index(CompensationState.HOLDING)].stamp) == held_from
    assert np.abs(said[states.index(CompensationState.HOLDING)].offset).min() > 5e-6
    assert not said[-1].offset.any()
    # Every 10 s: slew_max of 0.2 um/s up to the hold, then ramp_rate of 0.1 um/s.
    moves = np.abs(np.diff([item.offset for item in said], axis=0)).max(axis=1)
    held = states.index(CompensationState.HOLDING)
    assert moves[:held].max() <= 2e-6 + 1e-12
    assert moves[held:].max() <= 1e-6 + 1e-12
    assert np.abs(shift.applied[-1]).max() == 0.0


def test_prediction_comes_back_with_the_spindle_speed():
    back = SILENT + 35
    shift = Shift(speed_model(), change=silent(back, whole=True)).run()
    assert shift.valid[back:].all()
    assert not shift.valid[SILENT + 20 : back].any()
    assert (np.nanmax(np.abs(shift.residual[back:]), axis=0) <= (4.0, 4.0)).all()
    assert CompensationState(shift.compensation[-1].state) is CompensationState.ACTIVE
    assert np.abs(shift.residual[-1]).max() < 4.0


def test_a_model_without_spindle_speed_does_not_miss_it():
    shift = Shift(model_of(0), change=silent(np.inf, whole=False)).run()
    np.testing.assert_array_equal(shift.error, plain('T2').error)
    assert shift.valid[2:].all()
