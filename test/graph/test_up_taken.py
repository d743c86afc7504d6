# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc up` where others are at work already."""

import contextlib
import os
import shutil
import signal
import sys

import pytest
from processes import children, wait_for

pytestmark = pytest.mark.ros

NODES = 'temperature_acquisition,compensator'
# It may read everything, since Python and this tree may lie where root alone looks.
NOBODY = ['setpriv', '--reuid=65534', '--regid=65534', '--clear-groups']
NOBODY += [f'--{kind}=-all,+dac_read_search' for kind in ('inh-caps', 'ambient-caps')]


@pytest.fixture
def up(graph, tmp_path):
    """Start `fuzzycnc up` in the domain of the test: `up('first', '--simulate', 'T2')`."""

    def begin(name, *words, prefix=()):
        folder = tmp_path / name
        folder.mkdir()
        command = [*prefix, sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'up', *words]
        return graph.launch(name, command, folder)

    return begin


def started(command):
    """Wait until all nodes of a command are started."""
    wait_for(
        lambda: 'all started' in command.output or command.process.poll() is not None,
        f'{command.name} has started its nodes',
    )
    assert command.process.poll() is None, command.output
    return command


def there(pid):
    """Whether a process lives."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, 0)
        return True
    return False


def refusal(command):
    """Wait for the end of a command that is refused; return its one line."""
    assert command.wait() == 2, command.output
    # The middleware writes there too, of its shared memory.
    (line,) = [line for line in command.output.splitlines() if line.startswith('error: ')]
    assert 'runs as process' not in command.output
    return line


def test_second_of_the_same_name_is_refused(up):
    started(up('first', '--nodes', NODES, '--compose'))
    line = refusal(up('second', '--nodes', 'compensator,sensor_selector'))
    assert 'expected no nodes in mill but found /mill/compensator at work' in line
    assert '--takeover' in line
    line = refusal(up('both', '--machine', 'mill,other'))
    assert 'found /mill/compensator, /mill/temperature_acquisition at work' in line


@pytest.mark.slow
@pytest.mark.skipif(
    os.getuid() != 0 or shutil.which('setpriv') is None,
    reason='expected root and setpriv (apt-get install util-linux), to become another user',
)
def test_second_by_another_user_is_refused(up, tmp_path):
    """The graph shows it nobody: it cannot write the shared memory of the first one."""
    started(up('first', '--machine', 'shop/mill', '--nodes', NODES))
    home = tmp_path / 'home'
    home.mkdir()
    home.chmod(0o777)
    second = up(
        *('second', '--machine', '/shop/mill/', '--nodes', 'compensator,sensor_selector'),
        prefix=[*NOBODY, 'env', f'HOME={home}'],
    )
    line = refusal(second)
    assert 'expected no nodes in shop/mill but found /shop/mill/compensator at work' in line
    started(up('elsewhere', '--nodes', 'compensator'))


@pytest.mark.slow
def test_two_machines_of_one_name(up):
    """A second one that makes time, though no node has the name of another."""
    started(up('first', '--simulate', 'T2', '--nodes', 'temperature_acquisition'))
    line = refusal(up('second', '--nodes', 'simulated_body,compensator'))
    assert 'found /mill/simulated_machine at work' in line


@pytest.mark.slow
def test_of_two_that_start_at_once_one_is_refused(up):
    """Neither could find the other in the graph yet."""
    both = [up(name, '--nodes', NODES) for name in ('first', 'second')]
    wait_for(lambda: any(item.process.poll() is not None for item in both), 'one has ended')
    late = next(item for item in both if item.process.poll() is not None)
    assert 'at work' in refusal(late)
    (early,) = (item for item in both if item is not late)
    started(early)


@pytest.mark.slow
def test_who_is_in_nobodys_way_may_join(up, tmp_path):
    started(up('first', '--nodes', 'compensator', '--record', str(tmp_path / 'first_bag')))
    others = ('--nodes', 'sensor_selector', '--record', str(tmp_path / 'second_bag'))
    started(up('others', *others))
    started(up('elsewhere', '--machine', 'lathe', '--nodes', 'compensator'))
    started(up('meant', '--nodes', 'compensator', '--takeover'))


@pytest.mark.slow
def test_a_bridge_by_itself_is_refused_beside_another(up, graph, observer):
    started(up('first', '--simulate', 'T2', '--nodes', 'temperature_acquisition'))
    bridge = graph.start('opcua_bridge', {'axes': ['Y']})
    assert bridge.wait() == 2
    (line,) = [line for line in bridge.output.splitlines() if line.startswith('error: ')]
    assert 'opcua_bridge: expected nobody who stands for mill' in line
    assert 'found /mill/simulated_machine at work' in line
    elsewhere = graph.start('opcua_bridge', {'axes': ['Y']}, namespace='/lathe')
    assert observer.state('opcua_bridge', 'lathe')
    assert elsewhere.process.poll() is None


@pytest.mark.parametrize('dead', ['command', pytest.param('nodes', marks=pytest.mark.slow)])
def test_what_was_killed_locks_nobody_out(up, dead):
    """The nodes of a killed command end by themselves; killed nodes linger in the graph."""
    first = started(up('first', '--nodes', NODES))
    nodes = children(first.process.pid, 'fuzzycnc_ros.nodes.')
    assert len(nodes) == 2
    os.kill(first.process.pid, signal.SIGKILL)
    first.process.wait()
    if dead == 'nodes':
        for node in nodes:
            os.kill(node, signal.SIGKILL)
    wait_for(lambda: not any(map(there, nodes)), 'the nodes have ended')
    started(up('second', '--nodes', NODES))
