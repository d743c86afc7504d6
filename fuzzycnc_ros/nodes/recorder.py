# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Node `recorder`: undecoded bytes of any topics into an MCAP bag.

The callback only queues; a thread writes.  In a lock-step run the recorder takes a turn every
500 ticks, which holds the run up until everything published so far has reached it.
"""

import re
import struct
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from fuzzycnc_ros.bags.errors import BagError, BagWriteError
from fuzzycnc_ros.bags.holes import HoleCounter, not_explained
from fuzzycnc_ros.bags.metadata import Qos
from fuzzycnc_ros.bags.recorder import PENDING_MAX, Progress, RecordingThread
from fuzzycnc_ros.bags.shipping import Shipper
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.core.names import text_hash, visible
from fuzzycnc_ros.files.uninterrupted import Interrupted, uninterrupted
from fuzzycnc_ros.ros import run
from fuzzycnc_ros.ros.bag_node import bag_refused, check_keeping, closed_on_failure, pattern
from fuzzycnc_ros.ros.clocks import LogClock, SteadyClock, wall_timer
from fuzzycnc_ros.ros.configured_node import ConfiguredNode
from fuzzycnc_ros.ros.executor import hand_over
from fuzzycnc_ros.ros.node_config import RecorderConfig
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.ros.run import tell_error
from fuzzycnc_ros.ros.topics import (
    RCLPY,
    create_publisher,
    create_subscription,
    message_class,
    routes_matched,
)
from fuzzycnc_ros.ros.turn_taker import TurnTaker
from fuzzycnc_ros.runtime.component import STREAM, Health, Level
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.host import NodeConfiguration, RecorderProgress
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Displacement,
    MachineState,
    Temperatures,
)

DEPTH = 5000
"""Depth of the subscription: messages held while the process is stopped."""
DISCOVERY_PERIOD = 0.2
"""Wall time [s] between two looks for new topics."""
_NAMED = 3
"""Topics that are named at most."""
_STATE = 'machine_state'
_SAMPLED = (Temperatures.TYPE, Displacement.TYPE, MachineState.TYPE)
"""Types of what is sampled evenly; the last one tells how machine time went on."""
BEHIND = 5.0
"""Wall time [s] that a message may wait for the disk; one that keeps up takes it within 1 s."""
LOOK, QUIET, LOOKS_MAX = 0.05, 2, 40
"""Wall time [s] between two looks, at the end, at what comes; looks in a row without anything that
was published before; and the most looks, so that time in which the process stood still is none."""
RECORDER_PATIENCE = 25.0
"""Wall time [s] a turn waits for announced messages; below the sequencer's own timeout."""


