# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a machine of composed nodes costs while nothing happens: imports and timers."""

import subprocess
import sys
from importlib import import_module

import pytest

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

pytestmark = pytest.mark.ros


@pytest.mark.parametrize('names', [(), ('magic',), ('compensator', 'host'), ('../compensator',)])
def test_what_is_no_node_is_refused(names):
    from fuzzycnc_ros.nodes.composed import run_composed

    with pytest.raises(ValueError, match='expected nodes among simulated_machine') as caught:
        run_composed(names, [])
    assert str(caught.value).endswith(f'found {names[-1] if names else "none"}')


def test_a_library_that_is_missing_is_named_and_not_its_node(monkeypatch):
    from fuzzycnc_ros.nodes import composed

    def lacking(module):
        raise ModuleNotFoundError("No module named 'paho'", name='paho')

    monkeypatch.setattr(composed, 'import_module', lacking)
    with pytest.raises(ModuleNotFoundError, match='paho'):
        composed.run_composed(['mqtt_publisher'], [])


def test_only_the_nodes_that_are_named_are_loaded():
    script = (
        'import sys, fuzzycnc_ros.nodes.composed, fuzzycnc_ros.nodes.compensator\n'
        "print('fuzzycnc_ros.registry' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr) == ('False\n', '')


@pytest.mark.parametrize(
    ('node', 'running'),
    [
        ('temperature_acquisition', 1),
        ('sensor_selector', 1),
        ('thermal_predictor', 1),
        ('compensator', 2),  # it has deadlines
    ],
)
def test_nodes_wake_up_only_for_what_may_come_due(domain, node, running, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init(args=['--ros-args', '-r', '__ns:=/mill'])
    try:
        host = import_module(f'fuzzycnc_ros.nodes.{node}').make()
        timers = [timer for timer in host.node.timers if not timer.is_canceled()]
        host.stop()
        assert len(timers) == running
    finally:
        rclpy.shutdown()
