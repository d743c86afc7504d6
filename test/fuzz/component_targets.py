# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Every component at work, the good records that it takes, and the proof that it still works."""

import random
import sys
from copy import deepcopy
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fuzzycnc_ros.components.codes import (
    AppliedStatus,
    CompensationState,
    MachineMode,
    ServoStatus,
    Status,
    TrajectoryStatus,
)
from fuzzycnc_ros.components.compensator import Compensator
from fuzzycnc_ros.components.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.components.records import (
    SECOND,
    AxisCommand,
    AxisState,
    Compensation,
    PositionCommand,
    Record,
    SensorCluster,
    SensorSelection,
    ToolPath,
    TrajectoryState,
    nanoseconds,
)
from fuzzycnc_ros.components.sensor_selector import SensorSelector, SensorSelectorConfig
from fuzzycnc_ros.components.servo_controller import ServoController
from fuzzycnc_ros.components.simulated_machine import SimulatedMachine, SimulatedMachineConfig
from fuzzycnc_ros.components.temperature_acquisition import TemperatureAcquisition

sys.path.insert(0, str(Path(__file__).parents[1] / 'core'))
import predictor_bench
import trajectory_bench
from component_bench import Bench, applied, machine_state, readings, thermal_error

PERIOD = 1_000_000
"""Control period of the servo axes [ns]."""


class Target:
    """A component at work.

    `good` returns a record of an input as it belongs; `recover` gives good records from a time on
    and asserts that they get good answers.
    """

    inputs: tuple[str, ...]
    start = 1000 * SECOND
    """Stamp of the first record that may be hostile [ns]."""
    step = SECOND
    """Time between two records [ns]."""
    makes_time = False
    """Whether no stamp of a record moves its time on."""

    @cached_property
    def prepared(self) -> Bench:
        """A component at work; only copies of it are used."""
        return self.make()

    def bench(self) -> Bench:
        """Return a component at work."""
        return deepcopy(self.prepared)

    def make(self) -> Bench:
        """Return a component at work."""
        raise NotImplementedError

    def good(self, name: str, stamp: int, rng: random.Random) -> Record:
        """Return a record of an input."""
        raise NotImplementedError

    def recover(self, bench: Bench, stamp: int) -> None:
        """Assert that good records get good answers."""
        raise NotImplementedError

    def check(self, bench: Bench) -> None:
        """Assert what must hold for everything that was published."""


def work(bench: Bench, stamp: int) -> None:
    """Work up to a stamp [ns]."""
    bench.emitted += bench.merger.advance(stamp)


class CompensatorTarget(Target):
    """A compensator that follows 3 um; half of the time one that has no read-back yet."""

    inputs = ('machine_state', 'compensation_applied', 'thermal_error')
    step = 20 * SECOND

    def make(self) -> Bench:
        bench = Bench(Compensator())
        bench.until(900.0)
        assert bench.request('activate').success
        bench.push('machine_state', machine_state(900.0))
        return bench

    def bench(self) -> Bench:
        bench = super().bench()
        if len(bench.emitted) % 2 == 0:
            bench.push('compensation_applied', applied(910.0))
            bench.give('thermal_error', thermal_error(950.0, (3e-6, -3e-6)))
        return bench

    def good(self, name, stamp, rng):
        time = stamp / SECOND
        if name == 'machine_state':
            return replace(machine_state(time), stamp=stamp)
        if name == 'compensation_applied':
            return replace(applied(time), stamp=stamp)
        return replace(thermal_error(time, (3e-6, -3e-6)), stamp=stamp)

    def recover(self, bench, stamp):
        for _ in range(40):
            stamp += 30 * SECOND
            for name in self.inputs:
                bench.push(name, self.good(name, stamp, random.Random(0)))
            work(bench, stamp)
        newest = bench.records('compensation')[-1]
        assert newest.state == CompensationState.ACTIVE, bench.health()
        np.testing.assert_allclose(newest.offset, [-3e-6, 3e-6], atol=1e-12)

    def check(self, bench):
        for item in bench.records('compensation'):
            assert (np.abs(item.offset) <= 50e-6).all(), item.offset


