# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated machine: duties and ticks, readings and faults, the machine side of compensation."""

import numpy as np
import pytest
from benches.component_bench import Bench

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.machine.simulated_machine_config import DAY_START
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Compensation,
    nanoseconds,
)
from fuzzycnc_ros.simulation.thermal.duties import DUTIES, simulate_duty
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES, MILL_SENSORS

MICRON = 1e-6


def machine_of(**changes) -> SimulatedMachine:
    """Return a machine with some parameters set."""
    return SimulatedMachine(SimulatedMachineConfig(**changes))


def run(machine: SimulatedMachine, ticks: int | None = None) -> dict[str, list]:
    """Tick on; return all records by topic."""
    found: dict[str, list] = {item.name: [] for item in machine.OUTPUTS}
    count = 0
    while machine.next_tick is not None and (ticks is None or count < ticks):
        for emission in machine.tick():
            found[emission.output].append(emission.record)
        count += 1
    return found


def command(time: float, offset, epoch: int = 1, validity: float = 180.0) -> Compensation:
    """Return an offset command for Y and Z [m]."""
    return Compensation(
        stamp=nanoseconds(DAY_START + time),
        frame_id='mill/machine',
        epoch=epoch,
        state=1,
        axis=('Y', 'Z'),
        offset=np.array(offset, dtype=np.float64),
        slope=np.zeros(2),
        reference_position=np.zeros(2),
        at_limit=np.zeros(2, bool),
        slewing=np.zeros(2, bool),
        valid_until=nanoseconds(DAY_START + time + validity),
        source=('thermal_error',),
    )


def test_a_duty_has_its_ticks_and_begins_at_six():
    machine = machine_of(duties=('T2',), tick_period=60.0)
    assert machine.total_ticks == 200
    found = run(machine)
    stamps = [item.stamp for item in found['machine_state']]
    assert stamps == [nanoseconds(DAY_START + 60.0 * k) for k in range(1, 201)]
    assert machine.next_tick is None
    with pytest.raises(RuntimeError, match='all duties are done'):
        list(machine.tick())


@pytest.mark.parametrize(
    ('period', 'duration', 'ticks'),
    [(12.0, 600.0, 50), (7.0, 60.0, 8), (0.1, 30.0, 300), (0.3, 30.0, 100), (60.0, 30.0, 1)],
)
def test_total_is_the_number_of_ticks(period, duration, ticks):
    """Also where the period is no binary fraction."""
    machine = machine_of(duties=('T1', 'T3'), tick_period=period, duty_duration=duration)
    assert machine.total_ticks == 2 * ticks
    assert len(run(machine)['machine_state']) == machine.total_ticks


def test_every_duty_starts_cold_on_its_own_day():
    machine = machine_of(duties=('D0', 'T1'), tick_period=60.0, duty_duration=600.0)
    states = run(machine)['machine_state']
    assert sorted({item.cold_since for item in states}) == [
        nanoseconds(6 * 3600.0),
        nanoseconds(30 * 3600.0),
    ]
    assert all(item.cold_since < item.stamp for item in states)


def test_spindle_follows_the_duty():
    states = run(machine_of(duties=('T1',), tick_period=60.0))['machine_state']
    speeds = np.array([item.spindle_speed for item in states]) * 60 / (2 * np.pi)
    np.testing.assert_allclose(speeds[:60], 2000.0)
    np.testing.assert_array_equal(speeds[60:100], 0.0)
    np.testing.assert_allclose(speeds[100:], 1500.0)
    modes = [item.state for item in states]
    assert modes[0] == MachineMode.RUNNING
    assert modes[70] == MachineMode.ON
    assert all(item.homed and item.offsets_allowed for item in states)


