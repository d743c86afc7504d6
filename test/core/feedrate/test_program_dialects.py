# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Words that mean one thing on one controller and something else on another."""

import pytest

from fuzzycnc_ros.core.feedrate.gcode.blocks import Role
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program

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
    program = read_program(
        f'G21 G90\nG0 X0 Y0 Z5\n{line}\nG1 X10 F600\nG1 X20 Y0 Z5\nX30\nM30\n'
    )
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
