# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The lathe's axis: its motion, its friction and each knob on it; many of them at once."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.simulation.servo.axes import LatheAxis
from fuzzycnc_ros.simulation.servo.lathe_axes import LatheAxes, random_moves

FREE = {'coulomb': 0.0, 'breakaway': 0.0, 'noise': 0.0}


def course(duties, **knobs):
    """True positions after each duty."""
    axis = LatheAxis(LatheAxisConfig(**knobs))
    positions = []
    for duty in duties:
        axis.drive(duty)
        positions.append(axis.position)
    return np.array(positions)


def wild_duties(seed, size=400):
    """Duties that change often, with pauses that let friction hold."""
    rng = np.random.default_rng(seed)
    duties = np.repeat(rng.uniform(-0.4, 0.4, size // 40), 40)
    duties[rng.random(size) < 0.3] = 0.0
    return duties


@pytest.mark.parametrize(
    ('knobs', 'message'),
    [
        ({'coulomb': 0.05}, 'breakaway: expected coulomb = 0.05 or more but found 0.03'),
        ({'direction': 0.5}, 'direction: expected 1 or -1 but found 0.5'),
        ({'gain_factor': 0.0}, 'gain_factor = 0.0 is outside'),
        ({'substeps': 0}, 'substeps = 0 is outside'),
        ({'load': math.nan}, 'load = nan is outside'),
    ],
)
def test_an_axis_that_cannot_be_is_refused(knobs, message):
    with pytest.raises(ValueError, match=message):
        LatheAxisConfig(**knobs)


@pytest.mark.parametrize('duty', [math.nan, math.inf])
def test_a_duty_that_is_no_number_changes_nothing(duty):
    axis, untouched = LatheAxis(), LatheAxis()
    for _ in range(50):
        axis.drive(0.5)
        untouched.drive(0.5)
    with pytest.raises(ValueError, match='duty: expected a finite number'):
        axis.drive(duty)
    assert axis.measure() == untouched.measure()
    axis.drive(0.1)
    untouched.drive(0.1)
    assert (axis.position, axis.velocity) == (untouched.position, untouched.velocity)


def test_more_than_the_largest_duty_is_cut():
    duties = np.array([3.0] * 100 + [-3.0] * 100)
    assert np.array_equal(course(duties, duty_max=0.4), course(np.clip(duties, -0.4, 0.4)))


def test_the_sensor_lags_and_counts():
    axis = LatheAxis(LatheAxisConfig(**FREE))
    for _ in range(500):
        axis.drive(0.3)
    lag = axis.position - axis.measure()
    assert lag == pytest.approx(0.006 * axis.velocity, abs=0.4e-6)


@pytest.mark.parametrize('duty', [0.0299, -0.0299])
def test_breakaway_holds_the_axis(duty):
    assert not course([duty] * 500).any()


def test_above_breakaway_it_slides_against_coulomb_friction_and_comes_to_rest():
    axis = LatheAxis()
    for _ in range(600):
        axis.drive(0.05)
    # 0.05 - 0.02 of the duty are left
    assert axis.velocity == pytest.approx(0.286 * 0.03, rel=1e-6)
    for _ in range(200):
        axis.drive(0.0)
    assert axis.velocity == 0.0
    rest = axis.position
    axis.drive(0.0)
    assert axis.position == rest


def test_friction_takes_way():
    duties = wild_duties(0)
    none, some, more = (
        np.abs(np.diff(course(duties, coulomb=level, breakaway=1.5 * level))).sum()
        for level in (0.0, 0.02, 0.04)
    )
    assert none > some > more > 0.0


def test_gain_scales_a_frictionless_course():
    duties = wild_duties(1)
    nominal = course(duties, **FREE)
    for factor in (0.5, 1.5):
        found = course(duties, gain_factor=factor, **FREE)
        np.testing.assert_allclose(found, factor * nominal, rtol=1e-12, atol=1e-18)


def test_direction_mirrors_the_course_but_not_the_load():
    duties = wild_duties(2)
    np.testing.assert_array_equal(course(duties, direction=-1.0), course(-duties))
    loaded = course(duties, direction=-1.0, load=0.05)
    np.testing.assert_array_equal(loaded, course(-duties, load=0.05))


def test_a_load_pushes_the_axis_back_from_its_time_on():
    found = course([0.0] * 400, load=0.1, load_time=0.1)
    assert not found[:100].any()
    steady = np.diff(found[-10:]) / 1e-3
    # 0.1 of load less 0.02 of friction
    np.testing.assert_allclose(steady, -0.286 * 0.08, rtol=1e-6)


def test_a_duty_as_large_holds_the_load():
    assert np.abs(course([0.1] * 400, load=0.1, **FREE)[-1]) < 0.286 * 0.1 * 2.4e-3


def test_backlash_is_lost_at_each_reversal_and_a_grating_sees_it():
    there, back = [0.2] * 300, [-0.2] * 300
    knobs = {'noise': 0.0, 'count': 0.0, 'periodic_error': 0.0, 'pitch_error': 0.0}
    axes = {
        (sensor, play): LatheAxis(LatheAxisConfig(sensor=sensor, backlash=play, **knobs))
        for sensor in ('grating', 'encoder')
        for play in (0.0, 40e-6)
    }
    slid = []
    for axis in axes.values():
        for duty in there + back + [0.0] * 300:
            axis.drive(duty)
        slid.append(axis.position)
    # the slide starts amid the play: it lags by half on the way out and leads by half back
    np.testing.assert_allclose(np.array(slid) - slid[0], [0.0, 20e-6, 0.0, 20e-6], atol=1e-12)
    read = {key: axis.measure() for key, axis in axes.items()}
    assert read['grating', 40e-6] - read['grating', 0.0] == pytest.approx(20e-6, abs=1e-9)
    assert read['encoder', 40e-6] == pytest.approx(read['encoder', 0.0], abs=1e-12)


def test_the_slide_stands_while_the_screw_turns_through_backlash():
    axis = LatheAxis(LatheAxisConfig(backlash=1e-3))
    for _ in range(30):
        axis.drive(0.05)
    assert (axis.position, axis.velocity) == (0.0, 0.0)
    for _ in range(300):
        axis.drive(0.05)
    assert axis.position > 0.0
    assert axis.velocity == pytest.approx(0.286 * 0.03, rel=1e-3)


def test_finer_substeps_change_little():
    duties = wild_duties(3)
    reference = course(duties, substeps=320)
    errors = [np.abs(course(duties, substeps=n) - reference).max() for n in (5, 20, 80)]
    assert errors[0] > errors[1] > errors[2]
    assert errors[1] < 2e-6


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.floats(0.0, 0.05), st.floats(1.0, 2.0))
def test_mirrored_duties_give_the_mirrored_course(seed, coulomb, ratio):
    duties = wild_duties(seed, 120)
    knobs = {'coulomb': coulomb, 'breakaway': ratio * coulomb, 'noise': 0.0}
    np.testing.assert_array_equal(course(-duties, **knobs), -course(duties, **knobs))


def test_it_starts_where_it_is_told_to():
    axis = LatheAxis(position=-0.05)
    assert axis.position == -0.05
    assert axis.measure() == pytest.approx(-0.05, abs=1e-6)


KNOBS = [
    {},
    {'gain_factor': 0.5, 'load': -0.08, 'load_time': 0.2, 'seed': 4},
    {'coulomb': 0.05, 'breakaway': 0.09, 'noise': 0.2e-6},
    {**FREE, 'sensor': 'encoder'},
    {'sensor': 'encoder', 'backlash': 30e-6},
    {'backlash': 30e-6, 'duty_max': 0.2},
    {'direction': -1.0, 'velocity_lag': 0.03, 'gain': 0.4},
    {'counts_lost': 100, 'count_loss_time': 0.4, 'torque_lag': 3e-3},
]


def test_axes_together_move_as_each_alone():
    configs = [LatheAxisConfig(**knobs) for knobs in KNOBS]
    batch, single = LatheAxes(configs, 2e-3), [LatheAxis(c, position=2e-3) for c in configs]
    targets = np.linspace(-5e-3, 9e-3, len(configs))
    # a loop with integral action, so that each axis creeps, sticks and breaks away
    held = np.zeros(len(configs))
    for _ in range(800):
        readings = [axis.measure() for axis in single]
        np.testing.assert_allclose(batch.measure(), readings, rtol=0.0, atol=1e-15)
        held += 0.05 * (targets - readings)
        duties = 8.0 * (targets - readings) + held
        for axis, duty in zip(single, duties.tolist(), strict=True):
            axis.drive(duty)
        batch.drive(duties)
    for name in ('position', 'velocity'):
        expected = [getattr(axis, name) for axis in single]
        np.testing.assert_allclose(getattr(batch, name), expected, rtol=0.0, atol=1e-15)


def test_axes_together_refuse_what_they_cannot_do():
    with pytest.raises(ValueError, match='expected one or more axes'):
        LatheAxes([])
    with pytest.raises(ValueError, match='one period and number of substeps'):
        LatheAxes([LatheAxisConfig(), LatheAxisConfig(substeps=5)])
    axes = LatheAxes([LatheAxisConfig()] * 2)
    with pytest.raises(ValueError, match=r'expected 2 finite numbers but found the shape \(3,\)'):
        axes.drive([0.1, 0.1, 0.1])
    with pytest.raises(ValueError, match='not all finite'):
        axes.drive([0.1, math.nan])
    assert not axes.position.any()


@pytest.mark.parametrize(('hard', 'coulomb', 'ratio'), [(False, 0.03, 1.5), (True, 0.05, 1.8)])
def test_random_moves_fill_their_ranges(hard, coulomb, ratio):
    moves = random_moves(400, hard=hard, seed=1)
    drawn = [move.config for move in moves]
    for values, low, high in (
        ([c.gain_factor for c in drawn], 0.5, 1.5),
        ([c.load for c in drawn], -0.1, 0.1),
        ([c.noise for c in drawn], 0.0, 0.2e-6),
        ([c.coulomb for c in drawn], 0.0, coulomb),
        ([c.breakaway / c.coulomb for c in drawn], 1.0, ratio),
        ([math.log(abs(move.target)) for move in moves], math.log(5e-5), math.log(0.15)),
    ):
        assert low <= min(values) < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < max(values) <= high
    assert 150 < sum(move.target > 0.0 for move in moves) < 250
    assert moves == random_moves(400, hard=hard, seed=1)
    assert moves[0] != random_moves(1, hard=hard, seed=2)[0]
