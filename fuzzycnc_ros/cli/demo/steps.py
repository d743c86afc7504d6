# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of the scenarios of `fuzzycnc demo`: folder, steps, live graphs, output."""

import fcntl
import json
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TimeElapsedColumn

from fuzzycnc_ros.cli.console import show
from fuzzycnc_ros.cli.live.free_domain import own_domain
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.cli.live.page_process import page_beside
from fuzzycnc_ros.cli.progress_lines import progress_lines
from fuzzycnc_ros.cli.terminal import Description
from fuzzycnc_ros.graph.bring_up import NodeSpec
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.studies.page.document import to_document

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.page.html import Page
    from fuzzycnc_ros.studies.page.table import Table

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
        if self._console.is_terminal:
            task = self._progress.add_task(text, total=None)
            yield Bar(lambda done, total: self._progress.update(task, completed=done, total=total))
            self._progress.remove_task(task)
        else:
            with progress_lines(text) as lines:
                yield Bar(lambda done, total: lines.tell(text, done, total))
        self._console.print(f'  {time.monotonic() - started:5.1f} s  {text}')


@dataclass
class Bar:
    """The bar of a step; it is told steps done and in all."""

    update: Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of a scenario.

    Attributes
    ----------
    result : dict
        Its figures, as they go to `summary.json`; gets the time of all as `wall_s`.
    page : callable
        Returns the page of its report.
    tables : tuple
        Tables to show.
    lines : tuple of str
        What else is to be said; the last one gets the time of all.
    problem : str
        Why the demo proves nothing; empty if it does.
    """

    result: dict[str, Any]
    page: 'Callable[[], Page]'
    tables: 'tuple[Table, ...]'
    lines: tuple[str, ...]
    problem: str = ''


Play = Callable[[Path, int, Steps], Outcome]
"""Runs into an empty folder with a seed of all measuring noise, and tells its steps."""


def play(scenario: Play, console: Console, out: Path, seed: int, page: int | None = None) -> Any:
    """Run a scenario on a ROS domain of its own, write down and show what came of it.

    Parameters
    ----------
    scenario : callable
        The scenario.
    console : Console
        Where to show it.
    out : Path
        The demo's folder, which is empty.
    seed : int
        Seed of all measuring noise.
    page : int, optional
        Port of the live page, which then stays until somebody wishes it to end.

    Returns
    -------
    dataclass
        The figures.

    Raises
    ------
    GraphError
        If a node fails, or the demo proves nothing.
    """
    own_domain()
    with page_beside(console, page, out / 'bag', out / 'log'):
        result = _played(scenario, console, out, seed)
        if page is not None:
            console.print('the live page stays until Ctrl-C')
            with suppress(KeyboardInterrupt):
                signal.pause()
    return result


def _played(scenario: Play, console: Console, out: Path, seed: int) -> Any:
    """Run a scenario, write down and show what came of it; return the figures."""
    from fuzzycnc_ros.studies.page.html import render_page

    started = time.monotonic()
    with progress_of(console) as progress:
        found = scenario(out, seed, progress)
        with progress.step('wrote the report'):
            (out / 'report.html').write_text(render_page(found.page()), encoding='utf-8')
    result = found.result
    result['wall_s'] = round(time.monotonic() - started, 2)
    text = json.dumps(to_document(result), indent=2) + '\n'
    (out / 'summary.json').write_text(text, encoding='utf-8')
    for table in found.tables:
        show(table)
    *before, last = found.lines
    for line in (*before, f'{last}; {result["wall_s"]:.0f} s in all'):
        console.print(line)
    for name, what in (
        ('report.html', 'the report; open it in a browser'),
        ('bag', 'everything that was on the topics'),
        ('summary.json', 'the figures'),
    ):
        console.print(f'{out / name}: {what}', soft_wrap=True)
    if found.problem:
        raise GraphError(found.problem)
    return result


@contextmanager
def lockstep_graph(
    machine: str, specs: Sequence[NodeSpec], bag: Path, log: Path
) -> Iterator[GraphProcesses]:
    """Start a graph of nodes in lock-step and a recorder.

    Parameters
    ----------
    machine : str
        Name of the machine.
    specs : sequence of NodeSpec
        Nodes in the order of their turns, the simulated machine last.
    bag : Path
        Where everything is recorded.
    log : Path
        Folder of what the nodes say.
    """
    *served, maker = specs
    recorder = NodeSpec('recorder', {'lockstep': True, 'output': str(bag)})
    parameters = {
        **maker.parameters,
        'lockstep': True,
        'lockstep_nodes': [spec.name for spec in served],
        'lockstep_recorder': True,
        'answer_timeout': ANSWER_TIMEOUT,
    }
    with GraphProcesses(machine, folder=log) as graph:
        for spec in (*served, recorder, NodeSpec(maker.name, parameters)):
            graph.start(spec)
        yield graph


def ended(graph: GraphProcesses, maker: str = 'simulated_machine') -> dict[str, Any]:
    """End a graph whose machine has ended; return what that says of the run."""
    outcome = graph.outcome(maker)
    graph.stop()
    graph.check()
    return outcome
