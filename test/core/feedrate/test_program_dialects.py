# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Words that mean one thing on one controller and something else on another."""

import math

import numpy as np
import pytest

from fuzzycnc_ros.core.feedrate.gcode.blocks import Role
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import ProgramError

MM = 1e-3


def notes(program):
    """All notes of a program as one text."""
    return ' | '.join(map(str, program.notes))


def lengths(program):
    """Length of each segment that moves, by line [mm]."""
    return {
        part.line: round(part.length / MM, 6) for part in program.segments if part.length > 0.0
    }


@pytest.mark.parametrize(
    ('line', 'said'),
    [
        ('G70 I20. J15. L6', 'pattern of holes or pocket (G70)'),
        ('G70 L6 I20.', 'pattern'),
        ('N40 G71 I20. J15. K30. L6', 'pattern of holes or pocket (G71)'),
        ('G72 I20. J15. L6', 'pattern of holes or pocket (G72)'),
        ('G12 I10. D1 F500 Z-5.', 'pattern of holes or pocket (G12)'),
        ('G13 I2. K10. Q2. D1', 'pattern of holes or pocket (G13)'),
        ('G150 P100 X5. Y5. Z-3. Q1. D1', 'pattern of holes or pocket (G150)'),
        ('G70 P10 Q20', 'turning cycle (G70)'),
        ('G70 Q100', 'turning cycle (G70)'),
        ('G71 U2. R0.5', 'turning cycle (G71)'),
        ('G71 P10 Q20 U0.4 W0.1', 'turning cycle (G71)'),
        ('G71 P10 Q20 D2000 U0.4 W0.1', 'turning cycle (G71)'),
        ('G72 W2. R0.5', 'turning cycle (G72)'),
        ('G73 P10 Q20 U0.4 W0.1', 'turning cycle (G73)'),
        ('G75 X40. Z-20. P3000 Q5000 F0.1', 'turning cycle (G75)'),
        ('G20 HP=1', 'G20 HP=: motion to a place of the machine'),
        ('G21 HP=2', 'G21 HP=: motion to a place of the machine'),
    ],
)
def test_a_unit_word_beside_words_of_a_cycle_is_the_cycle(line, said):
    program = read_program(f'G21 G90\nG0 X0 Y0 Z5\n{line}\nG1 X10 F600\nG1 X20 Y0 Z5\nX30\nM30\n')
    assert said in notes(program)
    assert program.blocks[2].role in (Role.SEALED, Role.RAPID)
    # millimetres as before, and no place is guessed
    assert lengths(program) == {2: 5.0, 6: 10.0}


@pytest.mark.parametrize(
    'line', ['G70', 'N5 G70 G90', 'G70 T1 D1 M6', 'G70 G1 X0 F60', 'G70 S500 M3', 'G20']
)
def test_a_unit_word_by_itself_is_the_unit(line):
    program = read_program(f'G21 G90\nG0 X0 Y0 Z5\n{line}\nG1 X1 F600\nM30\n')
    assert lengths(program)[4] == 25.4


def test_an_arc_beside_a_unit_word_is_an_arc():
    program = read_program('G21\nG0 X0 Y0 Z5\nG71 G2 X10 Y0 I5 J0 F600\nG71 G2 X0 Y0 R10\n')
    assert [segment.line for segment in program.segments if segment.feed] == [3, 4]


NO_MOTION = r"""M84 X Y E ;Disable all steppers but Z
N10 M84 X Y
M17 X Y Z
M18 E
M115 U3.9.1 ; tell printer latest fw version
M104 S
M3 S
M220 S
M862.3 P "MK3S" ; printer model check
M117 Printing (layer 5
M117 It's X
M118 E1 hello "
M486 A"Cube (1).stl"
M1002 gcode_claim_action : 2
M620 S0A
M1006 A0 B10 L100 C37 D10 M60 E37 F10 N60
M201 X1000 Y1000 Z200 E5000
M205 X8.00 Y8.00 Z0.40 E1.50
M92 X80 Y80 Z400 E93
M107 X
M587 S"net (work" P"pass"
M291 P"Insert (tool" R"Now" S3
G92 E0
G10
G11
G10 S1
SET_VELOCITY_LIMIT ACCEL=1500 ACCEL_TO_DECEL=750
EXCLUDE_OBJECT_DEFINE NAME=part CENTER=120.5,100.2 POLYGON=[[1,2],[3,4]]
EXCLUDE_OBJECT_START NAME="a (b"
RESPOND MSG='it (x'
set_pressure_advance advance=0.04 extruder=extruder""".split('\n')

