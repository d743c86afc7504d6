# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.simulation.thermal.grinder import (
    FLUX_PLACES,
    GRINDER_CAPACITY,
    GRINDER_LOSS,
    GRINDER_NODES,
    GRINDER_SENSORS,
    GRINDER_STEP,
    AmbientCourse,
    Grinder,
    grinder_displacement,
    grinder_step,
    running_heat,
    surface_heat,
)
from fuzzycnc_ros.simulation.thermal.grinder_runs import (
    FLUX_CASES,
    GRINDER_EXPERIMENTS,
    GrinderCase,
    record_flux_case,
    record_grinder,
    simulate_grinder,
)

AMBIENT = AmbientCourse(22.0, 2.5, -0.9)


def grinder(ambient=AMBIENT, running=True):
    return Grinder(ambient, running_heat(lambda time: running))


def states(machine):
    return np.concatenate(
        [machine.node_temperatures, machine.sensor_temperatures(), machine.displacement()]
    )


@pytest.mark.parametrize('duration', [-1.0, np.nan, np.inf])
def test_refusals_leave_the_grinder_as_it_was(duration):
    machine = grinder()
    machine.advance(60.0)
    before = states(machine)
    with pytest.raises(ValueError, match='duration: expected 0 s or more'):
        machine.advance(duration)
    assert machine.time == 60.0
    np.testing.assert_array_equal(states(machine), before)


@pytest.mark.parametrize('name', ['base', 'amplitude', 'phase', 'period'])
def test_ambient_must_be_finite(name):
    with pytest.raises(ValueError, match=f'{name}: expected a finite number but found nan'):
        AmbientCourse(**{'base': 20.0, name: np.nan})


def test_ambient_must_swing_forward():
    with pytest.raises(ValueError, match='period: expected more than 0 s but found 0'):
        AmbientCourse(20.0, period=0.0)


@pytest.mark.parametrize('duration', [0.0, -60.0, 90.0, np.nan, np.inf])
def test_case_must_last_whole_minutes(duration):
    case = GrinderCase('odd', AMBIENT, running_heat(lambda time: True), duration)
    with pytest.raises(ValueError, match='positive multiple of 60 s in case odd'):
        simulate_grinder(case)


def test_unknown_names_and_sets_are_refused():
    with pytest.raises(ValueError, match='E1, E2, E3 but found E9'):
        record_grinder(['E1', 'E9'])
    with pytest.raises(ValueError, match='constant1, constant2, regular, random but found E1'):
        record_flux_case('E1')
    with pytest.raises(ValueError, match=r'28 \(machine\) or 38 .* but found 30'):
        record_grinder(sensors=30)
    for noise in (-0.1, 1.1, np.nan):
        with pytest.raises(ValueError, match='noise: expected a fraction from 0 to 1'):
            record_flux_case('random', noise)


@given(cuts=st.lists(st.integers(1, 40_000), min_size=1, max_size=12))
@settings(max_examples=30)
def test_states_do_not_depend_on_how_time_is_cut(cuts):
    whole, cut = grinder(), grinder()
    whole.advance(sum(cuts) / 1000)
    for milliseconds in cuts:
        cut.advance(milliseconds / 1000)
    assert cut.time == whole.time
    np.testing.assert_array_equal(states(cut), states(whole))


def test_states_hold_between_the_internal_steps():
    machine = grinder()
    machine.advance(20.0)
    held = states(machine)
    machine.advance(9.999)
    np.testing.assert_array_equal(states(machine), held)
    machine.advance(0.001)
    assert np.any(states(machine) != held)


@pytest.mark.parametrize(
    'heat',
    [running_heat(lambda time: True), surface_heat(lambda time: np.array([600, 200, 400, 800.0]))],
    ids=['running', 'flux'],
)
def test_step_conserves_energy(heat):
    """Heat stored in one step = sources - losses, summed over all nodes."""
    temperatures = 20.0 + np.linspace(0.0, 12.0, len(GRINDER_NODES))
    watts, ambient = heat(0.0, temperatures), 23.0
    after = grinder_step(temperatures, ambient, watts)
    stored = GRINDER_CAPACITY @ (after - temperatures) / GRINDER_STEP
    assert stored == pytest.approx(watts.sum() - GRINDER_LOSS @ (after - ambient), rel=1e-9)


def test_heat_of_the_grinder_at_work():
    temperatures = np.full(len(GRINDER_NODES), 22.0)
    on = running_heat(lambda time: True)(0.0, temperatures)
    assert on.sum() == pytest.approx(230 + 60 + 45 + 20 + 20 + 60 + 15 + 10 + 160 + 15)
    off = running_heat(lambda time: False)(0.0, temperatures)
    assert {GRINDER_NODES[i]: off[i] for i in np.flatnonzero(off)} == {'oil': 15.0}
    temperatures[GRINDER_NODES.index('sp')] = 122.0
    warm = running_heat(lambda time: True)(0.0, temperatures)
    assert on.sum() - warm.sum() == pytest.approx(230.0 * (1.0 - np.exp(-1.0)))


