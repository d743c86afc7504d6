# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the ball-screw axis' controller, and its friction feedforward."""

import math

import numpy as np
import pytest

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.servo.built_in import built_in_controller
from fuzzycnc_ros.core.servo.friction import MovingDisturbance
from fuzzycnc_ros.core.servo.observer import ObserverDesign, ObserverNoise
from fuzzycnc_ros.core.servo.profile import point_to_point
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis
from fuzzycnc_ros.simulation.servo.positioning import position

AXIS = BallscrewAxisConfig().linear()
FORCE = BallscrewAxisConfig().force_max


def ruled(plant=None, **settings):
    """Return the production controller of the ball screw, with other settings."""
    return built_in_controller('ballscrew', 'variable_universe', settings, **(plant or {}))


def drive(controller, axis, reference, velocity=0.0, periods=1000):
    """Follow a reference that moves on at a velocity; return where it has got to."""
    for _ in range(periods):
        axis.drive(controller.step(reference, axis.measure(), velocity))
        reference += velocity * axis.period
    return reference


@pytest.mark.parametrize(
    ('knobs', 'message'),
    [
        ({'friction': 1.5}, 'friction from 0 to 1 but found 1.5'),
        ({'friction': math.nan}, 'friction from 0 to 1'),
        ({'estimator': 0.0}, 'estimator from 0.2 to 8 but found 0.0'),
        ({'bandwidth': 0.005}, 'bandwidth from 0.01 to 12 but found 0.005'),
        ({'speed': 1.0}, "output_gain, disturbance for variable_universe but found 'speed'"),
    ],
)
def test_settings_without_meaning_are_refused(knobs, message):
    with pytest.raises(ValueError, match=message):
        ruled(**knobs)


@pytest.mark.parametrize('bandwidth', [30.0, 60.0])
def test_the_gains_close_a_critically_damped_loop(bandwidth):
    params = ruled(bandwidth=bandwidth / 100.0).params
    # duty feeds back position and velocity: s^2 + s (1 + k gain) / lag + k gain / lag
    stiffness = params.error_gain * AXIS.gain / AXIS.lag
    damping = (1.0 + params.rate_gain * AXIS.gain) / AXIS.lag
    assert stiffness == pytest.approx(bandwidth**2)
    assert damping == pytest.approx(2.0 * bandwidth)
    assert params.rate_range / AXIS.gain == pytest.approx(0.94036 / 0.286)


@pytest.mark.parametrize('axis', [AXIS, LatheAxisConfig().linear()], ids=['ballscrew', 'lathe'])
def test_the_observer_does_not_depend_on_the_assumed_error_of_the_sensor(axis):
    fine, coarse = (
        ObserverDesign.of(axis, ObserverNoise.of_bandwidth(axis, 150.0, sensor)).gain
        for sensor in (1e-9, 1e-6)
    )
    np.testing.assert_allclose(fine, coarse, rtol=1e-6)


def test_a_faster_observer_has_faster_poles():
    radius = []
    for bandwidth in (60.0, 120.0, 240.0):
        design = ObserverDesign.of(AXIS, ObserverNoise.of_bandwidth(AXIS, bandwidth))
        left = design.dynamics - np.outer(design.gain, design.reading)
        radius.append(np.abs(np.linalg.eigvals(left)).max())
    rates = -np.log(radius) / AXIS.period
    np.testing.assert_allclose(rates / rates[0], [1.0, 2.0, 4.0], rtol=0.05)


@pytest.mark.parametrize('velocity', [0.05, -0.05])
def test_what_is_fed_forward_does_not_end_up_in_the_observed_disturbance(velocity):
    config = BallscrewAxisConfig()
    observed = []
    for share in (0.0, 1.0):
        controller, axis = ruled(friction=share), BallscrewAxis()
        drive(controller, axis, 0.0, velocity)
        observed.append(FORCE * controller.status.disturbance)
    friction = math.copysign(config.coulomb_forward, velocity)
    np.testing.assert_allclose(observed, [config.offset + friction, config.offset], atol=0.02)


def test_friction_known_takes_the_error_out_of_a_reversal():
    # 0.1 s there and back at 0.37 m/s^2
    time = 1e-3 * np.arange(100)
    reference, velocity = 0.02 * time - 0.185 * time**2, 0.02 - 0.37 * time
    largest = []
    for share in (0.0, 1.0):
        controller, axis, errors = ruled(friction=share), BallscrewAxis(), []
        start = drive(controller, axis, 0.0, 0.02)
        for target, speed in zip((start + reference).tolist(), velocity.tolist(), strict=True):
            errors.append(abs(target - axis.position))
            axis.drive(controller.step(target, axis.measure(), speed, -0.37))
        largest.append(max(errors[50:]))
    assert largest[1] < 0.1 * largest[0]


@pytest.mark.parametrize('direction', [1.0, -1.0])
def test_it_positions_whichever_way_the_duty_drives(direction):
    config = BallscrewAxisConfig(direction=direction)
    controller, axis = ruled({'direction': direction}), BallscrewAxis(config)
    target = drive(controller, axis, 0.0, 0.05)
    drive(controller, axis, target)
    assert abs(axis.position - target) < 1e-7
    assert not controller.watch.fault


