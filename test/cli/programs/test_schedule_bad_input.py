# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Bad input of `fuzzycnc schedule` ends with code 2 and one line, and nothing is written."""

import os
from pathlib import Path

import pytest

GOOD = 'G0 X0 Y0 Z0\nG1 X30 F6000\nG2 X40 I5\n'

PROGRAMS = {
    'unbalanced parentheses': ('G0 X0\nG1 X1 F60 (out\n', ['line 2', 'unbalanced', 'close']),
    'unopened parenthesis': ('G0 X0\nG1 X1 F60 out)\n', ['line 2']),
    'radius that does not fit': (
        'G0 X0 Y0\nF60\nG2 X10 Y0 R2\n',
        ['line 3', 'radius', 'at least 5 mm'],
    ),
    'Heidenhain': ('0  BEGIN PGM 14 MM\n1 L X+9 FMAX\n', ['line 1', 'BEGIN PGM', 'reads G-code']),
    'centre that does not fit': ('G0 X0 Y0\nF60\nG2 X10 Y0 I7\n', ['line 3', 'I and J']),
    'arc without an end': ('G0 X0 Y0\nF60\nG2 R5\n', ['line 3', 'end', 'X or Y']),
    'arc without a centre': ('G0 X0 Y0\nF60\nG2 X5\n', ['line 3', 'centre', 'radius']),
    'no feed': ('G0 X0 Y0 Z0\nG1 X10\n', ['line 2', 'feed above 0 (F)', 'none']),
    'feed of zero': ('G0 X0 Y0 Z0\nG1 X10 F0\n', ['line 2', 'feed above 0']),
    'negative feed': ('G0 X0 Y0 Z0\nG1 X10 F-5\n', ['line 2', 'above 0', 'F-5']),
    'nan': ('G0 X0 Y0 Z0 F60\nG1 XNAN\n', ['line 2', 'expected a number after X', 'NAN']),
    'infinite': ('G0 X0 Y0 Z0 F60\nG1 XINF\n', ['line 2', 'expected a number after X', 'INF']),
    'too large': (f'F60\nG1 X{"9" * 400}\n', ['line 2', 'finite number']),
    'empty': ('', ['line 1', 'empty']),
    'blank': ('\n\n  \n', ['line 1', 'empty']),
    'comments alone': ('(a)\n; b\n', ['line 1', 'empty']),
    'binary': ('G0 X0\n\x00\x01\x7fELF\n', ['line 2', 'binary file']),
    'curve without an end': (
        'G0 X0 Y0 Z0 F60\nG5.2 P1 L3\nX1 Y1\nG5.3\n',
        ['line 2', 'control points'],
    ),
}

OPTIONS = {
    'no unit': (('--tolerance', '0.01'), ['--tolerance', 'mm, um, m, inch', "'0.01'"]),
    'unknown unit': (('--tolerance', '0.01cm'), ['--tolerance', 'mm, um, m, inch', '0.01cm']),
    'no number': (('--tolerance', 'small'), ['--tolerance', 'number with a unit', 'small']),
    'zero': (('--tolerance', '0mm'), ['--tolerance', 'above 0', '0mm']),
    'negative': (('--tolerance=-0.01mm',), ['--tolerance', 'above 0', '-0.01mm']),
    'nan': (('--tolerance', 'nanmm'), ['--tolerance', 'above 0', 'nanmm']),
    'infinite': (('--tolerance', 'infmm'), ['--tolerance', 'above 0', 'infmm']),
    'huge': (('--tolerance', '1m'), ['tolerance', 'outside', '0.01']),
    'negative blend': (('--blend=-1um',), ['--blend', '0 or more', '-1um']),
    'feed without unit': (('--feed', '6000'), ['--feed', 'mm/min', "'6000'"]),
    'feed of zero': (('--feed', '0mm/min'), ['--feed', 'above 0']),
    'override without unit': (('--override', '1.2'), ['--override', 'expected %', '120%']),
    'override of zero': (('--override', '0%'), ['--override', 'above 0']),
    'unknown method': (('--method', 'magic'), ['method', 'log_fuzzy', 'magic']),
    'unknown units': (('--units', 'feet'), ['--units', 'mm or inch', 'feet']),
}

