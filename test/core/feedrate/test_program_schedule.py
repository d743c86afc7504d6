# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Part programs scheduled: a feed for each block, times within limits, streams of any length."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from programs.without_feeds import strip_feeds
from tiers import rest_slow

from fuzzycnc_ros.components.motion.feedrate_scheduler_config import (
    FeedrateSchedulerConfig,
    make_scheduler,
)
from fuzzycnc_ros.components.motion.program_request import program_settings
from fuzzycnc_ros.core.feedrate.gcode.reader import ProgramReader, read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import ArcSegment
from fuzzycnc_ros.core.feedrate.gcode.writer import write_program
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.trajectory import limit_motion
from fuzzycnc_ros.core.feedrate.schedule import program_run
from fuzzycnc_ros.core.feedrate.schedule.program_schedule import (
    ProgramScheduler,
    rest_to_rest,
    schedule_program,
    straight_time,
)
from fuzzycnc_ros.core.feedrate.schedule.program_settings import ProgramSettings
from fuzzycnc_ros.core.feedrate.schedule.scheduler import ConstantFeed, ConstantNormalAcceleration

LIMITS = MotionLimits(
    path_velocity=0.25, path_acceleration=1.5, velocity=(0.25,) * 3, acceleration=(4.0,) * 3
)
SIDEWAYS = 0.05
"""Normal acceleration of the scheduler in most tests [m/s^2]."""

ROUTE = 'F6000\nG1 X30\nG2 X40 I5\nG1 X70\n'
"""A line, half a circle of 5 mm to its side, another line: two corners."""

FILES = [
    'ccby-5axis/Keychain_Schluesselanhaenger.mpf',
    'ccby-5axis/Bottle_opener_Flaschenoeffner.txt',
    'ccby-5axis/Coordinate_system_representation_Achskreuz.mpf',
    'ugs/Gates_combined_R12.nc',
    'ugs/arc_rword_test.gcode',
    'ugs/comments.gcode',
    'ugs/g17-g18-g19.gcode',
    'ugs/no_spaces.gcode',
    'ugs/rotation.ngc',
    'ugs/spiral.gcode',
]

LONG = [
    'ccby-5axis/Coordinate_system_representation_Achskreuz.mpf',
    'ugs/Gates_combined_R12.nc',
    'ugs/rotation.ngc',
]


def made(scheduler=None, **changes):
    """Settings whose scheduler keeps a normal acceleration."""
    law = ConstantNormalAcceleration(feed_max=0.2, normal_acceleration=SIDEWAYS)
    return ProgramSettings(**{'scheduler': scheduler or law, 'limits': LIMITS, **changes})


def feeds(text, **changes):
    """Feeds of the blocks of a program that have one [m/s]."""
    found = schedule_program(read_program(text), made(**changes)).feeds
    return found[~np.isnan(found)]


def on_circle(count, radius=20.0, feed=12000):
    """A polyline on a full circle [mm]."""
    angle = np.linspace(0.0, 2.0 * math.pi, count + 1)
    lines = [f'X{radius * math.cos(a):.6f} Y{radius * math.sin(a):.6f}' for a in angle.tolist()]
    return f'G0 {lines[0]} Z0\nG1 F{feed}\n' + '\n'.join(lines[1:]) + '\n'


def random_program(seed, blocks=60):
    """Lines, arcs, helices and rapids, with a tangent now and then."""
    generator = np.random.default_rng(seed)
    lines = ['G0 X0 Y0 Z0 F3000', 'G91']
    for _ in range(blocks):
        x, y, z = generator.uniform(-6.0, 6.0, 3).round(3).tolist()
        kind = generator.integers(0, 8)
        if kind < 4:
            lines.append(f'G1 X{x} Y{y}')
        elif kind < 6:
            lines.append(f'G{2 + kind % 2} X{x} Y{y} R{0.5 * math.hypot(x, y) + 1.0:.3f}')
        elif kind == 6:
            lines.append(f'G2 I{abs(x) + 0.5} J{y} Z{z}')
        else:
            lines.append(
                f'G0 Z{z}' if generator.integers(0, 2) else f'G1 F{1500 + 500 * abs(z):.0f}'
            )
    return '\n'.join(lines) + '\n'


