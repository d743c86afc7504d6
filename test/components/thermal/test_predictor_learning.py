# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal predictor: learning from probes, with a model and from nothing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benches.component_bench import Bench, applied
from benches.predictor_bench import (
    MICRON,
    START,
    bench_with_model,
    errors_of,
    model_text,
    predict,
    probe_of,
    recordings,
    reference_of,
    residual,
    sample_of,
    trained,
)

from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.components.thermal.thermal_predictor_config import ThermalPredictorConfig
from fuzzycnc_ros.runtime.enums import ForgetMode, Reason
from fuzzycnc_ros.runtime.records import nanoseconds

QUICK = {'correction_time': 60.0}
"""A correction that is in force with the next sample."""
HALF_HOURLY = range(30, 400, 30)


@cache
def unprobed(duty: str = 'T3', *names: str, learn: bool = False) -> np.ndarray:
    """Return what is published for a duty without probes, rows from the third on [um]."""
    run = recordings()[duty]
    bench = bench_with_model(model_text(*names), learn=learn)
    return errors_of(predict(bench, run, range(len(run.time))))


def probed_run(duty: str, rows, text: str = '', **changes):
    """Return a predictor after a duty that was probed at some rows, and its errors."""
    run, bench = recordings()[duty], bench_with_model(text, **changes)
    probes = [probe_of(run, row) for row in rows]
    return bench, predict(bench, run, range(len(run.time)), probes=probes)


def test_without_probing_a_displacement_changes_nothing():
    bench, errors = probed_run('T3', range(len(recordings()['T3'].time)))
    np.testing.assert_array_equal(errors_of(errors), unprobed())
    assert bench.health().startswith('OK prediction')
    assert 'learning' not in bench.health()
    assert not bench.records('thermal_posterior')


def test_compensation_that_was_active_is_taken_off():
    run, row, offset = recordings()['T3'], 100, np.array([-1.0, 0.7]) * MICRON
    bare = probe_of(run, row, later=-30.0)
    plain = bench_with_model(learn=True)
    wanted = errors_of(predict(plain, run, range(110), probes=[bare]))
    bench = bench_with_model(learn=True)
    for later, share in ((-42.0, 0.96), (-18.0, 1.04)):
        bench.push('compensation_applied', applied(START + run.time[row] + later, share * offset))
    probe = replace(bare, displacement=bare.displacement + offset, includes_compensation=True)
    found = errors_of(predict(bench, run, range(110), probes=[probe]))
    assert np.abs(wanted[-1] - unprobed(learn=True)[109]).max() > 0.3
    np.testing.assert_allclose(found, wanted, atol=1e-9)


READ_BACKS = {
    'none': ((), 'no read-back (compensation_applied) tells how much'),
    'before': (((-5.0, 0.0),), 'before and after it'),
    'rare': (((-100.0, 0.0), (0.0, 0.0)), 'read-backs are 100 s apart, more than 60 s'),
    'moving': (((-12.0, 0.0), (0.0, 2e-6)), 'compensation of Y moved by 2.0 µm'),
}


@pytest.mark.parametrize('case', READ_BACKS)
def test_probe_with_compensation_that_is_not_known_is_refused(case):
    read_backs, text = READ_BACKS[case]
    run, row = recordings()['T3'], 100
    bench = bench_with_model(learn=True)
    for later, offset in read_backs:
        time = START + run.time[row] + later
        bench.push('compensation_applied', applied(time, (offset, offset)))
    probe = probe_of(run, row, later=-5.0, includes_compensation=True)
    if case == 'before':
        probe = probe_of(run, row, includes_compensation=True)
    found = errors_of(predict(bench, run, range(110), probes=[probe]))
    np.testing.assert_array_equal(found, unprobed(learn=True)[:110])
    assert text in bench.health()
    assert 'WARN probe: probe at ' in bench.health()


