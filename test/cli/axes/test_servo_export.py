# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc servo export`: one C file of an axis' controller."""

import subprocess

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
