# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reports of nodes: health on `/diagnostics`, lifecycle on `node_configuration`."""

import pkgutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from fuzzycnc_ros import nodes
from fuzzycnc_ros.cli.live.operator_client import OperatorClient
from fuzzycnc_ros.cli.live.supervision import SILENT
from fuzzycnc_ros.ros.presence import lives
from fuzzycnc_ros.ros.topics import create_subscription, message_class, subscription_qos
from fuzzycnc_ros.runtime.component import Durability, Level
from fuzzycnc_ros.runtime.host import NodeConfiguration
from fuzzycnc_ros.runtime.records import Record

FIRST_HEARD = 8.0
"""Wall time [s] after which a machine of which nothing was heard has no nodes."""
DISCOVERED = 0.5
"""Wall time [s] after which the nodes of a running machine have been found."""
LEARNING = ('learning', 'probe due', 'band', 'first activation')
"""Items that say how well the error is known, and what is followed of it."""
NODE_CONFIGURATION = 'node_configuration'
_SPIN = 0.1


@dataclass
class NodeView:
    """Report of one node.

    Attributes
    ----------
    heard_at : float
        Wall time of its newest report [s]; 0 before the first of its present life.
    lifecycle : str
        State that it has told; empty before.
    was_active : bool
        Whether it was active in its present life.
    level : Level
        The worst of its items.
    trouble : tuple of str
        What its items above OK say, the worst first.
    learning : tuple of str
        What its items on learning from probes say.
    activity : dict
        Rate and latency.
    """

    heard_at: float = 0.0
    lifecycle: str = ''
    was_active: bool = False
    level: Level = Level.OK
    trouble: tuple[str, ...] = ()
    learning: tuple[str, ...] = ()
    activity: dict[str, str] = field(default_factory=dict)

    @property
    def told(self) -> bool:
        """True if the node has reported anything."""
        return self.heard_at > 0.0 or bool(self.lifecycle)

    def silent(self, now: float) -> bool:
        """Return True if nothing has been received for long."""
        return self.heard_at > 0.0 and now - self.heard_at > SILENT


class Monitor:
    """Listen to the nodes of some machines."""

    def __init__(self, machines: Sequence[str]) -> None:
        self.views: dict[tuple[str, str], NodeView] = {}
        self._began = time.monotonic()
        self._configurations = 0  # that have arrived
        self.operator = OperatorClient('')
        node = self.operator.node
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 1000)
        # Latched by every node of a machine: of each the newest is wanted.
        kept = QoSProfile(
            depth=100,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
        for machine in machines:
            node.create_subscription(
                message_class(NodeConfiguration.TYPE),
                f'/{machine}/{NODE_CONFIGURATION}',
                self._configuration_handler(machine),
                kept,
            )

    def listen(self, machine: str, record: type[Record], topic: str) -> list[Any]:
        """Return the messages of a topic of a machine, a list that grows while it listens."""
        heard: list[Any] = []
        place, qos = f'/{machine}/{topic}', subscription_qos(Durability.STREAM)
        create_subscription(self.operator.node, record.TYPE, place, heard.append, qos)
        return heard

    def settle(self, machine: str, patience: float) -> None:
        """Listen until each node of a machine has reported, for no longer than a time [s].

        On a busy computer nodes are found late: the first of them is waited for longer.  Among
        many processes they are found one after the other: those that live on this computer are
        waited for.  So is the configuration of a node that reports, which tells its state; of
        several that are latched the newest comes last.
        """
        own, heard, untold = _living(machine), False, False
        topic = f'/{machine}/{NODE_CONFIGURATION}'
        self.spin_until(DISCOVERED)
        while self.age < (patience if heard and not untold else FIRST_HEARD):
            known = own | {name for where, name in self.present() if where == machine}
            reported = {name for name in known if self.view(machine, name).heard_at > 0.0}
            told = {info.node_name for info in self.operator.publishers(topic)}
            untold = any(not self.view(machine, name).lifecycle for name in reported & told)
            if known and reported == known and not untold:
                break
            heard = heard or bool(reported)
            self.spin()
        before = -1
        while self._configurations > before and self.age < 2.0 * FIRST_HEARD:
            before = self._configurations
            self.spin()

    def close(self) -> None:
        """Leave the graph."""
        self.operator.__exit__(None, None, None)

    def spin(self, duration: float = _SPIN) -> None:
        """Listen for some wall time [s]."""
        self.operator.pause(duration)

    @property
    def age(self) -> float:
        """Wall time [s] since it began to listen."""
        return time.monotonic() - self._began

    def spin_until(self, age: float) -> None:
        """Listen until it is so old [s]."""
        self.spin(age - self.age)

    def present(self) -> set[tuple[str, str]]:
        """Return machines and nodes that are in the graph, or died in it a while ago."""
        found = self.operator.node.get_node_names_and_namespaces()
        return {(where.strip('/'), name) for name, where in found}

    def view(self, machine: str, node: str) -> NodeView:
        """Return what a node says of itself."""
        return self.views.setdefault((machine, node), NodeView())

    def begin(self, machine: str, node: str) -> None:
        """Forget what an earlier life of a node has said."""
        self.views[machine, node] = NodeView()

    def heard_at(self, machine: str, node: str) -> float:
        """Return the wall time of a node's newest report [s]; 0 before the first of its life."""
        return self.view(machine, node).heard_at

    def lifecycle(self, machine: str, node: str) -> str:
        """Return the lifecycle state that a node has told last; empty if none."""
        return self.view(machine, node).lifecycle

    def was_active(self, machine: str, node: str) -> bool:
        """Return True if a node has been active in its present life."""
        return self.view(machine, node).was_active

    def _configuration_handler(self, machine: str) -> Callable[[Any], None]:
        def on_configuration(message: Any) -> None:
            self._configurations += 1
            view = self.view(machine, message.node)
            view.lifecycle = message.lifecycle_state
            view.was_active |= view.lifecycle == 'active'

        return on_configuration

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        if not array.status:
            return
        machine, _, node = array.status[0].name.partition(': ')[0].rpartition('/')
        view = self.view(machine, node)
        view.heard_at = time.monotonic()
        found, learning = [], []
        for status in array.status:
            item = status.name.partition(': ')[2]
            if item == 'activity':
                view.activity = {value.key: value.value for value in status.values}
            elif status.level[0]:
                found.append((status.level[0], f'{item}: {status.message}'))
            elif item in LEARNING:
                learning.append(f'{item}: {status.message}')
        found.sort(key=lambda entry: -entry[0])
        view.level = Level(found[0][0]) if found else Level.OK
        view.trouble = tuple(text for _, text in found)
        view.learning = tuple(learning)


def _living(machine: str) -> set[str]:
    """Return the nodes of a machine that live on this computer, under the names of their kinds."""
    kinds = (item.name for item in pkgutil.iter_modules(nodes.__path__))
    return {name for name in kinds if lives(machine, name)}
