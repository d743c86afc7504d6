# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What part programs mean: words, modal state, geometry."""

import math

import numpy as np
import pytest

from fuzzycnc_ros.core.feedrate.gcode.blocks import Role
from fuzzycnc_ros.core.feedrate.gcode.reader import ProgramReader, read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import (
    ArcSegment,
    DwellSegment,
    NurbsSegment,
    ProgramError,
    sample_path,
)

MM = 1e-3


def ends(text, **options):
    """End points of all segments [mm]."""
    program = read_program(text, **options)
    return [tuple(np.round(np.array(part.end) / MM, 9)) for part in program.segments]


def only(text):
    """The last segment of a program."""
    return read_program(text).segments[-1]


@pytest.mark.parametrize(
    'text',
    [
        'G1 X1 Y2 F60',
        'g1x1y2f60',
        'N10G01X+1.Y2.0F60.',
        'G 1 X 1 Y 2 F 60',
        'F60 Y2 X1 G1 ; slow (really',
        '(first) G1 (in the middle: "7") X1 Y2 F60 (last)',
        'G1 X=1 Y=2. F60',
        'F60 MSG("G1 X9 (") G1 X1 Y2',
        'F60 FNORM G1 X1 Y2',
    ],
)
def test_spellings_of_one_block_mean_the_same(text):
    segment = only(text)
    assert np.allclose(segment.end, (MM, 2.0 * MM, 0.0), atol=1e-15)
    assert segment.feed == pytest.approx(MM)
    assert segment.length == pytest.approx(math.sqrt(5.0) * MM)


def test_motion_goes_on_without_its_word_and_axes_keep_their_place():
    assert ends('G0 Z5\nX1 Y1\nG1 Z-1 F100\nX2\nY3\nG0\nZ5\n') == [
        (0, 0, 5),
        (1, 1, 5),
        (1, 1, -1),
        (2, 1, -1),
        (2, 3, -1),
        (2, 3, 5),
    ]


def test_units_and_distances_switch_in_the_middle():
    text = 'G20\nG1 X1 F60\nG21\nX30.4 F600\nG91 X1 Y1\nY1\nG90 X0\nG710 X1\nG700 X1\n'
    program = read_program(text)
    assert [round(part.end[0] / MM, 9) for part in program.segments] == [
        25.4,
        30.4,
        31.4,
        31.4,
        0.0,
        1.0,
        25.4,
    ]
    assert program.segments[3].end[1] == pytest.approx(2.0 * MM)
    assert [part.feed for part in program.segments[:2]] == pytest.approx([25.4e-3, 10e-3])
    assert read_program('G1 X1 F60', units='inch').segments[0].length == pytest.approx(25.4e-3)


@pytest.mark.parametrize(
    ('plane', 'words', 'axis', 'quarter'),
    [
        ('G17', 'X0 Y10 I-10', 2, (1, 1, 0)),
        ('G18', 'Z0 X10 K-10', 1, (1, 0, 1)),
        ('G19', 'Y0 Z10 J-10', 0, (0, 1, 1)),
    ],
)
@pytest.mark.parametrize('direction', ['G2', 'G3'])
def test_arcs_of_each_plane_run_the_right_way(plane, words, axis, quarter, direction):
    start = {'G17': 'X10', 'G18': 'Z10', 'G19': 'Y10'}[plane]
    arc = only(f'{plane} G0 {start}\n{direction} {words} F100\n')
    turn = 0.5 * math.pi if direction == 'G3' else -1.5 * math.pi
    assert arc.sweep == pytest.approx(turn)
    assert arc.length == pytest.approx(abs(turn) * 10.0 * MM)
    point = arc.points(6)
    assert np.allclose(np.linalg.norm(np.delete(point, axis, axis=1), axis=1), 10.0 * MM)
    assert np.allclose(arc.curvatures(6), 100.0)
    middle = arc.points(2)[1] * (1.0 if direction == 'G3' else -1.0)
    assert np.allclose(middle, np.array(quarter) * 10.0 * MM / math.sqrt(2.0))


