# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feedrate scheduler: motion on the path within the limits, in parts that follow each other."""

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from benches.feedrate_rig import CONFIG, PROGRAM, SMALL, Rig, check_motion, distance, path_of
from paths.reference_segments import reference_path

from fuzzycnc_ros.components.motion.feedrate_run import planner_settings
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import (
    FeedrateSchedulerConfig,
    make_scheduler,
)
from fuzzycnc_ros.components.motion.tool_paths import program_tool_path, tool_path_segments
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import LineSegment
from fuzzycnc_ros.core.feedrate.path.curves import butterfly
from fuzzycnc_ros.core.feedrate.path.nodes import NodePlan, with_nodes
from fuzzycnc_ros.core.feedrate.schedule.planner import Planner
from fuzzycnc_ros.runtime.records import (
    SECOND,
    ToolPath,
    nanoseconds,
)


@pytest.fixture(scope='module')
def flown() -> Rig:
    """The butterfly, run from elsewhere."""
    rig = Rig(place=(0.01, 0.02, 0.03))
    rig.run(path_of(butterfly(), 'butterfly'))
    return rig


def test_butterfly_is_followed_on_the_curve_within_the_limits(flown):
    curve = butterfly()
    check_motion(flown)
    _, position, _, place = flown.motion()
    on = place >= 0.0
    assert distance(curve, place[on], position[on, :2]).max() <= 1e-9
    np.testing.assert_array_equal(position[:, 2], 0.03)
    assert place[-1] == pytest.approx(curve.length, abs=1e-9)
    np.testing.assert_allclose(position[-1, :2], curve.point(1.0), rtol=0.0, atol=1e-12)
    # The way there is a straight line from where the axes were.
    start = curve.point(0.0)
    before = position[~on, :2]
    along, across = (before - [0.01, 0.02]).T, (start - [0.01, 0.02])[::-1]
    assert np.abs(along[0] * across[0] - along[1] * across[1]).max() < 1e-15
    assert len(before) > 100
    assert 'OK state: butterfly finished' in flown.bench.health()


def test_parts_follow_each_other_ahead_of_their_start_and_end_at_rest(flown):
    parts = flown.records()
    lead, period = nanoseconds(CONFIG.lead), nanoseconds(CONFIG.period)
    assert [part.part for part in parts] == list(range(len(parts)))
    assert [part.last for part in parts] == [False] * (len(parts) - 1) + [True]
    assert {part.path_id for part in parts} == {'butterfly'}
    assert {part.epoch for part in parts} == {1}
    assert {part.axis for part in parts} == {('X', 'Y')}
    assert {part.frame_id for part in parts} == {'mill/workpiece'}
    for before, after in pairwise(parts):
        assert before.committed == 250
        assert after.start == before.start + before.committed * period
        assert after.stamp == after.start - lead
        assert len(before.arc_length) > before.committed or not before.velocity[-2:].any()
        np.testing.assert_allclose(before.velocity[-2:], 0.0, atol=4.1e-3 / 2)
    assert parts[0].start == parts[0].stamp + lead
    assert parts[-1].committed == len(parts[-1].arc_length)


def test_feed_schedule_covers_the_path_with_each_part(flown):
    parts, feeds = flown.records(), flown.records('feed_schedule')
    assert [item.part for item in feeds] == [item.part for item in parts]
    assert [item.stamp for item in feeds] == [item.stamp for item in parts]
    assert [item.last for item in feeds] == [item.last for item in parts]
    for item in feeds:
        for values in (item.curvature, item.feed, item.speed, item.block):
            assert len(values) == len(item.arc_length)
        for values in (item.arc_length, item.curvature, item.feed, item.speed):
            assert np.isfinite(values).all()
        assert (item.speed <= item.feed * (1.0 + 1e-9)).all()
        assert (item.method, item.tolerance, item.feed_override) == ('log_fuzzy', 5e-5, 1.0)
    place = np.concatenate([item.arc_length for item in feeds])
    assert (np.diff(place) >= -1e-12).all()
    assert place[-1] == pytest.approx(butterfly().length, abs=1e-9)
    bend = np.concatenate([item.curvature for item in feeds])
    assert bend.max() == pytest.approx(43.25e3, rel=0.01)


