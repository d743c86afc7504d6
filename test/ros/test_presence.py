# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Locks of nodes that live on this computer."""

import os
import signal
import subprocess
import sys

import pytest

from fuzzycnc_ros.ros.presence import Presence, lives

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
