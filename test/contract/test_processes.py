# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What watches over the processes of all tests does so itself."""

import signal
import subprocess
import sys

import processes
import pytest

LEAVES = """
import subprocess, sys
subprocess.Popen([sys.executable, '-c', 'input()'], stdin=sys.stdin, start_new_session=True)
"""
TELLS = 'import signal; print(signal.getsignal(signal.SIGINT) == signal.SIG_IGN)'


def test_a_process_that_is_left_is_named_and_ended(monkeypatch):
    check = processes.nobody_left()
    next(check)
    pipes = {'stdin': subprocess.PIPE}
    with processes.start([sys.executable, '-c', LEAVES], **pipes) as parent:
        parent.wait(processes.HANG)
        processes.wait_for(processes.living, 'it is found')
        (left,) = processes.living()
        monkeypatch.setattr(processes, 'HANG', 0.0)
        with pytest.raises(AssertionError, match=rf'{left}: .*input\(\)'):
            next(check)
    monkeypatch.undo()
    processes.wait_for(lambda: not processes.living(), 'it is killed')


def test_a_process_that_takes_its_time_to_begin_is_found():
    """On a busy machine it has no environment yet whenever somebody looks."""
    begins = ['sh', '-c', f'read word; exec env {processes.MARK} cat']
    pipes = {'stdin': subprocess.PIPE, 'text': True}
    with processes.start(begins, env={}, **pipes) as process:
        for _ in range(3):
            assert process.pid not in processes.living()
        print('go', file=process.stdin, flush=True)
        processes.wait_for(lambda: process.pid in processes.living(), 'it is found')
        process.stdin.close()


@pytest.mark.parametrize('here', [signal.SIG_IGN, signal.default_int_handler])
@pytest.mark.parametrize('interrupts', ['default', 'ignored'])
def test_interrupts_are_as_the_test_needs_them(here, interrupts):
    before = signal.signal(signal.SIGINT, here)
    try:
        command = [sys.executable, '-c', TELLS]
        with processes.start(command, interrupts=interrupts, stdout=subprocess.PIPE) as process:
            told = process.stdout.read().decode()
    finally:
        signal.signal(signal.SIGINT, before)
    assert told == f'{interrupts == "ignored"}\n'
