# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated machine in motion: fast ticks, what the axes do, contour error, paths, stops."""

from dataclasses import fields, replace

import numpy as np
import pytest
from benches.component_bench import Bench
from benches.trajectory_bench import PERIOD, line, parts, record, trapezoid

from fuzzycnc_ros.components.machine.machine_axes import MOTION_AXES
from fuzzycnc_ros.components.machine.simulated_machine import (
    DAY,
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.machine.simulated_machine_config import DAY_START, contouring_config
from fuzzycnc_ros.core.feedrate.path.curves import SHEET_SCALES, butterfly
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.schedule.scheduler import ConstantNormalAcceleration
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.core.machine.path_loop import ContouringConfig
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import SECOND, nanoseconds
from fuzzycnc_ros.simulation.motion.contour import Contour
from fuzzycnc_ros.simulation.motion.contouring import (
    controller_feed,
    simulate_contouring,
    travel,
)

STEP = round(PERIOD * SECOND)
START = nanoseconds(DAY_START)
RUN_OUT = 300
"""Ticks from the last sample to rest."""


class Machine(Bench):
    """A machine that is ticked as a host does it; later parts are sent 50 ms ahead."""

    def __init__(self, **changes) -> None:
        values = {'duties': (), 'paths': ('trident',), 'path_timeout': 5.0, **changes}
        super().__init__(SimulatedMachine(SimulatedMachineConfig(**values)))
        self.coming: list = []

    def tick(self) -> list:
        """Hand over what is due, tick once; return the records by topic."""
        now = self.merger.time
        while self.coming and self.coming[0].start - nanoseconds(0.05) <= now:
            self.give_part(self.coming.pop(0))
        stamp = self.component.next_tick
        self.emitted += self.merger.advance(stamp)
        found = list(self.component.tick())
        self.emitted += found
        return found

    def give_part(self, part) -> None:
        """Hand over a part now."""
        now = self.merger.time
        assert self.push('trajectory', record(part, now))
        self.emitted += self.merger.advance(now)

    def run_to(self, time: int) -> None:
        """Tick up to a machine time [ns] or the end of the programme."""
        while self.component.next_tick is not None and self.component.next_tick <= time:
            self.tick()

    def finish(self) -> None:
        """Tick until the programme is over."""
        while self.component.next_tick is not None:
            self.tick()

    def send(self, first, *found) -> None:
        """Send a part, and others when they are due."""
        self.coming += found
        self.give_part(first)


def ready(**changes) -> Machine:
    """Return a machine that waits for the trajectory of its path."""
    machine = Machine(**changes)
    machine.tick()
    return machine


def path(machine, way=None, wait=0.1, **changes):
    """Return the parts of a straight line that starts soon."""
    changes = {'path_id': 'trident', **changes}
    begin = machine.merger.time + nanoseconds(wait)
    return parts(line, trapezoid(0.02) if way is None else way, start=begin, **changes)


def test_axis_parameters_are_those_of_the_contouring_machine():
    machine = {item.name: item for item in fields(SimulatedMachineConfig)}
    own = {item.name: item for item in fields(ContouringConfig)}
    there = [name for name in own if f'axis_{name}' in machine]
    assert set(own) - set(there) == {'path_acceleration_max', 'velocity_min'}
    for name in there:
        assert machine[f'axis_{name}'].default == own[name].default
        assert machine[f'axis_{name}'].metadata == own[name].metadata
    assert contouring_config(SimulatedMachineConfig()) == ContouringConfig()
    changed = contouring_config(SimulatedMachineConfig(axis_position_gain=30.0))
    assert changed == ContouringConfig(position_gain=30.0)
    with pytest.raises(ValueError, match='loops that settle'):
        Machine(axis_velocity_bandwidth=9000.0)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'paths': ('circle',)}, 'paths: expected names among infinity, trident, butterfly but'),
        ({'paths': ()}, 'duties: expected names among .* but found none, and no paths either'),
    ],
)
def test_unknown_path_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Machine(**changes)


def test_first_tick_tells_all_that_a_path_needs():
    machine = Machine()
    found = machine.tick()
    topics = [item.output for item in found]
    assert topics == [
        'machine_state',
        'compensation_applied',
        'sensor_readings',
        'axis_state',
        'trajectory_state',
        'tool_path',
    ]
    assert {item.record.stamp for item in found} == {START + 12 * SECOND}
    state, axes, trajectory, tool = (found[k].record for k in (0, 3, 4, 5))
    assert (state.state, state.spindle_speed, state.axis) == (MachineMode.ON, 0.0, MOTION_AXES)
    np.testing.assert_array_equal([axes.reference, axes.position, axes.velocity], 0.0)
    assert (trajectory.status, trajectory.epoch) == (TrajectoryStatus.IDLE, 0)
    assert (tool.path_id, tool.frame_id) == ('trident', 'mill/workpiece')
    np.testing.assert_allclose(tool.feedrate, 0.2)


