# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Joint trajectories: followed within the limits, stopped on the way, refused with their code."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from bag_libraries import need_bag_libraries
from benches.joint_rig import CONFIG, JointRig

from fuzzycnc_ros.components.motion.joint_goal import goal_arguments
from fuzzycnc_ros.components.motion.joint_trajectory_config import JointTrajectoryBridgeConfig
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import SECOND, nanoseconds

TIME = (0.5, 1.0, 1.5)
POINTS = ((0.01, 0.0, 0.0), (0.02, 0.01, 0.0), (0.02, 0.0, -0.01))


def check_motion(rig):
    """Nothing was refused, and the limits were kept from rest to rest."""
    assert not rig.refusals
    position, velocity = rig.motion()
    assert np.abs(velocity).max() <= 1.01 * CONFIG.velocity_max
    rise = np.diff(np.vstack([np.zeros(3), velocity, np.zeros(3)]), axis=0) / CONFIG.period
    assert np.abs(rise).max() <= 1.01 * CONFIG.acceleration_max
    return position


def test_goal_is_followed_through_its_points_and_succeeds():
    rig = JointRig(place=(0.001, 0.0, 0.0))
    assert rig.follow('a', TIME, POINTS).success
    assert rig.outcome('a') == ('SUCCESSFUL', 'arrived', False)
    position = check_motion(rig)
    start = rig.parts()[0].start
    for time, point in zip(TIME, POINTS, strict=True):
        at = next(p for stamp, p, _ in rig.samples if stamp >= start + nanoseconds(time))
        np.testing.assert_allclose(at, point, rtol=0.0, atol=1e-9)
    assert position[:, 0].max() <= 0.02 + 1e-12, 'no axis passes beyond its points'


def test_parts_follow_each_other_ahead_of_time_each_with_a_way_to_rest():
    rig = JointRig()
    rig.follow('a', TIME, POINTS)
    rig.outcome('a')
    parts, period = rig.parts(), nanoseconds(CONFIG.period)
    assert [part.part for part in parts] == list(range(len(parts)))
    assert [part.last for part in parts] == [False] * (len(parts) - 1) + [True]
    assert {part.frame_id for part in parts} == {'mill/workpiece'}
    for before, after in pairwise(parts):
        assert after.start == before.start + before.committed * period
        assert after.stamp <= after.start - nanoseconds(CONFIG.lead)
        assert len(before.arc_length) > before.committed
        np.testing.assert_array_equal(before.velocity[-3:], 0.0)


def test_velocities_and_accelerations_of_the_points_are_kept():
    rig = JointRig()
    speed, bend = [[0.03], [0.0]], [[0.05], [0.0]]
    rig.follow('a', (0.5, 1.0), [[0.01], [0.02]], ['X'], velocity=speed, acceleration=bend)
    assert rig.outcome('a')[0] == 'SUCCESSFUL'
    check_motion(rig)
    start = rig.parts()[0].start
    stamp, place, velocity = next(
        item for item in rig.samples if item[0] >= start + nanoseconds(0.5)
    )
    assert place[0] == pytest.approx(0.01, abs=1e-9)
    assert velocity[0] == pytest.approx(0.03, abs=1e-9)
    assert not place[1:].any()
    assert stamp == start + nanoseconds(0.5)


def test_point_at_time_0_is_where_the_axes_stand():
    rig = JointRig(place=(0.01, 0.0, 0.0), joints=('a', 'b', 'c'))
    assert rig.follow('near', (0.0, 0.5), [[0.01 + 5e-5], [0.02]], ['a']).success
    assert rig.outcome('near')[0] == 'SUCCESSFUL'
    assert not rig.refusals
    rig.follow('far', (0.0, 0.5), [[0.01], [0.02]], ['a'])
    code, text, _ = rig.outcomes['far']
    assert code == 'INVALID_GOAL'
    assert 'at 20.0000 mm, but found 10.0000 mm' in text


@pytest.mark.parametrize('when', [0.05, 0.3, 0.62, 0.99, 1.4])
def test_cancelled_goal_rests_on_its_way_within_the_limits(when):
    rig = JointRig()
    rig.follow('a', TIME, POINTS)
    rig.until(lambda: rig.time >= rig.parts()[0].start + nanoseconds(when))
    assert rig.request('cancel', goal='a').success
    assert not rig.request('cancel', goal='a').success, 'it is on its way to rest'
    code, _, cancelled = rig.outcome('a')
    assert (code, cancelled) == ('SUCCESSFUL', True)
    position = check_motion(rig)
    assert rig.machine.status is TrajectoryStatus.FINISHED
    whole = JointRig()
    whole.follow('a', TIME, POINTS)
    whole.outcome('a')
    every, _ = whole.motion()
    away = np.linalg.norm(every[:, None] - position[None, -1:], axis=2).min()
    assert away < 1e-4, 'the place of rest lies on the way'
    if when < 1.0:
        assert np.linalg.norm(position[-1] - every[-1]) > 1e-3


