# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What diagnostics say of records that mean nothing, and of those that do not come."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import applied, readings
from benches.feedrate_rig import SMALL, Rig, path_of

from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachine
from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.components.thermal.compensator import Compensator
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.ros.health import input_health
from fuzzycnc_ros.runtime.component import Level
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.merge import Merger
from fuzzycnc_ros.runtime.records import SECOND, Compensation, Displacement, ThermalReference
from fuzzycnc_ros.simulation.thermal.mill import MILL_AXES

pytestmark = pytest.mark.ros


def test_refused_records_show_until_a_good_one_comes():
    merger = Merger(ThermalPredictor())
    good = readings(1.0, [20.0, 21.0])
    merger.push('temperatures', replace(good, status=np.zeros(1, np.uint8)))
    (item,) = (item for item in input_health(merger, SECOND) if item.name == 'temperatures')
    assert item.level is Level.ERROR
    assert item.message == 'refused: status: expected 2 values, parallel to sensor, but found 1'
    assert item.values['refused'] == '1'
    merger.push('temperatures', good)
    (item,) = (item for item in input_health(merger, SECOND) if item.name == 'temperatures')
    assert item.level is Level.OK


def test_latched_inputs_show_only_what_was_refused():
    merger = Merger(ThermalPredictor())
    assert 'thermal_reference' not in [item.name for item in input_health(merger, 0)]
    reference = ThermalReference(
        stamp=1, cold_since=0, set_by='test', sensor=('T1',), temperature=np.zeros(2), samples=3
    )
    merger.push('thermal_reference', reference)
    (item,) = (item for item in input_health(merger, 0) if item.name == 'thermal_reference')
    assert item.message.startswith('refused: temperature: expected 1 values')


def read_back(merger, now):
    """Return what is said of the read-back at a machine time [s]."""
    items = input_health(merger, round(now * SECOND))
    return next(item for item in items if item.name == 'compensation_applied')


def test_late_read_back_with_an_offset_is_an_error_within_seconds():
    """What was received last counts, though the compensator works when an error comes."""
    merger = Merger(Compensator())
    merger.component.on_request('activate', {}, 0)
    for tick in range(20):
        merger.push('compensation_applied', applied(0.2 * tick, (0.0, 5e-6)))
    assert read_back(merger, 4.2).level is Level.OK
    item = read_back(merger, 5.8)
    assert item.level is Level.ERROR
    assert item.message.startswith('late: newest is 2.0 s old, usual interval 0.2 s; Z 5.00 um')


def test_late_read_back_of_zero_is_a_warning():
    merger = Merger(Compensator())
    for tick in range(3):
        merger.push('compensation_applied', applied(0.2 * tick))
    item = read_back(merger, 2.4)
    assert item.level is Level.WARN
    assert item.message == 'late: newest is 2.0 s old, usual interval 0.2 s'


def test_burst_amid_a_slow_stream_does_not_make_it_late():
    """A bridge tells more often while offsets move."""
    merger = Merger(Compensator())
    times = [0.0, 0.2, 0.4, *np.arange(0.42, 0.5, 0.02)]
    for time in times:
        merger.push('compensation_applied', applied(time, (0.0, 5e-6)))
    assert read_back(merger, times[-1] + 0.2).level is Level.OK
    for step in range(60):  # the stream has become quicker
        merger.push('compensation_applied', applied(0.6 + 0.02 * step, (0.0, 5e-6)))
    assert merger.counts['compensation_applied'].interval == pytest.approx(0.02 * SECOND, rel=0.02)


def test_outage_does_not_become_usual():
    merger = Merger(Compensator())
    for time in (0.0, 60.0, 120.0, 7200.0, 7260.0):
        merger.push('compensation_applied', applied(time, (0.0, 5e-6)))
    assert read_back(merger, 7300.0).level is Level.OK
    assert read_back(merger, 7260.0 + 10 * 60.0).level is Level.ERROR


@pytest.mark.parametrize(('period', 'over'), [(60.0, 600.0), (0.2, 60.0), (900.0, 3600.0)])
def test_dropped_messages_are_a_warning_until_the_input_has_been_in_time(period, over):
    """Ten of its own intervals, a minute at the least, an hour at the most; the count stays."""
    merger = Merger(Compensator())
    for time in (period, 2.0 * period, 2.0 * period):
        merger.push('compensation_applied', applied(time))
        merger.advance(round(time * SECOND))
    amiss = 2.0 * period
    item = read_back(merger, amiss + 0.5 * period)
    assert item.level is Level.WARN
    assert item.message == 'messages since the start: 1 out of order'
    for step in range(3, round(over / period) + 4):
        time = step * period
        merger.push('compensation_applied', applied(time))
        item = read_back(merger, time + 0.1 * period)
        in_order = time + 0.1 * period - amiss >= over
        assert item.level is (Level.OK if in_order else Level.WARN)
    assert item.message == 'in time'
    assert item.values['dropped'] == '1'


