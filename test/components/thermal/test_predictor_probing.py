# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Thermal predictor: what probes change, which are refused, what a restart keeps."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benches.component_bench import applied
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

from fuzzycnc_ros.core.thermal.fit import train_model
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.runtime.records import nanoseconds

KINDS = pytest.mark.parametrize('kind', ['offset', 'kalman'])
QUICK = {'correction_time': 60.0}
"""A correction that is in force with the next sample."""
HALF_HOURLY = range(30, 400, 30)


@cache
def unprobed(duty: str = 'T3', *names: str) -> np.ndarray:
    """Return what a model publishes for a duty without probes, rows from the third on [um]."""
    run = recordings()[duty]
    bench = bench_with_model(model_text(*names))
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
    assert 'probing' not in bench.health()


@KINDS
def test_probes_bound_the_residual_of_a_model_of_one_run(kind):
    run, text = recordings()['T3'], model_text('D0')
    before = np.abs(unprobed('T3', 'D0') - run.displacement / MICRON)[2:].max()
    _, errors = probed_run('T3', HALF_HOURLY, text, probing=kind)
    assert residual(errors[2:], run, slice(2, None)) < min(0.7 * before, 4.5)


def test_reset_is_in_force_a_minute_after_the_probe():
    run, row = recordings()['T3'], 100
    _, errors = probed_run('T3', [row], probing='offset', **QUICK)
    found = errors_of(errors) - unprobed()
    offset = run.displacement[row] / MICRON - unprobed()[row]
    assert np.abs(offset).max() > 0.3
    assert np.nanmax(np.abs(found[: row + 1])) == 0.0
    np.testing.assert_allclose(found[row + 1 :], np.tile(offset, (len(found) - row - 1, 1)))


@KINDS
def test_correction_never_steps(kind):
    run, row = recordings()['T3'], 100
    probe = probe_of(run, row, displacement=run.displacement[row] + 8.0 * MICRON)
    bench = bench_with_model(probing=kind, correction_time=600.0)
    errors = predict(bench, run, range(row + 30), probes=[probe])
    found = errors_of(errors) - unprobed()[: row + 30]
    whole = np.abs(found[-1])
    assert (whole > 5.0).all()
    steps = np.abs(np.diff(found[2:], axis=0))
    assert (steps <= 0.11 * whole + 1e-9).all()
    assert steps[: row - 2].max() == 0.0
    assert bench.health().count('probing') == 1


def test_probe_between_samples_is_compared_with_what_was_predicted_then():
    run, row = recordings()['T3'], 63  # the spindle has just changed its speed
    at_half = 0.5 * (unprobed()[row] + unprobed()[row + 1])
    probe = probe_of(run, row, later=30.0, displacement=(at_half + 2.0) * MICRON)
    bench = bench_with_model(probing='offset')
    found = errors_of(predict(bench, run, range(70), probes=[probe])) - unprobed()[:70]
    assert np.abs(unprobed()[row + 1] - unprobed()[row]).max() > 0.2
    np.testing.assert_allclose(found[-1], [2.0, 2.0])


def test_stream_of_displacements_is_thinned_to_an_interval():
    every = range(len(recordings()['T3'].time))
    bench, thinned = probed_run('T3', every, probing='offset', probe_interval_min=1800.0)
    _, chosen = probed_run('T3', range(3, 400, 30), probing='offset')
    np.testing.assert_array_equal(errors_of(thinned), errors_of(chosen))
    assert 'OK probing: offset: 14 probes used' in bench.health()


def test_channels_are_probed_one_by_one():
    run, row = recordings()['T3'], 100
    probes = [
        probe_of(
            run,
            row,
            later=20.0 * number,
            axis=(axis,),
            channel=('probe',),
            displacement=run.displacement[row, [number]],
            standard_deviation=np.array([np.nan]),
        )
        for number, axis in enumerate(run.axis)
    ]
    bench = bench_with_model(probing='offset', probe_interval_min=10.0, **QUICK)
    found = errors_of(predict(bench, run, range(row + 3), probes=probes)) - unprobed()[: row + 3]
    before, after = unprobed()[row : row + 2]
    then = before + (after - before) * np.array([0.0, 20.0 / 60.0])
    np.testing.assert_allclose(found[-1], run.displacement[row] / MICRON - then)


