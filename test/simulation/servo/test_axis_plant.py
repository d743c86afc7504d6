# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Linear model and friction of axes."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.simulation.servo.axes import (
    stribeck_friction,
    stribeck_frictions,
)

AXES = {'lathe': LatheAxisConfig().linear(), 'ballscrew': BallscrewAxisConfig().linear()}
speeds = st.one_of(st.just(0.0), st.floats(-0.3, 0.3))
pushes = st.floats(-1.0, 1.0)
levels = st.floats(0.0, 0.1)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'gain': 0.0}, 'gain: expected a finite number other than 0'),
        ({'gain': math.inf}, 'gain: expected a finite number other than 0'),
        ({'drive_lags': {'torque': 0.0}}, 'torque: expected more than 0 s but found 0.0 s'),
        ({'velocity_lag': -1.0}, 'velocity_lag: expected more than 0 s'),
        ({'period': math.nan}, 'period: expected more than 0 s'),
        ({'sensor_lag': -1e-3}, 'sensor_lag: expected 0 s or more'),
    ],
)
def test_a_model_without_meaning_is_refused(changes, message):
    good = {'gain': 0.3, 'drive_lags': {}, 'velocity_lag': 0.02, 'sensor_lag': 0.0, 'period': 1e-3}
    with pytest.raises(ValueError, match=message):
        LinearAxis.chain(**{**good, **changes})


def test_states_of_the_axes():
    assert AXES['lathe'].states == ('amplifier', 'torque', 'velocity', 'position', 'sensor')
    assert AXES['ballscrew'].states == ('velocity', 'position')
    for axis in AXES.values():
        assert axis.a.shape == (len(axis.states), len(axis.states))
        assert axis.c[-1] == 1.0


@pytest.mark.parametrize('name', list(AXES))
def test_discrete_model_is_the_held_one_of_scipy(name):
    axis = AXES[name]
    dynamics, duty, disturbance = axis.discrete()
    inputs = np.column_stack([axis.b, axis.disturbance])
    system = (axis.a, inputs, axis.c[None], np.zeros((1, 2)))
    expected, entries, *_ = cont2discrete(system, axis.period, method='zoh')
    np.testing.assert_allclose(dynamics, expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(np.column_stack([duty, disturbance]), entries, rtol=1e-10)


@pytest.mark.parametrize('name', list(AXES))
def test_a_duty_moves_at_the_gain_after_the_lag_and_holds_a_disturbance(name):
    axis = AXES[name]
    dynamics, duty, disturbance = axis.discrete()
    state, balanced = np.zeros(len(duty)), np.zeros(len(duty))
    place = axis.states.index('position')
    steps = math.ceil(40.0 * axis.lag / axis.period)
    for _ in range(steps):
        state = dynamics @ state + 0.1 * duty
        balanced = dynamics @ balanced + 0.1 * duty + 0.1 * disturbance
    velocity = 0.1 * axis.gain
    assert state[axis.states.index('velocity')] == pytest.approx(velocity, rel=1e-9)
    way = velocity * (steps * axis.period - axis.lag)
    assert state[place] == pytest.approx(way, rel=1e-9)
    # what passes until the drive has built up; an axis without drive lags does not move at all
    assert abs(balanced[axis.states.index('velocity')]) < 1e-12
    assert abs(balanced[place]) < 0.1 * abs(axis.gain) * 2.4e-3


def test_lag_and_gain_of_the_axes():
    assert AXES['lathe'].lag == pytest.approx(0.0193)  # 0.8, 1.5 and 17 ms of [long2014]
    assert AXES['lathe'].gain == pytest.approx(0.286)
    assert AXES['ballscrew'].lag == pytest.approx(95.1089 / 203.5034)
    assert AXES['ballscrew'].gain == pytest.approx(351.5065188 / 203.5034)


@given(speeds, pushes, levels, st.floats(1.0, 3.0))
def test_friction_never_drives(velocity, drive, coulomb, ratio):
    friction = stribeck_friction(velocity, drive, coulomb, ratio * coulomb, 2e-3)
    if velocity == 0.0:
        assert abs(friction) <= abs(drive)
        assert friction * drive >= 0.0
    else:
        assert friction * velocity >= 0.0
        assert coulomb * (1 - 1e-12) <= abs(friction) <= ratio * coulomb * (1 + 1e-12)


@given(speeds, pushes, levels)
def test_friction_is_odd(velocity, drive, coulomb):
    there = stribeck_friction(velocity, drive, coulomb, 1.5 * coulomb, 2e-3)
    back = stribeck_friction(-velocity, -drive, coulomb, 1.5 * coulomb, 2e-3)
    assert back == -there


@given(st.lists(st.tuples(speeds, pushes, levels, st.floats(1.0, 3.0)), min_size=1, max_size=20))
def test_friction_of_many_axes_is_that_of_each(cases):
    velocity, drive, coulomb, ratio = np.array(cases).T
    scale = np.full(len(cases), 2e-3)
    found = stribeck_frictions(velocity, drive, coulomb, ratio * coulomb, scale)
    single = [stribeck_friction(v, d, c, r * c, 2e-3) for v, d, c, r in cases]
    np.testing.assert_allclose(found, single, rtol=1e-14, atol=0.0)
