# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Whether readings move in single counts: no alarm on smooth motion, one on coarse steps."""

import numpy as np
import pytest

from fuzzycnc_ros.core.servo.built_in import built_in_controller
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits, FeedbackWatch
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis

COUNT = 5e-8


def judged(places, count=COUNT):
    """Let a watch see the readings of a sensor at places [m]; return why it gave up, and when."""
    limits = FeedbackLimits(count=COUNT, noise=0.0, acceleration_max=100.0)
    watch = FeedbackWatch(limits, 1e-3, 1.0, 0.286)
    for step, place in enumerate(np.asarray(places).tolist()):
        watch.accepts(place, round(place / count) * count)
        if watch.fault:
            return watch.fault, step
    return '', None


def test_a_steady_acceleration_of_whole_counts_is_no_coarse_sensor():
    # 8 counts per period more or less with every period: all changes are multiples of 4
    time = 1e-3 * np.arange(100)
    assert judged(0.02 * time - 0.2 * time**2) == ('', None)


@pytest.mark.parametrize(('bends', 'speed'), [((14, 16), 2200), ((-3, 0), 450), ((2, -2), 40)])
def test_a_loop_that_swings_by_some_counts_is_no_coarse_sensor(bends, speed):
    """Bends that encoders without noise gave, in steady accelerations and at a steady speed."""
    changes = speed + np.cumsum(np.tile(bends, 30))
    assert judged(COUNT * np.cumsum(changes)) == ('', None)


@pytest.mark.parametrize('factor', [2.0, 4.0, 16.0])
def test_coarse_steps_are_noticed_where_the_acceleration_changes(factor):
    time = 1e-3 * np.arange(1000)
    fault, step = judged(0.01 * (1.0 - np.cos(6.0 * time)), factor * COUNT)
    assert fault == f'reading moves in steps of {factor:g} counts'
    assert step < 200


@pytest.mark.parametrize('acceleration', [0.397, 0.5])
def test_coarse_steps_are_noticed_in_a_steady_acceleration_that_does_not_fit_them(acceleration):
    time = 1e-3 * np.arange(300)
    fault, _ = judged(0.5 * acceleration * time**2, 16.0 * COUNT)
    assert fault == 'reading moves in steps of 16 counts'


def test_a_well_followed_reversal_raises_no_alarm():
    time = 1e-3 * np.arange(100)
    ramp, slope = 0.02 * time - 0.2 * time**2, 0.02 - 0.4 * time
    controller, axis = built_in_controller('ballscrew', 'variable_universe'), BallscrewAxis()
    target = 0.0
    for _ in range(1000):
        axis.drive(controller.step(target, axis.measure(), 0.02))
        target += 2e-5
    readings = []
    for place, speed in zip((target + ramp).tolist(), slope.tolist(), strict=True):
        readings.append(axis.measure())
        axis.drive(controller.step(place, readings[-1], speed, -0.4))
    changes = np.rint(np.diff(readings[:72]) / COUNT).astype(int)
    assert (np.gcd.reduce(changes[40:]), controller.status.fault) == (4, '')


def after_silence(silent, jump, acceleration=0.0):
    """Let readings at 0.2 m/s stop for some periods and come again; return what is found."""
    watch = FeedbackWatch(FeedbackLimits(), 1e-3, 1.0, 0.286)
    place, speed = 0.0, 0.2
    for step in range(300):
        quiet = 100 <= step < 100 + silent
        if quiet:
            speed += 1e-3 * acceleration
        place += 1e-3 * speed
        if step == 100 + silent:
            watch.resume()
        watch.bad = 0 if quiet else watch.bad  # how long silence may last is for others to judge
        shown = place + (jump if step >= 100 + silent else 0.0)
        watch.accepts(place, float('nan') if quiet else shown)
        if watch.fault:
            return watch.fault, step - 99 - silent
    return '', None


@pytest.mark.parametrize('silent', [1, 2, 3, 4])
def test_counts_that_are_lost_while_nothing_is_heard_are_noticed(silent):
    fault, after = after_silence(silent, 1e-3)
    assert 'has jumped' in fault
    assert after <= FeedbackLimits().bad_max + 1


@pytest.mark.parametrize('silent', [1, 5, 20])
@pytest.mark.parametrize('acceleration', [-15.0, 0.0, 15.0])
def test_an_axis_goes_on_after_a_silence_without_alarm(silent, acceleration):
    assert after_silence(silent, 0.0, acceleration) == ('', None)
