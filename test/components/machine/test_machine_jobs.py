# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Jobs of the simulated machine: at times of a duty, on axes that are clamped in between."""

import numpy as np
import pytest
from benches.component_bench import Bench

from fuzzycnc_ros.components.machine.machine_operator import ENGAGE, timed_jobs
from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.machine.simulated_machine_config import DAY_START, WHOLE_SHIFT
from fuzzycnc_ros.components.motion.feedrate_scheduler import FeedrateScheduler
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.graph import InProcessGraph
from fuzzycnc_ros.runtime.records import nanoseconds
from fuzzycnc_ros.studies.contour.contouring import ContouringLog

START = nanoseconds(DAY_START)
PERIOD = 1_000_000
SQUARE = 'G21 G90\nG0 X5 Y5\nG1 X10 F6000\nG3 X10 Y10 I0 J2.5\nG1 X5\nM2\n'


def config(**changes) -> SimulatedMachineConfig:
    """Return a short duty with jobs."""
    values = {'duties': ('T2',), 'duty_duration': 300.0, 'tick_period': 10.0, **changes}
    return SimulatedMachineConfig(**values)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'jobs': ('path:butterfly',)}, 'jobs: expected SECONDS:path'),
        ({'jobs': ('10:path:rose',)}, "jobs: expected .* found '10:path:rose'"),
        ({'jobs': ('10:program:part',)}, 'jobs: expected'),
        ({'jobs': ('10:move:',)}, 'jobs: expected'),
        ({'jobs': ('nan:program',)}, 'jobs: expected'),
        ({'jobs': ('300:program',)}, 'jobs: expected times within the duty of 300 s'),
        ({'jobs': ('20:program', '10:program')}, 'jobs: expected rising times'),
        ({'jobs': ('10:program',), 'duties': ('T2', 'T3')}, 'jobs: expected one duty'),
        ({'jobs': ('10:program',), 'paths': ('trident',)}, 'jobs: expected one duty and neither'),
        ({'jobs': ('10:move:X:0.01',)}, "jobs: expected servo_axes for the move 'X:0.01'"),
        (
            {'jobs': ('10:move:Z:0.01',), 'servo_axes': ('X:lathe',)},
            'moves: expected targets in m as X:-0.05 of axes among X',
        ),
        ({'jobs': ('10:program',), 'part_program': 'G28 X0\nM2\n'}, 'line 1: expected a motion'),
    ],
)
def test_jobs_that_cannot_be_done_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        SimulatedMachine(config(**changes))


def test_jobs_are_read_in_their_order():
    first, second = timed_jobs(('0:move:X:0.1,Y:0', '5.5:path:trident'), 10.0)
    assert (first.start, first.kind, first.what) == (0.0, 'move', 'X:0.1,Y:0')
    assert (second.start, second.kind, second.name) == (5.5, 'path', 'trident')


def test_the_shift_lasts_eight_hours():
    assert WHOLE_SHIFT.duration == 8 * 3600.0
    speeds = {block.spindle_speed for block in WHOLE_SHIFT.blocks}
    assert 0.0 in speeds
    assert len(speeds) >= 4


@pytest.fixture(scope='module')
def cut():
    """Two jobs on built-in axes with the duty going on, and the same duty without."""
    records = []
    log = ContouringLog()

    def sink(topic, record):
        records.append((topic, record))
        log(topic, record)

    machine = SimulatedMachine(
        config(jobs=('35:program', '105.5:path:trident'), part_program=SQUARE)
    )
    planner = FeedrateScheduler(FeedrateSchedulerConfig(tolerance=5e-5, settle=0.25))
    graph = InProcessGraph(machine, [planner], sink=sink)
    graph.request(planner.NAME, 'activate')
    graph.run()
    idle = []
    alone = SimulatedMachine(config())
    InProcessGraph(alone, [], sink=lambda topic, record: idle.append((topic, record))).run()
    return machine, log.paths(), records, idle


def test_jobs_are_loaded_at_their_times_and_done(cut):
    machine, paths, records, _ = cut
    assert machine.failure == ''
    assert [path.name for path in paths] == ['program', 'trident']
    assert all(path.finished and path.error_max <= 6e-5 for path in paths)
    loaded = [record.stamp - START for topic, record in records if topic == 'tool_path']
    for stamp, due in zip(loaded, (35.0, 105.5), strict=True):
        assert 0.0 <= 1e-9 * stamp - due - ENGAGE < 0.011
    end = paths[0].position[-1]
    np.testing.assert_allclose(end, [0.005, 0.01, 0.0], atol=1e-6)


def test_the_duty_goes_on_as_without_jobs(cut):
    _, _, records, idle = cut
    for wanted in ('sensor_readings', 'displacement'):
        with_jobs = [record for topic, record in records if topic == wanted]
        without = [record for topic, record in idle if topic == wanted]
        assert [item.stamp for item in with_jobs] == [item.stamp for item in without]
        name = 'temperature' if wanted == 'sensor_readings' else 'displacement'
        np.testing.assert_array_equal(
            [getattr(item, name) for item in with_jobs],
            [getattr(item, name) for item in without],
        )


def test_a_job_that_nobody_schedules_is_given_up_and_the_duty_goes_on():
    machine = SimulatedMachine(config(jobs=('20:path:trident', '50:program'), path_timeout=2.0))
    stamps = []
    InProcessGraph(
        machine, [], sink=lambda topic, record: stamps.append((topic, record.stamp))
    ).run()
    assert 'path trident was not followed to its end' in machine.failure
    assert [topic for topic, _ in stamps].count('tool_path') == 1
    assert max(stamp for _, stamp in stamps) >= START + nanoseconds(300.0)


class Driven(Bench):
    """A machine whose axes nobody controls, tick by tick."""

    def __init__(self, **changes) -> None:
        super().__init__(SimulatedMachine(config(**changes)))

    def run(self) -> None:
        """Tick to the end of the programme."""
        while self.component.next_tick is not None:
            self.emitted += self.merger.advance(self.component.next_tick)
            self.emitted += list(self.component.tick())


def test_driven_axes_have_periods_while_they_are_needed_only():
    machine = Driven(
        jobs=('35:move:X:0.0', '65:move:X:0.0'), servo_axes=('X:lathe',), move_time=0.5
    )
    machine.run()
    assert machine.component.failure == ''
    states = machine.records('axis_state')
    driven = np.array([item.stamp for item in states if item.axis]) - START
    assert all(len(item.position) == len(item.axis) for item in states)
    starts = driven[np.append(True, np.diff(driven) > PERIOD)]
    assert starts.tolist() == [nanoseconds(35.001), nanoseconds(65.001)]
    ends = driven[np.append(np.diff(driven) > PERIOD, True)]
    clamped = [item.stamp - START for item in states if not item.axis]
    assert set((ends + PERIOD).tolist()) <= set(clamped)
    commands = [item.stamp - START for item in machine.records('position_command')]
    assert [stamp // nanoseconds(1.0) for stamp in commands] == [35, 65]
    assert machine.component.ticks_done <= machine.component.total_ticks


def test_axes_that_do_not_arrive_do_not_hold_the_shift_up():
    machine = Driven(
        jobs=('35:move:X:0.01', '65:move:X:0.0'), servo_axes=('X:lathe',), move_time=0.5
    )
    machine.run()
    assert machine.component.failure.startswith('move 1: expected X within 10 µm of 10 mm')
    modes = {item.state for item in machine.records('machine_state')}
    assert modes <= {MachineMode.ON, MachineMode.RUNNING}
    last = machine.records('machine_state')[-1]
    assert last.stamp >= START + nanoseconds(300.0)
