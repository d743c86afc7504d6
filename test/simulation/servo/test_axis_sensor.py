# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position sensors of the axes, and what each of their faults does."""

import math

import numpy as np
import pytest

from fuzzycnc_ros.core.machine.axis_models import PositionSensorConfig
from fuzzycnc_ros.simulation.servo.axes import PositionSensor, PositionSensors

PERIOD = 1e-3
QUIET = {'noise': 0.0}


def readings(positions, **knobs):
    """Readings of a sensor at one position after the other."""
    sensor = PositionSensor(PositionSensorConfig(**knobs), PERIOD)
    taken = []
    for position in positions:
        taken.append(sensor.read(position))
        sensor.advance()
    return np.array(taken)


@pytest.mark.parametrize(
    ('knobs', 'message'),
    [
        ({'sensor': 'laser'}, 'sensor: expected one of grating, encoder'),
        ({'count': -1e-6}, 'count = -1e-06 is outside'),
        ({'counts_lost': 1.5}, 'counts_lost: expected int'),
        ({'noise': math.nan}, 'noise = nan is outside'),
        ({'screw_lead': 0.0}, 'screw_lead = 0.0 is outside'),
    ],
)
def test_a_sensor_that_cannot_be_is_refused(knobs, message):
    with pytest.raises(ValueError, match=message):
        PositionSensorConfig(**knobs)


def test_readings_are_the_nearest_counts():
    positions = np.linspace(-1e-4, 1e-4, 401)
    found = readings(positions, **QUIET)
    counts = found / 0.625e-6
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)
    assert np.abs(found - positions).max() <= 0.5 * 0.625e-6 * (1 + 1e-9)
    assert readings([1.23456789e-3], count=0.0, **QUIET) == [1.23456789e-3]


def test_noise_is_as_strong_as_asked_and_comes_from_the_seed():
    still = np.full(5000, 2e-3)
    noise = readings(still, count=0.0, noise=0.5e-6) - still
    assert noise.std() == pytest.approx(0.5e-6, rel=0.03)
    assert abs(noise.mean()) < 0.03e-6
    again, other = (readings(still, count=0.0, noise=0.5e-6, seed=seed) - still for seed in (0, 1))
    assert np.array_equal(again, noise)
    assert abs(np.corrcoef(noise, other)[0, 1]) < 0.05


def test_reading_again_says_the_same():
    sensor = PositionSensor(PositionSensorConfig(noise=5e-6), PERIOD)
    first = sensor.read(1e-3)
    assert sensor.read(1e-3) == first
    sensor.advance()
    assert sensor.read(1e-3) != first


def test_an_encoder_reads_the_error_of_the_screw_and_a_grating_does_not():
    turn = np.array([0.0, 2.5e-3, 5e-3, 7.5e-3, 0.1025])
    knobs = {'count': 0.0, 'periodic_error': 6e-6, 'pitch_error': 8e-5, **QUIET}
    error = turn - readings(turn, sensor='encoder', **knobs)
    expected = np.array([0.0, 6e-6, 0.0, -6e-6, 6e-6]) + 8e-5 * turn
    np.testing.assert_allclose(error, expected, atol=1e-15)
    assert np.array_equal(readings(turn, sensor='grating', **knobs), turn)


def test_lost_counts_stay_lost():
    found = readings(np.full(10, 1e-3), counts_lost=16, count_loss_time=4e-3, **QUIET)
    np.testing.assert_allclose(found - 1e-3, [0.0] * 4 + [-16 * 0.625e-6] * 6, atol=1e-15)


def test_a_coarser_count_rounds_coarser_from_its_time_on():
    positions = np.full(10, 23e-6)
    found = readings(positions, count_factor=16.0, count_change_time=5e-3, **QUIET)
    np.testing.assert_allclose(found, [23.125e-6] * 5 + [20e-6] * 5, atol=1e-15)


def test_a_dropout_reads_nothing_for_its_time():
    found = readings(np.full(10, 1e-3), dropout_time=3e-3, dropout_duration=4e-3, **QUIET)
    assert np.isnan(found).tolist() == [False] * 3 + [True] * 4 + [False] * 3


def test_many_sensors_read_what_each_would():
    configs = [
        PositionSensorConfig(seed=3),
        PositionSensorConfig(count=0.0, noise=2e-6),
        PositionSensorConfig(sensor='encoder', pitch_error=3e-5, seed=1),
        PositionSensorConfig(counts_lost=-5, count_loss_time=0.3),
        PositionSensorConfig(count_factor=8.0, count_change_time=0.7),
        PositionSensorConfig(dropout_time=0.9, dropout_duration=0.2),
    ]
    # longer than a block of noise
    courses = np.random.default_rng(0).normal(0.0, 0.05, (1500, len(configs)))
    batch = PositionSensors(configs, PERIOD)
    single = [PositionSensor(config, PERIOD) for config in configs]
    for positions in courses:
        expected = [sensor.read(at) for sensor, at in zip(single, positions, strict=True)]
        np.testing.assert_allclose(batch.read(positions), expected, rtol=0.0, atol=1e-16)
        for sensor in (batch, *single):
            sensor.advance()