@pytest.mark.parametrize('period', [12.0, 20.0, 60.0])
def test_displacement_is_that_of_the_mill_at_whole_minutes(period):
    """However the machine's ticks divide its time."""
    found = run(machine_of(duties=('T2',), tick_period=period))['displacement']
    truth = simulate_duty(DUTIES['T2'])
    assert [item.stamp for item in found] == [
        nanoseconds(DAY_START + time) for time in truth.time[1:]
    ]
    measured = np.array([item.displacement for item in found])
    residual = measured - truth.displacement[1:]
    # Noise of 0.3 um, and states that are held over the 5 s of the mill's inner step.
    assert np.abs(residual).max() < 5 * 0.3 * MICRON
    assert residual.std() == pytest.approx(0.3 * MICRON, rel=0.15)
    assert found[0].axis == MILL_AXES
    assert not found[0].includes_compensation


def test_readings_are_noisy_but_follow_the_mill():
    found = run(machine_of(duties=('T2',)))['sensor_readings']
    truth = simulate_duty(DUTIES['T2'])
    assert len(found) == 1000
    assert found[0].sensor == MILL_SENSORS
    minute = np.array([item.temperature for item in found[4::5]])
    residual = minute - truth.temperature[1:]
    assert residual.std() == pytest.approx(0.1, rel=0.05)


def test_a_seed_repeats_a_run_and_another_does_not():
    runs = [run(machine_of(seed=seed), ticks=20) for seed in (3, 3, 4)]
    readings = [np.array([item.temperature for item in r['sensor_readings']]) for r in runs]
    np.testing.assert_array_equal(readings[0], readings[1])
    assert not np.array_equal(readings[0], readings[2])


def test_two_days_of_one_duty_have_different_noise():
    machine = machine_of(duties=('T2', 'T2'), duty_duration=600.0)
    found = [item.temperature for item in run(machine)['sensor_readings']]
    assert not np.array_equal(found[0], found[50])


@pytest.mark.parametrize(
    ('fault', 'check'),
    [
        ('T18:dead:300', lambda before, after: np.isnan(after).all()),
        ('T18:stuck:300', lambda before, after: np.ptp(after) == 0.0),
        ('T18:open:300', lambda before, after: (after - before.mean() > 45.0).all()),
        ('T18:jump:300:7', lambda before, after: (np.abs(after - before.mean() - 7) < 2).all()),
        ('T18:drift:300:60', lambda before, after: after[-1] - after[0] > 3.0),
    ],
)
def test_faults_reach_the_readings(fault, check):
    machine = machine_of(sensor_faults=(fault,), duty_duration=600.0)
    found = run(machine)['sensor_readings']
    column = MILL_SENSORS.index('T18')
    values = np.array([item.temperature[column] for item in found])
    assert np.isfinite(values[:24]).all()
    assert check(values[:24], values[25:])
    others = np.delete(np.array([item.temperature for item in found]), column, axis=1)
    healthy = run(machine_of(duty_duration=600.0))['sensor_readings']
    wanted = np.delete(np.array([item.temperature for item in healthy]), column, axis=1)
    np.testing.assert_array_equal(others, wanted)
    statuses = {item.status[column] for item in found[25:]}
    assert statuses == ({1} if 'dead' in fault else {0})


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'duties': ('T9',)}, r'duties: expected names among .* but found T9'),
        ({'duties': ()}, r'duties: .* but found none'),
        ({'sensor_faults': ('T18:melted:0',)}, r'expected one of dead, stuck, .* found .melted'),
        ({'sensor_faults': ('T99:dead:0',)}, r'expected sensors among T1 to T76 but found T99'),
        ({'sensor_faults': ('T18',)}, r"sensor fault: expected sensor:kind:start.*found 'T18'"),
    ],
)
def test_unknown_duty_or_fault_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        machine_of(**changes)


def drive(bench: Bench, ticks: int) -> list[Emission]:
    """Tick on, commands first, as a host does."""
    found: list[Emission] = []
    for _ in range(ticks):
        stamp = bench.component.next_tick
        bench.until(stamp * 1e-9)
        found += list(bench.component.tick())
    return found


def offsets(emissions: list[Emission]) -> np.ndarray:
    """Return the offsets in force after each tick, shape (ticks, 2) [m]."""
    return np.array([e.record.offset for e in emissions if e.output == 'compensation_applied'])