def commands(state, *offsets, slope=0.0):
    """Return commands of a compensator, one a second."""
    size = len(MILL_AXES)
    return [
        Compensation(
            stamp=second * SECOND,
            epoch=1,
            state=int(state),
            axis=MILL_AXES,
            offset=np.full(size, offset),
            slope=np.full(size, slope),
            reference_position=np.zeros(size),
            at_limit=np.zeros(size, bool),
            slewing=np.zeros(size, bool),
            valid_until=(second + 5) * SECOND,
            source=('thermal_error',),
        )
        for second, offset in enumerate(offsets, start=1)
    ]


def machine_health(records):
    """Return what is said of the offsets, long after the last command: input and machine side."""
    merger = Merger(SimulatedMachine())
    for record in records:
        merger.push('compensation', record)
    merger.advance(300 * SECOND)
    merger.component._warmth.offsets.advance(300 * SECOND)
    of_input = [i for i in input_health(merger, 300 * SECOND) if i.name == 'compensation']
    return [*of_input, *(i for i in merger.component.health() if i.name == 'compensation')]


@pytest.mark.parametrize('state', [CompensationState.INACTIVE, CompensationState.EXPIRED])
def test_silence_of_a_compensator_that_has_taken_its_offsets_back_is_no_warning(state):
    told, machine = machine_health(
        [*commands(CompensationState.RAMPING, 2e-6, 1e-6), *commands(state, 1e-6, 5e-7, 0.0)[2:]]
    )
    assert (told.level, told.message) == (Level.OK, 'in time')
    assert (machine.level, machine.message) == (Level.OK, 'at zero, as commanded last')


@pytest.mark.parametrize(
    ('state', 'offset', 'slope'),
    [
        (CompensationState.ACTIVE, 0.0, 0.0),
        (CompensationState.ACTIVE, 1e-6, 0.0),
        (CompensationState.INACTIVE, 1e-6, 0.0),
        (CompensationState.RAMPING, 1e-6, 0.0),
        (CompensationState.EXPIRED, 0.0, 1e-5),
    ],
)
def test_silence_of_any_other_compensator_is_late(state, offset, slope):
    told, machine = machine_health(commands(state, offset, offset, offset, slope=slope))
    assert told.level is Level.WARN
    assert told.message.startswith('late: newest is 297.0 s old')
    if offset or slope:
        assert machine.level is Level.WARN
        assert 'expired' in machine.message


def test_silence_after_probes_and_news_is_no_warning():
    """Somebody probes twice within a minute, and then for hours not."""
    merger = Merger(ThermalPredictor())
    for second in (60, 90):
        merger.push(
            'displacement',
            Displacement(
                stamp=second * SECOND,
                axis=('Y',),
                channel=('Y',),
                displacement=np.zeros(1),
                standard_deviation=np.zeros(1),
                includes_compensation=True,
            ),
        )
    (item,) = (i for i in input_health(merger, 7200 * SECOND) if i.name == 'displacement')
    assert item.level is Level.OK


def test_silence_after_the_last_part_of_a_path_is_no_warning():
    rig = Rig()
    rig.run(path_of(SMALL))
    merger = Merger(ServoController())
    for part in rig.records():
        merger.push('trajectory', part)
    (item,) = (i for i in input_health(merger, 7200 * SECOND) if i.name == 'trajectory')
    assert item.level is Level.OK
    merger = Merger(ServoController())
    for part in rig.records()[:-1]:
        merger.push('trajectory', part)
    (item,) = (i for i in input_health(merger, 7200 * SECOND) if i.name == 'trajectory')
    assert item.level is Level.WARN


def test_stamps_of_another_clock_are_said_to_be_so():
    """A played file whose times begin at 0, at another rate than 1."""
    merger = Merger(Compensator())
    for tick in range(3):
        merger.push('compensation_applied', applied(0.2 * tick))
    item = read_back(merger, 1795854962.0)
    assert item.level is Level.WARN
    assert item.message.startswith('stamps are of another clock: the newest is at 0.4 s')
    assert 'csv_rate' in item.message
