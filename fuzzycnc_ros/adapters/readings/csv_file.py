# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Driver: plays a CSV file."""

import time
from pathlib import Path

import numpy as np
from rclpy.node import Node

from fuzzycnc_ros.adapters.readings.source import Readings, Source
from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisitionConfig
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.records import SECOND

FIRST_STAMP = SECOND
"""Earliest stamp that a file's readings get [ns]: stamp 0 means unknown in messages."""


class CsvFile(Source):
    """Play a CSV file: a time column in seconds, or of dates, and one column per sensor in degC.

    At the rate of 1 on the wall clock the first row is read now, so that the nodes beside this one
    take the readings for fresh.  At another rate, or where time is simulated, readings carry the
    times of the file, moved so that the first is at least 1 s.  An empty cell is a missing
    reading.  Dates that name no zone are of the zone of this computer, which the environment
    variable TZ changes.  The whole file is read and checked at once.

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
            # Costs a second of start-up
            from fuzzycnc_ros.bags.csv_table import read_sensor_table

            sensors, seconds, self._values, zone = read_sensor_table(self._path, config.csv_time)
        except BagError as error:
            raise ParameterError(f'parameter csv_file: {error}') from error
        if zone:
            node.get_logger().info(f'{self._path}: times that name no zone read as {zone}')
        self._stamps = np.rint(seconds * SECOND).astype(np.int64)
        simulated = bool(node.get_parameter('use_sim_time').value)
        self.makes_time = simulated or config.csv_rate != 1.0
        self._stamps += max(0, FIRST_STAMP - int(self._stamps[0]))
        self._readings = Readings(node, sensors, frame_id)
        self._rate = config.csv_rate
        self._row = 0
        self._started: int | None = None
        step = float(np.median(np.diff(seconds))) / self._rate
        period = min(max(step / 2.0, 0.002), 0.1)
        # Wall time: the file itself makes machine time, no clock does.
        self._timer = wall_timer(node, period, self._play)

    def health(self) -> list[Health]:
        """Report which row is played, and whose time its stamps are."""
        values = {'row': str(self._row), 'rows': str(len(self._stamps))}
        if self._started is None:
            return [Health('csv_file', Level.OK, 'waiting for a reader', values)]
        whose = 'times of the file, at csv_rate 1 of the wall clock' if self.makes_time else 'now'
        return [Health('csv_file', Level.OK, f'stamped with {whose}', values)]

    def _play(self) -> None:
        """Publish the rows that are due."""
        if self._started is None:
            if not self._readings.heard:
                return
            self._started = time.monotonic_ns()
            if not self.makes_time:
                self._stamps += self._node.get_clock().now().nanoseconds - self._stamps[0]
        elapsed = int((time.monotonic_ns() - self._started) * self._rate)
        due = int(self._stamps[0]) + elapsed
        while self._row < len(self._stamps) and self._stamps[self._row] <= due:
            self._readings.publish(int(self._stamps[self._row]), self._values[self._row])
            self._row += 1
        if self._row == len(self._stamps):
            self._timer.cancel()
            self._node.get_logger().info(f'{self._path}: end of file after {self._row} rows')
