# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A clock that is set ends in a hold and a ramp, then a new series begins."""

from dataclasses import replace

import numpy as np
import pytest
from benches.bridge_bench import ERROR, MICRON, Compensated
from benches.component_bench import Bench, machine_state, readings
from benches.linuxcnc_rig import CYCLE, SCALE, SLEW, Rig
from benches.predictor_bench import (
    START,
    bench_with_model,
    predict,
    recordings,
    reference_of,
    sample_of,
)
from tiers import rest_slow

from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.components.soft.deformation_compensator import DeformationCompensator
from fuzzycnc_ros.components.thermal.sensor_selector import SensorSelector
from fuzzycnc_ros.components.thermal.temperature_acquisition import (
    TemperatureAcquisition,
    TemperatureAcquisitionConfig,
)
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import CompensationState, Reason, Status
from fuzzycnc_ros.runtime.records import SECOND, SensorSelection, nanoseconds

HOUR = 3600.0
STEPS = pytest.mark.parametrize('step', rest_slow([-24 * HOUR, -HOUR, HOUR, 24 * HOUR], 1, 3))


@STEPS
def test_compensator_holds_and_follows_again_in_the_new_series(step):
    rig = Rig(validity_max=30.0)
    rig.time += 10 * HOUR
    compensated = Compensated(rig)
    compensated.run(30)
    wanted = -1e6 * np.array([0.0, *ERROR])
    assert rig.at(wanted)
    rig.set_clock(step)
    compensated.bench.clock_step(step, rig.time)
    compensated.run(3)
    held = compensated.bench.records('compensation')[-1]
    assert held.state == CompensationState.HOLDING
    assert rig.at(wanted)
    compensated.run(30)
    assert compensated.bench.records('compensation')[-1].state == CompensationState.ACTIVE
    assert rig.last.status == OffsetStatus.FOLLOWING
    assert rig.at(wanted)
    assert rig.largest_step <= SLEW * CYCLE + SCALE


@STEPS
def test_compensator_without_a_valid_error_ramps_to_zero(step):
    rig = Rig(validity_max=30.0)
    rig.time += 10 * HOUR
    compensated = Compensated(rig, hold_time=10.0)
    compensated.run(30)
    rig.set_clock(step)
    compensated.bench.clock_step(step, rig.time)
    compensated.run(70, errors=False)
    assert rig.at((0, 0, 0))
    assert rig.largest_step <= SLEW * CYCLE + SCALE


@pytest.mark.parametrize('epoch', rest_slow([5000, 2**61], 0))
def test_forged_read_back_does_not_end_compensation(epoch):
    rig = Rig()
    compensated = Compensated(rig)
    compensated.run(30)
    forged = rig.bench.records('compensation_applied')[-1]
    compensated.bench.push('compensation_applied', _forged(forged, epoch, rig.time))
    compensated.bench.until(rig.time)
    assert f'expected at most 1001 but found {epoch}' in compensated.bench.health()
    compensated.run(30)
    assert compensated.bench.component._epoch == 1
    assert rig.at(-1e6 * np.array([0.0, *ERROR]))


@pytest.mark.parametrize('epoch', rest_slow([5000, 2**61, 2**62], 0))
def test_first_read_back_may_be_forged(epoch):
    """A compensator that has just begun believes it, until the machine shows what is true."""
    rig = Rig()
    rig.run(1.0)
    compensated = Compensated(rig)
    forged = rig.bench.records('compensation_applied')[-1]
    compensated.bench.push('compensation_applied', _forged(forged, epoch, rig.time))
    compensated.bench.until(rig.time)
    compensated.run(40)
    assert rig.last.status == OffsetStatus.FOLLOWING
    assert rig.last.epoch < 10
    assert rig.at(-1e6 * np.array([0.0, *ERROR]))


def _forged(record, epoch, time):
    return replace(record, epoch=epoch, stamp=nanoseconds(time))


@STEPS
def test_reference_stays_as_old_as_it_was(step):
    config = TemperatureAcquisitionConfig(reference_samples=1)
    bench, start = Bench(TemperatureAcquisition(config)), 100 * HOUR
    bench.until(start)
    assert bench.request('set_thermal_reference').success
    for second in range(0, 121, 10):
        bench.give('sensor_readings', readings(start + second, [20.0, 21.0]))
    before = bench.records('thermal_reference')[-1]
    now = start + 300.0 + step
    bench.clock_step(step, now)
    after = bench.records('thermal_reference')[-1]
    assert after.stamp - before.stamp == nanoseconds(step)
    assert after.cold_since - before.cold_since == nanoseconds(step)
    np.testing.assert_array_equal(after.temperature, before.temperature)
    bench.give('machine_state', machine_state(now, cold_since=0))
    for second in range(0, 121, 10):
        bench.give('sensor_readings', readings(now + second, [25.0, 25.0]))
    assert bench.records('thermal_reference')[-1] is after
    assert bench.records('temperatures')[-1].stamp >= nanoseconds(now + 60.0)


