# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""YAML files from anywhere: refused with the file, in bounded time and memory."""

import os
from dataclasses import fields

import pytest

from fuzzycnc_ros.bags.csv_mapping import CsvMapping
from fuzzycnc_ros.cli.bags.import_csv import _read_mapping
from fuzzycnc_ros.cli.programs.scheduling_machine import read_machine
from fuzzycnc_ros.files.yaml_file import SIZE_MAX, compose, construct
from fuzzycnc_ros.studies.servo.servo_settings import read_settings

LAUGHS = 'a: &a [x, x]\n' + ''.join(
    f'{after}: &{after} [{", ".join([f"*{before}"] * 9)}]\n'
    for before, after in zip('abcdefghi', 'bcdefghij', strict=True)
)
READERS = {
    'machine': read_machine,
    'mapping': lambda path: _read_mapping(path, [item.name for item in fields(CsvMapping)]),
    'settings': read_settings,
}


@pytest.mark.parametrize('reader', READERS)
@pytest.mark.parametrize(
    ('text', 'complaint'),
    [
        (LAUGHS, r'line 2: expected no references \(\*a\)'),
        ('a: ' + '[' * 5000, 'expected at most 50 levels'),
        ('a: [' * 5000, 'expected at most 50 levels'),
        ('a: {b: ]', 'YAML'),
        ('\x00', 'YAML'),
        ('? [a, b]\n: 1\n', ''),
        ('x' * (SIZE_MAX + 1), f'a file of at most {SIZE_MAX} bytes'),
        ('!!python/object/apply:os.system [ls]', ''),
        ('', ''),
    ],
)
def test_what_is_no_such_file_is_refused(tmp_path, reader, text, complaint):
    path = tmp_path / 'file.yaml'
    path.write_text(text)
    with pytest.raises(ValueError, match=rf'file\.yaml:.*{complaint}'):
        READERS[reader](path)


@pytest.mark.parametrize('reader', READERS)
def test_what_would_never_end_is_refused(tmp_path, reader):
    pipe = tmp_path / 'pipe.yaml'
    os.mkfifo(pipe)
    for path in (pipe, tmp_path, tmp_path / 'gone.yaml'):
        with pytest.raises(ValueError, match=path.name):
            READERS[reader](path)


@pytest.mark.parametrize('value', ['9' * 5000, '9' * 400, '2001-99-99'])
def test_values_beyond_reason_name_the_line(tmp_path, value):
    path = tmp_path / 'file.yaml'
    path.write_text(f'feedrate_scheduler:\n  ros__parameters:\n    tolerance: {value}\n')
    with pytest.raises(ValueError, match=r'file\.yaml: line 3: '):
        read_machine(path)
    path.write_text(f'settings:\n  gain: {value}\n')
    with pytest.raises(ValueError, match=r'file\.yaml: '):
        read_settings(path)
    path.write_text(f'time: t\nresample: {value}\n')
    with pytest.raises(ValueError, match=r'file\.yaml: '):
        READERS['mapping'](path)


def test_values_are_those_of_yaml(tmp_path):
    path = tmp_path / 'file.yaml'
    path.write_text('a: [1, 2.5, yes, text]\nb: {c: null}\n')
    found = construct(path, compose(path, 'values'))
    assert found == {'a': [1, 2.5, True, 'text'], 'b': {'c': None}}
