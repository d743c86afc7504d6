# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings on a disk that fills up: they wait with an alarm, go on, and say what is lost.

The disk is a real one of a few megabytes, in a name space of the command alone.
"""

import json
import os
import sys
from contextlib import ExitStack
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from processes import HANG, free_port, wait_for
from std_msgs.msg import Header

from fuzzycnc_ros.bags.reader import BagReader

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROOM = '4m', 2_500_000
"""Size of a disk, and what is put there so that less than the following is free [bytes]."""
FREE_MIN = '2MB'
PLENTY = '300m', 150_000_000
"""The same where a recorder keeps its 200 MB free."""


class SmallDisk:
    """A disk that one command sees, and others by way of its process."""

    def __init__(self, place, size):
        self.place, self._size, self._open = place, size, None
        place.mkdir()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self._open is not None:
            os.close(self._open)

    def command(self, *words):
        """Return the line of a command that begins with the disk being there."""
        mount = f'mount -t tmpfs -o size={self._size} none {self.place} && exec "$@"'
        line = [sys.executable, '-m', *map(str, words)]
        return ['unshare', '-Urm', 'sh', '-c', mount, 'sh', *line]

    def seen_by(self, running):
        """Look at the disk of a process, and hold it: it would be gone with its name space."""
        seen = Path(f'/proc/{running.process.pid}')
        wait_for(lambda: f' {self.place} ' in (seen / 'mountinfo').read_text(), 'the disk')
        self._open = os.open(seen / 'root' / self.place.relative_to('/'), os.O_RDONLY)

    def inside(self, name):
        """Return the place of a file of the disk."""
        return Path(f'/proc/self/fd/{self._open}') / name

    def fill(self, size):
        """Leave so much less room [bytes]."""
        self.inside('ballast').write_bytes(bytes(size))

    def make_room(self):
        """Have all of it free again, but for the bag."""
        self.inside('ballast').unlink()


class Traffic:
    """What is recorded: numbers of the test itself, each with a text of its own."""

    def __init__(self, observer):
        self._observer = observer
        self._publisher = observer.node.create_publisher(Header, '/mill/said', 500)
        self.alarms, self.sent = [], 0
        observer.node.create_subscription(DiagnosticArray, '/diagnostics', self._note, 100)

    def _note(self, array):
        found = [s for s in array.status if s.name.endswith('recorder: disk')]
        said = [s.message for s in found if s.level == b'\x02']
        recorders = [s for s in array.status if s.name.endswith('recorder: bag')]
        if recorders:
            self.alarms.append(said[0] if said else '')
            self.values = {item.key: item.value for item in recorders[0].values}

    def heard(self):
        """Wait for the recorder to listen."""
        self._observer.until(lambda: self._publisher.get_subscription_count(), 'a recorder')

    def say(self, count=20):
        for _ in range(count):
            self._publisher.publish(Header(frame_id=f'{self.sent} {os.urandom(500).hex()}'))
            self.sent += 1

    def until_alarmed(self):
        self._observer.until(lambda: self.alarms and self.alarms[-1], 'the alarm')
        assert 'make room, it then goes on by itself' in self.alarms[-1]

    def until_received(self):
        """In simulated time it takes nothing before the machine has begun."""
        self._observer.until(lambda: self._counted('received'), 'all is received')

    def until_written(self):
        def gone_on():
            return not self.alarms[-1] and self._counted('written')

        self._observer.until(gone_on, 'it goes on')

    def _counted(self, what):
        return self.alarms and int(self.values[what]) >= self.sent


def paused_and_gone_on(disk, traffic, ballast=ROOM[1]):
    """Fill a disk under a recording, and make room again."""
    traffic.heard()
    traffic.say()
    traffic.until_received()
    fill_up(disk, traffic, ballast)
    disk.make_room()
    traffic.until_written()


def fill_up(disk, traffic, ballast=ROOM[1]):
    """Fill a disk under a recording, and say what finds no room."""
    disk.fill(ballast)
    traffic.until_alarmed()
    traffic.say()
    traffic.until_received()


def said(bag):
    with BagReader(bag) as reader:
        found = [m.message.frame_id for m in reader.messages(['/mill/said'])]
    return [int(text.split()[0]) for text in found]


@pytest.fixture
def small_disk(tmp_path):
    """A disk of a size."""
    with ExitStack() as stack:
        yield lambda size: stack.enter_context(SmallDisk(tmp_path / 'disk', size))


@pytest.mark.parametrize('full', [False, True])
def test_record(graph, observer, small_disk, tmp_path, full):
    disk, traffic = small_disk(ROOM[0]), Traffic(observer)
    bag = disk.place / 'bag'
    line = disk.command(
        *('fuzzycnc_ros.cli.main', 'record', '--out', bag, '--free-min', FREE_MIN),
        *('--topics', '^/mill/said$', '--json', tmp_path / 'record.json'),
    )
    (tmp_path / 'record').mkdir()
    running = graph.launch('record', line, tmp_path / 'record')
    disk.seen_by(running)
    paused_and_gone_on(disk, traffic)
    if full:
        fill_up(disk, traffic)
    assert running.interrupt() == full, running.output
    assert 'the recording to' in running.output
    errors = [text for text in running.output.splitlines() if text.startswith('error: ')]
    assert len(errors) == full
    if full:
        assert '20 messages of /mill/said are lost' in errors[0]
        assert 'the disk was full' in errors[0]
    assert said(disk.inside('bag')) == list(range(40))


@pytest.mark.parametrize('full', [False, True])
def test_up(graph, observer, small_disk, tmp_path, full):
    disk, traffic = small_disk(ROOM[0]), Traffic(observer)
    line = disk.command(
        *('fuzzycnc_ros.cli.main', 'up', '--simulate', 'T2', '--rate', 60),
        *('--nodes', 'temperature_acquisition', '--record', disk.place / 'bag'),
        *('--free-min', FREE_MIN, '--json', tmp_path / 'outcome.json'),
    )
    (tmp_path / 'up').mkdir()
    running = graph.launch('up', line, tmp_path / 'up')
    disk.seen_by(running)
    paused_and_gone_on(disk, traffic)
    if full:
        fill_up(disk, traffic)
    assert running.interrupt() == full, running.output
    lacking = json.loads((tmp_path / 'outcome.json').read_text())['lacking']
    assert len(lacking) == full
    if full:
        assert '20 messages of /mill/said are lost' in lacking[0]
        assert 'the disk was full' in lacking[0]
        assert f'error: {lacking[0]}' in running.output
    assert said(disk.inside('bag')) == list(range(40))


def act(page, **body):
    """Ask the page to record; return whether it does so, and what it says."""
    request = Request(
        f'{page}act/mill/record', json.dumps(body).encode(), {'Content-Type': 'application/json'}
    )
    try:
        with urlopen(request, timeout=HANG) as answer:
            return True, json.load(answer)['says']
    except HTTPError as error:
        with error:
            return False, json.load(error)['says']


@pytest.mark.parametrize('full', [False, True])
@pytest.mark.parametrize('by', ['page', 'end'])
def test_page(graph, observer, small_disk, tmp_path, full, by):
    """A recording from the page, which a person ends there, or the page as it ends itself."""
    disk, traffic = small_disk(PLENTY[0]), Traffic(observer)
    graph.start('temperature_acquisition')
    port = free_port()
    (tmp_path / 'page').mkdir()
    line = disk.command('fuzzycnc_ros.nodes.dashboard', '--ros-args', '-p', f'port:={port}')
    line += ['-p', f'bags:={disk.place}']
    running = graph.launch('dashboard', line, tmp_path / 'page')
    disk.seen_by(running)
    page = f'http://127.0.0.1:{port}/'
    wait_for(lambda: 'live page: ' in running.output, 'the page')
    observer.until(lambda: act(page, by='anna', start=True)[0], 'a recording')
    paused_and_gone_on(disk, traffic, PLENTY[1])
    if full:
        fill_up(disk, traffic, PLENTY[1])
    (bag,) = disk.inside('.').glob('mill_*')
    if by == 'page':
        done, says = act(page, by='anna', start=False)
        assert done != full, says
    else:
        assert running.interrupt() == full, running.output
        says = running.output
    assert ('20 messages of /mill/said are lost' in says) == full
    assert ('since the disk was full' in says) == full
    assert said(bag) == list(range(40))
