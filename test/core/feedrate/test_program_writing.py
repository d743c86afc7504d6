# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Programs with new feeds: nothing but feed words changes, and nothing runs faster than said."""

import math
import re
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from programs.slowed import slowed
from programs.without_feeds import strip_feeds

from fuzzycnc_ros.core.feedrate.gcode.blocks import Role
from fuzzycnc_ros.core.feedrate.gcode.reader import ProgramReader, read_program
from fuzzycnc_ros.core.feedrate.gcode.writer import write_blocks, write_program

NAN = math.nan

lines = st.sampled_from(
    [
        'G1 X1 F600',
        'X2.5(to the right)',
        'N7Y3',
        'G0 X0 Y0 Z0',
        'G0 Z5 F250. ; raise',
        'G3 X{x} I1 F120',
        'G2 I2.',
        'G91 X0.5',
        'G90',
        'G20 F30',
        'G21 F700',
        'F900',
        'g1x4f1200z-1',
        '/G1 X3 F50',
        'G4 F2',
        'G4 P1',
        'M3 S1000',
        'G1 F=333 X=7.',
        'G1 A{x} X{x}',
        'SUPA G0 X=_HOME',
        'CYCLE81(10.,0.,3.)',
        'MCALL CYCLE81(1.)',
        'MCALL',
        'G55',
        'M98 P7',
        'F500',
        'G93 G1 X2 F4',
        'G94 F350',
        '(F100)',
        '',
    ]
)


@st.composite
def programs(draw):
    """Text that any controller of both families could hold in parts."""
    body = draw(st.lists(lines, min_size=1, max_size=40))
    ending = draw(st.sampled_from(['\n', '\r\n']))
    text = ['G0 X0 Y0 Z0 F444']
    for line in body:
        if line.startswith('G3'):
            text += ['G90 G1 X0 Y0 F444', 'G91 G3 X2 Y0 I1', 'G90 G1']
        elif line.startswith('G2 '):
            text += [line, 'G1']
        else:
            text.append(line.format(x=draw(st.integers(0, 3))))
    return ending.join(text) + draw(st.sampled_from(['', ending]))


def chosen(program, seed):
    """Feeds for what is schedulable, some of them kept."""
    generator = np.random.default_rng(seed)
    return [
        generator.choice([1e-4, 0.0123456789, 0.05, segment.feed, NAN])
        if segment.schedulable
        else NAN
        for segment in program.segments
    ]


@settings(deadline=None, max_examples=60)
@given(text=programs(), seed=st.integers(0, 99))
def test_only_feed_words_change_and_each_block_runs_with_its_feed(text, seed):
    program = read_program(text)
    feeds = chosen(program, seed)
    written = write_program(program, feeds)
    assert strip_feeds(written) == strip_feeds(text)
    again = read_program(written)
    assert len(again.blocks) == len(program.blocks)
    assert again.runs == program.runs
    for old, new, feed in zip(program.segments, again.segments, feeds, strict=True):
        assert np.array_equal([old.start, old.end], [new.start, new.end], equal_nan=True)
        if old.schedulable:
            asked = old.feed if math.isnan(feed) else feed
            assert min(asked, old.feed) * 0.99 <= new.feed <= asked * (1.0 + 2e-9)
    for old, new in zip(program.blocks, again.blocks, strict=True):
        if old.role is Role.KEPT:
            assert (new.feed is None) == (old.feed is None)
            assert new.feed is None or new.feed == pytest.approx(old.feed, rel=1e-3)
        if old.role is Role.SEALED and old.feed is not None:
            assert new.feed is not None
            assert new.feed <= old.feed * (1.0 + 2e-9)


@settings(deadline=None, max_examples=60)
@given(text=programs(), seed=st.integers(0, 99))
def test_a_stream_writes_what_the_whole_writes(text, seed):
    program = read_program(text)
    feeds = iter(chosen(program, seed))
    asked = [None if block.segment is None else next(feeds) for block in program.blocks]
    whole = ''.join(write_blocks(zip(program.blocks, asked, strict=True)))
    if not all(feed is None or math.isnan(feed) for feed in asked):
        assert whole == write_program(program, chosen(program, seed))
    reader = ProgramReader()
    blocks = reader.blocks(block.text for block in program.blocks)
    assert ''.join(write_blocks(zip(blocks, asked, strict=True))) == whole


@settings(deadline=None, max_examples=60)
@given(text=programs())
def test_without_feeds_the_text_is_the_text(text):
    program = read_program(text)
    assert program.text == text
    assert write_program(program) == text
    assert write_program(program, np.full(len(program.segments), NAN)) == text


