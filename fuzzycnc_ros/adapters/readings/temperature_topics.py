# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Driver: gathers `sensor_msgs/Temperature` topics into sets of readings."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Temperature

from fuzzycnc_ros.adapters.readings.source import Readings, Source
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisitionConfig
from fuzzycnc_ros.ros.clocks import stamp_ahead_max
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.ros.topics import SUBSCRIPTION_DEPTH
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.convert import stamp_of

UNUSED = {
    'without a stamp': 'have its driver fill in header.stamp',
    'stamped ahead of the clock': 'compare the clocks, and stamp_ahead_max',
    'not newer than the last': 'compare the clocks, and have one publisher stamp each anew',
}
"""Why a reading is not used, and the remedy."""
UNSTAMPED, AHEAD, OLD = UNUSED


class TemperatureTopics(Source):
    """Gather `sensor_msgs/Temperature` topics into one set of readings.

    A set is complete when every sensor has a message newer than the set before, so that sets
    stay in step also after a message was lost; clocks of the sensors must agree to within the
    time between two of their messages.  A sensor that is slow or dead does not hold up the
    others: after `reading_period` of the node's clock a set goes without it, and it counts as
    missing there.  The stamp is that of the newest message.  A message without a stamp is not
    used, nor one that is stamped ahead of the clock: all others would be old after it.  A value
    that is no number is a sensor that is missing; a variance is not looked at.  Of a topic that
    several sensors share, `@` and a frame id choose the messages of one.

    Raises
    ------
    ParameterError
        If `temperature_topics` is empty, no list of name=topic, or names a sensor twice.
    """

    def __init__(self, node: Node, config: TemperatureAcquisitionConfig, frame_id: str) -> None:
        topics = _named_topics(config.temperature_topics)
        self._node, self._topics = node, topics
        self._ahead_max = stamp_ahead_max(node)
        self._counts: dict[str, Counter[str]] = {name: Counter() for name in topics}
        self._readings = Readings(node, list(topics), frame_id)
        self._index = {name: index for index, name in enumerate(topics)}
        self._value = np.full(len(topics), np.nan)
        self._stamp = np.zeros(len(topics), np.int64)
        self._sent = 0
        # Sensor drivers often publish best effort; this asks for no more than they offer.
        qos = QoSProfile(depth=SUBSCRIPTION_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        for name, source in topics.items():
            topic, _, frame = source.partition('@')
            node.create_subscription(Temperature, topic, self._handler(name, frame), qos)
        self._timer = node.create_timer(config.reading_period, self._send)

    def health(self) -> list[Health]:
        """Report on each topic: what came, and what of it is not used."""
        return [topic_health(topic, self._counts[name]) for name, topic in self._topics.items()]

    def _handler(self, name: str, frame: str) -> Any:
        index = self._index[name]

        def on_temperature(message: Temperature) -> None:
            if frame and message.header.frame_id != frame:
                return  # of another sensor on the same topic
            stamp = stamp_of(message.header.stamp)
            trouble = self._trouble(stamp, int(self._stamp[index]))
            self._counts[name][trouble] += 1
            if trouble:
                return
            self._stamp[index] = stamp
            self._value[index] = message.temperature
            if np.all(self._stamp > self._sent):
                self._timer.reset()
                self._send()

        return on_temperature

    def _trouble(self, stamp: int, last: int) -> str:
        """Return why a reading is not used; empty if it is."""
        now = int(self._node.get_clock().now().nanoseconds)
        if stamp <= 0:
            return UNSTAMPED
        if now and self._ahead_max and stamp > now + self._ahead_max:
            return AHEAD
        return OLD if stamp <= last else ''

    def _send(self) -> None:
        """Publish what is newer than the last set, if anything is."""
        fresh = self._stamp > self._sent
        if not fresh.any():
            return
        self._sent = int(self._stamp.max())
        self._readings.publish(self._sent, np.where(fresh, self._value, np.nan))


def topic_health(topic: str, counts: Counter[str]) -> Health:
    """Return a line on a topic; `counts` holds readings by trouble, empty for those used."""
    name, received = f'topic {topic}', counts.total()
    values = {'received': str(received), **{kind: str(counts[kind]) for kind in UNUSED}}
    if not received:
        return Health(name, Level.WARN, 'nothing received yet', values)
    unused = [f'{counts[kind]} {kind}: {UNUSED[kind]}' for kind in UNUSED if counts[kind]]
    if unused:
        text = f'not used of {received} readings: {"; ".join(unused)}'
        return Health(name, Level.WARN, text, values)
    return Health(name, Level.OK, 'all readings used', values)


def _named_topics(items: Sequence[str]) -> dict[str, str]:
    """Return sensor name to topic, with `@` and the frame id if it is shared."""
    pairs = [tuple(part.strip() for part in item.partition('=')) for item in items]
    wrong = [
        item
        for item, pair in zip(items, pairs, strict=True)
        if not (pair[0] and pair[2].partition('@')[0]) or pair[2].endswith('@')
    ]
    if wrong or not pairs:
        raise ParameterError(
            'parameter temperature_topics: expected name=topic, for example T1=/plc/bearing, or '
            f'name=topic@frame_id, but found {", ".join(map(repr, wrong)) or "none"}'
        )
    for what, place in (('sensor', 0), ('topic', 2)):
        repeated = [name for name, n in Counter(pair[place] for pair in pairs).items() if n > 1]
        if repeated:
            raise ParameterError(
                f'parameter temperature_topics: expected each {what} once but found '
                f'{", ".join(repeated)} more than once'
            )
    return {name: topic for name, _, topic in pairs}
