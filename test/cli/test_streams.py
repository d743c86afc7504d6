# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands whose standard streams are closed, not read, or in an encoding with few characters."""

import os
import subprocess
import sys

import pytest
from tiers import rest_slow

CLOSED = ['>&-', '2>&-', '<&- >&- 2>&-']
ASCII = [
    {'PYTHONIOENCODING': 'ascii'},
    {'LC_ALL': 'C', 'PYTHONUTF8': '0', 'PYTHONCOERCECLOCALE': '0'},
]


@pytest.fixture
def shell(root, tmp_path):
    """Run a command line of a shell, in which `$F` is the command."""

    def run(line, cwd=tmp_path, **environment):
        command = f'{sys.executable} -m fuzzycnc_ros.cli.main'
        return subprocess.run(
            ['sh', '-c', f'F="{command}"; {line}'],
            env={**os.environ, 'PYTHONPATH': str(root), **environment},
            cwd=cwd,
            capture_output=True,
            check=False,
        )

    return run


@pytest.mark.parametrize('closed', rest_slow(CLOSED, 2))
def test_closed_streams_change_nothing_but_what_is_seen(shell, tmp_path, closed):
    """The descriptors of closed ones must not be those of the files that are written."""
    done = shell(f'$F schema machine --out schema.json {closed}')
    assert (done.returncode, done.stderr) == (0, b'')
    whole = shell('$F schema machine').stdout
    assert (tmp_path / 'schema.json').read_bytes() == whole
    assert shell(f'$F machine show nowhere {closed}').returncode == 2


def test_an_error_is_told_where_only_standard_output_is_closed(shell):
    done = shell('$F machine show nowhere >&-')
    assert done.stderr == b'error: nowhere: expected a machine file but nothing is there\n'


def test_a_program_for_a_closed_standard_output_is_refused(shell, tmp_path):
    (tmp_path / 'part.ngc').write_text('G21 G90 F600\nG1 X10\nM2\n')
    done = shell('$F schedule part.ngc --tolerance 20um --out - >&-')
    assert done.returncode == 2
    assert b'--out -: expected an open standard output' in done.stderr


def test_a_standard_error_that_nobody_reads_changes_no_code(shell):
    assert shell('{ $F machine show nowhere; echo $? >code; } 2>&1 | true').returncode == 0
    done = shell('$F machine show nowhere 2>/dev/full')
    assert (done.returncode, done.stdout) == (2, b'')


@pytest.mark.parametrize('environment', rest_slow(ASCII, 0))
def test_characters_that_the_encoding_lacks_are_spelt_out(shell, environment):
    done = shell('$F machine show mill', **environment)
    assert (done.returncode, done.stderr) == (0, b'')
    assert rb'0.0002152 s\xb2' in done.stdout
    done = shell('$F machine show \N{LATIN SMALL LETTER SHARP S}', **environment)
    assert done.returncode == 2
    assert done.stderr.isascii()
    assert done.stderr.endswith(b': expected a machine file but nothing is there\n')


@pytest.mark.parametrize(
    ('words', 'code', 'told'),
    [
        ('--version', 0, b''),
        ('schema machine --out x.json', 2, b'error: the working folder was deleted'),
        ('machine show x.yaml', 2, b'nothing is there; the working folder was deleted'),
        ('demo --out x', 2, b'the working folder was deleted'),
    ],
)
def test_a_deleted_working_folder_is_named(shell, tmp_path, words, code, told):
    done = shell(f'mkdir gone; cd gone; rmdir ../gone; $F {words}')
    assert done.returncode == code, done.stderr
    assert told in done.stderr
    assert b'Traceback' not in done.stderr