def test_a_word_stands_only_where_the_feed_changes():
    program = read_program('G0 X0\nG1 X1 F600\nX2 ; two\nX3\nX4 (four)\nX5\nM30\n')
    assert write_program(program, [NAN, 0.01, 0.005, 0.005, 0.01, 0.01]) == (
        'G0 X0\nG1 X1 F600\nX2 F300. ; two\nX3\nX4 F600. (four)\nX5\nM30\n'
    )


def test_inches_get_more_digits_and_no_feed_is_rounded_up():
    program = read_program('G20\nG1 X1 F10\nG21 X30\n')
    feed = 0.00123456
    unit, inch, metric = write_program(program, [feed, feed]).splitlines()
    assert (unit, inch, metric) == ('G20', 'G1 X1 F2.91628', 'G21 X30')
    again = read_program(f'{unit}\n{inch}\n{metric}\n')
    assert all(segment.feed <= feed for segment in again.segments)


def test_before_a_cycle_the_feed_of_the_program_is_back():
    text = 'G1 X1 F600\nX2\nG0 Z5\nM5\nCYCLE81(1,2)\n'
    assert write_program(read_program(text), [0.005, 0.004, NAN]) == (
        'G1 X1 F300.\nX2 F240.\nG0 Z5 F600.\nM5\nCYCLE81(1,2)\n'
    )


def test_a_cycle_without_a_rapid_before_it_runs_slower_rather_than_faster():
    text = 'G1 X1 F600\nX2\nCYCLE81(1,2)\n'
    program = read_program(text)
    slower = write_program(program, [0.005, 0.004])
    assert slower == 'G1 X1 F300.\nX2 F240.\nCYCLE81(1,2)\n'
    assert write_program(program, [0.005, 0.02]) == 'G1 X1 F300.\nX2 F600.\nCYCLE81(1,2)\n'


def test_the_feed_of_a_curve_stands_before_its_points():
    text = 'G0 X0\nG5.2 L3 P1 F600\nX1 Y1\nX2 Y0\nG5.3\nG1 X3\n'
    program = read_program(text)
    assert write_program(program, [NAN, 0.005, 0.01]) == text.replace('F600', 'F300.').replace(
        'X3', 'X3 F600.'
    )
    inside = read_program(text.replace('X1 Y1', 'X1 Y1 F500'))
    assert inside.blocks[1].role is Role.KEPT


def test_a_block_that_may_be_skipped_settles_no_feed():
    program = read_program('G1 X1 F600\n/X2\nX3\nX4\n')
    assert program.runs == ((0, 1), (2, 4))
    slower, faster = ([feed, NAN, 0.005, 0.005] for feed in (0.005, 0.02))
    assert write_program(program, slower) == 'G1 X1 F300.\n/X2\nX3 F300.\nX4\n'
    assert write_program(program, faster) == 'G1 X1 F600\n/X2\nX3 F300.\nX4\n'


def test_many_lines_without_motion_are_not_held_back():
    reader = ProgramReader()
    count = 0

    def source():
        nonlocal count
        yield 'G1 X1 F600\n'
        for _ in range(5000):
            count += 1
            yield 'M8\n'

    feeds = (
        (block, None if block.segment is None else 0.005) for block in reader.blocks(source())
    )
    written = write_blocks(feeds)
    assert next(written) == 'G1 X1 F300.\n'
    assert count <= 1001


def test_stripping_leaves_comments_dwells_and_names_alone():
    text = 'N1 G1 X1 F600 (F7)\nG4 F2\nF9\nFNORM G1 F=12. X3\nMSG("F100 G4")\n'
    assert strip_feeds(text) == ('N1 G1 X1 (F7)\nG4 F2\n\nFNORM G1 X3\nMSG("F100 G4")\n')


CUT = 'G21 G90 G17\nG1 X0 Y0 Z0 F6000\nX10 Y0\nX10.1 Y0.1\n'


@pytest.mark.parametrize('call', ['G65 P100', 'M98 P1000', 'MYMACRO', 'o<foo> call', 'GOTO 9'])
@pytest.mark.parametrize('before', ['', 'o<bar> sub\no<bar> endsub\n'])
def test_a_call_that_nobody_knows_finds_the_feed_of_the_program(call, before):
    """It may run with the feed in effect, and so may what follows until the next feed word."""
    text = f'{CUT}{before}G0 Z50\n{call}\nG1 X50 Y0\nX0 Y0 Z0\nX1 F500\nM30\n'
    program = read_program(text)
    feeds = [0.001 if part.schedulable else math.nan for part in program.segments]
    written = write_program(program, feeds)
    assert written.startswith('G21 G90 G17\nG1 X0 Y0 Z0 F6000\nX10 Y0 F60.\n')
    assert f'G0 Z50 F6000.\n{call}\nG1 X50 Y0\nX0 Y0 Z0\nX1 F60.\n' in written


