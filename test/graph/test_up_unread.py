# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc up` and `demo` whose output nobody reads: they act and end all the same."""

import contextlib
import json
import os
import signal
import sys

import pytest
from processes import HANG, children, start, wait_for
from tiers import rest_slow

pytestmark = pytest.mark.ros

NODES = 'temperature_acquisition,compensator'


@pytest.fixture(params=[os.openpty, os.pipe], ids=['terminal', 'pipe'])
def unread(request):
    """A terminal or pipe that is full."""
    reading, writing = request.param()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, b'.' * 1000)
    os.set_blocking(writing, True)
    yield writing
    os.close(reading)
    os.close(writing)


@pytest.fixture
def command(domain, tmp_path, root, unread):
    """Start a command line at the full terminal or pipe: `command('up', '--machine', 'mill')`."""
    (tmp_path / 'temporary').mkdir()
    started = []

    def begin(*words):
        environment = {
            **os.environ,
            'ROS_DOMAIN_ID': str(domain),
            'PYTHONPATH': os.pathsep.join([str(root), os.environ.get('PYTHONPATH', '')]),
            'TMPDIR': str(tmp_path / 'temporary'),
            'TERM': 'xterm',
        }
        started.append(
            start(
                [sys.executable, '-m', 'fuzzycnc_ros.cli.main', *words],
                stdout=unread,
                stderr=unread,
                stdin=unread,
                cwd=tmp_path,
                env=environment,
                start_new_session=True,
            )
        )
        return started[-1]

    yield begin
    for process in started:
        process.kill()
        process.wait()


def nodes_of(process, name=''):
    """Return the processes of a command's nodes, which still runs."""
    assert process.poll() is None, f'ended with code {process.returncode}'
    return children(process.pid, f'fuzzycnc_ros.nodes.{name}')


@pytest.mark.parametrize('number', rest_slow([signal.SIGTERM, signal.SIGINT, signal.SIGHUP], 0))
def test_nodes_are_restarted_and_all_ends(command, tmp_path, number):
    process = command('up', '--nodes', NODES, '--json', 'outcome.json')
    wait_for(lambda: nodes_of(process, 'compensator'), 'the compensator is started')
    (first,) = nodes_of(process, 'compensator')
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: nodes_of(process, 'compensator') not in ([], [first]), 'it is started again')
    process.send_signal(number)
    assert process.wait(HANG) == 0
    outcome = json.loads((tmp_path / 'outcome.json').read_text())
    assert outcome['restarts'] == {'mill/compensator': 1}
    assert list((tmp_path / 'temporary').iterdir()) == []


def test_demo_ends(command):
    process = command('demo', '--scenario', 'contour')
    wait_for(lambda: nodes_of(process), 'its nodes are started')
    process.send_signal(signal.SIGTERM)
    assert process.wait(HANG) == 143