class AcquisitionTarget(Target):
    """An acquisition that gets a reading of four sensors every 12 s."""

    inputs = ('sensor_readings', 'machine_state')
    step = 12 * SECOND
    start = 1200 * SECOND
    names = ('T1', 'T2', 'T3', 'T4')

    def make(self) -> Bench:
        bench = Bench(TemperatureAcquisition())
        for number in range(40):
            stamp = 600 * SECOND + number * self.step
            for name in self.inputs:
                bench.push(name, self.good(name, stamp, random.Random(number)))
            work(bench, stamp)
        assert bench.records('temperatures')
        return bench

    def good(self, name, stamp, rng):
        time = stamp / SECOND
        if name == 'machine_state':
            return replace(machine_state(time), stamp=stamp)
        values = [20.0 + 0.1 * rng.random() + k for k in range(4)]
        return replace(readings(time, values), stamp=stamp)

    def recover(self, bench, stamp):
        rng = random.Random(1)
        stamp = (stamp // (60 * SECOND) + 20) * 60 * SECOND
        cold = stamp
        for _ in range(30):
            stamp += self.step
            bench.push('machine_state', machine_state(stamp / SECOND, cold_since=cold))
            bench.push('sensor_readings', self.good('sensor_readings', stamp, rng))
            work(bench, stamp)
        newest = bench.records('temperatures')[-1]
        assert newest.sensor == self.names
        assert (newest.status == Status.OK).all(), (newest, bench.health())
        np.testing.assert_allclose(newest.temperature, [20.0, 21.0, 22.0, 23.0], atol=0.1)
        assert bench.records('thermal_reference')[-1].cold_since == cold, bench.health()

    def check(self, bench):
        for item in bench.records('thermal_reference'):
            assert item.cold_since <= item.stamp, (item.cold_since, item.stamp)
        for item in bench.records('temperatures'):
            assert len(item.temperature) == len(item.status) == len(item.sensor)
            assert np.isfinite(item.temperature[item.status == Status.OK]).all()


class SelectorTarget(Target):
    """A selector that has kept a run of thirty samples."""

    inputs = ('displacement', 'temperatures')
    step = 60 * SECOND
    run = property(lambda self: predictor_bench.recordings()['D0'])

    def make(self) -> Bench:
        config = SensorSelectorConfig(clusters=2, refine=False)
        bench = Bench(SensorSelector(config))
        self.start = nanoseconds(predictor_bench.START + self.run.time[30])
        for row in range(30):
            bench.push('displacement', predictor_bench.probe_of(self.run, row))
            bench.give('temperatures', predictor_bench.sample_of(self.run, row))
        return bench

    def bench(self) -> Bench:
        bench = super().bench()
        bench.component.run_reader = lambda name: self.run
        return bench

    def good(self, name, stamp, rng):
        row = rng.randrange(30, 60)
        if name == 'displacement':
            return replace(predictor_bench.probe_of(self.run, row), stamp=stamp)
        return replace(predictor_bench.sample_of(self.run, row), stamp=stamp)

    def recover(self, bench, stamp):
        rng = random.Random(2)
        for name in self.inputs:
            bench.push(name, self.good(name, stamp, rng))
        work(bench, stamp)
        present = bench.request('select_sensors')
        assert present.success or present.message
        if rng.random() < 0.1:
            answer = bench.request('select_sensors', bag=['D0'])
            assert answer.success, answer.message


class PredictorTarget(Target):
    """A predictor in the midst of a run; probes are for training only."""

    inputs = (
        'sensor_selection',
        'thermal_reference',
        'machine_state',
        'compensation_applied',
        'displacement',
        'temperatures',
    )
    step = 60 * SECOND
    run = property(lambda self: predictor_bench.recordings()['T1'])
    rows = 12
    probing = 'none'

    def make(self) -> Bench:
        bench = predictor_bench.bench_with_model(probing=self.probing)
        predictor_bench.predict(bench, self.run, range(self.rows))
        self.start = bench.merger.time + self.step
        assert bench.records('thermal_error')[-1].valid
        return bench

    @cached_property
    def wanted(self) -> Any:
        """Errors at the beginning of the run."""
        bench = predictor_bench.bench_with_model()
        return predictor_bench.errors_of(
            predictor_bench.predict(bench, self.run, range(self.rows))[2:]
        )

    def good(self, name, stamp, rng):
        run, row, time = self.run, self.rows + rng.randrange(20), stamp / SECOND
        if name == 'sensor_selection':
            cluster = SensorCluster(
                member=run.sensor[:3],
                score=np.ones(3),
                chosen=run.sensor[0],
                substitute=run.sensor[1:3],
                gain=np.ones(2),
                correlation=np.ones(2),
            )
            return SensorSelection(
                stamp=stamp,
                method='correlation',
                cluster=(cluster,),
                partition_coefficient=0.9,
                xie_beni=0.1,
                dropped=(),
                calibration=('D0',),
            )
        if name == 'thermal_reference':
            cold = stamp - 4 * self.step
            return predictor_bench.reference_of(run, stamp=stamp, cold_since=cold)
        if name == 'machine_state':
            return replace(machine_state(time), stamp=stamp)
        if name == 'compensation_applied':
            return replace(applied(time), stamp=stamp)
        if name == 'displacement':
            probe = predictor_bench.probe_of(run, row, includes_compensation=rng.random() < 0.5)
            return replace(probe, stamp=stamp)
        return replace(predictor_bench.sample_of(run, row), stamp=stamp)

    def recover(self, bench, stamp):
        stamp += 86_400 * SECOND
        cold = stamp
        found = []
        for row in range(self.rows):
            stamp += self.step
            if row == 2:
                reference = self.good('thermal_reference', stamp, random.Random(0))
                bench.push('thermal_reference', replace(reference, cold_since=cold))
            sample = replace(predictor_bench.sample_of(self.run, row), stamp=stamp)
            bench.push('temperatures', sample)
            work(bench, stamp)
            found.append(bench.records('thermal_error')[-1])
        assert found[-1].valid, bench.health()
        if self.probing == 'none':
            errors = predictor_bench.errors_of(found[2:])
            np.testing.assert_allclose(errors, self.wanted, atol=1e-6)

    def check(self, bench):
        for item in bench.records('thermal_error'):
            if item.valid:
                assert np.isfinite(item.error).all()
                assert np.isfinite(item.standard_deviation).all()


class ProbingTarget(PredictorTarget):
    """A predictor that learns from probes; hostile ones that are plausible count as well."""

    inputs = ('compensation_applied', 'displacement', 'thermal_reference', 'temperatures')
    probing = 'offset'


class SchedulerTarget(Target):
    """A scheduler that waits for a path, on a machine at rest."""

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


class ServoTarget(Target):
    """A servo controller that holds an axis."""

    inputs = ('machine_state', 'position_command', 'trajectory', 'axis_state')
    step = PERIOD

    def make(self) -> Bench:
        bench = Bench(ServoController())
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
            return replace(machine_state(1.0), stamp=stamp)
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


class MachineTarget(Target):
    """A simulated machine amid a duty, with axes that follow trajectories."""

    inputs = ('compensation', 'trajectory')
    makes_time = True
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
        assert self.read_back(bench).status == AppliedStatus.FOLLOWING, bench.health()

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


TARGETS = {
    'compensator': CompensatorTarget(),
    'temperature_acquisition': AcquisitionTarget(),
    'sensor_selector': SelectorTarget(),
    'thermal_predictor': PredictorTarget(),
    'thermal_predictor that probes': ProbingTarget(),
    'feedrate_scheduler': SchedulerTarget(),
    'servo_controller': ServoTarget(),
    'simulated_machine': MachineTarget(),
    'simulated_machine with servo axes': ServoMachineTarget(),
}
