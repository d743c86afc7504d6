# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""O-words, M98 and expressions: run as LinuxCNC runs them, with feeds that hold in each pass."""

import math
from random import Random

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from programs.flow_programs import FlowProgram
from programs.rs274 import check_against, interpreted
from programs.slowed import slowed
from programs.without_feeds import strip_feeds

from fuzzycnc_ros.core.feedrate.gcode import reader
from fuzzycnc_ros.core.feedrate.gcode.blocks import FeedTally
from fuzzycnc_ros.core.feedrate.gcode.expressions import read_value
from fuzzycnc_ros.core.feedrate.gcode.reader import ProgramReader, read_program
from fuzzycnc_ros.core.feedrate.gcode.writer import write_blocks, write_program

MM = 1e-3
DIGIT = 1.1e-3 / 60e3  # of a feed word, and of what rs274 prints [m/s]


def ends(text, **options):
    """End points of all segments [mm]."""
    return [
        tuple(np.round(np.array(part.end) / MM, 6))
        for part in read_program(text, **options).segments
    ]


def allowed(program, feeds):
    """The feed of each line that holds in all of its passes [m/s]."""
    least, values = {}, iter(feeds)
    for block in program.blocks:
        feed = math.nan if block.segment is None else next(values)
        feed = block.feed if math.isnan(feed) else feed
        if block.insert and feed is not None:
            least[block.line] = min(feed, least.get(block.line, math.inf))
    return least


@pytest.mark.slow
@given(seed=st.integers(0, 10**6))
def test_random_programs_run_as_linuxcnc_runs_them(seed, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reader, 'PASSES', 3000)
        text = FlowProgram(Random(seed)).text()
        program = read_program(text)
        # Some run for ever, in LinuxCNC as well.
        assume(not any('more than' in note.text for note in program.notes))
        assert not any('kept from here' in note.text for note in program.notes)
        moves = interpreted(text, tmp_path_factory.mktemp('own'))
        check_against(program, moves)
        feeds = slowed(program, seed)
        written = write_program(program, feeds)
        assert strip_feeds(written) == strip_feeds(text)
        again = interpreted(written, tmp_path_factory.mktemp('new'))
    assert [move[:2] for move in again] == [move[:2] for move in moves]
    least = allowed(program, feeds)
    rows = zip(program.segments, feeds, moves, again, strict=True)
    for segment, feed, (_, _, own, _), (_, _, new, _) in rows:
        assert new <= own + DIGIT
        if not math.isnan(feed):
            assert new <= feed + DIGIT
            assert new == pytest.approx(least[segment.line], abs=DIGIT)


@pytest.mark.parametrize(
    ('expression', 'value'),
    [
        ('[2 ** 3 ** 2 + -2 ** 2]', 68.0),
        ('[1 + 2 * 3 - 4 / 8]', 6.5),
        ('[10 MOD 3 + 1 EQ 2 AND 1 LT 2]', 1.0),
        ('[-10 MOD 3]', 2.0),
        ('[1 XOR 0 OR 0]', 1.0),
        ('[0.30005 EQ 0.3]', 1.0),
        ('[1.00005 GE 1 + 10 * [2 LE 1]]', 1.0),
        ('-#31', -3.0),
        ('- [#31 + 1]', -4.0),
        ('#[30 + 1]', 3.0),
        ('##32', 3.0),
        ('#<A b>', 4.0),
        ('#<_ab>', 5.0),
        ('sin[30]', 0.5),
        ('ATAN[1] / [-1]', 135.0),
        ('ACOS[ASIN[1] - 89]', 0.0),
        ('FIX[-2.5]', -3.0),
        ('FUP[-2.5]', -2.0),
        ('ROUND[-2.5]', -3.0),
        ('SQRT[EXP[LN[16]]]', 4.0),
        ('[EXISTS[#<ab>] * 10 + EXISTS[#<none>]]', 10.0),
        ('#5421', 7.0),
        ('[#<_y> + #<_metric>]', 8.0),
    ],
)
def test_expressions_have_the_values_of_linuxcnc(expression, value, tmp_path):
    text = f'G21 G90\n#31=3\n#32=31 #<ab>=4 #<_AB>=5\nG0 X0 Y7 Z0\nG0 X{expression}\nM2\n'
    program = read_program(text)
    assert program.segments[-1].end[0] / MM == pytest.approx(value, abs=1e-9)
    check_against(program, interpreted(text, tmp_path))


