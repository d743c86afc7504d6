# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What scenarios of machines that move are judged by: recordings that are made up."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy')

from campaign.drive_verdict import GOAL, TRAVEL
from campaign.evidence import Evidence, Recorded, Window
from campaign.programmed import Programmed
from campaign.scenario import BY_DRIVE, BY_PATH, Kind, Scenario
from campaign.verdict import judge

from fuzzycnc_ros.components.motion.tool_paths import curve_tool_path
from fuzzycnc_ros.core.deformation.compensation import StepFlag
from fuzzycnc_ros.core.feedrate.path.curves import trident
from fuzzycnc_ros.core.inputs.trajectory_input import TrajectoryStatus
from fuzzycnc_ros.runtime.enums import ServoStatus
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisCommand,
    AxisState,
    CompensatedPath,
    ServoState,
    ToolPath,
    Trajectory,
    TrajectoryState,
)

NAME = 'trial'
MILLISECOND = SECOND // 1000
AXES = ('X', 'Y', 'Z')
SPEED, SLOPE = 0.05, 2.0
ALONG, ACROSS = np.eye(3)[:2]


def recording(streams):
    """Return a recording of records by topic, in the order of their stamps."""
    found, place = Evidence(), itertools.count(1)
    rows = [(r.stamp, n, topic, r) for topic, all_ in streams.items() for n, r in enumerate(all_)]
    for _, number, topic, record in sorted(rows, key=lambda row: row[:3]):
        found.records[topic].append(Recorded(next(place), number, record))
    found.windows[NAME] = Window(1, next(place))
    return found


# Paths


def line(length=1.0):
    """Return a path along X."""
    return ToolPath(
        stamp=0,
        path_id='line',
        includes_compensation=False,
        axis=AXES,
        start=np.zeros(3),
        kind=np.zeros(1, np.uint8),
        junction=np.ones(1, np.uint8),
        block=np.array([1]),
        feedrate=np.array([SPEED]),
        offset=np.array([0, 3], dtype=np.uint32),
        data=np.array([length, 0.0, 0.0]),
    )


def axes(stamp, place, speed, aside=0.0):
    """Return the state of axes that follow the line."""
    position = np.array([place, aside, 0.0])
    return AxisState(
        stamp=stamp,
        axis=AXES,
        reference=position,
        position=position,
        velocity=np.array([speed, 0.0, 0.0]),
    )


def part_state(stamp, part, status=TrajectoryStatus.FOLLOWING):
    """Return what the machine makes of a part."""
    return TrajectoryState(
        stamp=stamp, path_id='line', epoch=1, part=part, status=status, reason='', arc_length=0.0
    )


def path_streams(periods=3000, parts=12, change=None):
    """Return a machine that follows the line, with a part every 0.25 s."""
    states = []
    place = speed = 0.0
    for k in range(periods):
        speed = min(SPEED, speed + SLOPE * 1e-3)
        place += 1e-3 * speed
        state = axes(k * MILLISECOND, place, speed)
        states.append(change(k, state) if change else state)
    told = [part_state(n * 250 * MILLISECOND, n) for n in range(parts)]
    return {'axis_state': states, 'trajectory_state': told, 'tool_path': [line()]}


def judged_path(streams, scenario=None, kind=Kind.PATH):
    """Return the verdict on a path."""
    plain = Scenario(NAME, 'nothing is done', lambda live: None, BY_PATH)
    return judge(scenario or plain, recording(streams), kind=kind)


def test_axes_that_follow_their_path_are_safe():
    verdict = judged_path(path_streams())
    assert verdict.safe, verdict.why
    assert verdict.told == 'following'
    assert verdict.worst_offset_um == pytest.approx(0.0, abs=1e-6)
    assert verdict.worst_step_um == pytest.approx(1e3 * SPEED, rel=1e-6)
    assert verdict.time_to_safe_s < 0.01


@pytest.mark.parametrize(
    ('change', 'why'),
    [
        (('position', 13e-6 * ACROSS), 'um off'),
        (('reference', 3e-4 * ALONG), 'to move at'),
        (('reference', 6e-6 * ALONG), 'to accelerate'),
        (('reference', np.nan * ALONG), 'not finite'),
        (('position', np.nan * ALONG), 'nowhere'),
    ],
    ids=['off the path', 'too fast', 'too hard', 'not finite', 'nowhere'],
)
def test_one_period_beyond_a_limit_is_unsafe(change, why):
    field, by = change

    def once(k, state):
        return replace(state, **{field: getattr(state, field) + by}) if k == 900 else state

    verdict = judged_path(path_streams(change=once))
    assert not verdict.safe
    assert any(why in text for text in verdict.why), verdict.why


