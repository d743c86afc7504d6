# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What sensors, inputs and loggers say without a reading, and true temperatures of that size."""

from time import process_time

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.no_reading import values_without_reading
from fuzzycnc_ros.simulation.thermal.duties import record_runs

ROWS = 40


def warming(columns=3):
    return 20.0 + 0.1 * np.arange(ROWS)[:, np.newaxis] + np.arange(columns)


def found_in(values):
    return {
        (item.column, item.value): item.rows.tolist()
        for item in values_without_reading(values, values)
        if item.clear
    }


@pytest.mark.parametrize(
    'rows', [[0], [0, 1, 2, 3], [17], [39], [0, 9, 10, 30], list(range(20, 40))]
)
@pytest.mark.parametrize(
    'value', [85.0, 0.0, -127.0, 327.67, 850.0, 1372.0, -999.9, 9999.0, 888.8]
)
def test_a_known_or_impossible_value_far_off_the_others_is_none(value, rows):
    values = warming()
    values[rows, 1] = value
    if value == 888.8 and len(rows) == 1:  # known to nobody, and once may be anything
        assert found_in(values) == {}
    else:
        assert found_in(values) == {(1, value): rows}


@pytest.mark.parametrize('value', [85.0, 0.0, -127.0, 327.67])
def test_a_sensor_that_says_nothing_else_is_judged_by_the_others(value):
    values = warming()
    values[:, 2] = value
    assert found_in(values) == {(2, value): list(range(ROWS))}
    (item,) = values_without_reading(values[:, 2:], values[:, 2:])
    assert not item.clear
    assert len(item.rows) == ROWS


def test_a_machine_that_has_such_a_temperature_keeps_it():
    passing = warming() + 63.0 - 0.0  # through 85 degC
    passing[:, 0] = np.linspace(81.0, 89.0, ROWS).round(0)
    assert 85.0 in passing
    cold = np.round(warming() - 21.0, 0)  # through 0 degC
    assert (cold == 0.0).any()
    hot = np.full((ROWS, 2), 85.0)
    hot[:, 1] = 80.0
    for values in (passing, cold, hot):
        assert found_in(values) == {}


def test_another_unit_is_no_value_without_reading():
    kelvin = np.round(warming() + 273.15, 2)
    assert found_in(kelvin) == {}
    fahrenheit = warming() * 1.8 + 32.0
    fahrenheit[0, 0] = 185.0
    (item,) = values_without_reading(fahrenheit, (fahrenheit - 32.0) / 1.8)
    assert (item.value, item.clear, item.meaning[:22]) == (185.0, True, 'what a DS18B20 says at')


def test_missing_readings_and_healthy_runs_have_none():
    values = warming()
    values[:, 0] = np.nan
    values[::3, 1] = np.nan
    assert found_in(values) == {}
    for run in record_runs(seed=3).values():
        assert found_in(run.temperature) == {}


def test_a_thousand_sensors_take_no_minute():
    temperature = 20.0 + np.random.default_rng(1).normal(0.0, 0.5, (300, 1000)).round(3)
    temperature[5, 7] = 85.0
    begun = process_time()
    (found,) = values_without_reading(temperature, temperature)
    assert (found.column, found.rows.tolist()) == (7, [5])
    assert process_time() - begun < 5.0
