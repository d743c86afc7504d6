# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal predictor: how another model takes over."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benches.component_bench import Bench
from benches.predictor_bench import (
    LINEAR,
    MICRON,
    START,
    bench_with_model,
    errors_of,
    model_text,
    predict,
    probe_of,
    recordings,
    reference_of,
    sample_of,
)

from fuzzycnc_ros.components.thermal.predictor_stream import PredictorStream
from fuzzycnc_ros.components.thermal.thermal_predictor import (
    ThermalPredictor,
    ThermalPredictorConfig,
)
from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.runtime.enums import Reason
from fuzzycnc_ros.runtime.records import nanoseconds

OTHER = ('D0',)
"""Runs that the model is trained on that takes over."""
SWAP_TIME = 600.0
SAMPLES = 10
"""Samples of one minute in SWAP_TIME."""
PER_SAMPLE = 60.0 / SWAP_TIME


@cache
def course(*names: str) -> np.ndarray:
    """Return what a model publishes for T2 when it is in use from the start [um]."""
    bench = bench_with_model(model_text(*names))
    return errors_of(predict(bench, recordings()['T2'], range(140)))


def bench_in_use(rows: int, **changes):
    """Return a predictor after some samples of T2, its errors so far [um]."""
    bench = bench_with_model(**({'swap_time': SWAP_TIME} | changes))
    return bench, errors_of(predict(bench, recordings()['T2'], range(rows)))


def use(bench, *names: str) -> str:
    """Ask for a model; return the answer in words."""
    answer = bench.request('use_model', model=model_text(*names))
    assert answer.success
    return answer.message


def go_on(bench, rows, bad=()) -> np.ndarray:
    """Give further samples of T2; return the errors [um]."""
    return errors_of(predict(bench, recordings()['T2'], rows, bad))


def test_swap_time_has_a_lower_bound():
    with pytest.raises(ValueError, match=r'swap_time = 59.9 is outside \[60.0, 3600.0\] s'):
        ThermalPredictorConfig(swap_time=59.9)


def test_output_fades_linearly_from_the_old_model_to_the_new():
    bench, _ = bench_in_use(60)
    assert use(bench, *OTHER).startswith('fading from ')
    found = go_on(bench, range(60, 140))
    share = np.minimum(1.0, PER_SAMPLE * np.arange(1, 81))[:, np.newaxis]
    old, new = course()[60:], course(*OTHER)[60:]
    assert np.abs(new - old).max() > 1.0
    np.testing.assert_allclose(found, old + share * (new - old), atol=1e-9)
    np.testing.assert_array_equal(found[SAMPLES:], new[SAMPLES:])
    records = bench.records('thermal_error')[60:]
    assert all(item.valid for item in records)
    assert ' to ' in records[0].model
    assert records[0].model.endswith(' 10 %')
    assert records[-1].model.split()[-1] in use(bench, *OTHER)


def test_no_sample_steps_further_than_its_share_of_the_difference():
    bench, before = bench_in_use(60)
    use(bench, *OTHER)
    found = np.vstack([before[-1:], go_on(bench, range(60, 80))])
    old, new = course()[59:80], course(*OTHER)[59:80]
    moved = np.abs(np.diff(found, axis=0))
    own = np.maximum(np.abs(np.diff(old, axis=0)), np.abs(np.diff(new, axis=0)))
    allowed = own + np.abs(new - old)[1:] * PER_SAMPLE
    assert (moved <= allowed + 1e-9).all()


def deviations(bench) -> np.ndarray:
    """Return the standard deviations from just before a swap on [m]."""
    return np.array([e.standard_deviation for e in bench.records('thermal_error')[59:72]])


def test_deviation_fades_too():
    bench, _ = bench_in_use(60)
    use(bench, *OTHER)
    predict(bench, recordings()['T2'], range(60, 72))
    found = deviations(bench)
    alone = [bench_with_model(model_text(*names)) for names in ((), OTHER)]
    for other in alone:
        predict(other, recordings()['T2'], range(72))
    old, new = map(deviations, alone)
    share = np.minimum(1.0, PER_SAMPLE * np.arange(13))[:, np.newaxis]
    assert np.abs(new - old).max() > 0.01 * MICRON
    np.testing.assert_allclose(found, old + share * (new - old), rtol=1e-9)


def test_model_in_use_stays_until_the_history_of_the_new_one_is_known():
    """After a restart in the middle of a shift there are no samples since the cold start."""
    run, (first, _) = recordings()['T2'], bench_in_use(60)
    bench = bench_with_model(swap_time=SWAP_TIME, settle_time=1200.0)
    bench.component.restore('predictor_state', first.records('predictor_state')[-1])
    bench.push('thermal_reference', reference_of(run))
    predict(bench, run, range(60, 62))
    message = use(bench, *OTHER)
    assert 'takes over from' in message
    assert 'history lost; valid again after 1140 s' in message
    found = go_on(bench, range(62, 110))
    assert all(item.valid for item in bench.records('thermal_error'))
    np.testing.assert_allclose(found[:18], course()[62:80], atol=1e-9)
    assert 'OK swap: fading' not in bench.health()
    apart = np.abs(np.diff(found - course()[62:110], axis=0)).max()
    assert apart <= np.abs(found[-1] - course()[109]).max()  # no step on the way
    assert bench.records('thermal_error')[-1].model.split()[-1] in use(bench, *OTHER)


