# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks cut into several along the same path."""

import shutil
import subprocess

import numpy as np
import pytest

from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.studies.programs.split_program import check_same_path, split_program

PROGRAM = (
    'G21 G90 G17\nG0 X1 Y2 Z3\nN10 G1 X10.1237 Y5.5 Z1 F600 (down)\nY20\nG2 X14.1 Y24.1 I4.1 J0\n'
    'G3 X20.123 Y30.123 Z2 I0 J6.023 F300\nG1 X0 Y0 Z0\nM2\n'
)
CUTS = [0.1, 0.5, 0.93]


def everywhere(program):
    return {index: CUTS for index, one in enumerate(program.segments) if one.schedulable}


def test_lines_and_arcs_keep_their_path():
    program = read_program(PROGRAM)
    text = split_program(program, everywhere(program))
    other = read_program(text)
    check_same_path(program, other)
    assert len(other.segments) == len(program.segments) + 3 * 5
    assert 'N10 G1 X10.1237 Y5.5 Z1 F600 (down)\n' in text
    for feed in (0.01, 0.005):
        lengths = [
            sum(one.length for one in each.segments if one.feed == pytest.approx(feed))
            for each in (program, other)
        ]
        assert lengths[0] == pytest.approx(lengths[1], abs=1e-8)
    assert split_program(program, {}) == PROGRAM


@pytest.mark.parametrize(
    'text',
    [
        'G91 G1 X10 F600\nX5\n',
        'G1 X10 F600\nG2 X20 R5\n',
        'G1 X10 F600\n/ X20\n',
        'G1 X10 F600\nG1 X20 Y[5+20]\n',
        'G1 X10 F600\nG2 X10 I5\n',
        'G1 X10 F600\nG64 P0.1 X30\n',
    ],
)
def test_what_says_more_is_left_whole(text):
    program = read_program(text)
    last = {index: CUTS for index, one in enumerate(program.segments) if one.line > 1}
    assert split_program(program, last) == text


def test_another_path_is_refused():
    program = read_program(PROGRAM)
    for old, new in (('Y20', 'Y20.001'), ('J6.023', 'J6.024'), ('M2', 'X1')):
        with pytest.raises(ValueError, match=r'expected|not on its path'):
            check_same_path(program, read_program(PROGRAM.replace(old, new)))
    bent = PROGRAM.replace('Y20\n', 'X10.13 Y12\nX10.1237 Y20\n')
    with pytest.raises(ValueError, match='not on its path'):
        check_same_path(program, read_program(bent))


@pytest.mark.skipif(shutil.which('rs274') is None, reason='LinuxCNC is not installed')
def test_linuxcnc_reads_the_same_path(tmp_path):
    program = read_program(PROGRAM)
    found = []
    for name, text in (('one', PROGRAM), ('two', split_program(program, everywhere(program)))):
        file = tmp_path / f'{name}.ngc'
        file.write_text(text)
        said = subprocess.run(
            ['rs274', '-g', str(file)], capture_output=True, text=True, check=True, cwd=tmp_path
        ).stdout
        feeds = [
            line.split(None, 2)[-1].split('(', 1)
            for line in said.splitlines()
            if 'STRAIGHT_FEED' in line or 'ARC_FEED' in line
        ]
        found.append(
            [(word.split()[-1], values.split(')')[0].split(',')) for word, values in feeds]
        )
    one, two = found
    assert len(two) == len(one) + 3 * 5
    # every block ends where it did, to the last digit that LinuxCNC prints; arcs have one centre
    ends = [two[index] for index in range(3, len(two), 4)]
    for (word, values), (other, same) in zip(one, ends, strict=True):
        assert word == other
        assert values == same
    arcs = [values[2:4] for word, values in two if word == 'ARC_FEED']
    for each in (arcs[:4], arcs[4:]):
        assert np.ptp(np.array(each, dtype=float), axis=0).max() <= 1e-4
