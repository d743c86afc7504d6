# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A node that runs keeps its clock."""

from dataclasses import fields

import pytest
import yaml

pytestmark = pytest.mark.ros

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter, parameter_dict_from_yaml_file  # noqa: E402

from fuzzycnc_ros.nodes.compensator import make  # noqa: E402
from fuzzycnc_ros.registry import COMPONENTS  # noqa: E402
from fuzzycnc_ros.ros.node_config import RecorderConfig  # noqa: E402
from fuzzycnc_ros.ros.parameters import KEEPS_ITS_CLOCK, declare  # noqa: E402


@pytest.fixture(autouse=True)
def _initialised(domain, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    rclpy.init(args=[])
    yield
    rclpy.shutdown()


def clock(value: bool) -> Parameter:
    """Return the parameter that chooses a clock."""
    return Parameter('use_sim_time', Parameter.Type.BOOL, value)


@pytest.fixture
def compensator(_initialised):
    """A node with a component."""
    host = make()
    yield host
    host.node.destroy_node()


def test_another_clock_is_refused(compensator):
    node = compensator.node
    (result,) = node.set_parameters([clock(True)])
    assert (result.successful, result.reason) == (False, KEEPS_ITS_CLOCK)
    assert not node.get_clock().ros_time_is_active
    (result,) = node.set_parameters([clock(False)])
    assert result.successful, 'a dump is loaded again as a whole'


def test_what_is_set_with_another_clock_stays_as_it_was(compensator):
    node, before = compensator.node, compensator.component.configuration
    size = Parameter('offset_max', Parameter.Type.DOUBLE, before.offset_max / 2)
    assert not node.set_parameters_atomically([size, clock(True)]).successful
    assert compensator.component.configuration == before
    assert node.get_parameter('offset_max').value == before.offset_max
    assert node.set_parameters_atomically([size]).successful


LIVE = {
    name: [item for item in fields(component.CONFIG) if item.metadata['live']]
    for name, component in COMPONENTS.items()
}


@pytest.mark.parametrize('name', [name for name, items in LIVE.items() if items])
@pytest.mark.parametrize('smaller', [1.0, 1e-3])
def test_what_a_dump_wrote_is_loaded_again(tmp_path, name, smaller):
    """Limits of micrometres are numbers without a point, which YAML 1.1 takes for text."""
    wanted = {}
    for item in LIVE[name]:
        scaled = item.default
        if isinstance(scaled, tuple):  # the first number alone: a list of numbers and text
            scaled = (scaled[0] * smaller, *scaled[1:])
        elif isinstance(scaled, float):
            scaled = scaled * smaller
        low, sample = item.metadata['low'], scaled[0] if isinstance(scaled, tuple) else scaled
        wanted[item.name] = item.default if low is not None and sample < low else scaled
    node = Node(name)
    declare(node, COMPONENTS[name].CONFIG)
    values = {name: list(v) if isinstance(v, tuple) else v for name, v in wanted.items()}
    (tmp_path / 'dump.yaml').write_text(yaml.safe_dump({f'/{name}': {'ros__parameters': values}}))
    sent = parameter_dict_from_yaml_file(str(tmp_path / 'dump.yaml'))
    for result, item in zip(
        node.set_parameters([Parameter.from_parameter_msg(item) for item in sent.values()]),
        sent,
        strict=True,
    ):
        assert result.successful, (item, result.reason)
    for item, value in wanted.items():
        found = node.get_parameter(item).value
        assert (tuple(found) if isinstance(value, tuple) else found) == value
    node.destroy_node()


@pytest.mark.parametrize(
    ('given', 'taken'),
    [('2e-05', 2e-05), ('2E-05', 2e-05), ('.5e-4', 5e-05), ('0', 0.0), (0, 0.0)],
)
def test_text_that_is_a_number_is_taken_for_a_double(compensator, given, taken):
    (result,) = compensator.node.set_parameters([Parameter('offset_max', value=given)])
    assert result.successful, result.reason
    assert compensator.component.configuration.offset_max == taken


@pytest.mark.parametrize('given', ['2e-05 m', '20um', 'nan', 'inf', '', '1_0', '2e', True, '5e-2'])
def test_other_text_is_refused_and_changes_nothing(compensator, given):
    before = compensator.component.configuration
    (result,) = compensator.node.set_parameters([Parameter('offset_max', value=given)])
    assert not result.successful
    assert compensator.component.configuration == before


def test_numbers_as_text_start_a_node():
    given = [Parameter('offset_max', value='2e-05'), Parameter('slew_max', value='1e-06')]
    node = Node('compensator', parameter_overrides=given)
    (config,) = declare(node, COMPONENTS['compensator'].CONFIG)
    assert (config.offset_max, config.slew_max) == (2e-05, 1e-06)
    node.destroy_node()


def test_nodes_without_a_component_keep_theirs_too():
    node = Node('recorder')
    declare(node, RecorderConfig)
    (result,) = node.set_parameters([clock(True)])
    assert (result.successful, result.reason) == (False, KEEPS_ITS_CLOCK)
    node.destroy_node()
