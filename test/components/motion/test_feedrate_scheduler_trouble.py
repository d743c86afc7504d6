# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feedrate scheduler: what it does when it cannot, must not or should not go on."""

import re
from dataclasses import replace

import numpy as np
import pytest
from bag_libraries import need_bag_libraries
from benches.component_bench import machine_state
from benches.feedrate_rig import CONFIG, PROGRAM, SMALL, Rig, check_motion, distance, path_of

from fuzzycnc_ros.components.motion.tool_paths import program_tool_path
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.path.curves import butterfly
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import SECOND, nanoseconds


@pytest.mark.parametrize('changes', [{'method': 'look_ahead'}, {'curvature_max': 0.0}])
def test_method_that_needs_the_whole_path_refuses_paths(changes):
    rig = Rig(replace(CONFIG, **changes), active=False)
    answer = rig.request('activate')
    assert not answer.success
    assert answer.message.startswith('method: expected one that takes a path in parts')
    rig.restart()
    rig.component.reconfigure(replace(CONFIG, **changes))
    rig.step(path_of(SMALL))
    rig.steps(20)
    assert 'ERROR state: curve refused: method: expected one that takes' in rig.bench.health()
    assert not rig.records()


def test_deactivation_brakes_to_rest_on_the_path_and_drops_it():
    rig = Rig()
    rig.run(path_of(butterfly(), 'butterfly'), until=lambda: len(rig.records()) == 9)
    answer = rig.request('deactivate')
    assert answer.success
    assert answer.message == 'inactive; butterfly ends at rest'
    last = rig.records()[-1]
    assert last.last
    assert last.part == 9
    assert not last.velocity[-2:].any() or np.abs(last.velocity[-2:]).max() < 4e-3
    rig.run(until=lambda: rig.done)
    check_motion(rig)
    _, position, _, place = rig.motion()
    on = place >= 0.0
    assert place[-1] < 0.9 * butterfly().length
    assert distance(butterfly(), place[on], position[on, :2]).max() <= 1e-9
    count = len(rig.records())
    rig.steps(100)
    assert len(rig.records()) == count
    assert 'OK state: inactive' in rig.bench.health()
    assert not rig.request('deactivate').success
    # Activated again, the path is not run again; a new one has a higher epoch.
    assert rig.request('activate').success
    assert not rig.request('activate').success
    rig.steps(30)
    assert len(rig.records()) == count
    rig.samples.clear()
    rig.run(path_of(SMALL, 'next'), until=lambda: rig.done and rig.machine.path_id == 'next')
    check_motion(rig)
    assert rig.records()[-1].epoch == 2


def test_deactivation_during_a_feed_hold():
    rig = Rig()
    rig.run(path_of(SMALL), until=lambda: len(rig.records()) == 2)
    rig.reconfigure(replace(CONFIG, feed_override=0.0))
    rig.steps(40)
    rig.request('deactivate')
    assert rig.records()[-1].committed >= 1
    rig.run(until=lambda: rig.done)
    check_motion(rig)


def test_inactive_nothing_is_published_and_the_newest_path_is_kept():
    rig = Rig(active=False)
    for name in ('first', 'second', 'third'):
        rig.step(path_of(SMALL, name))
    rig.steps(50)
    assert not rig.bench.emitted
    assert rig.component.next_deadline is None
    assert 'WARN lost path: second replaced by third' in rig.bench.health()
    assert rig.request('activate').success
    rig.run(until=lambda: rig.done)
    check_motion(rig)
    assert {part.path_id for part in rig.records()} == {'third'}


def test_starved_path_is_dropped_and_can_be_sent_anew():
    rig = Rig()
    path = path_of(butterfly(), 'butterfly')
    rig.run(path, until=lambda: len(rig.records()) == 5)
    rig.silent = True
    rig.run(turns=200, until=lambda: 'ERROR' in rig.bench.health())
    assert 'ERROR state: butterfly given up: starved by the machine' in rig.bench.health()
    count = len(rig.records())
    rig.steps(60)
    assert len(rig.records()) == count
    assert rig.component.next_deadline is None
    assert not rig.refusals
    rig.silent = False
    stop = rig.machine.sample.position.copy()
    rig.samples.clear()
    rig.run(path)
    check_motion(rig)
    assert rig.records()[-1].last
    np.testing.assert_array_equal(rig.motion()[1][0], stop)
    assert rig.machine.epoch == 1