@pytest.mark.parametrize('direction', ['G2', 'G3'])
@pytest.mark.parametrize('radius', [6.0, 5.0, -6.0])
def test_an_arc_by_radius_is_the_arc_by_its_centre(direction, radius):
    by_radius = only(f'{direction} X6 Y8 R{radius} F100\n')
    by_name = only(f'{direction} X6 Y8 CR={radius} F100\n')
    x, y = (value / MM for value in by_radius.centre)
    by_centre = only(f'{direction} X6 Y8 I{x:.9f} J{y:.9f} F100\n')
    assert by_radius == by_name
    assert by_radius.sweep == pytest.approx(by_centre.sweep, abs=1e-6)
    assert np.allclose(by_radius.radii, abs(radius) * MM)
    assert (abs(by_radius.sweep) > math.pi * (1.0 + 1e-9)) == (radius < 0.0)
    assert (by_radius.sweep < 0.0) == (direction == 'G2')


def test_full_circles_turns_and_helices():
    circle = only('G0 X5\nG2 I-5 F100\n')
    assert circle.sweep == pytest.approx(-2.0 * math.pi)
    assert only('G0 X5\nG91 G3 X0 Y0 I-5 F100\n').sweep == pytest.approx(2.0 * math.pi)
    assert only('G0 X5\nG3 I-5 P3 F100\n').sweep == pytest.approx(6.0 * math.pi)
    helix = only('G0 X5\nG3 X-5 Z4 I=-5 TURN=1 F100\n')
    assert helix.sweep == pytest.approx(3.0 * math.pi)
    assert helix.length == pytest.approx(MM * math.hypot(15.0 * math.pi, 4.0))
    point = helix.points(3000)
    assert np.linalg.norm(np.diff(point, axis=0), axis=1).sum() == pytest.approx(helix.length)
    rise = 4.0 * MM / helix.sweep
    assert np.allclose(helix.curvatures(2), 5.0 * MM / ((5.0 * MM) ** 2 + rise**2))


def test_centres_may_be_absolute():
    relative = only('G0 X10 Y10\nG3 X0 Y20 I-10 F100\n')
    absolute = only('G0 X10 Y10\nG90.1 G3 X0 Y20 I0 J10 F100\n')
    back = only('G0 X10 Y10\nG90.1\nG91.1 G3 X0 Y20 I-10 F100\n')
    assert np.allclose(relative.centre, absolute.centre)
    assert relative.sweep == pytest.approx(absolute.sweep)
    assert np.allclose(back.centre, relative.centre)


def test_a_rounded_arc_meets_both_of_its_points():
    arc = only('G0 X10\nG3 X0.005 Y9.995 I-10 F100\n')
    point = arc.points(50)
    assert tuple(point[0]) == arc.start
    assert tuple(point[-1]) == arc.end
    assert np.abs(np.hypot(*point[:, :2].T) - 10.0 * MM).max() < 6e-6


@pytest.mark.parametrize(
    ('unit', 'radius', 'misfit', 'fits'),
    [
        # As `rs274` of LinuxCNC takes and refuses them.
        ('G21', 5.0, 0.016, True),
        ('G21', 5.0, 0.0282, True),
        ('G21', 5.0, 0.0284, False),
        ('G21', 500.0, 0.48, True),
        ('G21', 500.0, 0.52, False),
        ('G21', 50_000.0, 2.8, True),
        ('G21', 50_000.0, 3.0, False),
        ('G20', 0.2, 0.00282, True),
        ('G20', 0.2, 0.00287, False),
    ],
)
def test_an_arc_may_miss_its_radius_as_far_as_linuxcnc_lets_it(unit, radius, misfit, fits):
    text = f'{unit}\nG0 X{radius}\nF100\nG2 X-{radius} Y0 I-{radius + 0.5 * misfit:.6f}\n'
    if not fits:
        with pytest.raises(ProgramError, match=r'line 4: .*radius does not fit'):
            read_program(text)
        return
    program = read_program(text)
    arc, scale = program.segments[-1], 25.4 * MM if unit == 'G20' else MM
    assert arc.misfit == pytest.approx(misfit * scale, rel=1e-3)
    assert arc.length == pytest.approx(math.pi * radius * scale, rel=2e-3)
    assert 'its radius changes along the way' in str(program.notes[-1])


def test_an_arc_that_is_off_by_rounding_is_no_remark():
    assert read_program('G0 X10\nG3 X0.005 Y9.995 I-10 F100\n').notes == ()


def test_a_dwell_stands_still_and_sets_no_feed():
    program = read_program('F100 G1 X1\nG4 P2.5\nG4 F3\nX2\n')
    first, wait, other, last = program.segments
    assert isinstance(wait, DwellSegment)
    assert (wait.duration, other.duration, wait.length) == (2.5, 3.0, 0.0)
    assert first.feed == last.feed
    assert program.runs == ((0, 1), (3, 4))


