# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Which nodes are alive on this computer: each holds a file lock while its process lives.

What the graph shows is late: a node is found after a while, and a killed one stays for 20 s.
The kernel knows at once, and releases the lock of a process whatever ended it.

Who starts a graph looks at it whole and holds the locks of its nodes.  So what it starts does not
look again: it is told so by the environment (`TAKEOVER`).
"""

import fcntl
import os
import tempfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from fuzzycnc_ros.ros.bring_up import TAKEOVER, GraphError, in_the_way, rivals
from fuzzycnc_ros.ros.parameters import ParameterError

Key = tuple[str, str]
"""Machine and node."""


class Presence:
    """Locks that this process holds for nodes, until it ends or leaves them."""

    def __init__(self) -> None:
        self._held: list[IO[bytes]] = []

    def __enter__(self) -> 'Presence':
        """Return the locks."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave them all."""
        self.leave()

    def leave(self) -> None:
        """Let go of all locks."""
        while self._held:
            self._held.pop().close()

    def hold(self, machine: str, node: str) -> None:
        """Say that a node lives here; where no lock can be had, the graph alone tells."""
        with suppress(OSError):
            file = _file(machine, node).open('ab')
            # Shared: with --takeover a second one of the same name lives too.
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            self._held.append(file)

    def claim(self, wanted: Collection[Key], in_the_way: Collection[Key]) -> set[Key]:
        """Hold the locks of nodes unless others live that are in their way.

        Of two commands that claim at once, one finds the other.

        Returns
        -------
        set of Key
            Those that live; empty if the locks are held now.
        """
        with _door():
            living = {key for key in in_the_way if lives(*key)}
            if not living:
                for key in wanted:
                    self.hold(*key)
        return living

    def claim_graph(self, nodes: Collection[Key]) -> None:
        """Hold the locks of the nodes of a graph before it is started.

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


def check_alone(machine: str, node: str) -> None:
    """Refuse to start what a machine has one of beside another that lives on this computer.

    Parameters
    ----------
    machine, node : str
        Namespace, and what the node is.

    Raises
    ------
    ParameterError
        If there is another; the text names it and the remedy.
    """
    if os.environ.get(TAKEOVER):
        return
    found = sorted(name for name in rivals(node) if lives(machine, name))
    if found:
        raise ParameterError(
            f'{node}: expected nobody who stands for {machine.strip("/")} or makes its time but '
            f'found {at_work((machine, name) for name in found)}: end it, choose another '
            f'namespace or ROS_DOMAIN_ID, or set {TAKEOVER}=1 to run beside it'
        )


def at_work(found: Iterable[Key]) -> str:
    """Return the nodes that are at work, for a refusal."""
    names = ', '.join(f'/{machine.strip("/")}/{node}' for machine, node in found)
    return f'{names} at work in ROS domain {os.environ.get("ROS_DOMAIN_ID", "").strip() or 0}'


def lives(machine: str, node: str) -> bool:
    """Whether a process of this computer holds the lock of a node."""
    try:
        file = _file(machine, node).open('rb')
    except OSError:
        return False  # nobody ever held it
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
    return False


def living(machine: str) -> set[str]:
    """Return the nodes of a machine whose locks processes of this computer hold."""
    prefix = _file(machine, '').name
    try:
        names = [file.name.removeprefix(prefix) for file in _folder().glob(f'{prefix}*')]
    except OSError:
        return set()
    # What has a dot left belongs to a machine whose name begins alike.
    return {name for name in names if '.' not in name and lives(machine, name)}


@contextmanager
def _door() -> Iterator[None]:
    """Let one process at a time look and claim."""
    try:
        file = (_folder() / 'door').open('ab')
    except OSError:
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _file(machine: str, node: str) -> Path:
    return _folder() / f'{machine.strip("/").replace("/", ".")}.{node}'


def _folder() -> Path:
    """Return the folder of the locks of this user and ROS domain, which nobody else can write."""
    runtime = os.environ.get('XDG_RUNTIME_DIR')
    private = Path(tempfile.gettempdir(), f'fuzzycnc_nodes_{os.getuid()}')
    top = Path(runtime) if runtime else private
    with suppress(FileExistsError):
        top.mkdir(mode=0o700)
    if top.stat().st_uid != os.getuid():
        raise PermissionError(f'{top}: expected a folder of this user')
    folder = top / f'fuzzycnc_domain_{os.environ.get("ROS_DOMAIN_ID", "").strip() or 0}'
    folder.mkdir(mode=0o700, exist_ok=True)
    return folder