def test_compensation_that_was_active_is_taken_off():
    run, row, offset = recordings()['T3'], 100, np.array([-7.0, 5.0]) * MICRON
    bare = probe_of(run, row, later=-30.0)
    plain = bench_with_model(probing='offset')
    wanted = errors_of(predict(plain, run, range(110), probes=[bare]))
    bench = bench_with_model(probing='offset')
    for later, share in ((-42.0, 0.96), (-18.0, 1.04)):
        bench.push('compensation_applied', applied(START + run.time[row] + later, share * offset))
    probe = replace(bare, displacement=bare.displacement + offset, includes_compensation=True)
    found = errors_of(predict(bench, run, range(110), probes=[probe]))
    assert np.abs(wanted[-1] - unprobed()[109]).max() > 0.3
    np.testing.assert_allclose(found, wanted, atol=1e-9)


READ_BACKS = {
    'none': ((), 'no read-back (compensation_applied) tells how much'),
    'before': (((-5.0, 0.0),), 'before and after it'),
    'rare': (((-100.0, 0.0), (0.0, 0.0)), 'read-backs are 100 s apart, more than 60 s'),
    'moving': (((-12.0, 0.0), (0.0, 2e-6)), 'compensation of Y moved by 2.0 um'),
}


@pytest.mark.parametrize('case', READ_BACKS)
def test_probe_with_compensation_that_is_not_known_is_refused(case):
    read_backs, text = READ_BACKS[case]
    run, row = recordings()['T3'], 100
    bench = bench_with_model(probing='offset')
    for later, offset in read_backs:
        time = START + run.time[row] + later
        bench.push('compensation_applied', applied(time, (offset, offset)))
    probe = probe_of(run, row, later=-5.0, includes_compensation=True)
    if case == 'before':
        probe = probe_of(run, row, includes_compensation=True)
    found = errors_of(predict(bench, run, range(110), probes=[probe]))
    np.testing.assert_array_equal(found, unprobed()[:110])
    assert text in bench.health()
    assert 'WARN probe: probe at ' in bench.health()


def test_millimetres_are_refused():
    run = recordings()['T3']
    probe = probe_of(run, 100, displacement=run.displacement[100] * 1e3)
    bench = bench_with_model(probing='offset')
    found = errors_of(predict(bench, run, range(110), probes=[probe]))
    np.testing.assert_array_equal(found, unprobed()[:110])
    assert 'are displacements in m?' in bench.health()


@KINDS
def test_outlier_is_rejected_aloud_and_a_second_one_that_agrees_is_taken(kind):
    run = recordings()['T3']
    probes = [probe_of(run, 60)] + [
        probe_of(run, row, displacement=run.displacement[row] + [40.0 * MICRON, 0.0])
        for row in (90, 120)
    ]
    bench = bench_with_model(probing=kind, **QUICK)
    found = errors_of(predict(bench, run, range(110), probes=probes)) - unprobed()[:110]
    assert 'WARN probing: probe at ' in bench.health()
    assert 'misses the model in Y by +' in bench.health()
    assert np.abs(found[-1]).max() < 5.0
    found = errors_of(predict(bench, run, range(110, 125))) - unprobed()[110:125]
    assert found[-1, 0] > 35.0
    assert abs(found[-1, 1]) < 5.0
    assert 'OK probing' in bench.health()


