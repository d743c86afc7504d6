# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that tests start: signals as the test needs them, and none that outlives its test."""

import contextlib
import os
import signal
import socket
import subprocess
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

HANG = 240.0
"""Wall time [s] after which what is waited for will not come: no bound on how long it may take."""
POLL = 0.01

MARK = f'FUZZYCNC_TEST={uuid.uuid4().hex}'
"""Environment of everything that this process and its descendants start."""
os.environ.update([MARK.split('=')])
KEPT = 'FUZZYCNC_TEST_KEPT=1'
"""Environment of what a fixture of many tests ends, and no single test."""

_strangers: set[int] = set()


def start(
    command: Sequence[str], *, interrupts: str = 'default', **options: Any
) -> 'subprocess.Popen[Any]':
    """Start a process in which SIGINT is at its `default`, or `ignored` as in the background.

    As under `nohup` SIGHUP is ignored; else it is at its default.

    Without this it would be as in whatever shell the tests were started from.
    """
    ignored = {'default': (), 'ignored': (signal.SIGINT,), 'nohup': (signal.SIGHUP,)}[interrupts]
    wishes = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def set_up() -> None:
        for number in (signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN if number in ignored else signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, wishes)

    return subprocess.Popen(command, preexec_fn=set_up, **options)


def said(process: 'subprocess.Popen[str]') -> str:
    """Return the next line that a process printed itself: its middleware prints what it meets."""
    assert process.stdout
    for line in iter(process.stdout.readline, ''):
        if 'RTPS_' not in line:
            return line
    return ''


def wait_for(condition: Callable[[], Any], what: str) -> None:
    """Wait until a condition holds.

    Raises
    ------
    AssertionError
        If it never does.
    """
    until = time.monotonic() + HANG
    while not condition():
        assert time.monotonic() < until, f'not within {HANG:g} s: {what}'
        time.sleep(POLL)


def free_port() -> int:
    """Return a port of this computer at which a process that is started next can serve."""
    with socket.socket() as found:
        found.bind(('127.0.0.1', 0))
        return int(found.getsockname()[1])


def living() -> set[int]:
    """Return the processes that this one or its descendants have started and that still run."""
    pids = {int(name) for name in os.listdir('/proc') if name.isdigit()} - {os.getpid()}
    _strangers.intersection_update(pids)
    ours = {pid: _is_ours(pid) for pid in pids - _strangers}
    _strangers.update(pid for pid, known in ours.items() if known is False)
    # The resource tracker lives as long as this process.
    return {pid for pid, known in ours.items() if known} - {
        resource_tracker._resource_tracker._pid
    }


def command_line(pid: int) -> str:
    """Return the command line of a process; empty if it is gone."""
    try:
        return Path(f'/proc/{pid}/cmdline').read_bytes().replace(b'\0', b' ').decode().strip()
    except OSError:
        return ''


def children(pid: int, text: str) -> list[int]:
    """Return the descendants of a process that have a text in their command line."""
    parents = {item: _parent(item) for item in living()}
    below, found = {pid}, True
    while found:
        found = {item for item, parent in parents.items() if parent in below} - below
        below |= found
    return sorted(item for item in below - {pid} if text in command_line(item))


def nobody_left() -> Iterator[None]:
    """Fixture: what was started in the meantime has ended.

    Raises
    ------
    AssertionError
        If a process does not; it is killed, so that it disturbs no other test.
    """
    before = living()
    yield
    until = time.monotonic() + HANG
    while (left := living() - before) and time.monotonic() < until:
        time.sleep(POLL)
    names = [f'{pid}: {command_line(pid)}' for pid in sorted(left)]
    for pid in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    assert not names, f'expected no process of this test to be left but found {names}'


def _is_ours(pid: int) -> bool | None:
    """Return whether this process or a descendant has started one; None if that is to be seen.

    One that is about to begin has no environment yet, on a busy machine for a while.
    """
    try:
        environment = Path(f'/proc/{pid}/environ').read_bytes()
    except OSError:  # gone, or another user's
        return False
    if not environment:
        return None
    if KEPT.encode() in environment:
        return False
    return MARK.encode() in environment or _parent(pid) == os.getpid()


def _parent(pid: int) -> int:
    """Return the parent of a process; 0 if it is gone."""
    try:
        return int(Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[1])
    except OSError:
        return 0
