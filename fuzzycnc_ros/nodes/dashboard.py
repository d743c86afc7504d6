# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `dashboard`: the live page of all machines of its graph.

The page is served by a thread of its own: a browser never holds the graph up, nor the graph a
browser.  It reads what nodes publish and asks nothing of them; what a person does on the page goes
through the services that nodes offer anyway.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, nextafter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from fuzzycnc_ros import __version__
from fuzzycnc_ros.components.dashboard.history import Rows, history_document, joined
from fuzzycnc_ros.components.dashboard.machine_view import MachineView
from fuzzycnc_ros.graph.page_actions import Actions, NeedsForceError
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.health import diagnostic_array
from fuzzycnc_ros.ros.machine_watch import DISCOVERY_PERIOD, MachineWatch
from fuzzycnc_ros.ros.node_config import OWN_FOLDER, DashboardConfig
from fuzzycnc_ros.ros.parameters import ParameterError, declare
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.run import tell_error
from fuzzycnc_ros.runtime.addresses import is_loopback
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.records import nanoseconds

if TYPE_CHECKING:
    from fuzzycnc_ros.web.recordings import BagFolder
    from fuzzycnc_ros.web.server import PageServer

TICK = 0.1
"""Wall time [s] between two looks whether there is something to show."""
ALONE = 1.0
"""The same while no page is open [s]: a new one gets its first view within that time."""
SOONEST = 0.3
"""Part of the interval after which new data are shown, though a view was shown before them."""
ANSWERED = 10.0
"""Wall time [s] that a page waits for a stretch of history."""


@dataclass(frozen=True)
class _Shown:
    """State of a machine as last shown.

    Attributes
    ----------
    at : float
        When [s].
    key : object
        What is shown at once when it changes.
    news : int
        Records of data that had come.
    """

    at: float = -inf
    key: object = None
    news: int = 0


