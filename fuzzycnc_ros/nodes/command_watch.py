# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Who publishes a topic that commands a machine, as the graph shows it.

A node that was killed stays in the graph until its lease runs out, so that after a restart two
publishers of one name are seen of which one is dead; and for seconds the name of the new one is
not known yet.  Two of one name are therefore two sources only if both speak, which their sequence
numbers show, or if they outlast the lease.  Publishers of different names are two sources at once.
"""

import time
from collections.abc import Callable, Sequence

from rclpy.node import Node

from fuzzycnc_ros.nodes.timers import wall_timer

PERIOD = 0.2
"""Wall time [s] between two looks at the graph."""
SETTLED = 3
"""Looks at which the same publishers must have been seen."""
LEASE = 25.0
"""Wall time [s] after which a killed node is gone from the graph, with room to spare; the shipped
discovery profile says 20 s, as Fast DDS does by itself."""
_UNKNOWN = 'UNKNOWN_'


class TopicSources:
    """Tell live sources of one topic from what is left of dead ones."""

    def __init__(self) -> None:
        self._seen: tuple[str, ...] = ()
        self._looks = 0
        self._since = 0.0
        self._newest = 0
        self._returns = 0

    def heard(self, sequence_number: int) -> None:
        """Note a message: the numbers of one source rise."""
        self._returns += sequence_number <= self._newest
        self._newest = sequence_number

    def look(self, publishers: Sequence[str], now: float) -> tuple[str, ...] | None:
        """Return the nodes that publish at once; empty if one at most, None if it is not clear.

        Parameters
        ----------
        publishers : sequence of str
            Node of each publisher in the graph, fully qualified.
        now : float
            Wall time [s].
        """
        names = tuple(sorted(publishers))
        if names != self._seen:
            self._seen, self._looks, self._since = names, 0, now
        self._looks += 1
        if len(names) < 2:
            self._returns = 0
            return ()
        # All but one may be dead: then the numbers begin anew once for each.
        speaking = self._returns >= len(names)
        different = len({name for name in names if _UNKNOWN not in name}) > 1
        lasting = now - self._since > LEASE
        sure = speaking or lasting or (different and self._looks >= SETTLED)
        return names if sure else None


class CommandWatch:
    """Watch the topics that only one node may publish.

    Parameters
    ----------
    node : Node
        The node that reads them.
    topics : mapping of str to str
        Names of inputs by topic, fully qualified.
    tell : callable
        Told an input and the nodes that publish it at once, none if it is one again; on change.
    """

    def __init__(
        self, node: Node, topics: dict[str, str], tell: Callable[[str, tuple[str, ...]], None]
    ) -> None:
        self._node, self._tell = node, tell
        self._inputs = dict(topics)
        self._sources = {topic: TopicSources() for topic in topics}
        self._told: dict[str, tuple[str, ...]] = {}
        if topics:
            wall_timer(node, PERIOD, self._look)

    def heard(self, topic: str, sequence_number: int) -> None:
        """Note a message on a topic; others than those watched do not matter."""
        if topic in self._sources:
            self._sources[topic].heard(sequence_number)

    def _look(self) -> None:
        now = time.monotonic()
        for topic, sources in self._sources.items():
            found = self._node.get_publishers_info_by_topic(topic)
            names = [f'{item.node_namespace.rstrip("/")}/{item.node_name}' for item in found]
            nodes = sources.look(names, now)
            if nodes is not None and nodes != self._told.get(topic, ()):
                self._told[topic] = nodes
                self._tell(self._inputs[topic], nodes)
