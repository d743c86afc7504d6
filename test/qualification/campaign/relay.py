# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A node in the midst of routes: passes messages on, or what a fault makes of them.

The publisher of a topic is remapped to `direct/<topic>`; the relay reads that and publishes the
topic itself, so that a bag has what was sent beside what arrived.
"""

import heapq
import random
import time
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, Protocol

from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.ros.topics import (
    RCLPY,
    create_subscription,
    message_class,
    publisher_qos,
    subscription_qos,
)
from fuzzycnc_ros.runtime.component import STREAM, Durability
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.records import Record

CLOCK = '/clock'
_CLOCK_TYPE = 'rosgraph_msgs/msg/Clock'


def direct(topic: str) -> str:
    """Return the name under which the publisher of a topic is heard by the relay alone."""
    return f'direct/{topic.strip("/")}'


def remappings(routes: Mapping[str, str]) -> list[str]:
    """Return the remappings that put the relay into routes, topic to publishing node."""
    return [f'{node}:{topic}:={direct(topic)}' for topic, node in routes.items()]


class RouteFault(Protocol):
    """What happens to the messages of a route: delays [s of wall time] and payloads to send."""

    def passed(self, topic: str, payload: bytes) -> list[tuple[float, bytes]]:
        """Return what becomes of one message."""


class Drop:
    """Lose a share of the messages."""

    def __init__(self, share: float, seed: int) -> None:
        self._share, self._random = share, random.Random(seed)
        self.count = 0

    def passed(self, topic: str, payload: bytes) -> list[tuple[float, bytes]]:
        """Return the message, or nothing."""
        if self._random.random() < self._share:
            self.count += 1
            return []
        return [(0.0, payload)]


class Delay:
    """Hold every message back, by the same time or by one drawn anew: then they overtake."""

    def __init__(self, least: float, most: float, seed: int) -> None:
        self._least, self._most, self._random = least, most, random.Random(seed)

    def passed(self, topic: str, payload: bytes) -> list[tuple[float, bytes]]:
        """Return the message, late."""
        return [(self._random.uniform(self._least, self._most), payload)]


class Duplicate:
    """Send every message twice, the second time a little later."""

    def __init__(self, after: float) -> None:
        self._after = after

    def passed(self, topic: str, payload: bytes) -> list[tuple[float, bytes]]:
        """Return the message twice."""
        return [(0.0, payload), (self._after, payload)]


class Falsify:
    """Change the records of one topic, leave the others alone."""

    def __init__(self, topic: str, change: Any) -> None:
        self._topic, self._change = topic, change
        self.struck = False
        """Whether a record was changed."""

    def passed(self, topic: str, payload: bytes) -> list[tuple[float, bytes]]:
        """Return the message, changed where it is one of that topic."""
        if topic != self._topic:
            return [(0.0, payload)]
        self.struck = True
        if topic == CLOCK:
            kind = message_class(_CLOCK_TYPE)
            return [
                (0.0, bytes(serialize_message(self._change(deserialize_message(payload, kind)))))
            ]
        record_type = record_types()[topic]
        message = deserialize_message(payload, message_class(record_type.TYPE))
        changed = self._change(decode(record_type, message))
        return [(0.0, bytes(serialize_message(encode(changed, RCLPY))))]


@cache
def record_types() -> dict[str, type[Record]]:
    """Return the record type of every input of a component."""
    return {item.name: item.record for c in COMPONENTS.values() for item in c.INPUTS}


def durability(topic: str) -> Durability:
    """Return how the nodes that read a topic keep it."""
    kept = {item.name: item.durability for c in COMPONENTS.values() for item in c.INPUTS}
    return kept.get(topic, STREAM)


def readers(topic: str, nodes: Sequence[str]) -> int:
    """Return how many of some nodes read a topic."""
    if topic == CLOCK:
        return len(nodes)
    inputs = [{item.name for item in COMPONENTS[name].INPUTS} for name in nodes]
    return sum(topic in names for names in inputs)


class Relay:
    """Pass topics on.

    Parameters
    ----------
    node : Node
        The node; its namespace is that of the machine.
    topics : iterable of str
        Topics whose publishers are remapped.
    nodes : sequence of str
        Nodes of the graph beside machine and recorder.
    """

    def __init__(self, node: Node, topics: Iterable[str], nodes: Sequence[str]) -> None:
        self.fault: RouteFault | None = None
        self._node = node
        self._waiting: list[tuple[float, int, str, bytes]] = []
        self._serial = 0
        self._publishers: dict[str, Any] = {}
        types = record_types()
        self._readers = {topic: readers(topic, nodes) for topic in topics}
        for topic in topics:
            type_name = _CLOCK_TYPE if topic == CLOCK else types[topic].TYPE
            kept = durability(topic)
            self._publishers[topic] = node.create_publisher(
                message_class(type_name), topic, publisher_qos(kept)
            )
            create_subscription(
                node,
                type_name,
                direct(topic),
                self._handler(topic),
                subscription_qos(kept, lockstep=True),
                raw=True,
            )

    def matched(self) -> bool:
        """Whether each topic has met the recorder and the nodes that read it.

        The machine itself is started later.
        """
        return all(
            publisher.get_subscription_count() > self._readers[topic]
            for topic, publisher in self._publishers.items()
        )

    def send_due(self) -> None:
        """Send what has been held back for long enough."""
        now = time.monotonic()
        while self._waiting and self._waiting[0][0] <= now:
            _, _, topic, payload = heapq.heappop(self._waiting)
            self._publishers[topic].publish(payload)

    def _handler(self, topic: str) -> Any:
        def on_message(payload: bytes) -> None:
            if self.fault is None and not self._waiting:
                self._publishers[topic].publish(payload)
                return
            now = time.monotonic()
            sent = [(0.0, payload)] if self.fault is None else self.fault.passed(topic, payload)
            for wait, content in sent:
                self._serial += 1
                heapq.heappush(self._waiting, (now + wait, self._serial, topic, content))
            self.send_due()

        return on_message
