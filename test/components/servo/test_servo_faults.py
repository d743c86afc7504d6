# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component servo_controller: what is bridged, what is a fault, and what follows from it."""

import numpy as np
import pytest
from benches.component_bench import machine_state
from benches.positioning_run import PositioningError, run_positioning
from benches.servo_bench import PERIOD, START, Axis

from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.axis_control import FOR_USE
from fuzzycnc_ros.runtime.enums import MachineMode, ServoStatus
from fuzzycnc_ros.runtime.records import SECOND, AxisCommand, AxisState, MachineState
from fuzzycnc_ros.simulation.servo.axes import LatheAxis


def test_axis_states_that_are_missing_are_bridged_and_counted():
    axis = Axis()
    axis.go(X=-0.05)
    axis.run(0.2)
    axis.run(0.004, heard=False)
    axis.run(0.8)
    assert axis.state.missed == 4
    assert 'WARN deadlines: 4 missed' in axis.health()
    assert axis.place() == pytest.approx(-0.05, abs=2e-6)
    # the drives hold the last command until there is another
    told = [item.stamp for item in axis.records('axis_command')]
    assert told == sorted(
        {START + k * PERIOD for k in range(1004)} - {START + k * PERIOD for k in range(200, 204)}
    )


def test_states_that_are_late_altogether_are_made_up_for():
    """What a host without deadlines does: the gap shows in the stamps alone."""
    axis = Axis()
    axis.go(X=-0.05)
    axis.run(0.2)
    deadline = ServoController.next_deadline
    try:
        ServoController.next_deadline = property(lambda self: None)
        axis.run(0.003, heard=False)
        axis.run(0.8)
    finally:
        ServoController.next_deadline = deadline
    assert axis.state.missed == 3
    assert axis.place() == pytest.approx(-0.05, abs=2e-6)


def test_feedback_that_stops_is_a_fault_and_the_command_is_zero():
    axis = Axis()
    axis.go(X=-0.05)
    axis.run(0.2)
    axis.run(0.3, heard=False)
    last = axis.records('axis_command')[-1]
    assert last.duty.tolist() == [0.0]
    assert last.stamp == START + 220 * PERIOD + PERIOD // 2
    assert axis.component.next_deadline is None
    assert axis.state.status == ServoStatus.FAULT
    assert 'no axis_state for 21 ms' in axis.state.reason
    assert 'ERROR state: feedback has stopped' in axis.health()
    where = axis.place()
    axis.run(0.1)  # it is heard again, and nothing moves before it is activated anew
    assert axis.place() == where
    assert axis.duty == {'X': 0.0}


FAULTS = {
    'counts were lost': {'counts_lost': 160, 'count_loss_time': 0.2},
    'not finite': {'dropout_time': 0.2, 'dropout_duration': 1.0},
    'rougher than the sensor': {'count_factor': 8.0, 'count_change_time': 0.2},
}


@pytest.mark.parametrize('reason', FAULTS)
def test_feedback_that_cannot_be_right_is_a_fault(reason):
    axis = Axis({'X': LatheAxis(LatheAxisConfig(**FAULTS[reason]))})
    axis.go(X=-0.05)
    axis.run(1.0)
    assert axis.state.status == ServoStatus.FAULT
    assert reason in axis.state.reason
    assert axis.state.reason in axis.health()
    assert axis.duty == {'X': 0.0}
    assert axis.place() > -0.05 - 1e-5


@pytest.mark.parametrize('controller', FOR_USE)
def test_wrong_sign_is_found_within_20_ms_of_the_axis_running_away(controller):
    axis = Axis({'X': LatheAxis(LatheAxisConfig(direction=-1.0))}, controller=controller)
    axis.go(X=-0.05)
    away = None
    for _ in range(200):
        axis.tick()
        if away is None and axis.place() > 2e-6:
            away = axis.now
    fault = next(item for item in axis.records('servo_state') if item.status == ServoStatus.FAULT)
    assert 'runs away' in fault.reason
    assert away is not None
    assert fault.stamp - away <= 20 * PERIOD
    assert axis.place() < 2e-3
    assert axis.plants['X'].velocity == 0.0


