# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A feedrate scheduler and the machine side that its parts have to pass.

Whatever the guard of the machine would refuse shows in `Rig.refusals`.
"""

from dataclasses import fields, replace

import numpy as np
from benches.component_bench import Bench, machine_state

from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.motion.tool_paths import (
    curve_tool_path,
)
from fuzzycnc_ros.core.feedrate.path.curves import trident
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.core.inputs.trajectory_input import (
    TrajectoryInput,
    TrajectoryPart,
    TrajectoryStatus,
)
from fuzzycnc_ros.runtime.component import Emission
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.host import MachineTick
from fuzzycnc_ros.runtime.provenance import configuration_record, event_record
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    Record,
    ToolPath,
    Trajectory,
    TrajectoryState,
    nanoseconds,
)

CONFIG = FeedrateSchedulerConfig(tolerance=5e-5)
AXES = ('X', 'Y', 'Z')
SMALL = trident(0.3)
"""A curve of 29 mm."""


class Rig:
    """A scheduler and the trajectory input of a machine, in turns of a fixed period."""

    def __init__(
        self,
        config: FeedrateSchedulerConfig = CONFIG,
        *,
        place=(0.0, 0.0, 0.0),
        tick: float = 0.05,
        active: bool = True,
    ) -> None:
        self.machine = TrajectoryInput(AXES, place)
        self.tick = nanoseconds(tick)
        self.time = SECOND
        self.refusals: list[str] = []
        self.samples: list[tuple[int, np.ndarray, np.ndarray, float]] = []
        self.silent = False
        """Whether the machine hears nothing more."""
        self.mode, self.homed = MachineMode.RUNNING, True
        self.given: ToolPath | None = None
        """Newest path as it was given."""
        self.log: list[tuple[str, Record]] = []
        """Everything that was published, for a bag."""
        self.restart(config, active=active)

    def restart(self, config: FeedrateSchedulerConfig = CONFIG, *, active: bool = True) -> None:
        """Start a scheduler, a new one if there was one."""
        self.bench = Bench(FeedrateScheduler(config))
        self.bench.merger.advance(self.time)
        self._told: tuple[object, ...] = ()
        self._turns = 0
        self._announce('inactive')
        if active:
            assert self.request('activate').success

    def request(self, name: str, **arguments):
        """Send a request; what it causes reaches the machine."""
        answer = self.bench.request(name, **arguments)
        if answer.success:
            event = event_record(self.component, self.bench.merger.time, name, arguments)
            self.log.append(('node_event', event))
            self._announce('active')
        self.hear(list(answer.emissions))
        return answer

    def reconfigure(self, config: FeedrateSchedulerConfig) -> None:
        """Change live parameters."""
        self.component.reconfigure(config)
        self._announce('active')

    def push(self, topic: str, record: Record) -> None:
        """Give the scheduler a record."""
        self.bench.push(topic, record)
        self.log.append((topic, record))

    def _announce(self, state: str) -> None:
        record = configuration_record(self.component, self.bench.merger.time, state)
        self.log.append(('node_configuration', record))

    @property
    def component(self) -> FeedrateScheduler:
        """The scheduler."""
        return self.bench.component

    def records(self, output: str = 'trajectory') -> list:
        """Return what the scheduler has published."""
        return self.bench.records(output)

    def step(self, path: ToolPath | None = None) -> None:
        """Run one turn: the machine first, then the scheduler."""
        self.time += self.tick
        machine = self.machine
        while machine.next_time is not None and machine.next_time <= self.time:
            stamp, sample = machine.next_time, machine.take()
            self.samples.append((stamp, sample.position, sample.velocity, sample.arc_length))
        machine.advance(self.time)
        push = self.push
        push('axis_state', self.axis_state())
        state = self.trajectory_state()
        told = (state.path_id, state.epoch, state.part, state.status, state.reason)
        if told != self._told:
            self._told = told
            push('trajectory_state', state)
        if self._turns % 10 == 0 or self.mode == MachineMode.ESTOP:
            push('machine_state', self.machine_state())
        if path is not None:
            self.given = replace(path, stamp=self.time)
            push('tool_path', self.given)
        self._turns += 1
        names, counts = (), np.zeros(0, np.uint64)
        turn = MachineTick(
            stamp=self.time,
            tick=self._turns,
            node=self.component.NAME,
            probe=False,
            topic=names,
            published=counts,
            readers=np.zeros(0, np.uint32),
        )
        self.log.append((f'machine_tick/{self.component.NAME}', turn))
        self.hear(self.bench.until(self.time / SECOND))

    def steps(self, turns: int) -> None:
        """Run some turns."""
        for _ in range(turns):
            self.step()

    def hear(self, emissions: list[Emission]) -> None:
        """Give parts to the machine, as they are."""
        for emission in emissions:
            self.log.append((emission.output, emission.record))
            if isinstance(emission.record, Trajectory) and not self.silent:
                answer = self.machine.command(part_of(emission.record))
                if not answer.accepted:
                    self.refusals.append(answer.reason)

    def run(self, path: ToolPath | None = None, *, turns: int = 100_000, until=None) -> None:
        """Run turns until a path given now is done, or something holds."""
        done = until or (lambda: path is None or self.done)
        for number in range(turns):
            self.step(path if number == 0 else None)
            if number and done():
                return
        if until is not None or path is not None:
            raise AssertionError(f'not within {turns} turns: {self.bench.health()}')

    @property
    def done(self) -> bool:
        """Whether the machine has followed a path to its end."""
        return self.machine.status == TrajectoryStatus.FINISHED and bool(self.samples)

    def axis_state(self) -> AxisState:
        """Return where the axes are."""
        sample = self.machine.sample
        return AxisState(
            stamp=self.time,
            axis=AXES,
            reference=sample.position.copy(),
            position=sample.position.copy(),
            velocity=sample.velocity.copy(),
        )

    def machine_state(self):
        """Return what the machine says of itself."""
        return machine_state(self.time / SECOND, state=int(self.mode), homed=self.homed)

    def trajectory_state(self) -> TrajectoryState:
        """Return what the machine makes of its trajectory."""
        machine = self.machine
        return TrajectoryState(
            stamp=self.time,
            path_id=machine.path_id,
            epoch=machine.epoch,
            part=machine.part,
            status=int(machine.status),
            reason=machine.reason,
            arc_length=machine.sample.arc_length,
        )

    def motion(self):
        """Return time [s], positions, velocities and arc lengths that the machine followed."""
        time, position, velocity, place = zip(*self.samples, strict=True)
        return (
            np.array(time) / SECOND,
            np.array(position),
            np.array(velocity),
            np.array(place),
        )


def part_of(record: Trajectory) -> TrajectoryPart:
    """Return a part as the machine side takes it."""
    names = [item.name for item in fields(TrajectoryPart)]
    return TrajectoryPart(**{name: getattr(record, name) for name in names})


def path_of(curve: NurbsCurve, name: str = 'curve', feed: float = 0.2) -> ToolPath:
    """Return a tool path along a curve."""
    return curve_tool_path(curve, path_id=name, feed=feed, frame_id='mill/workpiece')


def distance(curve: NurbsCurve, place: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return how far points are from the curve near arc lengths [m]."""
    u = curve.parameter(np.clip(place, 0.0, curve.length))
    for _ in range(6):
        gap = points - curve.point(u)
        first = curve.derivative(u)
        u = np.clip(u + (gap * first).sum(axis=1) / (first**2).sum(axis=1), *curve.domain)
    return np.linalg.norm(points - curve.point(u), axis=1)


def check_motion(rig: Rig, config: FeedrateSchedulerConfig = CONFIG) -> None:
    """Check that motion is even, that velocities are its own, and that it keeps the limits."""
    assert not rig.refusals
    time, position, velocity, place = rig.motion()
    assert np.ptp(np.diff(time)) < 1e-9
    period = config.period
    mean = np.diff(position, axis=0) / period
    assert np.abs(mean - 0.5 * (velocity[1:] + velocity[:-1])).max() <= 1.1 * period * 1.0
    assert np.abs(velocity).max() <= 1.001 * max(config.axis_velocity)
    assert np.linalg.norm(velocity, axis=1).max() <= 1.001 * config.path_velocity
    rise = np.diff(velocity, axis=0) / period
    assert np.abs(rise).max() <= 1.001 * max(config.axis_acceleration)
    assert (np.diff(place) >= -1e-12).all()


PROGRAM = """G21 G90 G17
G0 X10 Y5
G1 X30 F6000
G1 Y20
G3 X20 Y30 I-10 J0
G4 P0.2
G1 X5 Y5 Z2
M30
"""