def test_lines_keep_the_feed_of_the_program_and_arcs_that_of_their_curvature():
    for blend in (0.0, 1e-5):
        line, arc, last = feeds(ROUTE, blend=blend)
        assert line == last == pytest.approx(0.1, rel=1e-12)
        assert arc == pytest.approx(math.sqrt(SIDEWAYS * 5e-3), rel=2e-3)


def test_a_bend_that_goes_on_without_a_corner_slows_the_arc_alone():
    text = 'F6000\nG1 X30\nG3 X35 Y5 J5\nG1 Y35\nG3 X30 Y40 I-5\nG1 X0\n'
    found = schedule_program(read_program(text), made())
    assert found.times.stops == 1
    slow = math.sqrt(SIDEWAYS * 5e-3)
    assert found.feeds == pytest.approx([0.1, slow, 0.1, slow, 0.1], rel=2e-3)


def test_a_dense_polyline_is_as_slow_as_its_circle_where_corners_are_blended():
    round_feed = math.sqrt(SIDEWAYS * 0.02)
    dense = feeds(on_circle(400), blend=1e-5)[1:-1]
    assert dense.min() > 0.8 * round_feed
    assert dense.max() < 1.25 * round_feed
    assert feeds(on_circle(400)) == pytest.approx(np.full(400, 0.2), rel=1e-9)  # stops
    square = 'F6000\nG1 X30\nY30\nX0\nY0\n'
    assert feeds(square, blend=1e-5) == pytest.approx(np.full(4, 0.1), rel=1e-9)


def test_a_curve_whose_end_is_sharpest_runs_with_the_feed_of_its_end():
    # a quarter of an ellipse with half axes of 20 and 2 mm: sharpest where it leaves X
    weight = 0.5 * math.sqrt(2.0)
    text = f'G0 X0 Y2\nF12000\nG5.2 P1 L3\nX20 Y2 P{weight}\nX20 Y0 P1\nG5.3\nG1 X50\n'
    curve, line = feeds(text)
    radius = 0.002**2 / 0.02
    assert curve == pytest.approx(math.sqrt(SIDEWAYS * radius), rel=0.02)
    assert line == pytest.approx(0.2, rel=1e-9)


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 10_000), blend=st.sampled_from([0.0, 1e-5, 1e-4]))
def test_no_block_runs_faster_than_the_program_or_the_scheduler_say(seed, blend):
    program = read_program(random_program(seed))
    found = schedule_program(program, made(blend=blend))
    slow = math.sqrt(SIDEWAYS)
    for segment, feed in zip(program.segments, found.feeds.tolist(), strict=True):
        assert segment.schedulable is not math.isnan(feed)
        if segment.schedulable:
            assert 2e-5 <= feed <= segment.feed * (1.0 + 1e-12)
            if isinstance(segment, ArcSegment):
                assert feed <= 1.01 * slow / math.sqrt(float(segment.curvatures(4).max()))
    assert found.times.duration >= found.times.programmed * (1.0 - 1e-3)
    written = write_program(program, found.feeds)
    assert strip_feeds(written) == strip_feeds(program.text)


@pytest.mark.parametrize('blend', [0.0, 1e-5])
@pytest.mark.parametrize(
    'method', rest_slow(['log_fuzzy', 'fuzzy', 'normal_acceleration', 'look_ahead'], 0, 2)
)
def test_a_stream_of_small_parts_gives_what_large_ones_give(monkeypatch, method, blend):
    law = make_scheduler(FeedrateSchedulerConfig(method=method))
    program = read_program(random_program(3, blocks=80) + 'G90\n' + on_circle(150))
    whole = schedule_program(program, made(law, blend=blend))
    for chunk in (11, 40):
        monkeypatch.setattr(program_run, '_CHUNK', chunk)
        parts = schedule_program(program, made(law, blend=blend))
        assert len(parts.paths) > len(whole.paths)
        assert np.allclose(parts.feeds, whole.feeds, rtol=1e-9, atol=0.0, equal_nan=True)
        assert parts.times.duration == pytest.approx(whole.times.duration, rel=1e-9)
        assert parts.times.programmed == pytest.approx(whole.times.programmed, rel=1e-9)