def test_axes_that_rest_are_told_every_half_minute_of_a_duty():
    machine = Machine(duties=('T2', 'T2'), paths=(), duty_duration=120.0, tick_period=6.0)
    machine.finish()
    for topic in ('axis_state', 'trajectory_state'):
        stamps = [item.stamp for item in machine.records(topic)]
        expected = [
            day + (6 + 30 * k) * SECOND
            for day in (START, START + nanoseconds(DAY))
            for k in range(4)
        ]
        assert stamps == expected


def test_every_period_of_a_path_is_reported_from_start_to_rest():
    machine = ready()
    way = trapezoid(0.02)
    pieces = path(machine, way)
    start = pieces[0].start
    machine.emitted.clear()
    machine.send(*pieces)
    machine.finish()
    axes = [item for item in machine.records('axis_state') if item.stamp >= start]
    count = len(way) + RUN_OUT
    assert [item.stamp for item in axes] == [start + k * STEP for k in range(count)]
    reference = np.array([item.reference for item in axes])
    np.testing.assert_array_equal(reference[: len(way)], line(way))
    np.testing.assert_array_equal(reference[len(way) :], np.tile(line(way)[-1], (RUN_OUT, 1)))
    position, velocity = (
        np.array([getattr(a, n) for a in axes]) for n in ('position', 'velocity')
    )
    np.testing.assert_allclose(position[-1], reference[-1], atol=1e-7)
    speed = np.diff(position, axis=0) / PERIOD
    np.testing.assert_allclose(speed, 0.5 * (velocity[1:] + velocity[:-1]), atol=2e-3)

    errors = machine.records('contour_error')
    assert [len(item.error) for item in errors[:-1]] == [100] * (len(errors) - 1)
    assert sum(len(item.error) for item in errors) == count
    assert errors[-1].stamp == axes[-1].stamp
    assert {item.path_id for item in errors} == {'trident'}
    assert max(item.error.max() for item in errors) < 1e-12  # it is a straight line
    place = np.concatenate([item.arc_length for item in errors])
    np.testing.assert_allclose(place, np.linalg.norm(position, axis=1), atol=1e-9)

    states = machine.records('trajectory_state')
    told = [(item.part, TrajectoryStatus(item.status).name) for item in states]
    assert told[-1] == (3, 'FINISHED')
    assert {name for _, name in told[:-1]} == {'FOLLOWING'}
    assert [item for item, _ in told] == sorted(item for item, _ in told)
    assert states[-1].stamp == start + (len(way) - 1) * STEP

    modes = [(item.stamp, item.state) for item in machine.records('machine_state')]
    assert modes == [(start, MachineMode.RUNNING), (axes[-1].stamp, MachineMode.ON)]
    np.testing.assert_array_equal(machine.records('machine_state')[-1].position, reference[-1])
    assert machine.component.failure == ''


def test_butterfly_is_what_the_contouring_machine_makes_of_it():
    """The same axes and, to the chords between samples, the same contour error."""
    config = ContouringConfig()
    curve = butterfly(SHEET_SCALES['butterfly'])
    # its sharpest bend has a radius of 20 um: 40 001 vertices would miss it by 0.4 um
    contour = Contour.curve(curve.point, vertices=400_001)
    parameter = np.linspace(0.0, 1.0, 20_000)
    arc = contour.arc_length(parameter)
    scheduler = ConstantNormalAcceleration(
        feed_max=0.2, normal_acceleration=40e-6 / config.contour_constant
    )
    feed = scheduler.feed(SampledPath.from_points(curve.point(parameter)))
    expected = simulate_contouring(contour, arc, feed, config)
    way, _ = travel(arc, controller_feed(arc, feed, config), PERIOD)

    machine = ready(paths=('butterfly',))
    origin = contour.position([0.0])[0]

    def from_rest(place):
        return contour.position(place) - origin

    start = machine.merger.time + nanoseconds(0.1)
    machine.send(*parts(from_rest, way, start=start, chunk=250, path_id='butterfly'))
    machine.finish()
    assert machine.records('trajectory_state')[-1].status == TrajectoryStatus.FINISHED
    axes = [item for item in machine.records('axis_state') if item.stamp >= start]
    position = np.array([item.position[:2] for item in axes]) + origin
    np.testing.assert_allclose(position, expected.position, rtol=0, atol=1e-12)
    error = np.concatenate([item.error for item in machine.records('contour_error')])
    assert len(error) == len(expected.error)
    assert error.max() == pytest.approx(expected.error_max, rel=1e-3)
    assert error.mean() == pytest.approx(expected.error.mean(), rel=1e-3)
    np.testing.assert_allclose(error, expected.error, rtol=0, atol=5e-8)