def jumping(random):
    """A program of lines that other lines jump to, on conditions that nobody knows."""
    lines = ['G21 G90 G1 X0 Y0 Z0 F9000']
    for number in range(1, 25):
        name = f'N{number} ' if random.random() < 0.8 else ''
        if random.random() < 0.15:
            lines.append(f'{name}IF[#501LT5]GOTO{random.randint(1, 24)}')
            continue
        move = random.choice(['', '', '', 'G1 ', 'G1 ', 'G0 '])
        place = f'X{random.randint(0, 9)} Y{random.randint(0, 9)}'
        height = f' Z{random.randint(0, 2)}' if random.random() < 0.8 else ''
        feed = f' F{random.randint(1, 90)}00' if random.random() < 0.35 else ''
        lines.append(f'{name}{move}{place}{height}{feed}')
    return '\n'.join([*lines, 'M30', ''])


def driven(lines, decisions):
    """Feeds in effect of the lines in the order in which a controller runs them, and the lines."""
    feed, at, found = 0.0, 0, []
    place = {match[1]: n for n, line in enumerate(lines) if (match := re.match(r'N(\d+) ', line))}
    for jumps in decisions:
        line = lines[at]
        if word := re.search(r'F(\d+\.?\d*)', line.split('IF')[0]):
            feed = float(word[1])
        found.append((at, feed))
        target = re.search(r'GOTO(\d+)', line)
        at = place[target[1]] if target and jumps and target[1] in place else at + 1
        if at == len(lines):
            break
    return found


@pytest.mark.parametrize('seed', range(25))
def test_no_jump_brings_a_feed_above_that_of_the_program(seed):
    random = Random(seed)
    text = jumping(random)
    program = read_program(text)
    written = write_program(program, slowed(program, seed))
    assert strip_feeds(written) == strip_feeds(text)
    for _ in range(20):
        decisions = [random.random() < 0.5 for _ in range(200)]
        own, new = (driven(lines.splitlines(), decisions) for lines in (text, written))
        assert [at for at, _ in new] == [at for at, _ in own]
        assert all(fast <= feed for (_, fast), (_, feed) in zip(new, own, strict=True))


@pytest.mark.parametrize(
    ('jump', 'kept'),
    [
        ('GOTO 20', 1),
        ('IF[#1EQ0]GOTO20', 1),
        ('IF R1<5 GOTOB N20', 1),
        ('M99 P20', 1),
        ('M97 P20', 1),
        ('REPEAT N20 N30 P=3', 1),
        ('IF [VC1 EQ 1] N20', 1),
        ('GOTOF LABEL', 0),
        ('GOTO 0020', 1),
        (f'GOTO {"2" * 5000}', 0),
        (f'N{"2" * 50} GOTO 20', 1),
        ('(GOTO 20)', 0),
        ('GOTO 70', 0),
        ('GOTO#1', 2),
    ],
)
def test_lines_that_a_jump_may_lead_to_keep_their_feed(jump, kept):
    lines = f'G90 G1 X0 Y0 Z0 F600\nN10 X5\nX6\nN20 X9\n{jump}\nM30\n'
    program = read_program(lines)
    told = [note for note in program.notes if 'a jump may come here' in note.text]
    assert sum(note.count for note in told) == kept
    free = [part.line for part in program.segments if part.schedulable]
    assert free == {0: [2, 3, 4], 1: [2, 3], 2: []}[kept]


def test_rounded_corners_of_fanuc_keep_their_feed():
    program = read_program('G90 G1 X5 F600\nX50 ,R2.\nX60 Y5 ,C2.\nX0 Y9,A135\nX1 Y0, Z2\nX9\n')
    assert [part.line for part in program.segments if part.schedulable] == [1, 6]
    assert [str(note) for note in program.notes][:1] == [
        'line 2: a motion with ,R: passed through with its own feed'
    ]


def test_increments_of_lathes_leave_the_place_unknown():
    """U, V and W are axes of their own, or X, Y and Z by increments: nobody says which."""
    text = 'G90 G1 X5 Y5 Z5 F600\nZ0\nU4\nZ3\nX9\nY3\nX9 U9 W2\nZ1\nX1\n'
    program = read_program(text)
    assert [part.line for part in program.segments if part.schedulable] == [1, 2, 6, 9]
    assert read_program('G1 X5 F600\nG2 X9 I2\nG1 X5 F0.1\nY1\n').notes[-1].text == (
        'feed below 1 mm/min: if it is one per revolution, say G95'
    )
