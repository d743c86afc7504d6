# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Publishers of a topic that a machine depends on, as the graph and its messages show.

A node that was killed stays in the graph until its lease runs out, so that after a restart two
publishers of one name are seen of which one is dead; and for seconds the name of the new one is
not known yet.  Two of one name are therefore two sources only if both speak, which their sequence
numbers show, or if they outlast the lease.  Publishers of different names are two sources at once.

One that lives shorter than the time between two looks is known by its messages: their numbers do
not go on from those of the source, which is still there when somebody else has spoken.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rclpy.node import Node

from fuzzycnc_ros.ros.clocks import wall_timer

PERIOD = 0.2
"""Wall time [s] between two looks at the graph."""
SETTLED = 3
"""Looks at which the same publishers must have been seen."""
GONE = 125.0
"""Wall time [s] after which a killed node is gone from the graph, with room to spare; the lease of
the shipped discovery profile is 120 s."""
_UNKNOWN = 'UNKNOWN_'
_NONE = -1
"""Stands for the number of a message that was not believed, where there is none."""


@dataclass(frozen=True)
class Publisher:
    """A publisher in the graph: its node, fully qualified, and its own identity."""

    node: str
    gid: bytes = b''

    @property
    def known(self) -> bool:
        """True if the name of its node has arrived."""
        return _UNKNOWN not in self.node


class TopicSources:
    """Tell live sources of one topic from what is left of dead ones.

    Parameters
    ----------
    lockstep : bool
        Whether messages are awaited: then one whose sender has no name yet cannot wait for it.
    """

    def __init__(self, *, lockstep: bool = False) -> None:
        self._lockstep = lockstep
        self._seen: tuple[str, ...] = ()
        self._looks = 0
        self._since = 0.0
        self._newest = 0
        self._returns = 0
        self._source = b''
        self._followed = 0
        self._odd = _NONE

    def heard(self, sequence_number: int, publishers: Callable[[], Sequence[Publisher]]) -> str:
        """Note a message; say why it must not be believed, empty if it may.

        Parameters
        ----------
        sequence_number : int
            Number of the message at its publisher.
        publishers : callable
            Looks who is in the graph; asked only where the numbers do not go on.
        """
        self._returns += sequence_number <= self._newest
        self._newest = sequence_number
        # What also goes on from a message that was not believed may be of either sender.
        clear = self._odd != self._followed
        if self._source and sequence_number == self._followed + 1 and clear:
            self._followed = sequence_number
            return ''
        found = publishers()
        odd, self._odd = self._odd, sequence_number
        nodes = sorted({item.node for item in found if item.known})
        if len(nodes) > 1:
            return f'comes from several nodes at once: {", ".join(nodes)}'
        if len(found) > 1 and not (self._lockstep or all(item.known for item in found)):
            return 'comes from a node whose name is not known yet'
        if len(found) == 1:
            alone = found[0].gid == self._source
            # The next number of what was not believed shows that it is from who is still there.
            if alone and sequence_number <= self._followed and sequence_number != odd + 1:
                return f'comes from a node that is gone again; {found[0].node} is still there'
            self._follow(found[0])
        self._followed, self._odd = sequence_number, _NONE
        return ''

    def look(self, publishers: Sequence[Publisher], now: float) -> tuple[str, ...] | None:
        """Return the nodes that publish at once; empty if one at most, None if it is not clear.

        Parameters
        ----------
        publishers : sequence of Publisher
            Those in the graph.
        now : float
            Wall time [s].
        """
        names = tuple(sorted(item.node for item in publishers))
        if names != self._seen:
            self._seen, self._looks, self._since = names, 0, now
        self._looks += 1
        if len(names) < 2:
            self._returns = 0
            for item in publishers:
                self._follow(item)
            return ()
        # All but one may be dead: then the numbers begin anew once for each.
        speaking = self._returns >= len(names)
        different = len({item.node for item in publishers if item.known}) > 1
        lasting = now - self._since > GONE
        sure = speaking or lasting or (different and self._looks >= SETTLED)
        return names if sure else None

    def _follow(self, publisher: Publisher) -> None:
        """Take the one publisher for the source; the numbers of another one begin anew."""
        if publisher.gid != self._source:
            self._source, self._followed = publisher.gid, -1


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
    lockstep : bool
        Whether messages are awaited.
    often : bool
        Whether to look by itself, for machines that move; else whoever has it calls `look`.
    """

    def __init__(
        self,
        node: Node,
        topics: dict[str, str],
        tell: Callable[[str, tuple[str, ...]], None],
        *,
        lockstep: bool,
        often: bool,
    ) -> None:
        self._node, self._tell = node, tell
        self._inputs = dict(topics)
        self._sources = {topic: TopicSources(lockstep=lockstep) for topic in topics}
        self._told: dict[str, tuple[str, ...]] = {}
        if often:
            wall_timer(node, PERIOD, self.look)

    def heard(self, topic: str, sequence_number: int) -> str:
        """Note a message; say why it must not be believed.  Topics not watched do not matter."""
        if topic not in self._sources:
            return ''
        return self._sources[topic].heard(sequence_number, lambda: self._publishers(topic))

    def _publishers(self, topic: str) -> list[Publisher]:
        return [
            Publisher(
                f'{item.node_namespace.rstrip("/")}/{item.node_name}', bytes(item.endpoint_gid)
            )
            for item in self._node.get_publishers_info_by_topic(topic)
        ]

    def look(self) -> None:
        """Look who publishes now; tell what has changed."""
        now = time.monotonic()
        for topic, sources in self._sources.items():
            nodes = sources.look(self._publishers(topic), now)
            if nodes is not None and nodes != self._told.get(topic, ()):
                self._told[topic] = nodes
                self._tell(self._inputs[topic], nodes)