def test_newer_goal_takes_over_from_rest():
    rig = JointRig()
    rig.follow('a', TIME, POINTS)
    rig.until(lambda: rig.time >= rig.parts()[0].start + nanoseconds(0.6))
    assert rig.follow('b', (1.0,), [[0.0, 0.0, 0.0]]).success
    assert rig.outcome('b')[0] == 'SUCCESSFUL'
    code, text, cancelled = rig.outcomes['a']
    assert (code, cancelled) == ('INVALID_GOAL', False)
    assert text == 'replaced by the newer goal b'
    assert not check_motion(rig)[-1].any()
    assert {part.path_id for part in rig.parts()} == {'joint_trajectory_1', 'joint_trajectory_2'}


def test_newer_goal_that_is_wrong_leaves_the_other_alone():
    rig = JointRig()
    rig.follow('a', TIME, POINTS)
    rig.steps(40)
    assert not rig.follow('b', (0.01,), [[0.2, 0.0, 0.0]]).success
    assert rig.outcomes['b'][0] == 'INVALID_GOAL'
    assert rig.outcome('a')[0] == 'SUCCESSFUL'


def test_goal_of_the_future_waits_and_may_be_replaced_or_cancelled():
    rig = JointRig()
    start = rig.time + nanoseconds(3.0)
    rig.follow('a', (0.5,), [[0.01, 0.0, 0.0]], start=start)
    rig.steps(50)
    assert not rig.parts()
    rig.follow('b', (0.5,), [[0.01, 0.0, 0.0]], start=start)
    assert rig.outcomes['a'][0] == 'INVALID_GOAL'
    assert rig.outcome('b')[0] == 'SUCCESSFUL'
    assert rig.parts()[0].start == start
    rig.follow('c', (0.5,), [[0.0, 0.0, 0.0]], start=rig.time + SECOND)
    rig.request('cancel', goal='c')
    assert rig.outcomes['c'] == ('SUCCESSFUL', 'cancelled before it started', True)


GIVEN = {'time': (0.5,), 'position': [[0.01]], 'joints': ['X']}
REFUSED = [
    ({'joints': []}, 'INVALID_JOINTS', 'among X, Y, Z but found none'),
    ({'joints': ['Q']}, 'INVALID_JOINTS', 'among X, Y, Z but found Q'),
    ({'joints': ['X', 'X']}, 'INVALID_JOINTS', 'found one twice: X, X'),
    ({'path_tolerance': [['Y', 0.1, 0, 0]]}, 'INVALID_JOINTS', 'joints of the trajectory, X, but'),
    ({'start': 1}, 'OLD_HEADER_TIMESTAMP', 'at most 0.5 s ago (parameter age_max) but found 1.0'),
    ({'time': (), 'position': []}, 'INVALID_GOAL', 'points: expected at least one'),
    ({'time': (0.5, 0.5)}, 'INVALID_GOAL', 'point 1: expected more than 0.5 s but found 0.5 s'),
    ({'time': (-0.5,)}, 'INVALID_GOAL', 'point 0: expected 0 s or later but found -0.5 s'),
    ({'time': (0.0,)}, 'INVALID_GOAL', 'last point: expected more than 0 s'),
    ({'time': (601.0,)}, 'INVALID_GOAL', 'at most 600 s (parameter duration_max)'),
    ({'position': [[]]}, 'INVALID_GOAL', 'positions: expected those of all points'),
    ({'position': [[0.1, 0.2]]}, 'INVALID_GOAL', 'for each of X but found 2'),
    ({'position': [[float('nan')]]}, 'INVALID_GOAL', 'a finite number (SI units) for X but'),
    ({'velocity': [[0.1]]}, 'INVALID_GOAL', 'X at rest at the last point but found 100 mm/s'),
    ({'acceleration': [[0.1]]}, 'INVALID_GOAL', 'velocities: expected them beside'),
    ({'effort': True}, 'INVALID_GOAL', 'effort: expected none'),
    ({'goal_time': -1}, 'INVALID_GOAL', 'goal_time_tolerance: expected 0 or more'),
    ({'goal_tolerance': [['X', -2.0, 0, 0]]}, 'INVALID_GOAL', '0 for the default or -1 for none'),
    ({'path_tolerance': [['X', 0, 0, 1.0]]}, 'INVALID_GOAL', 'which is not measured'),
    ({'position': [[0.5]]}, 'INVALID_GOAL', 'velocity of X: expected at most 250 mm/s but found'),
    ({'time': (0.02,)}, 'INVALID_GOAL', 'give the trajectory more time, or more points'),
    (
        {'time': (0.0, 0.5), 'position': [[0.0], [0.01]], 'velocity': [[0.1], [0.0]]},
        'INVALID_GOAL',
        'X at rest but found 100 mm/s',
    ),
]


