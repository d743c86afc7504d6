# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The JSON Schema of machine files agrees with their reader."""

import json
import re

import pytest
import yaml

from fuzzycnc_ros.cli.main import run
from fuzzycnc_ros.machine_file.reader import BUILT_IN, built_in_path, read_machine_file
from fuzzycnc_ros.machine_file.writer import machine_text

jsonschema = pytest.importorskip('jsonschema')

AXIS = 'axes: {X: {limits: {velocity: 250 mm/s}, plant: {model: mass, mass: 95 kg}}}\n'


@pytest.fixture(scope='module')
def validator(tmp_path_factory):
    """What the command writes, as a judge of files."""
    path = tmp_path_factory.mktemp('schema') / 'machine.schema.json'
    assert run(['schema', 'machine', '--out', str(path)]) == 0
    schema = json.loads(path.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize('name', BUILT_IN)
def test_built_in_machines_and_new_files_are_valid(validator, name):
    validator.validate(yaml.safe_load(built_in_path(name).read_text()))
    validator.validate(yaml.safe_load(machine_text(read_machine_file(name))))


def test_the_example_of_the_docs_is_valid(validator, root):
    page = (root / 'docs' / 'reference' / 'machine-file.md').read_text()
    examples = re.findall(r'^```yaml\n(machine:.*?)^```', page, re.M | re.S)
    assert examples
    for example in examples:
        validator.validate(yaml.safe_load(example))


@pytest.mark.parametrize(
    ('old', 'new', 'place'),
    [
        ('axes', 'axis', ''),
        ('X:', '1X:', 'axes'),
        ('limits', 'limit', 'axes/X'),
        ('velocity', 'velocty', 'axes/X/limits'),
        ('250 mm/s', '250 mm', 'axes/X/limits/velocity'),
        ('250 mm/s', '-1', 'axes/X/limits/velocity'),
        ('250 mm/s', 'fast', 'axes/X/limits/velocity'),
        ('250 mm/s', '[1]', 'axes/X/limits/velocity'),
        ('model: mass', 'model: lag', 'axes/X/plant'),
        ('model: mass', 'model: lags', 'axes/X/plant'),
        ('model: mass, ', '', 'axes/X/plant'),
        ('{model: mass, mass: 95 kg}', '{model: mass, seed: 3}', 'axes/X/plant'),
    ],
)
def test_what_the_reader_refuses_is_not_valid(validator, tmp_path, old, new, place):
    assert old in AXIS
    path = tmp_path / 'machine.yaml'
    path.write_text(AXIS)
    assert read_machine_file(path)
    validator.validate(yaml.safe_load(AXIS))
    path.write_text(AXIS.replace(old, new, 1))
    with pytest.raises(ValueError, match='line 1'):
        read_machine_file(path)
    errors = list(validator.iter_errors(yaml.safe_load(path.read_text())))
    assert place in {'/'.join(map(str, error.absolute_path)) for error in errors}


@pytest.mark.parametrize('value', ['0.25', '15 m/min', '9.8 in/min', '600 inch/min', '"2e-1"'])
def test_every_spelling_of_a_unit_is_valid(validator, tmp_path, value):
    text = AXIS.replace('250 mm/s', value)
    path = tmp_path / 'machine.yaml'
    path.write_text(text)
    assert read_machine_file(path).axes['X'].limits.velocity > 0.0
    validator.validate(yaml.safe_load(text))


def test_units_and_bounds_are_told(capfd):
    assert run(['schema', 'machine']) == 0
    axes = json.loads(capfd.readouterr().out)['properties']['axes']
    (axis,) = axes['patternProperties'].values()
    velocity = axis['properties']['limits']['properties']['velocity']
    assert velocity['description'] == 'Largest velocity [m/s]'
    assert velocity['anyOf'][0] == {'type': 'number', 'minimum': 1e-6, 'maximum': 100.0}
    assert velocity['default'] == 0.25


def test_wrong_names_are_refused(capfd, tmp_path):
    assert run(['schema', 'machines']) == 2
    assert 'expected one of devices, control, machine' in capfd.readouterr().err
    assert run(['schema', 'machine', '--out', str(tmp_path / 'no' / 'm.json')]) == 2
    assert 'expected an existing folder' in capfd.readouterr().err


@pytest.mark.parametrize('kind', ['devices', 'control', 'machine', 'thermal-test'])
def test_what_is_printed_is_what_is_written_and_is_json(kind, tmp_path, capsys):
    path = tmp_path / 'schema.json'
    assert run(['schema', kind, '--out', str(path)]) == 0
    capsys.readouterr()
    assert run(['schema', kind]) == 0
    assert capsys.readouterr().out == path.read_text()
    json.loads(path.read_text(), parse_constant=pytest.fail)  # no Infinity, no NaN
