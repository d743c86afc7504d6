# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the motion fits the duty, and the readings the sensor: no alarm on what is possible."""

from dataclasses import replace

import numpy as np
import pytest

from fuzzycnc_ros.components.servo.servo_axis import ServoAxis
from fuzzycnc_ros.components.servo.servo_controller_config import (
    ServoControllerConfig,
    make_controllers,
    motion_doubt,
    profile_limits,
)
from fuzzycnc_ros.components.servo.servo_plausibility import MotionDoubt, MotionWatch
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis, LatheAxis
from fuzzycnc_ros.simulation.servo.lathe_axes import random_moves


def moved(plant, target, *, model='lathe', rest=0.3):
    """Move a plant; return the axis that did it and the period of its fault, if there was one."""
    config = ServoControllerConfig(axes=(f'X:{model}',))
    (controller,) = make_controllers(config).values()
    axis = ServoAxis('X', controller, (-1.0, 1.0), motion_doubt(config.driven['X']))
    axis.hold(plant.measure())
    way = axis.way(target, profile_limits(config, float('nan'), config.driven['X']))
    axis.go(way)
    for period in range(len(way) + round(rest * 1e3)):
        plant.drive(axis.step(plant.measure()))
        if axis.fault:
            return axis, period
    return axis, None


@pytest.mark.slow
@pytest.mark.parametrize('hard', [False, True], ids=['moderate', 'hard friction'])
def test_no_alarm_on_random_moves(hard):
    """Gain x0.5 to x1.5, load 10 %, noise to 0.2 um; hard: friction 5 %, breakaway 9 %."""
    rng = np.random.default_rng(7)
    for move in random_moves(200, hard=hard, seed=11):
        # every other load sets in on the way
        begin = float(rng.uniform(0.0, 0.5)) if rng.random() < 0.5 else 0.0
        axis, _ = moved(LatheAxis(replace(move.config, load_time=begin)), move.target)
        assert axis.fault == '', move


@pytest.mark.parametrize(
    'changes',
    [{}, {'mass_factor': 0.7}, {'mass_factor': 1.3}, {'friction_factor': 2.0}],
    ids=str,
)
@pytest.mark.parametrize('target', [-0.1, 1e-4])
def test_no_alarm_on_the_ball_screw(changes, target):
    plant = BallscrewAxis(BallscrewAxisConfig(**changes))
    axis, _ = moved(plant, target, model='ballscrew')
    assert axis.fault == ''


@pytest.mark.parametrize('controller', ['variable_universe', 'cascade', 'pid'])
def test_no_alarm_where_the_target_changes_on_the_way(controller):
    config = ServoControllerConfig(controller=controller)
    (made,) = make_controllers(config).values()
    axis, plant = ServoAxis('X', made, (-1.0, 1.0)), LatheAxis()
    axis.hold(plant.measure())
    rng = np.random.default_rng(5)
    for period in range(3000):
        if period % 150 == 0:
            target = float(rng.uniform(-0.05, 0.05))
            axis.go(axis.way(target, profile_limits(config, float('nan'), config.driven['X'])))
        plant.drive(axis.step(plant.measure()))
    assert axis.fault == ''


def test_coarser_counts_are_found_within_periods():
    """Eight counts in one, from a moment in the move on: half of them within 20 ms."""
    found = []
    rng = np.random.default_rng(3)
    for move in random_moves(20, seed=1):
        begin = float(rng.uniform(0.02, 0.3))
        config = replace(move.config, count_factor=8.0, count_change_time=begin)
        axis, period = moved(LatheAxis(config), float(np.sign(move.target)) * 0.1)
        assert period is not None
        found.append(period - round(1e3 * begin))
        if found[-1] > 40:
            continue
        assert 'rougher than the sensor' in axis.fault or 'counts' in axis.fault
    assert np.median(found) <= 20
    assert max(found) <= 90


def test_a_glitch_is_no_change_of_the_count():
    axis = LatheAxisConfig().linear()
    watch = MotionWatch(axis, FeedbackLimits.of(axis))
    for period in range(100):
        watch.hold(0.0)
        watch.judge(1e-5 if period == 50 else 0.0)
        assert watch.fault == ''


def test_after_an_interruption_nothing_is_held_against_what_was_before():
    axis = LatheAxisConfig().linear()
    watch = MotionWatch(axis, FeedbackLimits.of(axis))
    for _ in range(50):
        watch.hold(0.0)
        watch.judge(0.0)
    watch.interrupt()
    for period in range(50):
        watch.hold(0.0)
        watch.judge(0.01 + 1e-5 * np.exp(-period / 17.0))  # coasting
        assert watch.fault == ''


def ramp(watch, speed, duty):
    """Let a reading move at a speed [m/s] under a duty [-]; return the period of the fault."""
    for period in range(200):
        watch.hold(duty)
        watch.judge(speed * 1e-3 * period)
        if watch.fault:
            return period
    return None


@pytest.mark.parametrize('gain', [0.286, -0.286])
@pytest.mark.parametrize(
    ('speed', 'duty', 'reason'),
    [
        (0.143, 0.5, ''),
        (0.143 * 1.6, 0.5, ''),
        (0.143 * 0.25, 0.5, ''),  # half the gain, and friction and load besides
        (0.0, 0.1, ''),
        (0.286, 0.5, 'faster than its duty makes it'),
        (0.0, 0.5, 'does not answer'),
        (-0.1, 0.3, 'runs away'),
    ],
)
def test_what_a_duty_makes_of_an_axis(gain, speed, duty, reason):
    axis = LatheAxisConfig(direction=float(np.sign(gain))).linear()
    watch = MotionWatch(axis, FeedbackLimits.of(axis), MotionDoubt())
    period = ramp(watch, speed * np.sign(gain), duty)
    assert (period is None) == (reason == '')
    assert reason in watch.fault
