# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What `fuzzycnc up` refuses before the first node is started."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from benches.predictor_bench import losing_text

from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.graph.bring_up import LENGTH_MAX
from fuzzycnc_ros.ros.presence import GraphError

pytestmark = pytest.mark.ros

LONG = 300 * 'a'


@pytest.fixture
def refused_at_once(refused, domain, monkeypatch):
    """Run `fuzzycnc up`, which must be refused before it starts a node."""

    def start(*specs):
        raise GraphError('a node was started')

    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setattr(GraphProcesses, 'start', start)
    return lambda *arguments, naming: refused('up', *arguments, naming=naming)


def write(path, text):
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(text)


@pytest.mark.parametrize(
    ('arguments', 'naming'),
    [
        (('--simulate', 'T9'), ['mill/simulated_machine', 'duties', 'T9', 'D0b']),
        (('--simulate', 'T2', '--rate', '0'), ['mill/simulated_machine', 'rate = 0', '0.01']),
        (('--model', 'gone.json'), ['mill/thermal_predictor', 'model', 'gone.json', 'No such']),
        (('--model', 'p/any.yaml'), ['thermal_predictor', 'p/any.yaml', 'expected JSON']),
        (('--record', 'p'), ['mill/recorder', 'p: expected a new name but it exists']),
        (
            ('--machine', 'a,b', '--record', 'bag', '--params', 'p'),
            ['a/compensator', 'parameter offset_max = 1.0', '0.001'],
        ),
        (('--state-directory', 'p/any.yaml/state'), ['state_directory', 'p/any.yaml']),
    ],
)
def test_parameters_that_a_node_would_refuse(refused_at_once, arguments, naming):
    write('p/any.yaml', '/**/compensator:\n  ros__parameters:\n    offset_max: 1.0\n')
    refused_at_once(*arguments, naming=naming)


def test_a_model_that_is_worse_than_none_is_found_before_any_node_starts(
    refused_at_once, fuzzycnc
):
    write('losing.json', losing_text())
    options = ('--nodes', 'thermal_predictor', '--model', 'losing.json')
    naming = ['mill/thermal_predictor', 'losing.json', 'Y', '26.6 µm of 9.4 µm', '--force-model']
    refused_at_once(*options, naming=naming)
    outcome = fuzzycnc('up', *options, '--force-model')
    assert outcome.err.endswith('error: a node was started\n')


@pytest.mark.parametrize(
    ('text', 'naming'),
    [
        ('/**:\n  ros__parameters:\n    axes: [Z\n', ['YAML', 'line 3']),
        ('/**:\n  ros__parameters:\n    period:\n', ['No value', 'line 3']),
        ('/**:\n  parameters:\n    period: 1.0\n', ['ros__parameters', 'line 1']),
        ('devices:\n- name: rtd\n', ['line 1', '`devices:`', 'outside of the folder']),
        (
            '/*/compensator:\n  ros__parameters:\n    ofset_max: 1e-6\n',
            ['mill/compensator', 'unknown parameter ofset_max', 'offset_max'],
        ),
        (
            'mill:\n  compensator:\n    ros__parameters:\n      axes: [Q]\n',
            ['mill/compensator', 'axes', 'Q'],
        ),
    ],
)
def test_parameter_files(refused_at_once, text, naming):
    write('p/some.yaml', text)
    refused_at_once('--nodes', 'compensator', '--params', 'p', naming=naming)


@pytest.mark.parametrize(
    ('line', 'instead'),
    [('probing: kalman', 'learn: true'), ('domain_margin: 3.0', 'from its training a model')],
)
def test_a_parameter_of_earlier_versions_names_its_successor(refused_at_once, line, instead):
    write('p/some.yaml', f'/**/thermal_predictor:\n  ros__parameters:\n    {line}\n')
    name = line.split(':')[0]
    naming = [f'parameter {name}: earlier versions had it; delete it', instead]
    refused_at_once('--nodes', 'thermal_predictor', '--params', 'p', naming=naming)


