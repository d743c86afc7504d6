# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Whether this machine keeps real time now: what is too slow or too busy cannot be judged.

Tests marked `realtime` are measured before they run, and a failed one again right after it.  Where
too few deadlines are kept, the outcome is a skip that names the figure; a failure on a machine
that keeps its deadlines stays one.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

PROCESSES = 2
"""That keep time at once, as the nodes of a graph do."""
DEADLINES = 50
"""Of each process."""
PERIOD = 0.01
"""Between two deadlines [s]."""
WORK = 40_000
"""Square roots to be taken by each deadline: a quarter of the period on a processor of 2020."""
NEEDED = 0.9
"""Share of the deadlines that must be kept."""
SCRIPT = f"""
import math, sys, time
begin, kept, number = float(sys.argv[1]), 0, 0
while number < {DEADLINES}:
    time.sleep(max(0.0, begin + number * {PERIOD} - time.monotonic()))
    for value in range({WORK}):
        math.sqrt(value)
    late = time.monotonic() - begin - (number + 1) * {PERIOD}
    kept += late < 0.0
    number += 1 + max(0, math.ceil(late / {PERIOD}))  # what has passed meanwhile is missed too
print(kept)
"""
START = 0.1
"""Time that the processes get to start [s]."""
TIMEOUT = 60.0


@dataclass(frozen=True)
class Deadlines:
    """How many deadlines were kept."""

    kept: int
    passed: int

    @property
    def enough(self) -> bool:
        """Whether what runs in real time can be judged."""
        return self.kept >= NEEDED * self.passed

    def __str__(self) -> str:
        """Say so."""
        return f'not judged: this machine keeps {self.kept} of {self.passed} deadlines'


def measure() -> Deadlines:
    """Let some processes work against the clock; count the deadlines that they keep."""
    begin = time.monotonic() + START
    command = [sys.executable, '-I', '-S', '-c', SCRIPT, repr(begin)]
    started = [
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(PROCESSES)
    ]
    kept = 0
    for process in started:
        try:
            kept += int(process.communicate(timeout=TIMEOUT)[0])
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
    return Deadlines(kept, PROCESSES * DEADLINES)


@contextlib.contextmanager
def held_still() -> Iterator[None]:
    """Stop all processes that this one has started: the load of a test is not the machine's."""
    stopped = _descendants(os.getpid())
    for number in stopped:
        _send(number, signal.SIGSTOP)
    try:
        yield
    finally:
        for number in stopped:
            _send(number, signal.SIGCONT)


def _send(number: int, wish: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.kill(number, wish)


def _descendants(process: int) -> set[int]:
    parents: dict[int, int] = {}
    for file in Path('/proc').glob('[0-9]*/stat'):
        with contextlib.suppress(OSError):
            # The name before it may hold anything, parentheses too.
            parents[int(file.parent.name)] = int(file.read_text().rpartition(')')[2].split()[1])
    found = {process}
    while more := {child for child, parent in parents.items() if parent in found} - found:
        found |= more
    return found - {process}


def before(item: pytest.Item) -> None:
    """Skip a test in real time on a machine that keeps none."""
    if item.get_closest_marker('realtime') and not (found := measure()).enough:
        pytest.skip(str(found))


def after(item: pytest.Item, report: pytest.TestReport) -> None:
    """Make a failure in real time a skip if the machine keeps none right now."""
    if not (report.failed and report.when == 'call' and item.get_closest_marker('realtime')):
        return
    with held_still():
        found = measure()
    if found.enough:
        report.sections.append(('real time', f'{found.kept} of {found.passed} deadlines are kept'))
        return
    path, line, _ = item.location
    report.outcome = 'skipped'
    report.longrepr = (str(path), line or 0, f'Skipped: {found}, and the test failed')
