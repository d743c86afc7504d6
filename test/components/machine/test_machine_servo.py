# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated machine with driven axes: periods, drives that trust nobody, moves, trajectories."""

import numpy as np
import pytest
from benches.component_bench import Bench
from benches.trajectory_bench import line, parts, record

from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.machine.simulated_machine_config import DAY_START
from fuzzycnc_ros.components.servo.servo_controller_config import (
    ServoControllerConfig,
    make_controllers,
)
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisCommand,
    nanoseconds,
)
from fuzzycnc_ros.simulation.servo.axes import LatheAxis

PERIOD = 1_000_000
START = nanoseconds(DAY_START)


class Machine(Bench):
    """A machine whose axes the test drives."""

    def __init__(self, **changes) -> None:
        values = {
            'duties': (),
            'servo_axes': ('X:lathe',),
            'moves': ('X:-0.05',),
            **changes,
        }
        super().__init__(SimulatedMachine(SimulatedMachineConfig(**values)))
        self.axes = [text.partition(':')[0] for text in values['servo_axes']]

    @property
    def plant(self):
        """The first axis."""
        return self.component._motion._plants[0]

    def tick(self, *duty, epoch=1, validity=10 * PERIOD):
        """Command the drives, if a duty is given, and tick."""
        now = self.merger.time
        if duty:
            command = AxisCommand(
                stamp=now,
                frame_id='mill/machine',
                epoch=epoch,
                axis=tuple(self.axes),
                duty=np.array(duty, dtype=np.float64),
                valid_until=now + validity,
            )
            self.push('axis_command', command)
            self.emitted += self.merger.advance(now)
        stamp = self.component.next_tick
        self.emitted += self.merger.advance(stamp)
        found = list(self.component.tick())
        self.emitted += found
        return found

    def run(self, ticks, *duty, **changes):
        """Tick a number of times."""
        for _ in range(ticks):
            self.tick(*duty, **changes)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'servo_axes': ('X:mill',)}, 'servo_axes: expected axes'),
        ({'servo_axes': ()}, r'moves: expected targets .* none \(servo_axes\)'),
        ({'moves': ('X',)}, "moves: expected targets in m .* found 'X'"),
        ({'moves': ('X:0.01,X:0.02',)}, 'moves: expected'),
        ({'moves': ('Z:0.01',)}, 'moves: expected targets in m as X:-0.05 of axes among X'),
        ({'duties': ('T2',)}, 'duties: expected none on a machine with servo_axes'),
        ({'servo_plant': ('Y:gain_factor:2',)}, 'servo_plant: expected an axis among X'),
        ({'servo_plant': ('X:colour:2',)}, 'expected <axis>:<setting>:<value>'),
        ({'servo_plant': ('X:gain_factor:x',)}, 'expected a number at the end'),
        ({'servo_plant': ('X:gain_factor:1e9',)}, 'gain_factor = 1000000000.0 is outside'),
        ({'servo_travel_low': 0.5}, 'servo_travel_high: expected more than servo_travel_low'),
        ({'moves': ()}, 'duties: expected names among'),
    ],
)
def test_parameters_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Machine(**changes)


def test_axis_is_that_of_the_core_driven_from_period_to_period():
    machine, alone = Machine(), LatheAxis()
    machine.tick()
    expected = [alone.measure()]
    for k in range(300):
        duty = 0.3 * np.sin(0.05 * k)
        machine.tick(duty)
        alone.drive(duty)
        expected.append(alone.measure())
    states = machine.records('axis_state')
    assert [item.stamp for item in states] == [START + k * PERIOD for k in range(1, 302)]
    np.testing.assert_array_equal([item.position[0] for item in states], expected)
    velocity = np.diff(expected, prepend=expected[0]) / 1e-3
    np.testing.assert_allclose([item.velocity[0] for item in states], velocity, atol=1e-12)
    assert 'OK axes: driven' in machine.health()


