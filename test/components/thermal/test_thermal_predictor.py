# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal predictor: what it predicts from, what it refuses, how it comes back."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import Bench
from benches.predictor_bench import (
    MICRON,
    START,
    bench_with_model,
    losing_text,
    model_text,
    predict,
    recordings,
    reference_of,
    residual,
    sample_of,
    trained,
)

from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.runtime.enums import Reason
from fuzzycnc_ros.runtime.records import (
    SensorCluster,
    SensorSelection,
    nanoseconds,
)


def test_stream_gives_what_the_model_gives_for_the_whole_run():
    run, bench = recordings()['T2'], bench_with_model()
    errors = predict(bench, run, range(len(run.time)))
    assert [item.valid for item in errors[:2]] == [False, False]
    assert all(item.valid for item in errors[2:])
    found = np.array([item.error for item in errors[2:]])
    np.testing.assert_allclose(found, trained().predict(run)[2:], rtol=1e-9, atol=1e-15)
    assert residual(errors[2:], run, slice(2, None)) < 6.0
    last = errors[-1]
    assert last.axis == last.channel == ('Y', 'Z')
    assert last.frame_id == 'mill/workpiece'
    assert last.stamp == nanoseconds(START + run.time[-1])
    assert bench.component.model_text == model_text()


def test_without_a_model_nothing_is_predicted():
    bench, run = Bench(ThermalPredictor()), recordings()['T2']
    (error,) = predict(bench, run, [5])
    assert (error.valid, error.reason) == (False, Reason.NO_MODEL)
    assert error.axis == ()
    assert 'ERROR prediction: no model; set the parameter model' in bench.health()


def test_without_a_reference_nothing_is_guessed():
    bench, run = bench_with_model(), recordings()['T2']
    for error in predict(bench, run, range(5, 10)):
        assert (error.valid, error.reason) == (False, Reason.NO_REFERENCE)
        assert np.isnan(error.error).all()
    assert 'no thermal reference (topic thermal_reference)' in bench.health()
    assert bench.records('predictor_state') == []


def test_late_reference_finds_the_samples_since_the_cold_start():
    run, bench = recordings()['T2'], bench_with_model()
    for row in range(6):
        bench.give('temperatures', sample_of(run, row))
    late = reference_of(run, stamp=nanoseconds(START + run.time[5]))
    bench.push('thermal_reference', late)
    bench.give('temperatures', sample_of(run, 6))
    error = bench.records('thermal_error')[-1]
    assert error.valid
    np.testing.assert_allclose(error.error, trained().predict(run)[6], rtol=1e-9, atol=1e-15)


def test_restart_from_the_checkpoint_goes_on_as_if_nothing_had_happened():
    run = recordings()['T2']
    whole = bench_with_model()
    wanted = predict(whole, run, range(120))

    first = bench_with_model()
    predict(first, run, range(90))
    second = bench_with_model()
    second.component.restore('predictor_state', first.records('predictor_state')[-1])
    second.push('thermal_reference', reference_of(run))
    found = predict(second, run, range(90, 120))
    assert all(item.valid for item in found)
    for one, other in zip(found, wanted[90:], strict=True):
        np.testing.assert_allclose(one.error, other.error, rtol=1e-12)


def test_restart_after_minutes_is_bridged_without_a_step():
    """Back within 1 um of the uninterrupted run at once."""
    run = recordings()['T2']
    wanted = predict(bench_with_model(), run, range(130))
    first = bench_with_model()
    predict(first, run, range(91))
    second = bench_with_model()
    second.component.restore('predictor_state', first.records('predictor_state')[-1])
    second.push('thermal_reference', reference_of(run))
    found = predict(second, run, range(101, 130))
    assert all(item.valid for item in found)
    apart = [np.abs(a.error - b.error).max() for a, b in zip(found, wanted[101:], strict=True)]
    assert max(apart) < 1.0 * MICRON