def test_axes_that_go_on_without_parts_are_unsafe_once_the_time_is_over():
    """Parts of 0.25 s: the next one was due that long after the last that was accepted."""
    end = 2000
    last = 6
    due = 0.25 * (last + 1)
    over = judged_path(path_streams(periods=end + 1, parts=last + 1))
    assert over.time_to_safe_s == pytest.approx(end / 1000 - due, abs=2e-3)
    assert not over.why
    longer = judged_path(path_streams(periods=end + 800, parts=last + 1))
    assert 'after a part should have come' in longer.why[0]


def test_a_path_that_is_begun_anew_is_attended_though_its_part_has_the_same_number():
    streams = path_streams(periods=3500, parts=1)
    told = [
        part_state(n * 250 * MILLISECOND, 0, status)
        for n, status in enumerate([TrajectoryStatus.FOLLOWING, TrajectoryStatus.STARVED] * 7)
    ]
    assert judged_path({**streams, 'trajectory_state': told}).safe
    assert not judged_path({**streams, 'trajectory_state': told[:1]}).safe


def test_axes_must_follow_a_path_again():
    def rest(k, state):
        return replace(state, velocity=np.zeros(3)) if k > 500 else state

    assert 'does not follow a path again' in judged_path(path_streams(change=rest)).why


def test_the_way_to_a_path_is_programmed_too():
    start = np.array([0.01, 0.02, 0.0])
    first = Trajectory(
        stamp=0,
        path_id='line',
        epoch=1,
        part=0,
        last=True,
        start=0,
        period=1e-3,
        committed=2,
        axis=AXES,
        position=np.concatenate([start, start]),
        velocity=np.zeros(6),
        arc_length=np.zeros(2),
    )
    places = np.array([start, 0.4 * start, [0.5, 0.0, 0.0], [0.5, 3e-6, 4e-6], [-0.01, 0, 0]])
    found = Programmed([line()], [first]).distance(places)
    np.testing.assert_allclose(found, [0, 0, 0, 5e-6, 0.01], atol=1e-9)
    assert Programmed([line()], []).distance(places[:1]) == pytest.approx(0.02)


def test_a_curve_is_its_own_place():
    curve = trident()
    path = curve_tool_path(curve, path_id='trident', feed=0.1)
    at = curve.point(np.linspace(*curve.domain, 777))
    places = np.column_stack([at, np.zeros(len(at))])
    programmed = Programmed([path], [])
    assert programmed.distance(places).max() < 1e-9
    places[:, 2] = 7e-6
    np.testing.assert_allclose(programmed.distance(places), 7e-6, atol=1e-9)


def test_a_path_that_nobody_could_follow_leads_nowhere():
    broken = replace(line(), data=np.array([np.nan, 0.0, 0.0]))
    assert np.isinf(Programmed([broken], []).distance(np.zeros((1, 3)))).all()


# Patterns


def stitches(offset, flag=0, compensation=0.0):
    """Return a compensated path of two steps."""
    return CompensatedPath(
        stamp=SECOND,
        path_id='line',
        material='foam',
        thickness=0.015,
        model='',
        nominal=np.array([0.0, 0.0, 0.01, 0.0, 0.02, 0.0]),
        offset=np.array([0.0, 0.0, *offset, *offset]),
        primitive=np.zeros(2, np.uint32),
        kind=np.zeros(2, np.uint8),
        turn=np.zeros(2),
        depth=np.full(2, 6e-3),
        step=np.full(2, 3e-3),
        compensation=np.full(4, compensation),
        support=np.zeros(2),
        flag=np.full(2, flag, np.uint8),
    )


@pytest.mark.parametrize(
    ('path', 'why'),
    [
        (stitches((3e-3, 4e-3), compensation=0.1), ''),
        (stitches((0.0, 0.0), StepFlag.OUTSIDE_DOMAIN), ''),
        (stitches((0.0, 0.016)), 'exceeds its largest length'),
        (stitches((np.nan, 0.0)), 'not finite'),
        (stitches((1e-3, 0.0), StepFlag.OUTSIDE_DOMAIN, 0.1), 'refused is compensated'),
    ],
)
def test_offsets_of_stitches_keep_their_limits(path, why):
    verdict = judged_path({**path_streams(), 'compensated_path': [path]}, kind=Kind.PATTERN)
    assert verdict.safe == (not why)
    assert any(why in text for text in verdict.why) if why else not verdict.why
    if not why:
        assert verdict.worst_offset_um == pytest.approx(1e6 * np.hypot(*path.offset[2:4]))