@pytest.mark.parametrize(('wrong', 'code', 'text'), REFUSED)
def test_goal_that_cannot_be_followed_is_refused_by_its_code(wrong, code, text):
    rig = JointRig()
    assert not rig.follow('a', **(GIVEN | wrong)).success
    assert rig.outcomes['a'][0] == code
    assert text in rig.outcomes['a'][1]
    rig.steps(30)
    assert not rig.parts()


def test_nothing_here_raises_a_limit_of_the_machine():
    rig = JointRig(velocity_max=1.0, acceleration_max=50.0)
    assert rig.follow('a', (0.5,), [[0.3, 0.0, 0.0]]).success
    code, text, _ = rig.outcome('a')
    assert code == 'INVALID_GOAL'
    assert text.startswith('given up: refused by the machine: velocity of X: expected at most 250')
    assert not rig.samples


def test_axis_off_the_way_ends_the_goal_at_rest():
    rig = JointRig()
    rig.follow('a', TIME, POINTS, path_tolerance=[['Y', 1e-3, 0.0, 0.0]])
    rig.until(lambda: rig.time >= rig.parts()[0].start + nanoseconds(0.5))
    rig.shift[0] = 0.01
    rig.steps(10)
    assert not rig.outcomes, 'only Y is watched'
    rig.shift[1] = 1.1e-3
    code, text, _ = rig.outcome('a')
    assert code == 'PATH_TOLERANCE_VIOLATED'
    assert text == 'position of Y: expected within 1 mm of the trajectory but found it 1.1 mm off'
    check_motion(rig)
    assert rig.machine.next_time is None


def test_erased_tolerance_is_none_and_a_velocity_has_one_too():
    rig = JointRig(path_tolerance=1e-3)
    rig.follow('a', TIME, POINTS, path_tolerance=[['X', -1.0, 0.0, 0.0], ['Y', 0.0, 0.1, 0.0]])
    rig.until(lambda: rig.time >= rig.parts()[0].start + nanoseconds(0.5))
    rig.shift[0] = 0.01
    rig.steps(10)
    assert not rig.outcomes
    rig.speed[1] = 0.2
    assert rig.outcome('a')[1].startswith('velocity of Y: expected within 100 mm/s')


def test_axes_that_do_not_arrive_in_time_miss_the_goal():
    rig = JointRig()
    rig.shift[2] = 3e-4
    rig.follow('a', (0.5,), [[0.01, 0.0, 0.0]], goal_time=nanoseconds(0.3))
    code, text, _ = rig.outcome('a')
    assert code == 'GOAL_TOLERANCE_VIOLATED'
    assert text == (
        'position of Z: expected within 0.1 mm of the trajectory but found it 0.3 mm off '
        '0.3 s after its end'
    )
    rig.follow('b', (0.5,), [[0.0, 0.0, 0.0]])
    rig.until(lambda: rig.machine.status is TrajectoryStatus.FINISHED)
    rig.steps(20)
    assert 'b' not in rig.outcomes
    rig.shift[2] = 0.0
    assert rig.outcome('b')[0] == 'SUCCESSFUL', 'late, but in time'


def test_another_commander_keeps_the_axes():
    rig = JointRig()
    other = JointRig()
    other.follow('a', TIME, POINTS)
    part = other.parts()[0]
    rig.machine.command(
        SimpleNamespace(**vars(part) | {'path_id': 'part', 'start': rig.time + SECOND})
    )
    rig.step()
    assert not rig.follow('a', (0.5,), [[0.0, 0.0, 0.0]]).success
    assert rig.outcomes['a'][1] == ('another commander has the axes: the machine follows part')
    moved = JointRig()
    moved.steps(200)
    moved.speed[0] = 0.01
    moved.step()
    assert not moved.follow('a', (0.5,), [[0.0, 0.0, 0.0]]).success
    assert moved.outcomes['a'][1] == 'the axes move: another commander has them'