def test_millimetres_are_refused():
    run = recordings()['T3']
    probe = probe_of(run, 100, displacement=run.displacement[100] * 1e3)
    bench = bench_with_model(learn=True)
    found = errors_of(predict(bench, run, range(110), probes=[probe]))
    np.testing.assert_array_equal(found, unprobed(learn=True)[:110])
    assert 'are displacements in m?' in bench.health()


def next_day(bench, run, rows, probes=()):
    """Give the samples of a run a day later, from a new reference on; return the errors."""
    day, before = 86400.0, len(bench.records('thermal_error'))
    for probe in probes:
        bench.push('displacement', replace(probe, stamp=probe.stamp + nanoseconds(day)))
    for row in rows:
        later = sample_of(run, row, later=day)
        if row == 2:
            changes = {'stamp': later.stamp, 'cold_since': nanoseconds(START + day - 1.0)}
            bench.push('thermal_reference', reference_of(run, **changes))
        bench.give('temperatures', later)
    return bench.records('thermal_error')[before:]


def test_probe_from_before_the_reference_is_not_used():
    run, bench = recordings()['T3'], bench_with_model(learn=True)
    early = probe_of(run, 1, displacement=np.full(2, 5.0 * MICRON))
    np.testing.assert_array_equal(
        errors_of(predict(bench, run, range(20), probes=[early])), unprobed(learn=True)[:20]
    )


def test_probe_of_what_is_not_predicted_is_refused_aloud():
    run = recordings()['T3']
    probe = probe_of(run, 60, axis=('X', 'X'), channel=('A', 'B'))
    bench = bench_with_model(learn=True)
    found = errors_of(predict(bench, run, range(70), probes=[probe]))
    np.testing.assert_array_equal(found, unprobed(learn=True)[:70])
    assert 'is not used: its channels are not predicted' in bench.health()


def test_probe_whose_deviation_says_nothing_is_not_used():
    """Its square would overflow in the state of a filter that is published."""
    run = recordings()['T3']
    told = bench_with_model(learn=True, **QUICK)
    vague = replace(probe_of(run, 30), standard_deviation=np.full(2, 1e300))
    errors = predict(told, run, range(40), probes=[vague])
    plain = predict(bench_with_model(learn=True, **QUICK), run, range(40))
    np.testing.assert_array_equal(errors_of(errors), errors_of(plain))
    assert np.isfinite(told.records('predictor_state')[-1].state).all()


def test_probes_bound_the_residual_of_a_model_of_one_run():
    run, text = recordings()['T3'], model_text('D0')
    before = np.abs(unprobed('T3', 'D0', learn=True) - run.displacement / MICRON)[2:].max()
    _, errors = probed_run('T3', HALF_HOURLY, text, learn=True)
    assert residual(errors[2:], run, slice(2, None)) < min(0.7 * before, 4.5)


def test_a_probe_comes_into_force_without_a_step():
    run, row = recordings()['T3'], 100
    probe = probe_of(run, row, displacement=run.displacement[row] + 8.0 * MICRON)
    bench = bench_with_model(learn=True, correction_time=600.0)
    found = (
        errors_of(predict(bench, run, range(row + 30), probes=[probe]))
        - unprobed(learn=True)[:130]
    )
    assert np.abs(found[2 : row + 1]).max() < 1e-9
    assert (found[row + 11] > 6.0).all()
    assert (np.abs(np.diff(found[2:], axis=0)) <= 0.15 * found[row + 11]).all()


def test_channels_are_probed_one_by_one():
    run, row = recordings()['T3'], 100
    probes = [
        probe_of(
            run,
            row,
            later=20.0 * number,
            axis=(axis,),
            channel=('probe',),
            displacement=run.displacement[row, [number]] + 3.0 * MICRON,
            standard_deviation=np.array([np.nan]),
        )
        for number, axis in enumerate(run.axis)
    ]
    bench = bench_with_model(learn=True, **QUICK)
    found = errors_of(predict(bench, run, range(row + 4), probes=probes))
    np.testing.assert_allclose(found[-1], run.displacement[row + 3] / MICRON + 3.0, atol=2.0)
    assert bench.records('thermal_posterior')[-1].probes.tolist() == [1, 1]