PRINT = 'M82\nG21 G90\nG1 X10 Y10 Z1 F3000\nX20 E1\n{}\nX30 E2\nX40\nM84\n'


@pytest.mark.parametrize('command', NO_MOTION)
def test_commands_that_move_nothing_are_kept_and_noted(command):
    program = read_program(PRINT.format(command))
    assert program.text == PRINT.format(command)
    # neither the place nor the feed is lost, and no word of theirs is a motion or a feed
    assert lengths(program) == {3: pytest.approx(14.177446879), 4: 10.0, 6: 10.0, 7: 10.0}
    assert all(segment.schedulable for segment in program.segments)
    assert [program.blocks[4].role, program.blocks[4].word] == [Role.PLAIN, None]
    assert any(note.line == 5 for note in program.notes)


@pytest.mark.parametrize(
    'command',
    [
        'G28 X Y',
        'G28 W',
        'G28 O',
        'G29 A',
        'M600 X10',
        'M98 P"wipe.g"',
        'PRINT_START BED=60 X',
        'G28',
    ],
)
def test_commands_that_may_move_are_kept_and_the_place_is_lost(command):
    program = read_program(PRINT.format(command).replace('X30 E2', 'X30 Y10 Z1 F3000'))
    found = lengths(program)
    assert 6 not in found
    assert found[7] == 10.0


@pytest.mark.parametrize(
    'text', ['G1 X', 'X', 'N10 G1 X10 Y', 'M5 G1 X', 'G1 X10 F', 'F', 'G2 X5 I R']
)
def test_a_motion_or_a_feed_without_its_number_is_still_refused(text):
    with pytest.raises(ProgramError, match='line 2: expected a number after'):
        read_program(f'G1 X1 F100\n{text}\n')


def test_printers_wait_in_milliseconds():
    program = read_program('M104 S200\nG4 P500\nG4 S2\nG1 X1 F60\n')
    assert [part.duration for part in program.segments[:2]] == [0.5, 2.0]
    assert read_program('G4 P5\n').segments[0].duration == 5.0


@pytest.mark.parametrize(
    'text',
    [
        'g 0 1 x 1 0 f 6 0 0 0',
        'G1 X1 0 F6000',
        'G01X 1 0 . 0 F 6 0 0 0 .',
        'n 1 0 g 1 x + 1 0 f 6000 (hi)',
        'g1 x [ 5 + 5 ] f[ 6 0 * 1 0 0 ]',
        'F6 000 o 1 0 0 sub\no100 endsub\nG1 X10',
    ],
)
def test_blanks_inside_of_words_are_ignored(text):
    text = text.replace(' o ', '\no ')
    segment = read_program(f'{text}\nM2\n').segments[-1]
    assert segment.length == pytest.approx(10.0 * MM)
    assert segment.feed == pytest.approx(0.1)


@pytest.mark.parametrize(
    'text',
    [
        'BEGIN PGM A MM\nTOOL CALL 1 Z S4000\n',
        '0  BEGIN PGM 14 MM\n1 L X+9 FMAX\n',
        '\ufeffBEGIN PGM A MM\n',
        '; Datei 14.h\n\n0 BEGIN PGM 14 MM\n',
        '\nTOOL CALL 1 Z S4000\nL X+9 FMAX\n',
        '1 BLK FORM 0.1 Z X+0 Y+0 Z-20\n',
        'begin pgm a inch\n',
        '%\nBEGIN PGM A MM\n2 TOOL CALL 1 Z S3000\n',
        '\r\n%\r\n0 BEGIN PGM A MM\r\n',
        '; a comment\n* - rough\n2 BEGIN PGM A MM\n',
    ],
)
def test_plain_text_of_heidenhain_is_recognised_wherever_it_begins(text):
    with pytest.raises(ProgramError, match="Heidenhain's plain-text language"):
        read_program(text)


