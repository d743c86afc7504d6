# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters: one schema, and files, tables and nodes that follow from it."""

import runpy
from dataclasses import MISSING, fields
from importlib import import_module
from pathlib import Path

import pytest
import yaml
from each_case import for_each

ROOT = Path(__file__).parents[2]
TABLES = runpy.run_path(str(ROOT / 'tools' / 'make_tables.py'))
NODES = TABLES['nodes']()
RECORDS = sorted({r for node in NODES for r in node.records}, key=lambda r: r.__name__)
PARAMETERS = [(record, item) for record in RECORDS for item in fields(record)]
SI_UNITS = {
    'B',
    '-',
    'm',
    'm/s',
    'm/s^2',
    'm/s^3',
    '1/m',
    's',
    '1/s',
    's^2',
    'degC',
    'K',
    'K/s',
    'rad',
    'rad/s',
}
ABBREVIATIONS = {'cfg', 'freq', 'idx', 'max_len', 'num', 'temp', 'tmp', 'vel'}


def loaded(node: str) -> dict:
    """Return the parameters of a params file."""
    content = yaml.safe_load((ROOT / 'params' / f'{node}.yaml').read_text())
    return content[f'/**/{node}']['ros__parameters']


def schema(node) -> dict:
    """Return the fields of all records of a node by name."""
    return {item.name: item for record in node.records for item in fields(record)}


@pytest.mark.parametrize('node', NODES, ids=lambda node: node.name)
def test_params_file_is_the_schema(node):
    values, declared = loaded(node.name), schema(node)
    assert list(values) == list(declared)
    for name, value in values.items():
        default = declared[name].default
        if isinstance(default, tuple):
            assert value == (list(default) or [''])
        else:
            assert type(value) is type(default), f'{name}: an integer would stop the node'
            assert value == default


@pytest.mark.parametrize('node', NODES, ids=lambda node: node.name)
def test_params_file_gives_the_default_configuration(node):
    """What the file says is accepted by the records, and changes nothing."""
    values = loaded(node.name)
    for record in node.records:
        own = {
            item.name: tuple(v for v in values[item.name] if v != '')
            if isinstance(values[item.name], list)
            else values[item.name]
            for item in fields(record)
        }
        assert record(**own) == record()


@pytest.mark.parametrize('node', NODES, ids=lambda node: node.name)
def test_no_name_is_declared_twice(node):
    names = [item.name for record in node.records for item in fields(record)]
    assert len(names) == len(set(names))


@for_each(PARAMETERS, lambda case: f'{case[0].__name__}.{case[1].name}')
def test_parameter_says_what_it_is(record, item):
    assert item.default is not MISSING
    meta = item.metadata
    assert meta['unit'] in SI_UNITS
    assert meta['doc'][0].isupper() or meta['doc'].startswith('/')
    assert not meta['doc'].endswith('.')
    assert not ABBREVIATIONS & set(item.name.split('_'))
    if meta['low'] is not None:
        assert meta['low'] <= meta['high']


@for_each(PARAMETERS, lambda case: f'{case[0].__name__}.{case[1].name}')
def test_value_out_of_bounds_is_refused(record, item):
    """The refusal names the parameter and the value."""
    meta, default = item.metadata, item.default
    if meta['choices']:
        with pytest.raises(
            ValueError, match=f'{item.name}: expected one of .* but found nonsense'
        ):
            record(**{item.name: 'nonsense'})
    elif meta['low'] is not None:
        for value in (2 * meta['high'] + 1, meta['low'] - 1):
            wrong = (value,) * len(default) if isinstance(default, tuple) else type(default)(value)
            with pytest.raises(ValueError, match=rf'{item.name} = \S+ is outside \[') as caught:
                record(**{item.name: wrong})
            assert meta['unit'] in str(caught.value)
    else:
        wrong = 1.5 if not isinstance(default, float) else 'text'
        with pytest.raises(ValueError, match=rf'{item.name}: expected \w+ as in the default'):
            record(**{item.name: wrong})


@pytest.mark.parametrize(
    ('value', 'text'),
    [
        (5e-05, '5.0e-05'),
        (1.5e-07, '1.5e-07'),
        (1.0, '1.0'),
        (3, '3'),
        (True, 'true'),
        ((), "['']"),
        (('a', 'b'), "['a', 'b']"),
        ("it's", "'it''s'"),
    ],
)
def test_yaml_keeps_the_type(value, text):
    assert TABLES['yaml_value'](value) == text
    read = yaml.safe_load(text)
    assert read == (list(value) or [''] if isinstance(value, tuple) else value)
    assert isinstance(value, tuple) or type(read) is type(value)


@pytest.mark.ros
def test_every_node_has_its_parameters_in_the_tables():
    pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')
    names = {
        path.stem
        for path in (ROOT / 'fuzzycnc_ros' / 'nodes').glob('*.py')
        if hasattr(import_module(f'fuzzycnc_ros.nodes.{path.stem}'), 'make')
    }
    assert names == {node.name for node in NODES}


@pytest.mark.ros
@pytest.mark.parametrize('node', NODES, ids=lambda node: node.name)
def test_ros_declaration_is_the_schema(node, monkeypatch, tmp_path):
    """Type, value, bounds and text of every declared parameter, and nothing undeclared."""
    rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')
    from rclpy.node import Node

    from fuzzycnc_ros.ros.parameters import declare

    context = rclpy.Context()
    context.init()
    try:
        ros = Node(f'declares_{node.name}', context=context, start_parameter_services=False)
        before = set(ros._parameters)
        declare(ros, *node.records)
        declared = schema(node)
        assert set(ros._parameters) - before == set(declared)
        for name, item in declared.items():
            value = ros.get_parameter(name).value
            default = item.default
            if isinstance(default, tuple):
                assert list(value) == (list(default) or [''])
            else:
                assert value == default
            descriptor = ros.describe_parameter(name)
            assert item.metadata['doc'] in descriptor.description
            assert f'[{item.metadata["unit"]}]' in descriptor.description
            assert descriptor.read_only is not item.metadata['live']
            ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
            assert bool(ranges) is (item.metadata['low'] is not None)
            if ranges:
                found = (ranges[0].from_value, ranges[0].to_value)
                assert found == (item.metadata['low'], item.metadata['high'])
        ros.destroy_node()
    finally:
        context.shutdown()
