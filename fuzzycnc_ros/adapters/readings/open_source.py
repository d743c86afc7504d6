# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Chooses the driver that a configuration asks for."""

from collections.abc import Callable, Mapping

from rclpy.node import Node

from fuzzycnc_ros.adapters.readings.csv_file import CsvFile
from fuzzycnc_ros.adapters.readings.device_source import DeviceSource
from fuzzycnc_ros.adapters.readings.source import Source
from fuzzycnc_ros.adapters.readings.temperature_topics import TemperatureTopics
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisitionConfig

SOURCES: Mapping[str, Callable[[Node, TemperatureAcquisitionConfig, str], Source]] = {
    'temperature_topics': TemperatureTopics,
    'csv': CsvFile,
    'devices': DeviceSource,
}


def open_source(node: Node, config: TemperatureAcquisitionConfig, frame_id: str) -> Source:
    """Return the driver that a configuration asks for.

    Raises
    ------
    ParameterError
        If what the driver needs is missing or wrong.
    """
    make = SOURCES.get(config.source)
    return Source() if make is None else make(node, config, frame_id)
