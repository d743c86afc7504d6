# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The ball-screw axis: its motion between stops and each knob on it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis

FREE = {'coulomb_forward': 0.0, 'coulomb_backward': 0.0, 'offset': 0.0}
FORCE = 351.5065188
MASS, VISCOUS, COULOMB, OFFSET = 95.1089, 203.5034, 20.3935, -3.1648


def states(duties, velocity=0.0, **knobs):
    """Position and velocity after each duty, shape (n, 2)."""
    axis = BallscrewAxis(BallscrewAxisConfig(**knobs), velocity=velocity)
    found = []
    for duty in duties:
        axis.drive(duty)
        found.append((axis.position, axis.velocity))
    return np.array(found)


def wild_duties(seed, size=300):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-0.25, 0.25, size // 20), 20)


def plain_steps(duties, substeps, mass=MASS):
    """The same axis in small Euler steps, friction at rest held below Coulomb's."""
    step = 1e-3 / substeps
    position = velocity = 0.0
    found = []
    for duty in duties:
        force = FORCE * duty - OFFSET
        for _ in range(substeps):
            if velocity == 0.0 and abs(force) <= COULOMB:
                break
            sign = math.copysign(1.0, velocity or force)
            after = velocity + step * (force - VISCOUS * velocity - sign * COULOMB) / mass
            after = 0.0 if after * velocity < 0.0 else after
            position += 0.5 * step * (velocity + after)
            velocity = after
        found.append((position, velocity))
    return np.array(found)


@pytest.mark.parametrize(
    ('knobs', 'message'),
    [
        ({'mass': 0.0}, 'mass = 0.0 is outside'),
        ({'direction': 0.0}, 'direction: expected 1 or -1 but found 0.0'),
        ({'breakaway_ratio': 0.9}, 'breakaway_ratio = 0.9 is outside'),
        ({'viscous_forward': 0.0}, 'viscous_forward = 0.0 is outside'),
    ],
)
def test_an_axis_that_cannot_be_is_refused(knobs, message):
    with pytest.raises(ValueError, match=message):
        BallscrewAxisConfig(**knobs)


def test_a_duty_that_is_no_number_changes_nothing():
    axis = BallscrewAxis(velocity=0.1)
    with pytest.raises(ValueError, match='duty: expected a finite number'):
        axis.drive(math.nan)
    assert (axis.position, axis.velocity) == (0.0, 0.1)


@settings(max_examples=30)
@given(
    st.integers(0, 10_000), st.floats(0.0, 60.0), st.floats(1.0, 3.0), st.sampled_from([2, 5, 10])
)
def test_a_period_in_parts_is_the_period(seed, coulomb, ratio, parts):
    knobs = {'coulomb_forward': coulomb, 'breakaway_ratio': ratio}
    duties = wild_duties(seed, 200)
    whole = states(duties, **knobs)
    part = states(np.repeat(duties, parts), period=1e-3 / parts, **knobs)[parts - 1 :: parts]
    np.testing.assert_allclose(whole, part, rtol=0.0, atol=1e-12)


def test_it_is_what_small_steps_converge_to():
    duties = wild_duties(0)
    duties[np.abs(duties) < 0.1] = 0.0  # pauses, in which it comes to rest
    exact = states(duties)
    errors = [np.abs(exact - plain_steps(duties, n)).max(axis=0) for n in (10, 1000)]
    assert (errors[1] < 0.2 * errors[0]).all()
    assert (errors[1] < [1e-7, 1e-6]).all()
    assert (exact[:, 1] == 0.0).any()


def test_without_friction_it_is_its_linear_model():
    dynamics, entry, _ = BallscrewAxisConfig().linear().discrete()
    state = np.zeros(2)
    duties = wild_duties(1)
    found = states(duties, **FREE)
    for duty, (position, velocity) in zip(duties, found, strict=True):
        state = dynamics @ state + entry * duty
        np.testing.assert_allclose([velocity, position], state, rtol=0.0, atol=1e-13)


def test_it_holds_against_friction_and_offset():
    # 351.5 N duty + 3.16 N lie within 20.39 N of friction
    assert not states([0.049] * 100).any()
    assert not states([-0.067] * 100).any()
    assert states([0.0491] * 100)[-1, 0] > 0.0
    assert states([-0.0671] * 100)[-1, 0] < 0.0


@pytest.mark.parametrize('duty', [0.2, -0.2])
def test_steady_velocity(duty):
    axis = states([duty] * 8000)
    expected = (FORCE * duty - OFFSET - math.copysign(COULOMB, duty)) / VISCOUS
    assert axis[-1, 1] == pytest.approx(expected, rel=1e-6)


