# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The launch file, where ROS's `launch` and `launch_ros` can be had (not from PyPI)."""

import os
import re
import signal
import sys
from pathlib import Path

import pytest
from processes import wait_for

pytestmark = pytest.mark.ros

pytest.importorskip('launch_ros', reason='launch_ros is part of a full ROS installation')

FILE = Path(__file__).parents[2] / 'launch' / 'thermal_compensation.launch.py'
RUN = """
import sys
from fuzzycnc_ros.graph import bring_up
bring_up.ACTIVE_TIMEOUT = 1e6  # who waits for an active node waits for what it tells
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
arguments = [tuple(word.split(':=')) for word in sys.argv[2:]]
source = PythonLaunchDescriptionSource(sys.argv[1])
service = LaunchService()
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments)])
)
sys.exit(service.run())
"""


@pytest.fixture
def launch(graph, tmp_path):
    """Start the launch file with arguments."""
    return lambda *words: graph.launch(
        'launch', [sys.executable, '-c', RUN, str(FILE), *words], tmp_path
    )


def pids(running, node):
    """Return the processes that a node has had so far."""
    started = rf'\[{node}-\d+\]: process started with pid \[(\d+)\]'
    return [int(pid) for pid in re.findall(started, running.output)]


def test_a_run_ends_with_its_simulation(launch):
    running = launch('duties:=T2', 'rate:=3000')
    assert running.wait() == 0
    assert '"degraded": false' in running.output


def test_two_machines_start_one_after_the_other(launch):
    running = launch('duties:=T2', 'rate:=3000', 'machine:=mill_1,mill_2')
    assert running.wait() == 0
    assert len(pids(running, 'simulated_machine')) == 2


def test_a_killed_node_comes_back_and_a_failed_simulation_ends_all(launch, observer):
    from lifecycle_msgs.msg import State

    running = launch('duties:=T2', 'rate:=20')
    wait_for(lambda: pids(running, 'simulated_machine'), 'all have started')
    (first,) = pids(running, 'compensator')
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: len(pids(running, 'compensator')) == 2, 'it has come back')
    os.kill(pids(running, 'compensator')[1], signal.SIGKILL)  # before it is active again
    wait_for(lambda: len(pids(running, 'compensator')) == 3, 'it has come back again')
    observer.until(lambda: observer.state('compensator') == State.PRIMARY_STATE_ACTIVE, 'active')
    os.kill(pids(running, 'simulated_machine')[0], signal.SIGKILL)
    assert running.wait() == 1
    assert 'mill/simulated_machine ended with code -9' in running.output


def test_a_manual_deactivation_is_not_undone(launch, observer):
    from lifecycle_msgs.msg import State, Transition

    running = launch('duties:=T2', 'rate:=20')
    wait_for(lambda: pids(running, 'simulated_machine'), 'all have started')
    assert observer.change('compensator', Transition.TRANSITION_DEACTIVATE)
    observer.settle('compensator')
    os.kill(pids(running, 'compensator')[0], signal.SIGKILL)
    wait_for(lambda: len(pids(running, 'compensator')) == 2, 'it has come back')
    observer.until(lambda: observer.state('compensator'), 'it answers')
    observer.spin_for(3.0)
    assert observer.state('compensator') != State.PRIMARY_STATE_ACTIVE


def test_a_wrong_folder_is_an_error(launch, tmp_path):
    running = launch(f'params_dir:={tmp_path / "nowhere"}')
    assert running.wait() == 1
    assert 'expected files <node>.yaml but found none' in running.output