class RecorderNode(ConfiguredNode[RecorderConfig]):
    """Record every matching topic as it appears."""

    def __init__(self, node: Node) -> None:
        super().__init__(node, RecorderConfig)
        config = self._config
        if not config.output:
            raise ParameterError('parameter output: expected the directory of a new bag')
        check_keeping(config)
        own = f'^({re.escape(node.get_namespace().rstrip("/"))}/|/clock$|/diagnostics$)'
        self._include = pattern('topics', config.topics or own)
        self._exclude = pattern('exclude', config.exclude)
        self._subscriptions: dict[str, Any] = {}
        self._skipped: dict[str, str] = {}
        self._newest = 0
        self._ending, self._older_came = 0, False
        self._clock: LogClock | None = None
        if not (config.lockstep or node.get_parameter('use_sim_time').value):
            self._clock = LogClock(SteadyClock(self._clock_now))
        self._models: set[str] = set()
        self._holes: dict[str, HoleCounter] = {}
        self._publishers: dict[str, int] = {}  # of each topic, at the last look
        self._left: Counter[str] = Counter()  # publishers that ended, by topic
        self._seen: dict[str, frozenset[str]] = {}  # nodes that published, by topic
        with bag_refused():
            writer = BagWriter(
                config.output,
                split_size=config.split_size,
                split_duration=config.split_duration,
            )
            self._thread = RecordingThread(
                writer,
                free_min=config.free_min,
                budget=config.budget,
                shipper=Shipper(config.ship, Path(config.output)) if config.ship else None,
                facts=self._facts,
            )
        with closed_on_failure(self._thread):
            self._connect(config)

    def _connect(self, config: RecorderConfig) -> None:
        """Create the endpoints; from here on messages come in."""
        node = self.node
        self._progress = create_publisher(node, RecorderProgress.TYPE, 'recorder/progress', STREAM)
        self.turns: TurnTaker | None = None
        if config.lockstep:
            self.turns = TurnTaker(
                node,
                self._on_turn,
                lambda: None,
                reads=lambda: tuple(self._subscriptions),
                writes=(),
                matched=self._matched,
                patience=RECORDER_PATIENCE,
            )
        self._discover()
        wall_timer(node, DISCOVERY_PERIOD, self._discover)
        wall_timer(node, 1.0, self._report)

    @property
    def done(self) -> bool:
        """True if the disk refuses to take any more."""
        if self._thread.failed:
            self.exit_code = 1
            return True
        return False

    def start(self) -> None:
        """Say where the bag is."""
        self.node.get_logger().info(f'recording to {self._config.output}')

    def stop(self) -> None:
        """Write what has arrived, close the bag and say what is in it.

        Who asks a second time waits as well: what is torn here would be lost.
        """
        with suppress(Interrupted), uninterrupted():
            self._end()

    def _end(self) -> None:
        self.turns = None  # there is nobody to answer any more
        self._take_the_rest()
        self._look_who_left()
        self._look_who_publishes()
        facts = self._facts()
        try:
            progress = self._thread.close(facts)
        except BagError as error:
            self._tell_notices()
            tell_error(error)
            self.exit_code = 1
        else:
            self._tell_notices()
            print(
                f'{visible(self._config.output)}: {progress.written} messages on '
                f'{len(progress.topics)} topics, {progress.lost} lost'
                + (f'; deleted: {progress.deleted}' if progress.deleted else '')
                + ''.join(
                    f', {hole["count"]} holes in {topic}' for topic, hole in facts['holes'].items()
                )
                + _told_left(self._left),
                flush=True,
            )

    def _take_the_rest(self) -> None:
        """Take what was published before the recorder was asked to end: it belongs into the bag.

        Threads of the middleware bring it, and on a busy computer these are late.
        """
        self._ending = time.time_ns()
        quiet = 0
        for _ in range(LOOKS_MAX):
            time.sleep(LOOK)
            self._older_came = False
            for subscription in tuple(self._subscriptions.values()):
                hand_over(subscription, DEPTH)
            quiet = 0 if self._older_came else quiet + 1
            if quiet == QUIET:
                break

    def _facts(self) -> dict[str, Any]:
        """Return what the bag says beside the counts of its messages."""
        return {
            'holes': self._found_holes(),
            'publishers': {topic: sorted(nodes) for topic, nodes in tuple(self._seen.items())},
            'publishers_left': dict(self._left),
        }

    def _look_who_left(self) -> None:
        """Count publishers that have ended; in lock-step turns see to it that all has come."""
        if self._config.lockstep:
            return
        for topic, subscription in self._subscriptions.items():
            count = int(subscription.get_publisher_count())
            if gone := max(0, self._publishers.get(topic, 0) - count):
                self._left[topic] += gone
            self._publishers[topic] = count

    def _look_who_publishes(self) -> None:
        """Note the nodes behind each topic, so that a replay knows what others wrote."""
        for topic, subscription in self._subscriptions.items():
            if int(subscription.get_publisher_count()) != len(self._seen[topic]):
                self._seen[topic] |= _nodes(self.node.get_publishers_info_by_topic(topic))

    def _wanted(self, topic: str) -> bool:
        return bool(self._include.search(topic)) and not self._exclude.search(topic)

    def _discover(self) -> None:
        self._look_who_left()
        for topic, types in self.node.get_topic_names_and_types():
            if topic in self._subscriptions or topic in self._skipped or not self._wanted(topic):
                continue
            publishers = self.node.get_publishers_info_by_topic(topic)
            if publishers:
                self._subscribe(topic, types, publishers)

    def _subscribe(self, topic: str, types: list[str], publishers: list[Any]) -> None:
        if len(types) > 1:
            self._skip(topic, f'has several types: {", ".join(types)}')
            return
        try:
            message_class(types[0])
        except (ImportError, AttributeError):
            self._skip(topic, f'its type {types[0]} is not installed here')
            return
        # The weakest offer decides: a reader that asks for more than a writer offers gets nothing.
        offers = [item.qos_profile for item in publishers]
        latched = all(o.durability is DurabilityPolicy.TRANSIENT_LOCAL for o in offers)
        reliable = all(o.reliability is ReliabilityPolicy.RELIABLE for o in offers)
        qos = Qos(
            depth=1 if latched else DEPTH,
            reliability='reliable' if reliable else 'best_effort',
            durability='transient_local' if latched else 'volatile',
        )

        def heard() -> int:
            own = self._subscriptions.get(topic)
            return 0 if own is None else int(own.get_publisher_count())

        try:
            self._thread.add_topic(topic, types[0], qos, publishers=heard)
        except BagWriteError:
            return  # the disk is full: the end says so
        profile = QoSProfile(
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=(
                DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
            ),
        )
        stamped = types[0].startswith('fuzzycnc_msgs/') or types[0] == 'rosgraph_msgs/msg/Clock'
        configuration = types[0] == NodeConfiguration.TYPE
        if types[0] in _SAMPLED and not self._config.lockstep:
            self._holes[topic] = HoleCounter()

        def on_message(payload: bytes, info: Any) -> None:
            if not configuration:
                self._take(topic, payload, info, stamped)
                return
            message = deserialize_message(payload, message_class(NodeConfiguration.TYPE))
            # All nodes share this topic: each has a newest configuration.
            self._take(topic, payload, info, stamped, message.node)
            self._attach_model(message)

        self._seen[topic] = _nodes(publishers)
        self._subscriptions[topic] = create_subscription(
            self.node, types[0], topic, on_message, profile, raw=True
        )

    def _skip(self, topic: str, reason: str) -> None:
        self._skipped[topic] = reason
        self.node.get_logger().warning(f'{topic} is not recorded: {reason}')

    def _take(
        self, topic: str, payload: bytes, info: Any, stamped: bool, sender: str | None = None
    ) -> None:
        sequence = info['publication_sequence_number']
        self._older_came |= info['source_timestamp'] < self._ending
        if not self._config.lockstep:
            self._newest = self._clock_now() if self._clock is None else self._clock.now()
        elif stamped:
            self._newest = max(self._newest, _leading_stamp(payload))
        if topic in self._holes:
            self._holes[topic].update(_leading_stamp(payload))
        # Before the first tick, or the first /clock, there is no time to log by.
        stamp = self._newest or None
        self._thread.put(topic, payload, stamp, stamp, sequence, sender)
        if self.turns is not None:
            self.turns.received(topic, sequence)

    def _clock_now(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def _found_holes(self) -> dict[str, dict[str, float]]:
        """Return the holes of each topic of samples: how many, and the longest, in seconds.

        In lock-step there are none.  Where machine time itself jumps nothing is lost.
        """
        found = {}
        for topic, counter in tuple(self._holes.items()):  # they come in another thread
            state = self._holes.get(f'{topic.rpartition("/")[0]}/{_STATE}')
            jumps = [] if state is None or state is counter else state.holes
            holes = not_explained(counter.holes, jumps)
            if holes and state is not counter:
                longest = max(holes, key=lambda hole: hole.stop - hole.start)
                found[topic] = {
                    'count': len(holes),
                    'longest_s': (longest.stop - longest.start) / SECOND,
                    'at_s': longest.start / SECOND,
                }
        return found

    def _attach_model(self, message: Any) -> None:
        """Keep each model that a node runs with beside the messages."""
        if not message.model or message.model_hash in self._models:
            return
        self._models.add(message.model_hash)
        digest = text_hash(message.model)
        with suppress(BagWriteError):  # the disk is full: the end says so
            self._thread.attach(f'{message.node}/model-{digest[:12]}.json', message.model)

    def _on_turn(self, stamp: int) -> None:
        """All that was announced has come: say how far the bag is."""
        self._publish_progress(self._thread.progress(), stamp)

    def _matched(self, readers: Mapping[str, int]) -> bool:
        self._discover()
        missing = [t for t in readers if self._wanted(t) and t not in self._subscriptions]
        return not missing and routes_matched(self.node, self._subscriptions.values(), (), readers)

    def _publish_progress(self, progress: Progress, stamp: int) -> None:
        record = RecorderProgress(
            stamp=stamp,
            received=progress.received,
            written=progress.written,
            lost=progress.lost,
        )
        self._progress.publish(encode(record, RCLPY))

    def _report(self) -> None:
        self._look_who_publishes()
        progress = self._thread.progress()
        self._publish_progress(progress, self._newest or self._clock_now())
        self._tell_notices()
        values = {
            'bag': Path(self._config.output).name,
            'received': str(progress.received),
            'written': str(progress.written),
            'lost': str(progress.lost),
            'parts': str(progress.parts),
        }
        level = Level.WARN if progress.lost else Level.OK
        text = f'{progress.written} messages on {len(progress.topics)} topics'
        if progress.lost:
            text += f', {progress.lost} lost'
        health = [Health('bag', level, text, values)]
        if progress.paused:
            health.append(Health('disk', Level.ERROR, progress.paused))
        if progress.behind > BEHIND and progress.untimed:
            text = (
                f'{progress.untimed} messages, {progress.pending_bytes / 1e6:.3g} of '
                f'{PENDING_MAX / 1e6:.3g} MB, wait in memory for the first machine time; start '
                'the simulation or the player that publishes /clock, or set use_sim_time to false'
            )
            health.append(Health('clock', Level.WARN, text))
        elif progress.behind > BEHIND and not progress.paused:
            text = (
                f'too slow for what comes: {progress.pending} messages, the oldest for '
                f'{progress.behind:.0f} s, wait in memory, {progress.pending_bytes / 1e6:.3g} of '
                f'{PENDING_MAX / 1e6:.3g} MB; a kill loses them; record to a faster disk'
            )
            health.append(Health('disk', Level.WARN, text))
        if progress.waiting:
            health.append(Health('ship', Level.WARN, progress.waiting))
        if progress.deleted:
            health.append(Health('budget', Level.OK, f'deleted: {progress.deleted}'))
        health += [Health(topic, Level.WARN, text) for topic, text in self._skipped.items()]
        self._publish_health(health)

    def _tell_notices(self) -> None:
        """Log what happened to the bag."""
        logger = self.node.get_logger()
        for urgent, text in self._thread.notices():
            if urgent:
                logger.error(text)
            else:
                logger.info(text)


def _nodes(publishers: Iterable[Any]) -> frozenset[str]:
    """Return the full names of the nodes of publishers; discovery tells some of them late."""
    known = (item for item in publishers if not item.node_name.startswith('_NODE_NAME_UNKNOWN'))
    return frozenset(f'{item.node_namespace.rstrip("/")}/{item.node_name}' for item in known)


def _told_left(left: Mapping[str, int]) -> str:
    """Return in words that publishers ended, whose last messages no number tells of."""
    if not left:
        return ''
    named = list(left)[:_NAMED]
    more = f' and {len(left) - _NAMED} more' if len(left) > _NAMED else ''
    return (
        f'; {sum(left.values())} publishers ended meanwhile, on {", ".join(named)}{more}: '
        'messages of their last moment may be missing uncounted'
    )


def _leading_stamp(payload: bytes) -> int:
    """Return the time with which a stamped message begins [ns]."""
    order = '<' if payload[1] & 1 else '>'
    seconds, rest = struct.unpack_from(f'{order}iI', payload, 4)
    return int(seconds) * SECOND + int(rest)


def make() -> RecorderNode:
    """Create the node."""
    return RecorderNode(Node('recorder'))


def main() -> None:
    """Run the node until it is interrupted."""
    run.main(make)


if __name__ == '__main__':
    main()