def test_samples_are_kept_for_as_long_as_they_matter_and_not_without_end():
    run = recordings()['T2']
    stream = PredictorStream(ThermalPredictorConfig(settle_time=1800.0))
    for row in range(len(run.time)):
        stream.hear(sample_of(run, row))
    kept = [item.sample.stamp for item in stream.since(0)]
    newest = nanoseconds(START + run.time[-1])
    assert kept == [newest - nanoseconds(60.0 * age) for age in range(30, -1, -1)]
    assert len(list(stream.since(newest - 1))) == 1


def test_model_that_begins_after_a_long_run_is_valid_at_once():
    bench, _ = bench_in_use(100, settle_time=1800.0)
    assert use(bench, *OTHER).startswith('fading from ')
    found = go_on(bench, range(100, 120))
    # It knows the last half hour only: what was before is what settle_time says to be over.
    apart = np.abs(found[-1] - course(*OTHER)[119]).max()
    assert 0.0 < apart < 3.0


def test_waiting_model_is_replaced_and_the_one_in_use_asked_for_again_stays():
    run, (first, _) = recordings()['T2'], bench_in_use(60)
    bench = bench_with_model(swap_time=SWAP_TIME)
    bench.component.restore('predictor_state', first.records('predictor_state')[-1])
    bench.push('thermal_reference', reference_of(run))
    predict(bench, run, range(60, 62))
    use(bench, *OTHER)
    assert 'WARN swap: ' in bench.health()
    use(bench, 'D0', 'T1')
    assert bench.component.model_text == model_text('D0', 'T1')
    assert 'in use already' in use(bench)
    assert 'swap' not in bench.health()
    np.testing.assert_allclose(go_on(bench, range(62, 70)), course()[62:70], atol=1e-9)


def test_third_model_waits_for_the_fade_under_way():
    bench, _ = bench_in_use(60)
    use(bench, *OTHER)
    go_on(bench, range(60, 64))
    assert 'when the fade to ' in use(bench, 'D0', 'T1')
    assert 'on its way already' in use(bench, 'D0', 'T1')
    found = go_on(bench, range(64, 100))
    first, second, third = (course(*names)[64:100] for names in ((), OTHER, ('D0', 'T1')))
    time = np.arange(5, 41)[:, np.newaxis] * PER_SAMPLE
    wanted = first + np.minimum(1.0, time) * (second - first)
    # The second fade begins with the first sample after the end of the first.
    wanted += np.clip(time - 1.0 - PER_SAMPLE, 0.0, 1.0) * (third - second)
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    np.testing.assert_array_equal(found[-1], third[-1])


def test_same_model_again_changes_nothing():
    bench, _ = bench_in_use(60)
    assert 'in use already' in use(bench)
    np.testing.assert_array_equal(go_on(bench, range(60, 90)), course()[60:90])


def test_without_a_prediction_the_new_model_is_in_use_at_once():
    """Samples since the cold start make it valid, though there was no model when they came."""
    run, bench = recordings()['T2'], Bench(ThermalPredictor())
    assert not any(item.valid for item in predict(bench, run, range(50)))
    assert use(bench).startswith('using ')
    np.testing.assert_array_equal(go_on(bench, range(50, 60)), course()[50:60])


def renamed(run: ThermalRun) -> ThermalRun:
    return replace(run, sensor=tuple(f'S{name}' for name in run.sensor))


def test_model_that_does_not_fit_the_stream_is_refused_and_the_one_in_use_stays():
    runs = [renamed(recordings()[name]) for name in ('D0', 'T1')]
    text = train_model(runs, candidates=('stable_grey',)).to_json()
    bench, _ = bench_in_use(60)
    answer = bench.request('use_model', model=text)
    assert not answer.success
    assert 'sensors: expected the inputs S' in answer.message
    np.testing.assert_array_equal(go_on(bench, range(60, 70)), course()[60:70])
    assert bench.component.model_text == model_text()


def test_restart_during_a_fade_goes_on_to_the_new_model():
    run, (first, _) = recordings()['T2'], bench_in_use(60)
    use(first, *OTHER)
    whole = go_on(first, range(60, 90))
    saved = first.records('predictor_state')[60 - 2 + 3]
    assert saved.model_hash != first.records('predictor_state')[0].model_hash
    second = bench_with_model(model_text(*OTHER), swap_time=SWAP_TIME)
    second.component.restore('predictor_state', saved)
    second.push('thermal_reference', reference_of(run))
    found = go_on(second, range(64, 90))
    # The difference of both models is the last known one for the rest of the fade.
    assert np.abs(found - whole[4:]).max() < 0.3
    np.testing.assert_array_equal(found[SAMPLES:], course(*OTHER)[64 + SAMPLES : 90])


