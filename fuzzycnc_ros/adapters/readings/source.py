# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Base of all drivers: their end, their health, and sets of raw readings."""

from collections.abc import Sequence

import numpy as np
from rclpy.node import Node

from fuzzycnc_ros.ros.topics import RCLPY, create_publisher
from fuzzycnc_ros.runtime.component import STREAM, Health
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.enums import Status
from fuzzycnc_ros.runtime.records import Floats, Temperatures

READINGS = 'sensor_readings'


class Source:
    """A driver; this one brings nothing: readings come on the topic by themselves.

    Attributes
    ----------
    makes_time : bool
        True if the stamps of its readings are the machine time of the node, not its clock.
    """

    makes_time = False

    @property
    def sensor_limits(self) -> tuple[str, ...]:
        """Limits of single sensors that what is read states, as the parameter of this name."""
        return ()

    def health(self) -> list[Health]:
        """Report on what the readings come from."""
        return []

    def close(self) -> None:
        """Release what the driver holds."""


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
        self._publisher = create_publisher(node, Temperatures.TYPE, READINGS, STREAM)

    @property
    def heard(self) -> bool:
        """True if the component reads them by now."""
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
