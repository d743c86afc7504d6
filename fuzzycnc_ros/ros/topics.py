# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of a node: message classes, QoS, routes.

docs/explanation/architecture.md says why these depths.
"""

from collections.abc import Callable, Collection, Mapping
from functools import cache
from importlib import import_module
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from fuzzycnc_ros.runtime.component import HISTORY, LATCHED, Durability
from fuzzycnc_ros.runtime.convert import Target


@cache
def message_class(type_name: str) -> Any:
    """Return the class of `package/kind/Name`."""
    package, kind, name = type_name.split('/')
    return getattr(import_module(f'{package}.{kind}'), name)


RCLPY = Target(message_class, numpy_arrays=False)
"""Builds rclpy's messages."""


PUBLISHER_DEPTH = 2000
"""A publisher serves its slowest reader: a recorder that pauses for two seconds."""
HISTORY_DEPTH = 100
"""A recorder that comes late still learns every request that made a node what it is."""
SUBSCRIPTION_DEPTH = 10
LOCKSTEP_DEPTH = 2000
"""In lock-step a node may get hundreds of messages in one turn, none of which may be lost."""


EMPTY: Mapping[str, int] = {}


def create_publisher(node: Node, type_name: str, topic: str, durability: Durability) -> Any:
    """Create a publisher of a message type by its name.

    rclpy's default event callbacks are left out here and below: they only log incompatible
    readers, but the executor looks at two of them per topic in every single wait, which halved
    the speed of a lock-step run.  The host reports unmatched routes on /diagnostics instead.
    """
    return node.create_publisher(
        message_class(type_name),
        topic,
        publisher_qos(durability),
        event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
    )


def create_subscription(
    node: Node,
    type_name: str,
    topic: str,
    callback: Callable[..., None],
    qos: QoSProfile,
    *,
    raw: bool = False,
) -> Any:
    """Create a subscription to a message type by its name."""
    return node.create_subscription(
        message_class(type_name),
        topic,
        callback,
        qos,
        raw=raw,
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
    )


def unmatched(node: Node, subscription: Any) -> int:
    """Return how many publishers of a subscription's topic it cannot hear."""
    known = node.count_publishers(subscription.topic_name)
    return max(0, known - int(subscription.get_publisher_count()))


def publisher_qos(durability: Durability) -> QoSProfile:
    """Return the QoS of a publisher."""
    if durability is LATCHED:
        # A reader keeps the newest; a recorder that pauses must still get every one.
        return durable(PUBLISHER_DEPTH)
    return durable(HISTORY_DEPTH) if durability is HISTORY else _stream(PUBLISHER_DEPTH)


def subscription_qos(durability: Durability, *, lockstep: bool = False) -> QoSProfile:
    """Return the QoS of a component's subscription."""
    if durability is LATCHED:
        return durable(1)
    return _stream(LOCKSTEP_DEPTH if lockstep else SUBSCRIPTION_DEPTH)


def routes_matched(
    node: Node,
    subscriptions: Collection[Any],
    publishers: Collection[Any],
    readers: Mapping[str, int] = EMPTY,
) -> bool:
    """Return True if both ends of all routes of a node are matched, as far as the graph is known.

    Parameters
    ----------
    node : Node
        The node.
    subscriptions, publishers : collection
        Its ends.
    readers : mapping of str to int
        Topics of the run, absolute names, and how many nodes of the run read each; the graph as
        seen from here may not show them yet.
    """
    heard = all(
        item.get_publisher_count()
        >= max(node.count_publishers(item.topic_name), int(item.topic_name in readers))
        for item in subscriptions
    )
    return heard and all(
        item.get_subscription_count()
        >= max(node.count_subscribers(item.topic_name), readers.get(item.topic_name, 0))
        for item in publishers
    )


def durable(depth: int) -> QoSProfile:
    """Return the QoS of what reaches those that come later, up to `depth` messages of it."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def _stream(depth: int) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
    )