def test_din_iso_of_heidenhain_is_told_from_a_program_number():
    with pytest.raises(ProgramError, match=r"line 1: .*Heidenhain's DIN/ISO \(%PART G71 \*\)"):
        read_program('%PART G71 *\nN10 G00 X+0 *\n')
    assert read_program('%O1000\nG21 G1 F100 X1\n').segments
    assert read_program('%1000 G71\nG1 F100 X1\n').segments


def test_a_feed_beside_the_first_unit_is_in_it():
    program = read_program('G20 F6\nG1 X1\nG20 X2\n')
    assert [segment.feed for segment in program.segments] == pytest.approx([6 * 25.4e-3 / 60] * 2)
    assert 'as controllers differ' in notes(program)
    # a change in the middle is 25 times as fast on one controller as on another
    program = read_program('G21 F60\nG1 X1\nG20 X2 F6\nX3\nF6 X4\n')
    assert [segment.schedulable for segment in program.segments] == [True, False, False, True]


FRAME = 'G21 G90\nG0 X0 Y0 Z5\nF600\n{}\nG1 X10\nG1 X20 Y0 Z5\nX30\nM30\n'


@pytest.mark.parametrize(
    'line',
    [
        'G68.2 X0 Y0 Z0 I0 J30 K0', 'G68.2', 'G68.3 R0', 'G69.1', 'G51.1 X0', 'G50.1', 'G53.1',
        'G54.4 P1', 'G43.4 H1', 'G43.5 H1', 'G234 H1', 'G254', 'G268 X0 Y0 Z0', 'TRAORI',
        'TRAORI(1)', 'TRAFOOF', 'TOROT', 'CYCLE800(1,"X",0)', 'PLANE SPATIAL SPA+0 SPB+45 SPC+0',
        'M128', 'FUNCTION TCPM F TCP AXIS POS',
    ],
)  # fmt: skip
def test_new_frames_lose_the_place(line):
    program = read_program(FRAME.format(line))
    assert lengths(program) == {2: 5.0, 7: 10.0}
    assert program.segments[-1].schedulable
    assert any(
        note.line == 4 and 'until all axes are named' in str(note) for note in program.notes
    )


@pytest.mark.parametrize(
    ('begin', 'end'),
    [
        ('G12.1', 'G13.1'), ('G112', 'G113'), ('G7.1 C30.', 'G7.1 C0'),
        ('G07.1 C30.', 'G07.1 C0.'), ('G107 C30.', 'G107'), ('TRANSMIT', 'TRAFOOF'),
        ('TRACYL(40)', 'TRAFOOF'),
        ('TRANSMIT(1)', 'TRAORI'), ('G51.2 P1 Q2', 'G50.2'), ('G137 C0', 'G136'),
    ],
)  # fmt: skip
def test_nothing_is_chosen_in_bent_coordinates(begin, end):
    text = FRAME.format(f'{begin}\nG1 X1 Y1 Z1\nX2 Y1 Z1\nG81 X1 Y1 Z-1 R1\nG80\n{end}')
    program = read_program(text)
    assert not [part for part in program.segments if part.line < 12 and part.schedulable]
    assert lengths(program)[12] == 10.0
    assert 'in the coordinates of' in notes(program)


def test_the_direction_of_a_tool_is_no_centre():
    program = read_program('G43.5 H1\nG1 X0 Y0 Z0 F600\nX1\nX2 I0.1 K0.9\nG49 X3 Y0 Z0\nX4 I1\n')
    assert [part.line for part in program.segments if part.schedulable] == [3, 6]


