# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The body of the simulated mill: heated by a controller's spindle, moved by its offsets."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import Bench, applied, machine_state

from fuzzycnc_ros.components.machine.simulated_body import SimulatedBody, SimulatedBodyConfig
from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.machine.simulated_machine_config import DAY_START
from fuzzycnc_ros.simulation.thermal.duties import DUTIES
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES

MICRON = 1e-6
SPEED = DUTIES['T2'].spindle_speed(0.0)


def body_of(**changes) -> Bench:
    """Return a body with some parameters set."""
    return Bench(SimulatedBody(SimulatedBodyConfig(**changes)))


def tick(bench: Bench, count: int = 1) -> None:
    """Let it tick."""
    for _ in range(count):
        bench.until(1e-9 * bench.component.next_tick)
        bench.emitted += bench.component.tick()


def state(speed: float):
    """Return the state of a controller at the beginning."""
    return machine_state(DAY_START, spindle_speed=speed)


def test_without_offsets_it_is_the_simulated_machine():
    """The same heat, noise and stamps, where the controller's spindle turns as the duty's does."""
    bench = body_of(seed=3, duration=1200.0)
    bench.push('machine_state', state(SPEED))
    tick(bench, 100)
    assert bench.component.next_tick is None
    machine = SimulatedMachine(SimulatedMachineConfig(seed=3, duty_duration=1200.0))
    found = [item for _ in range(100) for item in machine.tick()]
    for topic, field in (('displacement', 'displacement'), ('sensor_readings', 'temperature')):
        own = bench.records(topic)
        other = [item.record for item in found if item.output == topic]
        assert [item.stamp for item in own] == [item.stamp for item in other]
        np.testing.assert_array_equal(
            [getattr(item, field) for item in own], [getattr(item, field) for item in other]
        )


def test_displacement_is_thermal_error_plus_offset_in_force():
    plain, moved = body_of(), body_of()
    for bench in (plain, moved):
        bench.push('machine_state', state(SPEED))
        tick(bench, 5)
    # Z alone, and an axis that the mill does not have: Y stays as it was.
    offset = replace(
        applied(DAY_START + 61.0, (0.0, 0.0)),
        axis=('X', 'Z'),
        offset=np.array([9.0, -7.0]) * MICRON,
    )
    moved.push('compensation_applied', offset)
    for bench in (plain, moved):
        tick(bench, 10)
    change = [
        b.displacement - a.displacement
        for a, b in zip(plain.records('displacement'), moved.records('displacement'), strict=True)
    ]
    wanted = [[0.0, 0.0], [0.0, -7.0 * MICRON], [0.0, -7.0 * MICRON]]
    np.testing.assert_allclose(change, wanted, atol=1e-12)
    assert MILL_AXES == ('Y', 'Z')
    assert all(item.includes_compensation for item in moved.records('displacement'))


def test_offset_acts_from_its_stamp_on():
    bench = body_of(displacement_interval=12.0)
    tick(bench)
    bench.push('compensation_applied', applied(DAY_START + 30.0, (50 * MICRON, 0.0)))
    tick(bench, 2)
    along = [item.displacement[0] for item in bench.records('displacement')]
    assert along[1] < 10 * MICRON
    assert along[2] > 40 * MICRON


@pytest.mark.parametrize('speed', [float('nan'), 1e9])
def test_speed_that_means_nothing_leaves_the_last_one(speed):
    bench = body_of()
    assert 'no machine_state of a controller yet' in bench.health()
    bench.push('machine_state', state(-SPEED))
    tick(bench)
    bench.push('machine_state', machine_state(DAY_START + 20.0, spindle_speed=speed))
    tick(bench)
    assert f'spindle at {SPEED:.1f} rad/s' in bench.health()


@pytest.mark.parametrize('value', [float('nan'), float('inf'), 1.0])
def test_offset_that_means_nothing_leaves_the_last_one(value):
    bench = body_of()
    bench.push('machine_state', state(0.0))
    bench.push('compensation_applied', applied(DAY_START + 1.0, (3 * MICRON, 0.0)))
    bench.push('compensation_applied', applied(DAY_START + 2.0, (value, 0.0)))
    tick(bench)
    values = next(item.values for item in bench.component.health())
    assert values['offset Y [um]'] == '3.00'


def test_its_time_ends_with_the_duty():
    bench = body_of(duty='T2', tick_period=60.0)
    tick(bench, 200)
    assert bench.component.next_tick is None
    with pytest.raises(RuntimeError, match='the time is over'):
        next(bench.component.tick())


def test_at_least_one_tick():
    bench = body_of(duration=1.0)
    tick(bench)
    assert bench.component.next_tick is None


def test_malformed_sensor_fault_is_refused():
    with pytest.raises(ValueError, match='expected'):
        body_of(sensor_faults=('T1:nonsense',))
