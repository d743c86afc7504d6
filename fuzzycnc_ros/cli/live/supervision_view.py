# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Output of `fuzzycnc up`: a live table on a terminal, lines elsewhere."""

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.table import Table

from fuzzycnc_ros.cli.background_output import BackgroundOutput
from fuzzycnc_ros.cli.live.graph_processes import node_title
from fuzzycnc_ros.cli.live.supervision import ProcessState, Supervised
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.runtime.component import Level

if TYPE_CHECKING:
    from fuzzycnc_ros.cli.live.supervision_monitor import Monitor, NodeView

REFRESH = 2.0
"""Pictures of the table per second."""
SILENCE = 'silent, though its process runs: it hangs, was stopped, or the computer is too busy'
_STYLES = {Level.OK: 'green', Level.WARN: 'yellow', Level.ERROR: 'red', Level.STALE: 'red'}
_STATES = {
    ProcessState.WAITING: 'starts again',
    ProcessState.GIVEN_UP: 'given up',
    ProcessState.ENDED: 'ended',
}


def row(process: Supervised, node: str, view: 'NodeView', now: float) -> tuple[str, ...]:
    """Return the cells of one node: name, state, restarts, rate, latency, limits and trouble."""
    state = _STATES.get(process.state, '')
    trouble = process.reason
    if not state:
        state = 'starting' if not view.heard_at else view.lifecycle or 'running'
        if view.silent(now):
            state = f'silent for {now - view.heard_at:.0f} s'
        trouble = '; '.join(view.trouble)
    running = process.state is ProcessState.RUNNING and not view.silent(now)
    activity = view.activity if running else {}
    cells = (
        node_title(process.graph.machine, node),
        state,
        str(process.restarts or ''),
        activity.get('rate [1/s]', ''),
        activity.get('latency [ms]', ''),
        trouble,
    )
    return tuple(visible(cell) for cell in cells)  # before the table measures them


def table(processes: Sequence[Supervised], monitor: 'Monitor', now: float) -> Table:
    """Return the table of all nodes."""
    shown = Table(box=None, pad_edge=False, expand=True)
    for title in ('node', 'state'):
        shown.add_column(title, no_wrap=True)
    for title in ('restarts', 'rate [1/s]', 'latency [ms]'):
        shown.add_column(title, justify='right', no_wrap=True)
    shown.add_column('limits and trouble', overflow='ellipsis', no_wrap=True, ratio=1)
    for process in processes:
        for spec in process.specs:
            view = monitor.view(process.graph.machine, spec.name)
            level = view.level
            if process.state in (ProcessState.WAITING, ProcessState.GIVEN_UP) or view.silent(now):
                level = Level.ERROR
            shown.add_row(*row(process, spec.name, view, now), style=_STYLES[level])
    return shown


class ProcessView:
    """Shows processes: redraws a table on a terminal, writes lines of what changes elsewhere.

    Parameters
    ----------
    console : Console
        Where to.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live: Live | None = None
        self._told: dict[str, str] = {}
        self._drawn_at = 0.0
        if console.is_terminal:
            self._live = Live(console=console, auto_refresh=False, transient=False)

    def __enter__(self) -> 'ProcessView':
        """Begin the table."""
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Leave the last table on the screen."""
        if self._live is not None:
            self._live.stop()

    def tell(self, text: str) -> None:
        """Write a line; above the table if there is one."""
        self._console.print(text, highlight=False, soft_wrap=True)

    @property
    def _behind(self) -> bool:
        """True if the reader has not taken the last table yet: it then waits for a newer one."""
        file = self._console.file
        return isinstance(file, BackgroundOutput) and file.behind

    def update(self, processes: Sequence[Supervised], monitor: 'Monitor') -> None:
        """Show how all is now."""
        now = time.monotonic()
        if self._live is None:
            self._tell_changes(processes, monitor, now)
        elif now - self._drawn_at > 1.0 / REFRESH and not self._behind:
            self._drawn_at = now
            self._live.update(table(processes, monitor, now), refresh=True)

    def _tell_changes(
        self, processes: Sequence[Supervised], monitor: 'Monitor', now: float
    ) -> None:
        """Write lifecycle states, silence and errors that come up and that are over."""
        for process in processes:
            if process.state is not ProcessState.RUNNING:
                continue  # how it ended has been told, and what is known of it is of before
            for spec in process.specs:
                name = node_title(process.graph.machine, spec.name)
                view = monitor.view(process.graph.machine, spec.name)
                error = view.trouble[0] if view.level is Level.ERROR else ''
                managed = 'autostart' in spec.parameters
                silence = SILENCE if view.silent(now) else ''
                heard = bool(view.heard_at)
                for key, text, gone in (
                    (f'{name} silence', silence, 'heard again' if heard else ''),
                    (f'{name} lifecycle', view.lifecycle if managed else '', ''),
                    (f'{name} error', error, 'recovered' if heard else ''),
                ):
                    before = self._told.get(key, '')
                    # The figures of an error change all the time; what it is about does not.
                    same = text.partition(':')[0] == before.partition(':')[0]
                    if same:
                        continue
                    self._told[key] = text
                    if text or gone:
                        self.tell(f'{name}: {text or gone}')