@pytest.mark.parametrize(
    ('expression', 'value'),
    [
        # of x86's long number nearest to pi / 2, which is a little more: the sign counts
        ('COS[90]', -2.508278806334166e-20),
        ('SIN[180]', -5.016557612668332e-20),
        ('TAN[90]', -3.98679762981171e19),
        ('TAN[-45]', -1.0),
        ('SIN[-30]', -0.5),
        ('COS[1]', 0.9998476951563913),
        ('SIN[100000000000000000000]', -0.9920923197312241),
        ('ATAN[-0.0]/[-1]', -180.0),
        ('SIN[-0.0]', -0.0),
    ],
)
def test_turns_are_those_of_long_numbers_on_every_processor(expression, value):
    found = read_value(expression, 0)[0](None)
    assert (found, math.copysign(1.0, found)) == (value, math.copysign(1.0, value))


def test_a_line_sets_its_parameters_after_all_of_its_values_are_known(tmp_path):
    text = 'G21\n#31=1 #32=2\n#31=#32 #32=#31 G0 X#31 Y#32 Z0\nG0 X#31 Y#32\nM2\n'
    assert ends(text) == [(1.0, 2.0, 0.0), (2.0, 1.0, 0.0)]
    check_against(read_program(text), interpreted(text, tmp_path))


@pytest.mark.parametrize(
    'value',
    [
        '#31',
        '#5061',
        '[1 + #<_never set>]',
        '#<_hal[pin]>',
        '##5',
        '#5420',
        '#<_feed>',
        '#1=2+3',
        '[1 GE 1.00005]',
    ],
)
def test_what_only_the_controller_knows_stays_unknown(value):
    setting = value if '=' in value else f'#1={value}'
    program = read_program(f'F100\n{setting}\n#2=[#1*0]\nG1 X#2\nX1 Y0 Z0\nX2\n')
    assert [part.line for part in program.segments] == [6]
    assert 'does not say' in str(program.notes[0])


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('G0 X[1/0]\n', 'line 1: expected an expression that has a value'),
        ('#1=SQRT[-1]\n', 'line 1: expected an expression that has a value'),
        ('#1=[0-2]\nG0 X[#1**0.5]\n', 'line 2: expected an expression that has a value'),
        ('#1=1e9\nG0 X[2000000*2]\n', 'lengths up to 1e.06'),
        ('o1 if [' + 50 * '[' + '1' + 51 * ']' + '\no1 endif\n', 'at most 40 brackets'),
    ],
)
def test_expressions_without_a_value_are_refused(text, said):
    with pytest.raises(ValueError, match=said):
        read_program(text)


def written(text, share):
    """The program with each feed times a share."""
    program = read_program(text)
    feeds = [share * part.feed if part.schedulable else math.nan for part in program.segments]
    return write_program(program, feeds)


def test_a_line_in_a_loop_gets_one_word_for_all_of_its_passes():
    text = 'G0 X0 Y0 Z0\nF600\no1 repeat [3]\nG1 X10\nX0 F300\no1 endrepeat\nM2\n'
    # Line 4 runs at 600 first and at 300 then.
    assert written(text, 0.5).splitlines()[3:5] == ['G1 X10 F150.', 'X0 F150.']
    assert written(text, 1.0).splitlines()[3:5] == ['G1 X10 F300.', 'X0 F300']


def test_a_computed_feed_word_becomes_a_number_only_where_the_feed_is_another_one():
    text = 'G0 X0 Y0 Z0\n#1=600\no1 repeat [2]\nG1 X10 F#1 (there)\n#1=300\nG0 X0\no1 endrepeat\n'
    assert written(text, 1.0).splitlines()[3] == 'G1 X10 F300. (there)'
    single = text.replace('#1=300', '')
    assert written(single, 1.0) == single
    assert written(single, 0.5).splitlines()[3] == 'G1 X10 F300. (there)'