class DashboardNode:
    """Show the machines of the graph, and let people act at them."""

    exit_code = 0
    done = False

    def __init__(self, node: Node) -> None:
        self.node = node
        (config,) = declare(node, DashboardConfig)
        self._config = config
        self.executor = config.executor
        self._bags: BagFolder
        self._dirty: set[str] = set()
        self._shown: dict[str, _Shown] = {}
        self._known: set[str] = set()
        bags = Path(config.bags).expanduser() if config.bags else None
        self._actions = Actions(node, bags)
        self._server = self._make_server(bags)
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # Beside the machines it shows all of them, within the namespace of one that one alone.
        self._watch = MachineWatch(node, node.get_namespace().strip('/'), self._on_changed)
        self._ticks = wall_timer(node, TICK, self._show)
        wall_timer(node, DISCOVERY_PERIOD, self._look)
        wall_timer(node, 1.0, self._report)

    def _make_server(self, bags: Path | None) -> 'PageServer':
        """Return the server of the page.

        Raises
        ------
        ParameterError
            If something is not installed, or cannot be used.
        """
        try:
            from fuzzycnc_ros.web.guard import Token
            from fuzzycnc_ros.web.keys import (
                check_pair,
                fingerprint,
                own_certificate,
                own_token,
                read_token,
            )
            from fuzzycnc_ros.web.recordings import BagFolder
            from fuzzycnc_ros.web.server import PageServer
        except ModuleNotFoundError as error:
            raise _missing(error) from error
        config, say = self._config, self.node.get_logger().info
        open_to_others = not is_loopback(config.listen)
        folder = Path(config.state_directory or OWN_FOLDER).expanduser()
        secret, certificate = '', None
        try:
            if config.token_file:
                secret = read_token(Path(config.token_file).expanduser())
            elif open_to_others:
                secret, fresh = own_token(folder / 'token')
                if fresh:
                    print(
                        f'token, shown this once; it is in {folder / "token"}: {secret}',
                        flush=True,
                    )
            if config.certificate:
                certificate = (
                    Path(config.certificate).expanduser(),
                    Path(config.private_key).expanduser(),
                )
            elif open_to_others:
                certificate = own_certificate(folder, config.listen)
            if certificate is not None:
                check_pair(*certificate)
                say(f'certificate SHA-256 {fingerprint(certificate[0])}')
            self._bags = BagFolder(bags)
            self._token = bool(secret)
            return PageServer(
                self,
                self._bags,
                address=config.listen,
                port=config.port,
                token=Token(secret),
                hosts=config.hosts,
                certificate=certificate,
            )
        except ModuleNotFoundError as error:
            raise _missing(error) from error
        except OSError as error:
            raise ParameterError(
                f'parameter port: expected one that is free at {config.listen} but found '
                f'{config.port}, {error.strerror}; choose another, or 0'
            ) from error
        except ValueError as error:
            raise ParameterError(str(error)) from error

    def start(self) -> None:
        """Begin to serve, and say where."""
        self._server.start()
        self._greet()
        print(f'live page: {self._server.url}', flush=True)

    def stop(self) -> None:
        """Serve no more; recordings that were started here end whole."""
        self._server.stop()
        for text in self._actions.close():
            tell_error(text)  # the node's log may have ended already
            self.exit_code = 1

    # What the server asks, from its own thread.

    @property
    def machines(self) -> tuple[str, ...]:
        """Names of all machines."""
        return tuple(self._watch.machines)

    def history(
        self, machine: str, series: str, begin: float, end: float, points: int
    ) -> dict[str, Any]:
        """Return a stretch of a series; the thread of the node gives the rows.

        What was before the memory of this process comes from bags.
        """

        def rows() -> tuple[float, tuple[str, ...], Rows]:
            kept = self._watch.machines[machine].view.history[series]
            return kept.begin, kept.names, kept.rows(begin, end, points)

        oldest, names, found = self._actions.thread.ask(rows).result(ANSWERED)
        if begin < oldest:
            until = min(end, nextafter(oldest, -inf))
            recorded = self._bags.history(machine, series, begin, until)
            if recorded is not None:
                names, found = joined(recorded, (names, found), points)
        return history_document(machine, series, names, found)

    async def act(self, machine: str, action: str, body: Mapping[str, Any]) -> str:
        """Carry an action out.

        Raises
        ------
        ActionRefusedError
            If it is not.
        """
        from fuzzycnc_ros.web.app import ActionRefusedError

        try:
            return await self._actions.act(self._view(machine), action, body)
        except NeedsForceError as error:
            raise ActionRefusedError(str(error), needs='force') from error
        except GraphError as error:
            raise ActionRefusedError(str(error)) from error

    # What is done in the thread of the node.

    def _view(self, machine: str) -> MachineView:
        return self._watch.machines[machine].view

    def _on_changed(self, machine: str) -> None:
        self._dirty.add(machine)

    def _look(self) -> None:
        """Follow machines that come and go."""
        before = set(self._watch.machines)
        self._watch.look()
        now = time.monotonic()
        for machine, watched in list(self._watch.machines.items()):
            if watched.view.quiet_for(now) > self._config.forget_after:
                self._watch.forget(machine)
        present = set(self._watch.machines)
        for machine in before - present:
            self._actions.leave(machine)
            self._shown.pop(machine, None)
        for machine in present - self._known:
            self._actions.join(machine)
        if present != self._known:
            self._known = present
            self._greet()

    def _greet(self) -> None:
        self._server.greet(
            {
                'type': 'hello',
                'version': __version__,
                'machines': sorted(self._watch.machines),
                'writable': True,
                'needs_token': self._token,
                'recordable': bool(self._config.bags),
                'interval': self._config.interval,
            }
        )

    def _show(self) -> None:
        """Give pages the views that are due: after new data, a change, or the interval."""
        now, interval, clients = time.monotonic(), self._config.interval, self._server.clients
        pace = nanoseconds(TICK if clients else min(interval, ALONE))
        if self._ticks.timer_period_ns != pace:
            self._ticks.timer_period_ns = pace
        for machine, watched in self._watch.machines.items():
            view, shown = watched.view, self._shown.get(machine, _Shown())
            elapsed = now - shown.at
            due = elapsed >= interval - TICK / 2.0
            if not (due or clients):
                continue
            if due:
                watched.read()
            key = view.key(now) if due or machine in self._dirty else shown.key
            self._dirty.discard(machine)
            fresh = view.news != shown.news and elapsed >= SOONEST * interval
            if due or fresh or key != shown.key:
                self._shown[machine] = _Shown(now, key, view.news)
                view.set_recording(self._actions.recording(machine))
                document = view.document(now)
                if clients:
                    self._server.show(machine, document)

    def _report(self) -> None:
        """Publish on /diagnostics how the page is."""
        text = f'{self._server.url}, {self._server.clients} pages open'
        values = {
            'pages': str(self._server.clients),
            'machines': str(len(self._watch.machines)),
            'memory of histories [MiB]': f'{self._nbytes / 2**20:.1f}',
        }
        now = self.node.get_clock().now().to_msg()
        name = self.node.get_fully_qualified_name()
        health = [Health('page', Level.OK, text, values)]
        self._diagnostics.publish(diagnostic_array(name, '', health, {}, now))

    @property
    def _nbytes(self) -> int:
        return sum(w.view.history.nbytes for w in self._watch.machines.values())


def _missing(error: ModuleNotFoundError) -> ParameterError:
    return ParameterError(
        f'the live page needs {error.name}, which is not installed; '
        "install it with pip install 'fuzzycnc_ros[page]'"
    )


def make() -> DashboardNode:
    """Create the node."""
    return DashboardNode(Node('dashboard'))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