def test_stream_of_displacements_is_thinned_to_an_interval():
    every = range(len(recordings()['T3'].time))
    bench, thinned = probed_run('T3', every, learn=True, probe_interval_min=1800.0)
    _, chosen = probed_run('T3', range(3, 400, 30), learn=True)
    np.testing.assert_array_equal(errors_of(thinned), errors_of(chosen))
    assert 'OK learning: 14 probes; known: Y to ±' in bench.health()


def test_a_false_probe_is_doubted_aloud_and_a_second_one_that_agrees_is_believed():
    run, wrong = recordings()['T3'], np.array([90.0, 0.0]) * MICRON
    probes = [probe_of(run, row) for row in range(10, 80, 10)]
    probes += [probe_of(run, row, displacement=run.displacement[row] + wrong) for row in (90, 120)]
    bench = bench_with_model(learn=True, **QUICK)
    found = predict(bench, run, range(110), probes=probes)
    assert 'WARN learning: probe at ' in bench.health()
    assert 'is off in Y by +' in bench.health()
    # No further than the band that was published before it.
    moved = np.abs(errors_of(found)[92] - errors_of(found)[90])
    assert moved[0] <= 2.0 * found[90].standard_deviation[0] / MICRON + 0.5
    found = errors_of(predict(bench, run, range(110, 125))) - run.displacement[110:125] / MICRON
    assert found[-1, 0] > 80.0
    assert abs(found[-1, 1]) < 3.0
    assert 'OK learning' in bench.health()


def test_band_shrinks_with_a_probe_and_grows_back():
    run, row = recordings()['T3'], 180
    bench = bench_with_model(learn=True, probe_noise=0.1 * MICRON, **QUICK)
    found = predict(bench, run, range(270), probes=[probe_of(run, row)])
    deviation = np.array([item.standard_deviation for item in found]) / MICRON
    assert (deviation[row + 2] < 0.3 * deviation[row - 1]).all()
    assert (deviation[row + 80] > 1.5 * deviation[row + 2]).all()
    # What has not come into force yet counts as error.
    late = bench_with_model(learn=True, correction_time=3600.0)
    slow = predict(late, run, range(row + 2), probes=[probe_of(run, row)])
    correction = np.abs(errors_of(found)[row + 1] - errors_of(found)[row])
    assert (slow[row].standard_deviation / MICRON >= 0.5 * correction).all()


def restarted(first, run, text='', day=0.0, outputs=('predictor_state', 'thermal_posterior')):
    """Return a predictor that has taken back what another kept."""
    bench = bench_with_model(text, learn=True, correction_time=600.0)
    for output in outputs:
        bench.component.restore(output, first.records(output)[-1])
    if not day:
        bench.push('thermal_reference', reference_of(run))
    return bench


def test_restart_keeps_what_the_probes_said():
    run = recordings()['T3']
    changes = {'learn': True, 'correction_time': 600.0}
    probes = [probe_of(run, row) for row in (30, 60, 88)]
    whole = bench_with_model(**changes)
    wanted = predict(whole, run, range(130), probes=[*probes, probe_of(run, 110)])
    first = bench_with_model(**changes)
    predict(first, run, range(91), probes=probes)
    second = restarted(first, run)
    found = predict(second, run, range(91, 130), probes=[probe_of(run, 110)])
    for one, other in zip(found, wanted[91:], strict=True):
        np.testing.assert_array_equal(one.error, other.error)
        np.testing.assert_array_equal(one.standard_deviation, other.standard_deviation)
    one, other = (bench.records('thermal_posterior')[-1] for bench in (second, whole))
    np.testing.assert_array_equal(one.memory, other.memory)
    assert np.isfinite(whole.records('predictor_state')[-1].state).all()