def test_newer_owner_ends_the_goal():
    rig = JointRig()
    rig.follow('a', TIME, POINTS)
    rig.steps(5)
    rig.deaf = True
    rig.machine = type(rig.machine)(('X', 'Y', 'Z'), (0.0, 0.0, 0.0))
    part = rig.parts()[0]
    rig.machine.advance(rig.time)
    rig.machine.command(SimpleNamespace(**vars(part) | {'epoch': 9, 'start': rig.time + SECOND}))
    assert rig.outcome('a')[1] == 'given up: another owner, epoch 9, moves the machine'


@pytest.mark.parametrize(
    ('mode', 'homed', 'text'),
    [
        (MachineMode.ESTOP, True, 'the machine is not on but estop'),
        (MachineMode.RUNNING, False, 'the machine is not homed'),
    ],
)
def test_machine_that_must_not_move_refuses_and_ends_goals(mode, homed, text):
    rig = JointRig()
    rig.follow('a', TIME, POINTS)
    rig.steps(40)
    rig.mode, rig.homed = mode, homed
    assert rig.outcome('a') == ('INVALID_GOAL', f'given up: {text}', False)
    sent = len(rig.parts())
    assert not rig.follow('b', TIME, POINTS).success
    assert rig.outcomes['b'][1] == text
    rig.steps(100)
    assert len(rig.parts()) == sent


def test_part_that_is_lost_starves_the_machine_at_rest_on_the_way():
    rig = JointRig()
    rig.follow('a', TIME, POINTS)
    rig.steps(50)
    rig.deaf = True
    code, text, _ = rig.outcome('a')
    assert code == 'INVALID_GOAL'
    assert text == 'given up: starved by the machine: no part in time'
    rig.deaf = False
    rig.steps(5)
    assert not rig.follow('early', (0.5,), [[0.0, 0.0, 0.0]]).success
    rig.until(lambda: rig.machine.next_time is None)
    rig.steps(50)
    check_motion(rig)
    assert rig.follow('b', (0.5,), [[0.0, 0.0, 0.0]]).success
    assert rig.outcome('b')[0] == 'SUCCESSFUL'


def test_machine_that_says_nothing_ends_the_goal():
    rig = JointRig()
    rig.follow('a', (0.5,), [[0.01, 0.0, 0.0]])
    rig.silent = True
    assert rig.outcome('a')[1] == 'given up: the machine did not say that it has finished'


def test_deactivation_brings_the_axes_to_rest():
    rig = JointRig()
    assert rig.request('activate').message == 'already active'
    rig.follow('a', TIME, POINTS)
    rig.until(lambda: rig.time >= rig.parts()[0].start + nanoseconds(0.3))
    assert rig.request('deactivate').success
    assert rig.outcomes['a'][:2] == ('INVALID_GOAL', 'the node was deactivated')
    rig.until(lambda: rig.machine.status is TrajectoryStatus.FINISHED)
    check_motion(rig)
    assert not rig.follow('b', TIME, POINTS).success
    assert rig.outcomes['b'][1] == 'expected an active node but it is inactive'
    assert not rig.request('deactivate').success


def test_new_bridge_takes_over_with_a_higher_epoch():
    rig = JointRig()
    rig.follow('a', (0.5,), [[0.01, 0.0, 0.0]])
    rig.outcome('a')
    assert {part.epoch for part in rig.parts()} == {1}
    rig.request('deactivate')
    rig.request('activate')
    rig.follow('b', (0.5,), [[0.0, 0.0, 0.0]])
    rig.outcome('b')
    assert {part.epoch for part in rig.parts()} == {1, 2}
    assert not rig.refusals


def test_clock_that_is_set_ends_the_goal():
    rig = JointRig()
    rig.follow('a', TIME, POINTS)
    rig.steps(40)
    rig.bench.clock_step(3600.0, rig.time / SECOND + 3600.0)
    rig.step()
    assert rig.outcomes['a'] == ('INVALID_GOAL', 'given up: the clock was set', False)