def test_checkpoint_while_a_model_waits_is_of_the_one_in_use():
    run, (first, _) = recordings()['T2'], bench_in_use(60)
    bench = bench_with_model()
    bench.component.restore('predictor_state', first.records('predictor_state')[-1])
    bench.push('thermal_reference', reference_of(run))
    predict(bench, run, range(60, 62))
    use(bench, *OTHER)
    predict(bench, run, range(62, 64))
    hashes = {item.model_hash for item in bench.records('predictor_state')}
    assert hashes == {first.records('predictor_state')[-1].model_hash}


def test_new_reference_ends_a_fade():
    run, (bench, _) = recordings()['T2'], bench_in_use(60)
    use(bench, *OTHER)
    go_on(bench, range(60, 63))
    day = 86400.0
    for row in range(20):
        later = sample_of(run, row, later=day)
        if row == 2:
            changes = {'stamp': later.stamp, 'cold_since': nanoseconds(START + day - 1.0)}
            bench.push('thermal_reference', reference_of(run, **changes))
        bench.give('temperatures', later)
    found = errors_of(bench.records('thermal_error')[-10:])
    np.testing.assert_array_equal(found, course(*OTHER)[10:20])


HALVES = {
    name: tuple(f'T{number}' for number in range(first, 77, 2))
    for name, first in (('odd', 1), ('even', 2))
}
"""Sensors that a model of one half knows, mates included."""


@cache
def half(name: str) -> str:
    """Return a model that knows half of the sensors only."""
    runs = [
        replace(
            run,
            sensor=HALVES[name],
            temperature=run.temperature[:, run.columns(HALVES[name])],
        )
        for run in (recordings()[duty] for duty in ('D0', 'D0b', 'T1'))
    ]
    return train_model(runs, candidates=LINEAR).to_json()


@pytest.mark.parametrize('lost', ['odd', 'even'])
def test_model_that_fails_during_a_fade_leaves_without_a_step(lost):
    """Sensors of the old or the new model die half way: publication goes on from the other."""
    run = recordings()['T2']
    bench = bench_with_model(half('odd'), swap_time=SWAP_TIME)
    predict(bench, run, range(60))
    assert bench.request('use_model', model=half('even')).success
    whole = errors_of(predict(bench, run, range(60, 65)))
    found = go_on(bench, range(65, 95), bad=HALVES[lost])
    assert all(item.valid for item in bench.records('thermal_error')[2:])
    moved = np.abs(np.diff(np.vstack([whole[-1:], found]), axis=0)).max(axis=0)
    alone = {
        name: errors_of(predict(bench_with_model(half(name)), run, range(95)))[64:]
        for name in HALVES
    }
    left = alone['even' if lost == 'odd' else 'odd']
    # While it fades, what is published is of both.
    own = np.max(
        [np.abs(np.diff(values, axis=0)).max(axis=0) for values in alone.values()], axis=0
    )
    apart = np.abs(alone['even'] - alone['odd'])[0]
    assert (moved <= own + apart * PER_SAMPLE).all()
    np.testing.assert_allclose(found[-1], left[-1], atol=1e-9)


def test_both_models_failing_is_said_and_recovered_from():
    bench, _ = bench_in_use(60)
    use(bench, *OTHER)
    go_on(bench, range(60, 63))
    run = recordings()['T2']
    errors = predict(bench, run, range(63, 66), bad=run.sensor)
    assert {(item.valid, item.reason) for item in errors} == {(False, int(Reason.SENSOR_LOST))}
    found = go_on(bench, range(66, 100))
    np.testing.assert_allclose(found[-1], course(*OTHER)[99], atol=0.1)


def test_model_of_fewer_channels_takes_over_in_those_it_has():
    runs = [recordings()[name] for name in ('D0', 'T1')]
    runs = [
        replace(run, channel=('Z',), axis=('Z',), displacement=run.displacement[:, 1:])
        for run in runs
    ]
    text = train_model(runs, candidates=('stable_grey',)).to_json()
    bench, _ = bench_in_use(60)
    assert bench.request('use_model', model=text).success
    found = predict(bench, recordings()['T2'], range(60, 62))
    assert {item.channel for item in found} == {('Z',)}
    assert abs(found[0].error[0] / MICRON - course()[60, 1]) < 1.0


def test_swap_learns_from_the_probes_before_it():
    """The new model is corrected by what was probed while the old one was in use."""
    run = recordings()['T2']
    bench = bench_with_model(learn=True, swap_time=SWAP_TIME)
    probes = [probe_of(run, row) for row in (30, 50)]
    predict(bench, run, range(60), probes=probes)
    use(bench, *OTHER)
    swapped = go_on(bench, range(60, 80))
    single = bench_with_model(model_text(*OTHER), learn=True)
    alone = errors_of(predict(single, run, range(80), probes=probes))
    np.testing.assert_allclose(swapped[-1], alone[-1], atol=1e-9)
    assert np.abs(alone[-1] - course(*OTHER)[79]).max() > 0.3
