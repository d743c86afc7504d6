# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Real part programs, written by others: read without loss, and as a real controller reads them.

The Siemens programs are from ElMoe/Production-Data-Set-for-Five-Axis-CNC-Milling-with-Multiple-
Changeovers, the others from winder/Universal-G-Code-Sender, both public repositories.
"""

import math

import numpy as np
import pytest
from programs.rs274 import check_against, interpreted
from programs.slowed import slowed
from programs.without_feeds import strip_feeds

from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import ArcSegment, ProgramError, sample_path
from fuzzycnc_ros.core.feedrate.gcode.writer import write_program

# Name, segments that may be scheduled, arcs, runs.
FILES = {
    'ccby-5axis/Keychain_Schluesselanhaenger.mpf': (547, 58, 14),
    'ccby-5axis/Bottle_opener_Flaschenoeffner.txt': (2651, 1553, 10),
    'ccby-5axis/Coordinate_system_representation_Achskreuz.mpf': (2037, 696, 168),
    'ugs/Gates_combined_R12.nc': (15904, 5748, 21),
    'ugs/arc_rword_test.gcode': (196, 168, 1),
    'ugs/comments.gcode': (0, 0, 0),
    'ugs/g17-g18-g19.gcode': (6, 6, 3),
    'ugs/no_spaces.gcode': (102, 0, 49),
    'ugs/rotation.ngc': (49965, 0, 825),
    'ugs/spiral.gcode': (8, 6, 1),
}
LONG = ('ugs/Gates_combined_R12.nc', 'ugs/rotation.ngc')
FOR_LINUXCNC = [name for name in FILES if name.startswith('ugs') and 'no_spaces' not in name]

PROGRAM = """G21 G90 G17 G40 G64 P0.01
G0 X0 Y0 Z5
G1 Z-1.5 F120
g1x10y0f600(out)
G2 X20 R5
G3 X10 Y10 R-10 F333.25
G3 I-3 J4 P2
G91 G1 X1.5 Y-.5
G2 X2 Y-2 J-2
G90.1 G90 G3 I20 J10 F2000
"""


def long_ones_are_slow(names):
    """Return names of programs, those that take seconds marked."""
    return [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in names]


def read(path):
    return path.read_bytes().decode('utf-8', errors='surrogateescape')


def shape(part):
    """All that a segment's path is made of."""
    bent = (part.centre, part.sweep) if isinstance(part, ArcSegment) else None
    return type(part), part.start, part.end, bent


@pytest.fixture(scope='module')
def gcode(data):
    return data / 'gcode'


@pytest.mark.parametrize('name', long_ones_are_slow(FILES))
def test_a_real_program_is_read_and_written_without_loss(gcode, name):
    text = read(gcode / name)
    program = read_program(text)
    assert program.text == text
    arcs = sum(isinstance(segment, ArcSegment) for segment in program.segments)
    free = sum(segment.schedulable for segment in program.segments)
    assert (free, arcs, len(program.runs)) == FILES[name]
    feeds = slowed(program, 2)
    written = write_program(program, feeds)
    assert strip_feeds(written) == strip_feeds(text)
    again = read_program(written)
    assert [shape(part) for part in again.segments] == [shape(part) for part in program.segments]
    asked, own, new = np.array(
        [
            (feed, *(math.nan if part.feed is None else part.feed for part in (old, new)))
            for feed, old, new in zip(feeds, program.segments, again.segments, strict=True)
        ]
    ).T
    free = ~np.isnan(asked)
    assert (new[free] <= asked[free] * (1.0 + 2e-9)).all()
    assert (new[free] >= asked[free] * 0.999).all()
    kept = np.array([part.turning and part.feed is not None for part in program.segments])
    assert np.allclose(new[kept], own[kept], rtol=1e-4, atol=0.0)


@pytest.mark.parametrize('name', ['ugs/Gates_combined_R12.nc', 'ugs/spiral.gcode'])
def test_samples_of_a_real_program_are_as_long_as_its_segments(gcode, name):
    program = read_program(read(gcode / name))
    for first, last in program.runs:
        part = program.segments[first:last]
        path = sample_path(part, 5e-5)
        length = np.linalg.norm(np.diff(path.point, axis=0), axis=1).sum()
        assert length == pytest.approx(sum(segment.length for segment in part), rel=1e-4)


