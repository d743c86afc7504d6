# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What stands for a machine, at work: the simulated one and the bridge to a LinuxCNC."""

import random
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from benches import trajectory_bench
from benches.component_bench import Bench, applied, machine_state
from benches.probe_rig import zeroed
from fuzzing.targets import CopiedTarget, Target

from fuzzycnc_ros.components.machine.simulated_body import SimulatedBody, SimulatedBodyConfig
from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryPart
from fuzzycnc_ros.runtime.enums import CompensationState, PrimitiveKind
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisCommand,
    CompensatedPath,
    Compensation,
    nanoseconds,
)

PERIOD = 1_000_000
"""Period of the axes [ns]."""


class MachineTarget(Target):
    """A simulated machine amid a duty, with axes that follow trajectories."""

    component = 'simulated_machine'
    inputs = ('compensation', 'trajectory')
    makes_time = True
    ticks = 3
    """Ticks of the machine between two messages."""
    changes: dict[str, Any] = {'duties': ('D0',), 'paths': ()}  # noqa: RUF012

    def bench(self) -> Bench:
        bench = Bench(SimulatedMachine(SimulatedMachineConfig(**self.changes)))
        self.work(bench, 1)
        self.start = bench.merger.time
        return bench

    def good(self, name, stamp, rng):
        if name == 'compensation':
            return Compensation(
                stamp=stamp,
                frame_id='mill/machine',
                epoch=1,
                state=int(CompensationState.ACTIVE),
                axis=('Y', 'Z'),
                offset=np.array([2e-6, -2e-6]),
                slope=np.zeros(2),
                reference_position=np.zeros(2),
                at_limit=np.zeros(2, bool),
                slewing=np.zeros(2, bool),
                valid_until=stamp + 180 * SECOND,
                source=('thermal_error',),
            )
        if name == 'axis_command':
            return AxisCommand(
                stamp=stamp,
                frame_id='mill/machine',
                epoch=stamp,
                axis=('X',),
                duty=np.zeros(1),
                valid_until=stamp + 10 * PERIOD,
            )
        return trajectory_bench.record(
            trajectory_bench.parts(start=stamp + 100 * PERIOD)[0], stamp
        )

    def work(self, bench: Bench, ticks: int) -> None:
        """Let the machine tick."""
        for _ in range(ticks):
            stamp = bench.component.next_tick
            bench.emitted += bench.merger.advance(stamp)
            bench.emitted += bench.component.tick()

    def go_on(self, bench: Bench, stamp: int, until: int) -> int:
        """Let the machine tick a few times."""
        bench.emitted += bench.merger.advance(stamp)
        self.work(bench, self.ticks)
        return max(stamp, bench.merger.time)

    def read_back(self, bench: Bench) -> Any:
        """Let the machine tick until it tells what it applies."""
        before = len(bench.records('compensation_applied'))
        for _ in range(10_000):
            self.work(bench, 1)
            found = bench.records('compensation_applied')
            if len(found) > before:
                return found[-1]
        raise AssertionError(bench.health())

    def recover(self, bench, stamp):
        told = self.read_back(bench)
        good = self.good('compensation', told.stamp, random.Random(0))
        bench.component.on_compensation(replace(good, epoch=min(told.epoch + 1, 2**64 - 1)))
        assert self.read_back(bench).status == OffsetStatus.FOLLOWING, bench.health()

    def check(self, bench):
        for item in bench.records('compensation_applied'):
            assert (np.abs(item.offset) <= 100e-6).all()


class ServoMachineTarget(MachineTarget):
    """A simulated machine whose axes are driven from outside."""

    inputs = ('axis_command', 'trajectory')
    changes: dict[str, Any] = {'duties': (), 'servo_axes': ('X:lathe',), 'moves': ('X:0.01',)}  # noqa: RUF012

    def recover(self, bench, stamp):
        before = len(bench.records('axis_state'))
        self.work(bench, 20)
        assert len(bench.records('axis_state')) > before


WAY = trajectory_bench.trapezoid(0.25)
"""Way of the stitching machine at each period [m]."""


@cache
def plan(start: int) -> list[TrajectoryPart]:
    """Return the parts of its trajectory."""
    return trajectory_bench.parts(way=WAY, start=start, path_id='row')


