# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A node that passes topics on under `late/`, each message after a random time.

In lock-step it announces at once what it will send only later: its readers are given their turn
before their inputs are there, and get them in any order.
"""

import json
import random
import sys
import time

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.ros.processes import prepare_environment
from fuzzycnc_ros.ros.topics import message_class, publisher_qos, routes_matched, subscription_qos
from fuzzycnc_ros.ros.turn_taker import TurnTaker
from fuzzycnc_ros.runtime.component import STREAM

DELAY_MAX = 0.004
"""Longest delay [s]: many times a turn."""


class DelayingRelay:
    """Pass topics on, late."""

    def __init__(self, node, topics):
        types = {i.name: i.record.TYPE for c in COMPONENTS.values() for i in c.INPUTS}
        self._random = random.Random(1)
        self._waiting = []
        self._inputs = []
        self._publishers = {}
        self._newest = 0
        self.overtaken = 0
        for topic in topics:
            kind = message_class(types[topic])
            self._publishers[topic] = node.create_publisher(
                kind, f'late/{topic}', publisher_qos(STREAM)
            )
            self._inputs.append(
                node.create_subscription(
                    kind,
                    topic,
                    self._handler(topic, node.resolve_topic_name(topic)),
                    subscription_qos(STREAM, lockstep=True),
                    raw=True,
                )
            )
        self._turns = TurnTaker(
            node,
            lambda stamp: None,
            lambda: None,
            reads=lambda: tuple(node.resolve_topic_name(topic) for topic in topics),
            writes=[item.topic_name for item in self._publishers.values()],
            matched=lambda known: routes_matched(
                node, self._inputs, self._publishers.values(), known
            ),
        )
        node.create_timer(0.0005, self._send_due)

    def _handler(self, topic, name):
        def on_message(payload, info):
            number = info['publication_sequence_number']
            due = time.monotonic() + self._random.uniform(0.0, DELAY_MAX)
            self._waiting.append((due, len(self._waiting), topic, payload))
            self._turns.published(self._publishers[topic].topic_name)
            self._turns.received(name, number)

        return on_message

    def _send_due(self):
        now = time.monotonic()
        due = sorted(item for item in self._waiting if item[0] <= now)
        for item in due:
            # A message of the same topic must not be overtaken, one of another may.
            if any(i[2] == item[2] and i is not item and i[1] < item[1] for i in self._waiting):
                continue
            self.overtaken += any(i[1] < item[1] for i in self._waiting)
            self._waiting.remove(item)
            self._publishers[item[2]].publish(item[3])
        self._waiting = [
            (wait, order, topic, payload)
            for order, (wait, _, topic, payload) in enumerate(self._waiting)
        ]


def main():
    """Relay until interrupted."""
    prepare_environment()
    rclpy.init(args=[sys.argv[0], '--ros-args', '-r', '__ns:=/mill'])
    executor = SingleThreadedExecutor()
    node = Node('delaying_relay')
    relay = DelayingRelay(node, sys.argv[1:])
    executor.add_node(node)
    try:
        while rclpy.ok():
            executor.spin_once()
    except (KeyboardInterrupt, ExternalShutdownException):
        print(json.dumps({'overtaken': relay.overtaken}), flush=True)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
