# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component servo_controller: periods and commands, moves, trajectories, lifecycle."""

from dataclasses import replace

import numpy as np
import pytest
from benches.component_bench import machine_state
from benches.servo_bench import PERIOD, START, Axis
from benches.trajectory_bench import line, parts, record

from fuzzycnc_ros.components.servo.servo_controller import ServoControllerConfig
from fuzzycnc_ros.components.servo.servo_controller_config import make_controllers
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.axis_control import FOR_USE
from fuzzycnc_ros.core.servo.profile import point_to_point
from fuzzycnc_ros.runtime.enums import MachineMode, ServoStatus
from fuzzycnc_ros.runtime.records import SECOND
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis, LatheAxis
from fuzzycnc_ros.simulation.servo.positioning import position


def moved(**config):
    """Return an axis at rest after a move of -20 mm."""
    axis = Axis(**config)
    axis.go(X=-0.02)
    axis.run(0.8)
    return axis


@pytest.mark.parametrize('controller', FOR_USE)
def test_duties_are_those_of_the_core_on_its_own_plant(controller):
    """Bit for bit: nothing comes in between."""
    axis = Axis(controller=controller)
    axis.go(X=-0.05)
    axis.run(0.7)
    own = make_controllers(ServoControllerConfig(controller=controller))['X']
    reference = point_to_point(0.0, -0.05).sample(1e-3)
    alone = position(own, LatheAxis(), reference, 0.7)
    commands = axis.records('axis_command')
    np.testing.assert_array_equal([item.duty[0] for item in commands], alone.duty)
    assert [item.stamp for item in commands] == [START + k * PERIOD for k in range(700)]
    assert {item.valid_until - item.stamp for item in commands} == {20 * PERIOD}


def test_an_axis_is_held_where_it_is_found_and_arrives_where_it_is_sent():
    axis = Axis({'X': LatheAxis(position=0.03)})
    axis.run(0.1)
    assert axis.place() == pytest.approx(0.03, abs=2e-6)
    assert axis.state.status == ServoStatus.RESTING
    axis.go(X=-0.02)
    axis.run(0.1)
    assert axis.state.status == ServoStatus.MOVING
    axis.run(0.9)
    assert axis.place() == pytest.approx(-0.02, abs=2e-6)
    assert axis.state.status == ServoStatus.RESTING
    assert axis.state.reference[0] == -0.02
    assert abs(axis.state.error[0]) < 2e-6
    assert 'OK state: resting' in axis.health()


def test_ballscrew_and_lathe_go_together_each_as_fast_as_it_is_told():
    axis = Axis({'X': LatheAxis(), 'Z': BallscrewAxis()}, axes=('X:lathe', 'Z:ballscrew'))
    axis.run(0.01)
    axis.go(velocity=0.05, X=-0.02, Z=0.03)
    speeds = []
    for _ in range(1200):
        axis.tick()
        speeds.append(axis.plants['Z'].velocity)
    assert axis.place('X') == pytest.approx(-0.02, abs=2e-6)
    assert axis.place('Z') == pytest.approx(0.03, abs=2e-6)
    assert 0.045 < max(speeds) < 0.055


def test_reversed_axis_is_driven_the_other_way():
    axis = Axis({'X': LatheAxis(LatheAxisConfig(direction=-1.0))}, reversed_axes=('X',))
    axis.go(X=-0.02)
    axis.run(0.8)
    assert axis.place() == pytest.approx(-0.02, abs=2e-6)


def test_target_may_change_on_the_way_without_a_jump():
    axis = Axis()
    references = []
    axis.go(X=-0.05)
    for k in range(1400):
        if k == 200:
            axis.go(X=0.01)
        axis.tick()
        references.append(axis.component._axes[0].reference)
    assert axis.place() == pytest.approx(0.01, abs=2e-6)
    limit = ServoControllerConfig()
    assert np.abs(np.diff(references)).max() <= 1.001e-3 * limit.velocity_max
    assert np.abs(np.diff(references, 2)).max() <= 1.001e-6 * limit.acceleration_max
    assert np.abs(np.diff(references, 3)).max() <= 1.1e-9 * limit.jerk_max


