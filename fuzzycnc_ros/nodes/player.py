# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `player`: the recorded topics again, undecoded, with `/clock`.

At a rate it keeps the recorded distances in time.  In lock-step it takes the machine's place:
one tick per recorded stamp, the next as soon as all nodes have answered.
"""

import json
import posixpath
import re
import sys
import time
from collections.abc import Iterator
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage

from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.bags.playback import (
    PlayedMessage,
    PlayedTopic,
    by_stamp,
    messages,
    played_topics,
    require_topics,
    restamped,
)
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.components.component import STREAM, Health, Level
from fuzzycnc_ros.components.host_config import PlayerConfig
from fuzzycnc_ros.components.records import SECOND, nanoseconds
from fuzzycnc_ros.nodes import run
from fuzzycnc_ros.nodes.diagnostics import diagnostic_array
from fuzzycnc_ros.nodes.messages import RCLPY, message_class
from fuzzycnc_ros.nodes.parameters import ParameterError, declare
from fuzzycnc_ros.nodes.qos import publisher_qos, routes_matched
from fuzzycnc_ros.nodes.sequencer import Sequencer
from fuzzycnc_ros.nodes.timers import wall_timer

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


class PlayerNode:
    """Play a bag until its end, or for ever."""

    exit_code = 0

    def __init__(self, node: Node) -> None:
        self.node = node
        (config,) = declare(node, PlayerConfig)
        assert isinstance(config, PlayerConfig)
        self._config = config
        self._check(config)
        try:
            self._reader = BagReader(config.bag)
        except BagError as error:
            raise ParameterError(str(error)) from error
        try:
            self._prepare()
        except BaseException:
            self._reader.close()
            raise

    def _prepare(self) -> None:
        """Choose what to play, create the topics, take the first message."""
        node, config = self.node, self._config
        try:
            self._topics = self._choose()
        except BagError as error:
            raise ParameterError(str(error)) from error
        self._span = self._played_span()
        # A latched message may be an old fact told again: it makes no time if others do.
        self._timing = {name for name, topic in self._topics.items() if not topic.latched}
        self._timing = self._timing or set(self._topics)
        self._publishers = self._advertise()
        self._published = {p.topic_name: 0 for p in self._publishers.values()}
        self._clock = node.create_publisher(ClockMessage, '/clock', publisher_qos(STREAM))
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._repetition = 0
        self._log_shift = self._stamp_shift = 0
        self._first_stamp: int | None = None
        self._last_stamp = self._last_log_time = self._last_tick = 0
        self._step = SECOND
        self._sent = 0
        self._error = ''
        self._done = False
        self._source = self._open()
        self._next = self._take()
        if self._next is None:
            raise ParameterError(self._error or f'{config.bag}: no message to play')
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
        """Whether everything has been played."""
        return self._done

    def start(self) -> None:
        """Say what is played."""
        first, stop = self._span
        self.node.get_logger().info(
            f'playing {len(self._topics)} topics of {self._config.bag} from '
            f'{self._seconds(first):.3f} to {self._seconds(stop):.3f} s'
        )

    def stop(self) -> None:
        """Close the bag."""
        self._reader.close()
        self.node.destroy_node()

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
        include = self._pattern('topics', self._config.topics)
        exclude = self._pattern('exclude', self._config.exclude)
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

    @staticmethod
    def _pattern(name: str, text: str) -> re.Pattern[str]:
        try:
            return re.compile(text)
        except re.error as error:
            raise ParameterError(
                f'parameter {name}: {text!r} is no regular expression: {error}'
            ) from error

    def _played_span(self) -> tuple[int, int]:
        """Return the log times between which the bag is played [ns]."""
        start = self._reader.start + nanoseconds(self._config.start)
        if start > self._reader.stop:
            raise ParameterError(
                f'parameter start = {self._config.start:g} s lies behind the end of '
                f'{self._config.bag}, which is {self._seconds(self._reader.stop):.3f} s long'
            )
        end = self._reader.start + nanoseconds(self._config.end)
        return start, min(end, self._reader.stop) if self._config.end else self._reader.stop

    def _seconds(self, log_time: int) -> float:
        return (log_time - self._reader.start) / SECOND

    def _open(self) -> Iterator[PlayedMessage]:
        """Return the messages of one repetition."""
        first, last = self._span
        whole = self._config.start == 0.0 and self._config.end == 0.0
        source = messages(
            self._reader,
            self._topics,
            None if self._config.start == 0.0 else first,
            None if whole or self._config.end == 0.0 else last,
        )
        return by_stamp(source) if self._config.lockstep else source

    def _take(self) -> PlayedMessage | None:
        """Return the next message as it is sent, from the next repetition if need be."""
        try:
            message = next(self._source, None)
            if message is None and self._config.loop and self._last_log_time:
                self._repeat()
                message = next(self._source, None)
        except BagError as error:
            # What was played stands; the rest cannot be read.
            self._error = str(error)
            self.exit_code = 1
            return None
        if message is None:
            return None
        topic = self._topics[message.topic]
        message = message._replace(
            log_time=message.log_time + self._log_shift, stamp=message.stamp + self._stamp_shift
        )
        if self._stamp_shift and topic.stamped:
            message = message._replace(payload=restamped(message.payload, self._stamp_shift))
        self._last_log_time = max(self._last_log_time, message.log_time)
        if message.topic in self._timing:
            if self._first_stamp is None:
                self._first_stamp = message.stamp
            elif message.stamp > self._last_stamp:
                self._step = message.stamp - self._last_stamp
            self._last_stamp = max(self._last_stamp, message.stamp)
        return message

    def _repeat(self) -> None:
        self._repetition += 1
        self._log_shift = self._last_log_time + self._step - self._span[0]
        if self._config.restamp and self._first_stamp is not None:
            self._stamp_shift = self._last_stamp + self._step - self._first_stamp
            how = f'stamps moved on by {self._stamp_shift / SECOND:.3f} s'
        else:
            how = 'with the recorded stamps, which readers drop as not newer'
        self.node.get_logger().info(f'repetition {self._repetition}, {how}')
        self._source = self._open()

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
        while (message := self._next) is not None:
            if stamp is None and message.topic in self._timing:
                stamp = self._tick_of(message.stamp)
            if stamp is not None and message.stamp > stamp:
                break
            batch.append(message)
            self._next = self._take()
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
        due = self._span[0] + int((now - self._started) * self._config.rate * SECOND)
        for _ in range(BATCH):
            message = self._next
            if message is None:
                self._finish()
                return
            if message.log_time > due:
                break
            if message.topic in self._timing:
                if message.stamp != self._machine_time:
                    self._send_clock(message.stamp)
                    self._clock_sent = now
                self._machine_time, self._machine_time_at = message.stamp, message.log_time
            self._send(message)
            self._next = self._take()
        self._keep_time(now, due)

    def _ready(self, now: float) -> bool:
        """Whether the readers have found the topics; one that cannot match is not waited for."""
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
        if self._next is not None and self._next.topic in self._timing:
            stamp = min(stamp, self._next.stamp)
        self._send_clock(max(stamp, self._machine_time))

    # The end

    def _finish(self) -> None:
        """Wait until the readers have everything, and say how it went."""
        timeout = Duration(seconds=ACKNOWLEDGE_TIMEOUT)
        heard = all(item.wait_for_all_acked(timeout) for item in self._publishers.values())
        if not heard:
            self.node.get_logger().warning('some readers did not acknowledge the last messages')
        if self._error:
            print(f'error: {self._error}', file=sys.stderr, flush=True)
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
        stop = self._span[1]
        position = stop if self._next is None else self._next.log_time - self._log_shift
        values = {
            'messages': str(self._sent),
            'repetition': str(self._repetition),
            'rate': 'lock-step' if self._config.lockstep else f'{self._config.rate:g}',
        }
        text = f'at {self._seconds(position):.1f} of {self._seconds(stop):.1f} s'
        health = [Health('playback', Level.OK, text, values)]
        if self._sequencer is not None and self._sequencer.waiting_for:
            text = f'waiting for {", ".join(self._sequencer.waiting_for)}'
            health.append(Health('lock-step', Level.WARN, text))
        self._diagnostics.publish(
            diagnostic_array(
                self.node.get_fully_qualified_name(),
                '',
                health,
                {},
                self.node.get_clock().now().to_msg(),
            )
        )


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
