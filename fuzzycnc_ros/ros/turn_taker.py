# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A node's side of a lock-step run over DDS: take turns (docs/explanation/architecture.md).

A turn names, for every topic that the node reads, the sequence number of its newest message.
The node first waits until it has received all of them, so neither the order of arrival nor the
speed of a route can change a result.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from rclpy.node import Node

from fuzzycnc_ros.ros.clocks import AwakeTime, wall_timer
from fuzzycnc_ros.ros.topics import RCLPY, create_publisher, create_subscription, subscription_qos
from fuzzycnc_ros.runtime.component import STREAM
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.host import MachineTick, TickAnswer

PATIENCE = 5.0
"""Wall time [s] without a new message after which what was announced is not waited for any more.
Fast DDS sends a message that was dropped on the way again with its next heartbeat: by the profile
of this package 0.1 s later, without it up to 3 s."""


def tick_topic(node: str) -> str:
    """Return the topic on which a node gets its turns."""
    return f'machine_tick/{node}'


class TurnTaker:
    """The node's side: collect a turn's inputs, work, answer.

    Parameters
    ----------
    node : Node
        The node.
    work : callable
        Works up to a machine time [ns].
    next_deadline : callable
        Returns the node's next deadline [ns] or None.
    reads : callable
        Returns the absolute names of the topics that the node reads.
    writes : sequence of str
        Absolute names of the topics that the node publishes.
    matched : callable
        Told the topics of the run and how many of its nodes read each; says whether both ends of
        all the node's routes are matched.
    patience : float
        Wall time [s] without any input after which announced ones are not waited for any more.
    """

    def __init__(
        self,
        node: Node,
        work: Callable[[int], None],
        next_deadline: Callable[[], int | None],
        *,
        reads: Callable[[], tuple[str, ...]],
        writes: Iterable[str],
        matched: Callable[[Mapping[str, int]], bool],
        patience: float = PATIENCE,
    ) -> None:
        self._node = node
        self._work = work
        self._next_deadline = next_deadline
        self._reads = reads
        self._matched = matched
        self._patience = patience
        self._received: dict[str, int] = {}
        self._published = dict.fromkeys(writes, 0)
        self._turn: MachineTick | None = None
        self._time = AwakeTime(0.1 * patience)
        self._heard_at = self._time.now()
        self.missed = 0
        self._answers = create_publisher(node, TickAnswer.TYPE, 'tick_answer', STREAM)
        create_subscription(
            node,
            MachineTick.TYPE,
            tick_topic(node.get_name()),
            self._on_tick,
            subscription_qos(STREAM, lockstep=True),
        )
        wall_timer(node, 0.1 * patience, self._on_patience)

    def received(self, topic: str, sequence_number: int) -> None:
        """Note that a message of a topic has come in."""
        self._received[topic] = sequence_number
        if self._turn is not None:
            self._heard_at = self._time.now()
            self._try_turn()

    def published(self, topic: str) -> None:
        """Note that the node has published a message."""
        self._published[topic] += 1

    def _on_tick(self, message: Any) -> None:
        tick = decode(MachineTick, message)
        if tick.probe:
            # An unmatched node stays silent: the sequencer asks again.
            readers = dict(zip(tick.topic, tick.readers.tolist(), strict=True))
            if self._matched(readers):
                self._answer(tick, missed=False)
            return
        self._turn, self._heard_at = tick, self._time.now()
        self._try_turn()

    def _try_turn(self) -> None:
        turn = self._turn
        if turn is None:
            return
        for topic, count in zip(turn.topic, turn.published.tolist(), strict=True):
            if self._received.get(topic, 0) < count:
                return
        self._take(turn, missed=False)

    def _on_patience(self) -> None:
        """Work without inputs that were announced but do not come."""
        self._time.look()
        if self._turn is not None and self._time.now() - self._heard_at > self._patience:
            self.missed += 1
            self._take(self._turn, missed=True)

    def _take(self, turn: MachineTick, *, missed: bool) -> None:
        self._turn = None
        self._work(turn.stamp)
        self._answer(turn, missed=missed)

    def _answer(self, tick: MachineTick, *, missed: bool) -> None:
        deadline = self._next_deadline()
        answer = TickAnswer(
            stamp=tick.stamp,
            frame_id=tick.frame_id,
            tick=tick.tick,
            node=self._node.get_name(),
            probe=tick.probe,
            probe_number=tick.probe_number,
            missed=missed,
            topic=tuple(self._published),
            published=np.array(list(self._published.values()), dtype=np.uint64),
            reads=self._reads() if tick.probe else (),
            next_deadline=deadline or 0,
        )
        self._answers.publish(encode(answer, RCLPY))
