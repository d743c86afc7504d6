# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Drivers of `temperature_acquisition`: bring readings from elsewhere to `sensor_readings`.

A driver publishes raw readings on the topic that the component reads, so that a bag holds them
and a replay needs no driver.
"""

import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Temperature

from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.components.codes import Status
from fuzzycnc_ros.components.component import STREAM
from fuzzycnc_ros.components.records import (
    SECOND,
    Floats,
    Temperatures,
)
from fuzzycnc_ros.components.temperature_acquisition import TemperatureAcquisitionConfig
from fuzzycnc_ros.convert import encode, stamp_of
from fuzzycnc_ros.nodes.messages import RCLPY, message_class
from fuzzycnc_ros.nodes.parameters import ParameterError
from fuzzycnc_ros.nodes.qos import SUBSCRIPTION_DEPTH, publisher_qos
from fuzzycnc_ros.nodes.timers import wall_timer

READINGS = 'sensor_readings'
FIRST_STAMP = SECOND
"""Earliest stamp that a file's readings get [ns]: stamp 0 means unknown in messages."""


class Readings:
    """Publish sets of raw readings.

    Parameters
    ----------
    node : Node
        The node; readings go to its own namespace.
    sensors : sequence of str
        Names of the sensors.
    frame_id : str
        Frame id of the messages.
    """

    def __init__(self, node: Node, sensors: Sequence[str], frame_id: str) -> None:
        self._sensor = tuple(sensors)
        self._frame_id = frame_id
        self._publisher = node.create_publisher(
            message_class(Temperatures.TYPE), READINGS, publisher_qos(STREAM)
        )

    @property
    def heard(self) -> bool:
        """Whether the component reads them by now."""
        return int(self._publisher.get_subscription_count()) > 0

    def publish(self, stamp: int, temperature: Floats) -> None:
        """Publish one value per sensor [degC], NaN where there is none."""
        missing = ~np.isfinite(temperature)
        record = Temperatures(
            stamp=stamp,
            frame_id=self._frame_id,
            sensor=self._sensor,
            temperature=np.where(missing, np.nan, temperature),
            status=np.where(missing, int(Status.MISSING), int(Status.OK)).astype(np.uint8),
            readings=1,
        )
        self._publisher.publish(encode(record, RCLPY))


class TemperatureTopics:
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


class CsvFile:
    """Play a CSV file: a time column in seconds and one column per sensor in degC.

    Readings carry the times of the file, moved so that the first is at least 1 s; an empty cell
    is a missing reading.  The whole file is read and checked at once.

    Raises
    ------
    ParameterError
        If the file cannot be used; the text names file, line and column.
    """

    def __init__(self, node: Node, config: TemperatureAcquisitionConfig, frame_id: str) -> None:
        if not config.csv_file:
            raise ParameterError('parameter csv_file: expected a CSV file for the source csv')
        self._node = node
        self._path = Path(config.csv_file).expanduser()
        try:
            sensors, seconds, self._values = _read(self._path, config.csv_time)
        except BagError as error:
            raise ParameterError(f'parameter csv_file: {error}') from error
        self._stamps = np.rint(seconds * SECOND).astype(np.int64)
        self._stamps += max(0, FIRST_STAMP - int(self._stamps[0]))
        self._readings = Readings(node, sensors, frame_id)
        self._rate = config.csv_rate
        self._row = 0
        self._started: int | None = None
        step = float(np.median(np.diff(seconds))) / self._rate
        period = min(max(step / 2.0, 0.002), 0.1)
        # Wall time: the file itself makes machine time, no clock does.
        self._timer = wall_timer(node, period, self._play)

    def _play(self) -> None:
        """Publish the rows that are due."""
        if self._started is None:
            if not self._readings.heard:
                return
            self._started = time.monotonic_ns()
        elapsed = (time.monotonic_ns() - self._started) * self._rate
        due = int(self._stamps[0] + elapsed)
        while self._row < len(self._stamps) and self._stamps[self._row] <= due:
            self._readings.publish(int(self._stamps[self._row]), self._values[self._row])
            self._row += 1
        if self._row == len(self._stamps):
            self._timer.cancel()
            self._node.get_logger().info(f'{self._path}: end of file after {self._row} rows')


def open_source(node: Node, config: TemperatureAcquisitionConfig, frame_id: str) -> Any:
    """Return the driver that a configuration asks for; None where readings come on a topic."""
    if config.source == 'temperature_topics':
        return TemperatureTopics(node, config, frame_id)
    if config.source == 'csv':
        return CsvFile(node, config, frame_id)
    return None


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


def _read(path: Path, time_column: str) -> tuple[list[str], Floats, Floats]:
    """Return sensor names, times [s] and temperatures [degC] of a file."""
    from fuzzycnc_ros.bags.csv_mapping import CsvMapping  # costs a second of start-up
    from fuzzycnc_ros.bags.csv_table import read_table

    table = read_table(path, CsvMapping(time=time_column))
    table.require([time_column])
    sensors = [name for name in table.header if name != time_column]
    if not sensors:
        raise BagError(f'{path}: expected a column for each sensor beside {time_column!r}')
    table.time(time_column, 's')  # refuses what is missing or does not increase
    values = np.stack([table.column(name) for name in sensors], axis=1)
    return sensors, table.column(time_column), values
