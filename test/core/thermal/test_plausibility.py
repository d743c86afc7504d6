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
    WARM,
    half_change_times,
    lone_values,
    odd_pace,
    offset_channels,
    shifted_sensors,
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


@pytest.mark.parametrize('first', [20.0, 0.0, 50.0])
def test_the_first_row_of_a_fast_rise_stands_not_alone(first):
    moved = np.concatenate([[first, 60.9, 76.5], 80.0 + 0.1 * np.arange(60)])[:, np.newaxis]
    assert not list(lone_values(1e-6 * moved, DISPLACEMENT_STEP))


def test_a_value_at_an_end_names_its_neighbours_as_they_stand():
    readings = warming()
    readings[[0, 239], 0] = 35.0, 20.0
    first, last = lone_values(readings, TEMPERATURE_STEP)
    assert first.neighbours(1.0) == f'before {readings[1, 0]:.4g} and {readings[2, 0]:.4g}'
    assert last.neighbours(1.0) == f'behind {readings[237, 0]:.4g} and {readings[238, 0]:.4g}'


def test_half_of_the_change_takes_its_time():
    def taken(time, values):
        return half_change_times(time, values, WARM)[0]

    assert taken(TIME, warming()) == pytest.approx(1800.0 * np.log(2.0), rel=0.15)
    assert taken(TIME / 60.0, warming()) == pytest.approx(30.0 * np.log(2.0), rel=0.15)
    assert taken(TIME, warming()[::-1]) == pytest.approx(1800.0 * np.log(2.0), rel=0.15)
    assert np.isnan(taken(TIME, 0.1 * warming()))
    assert np.isnan(half_change_times(TIME, np.full((240, 2), np.nan), WARM)).all()


def test_a_unit_of_time_is_doubted_by_most_of_sensors_and_probes():
    slow, moved = np.hstack([warming(), warming()]), 1e-6 * warming()
    fast = np.hstack([warming(), 20.0 + 30.0 * (TIME[:, np.newaxis] % 7200.0 < 3600.0)])
    assert odd_pace(TIME, slow, moved) is None
    assert odd_pace(TIME, fast, moved) is None
    pace = odd_pace(TIME / 60.0, fast, moved)
    assert pace is not None
    assert (pace.agreeing, pace.witnesses) == (3, 3)
    assert pace.time == pytest.approx(30.0 * np.log(2.0), rel=0.2)
    pace = odd_pace(1000.0 * TIME, slow[:, :1], moved[:, :0])
    assert pace is not None
    assert (pace.agreeing, pace.witnesses) == (1, 1)
    assert odd_pace(TIME / 60.0, 0.1 * slow, moved) is None  # no sensor warms


@pytest.mark.parametrize(
    ('first', 'doubted'), [(0.0, False), (1.0, False), (8.0, True), (-8.0, True)]
)
def test_displacements_that_do_not_begin_at_zero(first, doubted):
    moved = 1e-6 * (2.0 * (warming() - 20.0) + first)
    found = offset_channels(moved, 3)
    assert [column for column, _, _ in found] == [0] * doubted
    if doubted:
        assert found[0][1:] == pytest.approx((first * 1e-6, 24e-6), abs=1e-6)


def test_what_tells_nothing_of_a_zero_is_not_doubted():
    late = np.where(np.arange(240)[:, np.newaxis] < 10, np.nan, 30e-6)
    noise = 20e-6 * np.random.default_rng(0).standard_normal((240, 1))
    small = np.full((240, 1), 1e-6)
    for moved in (late, noise, small, np.full((240, 1), np.nan)):
        assert offset_channels(moved, 3) == []
    fast = 40e-6 * (1.0 - np.exp(-TIME / 120.0))[:, np.newaxis]
    assert offset_channels(fast, 3) == []


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
    assert 'in the other 4 of 6 runs, and stays so' in line
    # One that was warm at the start and comes back is not broken.
    cooling = runs[3].temperature.copy()
    cooling[:, 2] = runs[0].temperature[:, 2] + 34.0 * np.exp(-TIME / 1200.0)
    assert not list(shifted_sensors([*runs[:1], *runs[4:], replace(runs[3], temperature=cooling)]))
    # Half of the runs are no exception.
    halves = [replace(runs[at], name=name) for at, name in zip((0, 1, 2, 3), 'ghij', strict=True)]
    assert not list(shifted_sensors(halves))
    # A machine that is warm has several sensors that are; two runs do not say which is odd.
    warm = started('warm', 30.0, 45.0, 60.0, 24.0)
    assert not list(shifted_sensors([runs[0], warm, runs[2]]))
    assert not list(shifted_sensors(runs[:2]))
    silent = [started(name, 21.0, 22.0, np.nan, 24.0) for name in 'abc']
    assert not list(shifted_sensors(silent))


def test_healthy_runs_raise_no_doubt():
    for seed in (0, 1):
        runs = list(record_runs(seed=seed).values())
        assert doubt_lines(runs) == []
        for run in runs:
            assert odd_pace(run.time, run.temperature, run.displacement) is None
