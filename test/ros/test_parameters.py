# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A node that runs keeps its clock."""

import pytest

pytestmark = pytest.mark.ros

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from fuzzycnc_ros.nodes.compensator import make  # noqa: E402
from fuzzycnc_ros.ros.parameters import KEEPS_ITS_CLOCK, declare  # noqa: E402
from fuzzycnc_ros.runtime.host import RecorderConfig  # noqa: E402


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


def test_nodes_without_a_component_keep_theirs_too():
    node = Node('recorder')
    declare(node, RecorderConfig)
    (result,) = node.set_parameters([clock(True)])
    assert (result.successful, result.reason) == (False, KEEPS_ITS_CLOCK)
    node.destroy_node()
