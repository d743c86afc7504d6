# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Words that mean one thing on one controller and something else on another."""

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
