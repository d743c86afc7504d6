# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""ROS arguments: axes named Y, what `ros2 param dump` writes, and what is not understood."""

import os

import pytest
import yaml

from fuzzycnc_ros.components.thermal.compensator import Compensator
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.ros.node_config import HostConfig

pytestmark = pytest.mark.ros

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from rclpy.node import Node  # noqa: E402

from fuzzycnc_ros.nodes.compensator import make  # noqa: E402
from fuzzycnc_ros.ros.arguments import initialise, quoted, quoted_yaml  # noqa: E402
from fuzzycnc_ros.ros.parameters import declare  # noqa: E402
from fuzzycnc_ros.ros.run import run  # noqa: E402


@pytest.fixture(autouse=True)
def _alone(domain, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))


def started(component, *arguments):
    """Return the parameters of a node with some ROS arguments, and those that ROS adds."""
    initialise(['a_node', '--ros-args', *arguments])
    try:
        node = Node(component.NAME)
        records = declare(node, component.CONFIG, HostConfig)
        values = {name: item.value for name, item in node._parameters.items()}
        node.destroy_node()
        return records, values
    finally:
        rclpy.shutdown()


@pytest.mark.parametrize(
    ('text', 'axes'),
    [
        ('[Y, Z]', ('Y', 'Z')),
        ('[X, Y]', ('X', 'Y')),
        ('[Y]', ('Y',)),
        ("['Y', 'Z']", ('Y', 'Z')),
        ('["X", Y]', ('X', 'Y')),
    ],
)
def test_axes_need_no_quotes(tmp_path, text, axes):
    file = tmp_path / 'compensator.yaml'
    file.write_text(f'/**:\n  ros__parameters:\n    axes: {text}\n')
    for arguments in (('-p', f'axes:={text}'), ('--params-file', str(file))):
        (config, _), _ = started(Compensator, *arguments)
        assert config.axes == axes


@pytest.mark.parametrize('component', COMPONENTS.values(), ids=lambda kind: kind.NAME)
def test_a_dump_is_loaded_again(component, tmp_path):
    """As `ros2 param dump` writes it: by PyYAML, to which Y is a name that needs no quotes."""
    before, values = started(component)
    if component is Compensator:
        assert '- Y\n' in yaml.dump(values)
    file = tmp_path / 'dumped.yaml'
    content = {f'/{component.NAME}': {'ros__parameters': values}}
    file.write_text(yaml.dump(content, default_flow_style=False))
    after, _ = started(component, '--params-file', str(file))
    assert after == before


@pytest.mark.parametrize(
    ('text', 'wanted'),
    [
        ('[Y, n]', "['Y', 'n']"),
        ('a:\n- y\n- N # Y\n', "a:\n- 'y'\n- 'N' # Y\n"),
        ('{a: [[Y]], b: y}', "{a: [['Y']], b: y}"),
        ("['Y', on, Yes]", "['Y', on, Yes]"),
        ('y', 'y'),
        ('[Y', '[Y'),
        ('[0.5, 1, -2] # 1', '[0.5, 1.0, -2.0] # 1'),
        ('a:\n- 1e-05\n- 3\n', 'a:\n- 1e-05\n- 3.0\n'),
        ('[1, 2]', '[1, 2]'),
        ("['0.5', 1, X]", "['0.5', 1, X]"),
    ],
)
def test_lists_are_as_rcl_takes_them(text, wanted):
    assert quoted_yaml(text) == wanted


def test_a_pipe_is_left_to_ros(tmp_path):
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    arguments = ['--params-file', str(pipe), '-p', 'axes:=[Y]']
    assert quoted(arguments, tmp_path.mkdir) == [*arguments[:3], "axes:=['Y']"]


FILE = '/**:\n  ros__parameters:\n    axes: [Y, on]\n'


@pytest.mark.parametrize(
    ('arguments', 'named'),
    [
        (('-p', 'axes:=[on, X]'), ("'-p axes:=[on, X]'", "in quotes: ['on', 'X']")),
        (('-p', 'axes:=[on]'), ('parameter axes:', "in quotes, as in ['Y', 'Z']")),
        (('-p', 'axes:=Y'), ('parameter axes:', "in quotes, as in ['Y', 'Z']")),
        (('--params-file', 'mill.yaml'), ("'--params-file mill.yaml'", 'line_num 3', 'quotes')),
        (('--params-file', 'none.yaml'), ('none.yaml', 'Error opening')),
        (('-p', 'axes'), ("'-p axes'",)),
        (('-r', '__ns:=mill'), ("'-r __ns:=mill'",)),
        (('--log-level', 'loud'), ('loud',)),
        (('--nonsense',), ('unknown ROS arguments', '--nonsense')),
    ],
)
def test_wrong_arguments_are_told_in_one_line(arguments, named, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'mill.yaml').write_text(FILE)
    assert run([make], ['compensator', '--ros-args', *arguments]) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if '[WARN]' not in line]
    assert len(lines) == 1, lines
    assert lines[0].startswith('error: ')
    for text in named:
        assert text in lines[0]


def test_the_chosen_log_level_of_rcl_stays():
    initialise(['a_node', '--ros-args', '--log-level', 'rcl:=error'])
    try:
        assert rclpy.logging.get_logger_level('rcl') == rclpy.logging.LoggingSeverity.ERROR
    finally:
        rclpy.shutdown()
        rclpy.logging.set_logger_level('rcl', rclpy.logging.LoggingSeverity.UNSET)


def test_a_machine_file_comes_before_parameters(tmp_path):
    machine = tmp_path / 'mill.yaml'
    machine.write_text('path: {velocity: 100 mm/s, settle: 0.2}\n')
    for option in (('--machine-file', str(machine)), (f'--machine-file={machine}',)):
        initialise(['node', *option, '--ros-args', '-p', 'settle:=0.3'])
        try:
            node = Node('feedrate_scheduler')
            (config,) = declare(node, COMPONENTS['feedrate_scheduler'].CONFIG)
            node.destroy_node()
        finally:
            rclpy.shutdown()
        assert (config.path_velocity, config.settle) == (0.1, 0.3)


@pytest.mark.parametrize(
    ('text', 'said'),
    [(None, 'nothing is there'), ('path: {velocity: fast}', 'line 1'), ('', 'empty file')],
)
def test_a_machine_file_that_is_none_is_refused(tmp_path, capfd, text, said):
    machine = tmp_path / 'mill.yaml'
    if text is not None:
        machine.write_text(text)
    assert run([make], ['compensator', '--machine-file', str(machine)]) == 2
    found = capfd.readouterr().err
    assert f'--machine-file: {machine}' in found
    assert said in found
    assert run([make], ['compensator', '--machine-file']) == 2
    assert 'expected a file but found none' in capfd.readouterr().err