def test_parts_are_the_whole_path_planned_at_once(flown):
    """Cutting into parts changes nothing."""
    (segment,) = tool_path_segments(path_of(butterfly()))
    there = LineSegment(-1, (0.01, 0.02, 0.0), segment.start, None, True, False, -1)
    planner = Planner(planner_settings(CONFIG), 3)
    path = reference_path([there, segment], exact_stop=[True, True])
    planner.push(with_nodes(path, NodePlan.of(planner.settings.scheduler)))
    planner.finish()
    whole = planner.take(1_000_000)
    assert planner.exhausted
    _, position, velocity, place = flown.motion()
    np.testing.assert_allclose(place, whole.arc_length - there.length, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(position[:, :2], whole.position[:, :2], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(velocity, whole.velocity, rtol=0.0, atol=1e-9)


def test_program_with_corners_rapids_and_a_dwell():
    rig = Rig()
    rig.run(program_tool_path(read_program(PROGRAM)))
    check_motion(rig)
    _, position, velocity, _ = rig.motion()
    at_rest = ~velocity.any(axis=1)
    for corner in ((0.01, 0.005, 0.0), (0.03, 0.005, 0.0), (0.02, 0.03, 0.0)):
        near = np.abs(position - corner).max(axis=1).argmin()
        assert np.abs(position[near] - corner).max() < 2e-6
    assert at_rest.sum() * CONFIG.period >= 0.199
    np.testing.assert_allclose(position[-1], [0.005, 0.005, 0.002], atol=1e-12)
    blocks = np.concatenate([item.block for item in rig.records('feed_schedule')])
    assert set(blocks.tolist()) == {2, 3, 4, 5, 7}
    assert (np.diff(blocks) >= 0).all()


def test_override_changes_what_has_not_been_sent():
    slow, fast = Rig(), Rig()
    path = path_of(butterfly(), 'butterfly')
    for rig in (slow, fast):
        rig.run(path, until=lambda r=rig: len(r.records()) == 6)
    slow.reconfigure(replace(CONFIG, feed_override=0.5))
    for rig in (slow, fast):
        rig.run(until=lambda r=rig: r.done)
        check_motion(rig)
    common = 6 * 250
    for one, other in zip(slow.motion()[1:], fast.motion()[1:], strict=True):
        np.testing.assert_array_equal(one[:common], other[:common])
    assert len(slow.samples) > 1.6 * len(fast.samples)
    overrides = [item.feed_override for item in slow.records('feed_schedule')]
    assert overrides == [1.0] * 6 + [0.5] * (len(overrides) - 6)


def test_feed_hold_rests_on_the_path_and_goes_on():
    rig = Rig()
    path = path_of(butterfly(), 'butterfly')
    rig.run(path, until=lambda: len(rig.records()) == 8)
    rig.reconfigure(replace(CONFIG, feed_override=0.0))
    assert 'WARN feed hold' in rig.bench.health()
    rig.steps(40)
    assert not rig.records()[-1].velocity.any()
    assert not rig.records()[-1].last
    held = rig.machine.sample.arc_length
    assert 0.0 < held < butterfly().length
    rig.steps(20)
    assert rig.machine.sample.arc_length == held
    rig.reconfigure(CONFIG)
    rig.run(until=lambda: rig.done)
    check_motion(rig)
    _, position, _, place = rig.motion()
    on = place >= 0.0
    assert distance(butterfly(), place[on], position[on, :2]).max() <= 1e-9


def test_other_live_parameters_at_run_time():
    rig = Rig()
    rig.run(path_of(butterfly(), 'butterfly'), until=lambda: len(rig.records()) == 5)
    slower = replace(
        CONFIG,
        tolerance=5e-6,
        path_velocity=0.05,
        path_acceleration=0.5,
        method='normal_acceleration',
    )
    rig.reconfigure(slower)
    rig.run(until=lambda: rig.done)
    check_motion(rig)
    feeds = rig.records('feed_schedule')
    assert [item.method for item in feeds[4:6]] == ['log_fuzzy', 'normal_acceleration']
    assert feeds[-1].tolerance == 5e-6
    late = np.linalg.norm(rig.motion()[2][9 * 250 :], axis=1)
    assert late.max() <= 0.05 * 1.001


def test_parameters_that_make_no_sense_are_refused_and_change_nothing():
    rig, other = Rig(), Rig()
    path = path_of(SMALL)
    for one in (rig, other):
        one.run(path, until=lambda r=one: len(r.records()) == 2)
    before = rig.component.configuration
    with pytest.raises(ValueError, match='method: expected one that takes a path in parts'):
        rig.component.reconfigure(replace(CONFIG, method='look_ahead'))
    with pytest.raises(ValueError, match='axis_velocity: expected one limit each'):
        rig.component.reconfigure(replace(CONFIG, axis_velocity=(0.1,)))
    assert rig.component.configuration is before
    for one in (rig, other):
        one.run(until=lambda r=one: r.done)
    np.testing.assert_array_equal(rig.motion()[1], other.motion()[1])


@pytest.mark.parametrize('method', ['fuzzy', 'constant', 'chord_error', 'normal_acceleration'])
def test_every_method_that_can_be_streamed_runs(method):
    config = replace(CONFIG, method=method, feed_max=0.1)
    rig = Rig(config)
    rig.run(path_of(SMALL))
    check_motion(rig, config)
    tolerance = rig.records('feed_schedule')[0].tolerance
    assert np.isnan(tolerance) == (method != 'normal_acceleration')


def test_tolerance_is_another_name_of_the_default():
    config = replace(CONFIG, log_fuzzy_margin=2.0)
    assert make_scheduler(replace(config, method='tolerance')) == make_scheduler(config)
    assert make_scheduler(config).margin == 2.0


def test_jerk_limits_run():
    config = replace(CONFIG, path_jerk=100.0, axis_jerk=(300.0, 300.0, 300.0))
    rig = Rig(config)
    rig.run(path_of(SMALL))
    check_motion(rig, config)
    jolt = np.diff(rig.motion()[2], 2, axis=0) / config.period**2
    assert np.abs(jolt).max() <= 1.01 * 300.0


def test_long_path_is_planned_only_as_far_as_needed():
    """200,000 short lines: the first part takes a few of them, and work does not pile up."""
    count = 200_000
    angle = np.linspace(0.0, 400.0, count + 1)
    points = 0.02 * np.column_stack([np.cos(angle), np.sin(angle)])
    path = ToolPath(
        stamp=0,
        path_id='long',
        includes_compensation=False,
        axis=('X', 'Y'),
        start=points[0],
        kind=np.zeros(count, np.uint8),
        junction=np.zeros(count, np.uint8),
        block=np.arange(count),
        feedrate=np.full(count, 0.2),
        offset=np.arange(0, 2 * count + 1, 2, dtype=np.uint32),
        data=points[1:].ravel(),
    )
    rig = Rig(replace(CONFIG, blend=1e-5), place=(0.02, 0.0, 0.0))
    rig.run(path, until=lambda: len(rig.records()) == 4)
    values = rig.component.health()[0].values
    assert float(values['planned [%]']) <= 10.0
    assert not rig.refusals


def test_work_in_other_turns_gives_the_same_parts():
    """Stamps, records and requests alone decide: not how often the component gets a turn."""
    fine, coarse = Rig(tick=0.01), Rig(tick=0.05)
    path = path_of(butterfly(), 'butterfly')
    for rig in (fine, coarse):
        while rig.time % nanoseconds(0.5) or rig.time < 2 * SECOND:
            rig.step()
        rig.run(path)
    assert len(fine.records()) == len(coarse.records())
    shift = fine.records()[0].stamp - coarse.records()[0].stamp
    for one, other in zip(fine.bench.emitted, coarse.bench.emitted, strict=True):
        assert one.output == other.output
        for item in fields(type(one.record)):
            a, b = getattr(one.record, item.name), getattr(other.record, item.name)
            if item.name in ('stamp', 'start'):
                assert a - b == shift
            else:
                np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'chunk': 0.2505}, 'chunk = 0.2505 s must be a whole number of periods'),
        ({'feed_min': 0.5}, 'feed_min: expected at most feed_max'),
        ({'tolerance': 0.0}, 'tolerance = 0.0 is outside'),
        ({'path_acceleration': 0.0}, 'path_acceleration = 0.0 is outside'),
        ({'axis_jerk': (1.0,)}, 'axis_jerk: expected one limit each for X, Y, Z but found 1'),
        ({'method': 'fuzzy', 'fuzzy_curvature_centres': (1.0, 2.0)}, 'curvature_centres'),
        ({'method': 'best'}, 'method: expected one of log_fuzzy, tolerance, fuzzy'),
    ],
)
def test_configuration_that_makes_no_sense_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        FeedrateSchedulerConfig(**changes)


def test_parts_shorter_than_a_piece_of_the_path():
    """With limits of jerk too; a part may lie between two nodes of the path."""
    config = replace(CONFIG, chunk=0.02, lead=0.05, axis_jerk=(100.0, 100.0, 100.0))
    rig = Rig(config)
    rig.run(path_of(SMALL))
    check_motion(rig)
    assert any(not len(schedule.arc_length) for schedule in rig.records('feed_schedule'))
