# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The machine's side of a lock-step run over DDS: give turns, tick by tick."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rclpy.node import Node

from fuzzycnc_ros.ros.clocks import AwakeTime, wall_timer
from fuzzycnc_ros.ros.topics import RCLPY, create_publisher, create_subscription, subscription_qos
from fuzzycnc_ros.ros.turn_taker import PATIENCE, tick_topic
from fuzzycnc_ros.runtime.component import STREAM
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.host import MachineTick, TickAnswer

LOOK_PERIOD, PROBE_PERIOD = 0.05, 0.1
"""Wall time [s] between two looks at who is silent, and two probes of them."""
RECORDER = 'recorder'
RECORDER_EVERY = 500
"""Ticks between two turns of the recorder, if it has not got many messages before."""
BACKLOG = 150
"""Messages after which a node gets a turn though it has nothing to do, which holds the run up
until it has taken them.  Fast DDS queues 512 for a process in shared memory, turns and `/clock`
too, and drops what comes then: a reader that was not scheduled for a while, while the machine
ticked without it, got them only with the next heartbeat."""
BREATH = 0.05
"""Wall time [s] of ticks in a row without a turn after which the node looks at the rest of its
work: with all nodes lost it would otherwise run to the end of the programme unheard."""
RECORDER_TIMEOUT = 30.0
"""Wall time [s] after which a silent recorder is lost; a stopped process may well come back."""


@dataclass
class Participant:
    """State of one node in the sequencer."""

    name: str
    publisher: Any
    timeout: float
    """Wall time [s] after which the node is lost."""
    every: int = 1
    """Ticks between two turns."""
    lost: bool = True
    reads: tuple[str, ...] = ()
    quiet: frozenset[str] = frozenset()
    """Topics that alone give the node no turn."""
    next_deadline: int = 0
    seen: dict[str, int] = field(default_factory=dict)
    """Newest sequence number of each topic at the node's last turn."""
    probe_number: int = 0