def test_joint_states_are_told_while_axes_move_and_again_while_they_rest():
    rig = JointRig(place=(0.0, 0.0, 0.002), joints=('mill_x', 'mill_y', 'mill_z'))
    rig.steps(100)
    told = rig.bench.records('joint_states')
    assert 48 <= len(told) <= 52
    assert told[-1].name == ('mill_x', 'mill_y', 'mill_z')
    assert told[-1].position.tolist() == [0.0, 0.0, 0.002]
    assert rig.component.tool(told[-1]).tolist() == [0.0, 0.0, 0.002]
    # Nothing new comes: what was told holds as long as the state may be old.
    rig.bench.until(rig.time / SECOND + 10.0)
    again = rig.bench.records('joint_states')[len(told) :]
    assert 9 <= len(again) <= 11
    assert again[-1].stamp > rig.time + 9 * SECOND
    rig.bench.until(rig.time / SECOND + 300.0)
    assert rig.bench.records('joint_states')[-1].stamp <= rig.time + 62 * SECOND


def test_progress_tells_what_is_wanted_and_what_is():
    rig = JointRig()
    assert rig.component.progress is None
    rig.follow('a', TIME, POINTS)
    rig.shift[0] = 1e-5
    rig.until(lambda: rig.time >= rig.parts()[0].start + nanoseconds(0.7))
    found = rig.component.progress
    assert (found.goal, found.joints, found.point) == ('a', ('X', 'Y', 'Z'), 1)
    np.testing.assert_allclose(found.actual[0] - found.desired[0], [1e-5, 0, 0], atol=1e-9)
    np.testing.assert_allclose(found.actual[1], found.desired[1], atol=1e-9)


def test_recorded_goals_are_replayed_byte_for_byte(tmp_path):
    need_bag_libraries()
    from fuzzycnc_ros.replay.replay import replay
    from fuzzycnc_ros.studies.published_bag import PublishedBag

    rig = JointRig()
    rig.follow('a', TIME, POINTS)
    rig.steps(50)
    rig.follow('b', (0.5,), [[0.0, 0.0, 0.0]])
    rig.outcome('b')
    rig.follow('c', (1.0,), [[0.02, 0.0, 0.0]])
    rig.steps(60)
    rig.request('cancel', goal='c')
    rig.outcome('c')
    with PublishedBag(tmp_path / 'bag') as bag:
        for topic, record in rig.log:
            bag(topic, record)
    report = replay(tmp_path / 'bag', nodes=['joint_trajectory_bridge'])
    assert report.identical, [item for item in report.topics if not item.equal]
    assert {item.topic for item in report.topics} == {'/mill/trajectory', '/mill/joint_states'}


def test_axis_that_nobody_measures_is_off_the_way_and_not_told():
    rig = JointRig()
    rig.follow('a', TIME, POINTS, path_tolerance=[['X', 1e-3, 0.0, 0.0]])
    rig.until(lambda: rig.time >= rig.parts()[0].start + nanoseconds(0.3))
    rig.shift[0] = np.nan
    assert rig.outcome('a')[0] == 'PATH_TOLERANCE_VIOLATED'
    assert rig.bench.records('joint_states')[-1].name == ('Y', 'Z')


def test_messages_mean_what_they_say():
    point = SimpleNamespace(
        positions=[0.1],
        velocities=[0.0],
        accelerations=[],
        effort=[],
        time_from_start=SimpleNamespace(sec=1, nanosec=5),
    )
    header = SimpleNamespace(stamp=SimpleNamespace(sec=2, nanosec=0))
    trajectory = SimpleNamespace(header=header, joint_names=['X'], points=[point])
    tolerance = SimpleNamespace(name='X', position=0.1, velocity=0.2, acceleration=0.0)
    late = SimpleNamespace(sec=0, nanosec=7)
    found = goal_arguments('a', trajectory, [tolerance], goal_time=late)
    assert (found['start'], found['time'], found['goal_time']) == (2 * SECOND, [SECOND + 5], 7)
    assert found['position'] == [[0.1]]
    assert found['acceleration'] == [[]]
    assert found['path_tolerance'] == [['X', 0.1, 0.2, 0.0]]
    assert not found['effort']
    assert goal_arguments('a', trajectory)['goal_time'] == 0


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [
        ({'axes': ()}, 'axes: expected names'),
        ({'axes': ('X', 'X')}, 'axes: expected names, each once'),
        ({'joints': ('a',)}, 'joints: expected one name for each of X, Y, Z'),
        ({'workpiece_offset': (0.0,)}, 'workpiece_offset: expected X, Y and Z'),
        ({'chunk': 0.0105}, 'chunk = 0.0105 s must be a whole number of periods'),
    ],
)
def test_parameters_that_do_not_fit_are_refused(wrong, text):
    with pytest.raises(ValueError, match=text.replace('.', r'\.')):
        JointTrajectoryBridgeConfig(**wrong)