SECTION = '/**/feedrate_scheduler:\n  ros__parameters:\n'
MACHINES = {
    'velocity of 0': (
        SECTION + '    path_velocity: 0.0\n',
        ['line 3', 'path_velocity', 'outside'],
    ),
    'axis of 0': (
        SECTION + '    tolerance: 1e-5\n    axis_acceleration: [4.0, 0.0, 4.0]\n',
        ['line 4', 'axis_acceleration', 'outside'],
    ),
    'tolerance of 0': (SECTION + '    tolerance: 0.0\n', ['line 3', 'tolerance']),
    'nan': (SECTION + '    path_acceleration: .nan\n', ['line 3', 'path_acceleration']),
    'two axes': (SECTION + '    axis_velocity: [0.1, 0.1]\n', ['line 3', 'X, Y, Z', 'found 2']),
    'misspelt': (
        SECTION + '    path_velocty: 0.1\n',
        ['line 3', 'unknown parameter path_velocty', 'path_velocity?'],
    ),
    'text': (SECTION + '    feed_max: fast\n', ['line 3', 'feed_max', 'fast']),
    'unparsable': ('a: [\n', ['YAML', 'line']),
    'a list': ('- 1\n', ['line 1', 'sections such as feedrate_scheduler']),
    'empty': ('', ['sections such as feedrate_scheduler']),
    'other nodes': (
        '/**/recorder:\n  ros__parameters:\n    output: x\n',
        ['expected a section feedrate_scheduler'],
    ),
    'no parameters': ('/**/feedrate_scheduler:\n  tolerance: 1\n', ['line 2', 'ros__parameters']),
    'loops that do not settle': (
        '/**/simulated_machine:\n  ros__parameters:\n    axis_velocity_bandwidth: 9000.0\n',
        ['settle'],
    ),
}


@pytest.fixture
def part(fuzzycnc):
    Path('part.ngc').write_text(GOOD)
    return Path('part.ngc')


@pytest.fixture
def nothing(refused):
    """Refuse a command that must leave no file behind."""

    def command(*arguments, naming):
        before = sorted(path.name for path in Path().iterdir())
        line = refused('schedule', *arguments, naming=naming)
        assert sorted(path.name for path in Path().iterdir()) == before
        return line

    return command


@pytest.mark.parametrize('case', PROGRAMS)
def test_a_bad_program(nothing, case):
    text, naming = PROGRAMS[case]
    Path('part.ngc').write_text(text)
    line = nothing(
        'part.ngc', '--tolerance', '0.01mm', '--out', 'out.ngc', naming=['part.ngc:', *naming]
    )
    assert len(line) < 400


def test_a_fault_far_inside_leaves_nothing_behind(nothing):
    lines = [f'G1 X{x} Y{x % 2}' for x in range(9000)]
    Path('part.ngc').write_text('F600\n' + '\n'.join(lines) + '\nG2 X0 R1\n')
    Path('out.ngc').write_text('as it was')
    nothing(
        'part.ngc', '--tolerance', '0.01mm', '--out', 'out.ngc', naming=['line 9002', 'radius']
    )
    assert Path('out.ngc').read_text() == 'as it was'


@pytest.mark.parametrize('case', OPTIONS)
def test_a_bad_option(nothing, part, case):
    options, naming = OPTIONS[case]
    if not any(option.startswith('--tolerance') for option in options):
        options = ('--tolerance', '0.01mm', *options)
    nothing(part, '--out', 'out.ngc', *options, naming=naming)


@pytest.mark.parametrize('case', MACHINES)
def test_a_bad_machine_file(nothing, part, case):
    text, naming = MACHINES[case]
    Path('machine.yaml').write_text(text)
    nothing(
        part, '--tolerance', '0.01mm', '--machine', 'machine.yaml', '--out', 'out.ngc',
        naming=['machine.yaml:', *naming],
    )  # fmt: skip


def test_missing_files_and_directories(nothing, part):
    Path('folder').mkdir()
    common = ('--tolerance', '0.01mm', '--out')
    nothing('gone.ngc', *common, 'out.ngc', naming=['gone.ngc', 'nothing is there'])
    nothing('folder', *common, 'out.ngc', naming=['folder', 'directory'])
    nothing(part, *common, 'folder', naming=['folder: expected a file', 'directory'])
    nothing(part, *common, 'nowhere/out.ngc', naming=['nowhere/out.ngc', 'folder'])
    nothing(part, *common, 'part.ngc/out.ngc', naming=['part.ngc/out.ngc', 'folder'])
    nothing(
        part,
        *common,
        'out.ngc',
        '--machine',
        'gone.yaml',
        naming=['gone.yaml', 'nothing is there'],
    )
    nothing(part, *common, 'out.ngc', '--report', 'nowhere/a.html', naming=['nowhere/a.html'])
    nothing(part, '--tolerance', '0.01mm', naming=['--out'])


def test_an_output_that_may_not_be_written(nothing, part, monkeypatch):
    # what a folder of somebody else answers; the tests may run as root
    monkeypatch.setattr('os.access', lambda path, mode, **_: mode != os.W_OK)
    nothing(
        part,
        '--tolerance',
        '0.01mm',
        '--out',
        'out.ngc',
        naming=['--out out.ngc', 'may be written'],
    )
