# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The components of motion at work: feed scheduler, joint trajectories and servo controller."""

import random
from dataclasses import replace

import numpy as np
from benches import trajectory_bench
from benches.component_bench import Bench, machine_state
from fuzzing.targets import CopiedTarget, work

from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.components.motion.joint_trajectory_bridge import JointTrajectoryBridge
from fuzzycnc_ros.components.servo.servo_controller import ServoController
from fuzzycnc_ros.components.servo.servo_controller_config import ServoControllerConfig
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData, axis_hash, axis_texts
from fuzzycnc_ros.runtime.enums import MachineMode, ServoStatus
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    PositionCommand,
    ServoTrial,
    ToolPath,
    TrajectoryState,
)

PERIOD = 1_000_000
"""Control period of the servo axes [ns]."""


class SchedulerTarget(CopiedTarget):
    """A scheduler that waits for a path, on a machine at rest."""

    component = 'feedrate_scheduler'
    inputs = ('axis_state', 'machine_state', 'trajectory_state', 'tool_path')
    step = 50_000_000
    axes = ('X', 'Y', 'Z')

    def make(self) -> Bench:
        bench = Bench(FeedrateScheduler())
        assert bench.request('activate').success
        self._rest(bench, 999 * SECOND)
        return bench

    def _rest(self, bench: Bench, stamp: int) -> None:
        for name in self.inputs[:3]:
            bench.push(name, self.good(name, stamp, random.Random(0)))
        work(bench, stamp)

    def good(self, name, stamp, rng):
        if name == 'machine_state':
            return replace(machine_state(1.0, state=int(MachineMode.ON)), stamp=stamp)
        if name == 'trajectory_state':
            return TrajectoryState(
                stamp=stamp,
                path_id='',
                epoch=0,
                part=0,
                status=int(TrajectoryStatus.IDLE),
                reason='',
                arc_length=0.0,
            )
        if name == 'axis_state':
            return AxisState(
                stamp=stamp,
                axis=self.axes,
                reference=np.zeros(3),
                position=np.zeros(3),
                velocity=np.zeros(3),
            )
        return ToolPath(
            stamp=stamp,
            frame_id='mill/workpiece',
            path_id='good',
            includes_compensation=False,
            axis=self.axes,
            start=np.zeros(3),
            kind=np.array([0, 1, 3], np.uint8),
            junction=np.array([0, 1, 1], np.uint8),
            block=np.array([1, 2, 3], np.int64),
            feedrate=np.array([0.05, 0.05, np.nan]),
            offset=np.array([0, 3, 13, 14], np.uint32),
            data=np.array(
                [5e-3, 0.0, 0.0, 5e-3, 4e-3, 0.0, 5e-3, 2e-3, 0.0, 0.0, 0.0, 1.0, np.pi, 0.1]
            ),
        )

    def recover(self, bench, stamp):
        bench.request('deactivate')  # a slow path would be worked through up to the far future
        work(bench, stamp)
        assert bench.request('activate').success  # takes a path that has come meanwhile
        bench.request('deactivate')
        stamp += 100 * SECOND
        work(bench, stamp)
        assert bench.request('activate').success
        epoch = max((item.epoch for item in bench.records('trajectory')), default=0)
        for _ in range(3):
            stamp += 2 * SECOND
            for name in self.inputs[:3]:
                record = self.good(name, stamp, random.Random(0))
                if name == 'trajectory_state':
                    record = replace(record, epoch=min(epoch, 2**63 - 1))
                bench.push(name, record)
            work(bench, stamp)
        stamp += SECOND // 10
        before = len(bench.records('trajectory'))
        path = replace(self.good('tool_path', stamp, random.Random(0)), path_id=f'again {stamp}')
        bench.push('tool_path', path)
        work(bench, stamp)
        work(bench, stamp + SECOND)
        found = bench.records('trajectory')[before:]
        assert found, bench.health()
        assert found[0].path_id == path.path_id
        assert found[0].part == 0