def test_flux_enters_through_its_area():
    """The spread over nodes adds up to one: a flux brings area times flux."""
    for place, area in zip(FLUX_PLACES, (0.28, 0.14, 0.21, 0.084), strict=True):
        flux = np.array([1000.0 * (name == place) for name in FLUX_PLACES])
        watts = surface_heat(lambda time, flux=flux: flux)(0.0, np.zeros(len(GRINDER_NODES)))
        assert watts.sum() == pytest.approx(1000.0 * area)


def test_random_flux_holds_its_level_for_twenty_minutes():
    heat = FLUX_CASES['random'].heat
    nodes = np.zeros(len(GRINDER_NODES))
    np.testing.assert_array_equal(heat(0.0, nodes), heat(1199.0, nodes))
    assert np.any(heat(1200.0, nodes) != heat(1199.0, nodes))


def test_intermittent_work_begins_with_half_an_hour_on():
    heat = GRINDER_EXPERIMENTS['E3'].heat
    nodes = np.full(len(GRINDER_NODES), 22.0)
    watts = [heat(60.0 * minute, nodes).sum() for minute in (0, 29, 30, 59, 60, 299)]
    assert [value > 100.0 for value in watts] == [True, True, False, False, True, False]


def test_a_cold_grinder_in_a_constant_room_stays_as_it_is():
    machine = Grinder(AmbientCourse(20.0), surface_heat(lambda time: np.zeros(4)))
    first = machine.sensor_temperatures()
    machine.advance(3600.0)
    np.testing.assert_allclose(machine.node_temperatures, 20.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(machine.sensor_temperatures(), first, rtol=0, atol=1e-9)
    np.testing.assert_allclose(machine.displacement(), 0.0, atol=1e-13)


def test_displacement_bends_away_from_zero_alike_on_both_sides():
    rise = np.linspace(0.0, 8.0, len(GRINDER_NODES))
    np.testing.assert_array_equal(grinder_displacement(np.zeros(len(GRINDER_NODES))), [0.0, 0.0])
    np.testing.assert_array_equal(grinder_displacement(-rise), -grinder_displacement(rise))
    once, twice = grinder_displacement(rise), grinder_displacement(2.0 * rise)
    assert np.all(np.abs(twice) > 2.0 * np.abs(once))


def test_streaming_equals_the_recording():
    case = GRINDER_EXPERIMENTS['E3']
    run, machine = simulate_grinder(case), case.grinder()
    for k in range(1, 5 * 130 + 1):
        machine.advance(12.0)
        if k % 5 == 0:
            np.testing.assert_array_equal(machine.displacement(), run.displacement[k // 5])
    np.testing.assert_array_equal(machine.sensor_temperatures(), run.temperature[130])


def test_recordings_depend_neither_on_the_names_nor_on_the_sensors_asked_for():
    alone, together = record_grinder(['E3'], 2)['E3'], record_grinder(seed=2)['E3']
    np.testing.assert_array_equal(alone.temperature, together.temperature)
    np.testing.assert_array_equal(alone.displacement, together.displacement)
    machine = record_grinder(['E3'], 2, sensors=28)['E3']
    assert (machine.sensor, alone.sensor) == (GRINDER_SENSORS[:28], GRINDER_SENSORS)
    assert [name.startswith('air') for name in alone.sensor] == [False] * 28 + [True] * 10
    np.testing.assert_array_equal(machine.temperature, alone.temperature[:, :28])
    np.testing.assert_array_equal(machine.displacement, alone.displacement)
    assert list(record_grinder(['E3', 'E1'])) == ['E3', 'E1']


def test_noise_has_the_stated_size_and_follows_the_seed():
    run, truth = record_grinder(['E1'])['E1'], simulate_grinder(GRINDER_EXPERIMENTS['E1'])
    assert (run.temperature - truth.temperature).std() == pytest.approx(0.1 / 5**0.5, rel=0.03)
    assert (run.displacement - truth.displacement).std() == pytest.approx(0.1e-6, rel=0.1)
    assert np.any(record_grinder(['E1'], 1)['E1'].temperature != run.temperature)
    np.testing.assert_array_equal(record_grinder(['E1'])['E1'].temperature, run.temperature)


def test_flux_noise_is_in_proportion_to_the_rise():
    clean, noisy = record_flux_case('random'), record_flux_case('random', 0.05, 1)
    rise, seen = (run.rise(run.temperature[0]) for run in (clean, noisy))
    large = np.abs(rise) > 1e-3
    relative = seen[large] / rise[large] - 1.0
    assert 0.0499 < relative.max() <= 0.05 + 1e-9
    assert -0.05 - 1e-9 <= relative.min() < -0.0499
    np.testing.assert_array_equal(noisy.displacement, clean.displacement)
    np.testing.assert_array_equal(
        record_flux_case('random', 0.05, 1).temperature, noisy.temperature
    )
    assert np.any(record_flux_case('random', 0.05, 2).temperature != noisy.temperature)


def test_flux_cases_draw_noise_of_their_own():
    factors = []
    for name in ('regular', 'random'):
        clean, noisy = record_flux_case(name), record_flux_case(name, 0.05)
        factors.append(
            (noisy.temperature[1:] - clean.temperature[0])
            / (clean.temperature[1:] - clean.temperature[0])
            - 1.0
        )
    assert abs(np.corrcoef(factors[0].ravel(), factors[1].ravel())[0, 1]) < 0.05
