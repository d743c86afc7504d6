# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Which nodes live on this computer."""

import errno
import os
import signal
import subprocess
import sys
import threading
from contextlib import nullcontext

import pytest
from processes import HANG

from fuzzycnc_ros.ros import presence as presence_module
from fuzzycnc_ros.ros.presence import HOLDERS, TAKEOVER, GraphError, Presence, check_alone, lives

NOBODY = 65534
"""User that owns nothing."""
HOLDER = """
import sys, time
from fuzzycnc_ros.ros.presence import Presence
presence = Presence()
presence.hold('mill', 'compensator')
print('held', flush=True)
time.sleep(600)
"""


@pytest.fixture(autouse=True)
def own_domain(monkeypatch, domain):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))


@pytest.fixture
def holder():
    """A process that says of the mill's compensator that it lives."""
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
    monkeypatch.setenv('ROS_DOMAIN_ID', '150')  # which no test has
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
        said = pytest.raises(GraphError, match='found /mill/linuxcnc_bridge at work in ROS')
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


@pytest.mark.parametrize('hidden', ['TMPDIR', 'XDG_RUNTIME_DIR'])
def test_no_folder_hides_who_lives(holder, monkeypatch, tmp_path, hidden):
    monkeypatch.setenv(hidden, str(tmp_path))
    assert lives('mill', 'compensator')


@pytest.mark.skipif(os.getuid() != 0, reason='expected root, who may become another user')
def test_another_user_finds_who_lives(holder):
    with Presence() as presence:
        presence.hold('lathe', 'recorder')
        wanted = [('mill', 'compensator'), ('lathe', 'recorder'), ('lathe', 'compensator')]
        os.seteuid(NOBODY)
        try:
            with Presence() as other:
                assert other.claim([], wanted) == set(wanted[:2])
        finally:
            os.seteuid(0)


def test_of_one_name_many_may_live():
    with Presence() as first:
        for _ in range(3 * HOLDERS):  # more than can be told apart change nothing
            first.hold('mill', 'compensator')
        with Presence() as second:
            second.hold('mill', 'compensator')
        assert lives('mill', 'compensator')
    assert not lives('mill', 'compensator')


def test_of_two_that_outlive_each_other_the_last_is_found():
    with Presence() as late:
        with Presence() as early:
            early.hold('mill', 'compensator')
            late.hold('mill', 'compensator')
        assert lives('mill', 'compensator')


@pytest.fixture
def patient(monkeypatch):
    """Nobody goes in without the door, however busy the machine is."""
    monkeypatch.setattr(presence_module, 'DOOR_TIMEOUT', HANG)


@pytest.mark.usefixtures('patient')
def test_of_many_that_claim_at_once_one_gets_it():
    wanted = [('mill', name) for name in ('compensator', 'sensor_selector')]
    claims = [Presence() for _ in range(8)]
    found = []
    threads = [
        threading.Thread(target=lambda own: found.append(own.claim(wanted, wanted)), args=(own,))
        for own in claims
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for own in claims:
        own.leave()
    assert sorted(map(len, found)) == [0] + [2] * 7


@pytest.mark.usefixtures('patient')
def test_who_claims_waits_while_another_looks():
    wanted = [('mill', 'compensator')]
    with Presence() as own:
        found = []
        thread = threading.Thread(target=lambda: found.append(own.claim(wanted, wanted)))
        with presence_module._door():
            thread.start()
            thread.join(0.2)
            assert thread.is_alive()
        thread.join()
        assert found == [set()]
        assert lives('mill', 'compensator')


def test_where_no_name_can_be_had_nobody_is_in_the_way(monkeypatch):
    def refuse(address):
        raise OSError(errno.EINVAL, 'Invalid argument')

    monkeypatch.setattr('fuzzycnc_ros.ros.presence._bound', refuse)
    with Presence() as presence:
        assert presence.claim([('mill', 'compensator')], [('mill', 'compensator')]) == set()
    assert not lives('mill', 'compensator')
