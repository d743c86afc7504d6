# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Part programs that say something impossible: the message names the line."""

import pytest

from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import ProgramError
from fuzzycnc_ros.core.feedrate.gcode.writer import write_program


@pytest.mark.parametrize(
    ('text', 'line', 'said'),
    [
        ('G1 X1 F100\n(open\n', 2, 'unbalanced parentheses'),
        ('G1 X1 F100\nG1 X2 )\n', 2, 'unbalanced parentheses'),
        ('G1 X1 F100\nCYCLE81(1,(2)\n', 2, 'unbalanced parentheses'),
        ('G1 X[1+2 F100\n', 1, 'unbalanced parentheses'),
        ('MSG("open)\n', 1, 'closing "'),
        ('G1 X1 F100\n\nG2 X9 Y9 I1 J0\n', 3, 'radius does not fit'),
        ('G1 X1 F100\nG2 X9 Y9 R1\n', 2, 'radius does not fit'),
        ('F100\nG2 R5\n', 2, r'expected an end \(X or Y\)'),
        ('F100 G18\nG2 Y4 R5\n', 2, r'expected an end \(Z or X\)'),
        ('F100\nG2 X0 Y0 R5\n', 2, 'full circle by its centre'),
        ('F100\nG2 X5\n', 2, r'expected a centre \(I or J\) or a radius'),
        ('F100\nG2 X0 Y0 I0 J0\n', 2, 'radius does not fit'),
        ('F100\nG2 I5 P0.5\n', 2, 'whole number of turns'),
        ('F100\nG2 I1000 P900\n', 2, r'1,000 m of an arc of several turns but found 5,655 m'),
        ('G0 X1\nG1 X2\n', 2, r'expected a feed above 0 \(F\).*none'),
        ('G0 X1\nG1 X2 F0\n', 2, 'but found 0'),
        ('G0 X1\nG1 X2 F-5\n', 2, 'but found F-5'),
        ('G1 X1 F100\nG93 X2 F2\nG94 X3\n', 3, 'expected a feed above 0'),
        ('G1 XNAN F100\n', 1, 'a number after X but found NAN'),
        ('G1 X nan F100\n', 1, 'a number after X'),
        ('G1 X-inf F100\n', 1, 'a number after X'),
        ('G1 F100 X\n', 1, 'a number after X'),
        ('G1 X' + '9' * 400 + ' F100\n', 1, 'a finite number'),
        ('G1 X1 F100\n\x7fELF\x02\x01\x00\n', 2, 'binary file'),
        ('PK\x03\x04', 1, 'binary file'),
        ('', 1, 'empty'),
        ('\n\n(only a comment)\n; and one more\n', 1, 'empty'),
        ('G0 X1\nG5.2 L3\nX2 Y2\nX3 Y5\nG5.3\n', 2, 'expected a feed above 0'),
        ('F100\nG5.2 L3\nX2 Y2\nG5.3\n', 2, 'at least 3 control points'),
        ('F100\nG5.2 L3\nX2\nG5.3\n', 3, 'expected X and Y'),
        ('F100\nG5.2 L3\nX2 Y3\nX3 Y3 P-1\nG5.3\n', 2, 'no NURBS curve begins here.*weight'),
        ('F100\nG5.2 L3\nX2 Y3\nM30\n', 4, 'control points only'),
        ('F100 G91\nG5.2 L3\nX2 Y3\n', 2, 'absolute'),
        ('F100\nG6.2 P2 K0 X0\nK0 X1\nK1\nG1 X1\n', 2, 'expected 4 knots'),
        ('F100\nG6.2 P2 K0 X0\nK1 X1\nK0\nK1\n', 2, 'never fall'),
        ('F100\nG6.2 P2 K0 X0\nX1\n', 3, 'a knot K in each line'),
        ('F100\nG6.2 P2 K0 X5\n', 2, 'where the tool stands'),
        ('F100\nG6.2 P1 K0 X0\n', 2, 'whole order P from 2'),
        ('F100\nG6.2 P2 K0 X0\n', 2, 'expected 3 knots'),
        ('F100\nG6.2 P2 K0 A0\n', 2, 'but found A'),
        ('F100\nG4 P-1\n', 2, 'at least 0 s'),
    ],
)
def test_impossible_programs_are_refused_with_the_line(text, line, said):
    with pytest.raises(ProgramError, match=said) as caught:
        read_program(text)
    assert caught.value.line == line
    assert str(caught.value).startswith(f'line {line}: expected') or 'no NURBS' in said


def test_units_are_known():
    with pytest.raises(ValueError, match="'mm' or 'inch' but found 'm'"):
        read_program('G0 X1\n', units='m')


@pytest.mark.parametrize(
    ('feeds', 'said'),
    [
        ([0.01], r'expected feeds of shape \(3,\).*\(1,\)'),
        ([0.01, 0.01, 0.01], 'line 1: expected no feed .NaN.'),
        ([float('nan'), 0.0, 0.01], 'line 2: expected a feed above 0 but found 0'),
        ([float('nan'), -1.0, 0.01], 'line 2: expected a feed above 0'),
        ([float('nan'), float('inf'), 0.01], 'line 2: expected a feed above 0'),
        ([float('nan'), 1e-9, 0.01], 'at least 0.001'),
    ],
)
def test_feeds_that_cannot_be_written_are_refused(feeds, said):
    program = read_program('G0 X1\nG1 X2 F100\nX3\n')
    with pytest.raises(ValueError, match=said):
        write_program(program, feeds)
