# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Ball screws of the simulated machine: readings, displacement along the axes, faults, offsets."""

import re
from itertools import chain

import numpy as np
import pytest

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.machine.simulated_machine_config import DAY_START
from fuzzycnc_ros.core.inputs.offset_input import OffsetInput, OffsetInputConfig
from fuzzycnc_ros.runtime.records import SECOND, Compensation, nanoseconds
from fuzzycnc_ros.simulation.thermal.duties import AXIS_DUTIES
from fuzzycnc_ros.simulation.thermal.mill import MILL_SENSORS

ENDS = (-0.5, -0.25, 0.0)


def run(ticks: int | None = None, before=lambda machine: None, **changes) -> dict[str, list]:
    """Run a machine, with screws unless said otherwise; return its records by topic."""
    given = {
        'duties': ('axis_Y',),
        'screws': ('Y:fixed_free',),
        'displacement_positions': ENDS,
        'displacement_noise': 1e-9,
    }
    machine = SimulatedMachine(SimulatedMachineConfig(**(given | changes)))
    found: dict[str, list] = {item.name: [] for item in machine.OUTPUTS}
    count = 0
    while machine.next_tick is not None and (ticks is None or count < ticks):
        before(machine)
        for emission in machine.tick():
            found[emission.output].append(emission.record)
        count += 1
    return found


def test_an_axis_that_warms_up_alone_is_longer_at_its_far_end():
    found = run(601)
    last = found['displacement'][-1]
    assert last.axis == ('Y', 'Y', 'Y', 'Z')
    assert last.channel == ('Y@-500mm', 'Y@-250mm', 'Y@0mm', 'Z')
    np.testing.assert_array_equal(last.position, [*ENDS, np.nan])
    far, middle, near = last.displacement[:3]
    assert far < -90e-6 < middle < near < -5e-6
    state = found['machine_state'][-1]
    assert state.axis[1] == 'Y'
    assert -0.45 <= state.position[1] <= -0.05
    assert state.travel[1] == pytest.approx(0.25 * (601 * 12 - 360))
    assert state.square_speed[1] == pytest.approx(0.0625 * (601 * 12 - 360))
    assert state.travel_moment[1] == pytest.approx(-0.25 * state.travel[1])
    assert state.travel_second_moment[1] == pytest.approx((0.25**2 + 0.2**2 / 3) * state.travel[1])
    assert np.isnan(state.travel[0])
    assert np.ptp([item.position[1] for item in found['machine_state']]) > 0.35


def test_sensors_of_a_screw_come_behind_those_of_the_mill():
    reading = run(301)['sensor_readings'][-1]
    assert reading.sensor[: len(MILL_SENSORS)] == MILL_SENSORS
    assert reading.sensor[-4:] == ('Y_bearing', 'Y_far_bearing', 'Y_nut', 'Y_table')
    bearing, _, nut, table = reading.temperature[-4:]
    assert nut > bearing > table > 20.0


@pytest.mark.parametrize('topic', ['machine_state', 'displacement', 'sensor_readings'])
def test_a_machine_without_screws_is_as_before(topic):
    # Screws draw from streams of their own, so the mill's own readings have the same noise.
    bare = run(200, screws=(), duties=('D0',), displacement_noise=0.3e-6)[topic]
    screwed = run(200, duties=('D0',), displacement_noise=0.3e-6)[topic]
    assert len(bare) == len(screwed)
    if topic == 'sensor_readings':
        for one, other in zip(bare, screwed, strict=True):
            np.testing.assert_array_equal(one.temperature, other.temperature[: len(one.sensor)])
    elif topic == 'displacement':
        assert {item.axis for item in bare} == {('Y', 'Z')}
        assert all(np.isnan(item.position).all() for item in bare)
    else:
        assert {item.axis for item in bare} == {('X', 'Y', 'Z')}


def test_an_axis_that_the_mill_does_not_bend_can_have_a_screw():
    found = run(51, screws=('X:linear_scale',), duties=('D0',))
    assert found['compensation_applied'][-1].axis == ('Y', 'Z', 'X')
    assert found['displacement'][-1].axis == ('Y', 'Z', 'X', 'X', 'X')


def test_named_faults():
    bare = run(301, screws=('Y:fixed_fixed',))
    faulty = run(
        301,
        screws=('Y:fixed_fixed',),
        screw_faults=('Y:stretch_lost:1800', 'Y:nut_sensor_off:1800'),
    )
    for index, same in ((140, True), (160, False)):
        one, other = bare['sensor_readings'][index], faulty['sensor_readings'][index]
        assert np.array_equal(one.temperature, other.temperature) is same
    assert faulty['sensor_readings'][-1].temperature[-2] == pytest.approx(20.0, abs=0.5)
    # A short while after the start the stretch still holds the ends; without it, it springs back.
    early = run(6, screws=('Y:fixed_fixed',))['displacement'][0].displacement
    lost = run(6, screws=('Y:fixed_fixed',), screw_faults=('Y:stretch_lost:0',))
    sprung = lost['displacement'][0].displacement - early
    assert sprung[0] > 5e-6
    assert sprung[-1] == 0.0