@pytest.mark.parametrize('step', [-4 * HOUR, -HOUR, -7.0, 60.0, HOUR, 24 * HOUR])
def test_predictor_goes_on_once_the_same_reference_comes_anew(step):
    """Each node sees a step of its own, so stamps of references differ by a moment."""
    run = recordings()['T2']
    wanted = predict(bench_with_model(), run, range(120))
    bench = bench_with_model()
    predict(bench, run, range(90))
    bench.clock_step(step, START + run.time[89] + step)
    before = bench.give('temperatures', later(sample_of(run, 90), step))
    assert not before[-1].record.valid
    bench.push('thermal_reference', later(reference_of(run), step + 0.003))
    found = []
    for row in range(91, 120):
        emitted = bench.give('temperatures', later(sample_of(run, row), step))
        found += [item.record for item in emitted if item.output == 'thermal_error']
    for one, other in zip(found, wanted[91:], strict=True):
        assert one.valid
        np.testing.assert_allclose(one.error, other.error, atol=0.2 * MICRON)


def test_predictor_of_another_reference_says_that_its_history_is_lost():
    run = recordings()['T2']
    bench = bench_with_model()
    predict(bench, run, range(90))
    bench.clock_step(-HOUR, START + run.time[89] - HOUR)
    other = replace(reference_of(run), temperature=reference_of(run).temperature + 1.0)
    bench.push('thermal_reference', later(other, -HOUR))
    error = bench.give('temperatures', later(sample_of(run, 90), -HOUR))[-1].record
    assert (error.valid, error.reason) == (False, Reason.STATE_LOST)


def test_a_state_of_the_reference_before_is_not_carried_over_a_step():
    run, bench = recordings()['T2'], bench_with_model()
    predict(bench, run, range(90))
    sample = sample_of(run, 90)
    second = replace(reference_of(run), stamp=sample.stamp, temperature=sample.temperature)
    bench.push('thermal_reference', second)
    # It is heard, but nothing is predicted from it yet: all sensors are lost.
    bench.give('temperatures', replace(sample, status=np.full_like(sample.status, Status.MISSING)))
    bench.clock_step(-HOUR, START + run.time[90] - HOUR)
    bench.push('thermal_reference', later(second, -HOUR))
    emitted = bench.give('temperatures', later(sample_of(run, 91), -HOUR))
    (error,) = (item.record for item in emitted if item.output == 'thermal_error')
    np.testing.assert_allclose(error.error, 0.0, atol=MICRON)


def test_reference_from_the_future_is_void():
    """Else it would stay for as long as the clock went back, whatever is asked for."""
    bench = Bench(TemperatureAcquisition(TemperatureAcquisitionConfig(reference_samples=1)))
    old = reference_of(recordings()['T2'])
    bench.component.restore('thermal_reference', old)
    now = START - HOUR
    bench.until(now)
    assert bench.request('set_thermal_reference').success
    for second in range(0, 121, 10):
        bench.give('sensor_readings', readings(now + second, [25.0, 25.0]))
    assert bench.records('thermal_reference')[-1].stamp <= nanoseconds(now + 120)


def later(record, seconds):
    """Return a record with another stamp."""
    return replace(record, stamp=record.stamp + nanoseconds(seconds))


def test_predictor_keeps_its_selection_but_no_history():
    bench = Bench(ThermalPredictor())
    chosen = SensorSelection(
        stamp=SECOND,
        method='',
        cluster=(),
        partition_coefficient=1.0,
        xie_beni=0.0,
        dropped=(),
        calibration=(),
    )
    bench.give('sensor_selection', chosen)
    bench.clock_step(-0.5, 0.5)
    assert bench.component._stream.selection is chosen
    assert bench.component._stream.reference is None


def test_servo_keeps_the_epoch_that_the_drives_know():
    controller = ServoController()
    controller._epoch = 7
    assert controller.renewed(-SECOND)[0]._epoch == 7


@pytest.mark.parametrize('kind', [SensorSelector, DeformationCompensator])
def test_what_rests_on_no_times_goes_on(kind):
    component = kind()
    assert component.renewed(-SECOND) == (component, [])


def test_sources_are_known_after_the_step():
    bench = Bench(TemperatureAcquisition())
    bench.request('sources', input='machine_state', node=['/a', '/b'])
    bench.clock_step(1.0, 1.0)
    assert '/a, /b' in bench.component.sources.refusals['machine_state']
    assert bench.component.machine == 'mill'


def test_doubted_inputs_are_held_at_once():
    rig = Rig()
    compensated = Compensated(rig)
    compensated.run(30)
    assert rig.at(-1e6 * np.array([0.0, *ERROR]))
    for name in ('thermal_error', 'machine_state', 'compensation_applied'):
        compensated.bench.request('sources', input=name, node=['/a', '/b'])
        compensated.run(10)
        command = compensated.bench.records('compensation')[-1]
        assert command.state == CompensationState.HOLDING
        assert f'{name} comes from several nodes' in compensated.bench.health()
        compensated.bench.request('sources', input=name, node=[])
        compensated.run(10)
        assert compensated.bench.records('compensation')[-1].state == CompensationState.ACTIVE
    assert np.abs(rig.path).max() <= 4 * MICRON + SCALE