def test_memory_outlasts_a_restart_and_the_reference():
    run, rows = recordings()['T2'], range(30, 190, 30)
    probes = [probe_of(run, row, displacement=1.4 * run.displacement[row]) for row in rows]
    first = bench_with_model(learn=True, correction_time=600.0)
    predict(first, run, range(10))
    assert first.request('forget', mode=ForgetMode.WIDEN, why='new spindle', by='anna').success
    predict(first, run, range(10, 190), probes=probes)
    second = restarted(first, run, day=1.0, outputs=('thermal_posterior',))
    found, wanted = (errors_of(next_day(bench, run, range(199))) for bench in (second, first))
    np.testing.assert_array_equal(found[3:], wanted[3:])
    truth = 1.4 * run.displacement[:199] / MICRON
    before = np.abs(unprobed('T2', learn=True)[3:199] - truth[3:]).max(axis=0)
    assert (np.abs(found[3:] - truth[3:]).max(axis=0) < 0.6 * before).all()


def test_memory_of_another_model_or_a_damaged_one_is_not_used():
    run = recordings()['T3']
    first = bench_with_model(learn=True)
    predict(first, run, range(91), probes=[probe_of(run, 60)])
    kept = first.records('thermal_posterior')[-1]
    other = bench_with_model(model_text('D0'), learn=True)
    other.component.restore('thermal_posterior', kept)
    other.push('thermal_reference', reference_of(run))
    assert not np.asarray(predict(other, run, range(20))[-1].error == 0.0).any()
    assert not other.records('thermal_posterior')
    spoilt = bench_with_model(learn=True)
    spoilt.component.restore('thermal_posterior', replace(kept, memory=kept.memory[:-1]))
    found = errors_of(predict(spoilt, run, range(20)))
    np.testing.assert_array_equal(found[2:], unprobed(learn=True)[2:20])
    assert 'what was learnt before is lost' in spoilt.health()


def test_without_learning_a_restart_takes_the_model_alone():
    run = recordings()['T3']
    first = bench_with_model(learn=True)
    predict(first, run, range(91), probes=[probe_of(run, 60)])
    second = bench_with_model()
    for output in ('predictor_state', 'thermal_posterior'):
        second.component.restore(output, first.records(output)[-1])
    second.push('thermal_reference', reference_of(run))
    found = errors_of(predict(second, run, range(91, 95)))
    np.testing.assert_allclose(found, unprobed()[91:95])
    plain = second.records('predictor_state')[-1].state
    assert len(plain) == len(trained().start().state)


def test_machine_that_has_changed_is_learnt():
    run = recordings()['T2']
    changed = replace(run, displacement=2.5 * run.displacement)
    bench = bench_with_model(learn=True)
    predict(bench, run, range(120), probes=[probe_of(run, row) for row in range(10, 120, 10)])
    assert 'WARN' not in bench.health()
    rows = range(130, 190, 10)
    errors = predict(bench, run, range(120, 195), probes=[probe_of(changed, row) for row in rows])
    wrong = np.abs(changed.displacement[194] - run.displacement[194]).max() / MICRON
    assert residual(errors[-1:], changed, slice(194, 195)) < 0.2 * wrong


def from_nothing(run, rows, probes=(), **changes):
    """Return a predictor without a model that learns, and its errors."""
    bench = Bench(ThermalPredictor(ThermalPredictorConfig(learn=True, **changes)))
    return bench, predict(bench, run, rows, probes=probes)


