# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc servo export`: one C file of an axis' controller."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_file_repeats_its_recorded_steps(fuzzycnc):
    words = ('servo', 'export', '--machine-file', 'ballscrew', '--out', 'axis.c')
    assert fuzzycnc(*words).code == 0
    command = ['gcc', '-DSELF_TEST', '-std=c99', '-O2', '-ffp-contract=off', 'axis.c', '-lm']
    subprocess.run([*command, '-o', 'axis'], check=True)
    done = subprocess.run(['./axis'], capture_output=True, text=True, check=True)
    assert done.stdout.startswith('0 of 400 duties differ')


def test_what_cannot_be_written_is_refused(fuzzycnc, refused):
    words = ('servo', 'export', '--machine-file', 'ballscrew', '--out', 'axis.c')
    refused(*words, '--to', 'ada', naming=['--to', "'ada'"])
    assert fuzzycnc(*words).code == 0
    refused(*words, naming=['axis.c', 'choose another one'])


def test_components_bear_the_names_of_their_files(fuzzycnc, refused):
    words = ('servo', 'export', '--machine-file', 'ballscrew', '--to')
    refused(*words, 'hal', '--out', 'axis.c', naming=['fuzzycnc_axis_x.comp', 'axis.c'])
    refused(*words, 'hal', '--out', 'Axis X.comp', naming=['name', "'Axis X'"])
    naming = ['--controller', 'none']
    refused(*words, 'plant', '--controller', 'pid', '--out', 'plant.comp', naming=naming)
    for kind, name in (('hal', 'own_axis'), ('plant', 'own_plant')):
        assert fuzzycnc(*words, kind, '--out', f'{name}.comp').code == 0
        text = Path(f'{name}.comp').read_text()
        assert f'\ncomponent {name} "' in text
        assert re.search('\nmachine file [0-9a-f]{64}\n', text)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which('halcompile'), reason='halcompile is not installed')
@pytest.mark.parametrize('machine', ['ballscrew', 'lathe'])
def test_linuxcnc_builds_components_without_a_warning(machine, fuzzycnc):
    words = ('servo', 'export', '--machine-file', machine, '--to')
    for kind in ('hal', 'plant'):
        assert fuzzycnc(*words, kind, '--out', f'own_{kind}.comp').code == 0
        command = ['halcompile', '--compile', f'own_{kind}.comp']
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert not done.stderr
        assert Path(f'own_{kind}.so').exists()