@pytest.mark.parametrize('name', long_ones_are_slow(FOR_LINUXCNC))
def test_linuxcnc_reads_the_same_path_and_feeds(gcode, name, tmp_path):
    program = read_program(read(gcode / name))
    check_against(program, interpreted(program.text, tmp_path))


@pytest.mark.parametrize('name', long_ones_are_slow(FOR_LINUXCNC))
def test_linuxcnc_reads_the_same_path_and_the_new_feeds(gcode, name, tmp_path):
    program = read_program(read(gcode / name))
    written = write_program(program, slowed(program, 3))
    check_against(read_program(written), interpreted(written, tmp_path))


def test_linuxcnc_reads_the_same_arcs(tmp_path):
    program = read_program(
        PROGRAM + 'G91.1 G20\nG1 X1 F10\nG91 G18 G2 X1 Z1 K1\nG19 G3 Y1 Z2 R4\nM2\n'
    )
    check_against(program, interpreted(program.text, tmp_path))
    written = write_program(program, slowed(program, 4))
    check_against(read_program(written), interpreted(written, tmp_path))


LATHE = """G21 G18 G90 G7 F200
G0 X24 Z3
G2 X30 Z6 I0 K3
G90.1 G3 X32 Z7 I15 K7
G91.1 G3 X34 Z8 R1
G91 G1 X4 Z1
G90 X[2*#5420]
X[20*#<_lathe_diameter_mode>] Z[10*#<_lathe_radius_mode>]
G92 X12
G1 X14
G0 X40 Z2
M70
G8 X5
M72
X6
G91 X2
G90 G8 X3
G7 X3
M2
"""


def test_linuxcnc_reads_the_same_diameters(tmp_path):
    program = read_program(LATHE)
    check_against(program, interpreted(LATHE, tmp_path))


def ends(text):
    """Last X of each line that moves [mm]."""
    return [round(1e3 * part.end[0], 6) for part in read_program(text).segments]


def test_x_of_a_lathe_is_a_diameter():
    assert ends('G18 G7 G0 X20\nG91 X4\nG8 X4\nG90 X20\n') == [10.0, 12.0, 16.0, 20.0]
    # The words of Siemens' controls: relative ones are lengths with DIAM90.
    said = 'DIAMON\nG0 X20\nG91 X4\nDIAM90\nX4\nG90 X20\nDIAMOF\nX20\n'
    assert ends(said) == [10.0, 12.0, 16.0, 10.0, 20.0]
    assert ends('G18 G7 G0 X20 Y0 Z5\nG81 Y-2 R1 X8 F100\nG98 X10\nG80\nG1 X4 Y1\n')[-1] == 2.0
    arc = read_program('G18 G7 F100\nG0 X24 Z3\nG2 X30 Z6 I0 K3\n').segments[-1]
    assert arc.length == pytest.approx(0.5e-3 * math.pi * 3.0)
    curve = read_program('G7 F100\nG0 X0 Y0\nG5.2 X2 Y1\nX8 Y0\nX12 Y2\nG5.3\n').segments[-1]
    assert curve.end == pytest.approx((6e-3, 2e-3, 0.0))


@pytest.mark.parametrize(
    ('text', 'remedy'),
    [
        ('G0 X-40 Y50\nG3 X-30 Y40 I-40 J40', 'write G90.1 above, if the control reads them so'),
        ('G90.1 G0 X-40 Y50\nG3 X-30 Y40 I0 J-10', 'write G91.1 above, if the control reads'),
        ('G0 X192.735 Z0\nG3 X193.84 Z-.366 I0 K-.6', 'K lies outside of the plane G17'),
        ('G18 G0 X192.735 Z0\nG3 X193.84 Z-.366 I0 K-.6', 'X would fit as a diameter: write G7'),
        ('G18 G90.1 G0 X4 Z3\nG3 X8 Z5 I4 K3', 'X would fit as a diameter: write G7'),
        ('G0 X0 Y0\nG2 X10 Y0 I4 J0', 'check I and J, which are read as relative to the start'),
    ],
)
def test_an_arc_that_does_not_fit_is_told_what_would(text, remedy):
    with pytest.raises(ProgramError, match=f'line 2: .* the radius does not fit; .*{remedy}'):
        read_program('F100 ' + text)
