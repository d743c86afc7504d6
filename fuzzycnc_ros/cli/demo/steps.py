# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the scenarios of `fuzzycnc demo` share: their folder, their steps, their closing lines."""

import fcntl
import json
import os
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TimeElapsedColumn

from fuzzycnc_ros.cli.console import show
from fuzzycnc_ros.cli.terminal import Description
from fuzzycnc_ros.ros.bring_up import GraphError

RUN_TIMEOUT = 300.0
"""Wall time [s] that a live run may take."""
ANSWER_TIMEOUT = 10.0
"""Wall time [s] after which a silent node of a live run is lost: a busy host is no fault."""


@contextmanager
def renewed(out: Path) -> Iterator[None]:
    """Empty a demo's folder, but nothing that is not a demo's, and hold it against other demos.

    Raises
    ------
    GraphError
        If something else lies there, or another demo writes there.
    """
    known = {
        'summary.json',
        'report.html',
        'model.json',
        'bag',
        'before',
        'quilt',
        'alone',
        'foam.json',
        'foam_trained.json',
        'trained',
        'calibration',
        'log',
        'latency',
    }
    out.mkdir(parents=True, exist_ok=True)
    # The lock is on the folder itself: nothing of it is left, however this process ends.
    folder = os.open(out, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise GraphError(
                f'--out {out}: another demo is writing there; wait for it or name another folder'
            ) from error
        found = sorted(out.iterdir())
        strange = [item.name for item in found if item.name not in known]
        if strange:
            raise GraphError(f'--out {out}: expected an empty folder but found {strange[0]}')
        for item in found:
            shutil.rmtree(item) if item.is_dir() and not item.is_symlink() else item.unlink()
        yield
    finally:
        os.close(folder)


@contextmanager
def progress_of(console: Console) -> Iterator['Steps']:
    """Show steps on a console."""
    columns = (SpinnerColumn(), Description(), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        yield Steps(console, progress)


class Steps:
    """One line for each step: a bar while it runs, its time when it is done."""

    def __init__(self, console: Console, progress: Progress) -> None:
        self._console, self._progress = console, progress

    @contextmanager
    def step(self, text: str) -> Iterator['Bar']:
        """Show a step as long as the block runs."""
        started = time.monotonic()
        task = self._progress.add_task(text, total=None)
        yield Bar(self._progress, task)
        self._progress.remove_task(task)
        self._console.print(f'  {time.monotonic() - started:5.1f} s  {text}')


@dataclass
class Bar:
    """The bar of a step."""

    progress: Progress
    task: Any

    def update(self, done: int, total: int) -> None:
        """Show how much is done."""
        self.progress.update(self.task, completed=done, total=total)


def finish(
    console: Console,
    out: Path,
    result: Any,
    tables: Sequence[Any],
    lines: Sequence[str],
    *,
    started: float,
    problem: str = '',
) -> None:
    """Write a demo's figures down and show what came of it.

    Parameters
    ----------
    console : Console
        Where to.
    out : Path
        The demo's folder.
    result : dataclass
        Its figures, as they go to `summary.json`; gets the time of all as `wall_s`.
    tables : sequence
        Tables to show.
    lines : sequence of str
        What else is to be said; the last one gets the time of all.
    started : float
        When it began, by the monotonic clock [s].
    problem : str
        Why the demo proves nothing; empty if it does.

    Raises
    ------
    GraphError
        If there is a problem.
    """
    result.wall_s = round(time.monotonic() - started, 2)
    (out / 'summary.json').write_text(json.dumps(vars(result), indent=2) + '\n', encoding='utf-8')
    for table in tables:
        show(table)
    *before, last = lines
    for line in (*before, f'{last}; {result.wall_s:.0f} s in all'):
        console.print(line)
    print_files(console, out)
    if problem:
        raise GraphError(problem)


def print_files(console: Console, out: Path) -> None:
    """Say what lies in the folder."""
    for name, what in (
        ('report.html', 'the report; open it in a browser'),
        ('bag', 'everything that was on the topics'),
        ('summary.json', 'the figures'),
    ):
        console.print(f'{out / name}: {what}', soft_wrap=True)
