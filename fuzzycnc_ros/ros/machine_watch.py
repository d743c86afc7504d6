# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Watch the machines of a graph: find them by their nodes, and bring what these say to views.

Nobody waits for the watch: it reads what is offered without asking for it again, and looks into
a fast topic only from time to time.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from fuzzycnc_ros.components.dashboard.machine_view import SOURCES, MachineView
from fuzzycnc_ros.ros.presence import lives
from fuzzycnc_ros.ros.topics import create_subscription, durable, message_class
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.convert import decode
from fuzzycnc_ros.runtime.host import NodeConfiguration
from fuzzycnc_ros.runtime.records import Record

LATCHED = frozenset(
    {
        'sensor_selection',
        'thermal_reference',
        'predictor_state',
        'probe_status',
        'probe_cycle_state',
        'compensated_path',
    }
)
FAST = frozenset({'axis_state', 'servo_state'})
"""Topics of a servo loop: their newest message is fetched, and nobody woken for each."""
RARE = frozenset({'displacement'})
"""Topics of which every message counts."""
SPACING = 0.05
"""Wall time [s] between two messages of a topic that are looked into at once."""
DISCOVERY_PERIOD = 0.5
"""Wall time [s] between two looks at the graph."""
MACHINES_MAX = 64
CONFIGURATIONS = 'node_configuration'
_DEPTH = 100
_TOLD = {
    CONFIGURATIONS: NodeConfiguration.TYPE,
    **{name: record.TYPE for name, record in SOURCES.items()},
}
"""Types of the topics by which a machine is known."""
_LEVELS = {level.value: level for level in Level}


class _Topic:
    """One topic of a machine.

    Parameters
    ----------
    view : MachineView
        Who gets its records.
    name : str
        Its name within the machine.
    record : type
        Its record.
    changed : callable
        Called when something was given to the view.
    """

    def __init__(
        self, view: MachineView, name: str, record: type[Record], changed: Callable[[], None]
    ) -> None:
        self._view, self._name, self._record = view, name, record
        self._changed = changed
        self._class = message_class(record.TYPE)
        self._spacing = 0.0 if name in RARE else SPACING
        self._pending: tuple[bytes, float] | None = None
        self._read_at = -SPACING
        self.fetched: Any = None
        """Subscription that is asked from time to time; None where messages call."""

    def hear(self, payload: bytes) -> None:
        """Take a message, or keep it until there is time."""
        now = time.monotonic()
        self._pending = payload, now
        if now - self._read_at >= self._spacing:
            self.read()

    def read(self) -> None:
        """Look into the newest message, if there is one that was not looked into."""
        if self.fetched is not None:
            with self.fetched.handle:
                taken = self.fetched.handle.take_message(self.fetched.msg_type, True)
            if taken is not None:
                self._pending = taken[0], time.monotonic()
        if self._pending is None:
            return
        payload, at = self._pending
        self._pending, self._read_at = None, at
        message = deserialize_message(payload, self._class)
        self._view.take(self._name, decode(self._record, message), at)
        self._changed()