def test_a_block_of_control_points_is_a_nurbs_curve_with_even_clamped_knots():
    text = (
        'G0 X1 Z3\nG5.2 P1 L4 F100\nX2 Y1 P2\nX4 Y5\n(between)\nX6 Y0\nX8 Y8 P0.5\nG5.3\nG1 X9\n'
    )
    program = read_program(text)
    curve = program.segments[1]
    assert isinstance(curve, NurbsSegment)
    assert (curve.line, curve.last_line) == (2, 7)
    assert curve.curve.knot.tolist() == [0, 0, 0, 0, 1, 2, 2, 2, 2]
    assert curve.curve.weight.tolist() == [1, 2, 1, 1, 0.5]
    assert np.allclose(curve.curve.control[[0, -1]] / MM, [[1, 0, 3], [8, 8, 3]])
    assert program.segments[2].start == curve.end
    assert [block.segment for block in program.blocks[2:8]] == [None] * 6
    assert program.runs == ((1, 3),)
    assert len(program.blocks) == len(text.splitlines())


def test_a_block_with_knots_is_a_circle_where_it_says_so():
    half = math.sqrt(0.5)
    text = (
        'G0 X10\nG6.2 P3 K0 X10 Y0 R1 F100\n'
        f'K0 X10 Y10 R{half:.15f}\nK0 X0 Y10 R1\nK1\nK1\nK1\nG0 Z5\n'
    )
    program = read_program(text)
    curve = program.segments[1]
    assert curve.length == pytest.approx(5.0 * MM * math.pi, rel=1e-9)
    assert np.allclose(curve.curvatures(5), 100.0)
    assert np.allclose(np.linalg.norm(curve.points(7), axis=1), 10.0 * MM)
    assert program.segments[2].rapid
    without_first = text.replace('K0 X10 Y0 R1 F100', 'F100', 1)
    assert np.allclose(read_program(without_first).segments[1].points(3), curve.points(3))


def test_other_axes_keep_their_feed_only_where_they_move():
    program = read_program('G0 A0\nG1 X1 A0 F100\nX2 A5\nX3 A5\nX4\n')
    assert [part.turning for part in program.segments[1:]] == [False, True, False, False]
    assert [block.role for block in program.blocks[1:]] == [
        Role.FEED,
        Role.KEPT,
        Role.FEED,
        Role.FEED,
    ]
    assert program.runs == ((1, 2), (3, 5))


@pytest.mark.parametrize('stop', ['M0', 'M6 T2', 'G4 P1', 'G0 Z0', 'G92 X2', 'CYCLE81(1,2)'])
def test_a_stop_ends_a_run(stop):
    program = read_program(f'F100 G1 X1\nX2\n{stop}\nG1 X3 Y0 Z0\nX4\nM30\n')
    indices = [list(range(*run)) for run in program.runs]
    lines = [[program.segments[index].line for index in run] for run in indices]
    assert lines == [[1, 2], [5]] if stop.startswith('CYCLE') else lines == [[1, 2], [4, 5]]


def test_a_block_of_no_length_does_not_end_a_run():
    program = read_program('F100 G1 X1\nX1\nX2\nG1\n(note)\nX3\n')
    assert program.runs == ((0, 4),)
    assert program.blocks[1].role is Role.PLAIN


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('SUPA G0 X=_HOME\nG1 X1 F100\nX2\n', 'place of the machine'),
        ('G28 X0\nG1 X1 F100\nX2\n', 'place of the machine'),
        ('AROT Y90.\nG1 X1 F100 Y0 Z0\nX2\n', 'AROT'),
        ('G0 X#1\nG1 X1 F100\nX2\n', 'does not say'),
        ('G0 X[#1+2]\nG1 X1 F100\nX2\n', 'does not say'),
        ('G54\nG55\nG1 X1 Y0 Z0 F100\nX2\n', 'work offset'),
        ('F100 G87 X1 Y1 Z-1 R1\nX2\nG80 G1 X1 Y0 Z0\nX2\n', 'cycle'),
        ('F100 MCALL CYCLE81(1.)\nX5\nMCALL\nG1 X1 Y0 Z0\nX2\n', 'MCALL'),
        ('M98 P100\nG1 X1 Y0 Z0 F100\nX2\n', 'subprogram'),
        ('o100 call [1]\nG1 X1 Y0 Z0 F100\nX2\n', 'call of 100, which is not here'),
        ('L200\nG1 X1 Y0 Z0 F100\nX2\n', 'subprogram'),
        ('F100\nCYCLE800(1,"X",3)\nG1 X1 Y0 Z0\nX2\n', 'CYCLE800'),
        ('F100\nG5.1 I1 J1 X3\nG1 X1 Y0 Z0\nX2\n', 'G5.1'),
        ('G16\nG1 X1 Y45 F100\nG15 X1 Y0 Z0\nX2\n', 'polar'),
        ('F100\nG1 X1 RND=2\nX1 Y0 Z0\nX2\n', 'RND'),
    ],
)
def test_what_is_not_understood_is_passed_through_and_said_and_no_place_is_guessed(text, said):
    program = read_program(text)
    assert program.text == text
    assert any(said in str(note) for note in program.notes)
    parts = [segment for segment in program.segments if segment.length > 0.0]
    assert [segment.line for segment in parts] == [text.count('\n')]
    assert parts[0].length == pytest.approx(MM)


