# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A bridge of joint trajectories and the machine side that its parts have to pass.

Whatever the guard of the machine would refuse shows in `JointRig.refusals`.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from benches.component_bench import Bench, machine_state
from benches.feedrate_rig import AXES, part_of

from fuzzycnc_ros.components.motion.joint_trajectory_bridge import JointTrajectoryBridge
from fuzzycnc_ros.components.motion.joint_trajectory_config import JointTrajectoryBridgeConfig
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryInput
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.host import MachineTick
from fuzzycnc_ros.runtime.provenance import configuration_record, event_record
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    Record,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)

CONFIG = JointTrajectoryBridgeConfig()
TICK = nanoseconds(0.01)


class JointRig:
    """A bridge and the trajectory input of a machine, in turns of 10 ms."""

    def __init__(self, *, place=(0.0, 0.0, 0.0), **parameters: Any) -> None:
        self.machine = TrajectoryInput(AXES, place)
        self.time = SECOND
        self.refusals: list[str] = []
        self.samples: list[tuple[int, np.ndarray, np.ndarray]] = []
        self.mode, self.homed, self.deaf, self.silent = MachineMode.RUNNING, True, False, False
        self.shift, self.speed = np.zeros(3), np.zeros(3)
        """By how much the axes are off [m], and move beside what they are told [m/s]."""
        self.outcomes: dict[str, tuple[str, str, bool]] = {}
        """Code, text and whether it was cancelled, by goal."""
        self.log: list[tuple[str, Record]] = []
        """Everything that was published, for a bag."""
        self._told: tuple[object, ...] = ()
        self._turns = 0
        self.bench = Bench(JointTrajectoryBridge(replace(CONFIG, **parameters)))
        self.bench.merger.advance(self.time)
        self._announce('inactive')
        assert self.request('activate').success
        self.steps(2)

    @property
    def component(self) -> JointTrajectoryBridge:
        """The bridge."""
        return self.bench.component

    def request(self, name: str, **arguments: Any) -> Any:
        """Send a request; what it causes reaches the machine."""
        answer = self.bench.request(name, **arguments)
        if answer.success:
            event = event_record(self.component, self.bench.merger.time, name, arguments)
            self.log.append(('node_event', event))
            self._announce('active')
        self._hear(list(answer.emissions))
        return answer

    def follow(self, goal: str, time, position, joints=AXES, **changes: Any) -> Any:
        """Send a goal: times [s], points [m]."""
        arguments = {
            'goal': goal,
            'joint': list(joints),
            'start': 0,
            'time': [nanoseconds(value) for value in time],
            'position': [list(row) for row in position],
            'velocity': [[] for _ in time],
            'acceleration': [[] for _ in time],
            'effort': False,
            'path_tolerance': [],
            'goal_tolerance': [],
            'goal_time': 0,
        }
        return self.request('follow', **arguments | changes)

    def step(self) -> None:
        """Run one turn: the machine first, then the bridge."""
        self.time += TICK
        machine = self.machine
        while machine.next_time is not None and machine.next_time <= self.time:
            stamp, sample = machine.next_time, machine.take()
            self.samples.append((stamp, sample.position, sample.velocity))
        machine.advance(max(self.time, machine.time))
        sample = machine.sample
        if not self.silent:
            state = TrajectoryState(
                stamp=self.time,
                path_id=machine.path_id,
                epoch=machine.epoch,
                part=machine.part,
                status=int(machine.status),
                reason=machine.reason,
                arc_length=sample.arc_length,
            )
            told = (state.path_id, state.epoch, state.part, state.status, state.reason)
            if told != self._told:
                self._told = told
                self._push('trajectory_state', state)
        self._push(
            'machine_state',
            machine_state(self.time / SECOND, state=int(self.mode), homed=self.homed),
        )
        self._push(
            'axis_state',
            AxisState(
                stamp=self.time,
                axis=AXES,
                reference=sample.position.copy(),
                position=sample.position + self.shift,
                velocity=sample.velocity + self.speed,
            ),
        )
        self._turns += 1
        turn = MachineTick(
            stamp=self.time,
            tick=self._turns,
            node=self.component.NAME,
            probe=False,
            topic=(),
            published=np.zeros(0, np.uint64),
            readers=np.zeros(0, np.uint32),
        )
        self.log.append((f'machine_tick/{self.component.NAME}', turn))
        self._hear(self.bench.until(self.time / SECOND))

    def steps(self, turns: int) -> None:
        """Run some turns."""
        for _ in range(turns):
            self.step()

    def until(self, condition, turns: int = 2000) -> None:
        """Run turns until something holds."""
        for _ in range(turns):
            if condition():
                return
            self.step()
        raise AssertionError(f'not within {turns} turns: {self.bench.health()}')

    def outcome(self, goal: str) -> tuple[str, str, bool]:
        """Run until a goal has ended; return code, text and whether it was cancelled."""
        self.until(lambda: goal in self.outcomes)
        return self.outcomes[goal]

    def parts(self) -> list[Trajectory]:
        """Return what the bridge has sent."""
        return self.bench.records('trajectory')

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions and velocities that the machine followed."""
        _, position, velocity = zip(*self.samples, strict=True)
        return np.array(position), np.array(velocity)

    def _push(self, topic: str, record: Record) -> None:
        self.bench.push(topic, record)
        self.log.append((topic, record))

    def _announce(self, state: str) -> None:
        record = configuration_record(self.component, self.bench.merger.time, state)
        self.log.append(('node_configuration', record))

    def _hear(self, emissions: list[Emission]) -> None:
        for emission in emissions:
            self.log.append((emission.output, emission.record))
            if isinstance(emission.record, Trajectory) and not self.deaf:
                answer = self.machine.command(part_of(emission.record))
                if not answer.accepted:
                    self.refusals.append(answer.reason)
        for item in self.component.take_outcomes():
            assert item.goal not in self.outcomes, 'an outcome is told once'
            self.outcomes[item.goal] = (item.code.name, item.text, item.cancelled)