class JointTarget(SchedulerTarget):
    """A bridge that follows a goal, on a machine that says nothing of it."""

    component = 'joint_trajectory_bridge'
    inputs = ('machine_state', 'trajectory_state', 'axis_state')

    def make(self) -> Bench:
        bench = Bench(JointTrajectoryBridge())
        assert bench.request('activate').success
        self._rest(bench, 999 * SECOND)
        self._follow(bench, 'fuzzed')
        return bench

    def _follow(self, bench: Bench, goal: str) -> None:
        asked = {'time': [5 * SECOND], 'position': [[0.01]], 'velocity': [[]], 'goal_time': 0}
        asked |= {'acceleration': [[]], 'path_tolerance': [['X', 0.5, 0, 0]], 'start': 0}
        answer = bench.request('follow', goal=goal, joint=['X'], goal_tolerance=[], **asked)
        assert answer.success, answer.message

    def recover(self, bench, stamp):
        bench.request('deactivate')
        stamp += 100 * SECOND
        work(bench, stamp)
        assert bench.request('activate').success
        epoch = max(item.epoch for item in bench.records('trajectory'))
        for _ in range(3):
            stamp += 2 * SECOND
            for name in self.inputs:
                record = self.good(name, stamp, random.Random(0))
                if name == 'trajectory_state':
                    record = replace(record, epoch=min(epoch, 2**63 - 1))
                bench.push(name, record)
            work(bench, stamp)
        before = len(bench.records('trajectory'))
        self._follow(bench, 'again')
        (found,) = bench.records('trajectory')[before:]
        assert (found.part, found.stamp) == (0, stamp)
        assert bench.records('joint_states')[-1].stamp == stamp
        assert {item.goal for item in bench.component.take_outcomes()} == {'fuzzed'}


class ServoTarget(CopiedTarget):
    """A servo controller that holds an axis."""

    component = 'servo_controller'
    inputs = ('machine_state', 'position_command', 'trajectory', 'servo_trial', 'axis_state')
    data = AxisData(plant=BallscrewAxisConfig(), controller='pid')
    step = PERIOD

    def make(self) -> Bench:
        config = ServoControllerConfig(
            axes=('X:machine_file',), axis_data=axis_texts({'X': self.data})
        )
        bench = Bench(ServoController(config))
        bench.until(999.0)
        assert bench.request('activate').success
        self.start = 1000 * SECOND
        for number in range(20):
            stamp = self.start - (20 - number) * PERIOD
            bench.push('machine_state', machine_state(stamp / SECOND, axis=('X',)))
            bench.push('axis_state', self.good('axis_state', stamp, random.Random(0)))
            work(bench, stamp)
        return bench

    def good(self, name, stamp, rng):
        if name == 'machine_state':
            return replace(machine_state(1.0), stamp=stamp, spindle_speed=0.0)
        if name == 'servo_trial':
            return ServoTrial(
                stamp=stamp,
                axis_name='X',
                trial=rng.randrange(4),
                machine_file=axis_hash('X', self.data),
                controller='pid',
                setting=('bandwidth',),
                value=np.array([1.0]),
                gain=1.0,
                way=1e-3,
                pace=0.5,
                error_max=1e-3,
            )
        if name == 'position_command':
            return PositionCommand(
                stamp=stamp, axis=('X',), position=np.array([1e-3]), velocity=np.array([np.nan])
            )
        if name == 'trajectory':
            part = trajectory_bench.parts(start=stamp + 50 * PERIOD)[0]
            return replace(
                trajectory_bench.record(part, stamp),
                axis=('X',),
                position=part.position.reshape(-1, 3)[:, 0].copy(),
                velocity=part.velocity.reshape(-1, 3)[:, 0].copy(),
            )
        return AxisState(
            stamp=stamp,
            frame_id='mill/workpiece',
            axis=('X',),
            reference=np.full(1, np.nan),
            position=np.zeros(1),
            velocity=np.zeros(1),
        )

    def recover(self, bench, stamp):
        work(bench, stamp)
        bench.request('deactivate')
        assert bench.request('activate').success
        for _ in range(80):
            stamp += PERIOD
            bench.push('machine_state', self.good('machine_state', stamp, random.Random(0)))
            bench.push('axis_state', self.good('axis_state', stamp, random.Random(0)))
            work(bench, stamp)
        assert bench.records('axis_command')[-1].stamp == stamp
        assert bench.records('servo_state')[-1].status == ServoStatus.RESTING, bench.health()

    def check(self, bench):
        for item in bench.records('axis_command'):
            assert (np.abs(item.duty) <= 1.0).all()
