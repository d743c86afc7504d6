# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Moves commanded, controlled and made in one process; the same figures from a bag."""

import numpy as np
import pytest
from benches.positioning_run import PositioningError, run_positioning

from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.components.servo.servo_controller_config import (
    ServoControllerConfig,
    make_controllers,
)
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.core.servo.profile import point_to_point
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.graph import InProcessGraph
from fuzzycnc_ros.simulation.servo.axes import LatheAxis
from fuzzycnc_ros.simulation.servo.positioning import position
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.servo.positioning import PositioningLog

MOVES = ('X:-0.05', 'X:0.01')


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Two moves, as they came out and as a bag."""
    bag = tmp_path_factory.mktemp('positioning') / 'bag'
    told = []
    with PublishedBag(bag) as sink:
        found = run_positioning(
            MOVES, sink=sink, progress=lambda done, total: told.append((done, total))
        )
    return found, bag, told


@pytest.mark.replay
def test_moves_arrive(recorded):
    found, _, told = recorded
    assert [(item.axis, item.target) for item in found] == [('X', -0.05), ('X', 0.01)]
    for item in found:
        assert len(item.time) in (1200, 1201)
        assert item.settle(2e-6) <= 0.7
        assert item.overshoot < 1.5e-6
        assert item.left < 1.5e-6
        assert (item.missed, item.fault) == (0, '')
        assert item.reference[-1] == item.target
        assert np.isfinite(item.duty).all()
    done, total = np.transpose(told)
    assert np.all(np.diff(done) >= 0)
    assert done[-1] <= total[-1] == 2400


@pytest.mark.replay
def test_a_move_is_that_of_the_core(recorded):
    first = recorded[0][0]
    controller = make_controllers(ServoControllerConfig())['X']
    run = position(controller, LatheAxis(), point_to_point(0.0, -0.05).sample(1e-3), 1.2)
    np.testing.assert_array_equal(first.duty, run.duty)
    np.testing.assert_array_equal(first.position, run.measured)


@pytest.mark.replay
def test_the_bag_gives_the_same_figures(recorded):
    found, bag, _ = recorded
    again = PositioningLog.from_bag(bag).moves()
    assert len(again) == len(found)
    for ours, theirs in zip(found, again, strict=True):
        for name, value in vars(ours).items():
            np.testing.assert_array_equal(value, getattr(theirs, name))


@pytest.mark.replay
def test_the_controller_is_replayed_from_the_bag(recorded):
    report = replay(recorded[1])
    assert report.identical, report.topics
    assert {item.topic for item in report.topics} == {'/mill/axis_command', '/mill/servo_state'}
    assert not report.notes


@pytest.mark.replay
def test_a_bag_without_moves_is_refused():
    with pytest.raises(BagError, match='position_command'):
        PositioningLog.from_bag('bags/mill_warm_up')


def test_a_move_that_does_not_arrive_is_an_error_that_says_why():
    broken = SimulatedMachineConfig(
        servo_axes=('X:lathe',), servo_plant=('X:direction:-1',), move_time=0.3
    )
    with pytest.raises(PositioningError, match=r'move 1: expected X .* runs away'):
        run_positioning(('X:-0.05',), machine=broken)


def test_gain_may_be_half_or_one_and_a_half_times_the_nominal_one():
    for gain in ('0.5', '1.5'):
        machine = SimulatedMachineConfig(
            servo_axes=('X:lathe',), servo_plant=(f'X:gain_factor:{gain}',)
        )
        (move,) = run_positioning(('X:-0.05',), machine=machine)
        assert move.settle(2e-6) <= 0.9
        assert move.left < 1.5e-6


def test_ballscrew_arrives():
    (move,) = run_positioning(('Z:0.05',), ServoControllerConfig(axes=('Z:ballscrew',)))
    assert move.left < 1e-6
    assert move.overshoot < 2e-5


@pytest.mark.slow
@pytest.mark.replay
def test_path_of_the_scheduler_is_followed_by_driven_axes():
    """Scheduler, controller and machine: the machine says what became of the trajectory."""
    axes = ('X:lathe', 'Y:lathe', 'Z:lathe')
    config = SimulatedMachineConfig(
        duties=(), servo_axes=axes, paths=('trident',), path_timeout=2.0
    )
    machine = SimulatedMachine(config)
    planner = FeedrateScheduler(FeedrateSchedulerConfig(tolerance=1e-4, settle=0.25))
    servo = ServoController(ServoControllerConfig(axes=axes))
    heard: dict[str, list] = {'axis_state': [], 'servo_state': [], 'trajectory_state': []}

    def sink(topic, record):
        if topic in heard:
            heard[topic].append(record)

    graph = InProcessGraph(machine, [planner, servo], sink=sink)
    for node in (planner.NAME, servo.NAME):
        assert graph.request(node, 'activate').success
    graph.run()
    assert machine.failure == ''
    assert heard['trajectory_state'][-1].status == TrajectoryStatus.FINISHED
    statuses = {item.status for item in heard['servo_state']}
    assert statuses == {ServoStatus.RESTING, ServoStatus.FOLLOWING}
    # the grating lags by 6 ms, the axes do not
    lag = 6
    told = np.array([item.reference for item in heard['axis_state']])[:-lag]
    read = np.array([item.position for item in heard['axis_state']])[lag:]
    assert np.abs(told - read).max() < 3e-4