def test_refused_part_is_reported_with_the_reason_of_the_machine():
    rig = Rig(
        replace(
            CONFIG,
            axis_velocity=(5.0, 5.0, 5.0),
            path_velocity=5.0,
            feed_max=5.0,
            method='constant',
            path_acceleration=3.5,
        )
    )
    line = program_tool_path(read_program('G1 X900 F600000\n'))
    rig.run(line, turns=200, until=lambda: 'ERROR' in rig.bench.health())
    assert rig.refusals
    assert 'velocity of X' in rig.refusals[0]
    assert f'refused by the machine: {rig.refusals[0]}' in rig.bench.health()
    assert rig.component.next_deadline is None


def test_machine_that_never_reports_the_end():
    rig = Rig()
    rig.run(path_of(SMALL), until=lambda: bool(rig.records()) and rig.records()[-1].last)
    rig.bench.until(rig.time / SECOND + 20.0)
    text = 'ERROR state: curve given up: the machine did not say that it has finished'
    assert text in rig.bench.health()
    assert rig.component.next_deadline is None


def test_path_waits_for_position_and_machine():
    rig = Rig()
    bench = rig.bench
    bench.give('tool_path', replace(path_of(SMALL), stamp=2 * SECOND))
    assert 'WARN state: curve waits for machine_state' in bench.health()
    bench.give('machine_state', machine_state(2.5, state=int(MachineMode.ESTOP)))
    assert 'WARN state: curve waits: the machine is not on but estop' in bench.health()
    bench.give('tool_path', replace(path_of(SMALL), stamp=2 * SECOND))
    assert 'lost path' not in bench.health()
    assert 'WARN state: curve waits: the machine is not on but estop' in bench.health()
    bench.give('machine_state', machine_state(3.0, state=int(MachineMode.OFF)))
    assert 'WARN state: curve waits: the machine is not on but off' in bench.health()
    bench.give('machine_state', machine_state(4.0, homed=False))
    assert 'WARN state: curve waits: the machine is not homed' in bench.health()
    bench.give('machine_state', machine_state(5.0))
    assert 'curve waits: no trajectory_state' in bench.health()
    bench.push('trajectory_state', replace(rig.trajectory_state(), stamp=nanoseconds(5.1)))
    bench.give('machine_state', machine_state(5.2))
    assert 'curve waits: no fresh axis_state' in bench.health()
    rig.time = 6 * SECOND
    bench.push('trajectory_state', rig.trajectory_state())
    unknown = replace(rig.axis_state(), reference=np.array([0.0, np.nan, np.nan]))
    bench.push('axis_state', unknown)
    bench.give('machine_state', machine_state(6.0))
    assert 'axis_state does not tell where Y is commanded to be' in bench.health()
    assert not bench.emitted
    rig.time = 7 * SECOND
    bench.push('axis_state', replace(rig.axis_state(), reference=np.array([0.0, 0.0, np.nan])))
    assert not bench.give('axis_state', replace(rig.axis_state(), stamp=nanoseconds(7.5)))
    bench.give('machine_state', machine_state(8.0))
    parts = rig.records()
    assert [part.stamp for part in parts] == [8 * SECOND]
    assert parts[0].start == 8 * SECOND + nanoseconds(CONFIG.lead)
    assert 'OK state: running curve' in bench.health()


def test_emergency_stop_ends_the_path():
    rig = Rig()
    path = path_of(butterfly(), 'butterfly')
    rig.run(path, until=lambda: len(rig.records()) == 5)
    rig.mode = MachineMode.ESTOP
    rig.machine.allow(False, 'emergency stop')
    rig.step()
    text = 'ERROR state: butterfly given up: the machine is not on but estop; send it anew'
    assert text in rig.bench.health()
    count = len(rig.records())
    rig.steps(50)
    rig.mode = MachineMode.RUNNING
    rig.machine.allow(True)
    rig.steps(50)
    assert len(rig.records()) == count
    rig.samples.clear()
    rig.run(path, until=lambda: rig.done)
    check_motion(rig)