def test_moves_are_asked_for_one_after_the_other_and_judged():
    machine = Machine(moves=('X:0.0', 'X:0.01'), move_time=0.1)
    while machine.component.next_tick is not None:
        machine.tick(0.0)
    commands = machine.records('position_command')
    assert [item.position.tolist() for item in commands] == [[0.0], [0.01]]
    assert commands[1].stamp - commands[0].stamp == 100 * PERIOD
    assert machine.component.failure.startswith('move 2: expected X within 10 µm of 10 mm but')
    assert 'ERROR path: move 2' in machine.health()
    assert machine.component.ticks_done == machine.component.total_ticks == 200
    modes = [item.state for item in machine.records('machine_state')]
    assert modes == [MachineMode.RUNNING, MachineMode.ON]


def test_command_runs_out_of_date():
    machine = Machine()
    machine.tick()
    machine.run(50, 0.3)
    speed = machine.plant.velocity
    assert speed > 0.05
    machine.run(10)
    assert machine.plant.velocity > speed
    machine.run(150)
    assert machine.plant.velocity == 0.0
    assert 'WARN axes: axis_command of epoch 1 is out of date' in machine.health()
    machine.run(10, 0.3)  # nothing is latched: a fresh command is followed
    assert machine.plant.velocity > 0.0
    assert 'OK axes: driven' in machine.health()


@pytest.mark.parametrize(
    ('duty', 'changes', 'message'),
    [
        ((0.3,), {'epoch': 4}, 'expected epoch 5 or higher but found 4'),
        ((np.nan,), {'epoch': 5}, 'duty: expected one within -1 to 1 per axis'),
        ((1.5,), {'epoch': 5}, 'duty: expected one within -1 to 1 per axis'),
        ((0.3, 0.3), {'epoch': 5}, 'duty: expected one within -1 to 1 per axis'),
    ],
)
def test_command_that_is_refused_moves_nothing(duty, changes, message):
    machine = Machine()
    machine.tick()
    machine.tick(0.0, epoch=5)
    told = []
    for _ in range(100):
        machine.tick(*duty, **changes)
        told.append(machine.health())
    assert machine.plant.position == 0.0
    assert 'WARN axes: axis_command of epoch 5 is out of date' in '\n'.join(told)
    assert f'WARN axes: {message}' in told[-1]


def test_command_of_other_axes_is_refused():
    machine = Machine()
    machine.tick()
    machine.axes = ['Y']
    machine.run(50, 0.3)
    assert machine.plant.position == 0.0
    assert 'WARN axes: axis: expected X but found Y' in machine.health()


@pytest.mark.parametrize('gain', ['1', '1.5', '0.5'])
@pytest.mark.parametrize('duty', [1.0, -1.0, 0.4])
def test_axis_at_any_duty_stops_within_its_travel(gain, duty):
    machine = Machine(
        servo_travel_low=-0.02,
        servo_travel_high=0.03,
        servo_plant=(f'X:gain_factor:{gain}', 'X:coulomb:0', 'X:breakaway:0'),
    )
    machine.tick()
    places = []
    for _ in range(600):
        machine.tick(duty)
        places.append(machine.plant.position)
    assert -0.02 <= min(places)
    assert max(places) <= 0.03
    assert abs(places[-1]) > 0.015
    assert 'X would leave its travel of -20 to 30 mm' in machine.health()
    assert machine.records('machine_state')[-1].state == MachineMode.FAULT
    machine.run(5, -0.5 * duty)
    assert places[-1] == pytest.approx(machine.plant.position, abs=1e-5)
    machine.run(30, -0.5 * duty, epoch=2)  # a new owner takes it back
    assert abs(machine.plant.position) < abs(places[-1]) - 2e-4
    assert machine.records('machine_state')[-1].state == MachineMode.RUNNING


def test_emergency_stop_takes_the_drives_to_zero_at_once():
    machine = Machine()
    machine.tick()
    machine.run(50, 0.3)
    machine.component.set_mode(MachineMode.ESTOP)
    machine.run(150, 0.3)
    assert machine.plant.velocity == 0.0
    assert 'WARN axes: the machine does not allow motion: estop' in machine.health()
    assert machine.records('machine_state')[-1].state == MachineMode.ESTOP
    machine.component.set_mode(MachineMode.ON)
    machine.run(10, 0.3)
    assert machine.plant.velocity > 0.0