@KINDS
def test_deviation_shrinks_with_a_probe_and_grows_back(kind):
    run, text, row = recordings()['T3'], model_text('D0'), 180
    plain = bench_with_model(text)
    usual = np.array([e.standard_deviation for e in predict(plain, run, range(270))])
    assert (usual[row : row + 10] > 0.85 * MICRON).all()  # far from its training
    bench = bench_with_model(text, probing=kind, probe_noise=0.1 * MICRON, **QUICK)
    found = predict(bench, run, range(270), probes=[probe_of(run, row)])
    deviation = np.array([item.standard_deviation for item in found])
    np.testing.assert_array_equal(deviation[:row], usual[:row])
    assert (deviation[row + 1] < 0.5 * usual[row + 1]).all()
    assert (np.diff(deviation[row + 1 : row + 8], axis=0) > 0.0).all()
    # Long after a probe the model is known as well as before it, and no worse.
    assert (deviation[row + 80 :] <= usual[row + 80 :]).all()
    assert (deviation[row + 80 :] >= 0.6 * usual[row + 80 :]).all()
    # What has not come into force yet counts as error.
    correction = np.abs(errors_of(found)[row + 1] - unprobed('T3', 'D0')[row + 1]) * MICRON
    assert (deviation[row] >= 0.9 * correction).all()


@KINDS
def test_restart_keeps_what_the_probes_said(kind):
    run = recordings()['T3']
    changes = {'probing': kind, 'adaptation': 0.1, 'correction_time': 600.0}
    probes = [probe_of(run, row) for row in (30, 60, 88)]
    whole = bench_with_model(**changes)
    wanted = predict(whole, run, range(130), probes=[*probes, probe_of(run, 110)])
    first = bench_with_model(**changes)
    predict(first, run, range(91), probes=probes)
    second = bench_with_model(**changes)
    second.component.restore('predictor_state', first.records('predictor_state')[-1])
    second.push('thermal_reference', reference_of(run))
    found = predict(second, run, range(91, 130), probes=[probe_of(run, 110)])
    for one, other in zip(found, wanted[91:], strict=True):
        np.testing.assert_allclose(one.error, other.error, rtol=1e-12)
        np.testing.assert_allclose(one.standard_deviation, other.standard_deviation, rtol=1e-12)
    assert np.isfinite(whole.records('predictor_state')[-1].state).all()


def test_checkpoint_of_another_kind_of_probing_serves_the_model_alone():
    run = recordings()['T3']
    first = bench_with_model(probing='kalman')
    predict(first, run, range(91), probes=[probe_of(run, 60)])
    second = bench_with_model()
    second.component.restore('predictor_state', first.records('predictor_state')[-1])
    second.push('thermal_reference', reference_of(run))
    found = errors_of(predict(second, run, range(91, 95)))
    np.testing.assert_allclose(found, unprobed()[91:95])
    plain = second.records('predictor_state')[-1].state
    assert len(plain) == len(trained().start().state)


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


def test_new_reference_forgets_the_offset():
    run = recordings()['T3']
    bench, _ = probed_run('T3', HALF_HOURLY, probing='kalman')
    found = errors_of(next_day(bench, run, range(60)))
    np.testing.assert_array_equal(found[2:], unprobed()[2:60])


def test_probe_from_before_the_reference_is_not_used():
    run, bench = recordings()['T3'], bench_with_model(probing='offset')
    early = probe_of(run, 1, displacement=np.full(2, 5.0 * MICRON))
    np.testing.assert_array_equal(
        errors_of(predict(bench, run, range(20), probes=[early])), unprobed()[:20]
    )


def changed(run: ThermalRun) -> ThermalRun:
    return replace(run, displacement=1.4 * run.displacement)


def test_machine_that_has_changed_asks_for_training_until_it_has_a_new_model():
    run = changed(recordings()['T2'])
    bench = bench_with_model(probing='kalman', swap_time=60.0)
    predict(bench, run, range(180), probes=[probe_of(run, row) for row in range(30, 180, 30)])
    text = bench.health()
    assert 'WARN drift: the model no longer fits the machine, train it anew' in text
    assert 'standard deviations over' in text
    runs = [changed(recordings()[name]) for name in ('D0', 'D0b', 'T1')]
    fitting = train_model(runs, candidates=('stable_grey',)).to_json()
    assert bench.request('use_model', model=fitting).success
    predict(bench, run, range(180, 190))
    assert 'OK probing' in bench.health()
    assert 'drift' not in bench.health()