class WatchedMachine:
    """A machine that is watched: its view, and what it is fed from."""

    def __init__(self, node: Node, machine: str, changed: Callable[[str], None]) -> None:
        self.view = MachineView(machine)
        self._node = node
        self._lived: set[str] = set()
        self._topics: list[_Topic] = []
        self._subscriptions = []
        self._fetched = []
        told = partial(changed, machine)
        for name, record in SOURCES.items():
            topic = _Topic(self.view, name, record, told)
            path = f'/{machine}/{name}'
            made = create_subscription(
                node, record.TYPE, path, topic.hear, _profile(name), raw=True
            )
            if name in FAST:
                # The executor, which would wake for every message, does not know of it.
                node._subscriptions.remove(made)
                topic.fetched = made
                self._fetched.append(made)
            else:
                self._subscriptions.append(made)
            self._topics.append(topic)
        self._subscriptions.append(
            create_subscription(
                node,
                NodeConfiguration.TYPE,
                f'/{machine}/{CONFIGURATIONS}',
                self._on_configuration,
                durable(_DEPTH),
            )
        )
        self._told = told

    def read(self) -> None:
        """Look into what has come since the last time."""
        for topic in self._topics:
            topic.read()

    def look(self, present: set[str]) -> None:
        """Take which nodes are in the graph, and which have ended.

        The graph shows a node that was killed for two minutes; where its process lived on this
        computer, the name that it holds tells at once.
        """
        machine, view = self.view.machine, self.view
        known = {*present, *view.nodes}
        living = {name for name in known if lives(f'/{machine}', name)}
        gone = {name for name in known - present - living}
        ended = gone | ((self._lived & known) - living)
        self._lived |= living
        view.set_nodes(present, ended)

    def close(self) -> None:
        """Read no more."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for subscription in self._fetched:
            subscription.destroy()

    def _on_configuration(self, message: Any) -> None:
        self.view.take_configuration(decode(NodeConfiguration, message))
        self._told()


class MachineWatch:
    """The machines of a graph.

    Parameters
    ----------
    node : Node
        The node that listens.
    only : str
        Name of the one machine that is of interest; empty for all.
    changed : callable
        Called with the name of a machine of which something new is known.
    """

    def __init__(
        self, node: Node, only: str = '', changed: Callable[[str], None] = lambda machine: None
    ) -> None:
        self._node, self._only, self._changed = node, only, changed
        self.machines: dict[str, WatchedMachine] = {}
        self._diagnostics = node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, _stream(_DEPTH)
        )
        if only:
            self._add(only)
        self.look()

    def look(self) -> None:
        """Look which machines and nodes there are, from time to time."""
        nodes: dict[str, set[str]] = {}
        for name, space in self._node.get_node_names_and_namespaces():
            nodes.setdefault(space.strip('/'), set()).add(name)
        strange = {space for space in nodes if space and space not in self.machines}
        if strange and not self._only:
            for topic, types in self._node.get_topic_names_and_types():
                machine, _, name = topic.strip('/').rpartition('/')
                # A player says nothing of itself, but plays what machines say.
                if types == [_TOLD.get(name)] and machine in strange:
                    strange.discard(machine)
                    self._add(machine)
        for machine, watched in self.machines.items():
            watched.look(nodes.get(machine, set()))

    def read(self) -> None:
        """Look into what has come on fast topics since the last time."""
        for watched in self.machines.values():
            watched.read()

    def forget(self, machine: str) -> None:
        """Watch a machine no more."""
        self.machines.pop(machine).close()

    def close(self) -> None:
        """Watch nothing any more."""
        for machine in list(self.machines):
            self.forget(machine)
        self._node.destroy_subscription(self._diagnostics)

    def _add(self, machine: str) -> None:
        if len(self.machines) >= MACHINES_MAX:
            return
        self.machines[machine] = WatchedMachine(self._node, machine, self._changed)
        self._changed(machine)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        if not array.status:
            return
        owner = array.status[0].name.partition(': ')[0]
        machine, _, node = owner.strip('/').rpartition('/')
        watched = self.machines.get(machine)
        if watched is None:
            return
        items = [
            Health(
                status.name.partition(': ')[2],
                _LEVELS.get(status.level[0], Level.STALE),
                status.message,
                {item.key: item.value for item in status.values},
            )
            for status in array.status
        ]
        watched.view.take_health(node, items, time.monotonic())
        self._changed(machine)


def _profile(name: str) -> QoSProfile:
    """Return how a topic is read: nobody shall wait for this reader, or repeat anything."""
    if name in LATCHED:
        return durable(1)
    if name in RARE:
        profile = _stream(_DEPTH)
        profile.reliability = ReliabilityPolicy.RELIABLE
        return profile
    return _stream(1 if name in FAST else _DEPTH)


def _stream(depth: int) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.VOLATILE,
    )
