# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Check values of the simulated mill."""

import numpy as np
import pytest

from fuzzycnc_ros.simulation.thermal.duties import DUTIES, record_runs, simulate_duty
from fuzzycnc_ros.simulation.thermal.mill import MILL_NODES, MILL_SENSORS, RPM, sensor_weights

pytestmark = pytest.mark.paper


def row_at(run, minutes):
    return 1e6 * run.displacement[np.flatnonzero(run.time == 60.0 * minutes)[0]]


@pytest.mark.parametrize(('minutes', 'y', 'z'), [(80, 11.15, 12.79), (200, 41.50, 33.80)])
def test_duty_d0_at_the_printed_minutes(minutes, y, z):
    assert row_at(simulate_duty(DUTIES['D0']), minutes) == pytest.approx([y, z], abs=0.01)


@pytest.mark.parametrize(
    ('name', 'y', 'z'),
    [
        ('D0', 41.5, 33.8),
        ('D0b', 34.1, 30.9),
        ('T1', 24.8, 26.8),
        ('T2', 38.5, 32.5),
        ('T3', 29.1, 24.4),
    ],
)
def test_largest_raw_error_of_each_run(name, y, z):
    largest = 1e6 * np.abs(simulate_duty(DUTIES[name]).displacement).max(axis=0)
    assert largest == pytest.approx([y, z], abs=0.0501)  # printed to one decimal


def test_rows_are_a_minute_apart_and_include_both_ends():
    lengths = {name: len(run.time) for name, run in record_runs().items()}
    assert lengths == {'D0': 201, 'D0b': 201, 'T1': 201, 'T2': 201, 'T3': 401}
    assert np.all(np.diff(record_runs(['T3'])['T3'].time) == 60.0)


def test_noise_is_drawn_in_the_sheets_order():
    rng = np.random.default_rng(1000 + 4)
    for name, run in record_runs(seed=4).items():
        truth = simulate_duty(DUTIES[name])
        temperature = truth.temperature + rng.normal(0.0, 0.1, truth.temperature.shape)
        y = truth.displacement[:, 0] + rng.normal(0.0, 0.3e-6, len(truth.time))
        z = truth.displacement[:, 1] + rng.normal(0.0, 0.3e-6, len(truth.time))
        np.testing.assert_array_equal(run.temperature, temperature)
        np.testing.assert_array_equal(run.displacement, np.column_stack([y, z]))


def test_sensors_sit_where_section_1_puts_them():
    weights = sensor_weights()
    assert weights.shape == (len(MILL_SENSORS), len(MILL_NODES)) == (76, 30)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-15)

    def nodes_of(first, last):
        rows = weights[first - 1 : last]
        return {MILL_NODES[i] for i in np.flatnonzero(rows.any(axis=0))}

    assert nodes_of(1, 7) == {'co0', 'co1', 'co2'}
    assert nodes_of(8, 32) == {f'b1{i}' for i in range(5)}
    assert nodes_of(33, 61) == {f'b2{i}' for i in range(5)}
    assert nodes_of(62, 63) == {'fb', 'rb', 'sh'}
    assert nodes_of(64, 67) == {'bb', 'bs', 'bt', 'ys'}
    assert [nodes_of(n, n) for n in (68, 69, 70, 72, 76)] == [
        {'ct'},
        {'bo'},
        {'bs'},
        {'hd'},
        {'tn'},
    ]
    assert nodes_of(73, 75) == {'ci0', 'ci1', 'ci2'}
    # A chain begins and ends on a node; the second of seven lies a third of the way to the next.
    assert weights[0, MILL_NODES.index('co0')] == 1.0
    assert weights[6, MILL_NODES.index('co2')] == 1.0
    assert weights[1, MILL_NODES.index('co1')] == pytest.approx(1 / 3)


def test_duties_speeds_are_the_printed_ones():
    speeds = [round(DUTIES['T2'].spindle_speed(60.0 * t) / RPM) for t in (0, 59, 60, 120, 199)]
    assert speeds == [1500, 1500, 500, 2000, 2000]
    assert [DUTIES['T2'].spindle_speed(t) for t in (-1.0, 12_000.0)] == [0.0, 0.0]
    assert [duty.duration / 60 for duty in DUTIES.values()] == [200, 200, 200, 200, 400]