@pytest.mark.parametrize(
    ('first', 'second', 'same'),
    [
        ('G54.1 P1', 'G54.1 P2', False),
        ('G54.1 P1', 'G54.1 P1', True),
        ('G154 P1', 'G154 P3', False),
        ('G54', 'G54.1 P1', False),
        ('G54', 'G110', False),
        ('G500', 'G505', False),
        ('G505', 'G505', True),
    ],
)
def test_other_work_offsets_lose_the_place(first, second, same):
    program = read_program(f'{first}\nF60 G1 X0 Y0 Z0\nX1\n{second}\nX2\n')
    assert [part.line for part in program.segments if part.length] == ([3, 5] if same else [3])


LATHE = 'O1\nG21 G40\n{}\nG97 S500 M3\nT0101\nG0 X60. Z2.\nG98 G1 Z-20. F3000\nX64. Z-22.\n'


@pytest.mark.parametrize(
    'line',
    [
        *('G50 S2500', 'S2500 G50', 'G92 S2500', 'N5G92S#100', 'S2500 G92', 'G96 S180 M3'),
        *('S180 M3 G96', 'G71 P10 Q20 U.5 W.1', 'G28 U0 W0', 'G28 U0.', 'N7 G30 U0. W0.'),
        'G53 G0 W-10. U0',
    ],
)
def test_a_lathe_of_fanucs_kind_has_diameters_and_no_y(line):
    program = read_program(LATHE.format(line))
    # X64 from X60 is 2 mm, in the plane of X and Z
    assert lengths(program)[7] == 22.0
    assert lengths(program)[8] == pytest.approx(2.0 * 2**0.5, abs=1e-6)
    assert [part.line for part in program.segments if part.schedulable] == [7, 8]
    assert 'a lathe' in notes(program)


def test_words_of_lathes():
    text = LATHE.format('G50 S2500') + 'G2 U4. W-2. R2.\nG3 X70. Z-25. I0 K-1.\nG1 U2. W-1.\n'
    program = read_program(text)
    assert lengths(program)[9] == pytest.approx(math.pi, abs=1e-6)
    assert lengths(program)[10] == pytest.approx(0.5 * math.pi, abs=1e-6)
    assert lengths(program)[11] == pytest.approx(2.0**0.5, abs=1e-6)
    assert program.segments[-1].schedulable


def test_a_way_home_of_a_lathe_loses_the_axes_that_it_names():
    text = LATHE.format('G50 S2500') + 'G28 U0\nG1 W-5.\nG28 W0\nG1 X50.\nG1 X40. Z0\nX30.\n'
    program = read_program(text)
    # where X stands does not matter for a way along Z
    assert lengths(program)[10] == 5.0
    assert [part.line for part in program.segments if part.schedulable] == [7, 8, 14]


@pytest.mark.parametrize(
    ('line', 'chosen'),
    [
        ('G1 Z-9. F0.2', False),
        ('G99 G1 Z-9. F0.2', False),
        ('G95 G1 Z-9. F0.2', False),
        ('G98 G1 Z-9. F200', True),
        ('G94 G1 Z-9. F200', True),
    ],
)
def test_feeds_of_lathes_are_per_revolution_unless_they_say_per_minute(line, chosen):
    program = read_program(f'G50 S2500\nG0 X60. Z2.\n{line}\nX50. Z-9.\n')
    assert [part.schedulable for part in program.segments[1:]] == [chosen, chosen]


@pytest.mark.parametrize(
    'cycle',
    ['G90 X50. Z-20. F0.2', 'G92 X50. Z-20. F1.5', 'G94 X50. Z-20. F0.2', 'G32 Z-20. F1.5'],
)
def test_cycles_and_threads_of_lathes_are_no_moves(cycle):
    text = f'G50 S2500\nG98 F100\nG0 X60. Z2.\n{cycle}\nX48.\nG1 X50. Z0 F100\nX40.\n'
    program = read_program(text)
    assert [part.line for part in program.segments if part.schedulable] == [7]
    assert [block.role for block in program.blocks[3:5]] == [Role.SEALED] * 2


