# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `player`: the recorded topics again, undecoded, with `/clock`.

At a rate it keeps the recorded distances in time.  In lock-step it takes the machine's place:
one tick per recorded stamp, the next as soon as all nodes have answered.
"""

import json
import posixpath
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage

from fuzzycnc_ros.bags.playback import (
    Playback,
    PlayedMessage,
    PlayedTopic,
    played_topics,
    require_topics,
)
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.graph.sequencer import Sequencer
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.bag_node import bag_refused, closed_on_failure, pattern
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.configured_node import ConfiguredNode
from fuzzycnc_ros.ros.node_config import PlayerConfig
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.ros.presence import check_alone
from fuzzycnc_ros.ros.run import tell_error
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos, routes_matched
from fuzzycnc_ros.runtime.component import STREAM, Health, Level
from fuzzycnc_ros.runtime.records import SECOND, nanoseconds

POLL = 0.005
"""Wall time [s] between two looks at what is due, at a rate."""
CLOCK_PERIOD = 0.02
"""Wall time [s] between two messages on `/clock` while nothing else is due."""
BATCH = 500
"""Messages sent in one go, so that the node still hears that it shall end."""
MATCH_TIMEOUT = 10.0
"""Wall time [s] to wait for readers that are there but not connected."""
ACKNOWLEDGE_TIMEOUT = 5.0
"""Wall time [s] that readers get for the last messages."""


class PlayerNode(ConfiguredNode[PlayerConfig]):
    """Play a bag until its end, or for ever."""

    def __init__(self, node: Node) -> None:
        check_alone(node.get_namespace(), 'player')
        super().__init__(node, PlayerConfig)
        self._check(self._config)
        with bag_refused():
            self._reader = BagReader(self._config.bag)
        with closed_on_failure(self._reader):
            self._prepare()

    def _prepare(self) -> None:
        """Choose what to play, create the topics, take the first message."""
        node, config = self.node, self._config
        with bag_refused():
            self._topics = self._choose()
        self._playback = Playback(
            self._reader,
            self._topics,
            *self._played_span(),
            ordered=config.lockstep,
            loop=config.loop,
            restamp=config.restamp,
            told=node.get_logger().info,
        )
        if self._playback.next is None:
            raise ParameterError(self._playback.error or f'{config.bag}: no message to play')
        self._publishers = self._advertise()
        self._published = {p.topic_name: 0 for p in self._publishers.values()}
        self._clock = node.create_publisher(ClockMessage, '/clock', publisher_qos(STREAM))
        self._last_tick = 0
        self._sent = 0
        self._done = False
        self._sequencer: Sequencer | None = None
        if config.lockstep:
            self._sequencer = Sequencer(
                node,
                config.lockstep_nodes,
                advance=self._tick,
                published=lambda: self._published,
                matched=lambda readers: routes_matched(
                    node, (), self._publishers.values(), readers
                ),
                finished=self._finish,
                recorder=config.lockstep_recorder,
                answer_timeout=config.answer_timeout,
            )
        else:
            self._created = time.monotonic()
            self._started: float | None = None
            self._clock_sent = 0.0
            self._machine_time: int | None = None
            self._machine_time_at = 0
            wall_timer(node, POLL, self._play_due)
        wall_timer(node, 1.0, self._report)

    @property
    def done(self) -> bool:
        """True if everything has been played."""
        return self._done

    def start(self) -> None:
        """Say what is played."""
        first, stop = self._playback.first, self._playback.last
        self.node.get_logger().info(
            f'playing {len(self._topics)} topics of {self._config.bag} from '
            f'{self._seconds(first):.3f} to {self._seconds(stop):.3f} s'
        )

    def stop(self) -> None:
        """Close the bag."""
        self._reader.close()

    # The bag

    @staticmethod
    def _check(config: PlayerConfig) -> None:
        if not config.bag:
            raise ParameterError('parameter bag: expected the directory of a bag')
        if 0.0 < config.end <= config.start:
            raise ParameterError(
                f'parameter end = {config.end:g} s must lie behind start = {config.start:g} s'
            )
        if config.lockstep and config.loop and not config.restamp:
            raise ParameterError(
                'parameter loop: in lock-step machine time cannot go back; set restamp as well'
            )

    def _choose(self) -> dict[str, PlayedTopic]:
        """Return the topics to play; what cannot be played here is refused or left out."""
        include = pattern('topics', self._config.topics)
        exclude = pattern('exclude', self._config.exclude)
        connections = self._reader.connections
        wanted = [
            topic
            for topic in connections
            if topic != '/clock'
            and include.search(topic)
            and not (self._config.exclude and exclude.search(topic))
        ]
        text = f'that match {self._config.topics!r}' if self._config.topics else 'to play'
        kept = []
        for topic in require_topics(self._reader, wanted, text):
            try:
                message_class(connections[topic].type)
            except (ImportError, AttributeError):
                self.node.get_logger().warning(
                    f'{topic} is not played: its type {connections[topic].type} is not '
                    'installed here'
                )
                continue
            kept.append(topic)
        if not kept:
            raise ParameterError(f'{self._config.bag}: no type of its topics is installed here')
        return played_topics(self._reader, kept)

    def _played_span(self) -> tuple[int | None, int | None]:
        """Return the log times between which the bag is played [ns], None for its own ends."""
        start = self._reader.start + nanoseconds(self._config.start)
        if start > self._reader.stop:
            raise ParameterError(
                f'parameter start = {self._config.start:g} s lies behind the end of '
                f'{self._config.bag}, which is {self._seconds(self._reader.stop):.3f} s long'
            )
        end = self._reader.start + nanoseconds(self._config.end)
        return (
            start if self._config.start else None,
            min(end, self._reader.stop) if self._config.end else None,
        )

    def _seconds(self, log_time: int) -> float:
        return (log_time - self._reader.start) / SECOND

    # Topics

    def _advertise(self) -> dict[str, Any]:
        return {
            name: self.node.create_publisher(
                message_class(topic.type),
                self._target(name),
                _qos(topic),
                event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
            )
            for name, topic in self._topics.items()
        }

    def _target(self, topic: str) -> str:
        if self._config.keep_namespace:
            return topic
        spaces = {posixpath.dirname(name) for name in self._topics}
        common = posixpath.commonpath(spaces)
        return posixpath.relpath(topic, common)

    def _send(self, message: PlayedMessage) -> None:
        publisher = self._publishers[message.topic]
        publisher.publish(message.payload)
        self._published[publisher.topic_name] += 1
        self._sent += 1

    def _send_clock(self, stamp: int) -> None:
        self._clock.publish(ClockMessage(clock=RCLPY.time(stamp)))

    # Lock-step

    def _tick(self) -> int | None:
        """Send everything of the next tick; return its stamp [ns], None at the end."""
        batch: list[PlayedMessage] = []
        stamp: int | None = None
        while (message := self._playback.next) is not None:
            if stamp is None and message.topic in self._playback.timing:
                stamp = self._tick_of(message.stamp)
            if stamp is not None and message.stamp > stamp:
                break
            batch.append(message)
            self._playback.advance()
        if not batch:
            return None
        self._last_tick = max(self._last_tick, batch[-1].stamp if stamp is None else stamp)
        self._send_clock(self._last_tick)
        for message in batch:
            self._send(message)
        return self._last_tick

    def _tick_of(self, stamp: int) -> int:
        """Return the tick at which a message of some stamp is sent [ns]."""
        period = nanoseconds(self._config.tick_period)
        return -(-stamp // period) * period if period else stamp

    # At a rate

    def _play_due(self) -> None:
        """Send what is due, and the time."""
        now = time.monotonic()
        if self._started is None:
            if not self._ready(now):
                return
            self._started = now
        due = self._playback.first + int((now - self._started) * self._config.rate * SECOND)
        for _ in range(BATCH):
            message = self._playback.next
            if message is None:
                self._finish()
                return
            if message.log_time > due:
                break
            if message.topic in self._playback.timing:
                if message.stamp != self._machine_time:
                    self._send_clock(message.stamp)
                    self._clock_sent = now
                self._machine_time, self._machine_time_at = message.stamp, message.log_time
            self._send(message)
            self._playback.advance()
        self._keep_time(now, due)

    def _ready(self, now: float) -> bool:
        """Return True if the readers have found the topics, those aside that cannot match."""
        waited = now - self._created - self._config.start_delay
        if waited < 0.0:
            return False
        if routes_matched(self.node, (), self._publishers.values()):
            return True
        if waited < MATCH_TIMEOUT:
            return False
        self.node.get_logger().warning(
            f'some readers did not connect within {MATCH_TIMEOUT:g} s; playing without them'
        )
        return True

    def _keep_time(self, now: float, due: int) -> None:
        """Let machine time pass between two messages, but not past the next one."""
        if self._machine_time is None or now - self._clock_sent < CLOCK_PERIOD:
            return
        self._clock_sent = now
        stamp = self._machine_time + due - self._machine_time_at
        following = self._playback.next
        if following is not None and following.topic in self._playback.timing:
            stamp = min(stamp, following.stamp)
        self._send_clock(max(stamp, self._machine_time))

    # The end

    def _finish(self) -> None:
        """Wait until the readers have everything, and say how it went."""
        timeout = Duration(seconds=ACKNOWLEDGE_TIMEOUT)
        heard = all(item.wait_for_all_acked(timeout) for item in self._publishers.values())
        if not heard:
            self.node.get_logger().warning('some readers did not acknowledge the last messages')
        if self._playback.error:
            self.exit_code = 1
            tell_error(self._playback.error)
        outcome: dict[str, Any] = {'messages': self._sent}
        if self._sequencer is not None:
            outcome['ticks'] = self._sequencer.tick
            outcome['degraded'] = self._sequencer.degraded
            outcome['lost'] = self._sequencer.lost
            outcome['missed'] = self._sequencer.missed
        print(json.dumps(outcome), flush=True)
        self._done = True

    def _report(self) -> None:
        """Publish on /diagnostics how far the bag has been played."""
        values = {
            'messages': str(self._sent),
            'repetition': str(self._playback.repetition),
            'rate': 'lock-step' if self._config.lockstep else f'{self._config.rate:g}',
        }
        position, stop = self._playback.position, self._playback.last
        text = f'at {self._seconds(position):.1f} of {self._seconds(stop):.1f} s'
        health = [Health('playback', Level.OK, text, values)]
        if self._sequencer is not None and self._sequencer.waiting_for:
            text = f'waiting for {", ".join(self._sequencer.waiting_for)}'
            health.append(Health('lock-step', Level.WARN, text))
        self._publish_health(health)


def _qos(topic: PlayedTopic) -> QoSProfile:
    """Return the QoS to offer: reliable satisfies every reader, durability is as recorded."""
    if topic.latched:
        return QoSProfile(
            depth=max(topic.depth, 1),
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
    return publisher_qos(STREAM)


def make() -> PlayerNode:
    """Create the node."""
    return PlayerNode(Node('player'))


def main() -> None:
    """Run the node until the bag is over or it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