@pytest.mark.slow
def test_a_duty_warms_the_machine_alike_whether_its_axes_move():
    plain, moved = (Machine(duties=('T2',), paths=(), duty_duration=240.0) for _ in range(2))
    moved.run_to(START + 24 * SECOND)
    moved.send(*path(moved, trapezoid(3.0), path_id='from the operator', wait=0.0503))
    moved.finish()
    plain.finish()
    assert moved.records('trajectory_state')[-1].status == TrajectoryStatus.FINISHED
    assert len(moved.records('axis_state')) > 30_000
    for topic in ('sensor_readings', 'displacement', 'compensation_applied'):
        ours, theirs = moved.records(topic), plain.records(topic)
        assert [item.stamp for item in ours] == [item.stamp for item in theirs]
    for ours, theirs in zip(
        moved.records('sensor_readings'), plain.records('sensor_readings'), strict=True
    ):
        np.testing.assert_array_equal(ours.temperature, theirs.temperature)
    stamps = [item.stamp for item in moved.records('machine_state')]
    assert stamps == sorted(set(stamps))


def test_the_next_duty_waits_for_the_end_of_a_path():
    machine = Machine(duties=('T2', 'T2'), paths=(), duty_duration=60.0)
    machine.run_to(START + 59 * SECOND)
    machine.send(*path(machine, trapezoid(1.5), path_id='long'))
    machine.finish()
    axes = machine.records('axis_state')
    moving = [item.stamp for item in axes if np.abs(item.velocity).max() > 1e-3]
    assert moving[0] < START + 60 * SECOND < moving[-1] < START + 70 * SECOND
    readings = [item.stamp for item in machine.records('sensor_readings')]
    first, second = START, START + nanoseconds(DAY)
    assert readings == [day + k * 12 * SECOND for day in (first, second) for k in range(1, 6)]


def test_paths_are_loaded_one_after_the_other_after_the_duties():
    machine = Machine(duties=('T2',), duty_duration=24.0, paths=('trident', 'infinity', 'trident'))
    names, progress = [], []
    while machine.component.next_tick is not None:
        tools = [item.record for item in machine.tick() if item.output == 'tool_path']
        for tool in tools:
            names.append(tool.path_id)
            rest = machine.records('axis_state')[-1]
            assert rest.stamp == tool.stamp
            begin = rest.reference.copy()
            machine.send(
                *parts(
                    lambda s, b=begin: b + line(s),
                    trapezoid(0.02),
                    start=tool.stamp + SECOND // 4,
                    path_id=tool.path_id,
                )
            )
        progress.append((machine.component.ticks_done, machine.component.total_ticks))
    assert names == ['trident', 'infinity', 'trident_2']
    assert machine.records('tool_path')[0].stamp == START + 36 * SECOND
    finished = [
        item.path_id
        for item in machine.records('trajectory_state')
        if item.status == TrajectoryStatus.FINISHED
    ]
    assert list(dict.fromkeys(finished)) == names
    done, total = np.transpose(progress)
    assert np.all(np.diff(done) >= 0)
    assert np.all(total == total[0])
    assert done[-1] == total[-1]
    assert machine.component.failure == ''
    assert 'OK path: none' in machine.health()


def test_a_path_without_a_trajectory_ends_the_run():
    machine = ready(path_timeout=2.0, paths=('butterfly', 'trident'))
    loaded = machine.merger.time
    machine.finish()
    assert machine.merger.time == loaded + 2 * SECOND
    assert 'path butterfly was not followed to its end: no trajectory for 2 s' in (
        machine.component.failure
    )
    assert 'ERROR path: path butterfly was not followed' in machine.health()
    assert [item.path_id for item in machine.records('tool_path')] == ['butterfly']


def test_a_starved_path_rests_on_the_path_and_ends_the_run():
    machine = ready(path_timeout=1.0)
    first, second, *_ = path(machine)
    machine.send(first, second)
    machine.finish()
    state = machine.records('trajectory_state')[-1]
    assert (state.status, state.part) == (TrajectoryStatus.STARVED, 1)
    last = machine.records('axis_state')[-1]
    np.testing.assert_allclose(last.position, last.reference, atol=1e-7)
    np.testing.assert_allclose(np.cross(last.position, [0.6, -0.8, 0.0]), 0.0, atol=1e-9)
    assert 'starved trident' in machine.component.failure
    assert 'WARN axes: starved trident' in machine.health()
    rest = [i.stamp for i in machine.records('machine_state') if i.state == MachineMode.ON][-1]
    assert machine.merger.time == rest + SECOND


