# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Programs that no machine follows, and whose motion would take for ever to find."""

import pytest

from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
from fuzzycnc_ros.core.feedrate.gcode.segments import ProgramError
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.schedule.program_run import BlockReader, ProgramRun
from fuzzycnc_ros.core.feedrate.schedule.program_settings import ProgramSettings
from fuzzycnc_ros.core.feedrate.schedule.scheduler import ConstantNormalAcceleration

CURVE = 'G21 G90\nG0 X0 Y0 Z0\nG5.2 X3 Y4 P{weight} L{order} F300\nX5 Y6\nX7 Y{y}\nX9 Y4\nG5.3\n'


@pytest.mark.parametrize('letter', ['X', 'Y', 'Z', 'I', 'J'])
@pytest.mark.parametrize('number', ['12345678', '-4294967296', '9' * 50])
def test_lengths_of_no_machine_are_refused(letter, number):
    text = f'G21\nF600\nG1 X0 Y0 Z0\nG2 X1 Y0 {letter}{number}\n'
    with pytest.raises(ProgramError, match=r'line 4: expected lengths up to 1e\+06 but found'):
        read_program(text)


@pytest.mark.parametrize(
    ('line', 'said'),
    [
        ('G2 X0 Y0 I1 J0 P100000000', 'no more than 1,001 turns of an arc but found 100,000,000'),
        ('G3 X0 Y0 Z5 I1 J0 P1002', 'no more than 1,001 turns of an arc but found 1,002'),
        ('G2 X0 Y0 I1 J0 TURN=2000', 'no more than 1,000 turns of an arc but found 2,000'),
        ('G4 P' + '9' * 200, r'at least 0 s and at most 1e\+07 s'),
        ('G1 X1 F0.' + '0' * 30 + '1', r'a feed from 0\.001 to 1e\+09 but found F1e-31'),
        ('G1 X1 F' + '9' * 200, r'a feed from 0\.001 to 1e\+09'),
        ('G1 X' + '9' * 100_000 + '!', 'finite number'),
        ('G1 X' + '1 ' * 50_000 + '!', 'finite number'),
        ('G1 X' + '[' * 100_000, 'unbalanced'),
        ('G1 X#[' + '-' * 100_000, 'unbalanced'),
        ('(' * 100_000, 'unbalanced'),
        ('G5.2 X1 Y1 P1 L3' + '\nX1 Y1' * 2000, 'at most 2,000 control points'),
    ],
)
def test_what_would_take_for_ever_is_refused_by_its_line(line, said):
    with pytest.raises(ProgramError, match=said) as caught:
        read_program(f'G21 G90\nG0 X0 Y0 Z0\nG1 Z1 F100\n{line}\n')
    assert caught.value.line == 4 + line.count('\n')


def test_the_turns_of_all_arcs_are_counted_in_loops_too():
    arc = 'G2 X0 Y0 I1 J0 P1000\n'
    head = 'G0 X0 Y0\nF100\n'
    assert len(read_program(head + 10 * arc).segments) == 11
    with pytest.raises(ProgramError, match='10,000 turns of all arcs of a program'):
        read_program(head + 11 * arc)
    loop = f'{head}o1 repeat [1000000000000]\n{arc}o1 endrepeat\n'
    with pytest.raises(ProgramError, match=r'line 4: .*10,000 turns of all arcs of a program'):
        read_program(loop)


def test_an_arc_whose_turns_the_control_computes_is_left_to_it():
    program = read_program('G0 X0 Y0\nF100\nG2 I1 P#5\nG1 X1 Y0 Z0\n')
    assert 'an arc whose P the controller computes' in str(program.notes[-1])


def test_many_turns_are_scheduled_in_parts():
    """Blocks are taken until their turns are many: memory does not grow with them."""
    parts = []
    text = 'G0 X0 Y0\nF100\n' + 'G2 X0 Y0 I0.01 J0 P700\n' * 6
    law = ConstantNormalAcceleration(feed_max=0.2, normal_acceleration=0.1)
    limits = MotionLimits(path_velocity=0.25, path_acceleration=1.5)
    program = read_program(text)
    run = ProgramRun(
        ProgramSettings(scheduler=law, limits=limits),
        BlockReader(program.blocks[2:]),
        parts.append,
    )
    assert [len(chunk) for chunk, _ in run._chunks()] == [3, 3, 0]


def test_a_cycle_that_is_repeated_for_ever_ends_nowhere():
    program = read_program('G91 F100\nG81 X1 Y1 Z-1 R1 L999999999\nG80 G90 G1 X0\nX1\n')
    assert [part.line for part in program.segments if part.schedulable] == []


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
