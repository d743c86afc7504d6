# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Locks of nodes that live on this computer."""

import os
import signal
import subprocess
import sys
from contextlib import nullcontext

import pytest

from fuzzycnc_ros.ros.bring_up import TAKEOVER, GraphError
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.ros.presence import Presence, check_alone, lives, living

HOLDER = """
import sys, time
from fuzzycnc_ros.ros.presence import Presence
presence = Presence()
presence.hold('mill', 'compensator')
print('held', flush=True)
time.sleep(600)
"""


@pytest.fixture(autouse=True)
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv('XDG_RUNTIME_DIR', str(tmp_path))
    monkeypatch.setenv('ROS_DOMAIN_ID', '7')


@pytest.fixture
def holder():
    """A process that holds the lock of the mill's compensator."""
    process = subprocess.Popen([sys.executable, '-c', HOLDER], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == 'held\n'
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def test_a_node_lives_as_long_as_its_process(holder):
    assert lives('/mill', 'compensator')
    assert not lives('mill', 'recorder')
    assert not lives('lathe', 'compensator')
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    assert not lives('mill', 'compensator')


def test_who_lives_of_a_machine(holder):
    with Presence() as own:
        own.hold('mill', 'thermal_predictor')
        own.hold('mill/2', 'recorder')
        own.hold('mill_2', 'recorder')
        assert living('mill') == {'compensator', 'thermal_predictor'}
        assert living('/mill/2') == {'recorder'}
    assert living('mill') == {'compensator'}
    assert living('lathe') == set()


def test_a_stopped_process_still_lives(holder):
    os.kill(holder.pid, signal.SIGSTOP)
    assert lives('mill', 'compensator')


def test_another_domain_is_another_graph(holder, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '8')
    assert not lives('mill', 'compensator')


def test_a_claim_finds_who_is_in_the_way_and_then_holds_nothing(holder):
    with Presence() as presence:
        wanted = [('mill', 'sensor_selector'), ('mill', 'compensator')]
        assert presence.claim(wanted, wanted) == {('mill', 'compensator')}
        assert not lives('mill', 'sensor_selector')


@pytest.mark.parametrize(
    ('machine', 'node', 'refused'),
    [
        ('/mill', 'compensator', False),  # told apart by those who read it
        ('/mill', 'opcua_bridge', True),
        ('/mill', 'simulated_machine', True),
        ('/mill', 'simulated_body', False),
        ('/lathe', 'opcua_bridge', False),
    ],
)
def test_a_machine_has_one_that_stands_for_it(monkeypatch, machine, node, refused):
    with Presence() as presence:
        presence.hold('/mill', 'linuxcnc_bridge')
        presence.hold('/mill', 'compensator')
        said = pytest.raises(ParameterError, match='found /mill/linuxcnc_bridge at work in ROS')
        with said if refused else nullcontext():
            check_alone(machine, node)
        monkeypatch.setenv(TAKEOVER, '1')
        check_alone(machine, node)


def test_a_graph_is_claimed_whole_or_not_at_all(holder):
    with Presence() as presence:
        with pytest.raises(GraphError, match=r'found /mill/compensator at work .* takeover:=true'):
            presence.claim_graph([('mill', 'sensor_selector'), ('mill', 'compensator')])
        assert not lives('mill', 'sensor_selector')
        presence.claim_graph([('lathe', 'simulated_machine')])
        assert lives('lathe', 'simulated_machine')
        with (
            Presence() as second,
            pytest.raises(GraphError, match='found /lathe/simulated_machine'),
        ):
            second.claim_graph([('lathe', 'opcua_bridge')])


def test_a_claim_is_held_until_it_is_left():
    wanted = [('mill/spindle', 'compensator')]
    with Presence() as first, Presence() as second:
        assert first.claim(wanted, wanted) == set()
        assert second.claim(wanted, wanted) == set(wanted)
    assert not lives('mill/spindle', 'compensator')


def test_without_a_folder_nobody_is_in_the_way(monkeypatch):
    monkeypatch.setenv('XDG_RUNTIME_DIR', '/dev/null')
    with Presence() as presence:
        assert presence.claim([('mill', 'compensator')], [('mill', 'compensator')]) == set()
    assert not lives('mill', 'compensator')