def test_one_axis_stops_all():
    plants = {'X': LatheAxis(), 'Y': LatheAxis(LatheAxisConfig(direction=-1.0))}
    axis = Axis(plants, axes=('X:lathe', 'Y:lathe'))
    axis.go(X=-0.05, Y=-0.05)
    axis.run(0.5)
    assert axis.state.reason.startswith('Y: ')
    assert axis.duty == {'X': 0.0, 'Y': 0.0}
    assert axis.place('X') > -0.02


def test_activation_clears_a_fault_and_takes_a_higher_epoch():
    axis = Axis()
    axis.go(X=-0.05)
    axis.run(0.2)
    axis.run(0.1, heard=False)
    first = axis.state.epoch
    assert axis.request('deactivate').success
    stopped = axis.records('axis_command')[-1]
    assert stopped.duty.tolist() == [0.0]
    assert stopped.stamp > axis.records('axis_command')[-2].stamp
    assert axis.request('activate').success
    axis.run(0.2)
    assert axis.state.status == ServoStatus.RESTING
    assert axis.state.missed == 0
    assert axis.state.epoch > first
    axis.go(X=0.0)
    axis.run(0.8)
    assert axis.place() == pytest.approx(0.0, abs=2e-6)


@pytest.mark.parametrize('way', [-0.05, 1e-3])
def test_wrong_sign_is_found_on_moves_of_any_length(way):
    axis = Axis({'X': LatheAxis(LatheAxisConfig(direction=-1.0, seed=3))})
    axis.go(X=way)
    wrong = None
    while axis.state_or_none() is None or axis.state.status != ServoStatus.FAULT:
        axis.tick()
        if wrong is None and axis.place() * np.sign(way) < -2e-6:
            wrong = axis.now
        assert axis.now < START + SECOND
    assert axis.now - wrong <= 20 * PERIOD


def test_a_short_move_runs_away_by_less_than_a_millimetre():
    """Its duty stays below what load and friction may take for most of the way."""
    axis = Axis({'X': LatheAxis(LatheAxisConfig(direction=-1.0))})
    axis.go(X=2e-5)
    axis.run(0.4)
    assert 'runs away' in axis.state.reason
    assert axis.place() > -1e-3


def test_silence_is_bridged_as_long_as_it_may_last():
    axis = Axis()
    axis.go(X=-0.05)
    for _ in range(8):
        axis.run(0.06)
        axis.run(0.015, heard=False)
    axis.run(0.4)
    assert axis.state.missed == 8 * 15
    assert axis.state.status == ServoStatus.RESTING
    assert axis.place() == pytest.approx(-0.05, abs=3e-6)


def test_silence_of_a_machine_that_is_off_asks_for_no_deadlines_without_end():
    axis = Axis()
    axis.run(0.05)
    off = machine_state(axis.now / SECOND, state=int(MachineMode.OFF))
    axis.push('machine_state', off)
    axis.run(0.005)
    axis.run(0.1, heard=False)
    assert axis.component.next_deadline is None
    axis.run(1.0, heard=False)
    axis.push('machine_state', machine_state(axis.now / SECOND, state=int(MachineMode.ON)))
    axis.run(0.1)
    assert axis.state.status == ServoStatus.RESTING, axis.health()
    assert axis.place() == pytest.approx(0.0, abs=2e-6)


@pytest.mark.parametrize('silence', [0.021, 0.3])
def test_states_that_come_again_after_a_silence_that_is_too_long_move_nothing(silence):
    """A node without deadlines, as one that its host has not let run."""
    axis = Axis()
    axis.go(X=-0.05)
    axis.run(0.2)
    deadline = ServoController.next_deadline
    try:
        ServoController.next_deadline = property(lambda self: None)
        axis.run(silence, heard=False)
        axis.run(0.1)
    finally:
        ServoController.next_deadline = deadline
    assert 'feedback has stopped' in axis.state.reason
    assert axis.duty == {'X': 0.0}


@pytest.mark.parametrize('late', [1, 2])
def test_commands_that_come_late_are_no_fault(late):
    axis = Axis(late=late)
    axis.go(X=-0.05)
    axis.run(1.2)
    assert axis.state.status == ServoStatus.RESTING
    assert axis.place() == pytest.approx(-0.05, abs=5e-6)


