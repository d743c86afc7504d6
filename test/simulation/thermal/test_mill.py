# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.simulation.thermal.duties import (
    DUTIES,
    Duty,
    DutyBlock,
    record_run,
    record_runs,
    simulate_duty,
)
from fuzzycnc_ros.simulation.thermal.mill import (
    MILL_CAPACITY,
    MILL_LOSS,
    MILL_NODES,
    MILL_SENSORS,
    MILL_STEP,
    RPM,
    ThermalMill,
    mill_displacement,
    mill_step,
)
from fuzzycnc_ros.simulation.thermal.sensor_faults import SensorFault

SPEED = 1500 * RPM


def mill(**changes):
    return ThermalMill(**{'base': 20.0, 'amplitude': 2.0, 'phase_hours': 0.0, **changes})


def states(machine):
    return np.concatenate(
        [machine.node_temperatures, machine.sensor_temperatures(), machine.displacement()]
    )


@pytest.mark.parametrize(
    ('name', 'minutes'), [('D0', 200), ('D0b', 200), ('T1', 200), ('T2', 200), ('T3', 400)]
)
def test_duties_last_as_long_as_their_blocks(name, minutes):
    assert sum(block.duration for block in DUTIES[name].blocks) == 60.0 * minutes


def test_refusals_leave_the_mill_as_it_was():
    machine = mill()
    machine.advance(60.0, SPEED)
    before = states(machine)
    for duration in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match='duration: expected 0 s or more'):
            machine.advance(duration, SPEED)
    for speed in (np.nan, np.inf, 30_000 * RPM):
        with pytest.raises(ValueError, match='spindle_speed: expected a speed within 24000 rpm'):
            machine.advance(60.0, speed)
    assert machine.time == 60.0
    np.testing.assert_array_equal(states(machine), before)


@pytest.mark.parametrize('name', ['base', 'amplitude', 'phase_hours'])
def test_ambient_must_be_finite(name):
    with pytest.raises(ValueError, match=name):
        mill(**{name: np.nan})


@pytest.mark.parametrize('ticks', [[60.0], [12.0] * 5, [5.0] * 12, [1.0] * 60, [0.1] * 600])
def test_a_minute_is_the_same_however_it_is_cut(ticks):
    whole, cut = mill(), mill()
    whole.advance(60.0, SPEED)
    for tick in ticks:
        cut.advance(tick, SPEED)
    assert cut.time == whole.time == 60.0
    np.testing.assert_array_equal(states(cut), states(whole))


@given(cuts=st.lists(st.integers(1, 40_000), min_size=1, max_size=12))
@settings(max_examples=30)
def test_states_depend_on_the_speed_over_time_alone(cuts):
    whole, cut = mill(), mill()
    total = sum(cuts)
    whole.advance(total / 1000, SPEED)
    for milliseconds in cuts:
        cut.advance(milliseconds / 1000, SPEED)
    np.testing.assert_array_equal(states(cut), states(whole))


def test_states_hold_between_the_internal_steps():
    machine = mill()
    machine.advance(10.0, SPEED)
    held = states(machine)
    machine.advance(4.999, SPEED)
    np.testing.assert_array_equal(states(machine), held)
    machine.advance(0.001, SPEED)
    assert np.any(states(machine) != held)


def test_a_step_runs_at_the_speed_at_its_end():
    late, other = mill(), mill()
    late.advance(2.0, 0.0)
    late.advance(3.0, SPEED)
    other.advance(5.0, SPEED)
    np.testing.assert_array_equal(states(late), states(other))


def test_step_conserves_energy():
    """Heat stored in one step = sources - losses, summed over all nodes."""
    temperatures = 20.0 + np.linspace(0.0, 12.0, len(MILL_NODES))
    u, ambient = 1.5, 23.0
    after = mill_step(SPEED).advance(temperatures, ambient)
    stored = MILL_CAPACITY @ (after - temperatures) / MILL_STEP
    loss = dict(zip(MILL_NODES, MILL_LOSS, strict=True))
    loss['tn'] *= 1 + 1.2 * u
    loss['sh'] *= 1 + 0.3 * u
    loss['mo'] *= 1 + 0.5 * u
    lost = sum(loss[n] * (t - ambient) for n, t in zip(MILL_NODES, after, strict=True))
    friction = sum(
        watt * u**1.5 * np.exp(-0.012 * (temperatures[MILL_NODES.index(name)] - 20.0))
        for name, watt in (('fb', 55.0), ('rb', 35.0))
    )
    source = friction + 40 * u + 25 * u**2 + 12 + 15
    assert stored == pytest.approx(source - lost, rel=1e-9)


