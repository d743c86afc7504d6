# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A wish to end is heeded wherever it meets the process."""

import signal
import subprocess
import sys
import threading

import pytest
from processes import start, wait_for

from fuzzycnc_ros.files.uninterrupted import Interrupted
from fuzzycnc_ros.graph.bring_up import NODE_STOP
from fuzzycnc_ros.ros import processes
from fuzzycnc_ros.ros.processes import EXITING, interruptible
from fuzzycnc_ros.ros.run import LETTING_GO


class Finalised:
    """Gets a signal while it is finalised, where Python can only print what is raised."""

    def __del__(self):
        signal.raise_signal(signal.SIGTERM)


def never():
    """Return False."""
    return False


class EarlyTimer(threading.Timer):
    """Takes so long to start that its signal is there before, the first time."""

    started = 0

    def start(self):
        EarlyTimer.started += 1
        if EarlyTimer.started == 1:
            signal.raise_signal(signal.SIGTERM)
        else:
            super().start()


def test_a_wish_is_put_off_where_an_exception_would_be_lost():
    with interruptible() as wish:
        with wish.put_off():
            signal.raise_signal(signal.SIGTERM)
            assert wish.number == signal.SIGTERM
        assert not wish._reminder.is_alive() or wish._reminder.finished.is_set()


def test_a_wish_that_was_put_off_ends_what_hangs(monkeypatch):
    monkeypatch.setattr(processes, 'HANGS', 0.01)
    monkeypatch.setattr(processes, 'ONE_WISH', 0.0)
    with interruptible() as wish, pytest.raises(Interrupted), wish.put_off():  # noqa: PT012
        signal.raise_signal(signal.SIGTERM)
        wait_for(never, 'nothing: the wish ends this')


@pytest.mark.parametrize('timer', [threading.Timer, EarlyTimer])
def test_wish_that_meets_a_finaliser_is_repeated(monkeypatch, timer):
    monkeypatch.setattr('fuzzycnc_ros.ros.processes.threading.Timer', timer)
    with interruptible() as wish:
        item = Finalised()
        with pytest.raises(Interrupted):  # noqa: PT012
            del item
            wait_for(never, 'nothing: the wish ends this')
    assert wish.number == signal.SIGTERM


def test_other_errors_that_are_lost_are_told_as_ever(monkeypatch):
    told = []
    monkeypatch.setattr('sys.unraisablehook', told.append)

    class Faulty:
        def __del__(self):
            raise ValueError

    with interruptible():
        item = Faulty()
        del item
    assert [lost.exc_type for lost in told] == [ValueError]


@pytest.mark.parametrize('hang', ['while True: pass', "re.match('(a+)+$', 80 * 'a' + 'b')"])
def test_a_process_ends_in_time_whatever_it_hangs_in(hang):
    """The second one holds the interpreter, as middleware does that spins in a destructor."""
    script = (
        'import re\nfrom fuzzycnc_ros.ros.processes import ending_within\n'
        f'print("told", flush=True)\nwith ending_within(1, 7):\n  {hang}\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (7, 'told\n', '')


def test_a_process_that_is_through_in_time_is_left_alone():
    script = (
        'import time\nfrom fuzzycnc_ros.ros.processes import ending_within\n'
        'with ending_within(1, 7): pass\ntime.sleep(1.5)\n'
    )
    done = subprocess.run([sys.executable, '-c', script], timeout=60, check=False)
    assert done.returncode == 0


LATE = """
import atexit, os, signal, sys
from fuzzycnc_ros.ros.processes import end, interruptible
with interruptible():
    atexit.register(os.kill, os.getpid(), signal.{name})
end(3)
"""


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM', 'SIGHUP'])
def test_a_wish_that_comes_when_all_is_done_is_no_failure(name):
    """A machine's duty is over as somebody ends the run."""
    done = start([sys.executable, '-c', LATE.format(name=name)], stderr=subprocess.PIPE, text=True)
    assert (done.communicate()[1], done.returncode) == ('', 3)


def test_a_node_ends_by_itself_before_it_is_killed():
    """Else `up` and `demo` would report the middleware's hang as a node that failed."""
    assert LETTING_GO <= 0.6 * NODE_STOP
    assert LETTING_GO + EXITING < NODE_STOP


HANGS_AT_EXIT = """
import atexit, sys
from fuzzycnc_ros.ros import processes
processes.EXITING = 1
def hang():
    while True:
        pass
atexit.register(hang)
processes.end(3)
"""


def test_a_library_that_hangs_as_the_process_exits_holds_it_no_longer():
    command = [sys.executable, '-c', HANGS_AT_EXIT]
    assert subprocess.run(command, timeout=60, check=False).returncode == 3


WISHED = """
import signal
import rclpy
from fuzzycnc_ros.ros.processes import end
from fuzzycnc_ros.ros.run import run

class Host:
    exit_code, executor, done = 0, 'lean', False
    def __init__(self):
        self.node = rclpy.create_node('deaf')
        self.calls = 0
        self.node.create_timer(0.01, self.work)
    def work(self):
        self.calls += 1
        if self.calls > 1:
            raise SystemExit('went on')
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            {instead}
    def start(self):
        pass
    stop = start

end(run([Host], ['deaf', '--ros-args', '-r', '__ns:=/ending']))
"""


@pytest.mark.parametrize('instead', ['pass', 'raise SystemError("an exception set") from error'])
def test_a_wish_ends_a_node_whatever_becomes_of_exceptions(instead):
    """Libraries in C clear what a callback of theirs raises, or make another error of it."""
    command = [sys.executable, '-c', WISHED.format(instead=instead)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (done.stderr, done.returncode) == ('', 0)