def test_second_path_is_refused_and_said_to_be_lost():
    rig = Rig()
    rig.run(path_of(SMALL, 'first'), until=lambda: len(rig.records()) == 1)
    rig.step(path_of(SMALL, 'second'))
    text = 'WARN lost path: second refused: first is being run; send it again afterwards'
    assert text in rig.bench.health()
    rig.run(until=lambda: rig.done)
    assert {part.path_id for part in rig.records()} == {'first'}
    rig.steps(20)
    rig.samples.clear()
    rig.run(path_of(SMALL, 'second'), until=lambda: rig.machine.path_id == 'second' and rig.done)
    assert 'lost path' not in rig.bench.health()
    check_motion(rig)


def test_repeated_latched_path_is_no_second_one():
    rig = Rig()
    path = path_of(SMALL)
    rig.run(path, until=lambda: len(rig.records()) == 1)
    again = replace(rig.given)
    rig.push('tool_path', again)
    rig.step()
    assert 'lost path' not in rig.bench.health()
    rig.run(until=lambda: rig.done)
    rig.push('tool_path', again)
    rig.steps(20)
    assert rig.records()[-1].last


def test_restarted_node_leaves_the_finished_path_and_takes_a_higher_epoch():
    rig = Rig()
    path = path_of(SMALL)
    rig.run(path)
    rig.restart()
    rig.push('tool_path', replace(rig.given))  # still latched
    rig.steps(40)
    assert not rig.records()
    assert 'WARN state: curve was begun before; send it anew' in rig.bench.health()
    rig.samples.clear()
    rig.run(path, until=lambda: bool(rig.records()) and rig.records()[-1].last and rig.done)
    check_motion(rig)
    assert {part.epoch for part in rig.records()} == {2}


def test_restarted_node_waits_until_the_path_of_its_predecessor_rests():
    rig = Rig()
    path = path_of(butterfly(), 'butterfly')
    rig.run(path, until=lambda: len(rig.records()) == 6)
    rig.restart()
    rig.step(path_of(SMALL, 'next'))
    assert 'WARN state: next waits: the machine still follows butterfly' in rig.bench.health()
    rig.run(until=lambda: bool(rig.records()))
    assert rig.machine.status in (TrajectoryStatus.STARVED, TrajectoryStatus.FOLLOWING)
    rig.samples.clear()
    rig.run(until=lambda: rig.done)
    check_motion(rig)
    assert {part.epoch for part in rig.records()} == {2}


def test_other_owner_ends_the_path():
    rig = Rig()
    rig.run(path_of(SMALL), until=lambda: len(rig.records()) == 1)
    rig.time += rig.tick
    rig.bench.push('trajectory_state', replace(rig.trajectory_state(), epoch=7))
    rig.step()
    assert 'curve given up: another owner, epoch 7, moves the machine' in rig.bench.health()


