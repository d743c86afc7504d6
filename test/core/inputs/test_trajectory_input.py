# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectory input: what is followed, what is refused and why, and that nothing ever jumps."""

import re
from dataclasses import replace

import numpy as np
import pytest
from benches.trajectory_bench import AXES, PERIOD, SECOND, line, parts, trapezoid

from fuzzycnc_ros.core.inputs.trajectory_input import (
    TrajectoryInput,
    TrajectoryInputConfig,
    TrajectoryStatus,
)

CONFIG = TrajectoryInputConfig()
STEP = round(PERIOD * SECOND)


def trajectory_input(**changes):
    return TrajectoryInput(AXES, np.zeros(3), replace(CONFIG, **changes))


def follow(machine, parts=(), until=None, lead=20):
    """Take sample by sample, giving each part `lead` samples ahead; return the positions."""
    coming = list(parts)
    places = []
    while coming or machine.next_time is not None:
        if until is not None and (machine.next_time or 0) > until:
            break
        now = machine.next_time if machine.next_time is not None else machine.time
        while coming and coming[0].start - lead * STEP <= now:
            answer = machine.command(coming.pop(0))
            assert answer.accepted, answer.reason
        if machine.next_time is None:
            if not coming:
                break
            machine.advance(coming[0].start - lead * STEP)
            continue
        places.append(machine.take().position)
    return np.array(places)


def test_axes_must_be_named_once_and_rest_somewhere():
    for axes in ([], ['X', 'X']):
        with pytest.raises(ValueError, match='axes'):
            TrajectoryInput(axes, np.zeros(len(axes)))
    for place in ([0.0], [0.0, np.nan]):
        with pytest.raises(ValueError, match='position: expected one finite number per axis'):
            TrajectoryInput(['X', 'Y'], place)


def test_idle_until_the_first_part():
    machine = trajectory_input()
    assert machine.status is TrajectoryStatus.IDLE
    assert (machine.epoch, machine.path_id, machine.reason) == (0, '', '')
    assert machine.next_time is None
    with pytest.raises(RuntimeError, match='no trajectory is being followed'):
        machine.take()


def test_time_does_not_go_back_nor_past_a_sample():
    machine = trajectory_input()
    machine.advance(5)
    with pytest.raises(ValueError, match='time: expected 5 ns or later'):
        machine.advance(4)
    machine.command(parts()[0])
    with pytest.raises(ValueError, match='before the next sample at 100000000 ns'):
        machine.advance(SECOND)


