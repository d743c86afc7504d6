# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Programs that no machine follows, and whose motion would take for ever to find."""

import pytest

from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import ProgramError

CURVE = 'G21 G90\nG0 X0 Y0 Z0\nG5.2 X3 Y4 P{weight} L{order} F300\nX5 Y6\nX7 Y{y}\nX9 Y4\nG5.3\n'


@pytest.mark.parametrize('letter', ['X', 'Y', 'Z', 'I', 'J'])
@pytest.mark.parametrize('number', ['12345678', '-4294967296', '9' * 50])
def test_lengths_of_no_machine_are_refused(letter, number):
    text = f'G21\nF600\nG1 X0 Y0 Z0\nG2 X1 Y0 {letter}{number}\n'
    with pytest.raises(ProgramError, match=r'line 4: expected lengths up to 1e\+06 but found'):
        read_program(text)


def test_other_numbers_may_be_large():
    assert len(read_program('N9999999 G1 X1 F10000000 S20000000\n').segments) == 1


@pytest.mark.parametrize(
    ('changes', 'complaint'),
    [
        ({'weight': 4294967296}, 'weights no more than 1e.06 times each other'),
        ({'weight': '0.0000001'}, 'weights no more than 1e.06 times each other'),
        ({'y': 2000000}, 'lengths up to'),
        ({'order': 40}, 'at least 40 control points'),
    ],
)
def test_curves_of_no_machine_are_refused(changes, complaint):
    good = {'weight': 1, 'order': 3, 'y': 4}
    assert len(read_program(CURVE.format(**good)).segments) == 2
    text = CURVE.format(**{**good, **changes})
    with pytest.raises(ProgramError, match=complaint):
        read_program(text)


def test_knots_that_run_together_are_refused():
    text = (
        'G21\nG0 X1 Y1 Z1\nG6.2 P3 K0 X1 Y1 Z1 F500\nK0 X2 Y2\nK0 X3 Y1\nK0.0000000000001 X4 Y1\n'
        'K1\nK1\nK1\n'
    )
    with pytest.raises(ProgramError, match='knots that are equal or 1e-09 of the domain apart'):
        read_program(text)