@pytest.mark.parametrize(
    ('axis', 'naming'),
    [
        ('Q', ['axes: expected an axis of the machine file, X, Z, W, but found Q']),
        ('Z', ['axes: expected the model (plant) of Z', 'fuzzycnc machine identify']),
        ('W', ['tuned controller of W', 'servo tune --machine-file', 'axis_controller']),
    ],
)
def test_servo_axes_that_a_machine_file_does_not_know(refused_at_once, fuzzycnc, axis, naming):
    write(
        'my.yaml',
        'axes:\n'
        '  X: {plant: {model: lags}, controller: {name: pid}}\n'
        '  Z: {limits: {velocity: 0.1}}\n'
        '  W: {plant: {model: mass}}\n',
    )
    options = ('--nodes', 'servo_controller', '--params', 'p', '--machine-file', 'my.yaml')
    parameters = '/**/servo_controller:\n  ros__parameters:\n    axes: ["{}:machine_file"]\n'
    write('p/servo.yaml', parameters.format(axis))
    refused_at_once(*options, naming=['mill/servo_controller', *naming])
    refused_at_once(*options[:4], naming=[f'data of the axis {axis}', 'give the machine file'])
    write('p/servo.yaml', parameters.format('X'))
    assert fuzzycnc('up', *options).err.endswith('error: a node was started\n')


def test_parameters_for_other_nodes_are_theirs(refused_at_once, fuzzycnc):
    write('p/some.yaml', '/other/compensator:\n  ros__parameters:\n    offset_max: 1.0\n')
    outcome = fuzzycnc('up', '--nodes', 'compensator', '--params', 'p')
    assert outcome.err.endswith('error: a node was started\n')


@pytest.mark.parametrize('name', ['../x', 'a b', ';rm', '9mill', 'mill/9', 'a__b', 'ä', LONG])
@pytest.mark.parametrize('command', ['up', 'record --out b', 'operate status', 'operate activate'])
def test_names_that_are_no_namespace(refused, command, name):
    shown = f'{len(LONG)} characters' if name is LONG else repr(name)
    refused(*command.split(), '--machine', name, naming=['--machine', 'mill_1', shown])


@pytest.mark.parametrize('number', ['500', '233', '-1', 'shop', '1e2', '5.0'])
@pytest.mark.parametrize('command', ['up', 'record --out b', 'operate status'])
def test_domains_that_are_none(refused, monkeypatch, command, number):
    monkeypatch.setenv('ROS_DOMAIN_ID', number)
    refused(*command.split(), naming=['ROS_DOMAIN_ID', '0 to 101', number])


def test_longest_name_has_room_for_its_topics(domain):
    """Topics and services of the longest names that the package has."""
    import rclpy
    from std_srvs.srv import Empty

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        node = rclpy.create_node(
            'deformation_compensator', namespace=LENGTH_MAX * 'a', context=context
        )
        node.create_service(Empty, '~/' + 60 * 'b', lambda request, response: response)
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)


@pytest.mark.parametrize(
    ('arguments', 'environment', 'naming'),
    [
        (('--params-file', 'bad.yaml'), {}, ['bad.yaml', 'line 3']),
        (('--params-file', 'gone.yaml'), {}, ['gone.yaml', 'YAML']),
        (('-r', '__ns:=/9mill'), {}, ['__ns:=/9mill', 'remap rule']),
        ((), {'ROS_DOMAIN_ID': '500'}, ['ROS_DOMAIN_ID', '500']),
    ],
)
def test_a_node_alone_says_it_in_one_line(tmp_path, root, domain, arguments, environment, naming):
    write(tmp_path / 'bad.yaml', '/**:\n  ros__parameters:\n    axes: [Z\n')
    done = subprocess.run(
        [sys.executable, '-m', 'fuzzycnc_ros.nodes.compensator', '--ros-args', *arguments],
        cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': str(root), 'ROS_DOMAIN_ID': str(domain), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.splitlines()
    assert line.startswith('error: ')
    assert [text for text in naming if text not in line] == []