def test_what_is_refused_after_the_end_of_a_path_does_not_undo_it():
    machine = ready(paths=('trident', 'infinity'))
    pieces = path(machine)
    machine.send(*pieces)
    machine.run_to(pieces[-1].start + pieces[-1].committed * STEP)
    machine.give_part(replace(pieces[-1], part=9))
    while len(machine.records('tool_path')) < 2:
        machine.tick()
    assert machine.records('trajectory_state')[-1].status == TrajectoryStatus.REFUSED
    assert machine.component.failure == ''
    np.testing.assert_allclose(
        machine.records('axis_state')[-1].position, line([0.02])[0], atol=1e-7
    )


def test_a_refused_part_is_told_at_once_though_the_axes_rest():
    machine = Machine(duties=('T2',), paths=())
    machine.tick()
    now = machine.merger.time
    machine.send(replace(path(machine)[0], part=3))
    found = machine.tick()
    assert [item.output for item in found] == ['axis_state', 'trajectory_state']
    state = found[-1].record
    assert (state.stamp, state.status) == (now + STEP, TrajectoryStatus.REFUSED)
    assert "expected part 0 of a path but found part 3 of 'trident'" in state.reason
    assert machine.component.next_tick == now + 12 * SECOND
    machine.tick()
    assert machine.records('trajectory_state')[-1].reason == state.reason
    assert 'WARN axes: expected part 0' in machine.health()


@pytest.mark.parametrize('mode', [MachineMode.ESTOP, MachineMode.OFF, MachineMode.FAULT])
def test_a_stop_holds_the_axes_and_gives_the_path_up(mode):
    machine = ready(path_timeout=1.0, axis_run_out=0.1)
    pieces = path(machine, trapezoid(0.05))
    machine.send(*pieces)
    machine.run_to(pieces[0].start + 250 * STEP)
    machine.component.set_mode(mode)
    before = machine.records('axis_state')[-1]
    machine.coming.clear()
    machine.tick()
    state, axes = machine.records('machine_state')[-1], machine.records('axis_state')[-1]
    assert (state.state, state.offsets_allowed) == (mode, False)
    np.testing.assert_array_equal(axes.reference, before.reference)
    report = machine.records('trajectory_state')[-1]
    assert report.status == TrajectoryStatus.REFUSED
    assert f'does not allow motion: {mode.name.lower()}' in report.reason
    machine.give_part(pieces[3])
    machine.run_to(machine.merger.time + SECOND // 2)
    axes = machine.records('axis_state')
    np.testing.assert_allclose(axes[-1].position, before.reference, atol=2e-7)
    change = np.abs(np.diff([item.velocity for item in axes], axis=0)).max() / PERIOD
    assert change <= ContouringConfig().acceleration_max * (1 + 1e-9)

    machine.component.set_mode(MachineMode.ON)
    rest = axes[-1].reference
    begin = machine.merger.time + SECOND // 10
    machine.send(*parts(lambda s: rest + line(s), trapezoid(0.01), start=begin, path_id='trident'))
    machine.finish()
    assert machine.records('trajectory_state')[-1].status == TrajectoryStatus.FINISHED
    assert machine.component.failure == ''


def test_a_path_may_begin_while_the_axes_still_settle():
    machine = ready(paths=('trident',))
    first = path(machine, path_id='first')
    machine.send(*first)
    end = first[-1].start + first[-1].committed * STEP
    machine.run_to(end + 10 * STEP)
    place = machine.records('axis_state')[-1].reference
    second = parts(
        lambda s: place + line(s, [0.0, 0.6, 0.8]),
        trapezoid(0.01),
        start=machine.merger.time + nanoseconds(0.0204),
        path_id='trident',
    )
    machine.send(*second)
    machine.finish()
    errors = machine.records('contour_error')
    assert list(dict.fromkeys(item.path_id for item in errors)) == ['first', 'trident']
    counts = {name: 0 for name in ('first', 'trident')}
    for item in errors:
        counts[item.path_id] += len(item.error)
    moved = [item for item in machine.records('axis_state') if item.stamp >= first[0].start]
    assert sum(counts.values()) == len(moved)
    assert max(item.error.max() for item in errors) < 1e-3
    assert machine.component.failure == ''