def test_all_of_the_error_is_learnt_from_nothing():
    run = recordings()['T3']
    bench, errors = from_nothing(
        run, range(len(run.time)), [probe_of(run, r) for r in HALF_HOURLY]
    )
    assert errors[4].reason == Reason.NO_MODEL
    first, last = errors[5], errors[-1]
    assert first.valid
    assert first.axis == ('X', 'Y', 'Z')
    assert not first.error.any()
    # It begins where the run begins, and knows little far from what was probed.
    assert first.standard_deviation.max() < errors[60].standard_deviation.max()
    assert (last.standard_deviation[1:] < 2.0 * MICRON).all()
    assert last.standard_deviation[0] > 5.0 * MICRON  # X was never probed
    assert last.model.startswith('learnt ')
    columns = [item.error[1:] for item in errors[200:]]
    apart = np.array(columns) / MICRON - run.displacement[200 : len(run.time)] / MICRON
    assert np.sqrt((apart**2).mean()) < 2.0
    text = bench.health()
    assert 'probe due: known: X to ±' in text
    assert 'OK learning: 13 probes' in text


def test_what_was_learnt_from_nothing_outlasts_a_restart():
    run = recordings()['T3']
    probes = [probe_of(run, row) for row in range(30, 90, 10)]
    _, wanted = from_nothing(run, range(130), probes)
    first, _ = from_nothing(run, range(91), probes)
    second = Bench(ThermalPredictor(ThermalPredictorConfig(learn=True)))
    for output in ('predictor_state', 'thermal_posterior'):
        second.component.restore(output, first.records(output)[-1])
    second.push('thermal_reference', reference_of(run))
    found = predict(second, run, range(91, 130))
    np.testing.assert_array_equal(errors_of(found), errors_of(wanted[91:]))


def test_too_many_sensors_are_refused_until_some_are_chosen():
    run = recordings()['T3']
    many = replace(
        run,
        sensor=tuple(f'S{number}' for number in range(90)),
        temperature=np.repeat(run.temperature[:, :1], 90, axis=1),
    )
    bench, errors = from_nothing(many, range(12))
    assert not errors[-1].valid
    assert 'learning from nothing: sensors: expected 1 to 85' in bench.health()


def test_the_screws_of_axes_leave_room_for_fewer_sensors():
    run = recordings()['T3']
    many = replace(
        run,
        sensor=tuple(f'S{number}' for number in range(80)),
        temperature=np.repeat(run.temperature[:, :1], 80, axis=1),
    )
    bench, errors = from_nothing(many, range(12), learn_places=('Y:-0.5:0', 'Z:-0.5:0'))
    assert not errors[-1].valid
    assert 'learning from nothing: sensors: expected 1 to 69' in bench.health()


def test_the_axes_that_are_learnt_can_be_chosen():
    run = recordings()['T3']
    _, errors = from_nothing(run, range(12), learn_axes=['Z'])
    assert errors[-1].axis == ('Z',)


def learnt_bench(rows=range(30, 91, 30)):
    """Return a predictor that has learnt T3 from some probes, and the run."""
    run = recordings()['T3']
    bench = bench_with_model(learn=True, correction_time=600.0)
    predict(bench, run, range(100), probes=[probe_of(run, row) for row in rows])
    return bench, run


def test_going_back_before_a_probe_is_as_if_it_had_never_been():
    bench, run = learnt_bench()
    spared, _ = learnt_bench(range(30, 61, 30))
    answer = bench.request('forget', mode=ForgetMode.UNDO, why='chip', by='anna')
    assert (answer.success, answer.message) == (
        True,
        'back to what was known before the last probe',
    )
    before = bench.records('thermal_error')[-1].error
    found, wanted = (predict(item, run, range(100, 130)) for item in (bench, spared))
    np.testing.assert_allclose(found[-1].error, wanted[-1].error, atol=1e-12)
    np.testing.assert_array_equal(
        bench.records('thermal_posterior')[-1].probes,
        spared.records('thermal_posterior')[-1].probes,
    )
    # It comes into force slowly.
    steps = np.abs(np.diff([before, *[item.error for item in found]], axis=0)).max()
    usual = np.abs(np.diff([item.error for item in wanted], axis=0)).max()
    assert steps <= usual + 1.0 * MICRON