def test_machine_as_trained_asks_for_nothing():
    bench, _ = probed_run('T2', range(30, 200, 30), probing='kalman')
    assert 'drift' not in bench.health()


def test_adaptation_learns_a_lasting_gain_within_its_bound():
    run = recordings()['T2']
    rows = range(30, 200, 30)
    probes = [probe_of(run, row, displacement=1.2 * run.displacement[row]) for row in rows]
    bench = bench_with_model(adaptation=0.15)
    predict(bench, run, range(len(run.time)), probes=probes)
    found = errors_of(next_day(bench, run, range(len(run.time)), probes))
    gain = found[5:] / unprobed('T2')[5:] - 1.0
    np.testing.assert_allclose(gain[0], gain[25], rtol=1e-6)  # learnt the day before
    assert (gain[0] > 0.05).all()
    assert (gain <= 0.15 + 1e-9).all()
    steps = np.abs(np.diff(gain, axis=0)).max()
    assert steps <= 0.15


def test_adaptation_outlasts_a_restart_and_the_reference():
    run, rows = recordings()['T2'], range(30, 200, 30)
    probes = [probe_of(run, row, displacement=1.2 * run.displacement[row]) for row in rows]
    first = bench_with_model(adaptation=0.15)
    predict(first, run, range(190), probes=probes)
    second = bench_with_model(adaptation=0.15)
    second.component.restore('predictor_state', first.records('predictor_state')[-1])
    found, wanted = (errors_of(next_day(bench, run, range(30))) for bench in (second, first))
    np.testing.assert_array_equal(found, wanted)
    assert np.abs(found[2:] - unprobed('T2')[2:30]).max() > 0.3


def test_probe_of_what_is_not_predicted_is_refused_aloud():
    run = recordings()['T3']
    probe = probe_of(run, 60, axis=('X', 'X'), channel=('A', 'B'))
    bench = bench_with_model(probing='offset')
    found = errors_of(predict(bench, run, range(70), probes=[probe]))
    np.testing.assert_array_equal(found, unprobed()[:70])
    assert 'is not used: its channels are not predicted' in bench.health()


@KINDS
def test_adaptation_and_probing_do_not_correct_twice(kind):
    run, rows = recordings()['T2'], range(30, 200, 30)
    probes = [probe_of(run, row, displacement=1.2 * run.displacement[row]) for row in rows]
    both, alone = (
        errors_of(
            predict(bench_with_model(probing=kind, **changes), run, range(199), probes=probes)
        )
        for changes in ({'adaptation': 0.3, **QUICK}, QUICK)
    )
    truth = 1.2 * run.displacement[2:199] / MICRON
    worst = [np.abs(found[2:] - truth).max() for found in (both, alone)]
    assert worst[0] <= worst[1] + 0.5
    # Right after a probe both are where it was measured.
    for row in rows[1:]:
        assert np.abs(both[row + 1] - truth[row - 1]).max() < 2.0


def test_adaptation_leaves_a_model_that_fits():
    run = recordings()['T2']
    _, errors = probed_run('T2', range(30, 200, 30), adaptation=0.1)
    worst = np.abs(unprobed('T2')[2:] - run.displacement[2:] / MICRON).max()
    assert residual(errors[2:], run, slice(2, None)) <= worst + 0.5


@KINDS
def test_probe_whose_deviation_says_nothing_is_not_used(kind):
    """Its square would overflow in the state of a filter that is published."""
    run = recordings()['T3']
    told = bench_with_model(probing=kind, **QUICK)
    vague = replace(probe_of(run, 30), standard_deviation=np.full(2, 1e300))
    errors = predict(told, run, range(40), probes=[vague])
    plain = predict(bench_with_model(probing=kind, **QUICK), run, range(40))
    np.testing.assert_array_equal(errors_of(errors), errors_of(plain))
    assert np.isfinite(told.records('predictor_state')[-1].state).all()