@pytest.mark.parametrize('blend', [0.0, 1e-5])
def test_a_long_program_is_read_no_farther_ahead_than_the_scheduler_looks(monkeypatch, blend):
    chunk, taken = 128, 0
    monkeypatch.setattr(program_run, '_CHUNK', chunk)
    monkeypatch.setattr(program_run, 'GROUP', chunk)

    def lines():
        nonlocal taken
        for line in on_circle(4000, radius=80.0).splitlines(keepends=True):
            taken += 1
            yield line

    law = make_scheduler(FeedrateSchedulerConfig())
    scheduler = ProgramScheduler(made(law, blend=blend))
    ahead = 0
    for done, _ in enumerate(scheduler.schedule(ProgramReader().blocks(lines()))):
        ahead = max(ahead, taken - done)
    assert taken > 4000
    assert ahead < 5 * chunk


def test_neighbours_whose_feeds_are_close_share_the_lowest():
    text = 'F12000 G91\n' + ''.join(
        f'G3 X{2.0 * radius:.3f} I{radius:.3f}\n' for radius in (5.0, 5.1, 5.2, 8.0, 7.9)
    )
    alone = feeds(text, feed_step=0.0)
    assert np.diff(alone[:4]).min() > 0.0
    low, high = alone[0], alone[4]
    assert feeds(text, feed_step=0.05).tolist() == [low, low, low, high, high]
    assert feeds(text, feed_step=0.5).tolist() == [low] * 5


def test_the_override_lifts_the_bound_of_the_program_and_never_the_tolerance():
    slow = math.sqrt(SIDEWAYS * 5e-3)
    for override, line, arc in ((0.5, 0.05, 0.5 * slow), (1.5, 0.15, slow)):
        found = feeds(ROUTE, override=override)
        assert found == pytest.approx([line, arc, line], rel=2e-3)
    even = ConstantFeed(feed_max=0.2)
    assert feeds(ROUTE, scheduler=even, override=1.5) == pytest.approx([0.15] * 3, rel=1e-9)


def test_another_bound_takes_the_place_of_the_feed_words():
    slow = math.sqrt(SIDEWAYS * 5e-3)
    assert feeds(ROUTE, feed=0.02) == pytest.approx([0.02, slow, 0.02], rel=2e-3)
    program = read_program(ROUTE)
    free = schedule_program(program, made(feed=0.2)).times
    bound = schedule_program(program, made()).times
    assert free.duration < bound.duration
    assert free.programmed == pytest.approx(bound.programmed, rel=1e-9)


def test_an_axis_that_is_slow_bounds_the_feed():
    limits = MotionLimits(path_velocity=0.25, path_acceleration=1.5, velocity=(0.25, 0.25, 0.01))
    assert feeds('F12000\nG1 X30\nX60 Z30\nZ60\n', limits=limits) == pytest.approx(
        [0.2, 0.01 * math.sqrt(2.0), 0.01], rel=1e-9
    )


def test_times_are_those_of_trapezoids_between_stops():
    # 30 mm at 0.1 m/s and 1.5 m/s^2 from rest to rest, four times
    one = 0.03 / 0.1 + 0.1 / 1.5
    text = 'G0 X0 Y0 Z0 F6000\nG1 X30\nY30\nX0\nY0\n'
    found = schedule_program(read_program(text), made()).times
    assert found.duration == pytest.approx(4.0 * one, rel=1e-12)
    assert (found.stops, found.chosen, found.blocks) == (4, 4, 5)
    rested = schedule_program(read_program(text), made(settle=0.2)).times
    assert rested.duration == pytest.approx(4.0 * (one + 0.2), rel=1e-12)
    blended = schedule_program(read_program(text), made(blend=1e-3)).times
    assert blended.stops == 1
    assert blended.programmed < found.programmed


def test_what_is_not_scheduled_counts_as_well():
    text = 'G0 X0 Y0 Z0\nG1 X30 F6000\nG0 Z10\nG4 P1.5\nG1 X0 A90\nG93 G1 X5 F2\nG94\nG0 Z=Q1\n'
    found = schedule_program(read_program(text), made()).times
    assert found.rapid == pytest.approx(2.0 * math.sqrt(0.01 / 4.0), rel=1e-12)
    assert found.dwell == 1.5
    assert found.kept == pytest.approx(0.03 / 0.1, rel=1e-12)
    assert found.untimed == 2  # G93, and where Z goes at last, which the control computes
    line = 0.03 / 0.1 + 0.1 / 1.5
    assert found.duration == pytest.approx(line + found.rapid + 1.5 + found.kept, rel=1e-12)
    assert found.programmed == pytest.approx(found.duration, rel=1e-12)