def test_command_that_comes_late_still_counts_and_is_counted():
    machine = Machine()
    machine.tick()
    machine.tick(0.3)
    machine.run(3)
    assert machine.plant.velocity > 0.0
    (axes,) = [item for item in machine.component.health() if item.name == 'axes']
    assert axes.values['late commands'] == '3'


def test_feedback_may_fall_silent_and_its_readings_may_be_missing():
    silent = Machine(servo_silence=0.1)
    silent.run(300)
    assert len(silent.records('axis_state')) == 100
    blind = Machine(servo_plant=('X:dropout_time:0.1', 'X:dropout_duration:0.05'))
    blind.run(300)
    readings = np.array([item.position[0] for item in blind.records('axis_state')])
    assert np.isnan(readings).sum() == 50


def test_trajectory_is_judged_here_too_and_given_up_with_the_drives():
    machine = Machine(servo_axes=('X:lathe', 'Y:lathe', 'Z:lathe'), moves=(), paths=('trident',))
    machine.run(20, 0.0, 0.0, 0.0)
    first, *_ = parts(line, start=machine.merger.time + 50 * PERIOD, path_id='trident')
    machine.push('trajectory', record(first, machine.merger.time))
    machine.run(80, 0.0, 0.0, 0.0)
    (taken,) = [
        item
        for item in machine.records('trajectory_state')
        if item.status == TrajectoryStatus.FOLLOWING
    ]
    assert taken.path_id == 'trident'
    assert machine.records('axis_state')[-1].reference[0] > 0.0
    machine.run(30)  # nobody drives any more
    assert machine.records('trajectory_state')[-1].status == TrajectoryStatus.REFUSED
    assert 'out of date' in machine.health()


def test_built_in_loops_take_no_notice_of_drives():
    bench = Bench(SimulatedMachine(SimulatedMachineConfig(duties=(), paths=('trident',))))
    command = AxisCommand(
        stamp=START,
        frame_id='mill/machine',
        epoch=1,
        axis=('X',),
        duty=np.ones(1),
        valid_until=START + SECOND,
    )
    bench.push('axis_command', command)
    stamp = bench.component.next_tick
    bench.emitted += bench.merger.advance(stamp)
    bench.emitted += list(bench.component.tick())
    assert bench.records('axis_state')[-1].position.tolist() == [0.0, 0.0, 0.0]


def test_contour_error_of_driven_axes_is_told_as_of_those_with_loops_of_their_own():
    names = ('X', 'Y', 'Z')
    machine = Machine(
        servo_axes=tuple(f'{name}:lathe' for name in names), moves=(), paths=('trident',)
    )
    controllers = make_controllers(
        ServoControllerConfig(axes=machine.component._config.servo_axes)
    )
    plants = machine.component._motion._plants
    machine.run(20, 0.0, 0.0, 0.0)
    coming = parts(line, start=machine.merger.time + 50 * PERIOD, path_id='trident')
    away = []
    while len(coming) or machine.component._motion.busy:
        while coming and coming[0].start - 40 * PERIOD <= machine.merger.time:
            machine.push('trajectory', record(coming.pop(0), machine.merger.time))
        state = machine.records('axis_state')[-1]
        machine.tick(
            *(
                controllers[name].step(place, reading)
                for name, place, reading in zip(
                    names, state.reference, state.position, strict=True
                )
            )
        )
        away.append(np.linalg.norm([plant.position for plant in plants] - state.reference))
        assert len(away) < 5000
    told = machine.records('contour_error')
    assert {item.path_id for item in told} == {'trident'}
    assert {item.period for item in told} == {1e-3}
    assert max(len(item.error) for item in told) == 100
    error = np.concatenate([item.error for item in told])
    way = np.concatenate([item.arc_length for item in told])
    assert np.isfinite(error).all()
    assert way[0] < 1e-3
    assert way[-1] == pytest.approx(0.05, abs=1e-4)
    # along a straight line the error across it is far less than the lag along it
    assert 0.0 < error.max() < max(away)
