# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc machine`: new, show, check; and the commands that take a machine file."""

import json
import os

import pytest

INI = """[TRAJ]
COORDINATES = XYZ
LINEAR_UNITS = mm
[AXIS_X]
MAX_VELOCITY = 100
MAX_ACCELERATION = 500
"""
PROGRAM = 'G21 G17 G90\nG0 X0 Y0\nG1 X10 F6000\nG3 X10 Y10 J5\nG1 X0\nM30\n'


@pytest.mark.parametrize('name', ['mill', 'lathe', 'ballscrew'])
def test_a_new_file_is_as_good_as_the_built_in_one(fuzzycnc, tmp_path, name):
    outcome = fuzzycnc('machine', 'new', 'own.yaml', '--like', name)
    assert outcome.code == 0, outcome.err
    for file in (name, 'own.yaml'):
        outcome = fuzzycnc('machine', 'show', file, '--json', f'{file}.json')
        assert outcome.code == 0, outcome.err
    given, own = (
        json.loads((tmp_path / f'{file}.json').read_text()) for file in (name, 'own.yaml')
    )
    assert own['values'] == pytest.approx(given['values'])
    assert own['machine'] == 'own'
    assert fuzzycnc('machine', 'check', 'own.yaml').code == 0


def test_limits_of_the_controller_follow_it(fuzzycnc, tmp_path):
    (tmp_path / 'mill.ini').write_text(INI)
    outcome = fuzzycnc('machine', 'new', 'own.yaml', '--linuxcnc-ini', 'mill.ini')
    assert outcome.code == 0, outcome.err
    assert (
        'axes.X.limits.velocity                  100 mm/s'
        in fuzzycnc('machine', 'show', 'own.yaml').out
    )
    (tmp_path / 'mill.ini').write_text(INI.replace('100', '50'))
    assert (
        'axes.X.limits.velocity                  50 mm/s'
        in fuzzycnc('machine', 'show', 'own.yaml').out
    )


def test_doubts_are_exit_code_1(fuzzycnc, tmp_path):
    (tmp_path / 'own.yaml').write_text('axes: {X: {}}\npath: {velocity: 2 m/s, feed: 3 m/s}\n')
    outcome = fuzzycnc('machine', 'check', 'own.yaml', '--json', 'out.json')
    assert outcome.code == 1
    assert 'path.velocity: 2000 mm/s is more than all axes together reach, 433' in outcome.out
    assert len(json.loads((tmp_path / 'out.json').read_text())['doubts']) == 2


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (('machine', 'new', 'there.yaml'), ['there.yaml', 'expected a new name']),
        (('machine', 'new', 'a.yaml', '--like', 'hexapod'), ['--like', 'hexapod']),
        (('machine', 'new', 'a.yaml', '--linuxcnc-ini', 'no.ini'), ['no.ini']),
        (('machine', 'check', 'no.yaml'), ['no.yaml', 'nothing is there']),
        (('machine', 'show', 'there.yaml'), ['there.yaml', 'line 1', 'unknown name pth']),
        (('pareto', 'infinity', '--machine-file', 'no.yaml'), ['no.yaml']),
    ],
)
def test_refusals(fuzzycnc, tmp_path, arguments, said):
    (tmp_path / 'there.yaml').write_text('pth: {}')
    outcome = fuzzycnc(*arguments)
    assert outcome.code == 2
    assert len(outcome.err.splitlines()) == 1
    for word in said:
        assert word in outcome.err


def test_feeds_are_those_of_the_machine(fuzzycnc, tmp_path):
    (tmp_path / 'part.ngc').write_text(PROGRAM)
    (tmp_path / 'stiff.yaml').write_text('loop: {position_gain: 160, velocity_bandwidth: 1000}')
    times = {}
    for machine in ('mill', 'stiff.yaml'):
        outcome = fuzzycnc(
            'schedule', 'part.ngc', '--tolerance', '10um', '--machine-file', machine,
            '--out', f'{machine}.ngc', '--json', 'out.json',
        )  # fmt: skip
        assert outcome.code in (0, 1), outcome.err
        times[machine] = (tmp_path / f'{machine}.ngc').read_text()
    assert times['mill'] != times['stiff.yaml']


def test_a_new_machine_file_goes_through_a_pipe(fuzzycnc, tmp_path):
    """What is read back is a file; a pipe has given its text to its reader."""
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    (tmp_path / 'link').symlink_to(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        outcome = fuzzycnc('machine', 'new', 'link')
        text = os.read(reader, 1 << 16).decode()
    finally:
        os.close(reader)
    assert outcome.code == 0, outcome.err
    assert 'axes:' in text
    assert pipe.is_fifo()
    assert (tmp_path / 'link').is_symlink()