def test_relative_moves_from_an_unknown_place_are_timed():
    text = 'G0 X0 Y0 Z0\nG10 L2 P1 X0\nG91\nG1 X100 F500\nY100\nG0 Z10\nG1 X-100\n'
    found = schedule_program(read_program(text), made()).times
    assert found.kept == pytest.approx(36.0, rel=1e-12)
    assert found.rapid == pytest.approx(2.0 * math.sqrt(0.01 / 4.0), rel=1e-12)
    assert (found.duration, found.untimed) == (found.programmed, 0)
    assert found.duration == pytest.approx(36.0 + found.rapid, rel=1e-12)


@pytest.mark.parametrize(
    ('line', 'untimed', 'kept'),
    [
        ('G28 Z0', 1, 0.0),
        ('G81 X1 Y1 Z-1 R1', 1, 0.0),
        ('M98 P100', 1, 0.0),
        ('CYCLE81(1,2)', 1, 0.0),
        ('G4 P#5', 1, 0.0),
        ('G4 S30', 1, 0.0),
        ('G1 E5', 1, 0.0),
        ('G1 A90', 1, 0.0),
        ('M600 X0 Y0', 1, 0.0),  # change of filament, which moves to a place and back
        ('M125', 1, 0.0),
        ('$H', 1, 0.0),
        ('$J=G91 X10 F500', 1, 0.0),
        ('$100=80', 0, 0.0),
        ('M206 X1', 0, 0.0),
        ('/G1 X40', 0, 6.0),  # the feed of a line that may be skipped is known
        ('M8', 0, 0.0),
        ('G54', 0, 0.0),
    ],
)
def test_what_is_not_timed_is_counted(line, untimed, kept):
    text = f'G1 X30 Y0 Z0 F100\n{line}\n'
    found = schedule_program(read_program(text), made()).times
    assert (found.untimed, found.kept) == (untimed, pytest.approx(kept))


def test_a_rapid_of_unknown_time_in_a_file_of_a_subroutine_is_counted():
    files = {'park': 'o<park> sub\nG0\nG28 X0\no<park> endsub\n'}
    reader = ProgramReader(follow=True, files=files.get)
    scheduler = ProgramScheduler(made())
    list(scheduler.schedule(reader.blocks(['G1 X30 Y0 Z0 F100\n', 'o<park> call\n'])))
    assert scheduler.times.untimed == 1


def test_the_time_of_a_whole_path_is_that_of_the_motion_along_it():
    for seed, blend in ((1, 0.0), (2, 1e-5), (5, 1e-4)):
        found = schedule_program(read_program(random_program(seed)), made(blend=blend))
        time = found.times.rapid
        run = []
        for part in [*found.paths, None]:
            if run and (part is None or part.first):
                assert len(run) == 1
                time += limit_motion(
                    run[0].path.geometry, run[0].feed, LIMITS, feed_max=0.25
                ).duration
                run = []
            run.append(part)
        assert found.times.duration == pytest.approx(time, rel=0.02)
        assert found.times.duration <= time * (1.0 + 1e-6)


@settings(deadline=None, max_examples=50)
@given(
    length=st.floats(1e-5, 1.0),
    speed=st.floats(1e-3, 1.0),
    rise=st.floats(0.1, 10.0),
    jolt=st.floats(1.0, 1e4),
)
def test_the_shortest_time_with_jerk_covers_its_way(length, speed, rise, jolt):
    limits = MotionLimits(path_velocity=speed, path_acceleration=rise, path_jerk=jolt)
    (time,) = straight_time(np.array([[length, 0.0]]), np.array([math.inf]), limits)
    # the profile by integrating its jerk: up, hold, down, cruise and the same mirrored
    build = min(rise / jolt, math.sqrt(speed / jolt), (0.5 * length / jolt) ** (1.0 / 3.0))
    top = jolt * build
    hold = 0.0
    if math.isclose(build, rise / jolt):
        full = max(speed / top - build, 0.0)
        short = -1.5 * build + math.sqrt(0.25 * build**2 + length / top)
        hold = max(min(full, short), 0.0)
    reached = top * (build + hold)
    way = reached * (2.0 * build + hold)
    cruise = (length - way) / reached
    assert cruise >= -1e-9 * time
    assert time == pytest.approx(2.0 * (2.0 * build + hold) + cruise, rel=1e-6)


