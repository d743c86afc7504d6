# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors at rest: which differ, by how much, and when nothing can be said."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.thermal.sensor_check import NotAtRestError, check_at_rest

SENSORS = ('T1', 'T2', 'T3', 'T4', 'T5', 'T6')
LAGS = np.array([0.3, 0.5, 0.8, 1.0, 1.5, 2.0])
"""Time constants of parts of a machine [h]."""


def night(rise=0.0, drift=0.1, hours=10.0, noise=0.05, step=30.0, seed=1):
    """Return times [s] and temperatures of a machine that cools in air that drifts [K/h]."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, 3600.0 * hours, step)
    at = time[:, np.newaxis] / 3600.0
    air = 20.0 + drift * at
    warm = (rise + drift * LAGS) * np.exp(-at / LAGS) - drift * LAGS
    return time, air + warm + random.normal(0.0, noise, (len(time), len(LAGS)))


def verdicts(found):
    return {item.sensor: item.verdict for item in found.sensors}


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('drift', [0.0, 0.1, -0.2])
def test_what_is_off_is_found_and_what_is_not_is_left_alone(seed, drift):
    time, temperature = night(rise=15.0, drift=drift, hours=14.0, seed=seed)
    wrong = np.array([0.0, 0.8, 0.0, 0.0, -1.2, 0.0])
    found = check_at_rest(time, temperature + wrong, SENSORS)
    for item, off in zip(found.sensors, wrong, strict=True):
        assert item.verdict == ('differs' if off else 'agrees')
        assert abs(item.difference - off) <= item.uncertainty + 0.15
    assert found.reference == pytest.approx(20.0 + drift * found.stop / 3600.0, abs=0.5)


def test_readings_in_steps_are_as_unsure_as_their_steps():
    time, temperature = night(noise=0.01, drift=0.0)
    coarse = 0.5 * np.round(temperature / 0.5)
    found = check_at_rest(time, coarse + np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0]), SENSORS)
    assert set(verdicts(found).values()) <= {'agrees', 'differs'}
    assert found.sensors[0].verdict == 'agrees'


@pytest.mark.parametrize(
    ('readings', 'text'),
    [
        (lambda: night(rise=20.0, hours=2.0), 'drift by less than 0.5 K/h'),
        (lambda: (np.arange(0.0, 60.0), np.full((60, 6), 20.0)), 'over at least 120 s'),
        (lambda: (np.arange(5) * 600.0, np.full((5, 6), 20.0)), 'over at least 120 s, 10 of them'),
        (
            lambda: (night()[0], night()[1] + [0.0, 9.0, 17.0, 25.0, 36.0, 44.0]),
            'not at one temperature, or most sensors are wrong',
        ),
        (lambda: (night()[0], np.full_like(night()[1], np.nan)), 'at least two sensors'),
    ],
)
def test_a_machine_that_is_plainly_not_at_rest_is_refused(readings, text):
    with pytest.raises(NotAtRestError, match=text):
        check_at_rest(*readings(), SENSORS)


def test_a_spindle_that_turned_leaves_the_time_before_it_out():
    time, temperature = night()
    speed = np.where(time < 7.9 * 3600.0, 100.0, 0.0)
    with pytest.raises(NotAtRestError, match='with the spindle at rest, as it has been for 2 h'):
        check_at_rest(time, temperature, SENSORS, speed)
    speed = np.where(time < 3.0 * 3600.0, 100.0, 0.0)
    found = check_at_rest(time, temperature, SENSORS, speed)
    assert found.start >= 5.0 * 3600.0
    assert found.quiet == pytest.approx(found.stop - 3.0 * 3600.0, abs=60.0)
    assert np.isnan(check_at_rest(time, temperature, SENSORS).quiet)


@pytest.mark.parametrize(
    ('change', 'verdict'),
    [
        (lambda t: t + 273.15, 'reads kelvin?'),
        (lambda t: 1.8 * t + 32.0, 'reads degF?'),
        (lambda t: 10.0 * t, 'reads tenths of a degree?'),
        (lambda t: t + 77.7, 'wrong'),
        (lambda t: np.full_like(t, np.nan), 'missing'),
        (lambda t: t + np.linspace(0.0, 10.0, len(t)), 'moves'),
    ],
)
def test_no_offset_is_advised_where_something_else_is_wrong(change, verdict):
    time, temperature = night(drift=0.0, hours=2.0)
    temperature[:, 3] = change(temperature[:, 3])
    found = check_at_rest(time, temperature, SENSORS)
    assert verdicts(found)['T4'] == verdict
    assert found.sensors[3].offset == 0.0
    assert [v for name, v in verdicts(found).items() if name != 'T4'] == ['agrees'] * 5


def test_of_two_sensors_one_has_to_be_right():
    time, temperature = night()
    two = temperature[:, :2] + [0.0, 1.0]
    with pytest.raises(NotAtRestError, match='of two that differ either may be wrong'):
        check_at_rest(time, two, SENSORS[:2])
    found = check_at_rest(time, two, SENSORS[:2], reference='T2')
    assert found.sensors[0].offset == pytest.approx(1.0, abs=0.1)
    assert found.reference_sensor == 'T2'
    with pytest.raises(NotAtRestError, match="expected one of T1, T2 but found 'T9'"):
        check_at_rest(time, two, SENSORS[:2], reference='T9')


@given(st.floats(-15.0, 15.0), st.permutations(range(6)))
def test_neither_season_nor_order_changes_a_verdict(warmer, order):
    time, temperature = night(hours=1.0)
    temperature = temperature + np.array([0.0, 0.8, 0.0, 0.0, -1.2, 0.0])
    plain = verdicts(check_at_rest(time, temperature, SENSORS))
    names = [SENSORS[place] for place in order]
    assert verdicts(check_at_rest(time, temperature[:, order] + warmer, names)) == plain
