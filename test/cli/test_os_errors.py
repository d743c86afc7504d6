# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the command line says when the operating system refuses something."""

import os
import subprocess
import sys

import pytest
from tiers import rest_slow


def started(root, words, **streams):
    """Run a command in a process of its own."""
    return subprocess.run(
        [sys.executable, '-m', 'fuzzycnc_ros.cli.main', *words],
        env={**os.environ, 'PYTHONPATH': str(root)},
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        **streams,
    )


@pytest.mark.parametrize(
    'words', rest_slow([['--version'], ['machine', 'show', 'mill'], ['schema', 'machine']], 0)
)
def test_standard_output_on_a_full_disk_is_one_line(root, words):
    with open('/dev/full', 'w', encoding='utf-8') as full:
        done = started(root, words, stdout=full)
    assert done.returncode == 2
    assert done.stderr == (
        'error: standard output: the disk is full; free some space, or name a place on another '
        'disk\n'
    )


def test_a_reader_that_has_gone_is_one_line(root):
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = started(root, ['machine', 'show', 'mill'], stdout=writer)
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (
        2,
        'error: standard output: its reader has gone, so the rest of the output is lost\n',
    )


def test_inputs(refused, tmp_path):
    (tmp_path / 'file').touch()
    (tmp_path / 'a').symlink_to('b')
    (tmp_path / 'b').symlink_to('a')
    on_the_way = ['file/x', 'expected a folder but file is a file']
    refused('import-csv', 'file/x', '--out', 'bag', naming=on_the_way)
    refused('evaluate', 'bag', '--model', 'file/x', naming=on_the_way)
    refused('position', '--to', '5mm', '--params', 'file/x', naming=on_the_way)
    refused('machine', 'show', 'file/x.yaml', naming=['file/x.yaml', 'file is a file'])
    refused('import-csv', 'a', '--out', 'bag', naming=['a: symbolic links', 'remove one'])
    refused('import-csv', '.', '--out', 'bag', naming=['expected a file but found a folder'])
    refused('machine', 'show', 300 * 'x', naming=['the name is too long'])


def test_outputs(refused, tmp_path):
    (tmp_path / 'file').touch()
    for words in (
        ['schema', 'machine', '--out'],
        ['machine', 'new'],
        ['simulate', '--json'],
        ['soft', 'demo', '--report'],
    ):
        refused(*words, 'file/x.yaml', naming=['file/x.yaml', 'file is a file', 'another place'])
        refused(*words, 'no/x.yaml', naming=['no/x.yaml', 'found no no', 'make it first'])
    name = 300 * 'x'
    refused('schema', 'machine', '--out', name, naming=[name, 'too long', 'a shorter one'])


OUTPUTS = {
    'schema': ['schema', 'machine', '--out'],
    'a model of a machine': ['machine', 'new'],
    'figures': ['machine', 'check', 'mill', '--json'],
    'a program': ['schedule', 'part.ngc', '--tolerance', '0.01mm', '--out'],
}


@pytest.mark.parametrize('words', OUTPUTS.values(), ids=OUTPUTS)
def test_what_is_no_regular_file_is_written_through(fuzzycnc, tmp_path, words):
    (tmp_path / 'part.ngc').write_text('G21 G90 F600\nG1 X10\nG1 Y10\nM2\n')
    with open(tmp_path / 'taken', 'w+') as taken:
        (tmp_path / 'name').symlink_to(f'/proc/self/fd/{taken.fileno()}')
        done = fuzzycnc(*words, 'name')
        assert done.code == 0, done.err
        assert (tmp_path / 'name').is_symlink()
        assert taken.read() == '' != (tmp_path / 'taken').read_text(), (
            'another file took its place'
        )


def test_a_bag_takes_no_place_of_a_pipe(refused, tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    refused('simulate', '--out', 'pipe', naming=['pipe: expected a new name but it exists'])
    assert (tmp_path / 'pipe').is_fifo()