def lone_lines(count):
    """A program of lines between rapids and waits, some of which go on."""
    rng = np.random.default_rng(count)
    lines = ['G0 X0 Y0 Z0', 'G91']
    for before in rng.choice(['G0 X1 Z-1', 'G4 P0.1', 'M3', '(text)', 'G1 X0.3 F900'], count):
        way = 10.0 ** rng.uniform(-3.0, 2.0) * rng.choice([0.0, 1.0, -0.4], 3)
        x, y, z = way.round(4).tolist()
        lines += [str(before), f'G1 X{x} Y{y} Z{z} F{rng.choice([100, 3000, 60000])}']
    return [f'{line}\n' for line in lines]


@pytest.mark.parametrize('blend', [0.0, 1e-5])
@pytest.mark.parametrize('override', [0.5, 1.3])
@pytest.mark.parametrize(
    'method', rest_slow(['log_fuzzy', 'fuzzy', 'constant', 'jerk_limited'], 0)
)
def test_lines_alone_are_scheduled_as_paths_are(method, override, blend):
    config = FeedrateSchedulerConfig(
        method=method, tolerance=20e-6, blend=blend, feed_override=override
    )
    found = []
    for observe in (None, [].append):  # who observes is told of paths, so that all become some
        scheduler = ProgramScheduler(program_settings(config), observe)
        blocks = ProgramReader().blocks(lone_lines(60))
        found.append([feed or math.nan for _, feed in scheduler.schedule(blocks)])
        found.append(scheduler.times.document())
    # a path bends by rounding, which the published rules answer
    assert found[0] == pytest.approx(found[2], rel=1e-8, nan_ok=True)
    assert found[1] == pytest.approx(found[3], rel=1e-8)
    assert found[1]['stops'] > 20


def test_a_move_below_rounding_keeps_its_feed():
    lines = ['G0 X0 Y0\n', 'G1 X0.000001 F600\n', 'G0 Y1\n', 'G1 X5\n']
    scheduler = ProgramScheduler(made())
    feeds = [feed for _, feed in scheduler.schedule(ProgramReader().blocks(lines))]
    assert feeds[1] is None
    assert feeds[3] == pytest.approx(0.01)


def test_rapids_heed_the_axes_and_not_the_path():
    slow = MotionLimits(
        path_velocity=0.01, path_acceleration=0.1, velocity=(0.25,) * 3, acceleration=(4.0,) * 3
    )
    ways = [[0.3, 0.3, 0.0], [math.nan, 0.0, 0.0], [0.0, 0.0, 0.0]]
    expected = [0.3 / 0.25 + 0.25 / 4.0, math.nan, 0.0]
    assert rest_to_rest(ways, slow) == pytest.approx(expected, rel=1e-12, nan_ok=True)


def test_limits_of_jerk_cost_time():
    program = read_program(on_circle(60) + ROUTE)
    hard = schedule_program(program, made()).times
    soft = schedule_program(
        program,
        made(limits=MotionLimits(path_velocity=0.25, path_acceleration=1.5, path_jerk=50.0)),
    ).times
    assert soft.duration > 1.05 * hard.duration
    assert soft.programmed > 1.05 * hard.programmed


@pytest.mark.parametrize('tolerance', [1e-6, 1e-5, 1e-4])
def test_the_error_to_expect_keeps_the_tolerance(tolerance):
    law = make_scheduler(FeedrateSchedulerConfig(tolerance=tolerance))
    program = read_program(random_program(8) + 'G90 G0 X20 Y0 Z0\nG91 G3 I-20\nG1 X20\nG2 I0.4\n')
    times = schedule_program(program, made(law)).times
    # words leave braking and blends to the controller: a bound, not far above the tolerance
    assert 0.3 * tolerance < times.error <= 5.0 * tolerance
    assert times.programmed_error > times.error


@pytest.mark.parametrize('method', ['jerk_limited', 'look_ahead', 'chord_error', 'constant'])
def test_every_scheduler_schedules_programs(method):
    law = make_scheduler(FeedrateSchedulerConfig(method=method))
    found = schedule_program(read_program(random_program(4)), made(law))
    assert 0.0 < found.times.programmed <= found.times.duration * (1.0 + 1e-3)