@pytest.mark.parametrize('wrong', ['none', 'reference', 'model', 'inputs'])
def test_restart_without_a_matching_checkpoint_says_that_its_history_is_lost(wrong):
    run = recordings()['T2']
    first = bench_with_model()
    predict(first, run, range(91))
    state = first.records('predictor_state')[-1]
    state = {
        'none': None,
        'reference': replace(state, reference_stamp=state.reference_stamp + 1),
        'model': replace(state, model_hash='0' * 64),
        'inputs': replace(state, input=state.input[::-1]),
    }[wrong]
    second = bench_with_model(settle_time=1800.0)
    if state is not None:
        second.component.restore('predictor_state', state)
    second.push('thermal_reference', reference_of(run))
    errors = predict(second, run, range(91, 130))
    for error in errors[:30]:
        assert (error.valid, error.reason) == (False, Reason.STATE_LOST)
        assert np.isnan(error.error).all()
    assert errors[-1].valid
    assert len(second.records('predictor_state')) == sum(item.valid for item in errors)


@pytest.mark.parametrize(
    ('duty', 'first', 'last'), [('T2', 60, 70), ('T2', 120, 139), ('T3', 100, 119)]
)
def test_missing_samples_are_bridged(duty, first, last):
    """Right after a change of speed a recursion that was not bridged is 7 um off."""
    run = recordings()[duty]
    wanted = predict(bench_with_model(), run, range(last + 20))[last:]
    found = predict(bench_with_model(), run, [*range(first), *range(last, last + 20)])[first:]
    assert all(item.valid for item in found)
    apart = [np.abs(a.error - b.error).max() for a, b in zip(found, wanted, strict=True)]
    assert max(apart) < 1.0 * MICRON


def test_too_long_a_gap_loses_the_history():
    run, bench = recordings()['T3'], bench_with_model(gap_max=600.0, settle_time=1200.0)
    predict(bench, run, range(60))
    (error,) = predict(bench, run, [90])
    assert (error.valid, error.reason) == (False, Reason.STATE_LOST)
    assert 'ERROR prediction: history lost; valid again after 1200 s' in bench.health()
    errors = predict(bench, run, range(91, 130))
    assert [item.valid for item in errors].index(True) == 19
    assert all(item.valid for item in errors[19:])


def test_dead_sensor_is_replaced_by_its_mate():
    run = recordings()['T2']
    for dead in trained().inputs:
        bench = bench_with_model()
        predict(bench, run, range(60))
        errors = predict(bench, run, range(60, len(run.time)), bad=(dead,))
        assert all(item.valid for item in errors)
        assert errors[-1].substituted == (dead,)
        cluster = next(c for c in trained().selection.clusters if c.chosen == dead)
        assert errors[-1].substitute[0] in cluster.substitute
        assert residual(errors, run, slice(60, None)) < 6.0
        assert f'WARN substitution: substituted: {dead} by' in bench.health()


def drifting(run: ThermalRun, sensor: str, rate: float = 2.0) -> ThermalRun:
    """Return a run in which a sensor drifts by `rate` [K/h] from minute 60 on."""
    temperature = run.temperature.copy()
    hours = np.maximum(run.time - 3600.0, 0.0) / 3600.0
    temperature[:, run.sensor.index(sensor)] += rate * hours
    return replace(run, temperature=temperature)


@pytest.mark.parametrize('duty', ['T2', 'T3'])
def test_healthy_sensors_are_not_voted_out(duty):
    run = recordings()[duty]
    errors = predict(bench_with_model(), run, range(len(run.time)))
    assert not any(item.substituted for item in errors)


@pytest.mark.parametrize('duty', ['T2', 'T3'])
def test_drifting_sensor_is_voted_out(duty):
    run, model = recordings()[duty], trained()
    for sensor in model.inputs:
        faulty = drifting(run, sensor)
        bench, blind = bench_with_model(), bench_with_model(mate_persistence=0.0)
        errors = predict(bench, faulty, range(len(run.time)))
        assert errors[-1].substituted == (sensor,)
        assert f'{sensor} drifted away from its mates' in bench.health()
        unseen = predict(blind, faulty, range(len(run.time)))
        assert not any(item.substituted for item in unseen)
        rows = slice(2, None)
        assert residual(errors[2:], run, rows) < residual(unseen[2:], run, rows)


