#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Run a tier of the tests, part by part, and show how long each part took.

A tier has two parts: what keeps no time of its own runs on all processors, what runs in real time
runs alone, one test after another.  Up to five tests that fail are run once more, alone: a part
is `unsteady` if they pass then, and they are named.  Times are given in seconds and as a ratio to
a fixed computation of the same run, which tells a slow machine from a slow suite.

Usage: tools/run_tests.py fast|slow|qualify [PYTEST ARGUMENT...]
       tools/run_tests.py table
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DURATIONS = ROOT / 'build' / 'durations.tsv'
TIERS = {
    'fast': 'not slow and not qualify',
    'slow': 'slow and not qualify',
    'qualify': 'qualify',
}
ON_ALL_CORES = ('-n', str(min(len(os.sched_getaffinity(0)) + 1, 8)), '--dist', 'worksteal')
"""One worker more than there are processors: tests that wait for a process leave theirs idle."""
PASSED, FAILED, NO_TESTS = 0, 1, 5
"""Exit codes of pytest: the last where the expression leaves none."""
AGAIN_MAX = 5
"""Most failed tests of a part that are run again: more do not fail by chance."""
LAST_FAILED = ROOT / '.pytest_cache' / 'v' / 'cache' / 'lastfailed'


def yardstick() -> float:
    """Return the time that a fixed computation takes here [s]: the best of three, on one core."""
    best = math.inf
    for _ in range(3):
        begin = time.perf_counter()
        total = 0.0
        for number in range(1_000_000):
            total += math.sqrt(number) * (number % 7)
        best = min(best, time.perf_counter() - begin)
    return best


def table(rows: list[tuple[str, str, float]], unit: float) -> str:
    """Return part, outcome, time [s] and ratio to the fixed computation as text."""
    lines = [f'{"part":<28} {"outcome":<8} {"s":>7} {"ratio":>8}']
    for name, outcome, seconds in rows:
        lines.append(f'{name:<28} {outcome:<8} {seconds:7.1f} {seconds / unit:8.0f}')
    lines.append(f'the fixed computation takes {unit * 1e3:.0f} ms here')
    return '\n'.join(lines)


def note(name: str, outcome: str, seconds: float) -> None:
    """Keep a row for the table of a whole run."""
    DURATIONS.parent.mkdir(exist_ok=True)
    with DURATIONS.open('a', encoding='utf-8') as file:
        file.write(f'{name}\t{outcome}\t{seconds:.1f}\n')


def noted() -> list[tuple[str, str, float]]:
    """Return the rows that were kept since the file was removed."""
    if not DURATIONS.is_file():
        return []
    rows = (line.split('\t') for line in DURATIONS.read_text(encoding='utf-8').splitlines())
    return [(name, outcome, float(seconds)) for name, outcome, seconds in rows]


def run(name: str, arguments: list[str]) -> int:
    """Run a part, and once more what fails of it; return the exit code of pytest."""
    begin = time.monotonic()
    LAST_FAILED.unlink(missing_ok=True)
    code = pytest(arguments)
    outcome = {PASSED: 'passed', NO_TESTS: 'no tests'}.get(code, 'failed')
    failed = list(json.loads(LAST_FAILED.read_text())) if LAST_FAILED.is_file() else []
    if code == FAILED and 0 < len(failed) <= AGAIN_MAX:
        print(f'run_tests: once more, alone: {", ".join(failed)}', flush=True)
        if pytest(failed) == PASSED:
            code, outcome = PASSED, 'unsteady'
            print(
                f'run_tests: unsteady, to be mended: {", ".join(failed)} failed among others and '
                'passed alone'
            )
    note(name, outcome, time.monotonic() - begin)
    return code


def pytest(arguments: list[str]) -> int:
    """Run pytest; return its exit code."""
    command = [sys.executable, '-m', 'pytest', '--timeout=600', *arguments]
    process = subprocess.Popen(command, cwd=ROOT)
    try:
        return process.wait()
    except KeyboardInterrupt:
        process.send_signal(signal.SIGINT)  # asked to end alone: the tests still clean up
        process.wait()
        raise


def main(arguments: list[str]) -> int:
    """Run a tier, or show the table of a whole run."""
    # A shell that starts this in the background has interrupts ignored.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    if arguments == ['table']:
        print(table(noted(), yardstick()))
        return 0
    if not arguments or arguments[0] not in TIERS:
        sys.exit(f'run_tests: expected table, {", ".join(TIERS)} but found {arguments[:1]}')
    tier, more = arguments[0], arguments[1:]
    marks = TIERS[tier]
    before = len(noted())
    parts = ((*ON_ALL_CORES, '-m', f'{marks} and not realtime'), ('-m', f'{marks} and realtime'))
    codes = {
        run(f'{tier}, {how}', [*more, *options])
        for how, options in zip(('on all cores', 'in real time'), parts, strict=True)
    }
    print(table(noted()[before:], yardstick()), flush=True)
    if codes == {NO_TESTS}:
        print(f'run_tests: expected tests of the tier {tier} but {" ".join(more)} leaves none')
    return 0 if PASSED in codes <= {PASSED, NO_TESTS} else 1


if __name__ == '__main__':
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