@pytest.mark.parametrize(
    ('targets', 'velocity', 'message'),
    [
        ({'X': 0.3}, np.nan, 'expected X within -250 to 250 mm but found 300 mm'),
        ({'X': np.nan}, np.nan, 'expected X within'),
        ({'X': 0.01}, 0.0, 'velocity: expected more than 0'),
        ({'Y': 0.01}, np.nan, 'axis: expected X but found Y'),
        ({}, np.nan, 'one position and velocity per axis'),
    ],
)
def test_command_that_cannot_be_carried_out_is_refused(targets, velocity, message):
    axis = Axis()
    axis.run(0.01)
    axis.go(velocity, **targets)
    axis.run(0.1)
    assert 'WARN command: ' in axis.health()
    assert message in axis.health()
    assert axis.place() == pytest.approx(0.0, abs=2e-6)
    axis.go(X=0.001)
    axis.run(0.8)
    assert axis.place() == pytest.approx(0.001, abs=2e-6)
    assert 'WARN' not in axis.health()


def test_target_that_is_too_near_to_stop_at_the_end_of_the_travel_is_refused():
    axis = Axis(travel_low=-0.05)
    axis.go(X=-0.0499)
    axis.run(0.33)
    speed = axis.plants['X'].velocity
    assert speed < -0.1
    axis.go(X=axis.place() - 1e-4)
    axis.run(0.002)
    assert 'WARN command: X moves too fast to come to rest within its travel' in axis.health()
    axis.run(0.8)
    assert axis.place() == pytest.approx(-0.0499, abs=2e-6)


def test_inactive_component_commands_nothing_and_keeps_no_command():
    axis = Axis(active=False)
    axis.go(X=-0.05)
    axis.run(0.1)
    assert not axis.records('axis_command')
    assert axis.state.status == ServoStatus.INACTIVE
    assert not axis.request('deactivate').success
    assert axis.request('activate').success
    assert not axis.request('activate').success
    axis.run(0.3)
    assert axis.place() == pytest.approx(0.0, abs=2e-6)


def test_machine_that_may_not_move_is_let_go_and_held_anew():
    axis = Axis()
    axis.go(X=-0.05)
    axis.run(0.2)
    axis.push('machine_state', machine_state(axis.now / SECOND, state=int(MachineMode.ESTOP)))
    axis.run(0.3)
    assert axis.duty == {'X': 0.0}
    assert axis.state.status == ServoStatus.INACTIVE
    assert axis.state.reason == 'the machine is estop'
    where = axis.place()
    axis.push('machine_state', machine_state(axis.now / SECOND, state=int(MachineMode.ON)))
    axis.run(0.3)
    assert axis.state.status == ServoStatus.RESTING
    assert axis.place() == pytest.approx(where, abs=3e-6)


def test_servo_state_is_told_on_a_change_and_every_50_ms():
    axis = moved()
    stamps = [item.stamp - START for item in axis.records('servo_state')]
    assert np.max(np.diff(stamps)) == 50 * PERIOD
    assert len(stamps) <= 0.8 / 0.05 + 4


@pytest.mark.parametrize(
    ('targets', 'message'),
    [
        ({'X': 0.02, 'Z': 0.02}, 'axis: expected X, Y but found Z'),
        ({'X': 0.02, 'Y': 0.4}, 'position: expected Y within -250 to 250 mm but found 400 mm'),
    ],
)
def test_command_that_one_axis_refuses_moves_none(targets, message):
    plants = {'X': LatheAxis(), 'Y': LatheAxis(LatheAxisConfig(seed=1))}
    axis = Axis(plants, axes=('X:lathe', 'Y:lathe'))
    axis.run(0.01)
    axis.go(**targets)
    axis.run(0.3)
    assert axis.place('X') == pytest.approx(0.0, abs=2e-6)
    assert axis.place('Y') == pytest.approx(0.0, abs=2e-6)
    assert f'WARN command: {message}' in axis.health()


