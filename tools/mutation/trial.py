# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Mutants on trial: the tests that reach one, cheapest first, up to the one that catches it."""

import contextlib
import queue
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mutation.draw import Mutant, applied
from mutation.reach import copied, pytest

WAVES = (20, 200, sys.maxsize)
"""Tests that are started together: few at first, since most mutants fall at once."""
PATIENCE = 5.0
"""How many times its time in the map a test may take before it counts as hanging."""
GRACE = 60.0
"""Time [s] on top, for what starts slowly."""


@dataclass(frozen=True)
class Outcome:
    """How a run of pytest ended: its exit code, and the test that failed first, if any."""

    code: int
    test: str = ''
    hung: bool = False


class Judge:
    """Tries mutants on one copy of the tree."""

    def __init__(self, tree: Path, copy: Path, suite: dict[str, Any]) -> None:
        self._tree, self._copy, self._suite = tree, copy, suite
        self._sound: dict[str, bool] = {}

    def judge(self, mutant: Mutant, budget: float) -> dict[str, Any]:
        """Run a mutant's tests up to the first that catches it; return what came of it.

        Tests beyond the budget [s], by their times in the map, are not run but counted.  Those
        that fail at times, or without the mutant too, are told as doubted.
        """
        durations = self._suite['durations']
        tests, left = [], 0
        for test in self._suite['tests'][mutant.id]:
            budget -= durations[test]
            if budget >= 0.0:
                tests.append(test)
            else:
                left += 1
        begin, ran = 0, 0
        doubted: list[str] = []
        for size in WAVES:
            wave = tests[begin : begin + size]
            begin += size
            while wave:
                with applied(self._copy, mutant):
                    outcome = self._run(wave)
                if outcome.code == 0:
                    break
                suspects = [outcome.test] if outcome.test in wave else wave
                if self._pass_without(suspects):
                    with applied(self._copy, mutant):
                        again = outcome if outcome.hung else self._run(suspects)
                    if again.code != 0:
                        by = outcome.test or ('time limit' if outcome.hung else 'collection')
                        found = {'by': by, 'hung': outcome.hung, 'reached': len(tests) + left}
                        return {'caught': True, **found}
                doubted += suspects
                wave = [test for test in wave if test not in suspects]
            ran += len(wave)
        found = {'caught': False, 'ran': ran, 'left': left, 'reached': len(tests) + left}
        return {**found, 'doubted': doubted}

    def _pass_without(self, tests: list[str]) -> bool:
        key = '\n'.join(tests)
        if key not in self._sound:
            self._sound[key] = self._run(tests).code == 0
        return self._sound[key]

    def _run(self, tests: list[str]) -> Outcome:
        durations = self._suite['durations']
        limit = PATIENCE * max(durations[test] for test in tests) + GRACE
        total = PATIENCE * sum(durations[test] for test in tests) + 2 * GRACE
        options = [*self._suite['arguments'], '-n', '0', '-x', f'--timeout={limit:.0f}']
        names = self._copy.parent / 'tests.txt'
        wanted = tests
        while True:
            names.write_text('\n'.join(wanted))
            more = {'FUZZYCNC_MUTANTS_TESTS': str(names)}
            code, report = pytest(self._tree, self._copy, options, total, more)
            failed = [row['test'] for row in report if row.get('outcome') == 'failed']
            if code == 2 and not failed:
                raise KeyboardInterrupt
            files = sorted({test.split('::')[0] for test in tests})
            # A mutant may rename the cases of a test, which is no failure: take its whole file.
            if code == 4 and not failed and wanted != files:
                wanted = files
                continue
            return Outcome(code, failed[0] if failed else '', code == -1)


def run(
    tree: Path,
    mutants: Sequence[Mutant],
    suite: dict[str, Any],
    results: dict[str, Any],
    jobs: int,
    budget: float,
) -> Iterator[Mutant]:
    """Try the mutants that have no result yet, several at once; yield each that is done."""
    with contextlib.ExitStack() as stack:
        judges: queue.Queue[Judge] = queue.Queue()
        for _ in range(jobs):
            judges.put(Judge(tree, stack.enter_context(copied(tree)), suite))

        def judged(mutant: Mutant) -> dict[str, Any]:
            judge = judges.get()
            try:
                return judge.judge(mutant, budget)
            finally:
                judges.put(judge)

        pool = stack.enter_context(ThreadPoolExecutor(jobs))
        stack.callback(pool.shutdown, cancel_futures=True)
        waiting = {pool.submit(judged, m): m for m in mutants if m.id not in results}
        for done in as_completed(waiting):
            results[waiting[done].id] = done.result()
            yield waiting[done]