def test_a_condition_that_only_the_controller_knows_keeps_the_rest_as_it_is():
    text = (
        'o<far> sub\nG1 X0\no<far> endsub\nG0 X0 Y0 Z0\nG1 X10 F600\nG0 X20\no<far> call\nG1 X30\n'
        'G0 X0\no2 repeat [2]\no3 if [#<_hal[door]> GT 0]\no<far> call\no3 endif\n'
        'o2 endrepeat\nG1 X9\n'
    )
    program = read_program(text)
    note = next(str(note) for note in program.notes if 'kept from here' in note.text)
    assert note.startswith('line 10: kept from here on with its own feeds')
    assert 'line 11: if depends on #<_hal[door]>, which only the controller knows' in note
    lines = written(text, 0.5).splitlines()
    own = text.splitlines()
    # The subroutine may be called from where nobody knows, so it keeps its feed, and has it.
    changed = {at + 1: lines[at] for at in range(len(own)) if lines[at] != own[at]}
    assert changed == {
        5: 'G1 X10 F300.',
        6: 'G0 X20 F600.',
        8: 'G1 X30 F300.',
        9: 'G0 X0 F600.',
    }


def test_a_branch_that_only_ends_the_program_decides_nothing():
    text = 'o1 if [#<_task> EQ 0]\n(print, stop)\nM2\no1 endif\nF100 G1 X1\n'
    assert ends(text) == [(1.0, 0.0, 0.0)]


@pytest.mark.parametrize(
    'text',
    [
        'o1 while [0]\nG1 X1 F100\n',
        'o1 endsub\n',
        'o1 if\nG0 X1\no1 endif\n',
        'o<a> nonsense\n',
        '/o1 repeat [2]\nG0 X1\no1 endrepeat\n',
        'o1 sub\no1 call\no1 endsub\no1 call\nG0 X1\n',
        'o1 do\no1 while [1]\n',
        'M98 P#<_which>\n',
    ],
)
def test_programs_that_lead_nowhere_are_kept_and_said(text, monkeypatch):
    monkeypatch.setattr(reader, 'PASSES', 1000)
    program = read_program(text + 'M2\n')
    assert program.text == text + 'M2\n'
    assert program.notes


def test_a_subroutine_in_a_file_moves_the_tool_and_keeps_its_feeds():
    files = {'far': 'o<far> sub\nG1 X[#1 * 2] F600\no<far> endsub [#1 + 1]\nM2\n'}
    lines = ['G0 X0 Y0 Z0\n', 'o<far> call [5]\n', 'G1 X#<_value>\n', 'o<near> call\n', 'X20\n']
    reader = ProgramReader(follow=True, files=files.get)
    blocks = list(reader.blocks(lines))
    assert [block.text for block in blocks if block.line != 2] == [lines[0], *lines[2:]]
    assert blocks[3].segment is not None
    assert blocks[3].segment.end[0] == pytest.approx(10 * MM)
    assert not blocks[3].segment.schedulable
    part = next(block.segment for block in blocks if block.line == 3)
    assert part.schedulable
    assert part.end[0] == pytest.approx(6 * MM)
    assert part.feed == pytest.approx(600 * MM / 60)
    found = ' '.join(map(str, reader.notes))
    assert 'far.ngc: subroutine in a file of its own' in found
    assert 'call of near, which is not here' in found
    assert ''.join(write_blocks((block, None) for block in blocks)) == ''.join(lines)


def test_modes_are_saved_and_restored_but_the_feed_there_is_what_was_chosen():
    text = 'G21 G90\nF600\nM70\nG91 G20 F1\nM72\nG1 X1 Y0 Z0\nF100 X2\n'
    program = read_program(text)
    first, last = program.segments
    assert first.feed is None
    assert not first.schedulable
    assert last.end[0] == pytest.approx(2 * MM)
    assert last.feed == pytest.approx(100 * MM / 60)


@pytest.mark.parametrize(
    ('line', 'known'),
    [
        ('G20 F60', [False, True]),
        ('G20 F60 X1', [False, False, True]),
        ('G21 F60', [True, True]),
        ('G20', [True, True]),
    ],
)
def test_a_feed_beside_a_change_of_units_is_not_guessed(line, known):
    """LinuxCNC takes it in the old unit, GRBL in the new one."""
    program = read_program(f'G1 F100 Y1 X0 Z0\n{line}\nG1 X2\nF50 X3\n')
    assert [part.schedulable for part in program.segments[1:]] == known
    assert ('controllers differ' in ' '.join(map(str, program.notes))) is not all(known)


def test_a_long_part_is_not_followed_and_said(monkeypatch):
    monkeypatch.setattr(reader, 'LINES', 4)
    text = 'F100\no1 repeat [2]\nG91 G1 X1\no1 endrepeat\nG90 X1 Y0 Z0\nG1 X5 F100\n'
    program = read_program(text)
    assert program.text == text
    assert 'not followed: more than 4 lines' in str(program.notes[0])
    assert [part.line for part in program.segments if part.schedulable] == [6]


