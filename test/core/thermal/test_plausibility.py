# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Single values, units of time and signs that look like mistakes, and healthy runs that do not."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.cli.models.recorded_runs import doubt_lines
from fuzzycnc_ros.core.thermal.plausibility import (
    DISPLACEMENT_STEP,
    TEMPERATURE_STEP,
    half_rise_time,
    lone_values,
    shifted_sensors,
    turned_channels,
)
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.simulation.thermal.duties import record_runs

TIME = 60.0 * np.arange(240)


def warming(noise=0.03):
    """Return a sensor that warms by 12 K with a time constant of half an hour."""
    rng = np.random.default_rng(0)
    rise = 12.0 * (1.0 - np.exp(-TIME / 1800.0))
    return (20.0 + rise + noise * rng.standard_normal(len(TIME)))[:, np.newaxis]


@pytest.mark.parametrize(
    ('rows', 'values'),
    [([50], [85.0]), ([50, 120], [0.0, 35.0]), ([0], [28.0]), ([239], [20.0])],
)
def test_a_value_far_off_its_neighbours_stands_alone(rows, values):
    readings = warming()
    readings[rows, 0] = values
    found = list(lone_values(readings, TEMPERATURE_STEP))
    assert [(item.row, item.value) for item in found] == list(zip(rows, values, strict=True))
    assert all(abs(item.before - item.behind) < 1.0 for item in found)


@pytest.mark.parametrize('rows', [[50, 51], slice(50, 240), slice(0, 2)])
def test_steps_and_more_values_than_one_stand_not_alone(rows):
    readings = warming()
    readings[rows, 0] += 6.0
    assert not list(lone_values(readings, TEMPERATURE_STEP))


def test_neighbours_are_the_next_that_were_measured():
    probes = np.full((240, 1), np.nan)
    probes[::6, 0] = np.linspace(0.0, 40e-6, 40)
    assert not list(lone_values(probes, DISPLACEMENT_STEP))
    probes[60, 0] += 30e-6
    (found,) = lone_values(probes, DISPLACEMENT_STEP)
    assert (found.row, found.before, found.behind) == (60, probes[54, 0], probes[66, 0])
    assert not list(lone_values(probes[:30], DISPLACEMENT_STEP))  # five say nothing


def test_what_scatters_by_itself_stands_not_alone():
    rng = np.random.default_rng(1)
    noisy = 20.0 + 1.5 * rng.standard_normal((400, 3))
    assert not list(lone_values(noisy, TEMPERATURE_STEP))


def test_half_of_the_rise_takes_its_time():
    assert half_rise_time(TIME, warming()) == pytest.approx(1800.0 * np.log(2.0), rel=0.15)
    assert half_rise_time(TIME / 60.0, warming()) == pytest.approx(30.0 * np.log(2.0), rel=0.15)
    assert np.isnan(half_rise_time(TIME, 0.3 * warming()))
    assert np.isnan(half_rise_time(TIME, warming()[::-1]))
    assert np.isnan(half_rise_time(TIME, np.full((240, 2), np.nan)))


def run_of(name, *gains):
    """Return a run whose channels follow its temperature with some gains."""
    temperature = warming()
    moved = 1e-6 * (temperature - 20.0) * np.array(gains)
    channel = ('X', 'Y', 'Z')[: len(gains)]
    return ThermalRun(name, TIME, ('T1',), temperature, channel, channel, moved)


def test_a_turned_run_is_named():
    runs = [run_of('a', 3.0, -2.0), run_of('b', 3.0, 2.0), run_of('c', 2.0, -1.0)]
    (found,) = turned_channels(runs)
    assert (found.channel, list(found.against), list(found.others)) == ('Y', ['b'], ['a', 'c'])
    assert found.against['b'] > 0.99
    (found,) = turned_channels(runs[:2])
    assert (list(found.against), list(found.others)) == (['a'], ['b'])


def test_runs_that_tell_nothing_are_not_asked():
    still = replace(run_of('still', 3.0), displacement=np.zeros((240, 1)))
    cold = replace(run_of('cold', -3.0), temperature=20.0 + 0.1 * (warming() - 20.0))
    few = run_of('few', -3.0)
    measured = np.where(np.arange(240)[:, np.newaxis] < 7, few.displacement, np.nan)
    runs = [run_of('a', 3.0), still, cold, replace(few, displacement=measured)]
    assert not list(turned_channels(runs))


def started(name, *first):
    """Return a run whose sensors begin at some temperatures [degC]; NaN of one that has none."""
    temperature = warming() - 20.0 + np.array(first)
    names = tuple(f'T{place}' for place in range(len(first)))
    return ThermalRun(name, TIME, names, temperature, (), (), np.empty((240, 0)))


def test_a_sensor_that_alone_begins_far_off_in_some_runs_is_named():
    runs = [
        started('a', 21.0, 22.0, 20.0, 24.0),
        started('b', 18.0, 19.0, 48.0, 21.0),
        started('c', 25.0, 26.0, 24.0, 28.0),
        started('d', 21.0, 22.0, 55.0, 24.0),
        started('e', 21.0, 22.0, np.nan, 24.0),
        started('f', 20.0, 21.0, 19.0, 23.0),
    ]
    (found,) = shifted_sensors(runs)
    assert found.sensor == 'T2'
    assert found.start == pytest.approx({'b': 48.0, 'd': 55.0}, abs=0.2)
    assert found.off == pytest.approx(34.0, abs=1.5)
    (line,) = doubt_lines(runs)
    assert re.match('b, d: T2 begins at 48, 55 degC, .* 3[345] K above .* --drop-sensor T2', line)
    # A machine that is warm has several sensors that are; two runs do not say which is odd.
    warm = started('warm', 30.0, 45.0, 60.0, 24.0)
    assert not list(shifted_sensors([runs[0], warm, runs[2]]))
    assert not list(shifted_sensors(runs[:2]))
    silent = [started(name, 21.0, 22.0, np.nan, 24.0) for name in 'abc']
    assert not list(shifted_sensors(silent))


def test_healthy_runs_raise_no_doubt():
    for seed in (0, 1):
        runs = list(record_runs(seed=seed).values())
        assert not list(turned_channels(runs))
        assert not list(shifted_sensors(runs))
        for run in runs:
            assert not list(lone_values(run.temperature, TEMPERATURE_STEP))
            assert not list(lone_values(run.displacement, DISPLACEMENT_STEP))
            assert 600.0 < half_rise_time(run.time, run.temperature) < 7200.0
