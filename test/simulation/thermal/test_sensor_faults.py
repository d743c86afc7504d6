# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.simulation.thermal.sensor_faults import (
    FaultInjector,
    SensorFault,
    parse_sensor_fault,
)

SENSORS = ('T1', 'T2', 'T3')


def apply(fault, time, readings=(20.0, 21.0, 22.0)):
    return FaultInjector(SENSORS, [fault]).apply(time, np.array(readings))


@pytest.mark.parametrize(
    ('fault', 'expected'),
    [
        (SensorFault('T2', 'dead', 60.0), np.nan),
        (SensorFault('T2', 'drift', 60.0), 21.0 + 2.0),
        (SensorFault('T2', 'drift', 60.0, -1.0), 21.0 - 1.0),
        (SensorFault('T2', 'open', 60.0), 21.0 + 50.0),
        (SensorFault('T2', 'jump', 60.0, 3.0), 21.0 + 3.0),
    ],
)
def test_kinds_one_hour_after_the_start(fault, expected):
    np.testing.assert_array_equal(apply(fault, 59.9), [20.0, 21.0, 22.0])
    np.testing.assert_array_equal(apply(fault, 3660.0), [20.0, expected, 22.0])


def test_stuck_holds_the_reading_at_its_start():
    injector = FaultInjector(SENSORS, [SensorFault('T1', 'stuck', 60.0)])
    shown = [injector.apply(t, np.array([t, 0.0, 0.0]))[0] for t in (0.0, 30.0, 72.0, 90.0, 120.0)]
    assert shown == [0.0, 30.0, 72.0, 72.0, 72.0]


def test_faults_on_one_sensor_act_in_order():
    faults = [SensorFault('T1', 'jump', 0.0, 3.0), SensorFault('T1', 'stuck', 0.0)]
    injector = FaultInjector(SENSORS, faults)
    assert [injector.apply(t, np.full(3, 20.0 + t))[0] for t in (0.0, 1.0)] == [23.0, 23.0]


def test_readings_handed_in_are_not_changed():
    readings = np.array([20.0, 21.0, 22.0])
    FaultInjector(SENSORS, [SensorFault('T1', 'dead')]).apply(0.0, readings)
    np.testing.assert_array_equal(readings, [20.0, 21.0, 22.0])


def test_unknown_sensor_is_refused():
    with pytest.raises(ValueError, match='T1 to T3 but found T77'):
        FaultInjector(SENSORS, [SensorFault('T77', 'dead')])


@given(
    sensor=st.sampled_from(SENSORS),
    kind=st.sampled_from(['drift', 'open', 'jump']),
    start=st.floats(0.0, 1e6),
    value=st.floats(-100.0, 100.0),
)
def test_text_form_round_trips(sensor, kind, start, value):
    fault = SensorFault(sensor, kind, start, value)
    assert parse_sensor_fault(f'{sensor}:{kind}:{start!r}:{value!r}') == fault


def test_text_form_without_value_takes_the_default():
    assert parse_sensor_fault(' T18 : open : 60 ') == SensorFault('T18', 'open', 60.0, 50.0)
    assert parse_sensor_fault('T18:dead:0').value is None


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'sensor:kind:start'),
        ('T18:drift', "'T18:drift'"),
        ('T18:drift:1:2:3', 'sensor:kind:start'),
        ('T18:drift:soon', 'numbers for start and value'),
        ('T18:melted:60', 'expected one of dead, stuck, drift, open, jump'),
        ('T18:dead:-1', '0 s or more'),
        ('T18:dead:nan', '0 s or more'),
        ('T18:dead:60:2', 'expected none'),
        ('T18:drift:60:inf', 'finite'),
        (':dead:60', 'name'),
    ],
)
def test_bad_text_is_refused_with_a_reason(text, message):
    with pytest.raises(ValueError, match=message):
        parse_sensor_fault(text)
