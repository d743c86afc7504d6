# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands end by a signal, whatever they inherited, and take along what they started."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from processes import HANG, children, living, start, wait_for

from fuzzycnc_ros.bags.reader import BagReader

TRIES = 20
"""How often a command is started that may be done before it is seen at work."""
ENDS = [
    pytest.param(signal.SIGTERM, 'default', 143, id='SIGTERM'),
    pytest.param(signal.SIGTERM, 'ignored', 143, id='SIGTERM-background', marks=pytest.mark.slow),
    pytest.param(signal.SIGINT, 'ignored', 130, id='SIGINT-background'),
    pytest.param(signal.SIGHUP, 'default', 129, id='SIGHUP', marks=pytest.mark.slow),
]
TERMINATED = [
    one if one.id == 'SIGTERM' else pytest.param(*one.values, id=one.id, marks=pytest.mark.slow)
    for one in ENDS
]
"""For further commands that end in the same way."""
KILLED = pytest.param(signal.SIGKILL, 'default', -9, id='SIGKILL')
"""Signal, what SIGINT is at the beginning, and exit code; SIGINT at its default: test_main.py."""


@pytest.fixture
def command(root, tmp_path):
    """Start a command line in an empty folder: `command('replay', interrupts='ignored')`."""
    started = []
    environment = {
        **os.environ,
        'PYTHONPATH': os.pathsep.join([str(root), os.environ.get('PYTHONPATH', '')]),
        'ROS_DOMAIN_ID': str(1 + os.getpid() % 100),
    }

    def begin(*words, interrupts='default'):
        process = start(
            [sys.executable, '-m', 'fuzzycnc_ros.cli.main', *map(str, words)],
            interrupts=interrupts,
            cwd=tmp_path,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.communicate()


def has_open(process, name):
    """Whether a process has a file of this name open."""
    try:
        links = [os.readlink(link) for link in Path(f'/proc/{process.pid}/fd').iterdir()]
    except OSError:  # it has just ended, or closed one
        return False
    return any(Path(link).name == name for link in links)


def end(begin, at_work, number, *, may_be_done=True):
    """Start a process, send a signal once it is at work; return its code and what it wrote.

    One that is done before it is seen at work, or before the signal comes, is started again.
    """
    for _ in range(TRIES):
        process = begin()
        wait_for(lambda p=process: p.poll() is not None or at_work(p), 'the command works')
        process.send_signal(number)
        out, err = process.communicate(timeout=HANG)
        if not may_be_done or (process.returncode != 0 and not out):
            return process.returncode, out, err
    raise AssertionError('expected an end by the signal but found the work done every time')


@pytest.mark.parametrize(('number', 'interrupts', 'code'), ENDS)
@pytest.mark.parametrize(
    'words',
    [
        ('schedule', 'pipe', '--tolerance', '0.01mm', '--out', 'out'),
        ('import-csv', 'pipe', '--out', 'out', '--time', 't', '--displacement', 'd=Z:um'),
    ],
    ids=lambda words: words[0],
)
def test_while_reading_what_does_not_come(command, tmp_path, words, number, interrupts, code):
    pipe, ends = tmp_path / 'pipe', []
    os.mkfifo(pipe)

    def read(process):
        if ends:  # since the last look: it has had the time to begin to read
            return True
        with contextlib.suppress(OSError):  # nobody reads yet
            ends.append(os.open(pipe, os.O_WRONLY | os.O_NONBLOCK))
        return False

    found = end(lambda: command(*words, interrupts=interrupts), read, number)
    for writer in ends:
        os.close(writer)
    assert found == (code, '', 'interrupted\n')
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize(('number', 'interrupts', 'code'), TERMINATED)
def test_replay_in_the_middle_of_work(command, root, number, interrupts, code):
    found = end(
        lambda: command('replay', root / 'bags' / 'mill_warm_up', interrupts=interrupts),
        lambda process: has_open(process, 'mill_warm_up_0.mcap'),
        number,
    )
    assert found == (code, '', 'interrupted\n')


def test_nohup_is_heeded(command, root):
    """The terminal goes, the command does not."""
    for _ in range(TRIES):
        process = command('replay', root / 'bags' / 'mill_warm_up', interrupts='nohup')
        wait_for(
            lambda p=process: p.poll() is not None or has_open(p, 'mill_warm_up_0.mcap'),
            'it reads the bag',
        )
        at_work = process.poll() is None
        process.send_signal(signal.SIGHUP)
        out, err = process.communicate(timeout=HANG)
        if at_work:
            break
    assert at_work
    assert (process.returncode, err) == (0, '')
    assert 'identical' in out


@pytest.mark.parametrize(('number', 'interrupts', 'code'), TERMINATED)
def test_simulate_leaves_whole_bags(command, tmp_path, number, interrupts, code):
    words = ('simulate', '--seeds', '1000', '--out', 'shift')
    calibration = tmp_path / 'shift_calibration'
    found = end(
        lambda: command(*words, interrupts=interrupts), lambda _: calibration.exists(), number
    )
    assert found == (code, '', 'interrupted\n')
    for file in tmp_path.rglob('*.mcap'):
        with BagReader(file.parent) as reader:
            assert reader.message_count == sum(1 for _ in reader.messages(raw=True))
    assert list(calibration.rglob('*.mcap'))


@pytest.mark.parametrize(('number', 'interrupts', 'code'), [*ENDS, KILLED])
def test_compare_takes_its_workers_along(command, root, tmp_path, number, interrupts, code):
    bags = [root / 'bags' / name for name in ('mill_warm_up', 'mill_lost_sensors')]
    words = ('compare', *bags, '--jobs', 2, '--json', 'compared.json')
    found, out, err = end(
        lambda: command(*words, interrupts=interrupts),
        lambda process: len(children(process.pid, 'spawn_main')) == 2,
        number,
    )
    assert (found, out) == (code, '')
    if number != signal.SIGKILL:  # else Python tells of what it has not released
        assert err == 'interrupted\n'
    wait_for(lambda: not living(), 'its workers end')
    assert not (tmp_path / 'compared.json').exists()


GRAPHS = [
    pytest.param(('up', '--simulate', 'T2', '--record', 'bag'), 'bag', id='up'),
    pytest.param(('record', '--out', 'bag'), 'bag', id='record'),
    pytest.param(('demo', '--scenario', 'contour', '--out', 'demo'), 'demo/bag', id='demo'),
    pytest.param(('demo', '--scenario', 'shift', '--out', 'demo'), 'demo/before', id='demo-shift'),
]
"""Commands that start nodes, and a file that is there when they are at work."""


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize(('number', 'interrupts', 'code'), [*ENDS, KILLED])
@pytest.mark.parametrize(('words', 'file'), GRAPHS)
def test_nodes_end_with_their_command(command, tmp_path, words, file, number, interrupts, code):
    """Ctrl-C is how `up` and `record` are ended: they have done what they were to do."""
    pytest.importorskip('rclpy')
    found, _, err = end(
        lambda: command(*words, interrupts=interrupts),
        lambda process: (
            (tmp_path / file).exists() and children(process.pid, 'fuzzycnc_ros.nodes.')
        ),
        number,
        may_be_done=False,
    )
    asked = words[0] in ('up', 'record') and number != signal.SIGKILL
    assert found == (0 if asked else code), err
    wait_for(lambda: not living(), 'its nodes end')
    bags = {path.parent for path in tmp_path.rglob('*.mcap')}
    if number == signal.SIGKILL:  # what the command itself was writing is torn
        bags.discard(tmp_path / 'demo' / 'before')
    for bag in bags:
        with BagReader(bag):
            pass


EARLY = """
import os, signal, sys
from fuzzycnc_ros.cli import background_output
from fuzzycnc_ros.cli.main import APPLICATION
set_up = background_output.BackgroundOutput.__init__
def interrupted(self, *words, **more):
    os.kill(os.getpid(), signal.SIGINT)
    set_up(self, *words, **more)
background_output.BackgroundOutput.__init__ = interrupted
sys.argv = ['fuzzycnc', 'record', '--out', 'bag']
APPLICATION.main()
"""
"""A wish to end that comes while a command that goes on for long sets up its output."""


def test_before_the_command_has_begun(tmp_path):
    done = subprocess.run(
        [sys.executable, '-c', EARLY], cwd=tmp_path, capture_output=True, text=True, timeout=HANG
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, '', 'interrupted\n')
    assert not list(tmp_path.iterdir())