def test_blocks_without_a_length_pass():
    text = 'F6000\nG1 X10\nX10\nM8\n\nX20\nX20.0000000001\nX30\n'
    program = read_program(text)
    found = schedule_program(program, made())
    assert found.feeds[~np.isnan(found.feeds)] == pytest.approx(0.1, rel=1e-9)
    assert write_program(program, found.feeds) == text


def test_many_lines_without_motion_end_a_run():
    quiet = program_run.QUIET
    text = 'F6000\nG1 X10\n' + 'M8\n' * (quiet + 5) + 'X20\n'
    found = schedule_program(read_program(text), made())
    assert [part.first for part in found.paths] == [True, True]
    assert found.times.duration == pytest.approx(2.0 * (0.01 / 0.1 + 0.1 / 1.5), rel=1e-9)


@pytest.mark.parametrize(
    ('name', 'value'),
    [('override', 0.0), ('feed', -1.0), ('blend', -1e-6), ('settle', math.nan), ('feed_step', -1)],
)
def test_settings_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f'{name}: expected a number'):
        made(**{name: value})


@pytest.fixture(scope='module')
def gcode(data):
    return data / 'gcode'


def shape(part):
    """All that a segment's path is made of."""
    bent = (*part.centre, part.sweep) if isinstance(part, ArcSegment) else ()
    return (*part.start, *part.end, *bent)


@pytest.mark.parametrize('blend', rest_slow([0.0, 1e-5], 1))
@pytest.mark.parametrize(
    'name',
    [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in FILES],
)
def test_a_real_program_keeps_its_path(gcode, name, blend):
    text = (gcode / name).read_bytes().decode('utf-8', errors='surrogateescape')
    program = read_program(text)
    law = make_scheduler(FeedrateSchedulerConfig())
    found = schedule_program(program, made(law, blend=blend))
    written = write_program(program, found.feeds)
    assert strip_feeds(written) == strip_feeds(text)
    again = read_program(written)
    assert len(again.segments) == len(program.segments)
    for old, new in zip(program.segments, again.segments, strict=True):
        assert type(old) is type(new)
        assert np.allclose(shape(old), shape(new), rtol=0.0, atol=1e-12, equal_nan=True)
        if old.schedulable:
            assert new.feed <= old.feed * (1.0 + 1e-8)
    times = found.times
    assert times.chosen == sum(segment.schedulable for segment in program.segments)
    assert times.blocks == len(program.blocks)
    assert times.duration >= times.programmed * (1.0 - 1e-3)
    # a bound by what the words ask for; braking and rounded corners are the controller's
    assert times.error <= times.programmed_error * (1.0 + 1e-6)


CORNERS = '{}\nG0 X0 Y0 Z0\nG1 F6000 X5\nX10 Y1\nX15 Y3\nX20 Y3\nX25 Y2\n'


@pytest.mark.parametrize(
    ('word', 'blend'),
    [
        ('G64 P0.01', 1e-5),
        ('G20\nG64 P0.001\nG21', 25.4e-6),
        ('G64 P0.01 Q0.02', 1e-5),
        ('G64 P0.01\nG64 P0.03', 3e-5),
        ('G61', 0.0),
        ('G61.1', 0.0),
        ('G64 P0.01\nG61', 0.0),
        ('G64', None),
        ('G64 P0', None),
        ('G64 P#1', None),
        ('G642', None),
        ('', None),
    ],
)
def test_how_the_program_rounds_corners_counts_before_the_setting(word, blend):
    """P of G64 is a tolerance; without P the control decides, and the setting counts."""
    if word.startswith('G20'):
        word, blend = 'G20\nG64 P0.001\nG21', 25.4e-6
    setting = 5e-5
    asked = setting if blend is None else blend
    wanted = schedule_program(read_program(CORNERS.format('')), made(blend=asked)).times
    program = read_program(CORNERS.format(word))
    found = schedule_program(program, made(blend=setting)).times
    # the lines in front count
    assert replace(found, blocks=0) == replace(wanted, blocks=0)
    # who gives the setting of a machine that follows it may refuse the program's word
    other = schedule_program(program, made(blend=setting, own_corners=False)).times
    plain = schedule_program(read_program(CORNERS.format('')), made(blend=setting)).times
    assert replace(other, blocks=0) == replace(plain, blocks=0)


