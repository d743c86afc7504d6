# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Which nodes are alive on this computer: each holds a name in the kernel while its process lives.

What the graph shows is late: a node is found after a while, and a killed one stays for two
minutes.  And it shows nothing of another user, whose shared memory the middleware cannot write.
The kernel knows at once, whoever asks, and releases the names of a process whatever ended it.
The names are addresses of sockets that nobody sends to: abstract ones, which lie in no folder, so
that no permission, `TMPDIR` or `XDG_RUNTIME_DIR` hides them.  Like the middleware's ports they are
those of a network name space.

Who starts a graph looks at it whole and holds the names of its nodes.  So what it starts does not
look again: it is told so by the environment (`TAKEOVER`).
"""

import errno
import os
import socket
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import closing, contextmanager

from fuzzycnc_ros.core.names import text_hash

MACHINE = 'simulated_machine'
BODY = 'simulated_body'
"""Makes the time of a real controller without hardware; it starts last, too."""
TIME_SOURCES = (MACHINE, BODY, 'player')
"""Nodes that make machine time: a run is over when its one ends, and cannot be resumed."""
RIVALS = (
    frozenset(TIME_SOURCES),
    frozenset({MACHINE, 'linuxcnc_bridge', 'opcua_bridge'}),
)
"""Nodes of which a machine has one: what makes its time, and what stands for it."""
TAKEOVER = 'FUZZYCNC_TAKEOVER'
"""Environment variable: a node starts whoever else stands for its machine or makes its time."""

Key = tuple[str, str]
"""Machine and node."""

HOLDERS = 16
"""Processes that may say of a node that it lives: it, who started it, with --takeover more."""
DOOR_TIMEOUT = 5.0
"""Wall time [s] to wait for who looks and claims; that takes moments."""
_AJAR = 0.01  # s between two tries


class GraphError(RuntimeError):
    """The graph could not be brought up or broke down; the text says which node and why."""


class Presence:
    """Names that this process holds for nodes, until it ends or leaves them."""

    def __init__(self) -> None:
        self._held: list[socket.socket] = []

    def __enter__(self) -> 'Presence':
        """Return the names."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave them all."""
        self.leave()

    def leave(self) -> None:
        """Let go of all names."""
        while self._held:
            self._held.pop().close()

    def hold(self, machine: str, node: str) -> None:
        """Say that a node lives here; where no name can be had, the graph alone tells."""
        for number in range(HOLDERS):  # with --takeover a second one of the same name lives too
            try:
                held = _bound(_name(machine, node, number))
            except OSError as error:
                if error.errno == errno.EADDRINUSE:
                    continue
                return
            self._held.append(held)
            return

    def claim(self, wanted: Collection[Key], in_the_way: Collection[Key]) -> set[Key]:
        """Hold the names of nodes unless others live that are in their way.

        Of two commands that claim at once, one finds the other.

        Returns
        -------
        set of Key
            Those that live; empty if the names are held now.
        """
        with _door():
            living = {key for key in in_the_way if lives(*key)}
            if not living:
                for key in wanted:
                    self.hold(*key)
        return living

    def claim_graph(self, nodes: Collection[Key]) -> None:
        """Hold the names of the nodes of a graph before it is started.

        Raises
        ------
        GraphError
            If others live that are in their way; the text names them.
        """
        around = {(machine, name) for machine, node in nodes for name in in_the_way({node})}
        if living := self.claim(nodes, around):
            raise GraphError(
                f'expected nobody in the way of these nodes but found {at_work(sorted(living))}: '
                'end them, choose another machine or ROS_DOMAIN_ID, or add takeover:=true to run '
                'beside them'
            )


def rivals(name: str) -> frozenset[str]:
    """Return the nodes of which a machine has one, if this is among them; it is one of them."""
    return frozenset[str]().union(*(group for group in RIVALS if name in group))


def in_the_way(names: set[str]) -> set[str]:
    """Return the nodes that cannot run beside some others; recorders disturb nobody."""
    return names.union(*map(rivals, names)) - {'recorder'}


def check_alone(machine: str, node: str) -> None:
    """Refuse to start what a machine has one of beside another that lives on this computer.

    Parameters
    ----------
    machine, node : str
        Namespace, and what the node is.

    Raises
    ------
    GraphError
        If there is another; the text names it and the remedy.
    """
    if os.environ.get(TAKEOVER):
        return
    found = sorted(name for name in rivals(node) if lives(machine, name))
    if found:
        raise GraphError(
            f'{node}: expected nobody who stands for {machine.strip("/")} or makes its time but '
            f'found {at_work((machine, name) for name in found)}: end it, choose another '
            f'namespace or ROS_DOMAIN_ID, or set {TAKEOVER}=1 to run beside it'
        )


def at_work(found: Iterable[Key]) -> str:
    """Return the nodes that are at work, for a refusal."""
    names = ', '.join(f'/{machine.strip("/")}/{node}' for machine, node in found)
    return f'{names} at work in ROS domain {_domain()}'


def lives(machine: str, node: str) -> bool:
    """Return True if a process of this computer, of whatever user, says that a node lives."""
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as caller:
        for number in range(HOLDERS):
            try:
                caller.connect(_name(machine, node, number))
            except OSError:
                continue  # nobody holds it
            return True
    return False


@contextmanager
def _door() -> Iterator[None]:
    """Let one process at a time look and claim."""
    until = time.monotonic() + DOOR_TIMEOUT
    while True:
        try:
            held = _bound(_address('door'))
        except OSError as error:
            if error.errno != errno.EADDRINUSE or time.monotonic() > until:
                yield
                return
            time.sleep(_AJAR)
        else:
            break
    with closing(held):
        yield


def _bound(address: str) -> socket.socket:
    """Return a socket that holds an address.

    Raises
    ------
    OSError
        If another holds it, or this system has no such addresses.
    """
    held = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        held.bind(address)
    except OSError:
        held.close()
        raise
    return held


def _name(machine: str, node: str, number: int) -> str:
    # An address has 108 bytes at most, which is less than the names may have.
    digest = text_hash(f'{machine.strip("/")}/{node}')
    return _address(f'{digest}/{number}')


def _address(name: str) -> str:
    """Return the address of a name in this ROS domain, of the kind that lies in no folder."""
    return f'\0fuzzycnc/{_domain()}/{name}'


def _domain() -> str:
    return os.environ.get('ROS_DOMAIN_ID', '').strip() or '0'