def test_offsets_are_applied_within_the_machines_own_slew_limit():
    bench = Bench(machine_of(tick_period=1.0))
    drive(bench, 1)
    bench.push('compensation', command(1.0, (10 * MICRON, -4 * MICRON)))
    moved = offsets(drive(bench, 60))
    steps = np.abs(np.diff(moved, axis=0))
    assert steps.max() <= 0.5 * MICRON * (1 + 1e-9)
    np.testing.assert_allclose(moved[-1], [10 * MICRON, -4 * MICRON])


def test_offsets_beyond_the_machines_own_limit_are_cut_and_flagged():
    bench = Bench(machine_of(tick_period=1.0, validity_max=1000.0))
    drive(bench, 1)
    bench.push('compensation', command(1.0, (90 * MICRON, 0.0), validity=1000.0))
    found = drive(bench, 200)
    last = [e.record for e in found if e.output == 'compensation_applied'][-1]
    np.testing.assert_allclose(last.offset, [60 * MICRON, 0.0])
    assert last.at_limit.tolist() == [True, False]
    assert 'Y cut at the limit of 60 um' in last.reason


def test_offsets_go_to_zero_by_themselves_when_the_command_expires():
    bench = Bench(machine_of(tick_period=1.0))
    drive(bench, 1)
    bench.push('compensation', command(1.0, (10 * MICRON, 0.0), validity=60.0))
    moved = offsets(drive(bench, 60 + 25))
    assert moved[50, 0] == pytest.approx(10 * MICRON)
    np.testing.assert_array_equal(moved[-1], 0.0)
    assert np.abs(np.diff(moved, axis=0)).max() <= 0.5 * MICRON * (1 + 1e-9)
    last = next(e.record for e in drive(bench, 1) if e.output == 'compensation_applied')
    assert last.status == OffsetStatus.EXPIRED
    assert 'expired' in bench.health()


def test_read_back_says_why_a_command_was_refused():
    bench = Bench(machine_of(tick_period=1.0))
    drive(bench, 1)
    bench.push('compensation', command(1.0, (1 * MICRON, 0.0), epoch=5))
    drive(bench, 1)
    bench.push('compensation', command(2.0, (30 * MICRON, 0.0), epoch=4))
    found = drive(bench, 30)
    last = [e.record for e in found if e.output == 'compensation_applied'][-1]
    assert last.status == OffsetStatus.REFUSED
    assert last.epoch == 5
    assert 'expected epoch 5 or higher but found 4' in last.reason
    assert last.offset[0] == pytest.approx(1 * MICRON)
    assert 'WARN compensation: expected epoch 5' in bench.health()


def test_displacement_does_not_contain_the_compensation():
    """It is the ground truth that predictions are judged against."""
    bench, plain = Bench(machine_of(tick_period=60.0)), Bench(machine_of(tick_period=60.0))
    drive(bench, 1)
    drive(plain, 1)
    bench.push('compensation', command(60.0, (20 * MICRON, 20 * MICRON)))
    for one, other in zip(drive(bench, 5), drive(plain, 5), strict=True):
        if one.output == 'displacement':
            np.testing.assert_array_equal(one.record.displacement, other.record.displacement)


def test_all_records_of_a_tick_carry_its_stamp():
    machine = machine_of(tick_period=12.0)
    for number in range(1, 11):
        stamps = {emission.record.stamp for emission in machine.tick()}
        assert stamps == {nanoseconds(DAY_START) + number * 12 * SECOND}


def test_frames_are_those_of_the_machine():
    machine = machine_of()
    machine.machine = 'mill_7'
    frames = {e.output: e.record.frame_id for e in [*machine.tick(), *list(machine.tick())]}
    assert frames['sensor_readings'] == 'mill_7/machine'
    assert frames['machine_state'] == 'mill_7/machine'
    run_on = run(machine, ticks=10)
    assert run_on['displacement'][0].frame_id == 'mill_7/workpiece'