def test_it_stops_at_the_right_place_and_time():
    # thrown at 0.1 m/s without force: v = (v0 + w) exp(-t/T) - w with w = friction / viscous
    lag, wind = MASS / VISCOUS, (COULOMB + OFFSET) / VISCOUS
    time = lag * math.log(1.0 + 0.1 / wind)
    way = lag * 0.1 - wind * time
    found = states([0.0] * 500, velocity=0.1)
    at_rest = np.flatnonzero(found[:, 1] == 0.0)
    assert at_rest[0] == math.ceil(1e3 * time) - 1
    np.testing.assert_allclose(found[at_rest, 0], way, rtol=1e-12)


def test_mass_and_gain_change_the_acceleration():
    knobs = {**FREE, 'viscous_forward': 1.0, 'viscous_backward': 1.0}
    nominal = states([0.1] * 10, **knobs)[-1, 1]
    assert states([0.1] * 10, mass_factor=1.3, **knobs)[-1, 1] == pytest.approx(
        nominal / 1.3, rel=1e-4
    )
    assert states([0.1] * 10, gain_factor=0.7, **knobs)[-1, 1] == pytest.approx(
        0.7 * nominal, rel=1e-12
    )


def test_friction_factor_scales_both_frictions_and_not_the_offset():
    doubled = states([0.3] * 8000, friction_factor=2.0)[-1, 1]
    assert doubled == pytest.approx((0.3 * FORCE - OFFSET - 2 * COULOMB) / (2 * VISCOUS), rel=1e-6)


def test_a_harder_breakaway_holds_longer_but_slides_alike():
    assert not states([0.09] * 100, breakaway_ratio=2.0).any()
    np.testing.assert_array_equal(states([0.2] * 100, breakaway_ratio=2.0), states([0.2] * 100))


def test_a_load_is_an_offset_from_its_time_on():
    late = states([0.1] * 200, load=30.0, load_time=0.1)
    np.testing.assert_array_equal(late[:100], states([0.1] * 100))
    axis = BallscrewAxis(
        BallscrewAxisConfig(offset=OFFSET + 30.0), position=late[99, 0], velocity=late[99, 1]
    )
    for _ in range(100):
        axis.drive(0.1)
    np.testing.assert_allclose(late[-1], [axis.position, axis.velocity], rtol=1e-12)


def test_direction_mirrors_the_force_alone():
    duties = wild_duties(2)
    np.testing.assert_array_equal(states(duties, direction=-1.0), states(-duties))


def test_frictions_by_direction():
    config = BallscrewAxisConfig.by_direction()
    for duty, viscous, coulomb in ((0.2, 166.7061, 20.1440), (-0.2, 240.4236, 20.6277)):
        axis = BallscrewAxis(config)
        for _ in range(9000):
            axis.drive(duty)
        expected = (FORCE * abs(duty) - coulomb) / viscous
        assert abs(axis.velocity) == pytest.approx(expected, rel=1e-5)


def test_the_encoder_counts_and_does_not_see_backlash():
    plain = BallscrewAxis(BallscrewAxisConfig())
    loose = BallscrewAxis(BallscrewAxisConfig(backlash=100e-6))
    grated = BallscrewAxis(BallscrewAxisConfig(backlash=100e-6, sensor='grating'))
    for duty in wild_duties(3):
        for axis in (plain, loose, grated):
            axis.drive(duty)
        assert loose.measure() == plain.measure()
        assert abs(plain.measure() - plain.position) <= 25.001e-9
        assert abs(grated.measure() - grated.position) <= 25.001e-9
        assert abs(loose.position - plain.position) <= 50.001e-6


def test_backlash_takes_its_part_at_a_turn_amid_a_period():
    axis = BallscrewAxis(
        BallscrewAxisConfig(backlash=100e-6, period=0.05, sensor='encoder'), velocity=0.01
    )
    axis.drive(-0.1)
    lag, wind = MASS / VISCOUS, (0.1 * FORCE + OFFSET + COULOMB) / VISCOUS
    turn = lag * 0.01 - wind * lag * math.log(1.0 + 0.01 / wind)
    assert 0.0 < axis.measure() < turn - 50e-6  # the screw is on its way back within the play
    assert axis.position == pytest.approx(turn - 50e-6, rel=1e-9)


def test_a_slide_left_behind_by_the_screw_stands():
    axis = BallscrewAxis(BallscrewAxisConfig(backlash=1e-3))
    for _ in range(20):
        axis.drive(0.2)
    assert (axis.position, axis.velocity) == (0.0, 0.0)
    assert axis.measure() > 0.0
