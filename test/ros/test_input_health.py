# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What diagnostics say of records that mean nothing, and of those that do not come."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import applied, readings

from fuzzycnc_ros.components.thermal.compensator import Compensator
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.ros.health import input_health
from fuzzycnc_ros.runtime.component import Level
from fuzzycnc_ros.runtime.merge import Merger
from fuzzycnc_ros.runtime.records import SECOND, ThermalReference

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


def test_dropped_messages_are_a_warning_for_an_hour():
    merger = Merger(Compensator())
    for time in (60.0, 120.0, 120.0):
        merger.push('compensation_applied', applied(time))
        merger.advance(round(time * SECOND))
    item = read_back(merger, 130.0)
    assert item.level is Level.WARN
    assert item.message == 'messages since the start: 1 not newer than the one before'
    for time in range(180, 3900, 60):
        merger.push('compensation_applied', applied(time))
    item = read_back(merger, 3800.0)
    assert (item.level, item.message) == (Level.OK, 'in time')
    assert item.values['dropped'] == '1'