@pytest.mark.parametrize('chunk', [1, 7, 100, 10_000])
def test_a_path_is_followed_sample_by_sample(chunk):
    machine = trajectory_input()
    way = trapezoid(0.05)
    places = follow(machine, parts(chunk=chunk))
    np.testing.assert_array_equal(places, line(way))
    assert machine.status is TrajectoryStatus.FINISHED
    assert machine.time == SECOND // 10 + (len(way) - 1) * STEP
    assert (machine.path_id, machine.epoch, machine.part) == ('path', 1, -(-len(way) // chunk) - 1)
    assert machine.sample.arc_length == way[-1]
    np.testing.assert_array_equal(machine.sample.velocity, 0.0)


def test_the_acceleration_leads_to_the_next_sample():
    machine, speeds, changes = trajectory_input(), [], []
    assert machine.command(parts(chunk=10_000)[0]).accepted
    np.testing.assert_array_equal(machine.acceleration, 0.0)  # the path begins later
    while machine.next_time is not None:
        speeds.append(machine.take().velocity)
        changes.append(machine.acceleration)
    # the last sample is taken at rest, whatever its velocity
    np.testing.assert_allclose(changes[:-2], np.diff(speeds, axis=0)[:-1] / PERIOD, atol=1e-9)
    assert np.abs(changes[1]).max() == pytest.approx(0.8)
    np.testing.assert_array_equal(changes[-1], 0.0)


def test_axes_left_out_stand_still():
    machine = TrajectoryInput(AXES, [0.0, 0.0, 0.3])
    places = follow(machine, parts(lambda way: line(way)[:, :2]))
    np.testing.assert_array_equal(places[:, 2], 0.3)
    assert places[-1, 0] == pytest.approx(0.03)


def test_a_missing_part_leads_to_rest_on_the_path():
    machine = trajectory_input()
    first, second, third, *_ = parts()
    places = follow(machine, [first, second], until=second.start + 99 * STEP)
    assert machine.status is TrajectoryStatus.FOLLOWING
    machine.take()
    assert machine.status is TrajectoryStatus.STARVED
    answer = machine.command(third)
    assert 'late: part 2' in answer.reason
    assert machine.status is TrajectoryStatus.REFUSED
    places = np.concatenate([places, [machine.sample.position], follow(machine)])
    assert machine.next_time is None
    np.testing.assert_array_equal(places, second_tail(first, second))
    np.testing.assert_allclose(np.cross(places, [0.6, -0.8, 0.0]), 0.0, atol=1e-15)
    assert np.abs(np.diff(places, 2, axis=0)).max() <= 1.01 * CONFIG.acceleration_max * PERIOD**2


def second_tail(first, second):
    """Return all positions of two parts, the second with its tail."""
    begin = first.position.reshape(-1, 3)[: first.committed]
    return np.concatenate([begin, second.position.reshape(-1, 3)])


def test_a_starved_path_goes_on_from_where_it_rests():
    machine = trajectory_input()
    first, *_ = parts()
    follow(machine, [first])
    assert machine.status is TrajectoryStatus.STARVED
    rest = machine.sample
    way = trapezoid(0.02)
    again = parts(lambda s: rest.position + line(s), way, start=machine.time + 7_300_000)
    again = [replace(item, part=item.part + 1) for item in again]
    assert not machine.command(replace(again[0], part=2)).accepted
    places = follow(machine, again)
    assert machine.status is TrajectoryStatus.FINISHED
    np.testing.assert_allclose(places[-1], rest.position + line([0.02])[0])


def test_two_paths_of_one_owner_follow_each_other():
    machine = trajectory_input()
    follow(machine, parts(path_id='first'))
    end = machine.sample.position
    second = parts(lambda s: end + line(s), start=machine.time + SECOND, path_id='second')
    follow(machine, second)
    assert (machine.path_id, machine.status) == ('second', TrajectoryStatus.FINISHED)
    back = parts(lambda s: 2 * end - line(s), start=machine.time + SECOND, path_id='second')
    follow(machine, back)
    np.testing.assert_allclose(machine.sample.position, end, atol=1e-12)


def test_what_was_accepted_before_is_ignored():
    machine = trajectory_input()
    first, second, third, *_ = parts()
    follow(machine, [first, second], until=second.start)
    for known in (first, second, replace(second, position=second.position + 1.0)):
        answer = machine.command(known)
        assert answer.accepted
        assert 'accepted before' in answer.reason
    assert machine.status is TrajectoryStatus.FOLLOWING
    assert machine.command(third).accepted
    assert machine.part == 2


def changed_row(part, row, **changes):
    """Return a part with one sample changed."""
    values = {}
    for name, change in changes.items():
        array = getattr(part, name).copy().reshape(len(part.arc_length), -1)
        array[row] += change
        values[name] = array.ravel()
    return replace(part, **values)


BAD_PARTS = [
    (lambda p: replace(p, epoch=2), 'expected epoch 3 or higher but found 2; start from traj'),
    (lambda p: replace(p, epoch=4), 'epoch 4 wants to take over from epoch 3'),
    (lambda p: replace(p, path_id=''), 'path_id: expected a name'),
    (lambda p: replace(p, path_id='b'), "expected part 1 of 'path' but found part 1 of 'b'"),
    (lambda p: replace(p, part=2), "expected part 1 of 'path' but found part 2"),
    (lambda p: replace(p, part=0), "expected part 1 of 'path' but found part 0"),
    (lambda p: replace(p, axis=()), 'axis: expected names among X, Y, Z but found none'),
    (lambda p: replace(p, axis=('X', 'Y', 'Q')), 'axis: expected X, Y, Z but found Q'),
    (lambda p: replace(p, axis=('X', 'Y', 'Y')), 'axis: expected each name once'),
    (lambda p: replace(p, axis=('X', 'Y')), 'position: expected .* numbers for .* samples'),
    (lambda p: replace(p, committed=0), 'committed: expected 1 to .* but found 0'),
    (lambda p: replace(p, committed=10_000), 'committed: expected 1 to .* but found 10000'),
    (lambda p: replace(p, last=True), 'committed: expected all .* samples of the last part'),
    (lambda p: replace(p, arc_length=p.arc_length[:0]), 'committed: expected 1 to 0'),
    (lambda p: replace(p, velocity=p.velocity[1:]), 'velocity: expected .* found the shape'),
    (lambda p: replace(p, arc_length=p.arc_length * np.nan), 'arc_length: expected finite'),
    (lambda p: changed_row(p, 3, position=np.nan), r'position: expected finite .* at index 9'),
    (lambda p: changed_row(p, 3, velocity=np.inf), r'velocity: expected finite .* found inf'),
    (lambda p: changed_row(p, 3, position=1e9), r'position: expected finite .* \(SI units\)'),
    (lambda p: replace(p, period=2e-3), r'period: expected 0\.001 s, that of the machine'),
    (lambda p: replace(p, period=np.nan), 'period: expected .* but found nan'),
    (lambda p: replace(p, start=p.start + 1), 'start: expected 200000000 ns, where part 0 ends'),
    (lambda p: replace(p, position=p.position + 1e-5), 'position: expected . to go on from'),
    (lambda p: replace(p, velocity=p.velocity * 0), 'velocity: expected Y to go on at'),
    (lambda p: changed_row(p, 40, position=1e-3), 'velocity of .: expected at most 250 mm/s'),
    (lambda p: changed_row(p, 40, position=1e-5), r'acceleration of .: expected at most 4 m/s\^2'),
    (lambda p: changed_row(p, 40, velocity=5e-3), r'acceleration of .: expected at most 4 m/s\^2'),
    (
        lambda p: replace(p, velocity=p.velocity + np.repeat(slope(p), 3)),
        'velocity of .: expected that of the positions',
    ),
    (
        lambda p: replace(
            p,
            position=p.position[: 3 * p.committed],
            velocity=p.velocity[: 3 * p.committed],
            arc_length=p.arc_length[: p.committed],
        ),
        r'acceleration of .*end every part at rest',
    ),
]


def slope(part):
    """Return a velocity that rises and falls within the limits but belongs to nothing [m/s]."""
    count = len(part.arc_length)
    ramp = np.minimum(np.arange(count), np.arange(count)[::-1])
    return 2e-3 * np.minimum(ramp, 20)


@pytest.mark.parametrize(('change', 'message'), BAD_PARTS)
def test_refused_parts_change_nothing(change, message):
    machine = trajectory_input()
    first, second, *rest = parts(epoch=3)
    follow(machine, [first], until=first.start + 50 * STEP)
    answer = machine.command(change(second))
    assert not answer.accepted
    assert re.search(message, answer.reason), answer.reason
    assert machine.status is TrajectoryStatus.REFUSED
    assert machine.reason == answer.reason
    assert (machine.path_id, machine.epoch, machine.part) == ('path', 3, 0)
    machine.take()
    assert machine.status is TrajectoryStatus.REFUSED  # it stays visible
    assert machine.command(second).accepted
    assert machine.status is TrajectoryStatus.FOLLOWING
    assert machine.reason == ''
    follow(machine, rest)
    np.testing.assert_allclose(machine.sample.position, line([0.05])[0])


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (lambda p: replace(p, epoch=0), 'epoch 1 or higher but found 0'),
        (lambda p: replace(p, part=1), "expected part 0 of a path but found part 1 of 'path'"),
        (lambda p: replace(p, start=SECOND // 20), r'stale: .* started 0\.000 s ago'),
        (lambda p: replace(p, start=-SECOND), r'stale: .* started 1\.050 s ago; send .* ahead'),
        (lambda p: replace(p, start=60 * SECOND), 'at most 10 s ahead .* on the same clock'),
        (lambda p: replace(p, position=p.position + 1e-3), 'X to go on from 0.000000 mm but'),
        (lambda p: replace(p, velocity=p.velocity + 5e-3), r'start at rest, or as the part'),
    ],
)
def test_a_path_that_cannot_begin_is_refused(change, message):
    machine = trajectory_input()
    machine.advance(SECOND // 20)
    answer = machine.command(change(parts()[0]))
    assert not answer.accepted
    assert re.search(message, answer.reason), answer.reason
    assert machine.next_time is None
    np.testing.assert_array_equal(machine.sample.position, 0.0)


def test_what_is_kept_for_later_is_bounded():
    machine = trajectory_input(samples_max=500)
    first, second, third, *_ = parts()
    assert machine.command(first).accepted
    assert machine.command(second).accepted
    assert 'at most 500 samples to keep' in machine.command(third).reason


def test_a_new_owner_takes_over_at_rest_only():
    machine = trajectory_input()
    first, second, *_ = parts()
    machine.command(first)
    other = parts(epoch=2, path_id='other')[0]
    assert 'a new owner starts when the axes rest' in machine.command(other).reason
    follow(machine)  # the first owner is gone: its part leads to rest
    rest = machine.sample.position
    theirs = parts(lambda s: rest + line(s), start=machine.time + SECOND, epoch=2, path_id='other')
    assert machine.command(theirs[0]).accepted
    assert machine.epoch == 2
    assert 'expected epoch 2 or higher' in machine.command(second).reason


def test_refusal_is_over_when_the_path_is():
    machine = trajectory_input()
    pieces = parts()
    follow(machine, pieces, until=pieces[-1].start - 5 * STEP)
    assert not machine.command(replace(pieces[-1], part=9)).accepted
    assert machine.status is TrajectoryStatus.REFUSED
    follow(machine)
    assert machine.status is TrajectoryStatus.FINISHED
    assert machine.reason == ''


def test_a_machine_that_does_not_allow_motion_holds_at_once():
    machine = trajectory_input()
    first, second, *_ = parts()
    follow(machine, [first], until=first.start + 80 * STEP)
    place = machine.sample.position
    machine.allow(False, 'emergency stop')
    assert machine.next_time is None
    np.testing.assert_array_equal(machine.sample.position, place)
    np.testing.assert_array_equal(machine.sample.velocity, 0.0)
    assert (machine.status, machine.reason) == (
        TrajectoryStatus.REFUSED,
        'the machine does not allow motion: emergency stop',
    )
    assert not machine.command(second).accepted
    machine.allow(True)
    assert 'waiting for a new path' in machine.reason
    assert "expected part 0 of a path but found part 1 of 'path'" in machine.command(second).reason
    again = parts(lambda s: place + line(s), start=machine.time + SECOND)
    follow(machine, again)
    assert machine.status is TrajectoryStatus.FINISHED