def test_a_change_of_the_rounding_splits_a_run():
    text = CORNERS.format('G64 P0.01') + 'G61\nX30 Y5\nX35 Y5\nG64 P0.02\nX40 Y4\nX45 Y5\n'
    scheduler = ProgramScheduler(made())
    for _ in scheduler.schedule(read_program(text).blocks):
        pass
    assert scheduler.corners == {1e-5, 0.0, 2e-5}
    # at the changes, at both corners under G61, and at the end
    assert scheduler.times.stops == 4


_O, _A, _B, _C = (0.0, 0.0), (4.0, 0.0), (8.0, 3.0), (12.0, 0.0)
REPEATED = {
    'start of order 3': (3, [_O, _O, _A, _B, _C]),
    'start, straight': (3, [_O, _O, _A]),
    'start, more than order 4': (4, [_O, _O, _O, _O, _A, _B, _C]),
    'middle': (3, [_A, _B, _B, _B, _C, (12.0, 9.0)]),
    'middle, more than order 4': (4, [_A, _B, _B, _B, _B, _B, _C, _A]),
    'end': (3, [_A, _B, _C, _C, _C]),
    'end, more than order 4': (4, [_A, _B, _C, _C, _C, _C, _C]),
    'everywhere': (3, [_O, _O, _A, _A, _A, _B, _B, _B]),
    'straight back': (3, [_A, _O]),
    'back in a knot': (4, [_A, (8.0, 0.0), _A, _O]),
    'back in the middle': (3, [_A, _C, _A, _C, _A]),
}


@pytest.mark.parametrize('name', REPEATED)
def test_a_curve_that_stands_still_or_turns_back_is_scheduled(name):
    order, points = REPEATED[name]
    words = [f'X{x} Y{y} P1' for x, y in points]
    text = f'G0 X0 Y0\nF600\nG5.2 L{order} {words[0]}\n' + '\n'.join(words[1:]) + '\nG5.3\n'
    program = read_program(text)
    curve = program.segments[-1].curve
    found = schedule_program(program, made())
    # the way of a fine polygon, from rest to rest
    u = np.linspace(*curve.domain, 20_001)
    way = float(np.linalg.norm(np.diff(curve.point(u), axis=0), axis=1).sum())
    assert found.times.length == pytest.approx(way, rel=1e-4)
    feed = float(found.feeds[-1])
    assert 0.0 < feed <= 0.01
    assert found.duration >= way / 0.01 * (1.0 - 1e-4)
    path = found.paths[-1].path
    assert np.isfinite(path.curvature).all()
    assert (
        np.linalg.norm(path.geometry.coefficient[-1, 5, :2] - 1e-3 * np.array(points[-1])) < 1e-9
    )


@pytest.mark.parametrize('name', ['middle', 'middle, more than order 4', 'everywhere'])
def test_a_corner_within_a_curve_is_rounded_and_bounds_the_feed_of_its_block(name):
    order, points = REPEATED[name]
    words = [f'X{x} Y{y} P1' for x, y in points]
    text = f'G0 X0 Y0\nF1600\nG5.2 L{order} {words[0]}\n' + '\n'.join(words[1:]) + '\nG5.3\n'
    found = schedule_program(read_program(text), made(blend=5e-6))
    (path,) = (item.path for item in found.paths)
    assert path.stop.tolist() == [True, *[False] * (len(path.stop) - 2), True]
    # a corner of 37 degrees or more, rounded within 5 um, bends at least as much as this
    assert path.curvature.max() > 9e3
    assert found.feeds[-1] ** 2 * path.curvature.max() <= SIDEWAYS * (1.0 + 1e-9)


@pytest.mark.parametrize('words', ['X0 Y0', 'X0 Y0 P2'])
def test_a_curve_of_one_point_is_refused_by_its_line(words):
    text = f'G0 X0 Y0\nF600\nG5.2 L3 {words}\n{words}\n{words}\nG5.3\n'
    with pytest.raises(
        ValueError, match=r'line 3: no NURBS curve begins here: .*one and the same'
    ):
        schedule_program(read_program(text), made())