class Sequencer:
    """Give one turn after the other, tick by tick, until the programme is over.

    It first sends probes, which change no state, until every node has answered one that named
    all topics of the run; each node vouches for both ends of its own routes.  A node that does
    not answer a turn in time is lost: reported once, and left out until it answers a probe.

    Parameters
    ----------
    node : Node
        The node of the machine.
    nodes : sequence of str
        Names of the nodes that get turns, in order.
    advance : callable
        Makes the machine take its inputs up to the next tick, tick and publish; returns the
        stamp [ns], or None when the programme is over.
    published : callable
        Returns the machine's own publications so far, absolute topic to count.
    matched : callable
        Told how many nodes of the run read each topic; says whether both ends of all the
        machine's own routes are matched.
    finished : callable
        Called once, when the programme is over and all turns are taken.
    recorder : bool
        Whether the node `recorder` gets a turn every 500 ticks and at the end.
    answer_timeout : float
        Wall time [s] after which a silent node is lost.
    reads : sequence of str
        Absolute names of the topics that the machine itself reads; it must say what it has
        `received`.
    """

    def __init__(
        self,
        node: Node,
        nodes: tuple[str, ...],
        *,
        advance: Callable[[], int | None],
        published: Callable[[], dict[str, int]],
        matched: Callable[[Mapping[str, int]], bool],
        finished: Callable[[], None],
        recorder: bool,
        answer_timeout: float,
        reads: tuple[str, ...] = (),
    ) -> None:
        self._node = node
        self._advance, self._own = advance, published
        self._matched, self._finished = matched, finished
        self._participants = [self._participant(name, answer_timeout) for name in nodes]
        if recorder:
            last = self._participant(RECORDER, RECORDER_TIMEOUT)
            last.every = RECORDER_EVERY
            self._participants.append(last)
        self._counts: dict[str, int] = {}
        self._received = dict.fromkeys(reads, 0)
        self._held = False
        self._stamp = 0
        self._turn = len(self._participants)
        self._waiting: Participant | None = None
        self._time = AwakeTime(LOOK_PERIOD)
        self._since = self._time.now()
        self._probed = 0.0
        self._probes = 0
        self._running = False
        self._programme_over = False
        self.tick = 0
        """Number of the present tick."""
        self.over = False
        """True if the programme is over and all turns are taken."""
        self.lost: list[str] = []
        """Nodes that fell silent, in order of the event."""
        self.missed = 0
        """Turns that were taken without all announced inputs."""
        create_subscription(
            node,
            TickAnswer.TYPE,
            'tick_answer',
            self._on_answer,
            subscription_qos(STREAM, lockstep=True),
        )
        wall_timer(node, LOOK_PERIOD, self._on_timer)
        self._breath = wall_timer(node, 0.0, self._after_breath)
        self._breath.cancel()

    @property
    def degraded(self) -> bool:
        """True if the run proves nothing: a node was lost or worked without its inputs."""
        return bool(self.lost) or self.missed > 0

    @property
    def running(self) -> bool:
        """True if the first tick has been given."""
        return self._running

    @property
    def waiting_for(self) -> tuple[str, ...]:
        """Names of the nodes that have not answered a probe yet, or were lost."""
        return tuple(item.name for item in self._participants if item.lost)

    def received(self, topic: str, sequence_number: int) -> None:
        """Note that the machine has received a message of a topic that it reads."""
        self._received[topic] = sequence_number
        if self._held:
            self._since = self._time.now()
            if self._inputs_are_here():
                self._next()

    def _participant(self, name: str, timeout: float) -> Participant:
        publisher = create_publisher(self._node, MachineTick.TYPE, tick_topic(name), STREAM)
        space = self._node.get_namespace().rstrip('/')
        # Loaded on use: only a lock-step run needs to know the components of other nodes.
        from fuzzycnc_ros.registry import COMPONENTS

        component = COMPONENTS.get(name)
        inputs = () if component is None else component.INPUTS
        quiet = frozenset(f'{space}/{item.name}' for item in inputs if item.quiet)
        return Participant(name, publisher, timeout, quiet=quiet)

    def _on_timer(self) -> None:
        """Probe silent nodes, start when all are there, notice those that fall silent."""
        self._time.look()
        now = self._time.now()
        if now - self._probed >= PROBE_PERIOD:
            self._probed = now
            for item in self._participants:
                if item.lost:
                    self._probe(item)
        if self.over:
            return
        if not self._running:
            if not self.waiting_for and self._routes_stand():
                self._running = True
                self._next()
        elif self._waiting is not None and now - self._since > self._waiting.timeout:
            self._lose(self._waiting)
            self._next()
        elif self._held and now - self._since > PATIENCE:
            self.missed += 1
            self._next(without_inputs=True)

    def _lose(self, item: Participant) -> None:
        item.lost = True
        self.lost.append(item.name)
        self._waiting = None
        self._node.get_logger().warning(
            f'{item.name} did not answer tick {self.tick} within {item.timeout:g} s: lost until '
            'it answers a probe; this run is degraded'
        )

    def _on_answer(self, message: Any) -> None:
        answer = decode(TickAnswer, message)
        item = next((p for p in self._participants if p.name == answer.node), None)
        if item is None:
            return
        counts = dict(zip(answer.topic, answer.published.tolist(), strict=True))
        if answer.probe:
            self._on_probe_answer(item, answer, counts)
        elif item is self._waiting and answer.tick == self.tick:
            self._counts.update(counts)
            item.next_deadline = answer.next_deadline
            self.missed += answer.missed
            self._waiting = None
            self._next()

    def _on_probe_answer(
        self, item: Participant, answer: TickAnswer, counts: dict[str, int]
    ) -> None:
        if not item.lost:
            return
        news = set(counts) - set(self._counts) or set(answer.reads) - set(item.reads)
        self._counts.update(counts)
        item.reads = answer.reads
        if news:
            # Earlier answers did not vouch for these topics and readers: all are asked again.
            self._probes += 1
            if not self._running:
                for other in self._participants:
                    other.lost = True
                return
        if answer.probe_number < self._probes:
            return
        item.lost = False
        item.next_deadline = answer.next_deadline
        item.seen = {}
        if self._running:
            self._node.get_logger().info(f'{item.name} is back at tick {self.tick}')

    def _inputs_are_here(self) -> bool:
        """Return True if the machine has received everything that was announced to it.

        An answer may overtake the message that it announces.
        """
        return all(self._counts.get(t, 0) <= number for t, number in self._received.items())

    def _next(self, *, without_inputs: bool = False) -> None:
        """Give the next turn that is due; tick when there is none left."""
        self._held = False
        began = time.monotonic()
        while not self.over:
            counts = self._all_counts()
            while self._turn < len(self._participants):
                item = self._participants[self._turn]
                self._turn += 1
                if not item.lost and self._due(item, counts):
                    self._give_turn(item, counts)
                    return
            if self._programme_over:
                self.over = True
                self._finished()
                return
            if not (without_inputs or self._inputs_are_here()):
                self._held, self._since = True, self._time.now()
                return
            stamp = self._advance()
            self._turn = 0
            if stamp is None:
                # One more round: the recorder and late deadlines get their last turn.
                self._programme_over = True
                continue
            self.tick += 1
            self._stamp = stamp
            if time.monotonic() - began > BREATH:
                self._breath.reset()
                return

    def _after_breath(self) -> None:
        self._breath.cancel()
        self._next()

    def _due(self, item: Participant, counts: Mapping[str, int]) -> bool:
        """Return True if a turn would change anything: by new inputs that matter, or a deadline.

        Nor may too many messages wait for a node.
        """
        news = {t: counts.get(t, 0) - item.seen.get(t, 0) for t in item.reads}
        if sum(news.values()) >= BACKLOG:
            return True
        if item.every > 1 and self.tick % item.every and not self._programme_over:
            return False
        if 0 < item.next_deadline <= self._stamp:
            return True
        return any(count for topic, count in news.items() if topic not in item.quiet)

    def _give_turn(self, item: Participant, counts: dict[str, int]) -> None:
        item.seen = counts
        self._waiting, self._since = item, self._time.now()
        # What the node does not read is none of its business, and costs time to send.
        self._send(item, {topic: counts[topic] for topic in item.reads if topic in counts})

    def _probe(self, item: Participant) -> None:
        self._send(item, self._all_counts(), probe=True)

    def _readers(self) -> dict[str, int]:
        """Return how many nodes of the run read each of its topics.

        A writer that has not met a reader yet does not send to it, though the reader may have
        met the writer: each writer has to see as many readers as have answered.
        """
        readers = dict.fromkeys(self._all_counts(), 0)
        for topic in self._received:
            if topic in readers:  # else nobody in the run writes what the machine would read
                readers[topic] += 1
        for item in self._participants:
            for topic in item.reads:
                # What the machine would read too, nobody in the run writes unless it is known.
                if topic in readers or topic not in self._received:
                    readers[topic] = readers.get(topic, 0) + 1
        return readers

    def _routes_stand(self) -> bool:
        """Return True if the machine's own writers have met all readers of the run."""
        readers = self._readers()
        turns = (item.publisher for item in self._participants)
        return self._matched(readers) and all(
            p.get_subscription_count() > readers.get(p.topic_name, 0) for p in turns
        )

    def _all_counts(self) -> dict[str, int]:
        # What the machine could write but has not, another node of the run may write.
        own = self._own().items()
        return self._counts | {t: n for t, n in own if n or t not in self._counts}

    def _send(self, item: Participant, counts: dict[str, int], *, probe: bool = False) -> None:
        readers = self._readers() if probe else {}
        tick = MachineTick(
            stamp=self._stamp,
            tick=self.tick,
            node=item.name,
            probe=probe,
            probe_number=self._probes if probe else 0,
            topic=tuple(counts),
            published=np.array(list(counts.values()), dtype=np.uint64),
            readers=np.array([readers[t] for t in counts] if probe else [], dtype=np.uint32),
        )
        item.publisher.publish(encode(tick, RCLPY))