def test_old_latched_path_does_not_start_in_the_past():
    """Nobody knows how late it is when a path arrives that was made long ago."""
    rig = Rig()
    rig.steps(25)
    old = replace(path_of(SMALL), stamp=SECOND // 2)
    rig.bench.push('tool_path', old)
    rig.run(until=lambda: rig.done)
    check_motion(rig)


@pytest.mark.parametrize('spoil', ['offset', 'gap', 'still'])
def test_malformed_path_is_refused_and_moves_nothing(spoil):
    path = path_of(SMALL)
    if spoil == 'offset':
        path = replace(path, offset=path.offset + np.uint32(1))
    elif spoil == 'gap':
        path = replace(path, start=path.start + 1e-3)
    else:
        path = replace(
            path,
            start=np.zeros(2),
            kind=np.zeros(1, np.uint8),
            offset=np.array([0, 2], np.uint32),
            data=np.zeros(2),
        )
    rig = Rig()
    rig.step(path)
    rig.steps(20)
    assert 'ERROR state: curve' in rig.bench.health()
    assert not rig.records()
    assert rig.component.next_deadline is None


def test_schedule_program():
    rig = Rig()
    answer = rig.request('schedule_program', program=PROGRAM)
    assert answer.success
    assert 's in all' in answer.message
    found = rig.component.scheduled
    assert found.duration > 0.2
    assert found.path is None
    assert [line.split(' F')[0] for line in found.program.splitlines()] == [
        line.split(' F')[0] for line in PROGRAM.splitlines()
    ]
    assert found.program != PROGRAM
    assert not rig.bench.emitted


def test_schedule_program_that_is_run():
    rig = Rig()
    rig.steps(12)
    answer = rig.request('schedule_program', program=PROGRAM, path_id='part', run=True)
    assert answer.success
    again = rig.request('schedule_program', program=PROGRAM, run=True)
    assert not again.success
    assert 'run: part is being run' in again.message
    rig.run(until=lambda: rig.done)
    check_motion(rig)
    assert {part.path_id for part in rig.records()} == {'part'}
    np.testing.assert_allclose(rig.motion()[1][-1], [0.005, 0.005, 0.002], atol=1e-12)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'program': 'G1 X(\n'}, 'line 1: '),
        ({'program': 'G0 X1\nG2 X5 Y5 I1 J1 F100\n'}, 'line 2: .*radius does not fit'),
        ({'program': ''}, 'it is empty'),
        ({'program': 'G1 X1\n'}, 'line 1: '),
        ({'program': 'G1 X1 F100\n', 'units': 'cm'}, "expected units 'mm' or 'inch'"),
        ({'program': 'G81 X1 Z1 R1 F100\n', 'run': True}, 'line 1: expected a motion whose place'),
    ],
)
def test_bad_program_changes_nothing(arguments, message):
    rig = Rig()
    rig.steps(12)
    answer = rig.request('schedule_program', **arguments)
    assert not answer.success
    assert re.search(message, answer.message)
    assert rig.component.scheduled is None
    assert rig.component.next_deadline is None
    assert not rig.bench.emitted


def test_program_is_refused_where_it_cannot_be_served():
    rig = Rig(active=False)
    answer = rig.request('schedule_program', program=PROGRAM, run=True)
    assert 'activate it first' in answer.message
    assert rig.request('schedule_program', program=PROGRAM).success
    running = Rig()
    running.run(path_of(SMALL), until=lambda: len(running.records()) == 1)
    answer = running.bench.request('schedule_program', program=1000 * '(nothing)\n' + PROGRAM)
    assert 'expected up to 300 lines while a path is being run' in answer.message


def test_recorded_run_is_replayed_byte_for_byte(tmp_path):
    """With a request, changes of parameters, a feed hold and a deactivation on the way."""
    need_bag_libraries()
    from fuzzycnc_ros.replay.replay import replay
    from fuzzycnc_ros.studies.published_bag import PublishedBag

    rig = Rig()
    rig.run(path_of(SMALL, 'first'))
    rig.steps(5)
    rig.request('schedule_program', program=PROGRAM, path_id='part', run=True)
    rig.run(until=lambda: len(rig.records()) == 12)
    rig.reconfigure(replace(CONFIG, feed_override=0.0))
    rig.steps(20)
    rig.reconfigure(replace(CONFIG, feed_override=1.2, tolerance=2e-5))
    rig.steps(10)
    rig.request('deactivate')
    rig.steps(40)
    assert not rig.refusals
    with PublishedBag(tmp_path / 'bag') as bag:
        for topic, record in rig.log:
            bag(topic, record)
    report = replay(tmp_path / 'bag', nodes=['feedrate_scheduler'])
    assert report.identical, [item for item in report.topics if not item.equal]
    assert {item.topic for item in report.topics} == {'/mill/trajectory', '/mill/feed_schedule'}
    assert not report.notes


def test_request_that_is_unknown():
    assert 'knows no request fly' in Rig().bench.request('fly').message


def test_configuration_of_another_kind():
    from fuzzycnc_ros.core.config import Config

    with pytest.raises(TypeError, match='expected FeedrateSchedulerConfig but found Config'):
        Rig().component.reconfigure(Config())


def test_status_of_a_newer_machine_is_told_as_a_number():
    rig = Rig()
    rig.run(path_of(SMALL), until=lambda: bool(rig.records()) and rig.records()[-1].last)
    rig.push('trajectory_state', replace(rig.trajectory_state(), stamp=rig.time + 1, status=77))
    rig.bench.until(rig.time / SECOND + 20.0)
    assert 'did not say that it has finished: status 77' in rig.bench.health()