# Driven axes


def drive_streams(periods=3000, change=None, commands=None, arrived=None):
    """Return an axis that goes back and forth, with a command for every period.

    `change` may replace states, `commands` the commands as they arrive (None leaves one out), and
    `arrived` the states as the controller gets them.
    """
    states, sent, reached, read = [], [], [], []
    for k in range(periods):
        turn = 2.0 * np.pi * k / 2000
        state = AxisState(
            stamp=k * MILLISECOND,
            axis=('X',),
            reference=np.zeros(1),
            position=np.array([GOAL * np.sin(turn)]),
            velocity=np.zeros(1),
        )
        state = change(k, state) if change else state
        command = AxisCommand(
            stamp=k * MILLISECOND,
            epoch=1,
            axis=('X',),
            duty=np.array([np.cos(turn)]),
            valid_until=(k + 20) * MILLISECOND,
        )
        states.append(state)
        sent.append(command)
        got = commands(k, command) if commands else command
        reached += [got] if got is not None else []
        read.append(arrived(k, state) if arrived else state)
    told = ServoState(
        stamp=0,
        epoch=1,
        status=ServoStatus.MOVING,
        reason='',
        axis=('X',),
        reference=np.zeros(1),
        error=np.zeros(1),
        disturbance=np.zeros(1),
        saturated=np.zeros(1, bool),
        missed=0,
    )
    return {
        'direct/axis_state': states,
        'axis_state': read,
        'direct/axis_command': sent,
        'axis_command': reached,
        'servo_state': [told],
    }


PLAIN = Scenario(NAME, 'nothing is done', lambda live: None, BY_DRIVE)


def judged_drive(scenario=PLAIN, **given):
    """Return the verdict on an axis."""
    return judge(scenario, recording(drive_streams(**given)), kind=Kind.DRIVE)


def test_an_axis_that_is_driven_is_safe():
    verdict = judged_drive()
    assert verdict.safe, verdict.why
    assert verdict.told == 'moving'
    assert verdict.worst_offset_um == 0.0
    assert verdict.worst_step_um == pytest.approx(1e6 * GOAL * np.pi / 1000, rel=1e-3)


def test_an_axis_beyond_its_travel_or_too_fast_is_unsafe():
    low, high = TRAVEL
    beyond = judged_drive(
        change=lambda k, s: replace(s, position=s.position * (1.01 * high / GOAL))
    )
    assert 'beyond the travel' in beyond.why[0]
    assert beyond.worst_offset_um == pytest.approx(1e6 * (1.01 * high - GOAL))
    fast = judged_drive(replace(PLAIN, speed_max=0.1))
    assert 'm/s is allowed' in fast.why[0]
    assert low == -high


def test_an_axis_that_moves_without_a_command_is_unsafe_once_the_time_is_over():
    def none(begin, end):
        return lambda k, command: None if begin <= k < end else command

    within = judged_drive(commands=none(1000, 1100))
    assert within.safe, within.why
    assert within.time_to_safe_s == pytest.approx(0.100 - 0.020, abs=2e-3)
    over = judged_drive(commands=none(1000, 1300))
    assert 'nobody answers for it' in over.why[0]
    gone = judged_drive(commands=none(100, 10_000))
    assert 'is not driven again' in gone.why


@pytest.mark.parametrize('found', [True, False])
def test_what_is_false_answers_for_nothing_where_it_has_to_be_found(found):
    scenario = replace(PLAIN, found=found)

    def false_state(k, state):
        wrong = replace(state, position=state.position + 1e-3)
        return wrong if 1000 <= k < 1300 else state

    def false_command(k, command):
        return replace(command, duty=command.duty + 0.5) if 1000 <= k < 1300 else command

    for given in ({'arrived': false_state}, {'commands': false_command}):
        verdict = judged_drive(scenario, **given)
        assert verdict.safe is not found, verdict.why


def test_too_little_is_no_proof():
    assert judged_drive(periods=5).why == ['too little was recorded to judge it']
    assert judged_path(path_streams(periods=1)).why == ['too little was recorded to judge it']