def test_drive_that_does_not_answer_is_a_fault():
    """Switched off, tripped or commanded by somebody else: the duty moves nothing."""
    axis = Axis()
    axis.go(X=-0.05)
    axis.run(0.15)
    axis.answers = False
    off = axis.now
    axis.run(0.2)
    fault = next(item for item in axis.records('servo_state') if item.status == ServoStatus.FAULT)
    assert 'does not answer its duty' in fault.reason
    assert fault.stamp - off <= 60 * PERIOD


class Frozen(LatheAxis):
    """An axis whose reading stands still from some time on."""

    frozen = None

    def measure(self):
        """Return the reading."""
        return super().measure() if self.frozen is None else self.frozen


def test_reading_that_stands_still_is_a_fault():
    axis = Axis({'X': Frozen()})
    axis.go(X=-0.05)
    axis.run(0.15)
    axis.plants['X'].frozen = axis.plants['X'].measure()
    stuck = axis.now
    axis.run(0.3)
    fault = next(item for item in axis.records('servo_state') if item.status == ServoStatus.FAULT)
    assert 'does not answer its duty' in fault.reason or 'counts were lost' in fault.reason
    assert fault.stamp - stuck <= 60 * PERIOD
    assert axis.place() > -0.05


def test_readings_that_are_missing_for_a_moment_are_bridged():
    axis = Axis({'X': LatheAxis(LatheAxisConfig(dropout_time=0.2, dropout_duration=0.004))})
    axis.go(X=-0.05)
    axis.run(1.0)
    assert axis.state.status == ServoStatus.RESTING
    assert axis.place() == pytest.approx(-0.05, abs=2e-6)


def test_a_single_count_that_is_lost_is_that_much_off():
    axis = Axis({'X': LatheAxis(LatheAxisConfig(counts_lost=1, count_loss_time=0.2))})
    axis.go(X=-0.05)
    axis.run(1.0)
    assert axis.state.status == ServoStatus.RESTING
    assert axis.place() == pytest.approx(-0.05 + 0.625e-6, abs=2e-6)


def test_fault_of_the_machine_is_one_here_until_activated_anew():
    axis = Axis()
    axis.go(X=-0.05)
    axis.run(0.2)
    axis.push('machine_state', machine_state(axis.now / SECOND, state=int(MachineMode.FAULT)))
    axis.run(0.1)
    assert axis.state.status == ServoStatus.FAULT
    assert axis.state.reason == 'the machine reports a fault and keeps its drives at zero'
    assert axis.duty == {'X': 0.0}
    axis.push('machine_state', machine_state(axis.now / SECOND, state=int(MachineMode.ON)))
    axis.run(0.1)
    assert axis.state.status == ServoStatus.FAULT
    assert axis.request('deactivate').success
    assert axis.request('activate').success
    axis.run(0.2)
    assert axis.state.status == ServoStatus.RESTING


def test_activation_beside_a_machine_at_fault_waits_for_it():
    axis = Axis(active=False)
    axis.push('machine_state', machine_state(axis.now / SECOND, state=int(MachineMode.FAULT)))
    axis.run(0.1)
    assert axis.request('activate').success
    axis.run(0.1)
    assert axis.state.status == ServoStatus.INACTIVE
    assert axis.state.reason == 'the machine is fault'
    assert axis.records('axis_command')[-1].duty.tolist() == [0.0]
    axis.push('machine_state', machine_state(axis.now / SECOND, state=int(MachineMode.ON)))
    axis.run(0.1)
    assert axis.state.status == ServoStatus.RESTING


def test_axis_that_would_leave_the_travel_of_the_machine_is_a_fault_on_both_sides():
    machine = SimulatedMachineConfig(servo_travel_low=-0.02)
    heard = []
    with pytest.raises(PositioningError, match='the machine reports a fault and keeps'):
        run_positioning(machine=machine, sink=lambda topic, record: heard.append(record))
    modes = [item.state for item in heard if isinstance(item, MachineState)]
    assert modes == [MachineMode.RUNNING, MachineMode.FAULT]
    places = [item.position[0] for item in heard if isinstance(item, AxisState)]
    assert min(places) > -0.02
    duties = [item.duty[0] for item in heard if isinstance(item, AxisCommand)]
    assert not any(duties[-300:])