def test_a_feed_beside_a_change_of_units_is_said():
    assert 'as controllers differ' in str(read_program('G20 G1 X1 F10\n').notes[0])
    assert read_program('G21 G1 X1 F10\n').notes == ()


def test_words_without_meaning_here_are_silent_or_said_but_never_lost():
    text = (
        'DEF REAL _A, _B\n_A=.02 _B=-3.\nT="MILL D8" M6\nMSG("(half")\n'
        'G64 P0.01 G40 G94 S1000 M3\n'
    )
    program = read_program(text + 'G1 X1 F100\n')
    assert program.segments[0].schedulable
    notes = ' '.join(map(str, program.notes))
    assert 'declaration' in notes
    assert 'MSG' in notes


def test_feeds_that_are_no_length_per_time_are_left_alone():
    program = read_program('G93 G1 X1 F2\nX2 F3\nG95 X3 F0.1\nG94 X4 F100\n')
    assert [part.schedulable for part in program.segments] == [False, False, False, True]
    assert [block.word for block in program.blocks[:3]] == [None] * 3


def test_nothing_is_read_after_the_end():
    for last in ('M30', 'M2', '%'):
        text = f'%\nG1 X1 F100\n{last}\n) G1 this is ((no program X\n'
        program = read_program(text)
        assert program.text == text
        assert len(program.segments) == 1


def test_a_stream_gives_the_blocks_of_the_whole():
    text = 'G0 X1\r\nG5.2 F100 L3\nX2 Y1\rX4 Y5\nG5.3\n\nG1 X9'
    program = read_program(text)
    reader = ProgramReader()
    blocks = list(reader.blocks(iter(block.text for block in program.blocks)))
    assert [block.text for block in blocks] == [block.text for block in program.blocks]
    assert [block.role for block in blocks] == [block.role for block in program.blocks]
    assert [block.line for block in blocks] == list(range(1, 8))
    assert reader.notes == program.notes
    assert program.text == text


def test_samples_hold_all_corners_and_never_stand_apart_more_than_asked():
    program = read_program('G1 X10 F100\nX10\nG3 X10 Y20 J10\nG1 X0\nY0\n')
    path = sample_path(program.segments, 0.7 * MM)
    step = np.linalg.norm(np.diff(path.point, axis=0), axis=1)
    assert step.max() <= 0.7 * MM * (1.0 + 1e-12)
    assert step.min() > 0.5 * MM
    for segment in program.segments:
        assert (path.point == segment.end).all(axis=1).any()
    assert set(path.segment) == {0, 2, 3, 4}
    assert isinstance(program.segments[2], ArcSegment)
    bent = path.curvature > 0.0
    assert np.allclose(path.curvature[bent], 100.0)
    assert bent.sum() == (path.segment == 2).sum() + 1


def test_samples_refuse_gaps_and_nothing():
    program = read_program('G1 X1 F100\nG92 X5\nX6\n')
    with pytest.raises(ValueError, match=r'gap of 0\.004 m before line 3'):
        sample_path(program.segments, MM)
    with pytest.raises(ValueError, match='spacing above 0 but found 0'):
        sample_path(program.segments, 0.0)
    with pytest.raises(ValueError, match='found none'):
        sample_path([], MM)