class StitchingTarget(MachineTarget):
    """A simulated machine that stitches straight rows while its axes follow a trajectory.

    A row begins where the tool is when it is loaded, so that stitches of hostile ones are made.
    """

    inputs = ('compensated_path', 'trajectory')
    ticks = 60
    changes: dict[str, Any] = {  # noqa: RUF012
        'duties': (),
        'patterns': ('parallelogram:45',),
        'path_timeout': 1000.0,
    }
    ahead = 40 * PERIOD

    def bench(self) -> Bench:
        bench = super().bench()
        for name in self.inputs:
            bench.push(name, self.good(name, self.start, random.Random(0)))
        self.work(bench, self.ticks)
        return bench

    def good(self, name, stamp, rng):
        if name == 'compensated_path':
            at = (stamp - self.start - self.ahead) // PERIOD + 1
            return self.row(stamp, trajectory_bench.line(WAY[max(min(at, len(WAY) - 1), 0)])[:2])
        due = [item for item in plan(self.start + self.ahead) if item.start > stamp]
        return trajectory_bench.record(due[0] if due else plan(self.start)[-1], stamp)

    @staticmethod
    def row(stamp: int, begin: np.ndarray, path_id: str = 'row') -> CompensatedPath:
        """Return stitches of 3 mm along the line of `trajectory_bench`."""
        steps = 10
        kind = np.zeros(steps, np.uint8)
        kind[5] = PrimitiveKind.JUMP
        points = begin + np.outer(3e-3 * np.arange(steps + 1), (0.6, -0.8))
        return CompensatedPath(
            stamp=stamp,
            frame_id='mill/workpiece',
            path_id=path_id,
            material='foam',
            thickness=15e-3,
            model='',
            nominal=points.ravel(),
            offset=np.zeros(points.size),
            primitive=np.zeros(steps, np.uint32),
            kind=kind,
            turn=np.zeros(steps),
            depth=np.full(steps, 6e-3),
            step=np.full(steps, 3e-3),
            compensation=np.zeros(2 * steps),
            support=np.full(steps, np.nan),
            flag=np.zeros(steps, np.uint8),
        )

    def recover(self, bench, stamp):
        machine = bench.component
        for _ in range(3000):
            if machine._motion.following or machine._motion.moving:
                self.work(bench, 1)
        self.work(bench, 50)
        begin = bench.records('axis_state')[-1].reference.copy()
        epoch = max(item.epoch for item in bench.records('trajectory_state')) + 1
        now = bench.merger.time
        machine.on_compensated_path(self.row(now, begin[:2], 'again'))
        again = trajectory_bench.parts(
            lambda way: begin + trajectory_bench.line(way),
            start=now + self.ahead,
            path_id='again',
            epoch=min(epoch, 2**64 - 1),
        )
        for part in again:
            machine.on_trajectory(trajectory_bench.record(part, now))
        self.work(bench, 1000)
        found = bench.records('stitched_path')
        assert [item.path_id for item in found][-1:] == ['again'], bench.health()


class BodyTarget(MachineTarget):
    """A simulated mill behind a controller, heated by its spindle and moved by its offsets."""

    component = 'simulated_body'
    inputs = ('machine_state', 'compensation_applied')

    def bench(self) -> Bench:
        bench = Bench(SimulatedBody(SimulatedBodyConfig(displacement_interval=12.0)))
        self.work(bench, 1)
        self.start = bench.merger.time
        return bench

    def good(self, name, stamp, rng):
        if name == 'machine_state':
            return machine_state(1e-9 * stamp)
        return applied(1e-9 * stamp, (2e-6, -2e-6), 1)

    def recover(self, bench, stamp):
        now = bench.merger.time + SECOND
        state = self.good('machine_state', now, random.Random(0))
        list(bench.component.receive('machine_state', state))
        read_back = self.good('compensation_applied', now, random.Random(0))
        bench.component.on_compensation_applied(read_back)
        before = len(bench.records('displacement'))
        assert '100.0 rad/s' in bench.health()
        self.work(bench, 5)  # hostile ones of the future may come meanwhile
        assert len(bench.records('displacement')) == before + 5

    def check(self, bench):
        for item in bench.records('displacement'):
            assert (np.abs(item.displacement) <= 2e-3).all()


class BridgeTarget(CopiedTarget):
    """A bridge that has offsets in force on a controller, cycle by cycle.

    Attributes
    ----------
    rig : module
        The rig of the bridge.
    """

    inputs = ('compensation', 'probe_cycle_state')
    makes_time = True

    def __init__(self, component: str, rig: Any) -> None:
        self.component, self.rig = component, rig

    def make(self) -> Bench:
        rig = self.rig.settled()
        rig.bench.rig = rig
        return rig.bench

    def bench(self) -> Bench:
        bench = super().bench()
        self.start = nanoseconds(bench.rig.time)
        return bench

    def good(self, name, stamp, rng):
        if name == 'probe_cycle_state':
            return replace(zeroed().state, stamp=stamp, due=rng.random() < 0.5)
        size = len(self.rig.AXES)
        return Compensation(
            stamp=stamp,
            frame_id='mill/machine',
            epoch=1,
            state=int(CompensationState.ACTIVE),
            axis=self.rig.AXES,
            offset=1e-6 * np.arange(1, size + 1),
            slope=np.zeros(size),
            reference_position=np.zeros(size),
            at_limit=np.zeros(size, bool),
            slewing=np.zeros(size, bool),
            valid_until=stamp + 180 * SECOND,
            source=('thermal_error',),
        )

    def go_on(self, bench: Bench, stamp: int, until: int) -> int:
        """Let the controller run for a few cycles."""
        bench.emitted += bench.merger.advance(stamp)
        bench.rig.run(5 * self.rig.CYCLE)
        return nanoseconds(bench.rig.time)

    def recover(self, bench, stamp):
        rig = bench.rig
        told = rig.last
        good = self.good('compensation', nanoseconds(rig.time), random.Random(0))
        rig.bridge.on_compensation(replace(good, epoch=min(told.epoch + 1, 2**64 - 1)))
        rig.run(10.0)
        assert rig.last.status == OffsetStatus.FOLLOWING, bench.health()
        assert rig.at(1e6 * good.offset), rig.last

    def check(self, bench):
        rig = bench.rig
        assert rig.largest_step <= self.rig.STEP_MAX
        assert np.abs(rig.path).max() <= rig.config.offset_max + self.rig.SCALE