def test_command_that_one_axis_is_too_fast_for_leaves_all_on_their_way():
    plants = {'X': LatheAxis(), 'Y': LatheAxis(LatheAxisConfig(seed=1))}
    axis = Axis(plants, axes=('X:lathe', 'Y:lathe'), travel_low=-0.05)
    axis.go(Y=-0.0499)
    axis.run(0.33)
    axis.go(X=0.02, Y=axis.place('Y') - 1e-4)
    axis.run(0.8)
    assert axis.place('X') == pytest.approx(0.0, abs=2e-6)
    assert axis.place('Y') == pytest.approx(-0.0499, abs=2e-6)
    assert 'WARN command: Y moves too fast' in axis.health()


def test_trajectory_is_followed_from_rest_to_rest():
    plants = {'X': LatheAxis(), 'Y': LatheAxis(LatheAxisConfig(seed=1))}
    axis = Axis(plants, axes=('X:lathe', 'Y:lathe'), controller='cascade')
    axis.run(0.01)
    begin = axis.now + 50 * PERIOD
    coming = parts(line, start=begin)
    coming = [
        replace(
            item,
            axis=('X', 'Y'),
            position=item.position.reshape(-1, 3)[:, :2].ravel(),
            velocity=item.velocity.reshape(-1, 3)[:, :2].ravel(),
        )
        for item in coming
    ]
    errors = []
    while axis.now < begin + 2 * SECOND:
        while coming and coming[0].start - 40 * PERIOD <= axis.now:
            axis.push('trajectory', record(coming.pop(0), axis.now))
        axis.tick()
        told = [each.reference for each in axis.component._axes]
        errors.append(np.subtract(told, [axis.place('X'), axis.place('Y')]))
    assert not coming
    assert ServoStatus.FOLLOWING in {item.status for item in axis.records('servo_state')}
    assert axis.state.status == ServoStatus.RESTING
    assert axis.place('X') == pytest.approx(0.03, abs=3e-6)
    assert axis.place('Y') == pytest.approx(-0.04, abs=3e-6)
    assert np.abs(errors).max() < 2e-4


def test_trajectory_that_passes_the_limits_moves_nothing():
    axis = Axis(trajectory_velocity_max=0.01)
    axis.run(0.01)
    (first, *_) = parts(line, start=axis.now + 50 * PERIOD)
    one = replace(
        first,
        axis=('X',),
        position=first.position.reshape(-1, 3)[:, 0],
        velocity=first.velocity.reshape(-1, 3)[:, 0],
    )
    axis.push('trajectory', record(one, axis.now))
    axis.run(0.2)
    assert axis.place() == pytest.approx(0.0, abs=2e-6)
    assert 'velocity of X: expected at most 10 mm/s' in axis.health()


def test_live_limits_act_on_the_next_move():
    axis = Axis()
    axis.run(0.01)
    axis.component.reconfigure(ServoControllerConfig(velocity_max=0.02))
    axis.go(X=-0.01)
    speeds = []
    for _ in range(800):
        axis.tick()
        speeds.append(abs(axis.component._axes[0].velocity))
    assert max(speeds) == pytest.approx(0.02, rel=1e-3)
    assert axis.place() == pytest.approx(-0.01, abs=2e-6)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'axes': ('X:mill',)}, "axes: expected axes, each once, .* found 'X:mill'"),
        ({'axes': ('X:lathe', 'X:lathe')}, 'each once'),
        ({'axes': ()}, 'axes: expected one or more'),
        ({'reversed_axes': ('Y',)}, 'reversed_axes: expected axes among X but found Y'),
        ({'travel_low': 0.3}, 'travel_high: expected more than travel_low'),
        ({'silence_max': 0.05}, 'silence_max: expected at most command_validity = 0.02 s'),
        ({'axes': ('Z:ballscrew',), 'controller': 'cascade'}, 'universe, pid for a ballscrew'),
    ],
)
def test_parameters_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        ServoControllerConfig(**changes)