def test_a_sensor_fault_of_a_screw_is_one_like_others():
    reading = run(11, sensor_faults=('Y_nut:dead:60', 'T18:dead:60'))['sensor_readings'][-1]
    dead = np.array(reading.sensor)[np.isnan(reading.temperature)]
    assert set(dead) == {'T18', 'Y_nut'}


def test_offsets_follow_the_axis_and_are_measured_where_the_probe_is():
    sent = []

    def order(machine: SimulatedMachine) -> None:
        sent.append(machine.next_tick)
        if len(sent) == 3:
            start = nanoseconds(DAY_START)
            machine.on_compensation(
                Compensation(
                    stamp=start,
                    frame_id='mill/machine',
                    epoch=1,
                    state=1,
                    axis=('Y', 'Z'),
                    offset=np.zeros(2),
                    slope=np.array([-100e-6, 0.0]),
                    reference_position=np.array([-0.25, 0.0]),
                    at_limit=np.zeros(2, bool),
                    slewing=np.zeros(2, bool),
                    valid_until=start + 10_000 * SECOND,
                    source=('thermal_error',),
                )
            )

    changes = {'slew_max': 1e-3, 'validity_max': 7200.0}
    bare = run(28, **changes)
    moved = run(28, order, displacement_compensated=True, **changes)
    position = moved['machine_state'][-1].position[1]
    offset = moved['compensation_applied'][-1].offset[0]
    assert abs(position + 0.25) > 0.05
    assert offset == pytest.approx(-100e-6 * (position + 0.25), abs=1e-12)
    change = moved['displacement'][-1].displacement - bare['displacement'][-1].displacement
    np.testing.assert_allclose(change, [25e-6, 0.0, -25e-6, 0.0], atol=1e-8)


@pytest.mark.parametrize(
    ('changes', 'said'),
    [
        ({'screws': ('Y',)}, "Y:fixed_free, but found 'Y'"),
        ({'screws': ('Y:fixed_free', 'Y:fixed_free')}, 'each axis once'),
        ({'screws': ('Q:fixed_free',)}, "'Q:fixed_free'"),
        ({'screw_data': ('Z:length:0.9',)}, "'Z:length:0.9'"),
        ({'screw_data': ('Y:mounting:1',)}, "'Y:mounting:1'"),
        ({'screw_data': ('Y:length:long',)}, "'Y:length:long'"),
        ({'screw_data': ('Y:length:99',)}, 'screw of Y: length: expected 0.1 to 10 m'),
        ({'screw_faults': ('Y:broken:0',)}, "'Y:broken:0'"),
        ({'screw_faults': ('Y:stretch_lost:-1',)}, "'Y:stretch_lost:-1'"),
        ({'screw_faults': ('Z:stretch_lost:0',)}, "'Z:stretch_lost:0'"),
        ({'displacement_positions': (0.0, 0.0)}, 'each once, but found 0, 0'),
        ({'screws': (), 'screw_data': ('Y:length:1',)}, 'name them, as Y:fixed_free'),
        ({'sensor_faults': ('Z_nut:dead:0',)}, 'Z_nut'),
    ],
)
def test_refusals(changes, said):
    with pytest.raises(ValueError, match=re.escape(said)):
        run(1, **changes)


def test_duties_with_motion_stay_on_the_travel_of_the_screw():
    blocks = chain.from_iterable(duty.blocks for duty in AXIS_DUTIES.values())
    strokes = [stroke for block in blocks for _, stroke in block.strokes]
    assert min(stroke.low for stroke in strokes) >= -0.5
    assert max(stroke.high for stroke in strokes) <= 0.0


def test_offsets_elsewhere_on_the_travel():
    guard = OffsetInput(['Y'], OffsetInputConfig(slew_max=1e-3))
    guard.command(1, ['Y'], [10e-6], [100e-6], [-0.25], stamp=0, valid_until=10 * SECOND)
    guard.advance(SECOND, [-0.25])
    assert guard.at([0.0]) == pytest.approx([35e-6])
    assert guard.at([np.nan]) == pytest.approx([10e-6])
    assert guard.at([0.75]) == pytest.approx([60e-6])
    guard.allow(False)
    assert guard.at([0.0]) == pytest.approx([10e-6])
