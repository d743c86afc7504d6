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

from fuzzycnc_ros.components.temperature_acquisition import TemperatureAcquisitionConfig
from fuzzycnc_ros.convert import stamp_of
from fuzzycnc_ros.nodes.parameters import ParameterError
from fuzzycnc_ros.nodes.qos import SUBSCRIPTION_DEPTH
from fuzzycnc_ros.nodes.sources.source import Readings, Source


class TemperatureTopics(Source):
    """Gather `sensor_msgs/Temperature` topics into one set of readings.

    A set is complete when every sensor has a message newer than the set before, so that sets
    stay in step also after a message was lost; clocks of the sensors must agree to within the
    time between two of their messages.  A sensor that is slow or dead does not hold up the
    others: after `reading_period` of the node's clock a set goes without it, and it counts as
    missing there.  The stamp is that of the newest message.

    Raises
    ------
    ParameterError
        If `temperature_topics` is empty, no list of name=topic, or names a sensor twice.
    """

    def __init__(self, node: Node, config: TemperatureAcquisitionConfig, frame_id: str) -> None:
        topics = _named_topics(config.temperature_topics)
        self._readings = Readings(node, list(topics), frame_id)
        self._index = {name: index for index, name in enumerate(topics)}
        self._value = np.full(len(topics), np.nan)
        self._stamp = np.zeros(len(topics), np.int64)
        self._sent = 0
        # Sensor drivers often publish best effort; this asks for no more than they offer.
        qos = QoSProfile(depth=SUBSCRIPTION_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        for name, topic in topics.items():
            node.create_subscription(Temperature, topic, self._handler(name), qos)
        self._timer = node.create_timer(config.reading_period, self._send)

    def _handler(self, name: str) -> Any:
        index = self._index[name]

        def on_temperature(message: Temperature) -> None:
            stamp = stamp_of(message.header.stamp)
            if stamp <= self._stamp[index]:
                return
            self._stamp[index] = stamp
            self._value[index] = message.temperature
            if np.all(self._stamp > self._sent):
                self._timer.reset()
                self._send()

        return on_temperature

    def _send(self) -> None:
        """Publish what is newer than the last set, if anything is."""
        fresh = self._stamp > self._sent
        if not fresh.any():
            return
        self._sent = int(self._stamp.max())
        self._readings.publish(self._sent, np.where(fresh, self._value, np.nan))


def _named_topics(items: Sequence[str]) -> dict[str, str]:
    """Return sensor name to topic."""
    pairs = [tuple(part.strip() for part in item.partition('=')) for item in items]
    wrong = [item for item, pair in zip(items, pairs, strict=True) if not (pair[0] and pair[2])]
    if wrong or not pairs:
        raise ParameterError(
            'parameter temperature_topics: expected name=topic, for example '
            f'T1=/plc/bearing, but found {", ".join(map(repr, wrong)) or "none"}'
        )
    for what, place in (('sensor', 0), ('topic', 2)):
        repeated = [name for name, n in Counter(pair[place] for pair in pairs).items() if n > 1]
        if repeated:
            raise ParameterError(
                f'parameter temperature_topics: expected each {what} once but found '
                f'{", ".join(repeated)} more than once'
            )
    return {name: topic for name, _, topic in pairs}