def test_sensor_without_a_good_mate_is_lost_and_comes_back():
    run, bench = recordings()['T2'], bench_with_model()
    predict(bench, run, range(60))
    errors = predict(bench, run, range(60, 70), bad=run.sensor)
    for error in errors:
        assert (error.valid, error.reason) == (False, Reason.SENSOR_LOST)
        assert np.isnan(error.error).all()
    assert f'no good reading of {", ".join(trained().inputs)} nor of any mate' in bench.health()
    back = predict(bench, run, range(70, 90))
    assert all(item.valid for item in back)
    assert back[-1].substituted == ()


def test_published_selection_names_the_mates():
    run, model = recordings()['T2'], trained()
    dead = model.inputs[0]
    cluster = next(c for c in model.selection.clusters if c.chosen == dead)
    mate = cluster.substitute[1]
    gain = cluster.gain[1]
    selection = SensorSelection(
        stamp=nanoseconds(START),
        frame_id='mill/machine',
        method='correlation',
        cluster=(
            SensorCluster(
                member=(dead, mate),
                score=np.ones(2),
                chosen=dead,
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
    bench = bench_with_model()
    bench.push('sensor_selection', selection)
    predict(bench, run, range(30))
    (error,) = predict(bench, run, [30], bad=(dead,))
    assert error.substitute == (mate,)


def test_samples_at_another_interval_are_refused_with_the_remedy():
    run, bench = recordings()['T2'], bench_with_model()
    predict(bench, run, range(10))
    bench.give('temperatures', sample_of(run, 10, later=-30.0))
    error = bench.records('thermal_error')[-1]
    assert (error.valid, error.reason) == (False, Reason.NO_MODEL)
    text = bench.health()
    assert 'takes samples every 60 s but they come after 30 s' in text
    assert 'set interval of temperature_acquisition' in text
    bench.give('temperatures', sample_of(run, 10, later=-29.9))
    assert 'but they come after 0.1 s' in bench.health()


def test_stream_without_the_models_sensors_is_refused_by_name():
    run, bench = recordings()['T2'], bench_with_model()
    keep = [n for n, name in enumerate(run.sensor) if name != trained().inputs[0]]
    other = replace(
        run,
        sensor=tuple(run.sensor[n] for n in keep),
        temperature=run.temperature[:, keep],
    )
    errors = predict(bench, other, range(5))
    assert (errors[-1].valid, errors[-1].reason) == (False, Reason.NO_MODEL)
    assert trained().inputs[0] in bench.health()


def test_temperatures_far_from_the_training_are_flagged_and_widened():
    run, bench = recordings()['T2'], bench_with_model()
    predict(bench, run, range(30))
    usual = bench.records('thermal_error')[-1]
    hot = replace(run, temperature=run.temperature + np.arange(76) % 5 * 8.0)
    bench.give('temperatures', sample_of(hot, 30))
    far = bench.records('thermal_error')[-1]
    assert usual.in_domain
    assert not far.in_domain
    assert (far.standard_deviation > 2.0 * trained().band.deviation).all()


def test_new_reference_begins_a_new_history():
    run, bench = recordings()['T2'], bench_with_model()
    first = predict(bench, run, range(100))
    day = 86400.0
    for row in range(100):
        later = sample_of(run, row, later=day)
        if row == 2:
            reference = reference_of(
                run, stamp=later.stamp, cold_since=nanoseconds(START + day - 1.0)
            )
            bench.push('thermal_reference', reference)
        bench.give('temperatures', later)
    second = bench.records('thermal_error')[100:]
    for one, other in zip(first[2:], second[2:], strict=True):
        np.testing.assert_array_equal(one.error, other.error)


@pytest.mark.parametrize('text', ['', 'not a model', '{}', '{"schema": 99}'])
def test_bad_model_is_refused_and_the_one_in_use_stays(text):
    run, bench = recordings()['T2'], bench_with_model()
    predict(bench, run, range(10))
    answer = bench.request('use_model', model=text)
    assert not answer.success
    assert answer.message
    (error,) = predict(bench, run, [10])
    assert error.valid
    assert bench.component.model_text == model_text()


def test_two_predictors_agree_to_the_last_bit():
    run = recordings()['T3']
    one = predict(bench_with_model(), run, range(150))
    other = predict(bench_with_model(), run, range(150))
    for a, b in zip(one, other, strict=True):
        assert a.error.tobytes() == b.error.tobytes()
        assert a.standard_deviation.tobytes() == b.standard_deviation.tobytes()


@pytest.mark.parametrize('damage', ['short', 'rest', 'length'])
def test_damaged_checkpoint_is_as_good_as_none(damage):
    run, first = recordings()['T2'], bench_with_model()
    predict(first, run, range(91))
    saved = first.records('predictor_state')[-1]
    state = {
        'short': saved.state[:-1],
        'rest': np.append(saved.state, 1.0),
        'length': np.append(saved.state, [1.0, 5.0, 0.0]),
    }[damage]
    second = bench_with_model()
    second.component.restore('predictor_state', replace(saved, state=state))
    second.push('thermal_reference', reference_of(run))
    (error,) = predict(second, run, [91])
    assert (error.valid, error.reason) == (False, Reason.STATE_LOST)


def test_block_of_a_newer_version_is_passed_over():
    run, first = recordings()['T2'], bench_with_model()
    wanted = predict(first, run, range(95))[-1]
    second = bench_with_model()
    saved = first.records('predictor_state')[-5]
    newer = replace(saved, state=np.append(saved.state, [99.0, 2.0, 3.0, 4.0]))
    second.component.restore('predictor_state', newer)
    second.push('thermal_reference', reference_of(run))
    found = predict(second, run, range(91, 95))[-1]
    np.testing.assert_array_equal(found.error, wanted.error)


def test_model_that_is_worse_than_none_is_refused_unless_forced():
    run, bench = recordings()['T2'], bench_with_model()
    answer = bench.request('use_model', model=losing_text())
    assert not answer.success
    for words in ('Y worse than without: 26.6 µm of 9.4 µm', '--model auto', 'force'):
        assert words in answer.message
    predict(bench, run, range(5))
    assert bench.component.model_text == model_text()
    forced = bench_with_model(losing_text(), force=True)
    assert predict(forced, run, range(5))[-1].valid
    assert 'WARN forced: Y worse than without: 26.6 µm of 9.4 µm' in forced.health()


def test_channel_that_stays_uncompensated_is_reported_and_predicted_as_nothing():
    left = replace(trained(), default=(UNCOMPENSATED, trained().default[1]))
    run, bench = recordings()['T2'], bench_with_model(left.to_json())
    errors = predict(bench, run, range(50))
    assert (errors[-1].valid, errors[-1].error[0]) == (True, 0.0)
    assert errors[-1].error[1] != 0.0
    assert 'OK uncompensated: Y: no model was better beyond chance' in bench.health()


@pytest.mark.parametrize('accepted', [False, True])
def test_warm_reference_is_named_and_out_of_domain_unless_it_is_accepted(accepted):
    run, bench = recordings()['T2'], bench_with_model(warm_reference=accepted)
    front = trained().inputs[0]
    warm = run.temperature.copy()
    # As if it had run before: of what it is now, the rises are those of a cold start.
    warm[:, run.sensor.index(front)] += 20.0
    errors = predict(bench, replace(run, temperature=warm), range(10))
    assert all(item.valid for item in errors[2:])
    assert [item.in_domain for item in errors[2:]] == [accepted] * 8
    told = f'WARN reference: the machine was warm when the reference was taken: {front} +'
    assert told in bench.health()
    assert ('WARN domain: rises are meant against a warm reference' in bench.health()) != accepted


def test_cold_reference_that_lacks_a_sensor_is_not_warm():
    run, bench = recordings()['T2'], bench_with_model()
    reference = reference_of(run)
    reference.temperature[run.sensor.index(trained().inputs[0])] = np.nan
    bench.push('thermal_reference', reference)
    bench.give('temperatures', sample_of(run, 2))
    assert 'warm' not in bench.health()