@pytest.mark.parametrize(
    'text',
    [
        'G50 S2500\nG0 X60. Y1. Z2.\n',  # a mill
        'G92 S2500\nT0101\nG96 S180\nG0 X60. Y1. Z2.\n',
        'G50 S2500\nG91\nG90 G0 X60. Z2.\n',  # a control on which U and W are axes
        'G91 G28 U0\nG90 G0 X60. Z2.\n',
        'G18 G7\nG96 D2500 S200\nG0 X60. Z2.\n',  # LinuxCNC
        'T101 M6\nG96 S200\nG0 X60. Z2.\n',
        'G8\nT101\nG96 S200\nG0 X60. Z2.\n',
        'G96 S200 LIMS=3000\nG0 X60. Z2.\n',  # Siemens
        'G96 S200 (T0101)\nG0 X60. Z2.\n',
        'G96 S200\nG0 X60. Z2.\n',  # a facing head may be U
        'G71\nG0 X60. Z2.\nG4 P1\n',  # millimetres of Siemens
        'G92 X0 Z0 S2500\nG0 X60. Z2.\n',  # a new place
        'G92.1 S2500\nG0 X60. Z2.\n',
        'G96 S200\nT0101\nG0 X60.\n',  # no Z
        'G50 (S2500)\nG0 X60. Z2.\n',
    ],
)
def test_other_programs_are_of_no_such_lathe(text):
    program = read_program(text + 'G98 G1 U5 F100\n')
    assert 'a lathe' not in notes(program)
    assert program.segments[-1].turning


def test_a_limit_of_the_spindle_shifts_nothing_anywhere():
    for word in ('G50 S2500', 'G92 S2500'):
        program = read_program(f'G1 X0 Y0 Z0 F100\n{word}\nX1\n')
        assert program.segments[-1].schedulable
        assert 'imit of the spindle' in notes(program)
    assert read_program('G1 X5 Y0 F100\nG92 X0 S2500\nX1\n').segments[-1].length == MM


def test_nobody_waits_for_an_axis_that_no_line_names():
    # of a laser, which has no Z, and of a lathe, which has no Y
    for text, line in (('G28\nG1 X0 Y0 F100\nX1\n', 3), ('G28\nG1 X0 Z0 F100\nX1\n', 3)):
        assert [part.line for part in read_program(text).segments if part.schedulable] == [line]
    # a subroutine in a file of its own may name it
    text = 'o<down> call\nG1 X0 Y0 F100\nX1\n'
    assert not any(part.schedulable for part in read_program(text).segments)


@pytest.mark.parametrize(
    ('words', 'length'),
    [
        ('G1 X100 F500', 100.0),
        ('G1 X3 Y4 F500', 5.0),
        ('G2 X10 Y0 I5 J0 F500', 5.0 * math.pi),
        ('G3 X0 Y10 R5 F500', 5.0 * math.pi),
        ('G2 I5 P2 Z1 F500', math.hypot(20.0 * math.pi, 1.0)),
        ('G0 Z-7', 7.0),
    ],
)
def test_a_relative_move_from_an_unknown_place_has_a_known_length(words, length):
    program = read_program(f'G21 G17\nG1 X1 Y1 Z1 F100\nG10 L2 P1 X0\nG91\n{words}\nM2\n')
    segment = program.segments[-1]
    assert segment.line == 5
    assert segment.length == pytest.approx(length * MM)
    assert not segment.schedulable
    assert not np.isfinite([segment.start, segment.end]).all()
    assert program.blocks[4].role is (Role.RAPID if words.startswith('G0') else Role.KEPT)


@pytest.mark.parametrize(
    'words', ['G90 X5', 'G1 X#5', 'G90.1 G2 X5 I5', 'G90 G1 Y3', 'G5.1 I1 J1 X3']
)
def test_no_length_is_guessed_where_the_place_counts(words):
    program = read_program(f'G1 X1 Y1 Z1 F100\nG10 L2 P1 X0\nG91\n{words}\nM2\n')
    assert [segment.line for segment in program.segments] == [1]
    assert program.blocks[3].role in (Role.KEPT, Role.SEALED)