def test_a_changed_machine_is_known_less_and_learnt_faster():
    bench, run = learnt_bench()
    band = bench.records('thermal_error')[-1].standard_deviation
    assert bench.request('forget', mode=ForgetMode.WIDEN, why='new spindle', by='anna').success
    wider = predict(bench, run, range(100, 102))[-1].standard_deviation
    assert (wider > 2.0 * band).all()
    assert bench.records('thermal_posterior')[-1].probes.tolist() == [3, 3]


def test_all_can_be_forgotten_and_a_restart_knows_it():
    bench, run = learnt_bench()
    assert bench.request('forget', mode=ForgetMode.ALL, why='wrong sign', by='anna').success
    assert bench.records('thermal_posterior')[-1].probes.tolist() == [0, 0]
    found = errors_of(predict(bench, run, range(100, 130)))
    np.testing.assert_allclose(found[-1], unprobed(learn=True)[129], atol=1e-9)
    again = restarted(bench, run)
    errors = errors_of(predict(again, run, range(130, 140)))
    np.testing.assert_allclose(errors[-1], unprobed(learn=True)[139], atol=1e-9)


def test_nothing_to_forget_is_refused():
    plain = bench_with_model()
    assert not plain.request('forget', mode=ForgetMode.ALL, why='x', by='anna').success
    bench, _ = learnt_bench(())
    answer = bench.request('forget', mode=ForgetMode.UNDO, why='x', by='anna')
    assert not answer.success
    assert 'no probe to go back before' in answer.message


def test_a_probe_of_the_day_before_cannot_be_undone():
    bench, run = learnt_bench()
    next_day(bench, run, range(10))
    answer = bench.request('forget', mode=ForgetMode.UNDO, why='x', by='anna')
    assert not answer.success
    assert 'none over a restart or a new thermal reference' in answer.message


def test_it_tells_when_a_probe_is_due_and_what_the_last_one_changed():
    run = recordings()['T3']
    rows, probe = range(len(run.time)), probe_of(run, 60)
    bench, _ = from_nothing(run, rows, [probe], learn_axes=run.axis, band_wanted=12 * MICRON)
    told = bench.records('probe_status')
    assert told[0].probed_at == 0
    assert np.isnan(told[0].change).all()
    after = [item for item in told if item.probed_at]
    assert after[0].probed_at == probe.stamp
    assert np.abs(after[0].change).max() > MICRON
    for item in told:
        assert item.due == bool((item.band > 12 * MICRON).any())
        assert item.due == (item.due_at == item.stamp)
        assert ('known' in item.reason or 'probed' in item.reason) == item.due
    # What is foretold in the end comes true.
    quiet = after[5:]  # the correction has come into force
    due = next(item.stamp for item in quiet if item.due)
    foretold = [item for item in quiet if item.due_at > item.stamp and item.stamp < due]
    assert len(foretold) > 20
    assert abs(foretold[-1].due_at - due) < nanoseconds(600.0)
    assert abs(foretold[-20].due_at - due) < nanoseconds(3600.0)


def test_without_learning_nothing_is_told_of_probes():
    bench, _ = probed_run('T3', ())
    assert not bench.records('probe_status')


def test_another_place_of_an_axis_does_not_take_the_place_of_the_first():
    run, row = recordings()['T3'], 60
    one = probe_of(run, row)
    both = replace(
        one,
        axis=(*one.axis, one.axis[0]),
        channel=(*one.channel, f'{one.axis[0]} right'),
        displacement=np.array([*one.displacement, 80 * MICRON]),
        standard_deviation=np.full(len(one.axis) + 1, 0.3 * MICRON),
        position=np.zeros(len(one.axis) + 1),
    )
    rows = range(len(run.time))
    _, wanted = from_nothing(run, rows, [one])
    _, found = from_nothing(run, rows, [both])
    np.testing.assert_array_equal(errors_of(found[5:]), errors_of(wanted[5:]))
