# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from fuzzycnc_ros.core.deformation.stitched_program import StitchedProgram
from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import ProgramError

QUILT = """%
N10 G21 G90 G17
N20 G0 Z5
N30 G0 X40 Y30
N40 G1 Z-1 F300
N50 G1 X100 F1200 (base)
N60 X115 Y45
N70 G3 X100 Y60 I-15
N80 G1 X55 ; back
N90 G2 X40 Y45 J-15 (right)
N100 G1 Y30
N110 G0 Z5
N120 G0 X10
N130 G1 X10 Y50
M30
%
"""


def program(text, step=3e-3, **settings):
    return StitchedProgram(text.splitlines(keepends=True), step, **settings)


def zeros(found):
    return [np.zeros((sum(figure.steps) + 1, 2)) for figure in found.figures]


def rewritten(text, shift=(1e-4, -2e-4), **settings):
    """Return the program with every stitch but the first of a figure shifted."""
    found = program(text, **settings)
    offsets = zeros(found)
    for offset in offsets:
        offset[1:] = shift
    return found, ''.join(found.written(offsets))


def visited(text):
    """Return X and Y of all ends of moves [m]."""
    return np.array([segment.end[:2] for segment in read_program(text).segments])


def test_without_offsets_every_byte_stays():
    for text in (QUILT, QUILT.replace('\n', '\r\n'), QUILT.rstrip('\n%')):
        found = program(text)
        assert ''.join(found.written(zeros(found))) == text


def test_figures_go_from_rapid_to_rapid():
    found = program(QUILT)
    assert [figure.lines for figure in found.figures] == [[6, 7, 8, 9, 10, 11], [14]]
    first = found.figures[0]
    assert first.steps == [20, 7, 8, 15, 24, 5]
    assert first.kind == [2, 2, 1, 2, 1, 2]
    assert first.turn == [0, 0, 1, 0, -1, 0]
    path = first.path(6e-3, 3e-3)
    np.testing.assert_allclose(path.points[[0, -1]], [[40e-3, 30e-3]] * 2, atol=1e-12)
    arms = path.points[27:36] - [100e-3, 45e-3]
    np.testing.assert_allclose(np.hypot(*arms.T), 15e-3, rtol=1e-12)


def test_stitches_are_where_they_are_shifted_to():
    shift = (1e-4, -2e-4)
    found, text = rewritten(QUILT, shift)
    places = visited(text)
    wanted = np.concatenate(
        [np.concatenate(figure.points)[1:] + shift for figure in found.figures]
    )
    for point in wanted:
        assert np.abs(places - point).max(axis=1).min() < 0.6e-7


def test_everything_else_stays():
    _, text = rewritten(QUILT)
    lines = text.splitlines()
    assert lines[:5] == QUILT.splitlines()[:5]
    assert lines[5].startswith('N50 G1 X43.1 Y29.8 F1200 (base)')
    assert lines[6] == 'X46.1 Y29.8'
    assert any(line.startswith('N70 G1 X') for line in lines)
    assert next(line for line in lines if '(right)' in line).startswith('N90 G1 X')
    assert any(line.endswith('; back') for line in lines)
    assert lines[-2:] == ['M30', '%']
    # after a figure that ends beside its place the rapid names the other axis as well
    assert 'N120 G0 X10 Y30.' in lines
    assert 'N110 G0 Z5' in lines


def test_arcs_that_stay_get_their_motion_word_back():
    text = 'G0 X0 Y0\nG3 X30 Y0 I15 F600\nX60 I15\nG1 X90\nX120\n'
    found = program(text)
    offset = np.zeros((sum(found.figures[0].steps) + 1, 2))
    offset[3, 0] = 1e-4  # of the first arc alone
    new = ''.join(found.written([offset]))
    assert new.endswith('\nG3 X60 I15\nG1 X90\nX120\n')
    np.testing.assert_allclose(visited(new)[-1], visited(text)[-1])
    assert read_program(new).segments[-3].sweep == pytest.approx(np.pi)


def test_inches_and_the_last_line_without_an_ending():
    found, text = rewritten('G20 G90\nG0 X1 Y1\nG1 X1.5 F20', shift=(0.0, 2.54e-5))
    assert found.figures[0].steps == [4]
    assert (
        text
        == 'G20 G90\nG0 X1 Y1\nG1 X1.125 Y1.001 F20\nX1.25 Y1.001\nX1.375 Y1.001\nX1.5 Y1.001\n'
    )
    _, text = rewritten('G0 X1 Y1\nG1 X1.5 F20', shift=(0.0, 2.54e-5), units='inch')
    assert 'X1.5 Y1.001' in text


@pytest.mark.parametrize(
    ('text', 'line', 'message'),
    [
        ('G0 X1\nG1 X2 F100\n', 2, 'at least the stitch step of 3 mm but found 1.000 mm'),
        ('G91 G1 X9 F100\n', 1, r'relative coordinates \(G91\)'),
        ('G1 X9 Z1 F100\n', 1, 'another axis moving along'),
        ('G1 X9 A5 F100\n', 1, 'another axis moving along'),
        ('G41 D1\nG1 X9 F100\n', 2, 'cutter compensation'),
        ('/G1 X9 F100\n', 1, 'may be skipped'),
        ('G18 G3 X9 I4.5 F100\n', 1, 'another plane'),
        ('G2 X9 CR=5 F100\n', 1, 'words of the control'),
        ('G1 X9 F100\nG5.2 P1\nX9 Y9\nX12 Y3\nX15 Y0\nG5.3\n', 2, 'NURBS'),
        ('G0 X9\nG1 Z1 F100\nM30\n', 1, 'found none to stitch'),
        ('G1 X160 F100\n', 1, 'on the sheet of 150 x 100 mm'),
        ('G1 X9 F100\nG1 X\n', 2, 'X'),
        ('', 1, 'empty'),
    ],
)
def test_what_cannot_be_stitched_names_its_line(text, line, message):
    with pytest.raises(ProgramError, match=message) as caught:
        program(text, size=(0.15, 0.1))
    assert caught.value.line == line