@pytest.mark.parametrize('step', [1e-3, -1e-2])
def test_a_step_does_not_overshoot(step):
    controller, axis = ruled(), BallscrewAxis()
    left = []
    for _ in range(1000):
        axis.drive(controller.step(step, axis.measure()))
        left.append((step - axis.position) * math.copysign(1.0, step))
    assert min(left) > -1e-6
    assert np.abs(left[300:]).max() < 1e-6


MOVES = {
    'nominal': ({}, 0.05),
    'mass +30 %': ({'mass_factor': 1.3}, 0.2),
    'friction x0.5': ({'friction_factor': 0.5}, 0.1),
    'friction x2': ({'friction_factor': 2.0}, 0.4),
    'noise': ({'noise': 1e-7}, 0.05),
    'breakaway 1.3': ({'breakaway_ratio': 1.3}, 0.3),
    'breakaway 1.5': ({'breakaway_ratio': 1.5}, 0.7),
}


@pytest.mark.parametrize('target', [0.05, -0.05])
@pytest.mark.parametrize('name', MOVES)
def test_a_profile_does_not_end_stuck_short_of_its_target(name, target):
    knobs, patience = MOVES[name]
    profile = point_to_point(0.0, target)
    plant = BallscrewAxis(BallscrewAxisConfig(**knobs))
    run = position(ruled(), plant, profile.sample(1e-3), 2.5)
    assert run.settle() - profile.duration < patience
    assert not run.fault


def test_a_missing_reading_while_friction_is_fed_forward_is_bridged():
    config = BallscrewAxisConfig(dropout_time=0.5, dropout_duration=4e-3)
    controller, axis = ruled(), BallscrewAxis(config)
    target = drive(controller, axis, 0.0, 0.05, periods=510)
    assert abs(axis.position - target) < 20e-6
    assert controller.status.bad_total == 4
    assert not controller.watch.fault


def test_what_is_seen_in_motion_is_remembered_by_direction():
    memory = MovingDisturbance(1e-3, settle=10e-3)
    memory.reset(0.5)
    for _ in range(10):
        memory.learn(1, 7.0)  # not found yet
    assert memory.recall(1) == 0.5
    for seen in (0.1, 0.2, 0.3):
        memory.learn(1, seen)
    assert memory.recall(1) == pytest.approx(0.2)
    assert memory.recall(-1) == pytest.approx(0.2)  # better than what is seen at rest
    memory.rest()
    for _ in range(12):
        memory.learn(-1, -0.2)
    assert (memory.recall(1), memory.recall(-1)) == (pytest.approx(0.2), pytest.approx(-0.2))
    memory.reset(0.0)
    assert memory.recall(-1) == 0.0


SET_OFF = {
    'nominal': (BallscrewAxisConfig(), 2e-6),
    'by direction': (BallscrewAxisConfig.by_direction(), 12e-6),
    'breakaway 1.3': (BallscrewAxisConfig(breakaway_ratio=1.3), 2e-6),
}


@pytest.mark.parametrize('name', SET_OFF)
def test_it_sets_off_after_a_rest_with_what_it_saw_in_motion(name):
    """With what the observer learns at rest the errors reach 4.8, 34 and 4.1 um."""
    config, bound = SET_OFF[name]
    controller, axis = ruled(), BallscrewAxis(config)
    rng, place, worst = np.random.default_rng(1), 0.0, []
    for _ in range(24):
        edges = np.repeat([1.0, -1.0], rng.integers(8, 80)) * rng.choice([-1.0, 1.0])
        edges *= rng.uniform(0.6, 2.0)
        change = np.append(edges, np.zeros(rng.choice([20, 250])))
        speed = np.append(0.0, np.cumsum(change)[:-1] * axis.period)
        worst.append(0.0)
        for velocity, acceleration in zip(speed.tolist(), change.tolist(), strict=True):
            worst[-1] = max(worst[-1], abs(place - axis.position))
            axis.drive(controller.step(place, axis.measure(), velocity, acceleration))
            place += velocity * axis.period + 0.5 * acceleration * axis.period**2
    assert max(worst[8:]) < bound  # both directions were met


def test_an_axis_that_waits_while_others_move_sets_off_with_nothing_learnt_at_rest():
    controller, axis = ruled(), BallscrewAxis()
    place, worst = 0.0, 0.0
    # to 0.6 mm/s and back, too slow to learn from: 18 um with what is seen at rest
    for _ in range(4):
        change = np.repeat([0.06, -0.06, 0.0], [10, 10, 300]) * (1.0 + np.arange(320) % 2)
        velocity = 0.0
        for acceleration in change.tolist():
            worst = max(worst, abs(place - axis.position))
            axis.drive(controller.step(place, axis.measure(), velocity, acceleration))
            place += velocity * axis.period + 0.5 * acceleration * axis.period**2
            velocity = 0.0 if acceleration == 0.0 else velocity + acceleration * axis.period
    assert worst < 9e-6