def cycles(random):
    """A program of fixed cycles, and a last move that shows where they end."""
    lines = [f'G21 G90 G{random.choice((17, 18, 19))} F100', 'G0 X1 Y2 Z3']
    lines.append(random.choice(('G98', 'G99')))
    kinds = ('G81', 'G82 P0.1', 'G83 Q1', 'G73 Q1', 'G85', 'G89 P0.1')
    for _ in range(random.randint(1, 3)):
        lines.append(random.choice(('G90', 'G91')))
        high, low = random.randint(2, 9), random.randint(-9, -1)
        lines.append(
            f'{random.choice(kinds)} X{high} Y{high} Z{high} R{high}'.replace(
                {'17': 'Z', '18': 'Y', '19': 'X'}[lines[0][9:11]] + str(high),
                {'17': 'Z', '18': 'Y', '19': 'X'}[lines[0][9:11]] + str(low),
            )
            + random.choice(('', ' L3'))
        )
        across = {'17': 'XY', '18': 'XZ', '19': 'YZ'}[lines[0][9:11]]
        lines += [f'{random.choice(across)}{random.randint(1, 9)}' for _ in range(2)]
        lines.append(random.choice(('G80', 'G0 X4 Y4 Z12', 'G98', 'G99')))
    return '\n'.join([*lines, 'G80', 'G91 G1 X1 Y1 Z1', 'M2', ''])


@pytest.mark.parametrize('seed', range(40))
def test_fixed_cycles_leave_the_tool_where_linuxcnc_does(seed, tmp_path):
    text = cycles(Random(seed))
    moves = interpreted(text, tmp_path)
    last = read_program(text).segments[-1]
    assert last.schedulable, text
    assert moves[-1][1][:3] == pytest.approx(last.end, abs=1e-7), text


@pytest.mark.parametrize(
    'text',
    [
        'G0 @5 ^30 Z0\nG1 ^90 F100\n@2\nG91 ^45\n@1 ^-10\nG90 @3 ^0 Z1\n',
        'G0 X2 Y0 Z0\no1 repeat [5]\nG91 G1 @-.1 ^[9*2] F50\no1 endrepeat\n',
    ],
)
def test_places_by_radius_and_angle_are_those_of_linuxcnc(text, tmp_path):
    text = f'G21 G90\n{text}M2\n'
    check_against(read_program(text), interpreted(text, tmp_path))


def test_cycles_by_angle_are_repeated_about_the_origin(tmp_path):
    text = 'G21 G99\nG0 X2 Y0 Z5\nG91 G81 R-1 Z-.5 ^60 L4 F10\nG80 G90 G1 Z9\nM2\n'
    last = read_program(text).segments[-1]
    assert last.schedulable
    assert interpreted(text, tmp_path)[-1][1][:3] == pytest.approx(last.end, abs=1e-7)


def test_commands_to_a_control_are_kept_and_text_behind_the_end_is_noted():
    text = (
        '$H\nG0 X0 Y0 Z0\nM3 $1 S100\nG1 X5 F100\n$J=G91 X10 F500\n%\nX7 Y0 Z0\nX8\n%\ntext (\nx\n'
    )
    program = read_program(text)
    assert program.text == text
    assert [part.line for part in program.segments] == [4, 8]
    found = [str(note) for note in program.notes]
    assert found[0].startswith('line 1: command to the control ($): kept')
    assert found[-1] == 'line 10: text after the end of the program: not read (2 times)'


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('o1 sub\nG1 X1 F1\no1 endsub\nM2\n', 'nothing moves'),
        ('G0 X1\nM2\n', 'only rapids, no motion with feed'),
        ('G93 G1 X1 F2\nM2\n', 'no feed may be chosen: 1 motions or calls keep their feed'),
        ('G1 X1 F100\nM2\n', 'the tolerance asks for no lower feed on the 1 blocks with one'),
    ],
)
def test_a_program_that_stays_as_it_is_has_a_reason(text, reason):
    tally = FeedTally()
    for block in read_program(text).blocks:
        free = block.segment is not None and block.segment.schedulable
        tally.take(block, block.feed if free else None)
    assert tally.reason.startswith(reason)
