# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Output that nobody reads: it is dropped, counted, and keeps nobody from ending."""

import contextlib
import fcntl
import math
import os
import select
import subprocess
import sys

import pytest
from processes import HANG, start, wait_for
from rich.console import Console
from tiers import rest_slow

from fuzzycnc_ros.cli.background_output import BackgroundOutput
from fuzzycnc_ros.cli.live import supervision_view
from fuzzycnc_ros.cli.live.supervision_view import ProcessView

LINES = 5000
"""More than a pipe and the queue hold."""


@pytest.fixture
def pipe():
    """A small pipe: the end to read, and a stream of the end to write."""
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    with open(writing, 'w', encoding='utf-8') as stream:
        yield reading, stream
        with contextlib.suppress(OSError):
            os.close(reading)


@pytest.fixture
def terminal():
    """A terminal: the side of its reader, and a stream."""
    reading, writing = os.openpty()
    with open(writing, 'w', encoding='utf-8') as stream:
        yield reading, stream
        os.close(reading)


def fill(stream):
    """Write until nothing goes in any more."""
    os.set_blocking(stream.fileno(), False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(stream.fileno(), b'.' * 1000)
    os.set_blocking(stream.fileno(), True)


def read_until(reading, text):
    """Read until a text has come; return all."""
    found = b''
    while text.encode() not in found:
        assert select.select([reading], [], [], HANG)[0], found[-500:]
        found += os.read(reading, 65536)
    return found.decode()


def test_whoever_writes_does_not_wait_and_is_told_what_was_lost(pipe):
    reading, stream = pipe
    fill(stream)
    output = BackgroundOutput(stream, pending_max=2000)
    for number in range(LINES):
        print(f'line {number}', file=output)
    assert output.behind
    found = read_until(reading, 'lines omitted here]\n')
    kept, note = found.strip('.').split('\n\n')
    kept = kept.splitlines()
    assert kept == [f'line {number}' for number in range(len(kept))]
    assert note == f'[output was not read: {LINES - len(kept)} lines omitted here]\n'
    wait_for(lambda: not output.behind, 'all is taken')
    print('again', file=output)
    assert read_until(reading, 'again\n') == 'again\n'
    output.finish(HANG)


def test_what_is_read_is_whole(pipe):
    reading, stream = pipe
    output = BackgroundOutput(stream)
    text = ''.join(f'{number} µm\n' for number in range(LINES))
    output.write(text)
    assert read_until(reading, f'{LINES - 1} µm\n') == text
    output.finish(HANG)


def test_a_reader_that_is_gone_ends_the_writing_alone(pipe):
    reading, stream = pipe
    output = BackgroundOutput(stream)
    os.close(reading)
    print('line', file=output)
    output.finish(HANG)
    print('line', file=output)


class Counting(BackgroundOutput):
    """Counts what is written to it."""

    writes = 0

    def write(self, text):
        self.writes += bool(text)
        return super().write(text)


def test_the_table_waits_for_its_reader(terminal, monkeypatch):
    """Of a table only the newest is of use: none is queued behind one that nobody takes."""
    monkeypatch.setattr(supervision_view, 'REFRESH', math.inf)
    reading, stream = terminal
    fill(stream)
    output = Counting(stream)
    with ProcessView(Console(file=output, force_terminal=True, width=80)) as view:
        view.tell('first')
        before = output.writes
        for _ in range(100):
            view.update([], None)
        assert output.writes == before
        read_until(reading, 'first')
        wait_for(lambda: not output.behind, 'all is taken')
        view.update([], None)
        assert 'limits and trouble' in read_until(reading, 'limits and trouble')
    output.finish(HANG)


SCRIPT = """
import os, sys
from fuzzycnc_ros.cli.background_output import background_output

with background_output():
    for number in range(200_000):
        if number % 3:
            print(number, file=(sys.stdout, sys.stderr)[number % 2])
        else:  # as the middleware does
            os.write(1 + number % 2, b'%d\\n' % number)
sys.exit(3)
"""


@pytest.mark.parametrize('open_one', rest_slow([os.openpty, os.pipe], 1))
def test_a_process_ends_though_nobody_reads(open_one):
    reading, writing = open_one()
    process = start([sys.executable, '-c', SCRIPT], stdout=writing, stderr=writing)
    try:
        assert process.wait(HANG) == 3
    finally:
        process.kill()
        os.close(reading)
        os.close(writing)


def test_a_process_that_is_read_loses_nothing():
    patient = f'from fuzzycnc_ros.cli import background_output as b; b.FLUSH_TIME = {HANG}'
    script = patient + SCRIPT.replace('200_000', '2000')
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    for found, first in ((done.stdout, 0), (done.stderr, 1)):
        assert sorted(map(int, found.split())) == list(range(first, 2000, 2))