def test_a_cold_mill_in_a_constant_room_stays_as_it_is():
    machine = mill(amplitude=0.0)
    machine.advance(3600.0, 0.0)
    np.testing.assert_allclose(machine.node_temperatures, 20.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(machine.displacement(), 0.0, atol=1e-13)


@given(rpm=st.floats(100.0, 3000.0))
@settings(max_examples=20, deadline=None)
def test_faster_means_warmer_and_direction_does_not_matter(rpm):
    slow, fast, reverse = mill(), mill(), mill()
    for machine, factor in ((slow, 1.0), (fast, 1.1), (reverse, -1.0)):
        machine.advance(600.0, factor * rpm * RPM)
    front = MILL_NODES.index('fb')
    assert fast.node_temperatures[front] > slow.node_temperatures[front] > 20.0
    np.testing.assert_array_equal(states(reverse), states(slow))


def test_displacement_of_no_rise_is_zero():
    np.testing.assert_array_equal(mill_displacement(np.zeros(len(MILL_NODES))), [0.0, 0.0])


def test_readings_are_seeded_and_independent_of_the_displacement():
    one, two, other = mill(seed=3), mill(seed=3), mill(seed=4)
    for _ in range(4):
        two.measure_displacement()
    first = one.read()
    np.testing.assert_array_equal(two.read(), first)
    assert np.all(other.read() != first)
    assert one.measure_displacement() != pytest.approx(two.measure_displacement(), abs=1e-12)


def test_noise_has_the_stated_size():
    machine = mill()
    readings = np.array([machine.read() for _ in range(200)]) - machine.sensor_temperatures()
    assert readings.std() == pytest.approx(0.1, rel=0.03)
    displacement = np.array([machine.measure_displacement() for _ in range(2000)])
    assert displacement.std() == pytest.approx(0.3e-6, rel=0.05)
    rng = np.random.default_rng(0)
    given_rng = machine.read(np.random.default_rng(0)) - machine.sensor_temperatures()
    np.testing.assert_allclose(given_rng, rng.normal(0.0, 0.1, 76), atol=1e-12)


def test_faults_show_in_readings_only():
    machine = mill(seed=1, faults=[SensorFault('T5', 'dead', 60.0)])
    healthy = mill(seed=1)
    for m in (machine, healthy):
        m.advance(60.0, SPEED)
    reading, expected = machine.read(), healthy.read()
    assert np.isnan(reading[4])
    np.testing.assert_array_equal(np.delete(reading, 4), np.delete(expected, 4))
    assert np.isfinite(machine.sensor_temperatures()).all()


def test_streaming_equals_the_recording():
    duty = DUTIES['T2']
    run, machine = simulate_duty(duty), duty.mill()
    for k in range(1, 5 * 130 + 1):
        machine.advance(12.0, duty.spindle_speed(machine.time))
        if k % 5 == 0:
            np.testing.assert_array_equal(machine.displacement(), run.displacement[k // 5])
    np.testing.assert_array_equal(machine.sensor_temperatures(), run.temperature[130])


def test_recordings_do_not_depend_on_the_names_asked_for():
    alone, all_runs = record_run('T3', 2), record_runs(seed=2)['T3']
    np.testing.assert_array_equal(alone.temperature, all_runs.temperature)
    np.testing.assert_array_equal(record_run(DUTIES['T3'], 2).displacement, alone.displacement)
    assert alone.sensor == MILL_SENSORS
    assert np.any(record_run('T3', 3).temperature != alone.temperature)


def test_faults_in_a_recording():
    faults = [SensorFault('T18', 'drift', 3600.0, 2.0), SensorFault('T1', 'dead', 60.0)]
    healthy, faulty = record_run('T2', 5), record_run('T2', 5, faults=faults)
    np.testing.assert_allclose(
        faulty.temperature[:, 17] - healthy.temperature[:, 17],
        2.0 * np.maximum(healthy.time - 3600.0, 0.0) / 3600.0,
        atol=1e-12,
    )
    assert np.isnan(faulty.temperature[1:, 0]).all()
    assert faulty.temperature[0, 0] == healthy.temperature[0, 0]
    np.testing.assert_array_equal(faulty.displacement, healthy.displacement)


def test_own_duty_is_recorded_with_seeded_noise():
    duty = Duty('warm_up', (DutyBlock(SPEED, 600.0),), 22.0, 0.0, 0.0)
    run = record_run(duty, 1)
    np.testing.assert_array_equal(run.temperature, record_run(duty, 1).temperature)
    assert len(run.time) == 11
    assert len(simulate_duty(duty, 12.0).time) == 51


@pytest.mark.parametrize('interval', [7.0, 0.0, -60.0])
def test_interval_that_does_not_divide_a_block_is_refused(interval):
    with pytest.raises(ValueError, match='divisor'):
        simulate_duty(DUTIES['D0'], interval)


def test_unknown_duty_is_named():
    with pytest.raises(ValueError, match='D0, D0b, T1, T2, T3 but found T9'):
        record_runs(['T9'])


def test_bad_blocks_are_refused():
    with pytest.raises(ValueError, match='spindle_speed'):
        DutyBlock(np.nan, 60.0)
    with pytest.raises(ValueError, match='duration'):
        DutyBlock(SPEED, 0.0)
