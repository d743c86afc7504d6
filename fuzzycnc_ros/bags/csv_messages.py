# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of an imported recording."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.csv_mapping import CsvMapping
from fuzzycnc_ros.bags.typestore import message_type

_STATUS_OK, _STATUS_MISSING = 0, 1  # Temperatures.msg
_STATE_ON, _STATE_RUNNING = 2, 3  # MachineState.msg


class Messages:
    """Makes the messages of an imported recording."""

    def __init__(
        self, mapping: CsvMapping, sensors: list[str], channels: list[str], cold_since: int
    ) -> None:
        self._machine = mapping.machine
        self._sensors = sensors
        self._channels = channels
        self._axes = [channel.axis for channel in mapping.channels]
        self._unknown = np.full(len(channels), np.nan)
        self._cold_since = _time(cold_since)

    def temperatures(self, stamp: int, values: NDArray[np.float64], readings: int) -> Any:
        """Return a sample; a reading that the file lacks is missing."""
        return message_type('fuzzycnc_msgs/msg/Temperatures')(
            header=self._header(stamp, 'machine'),
            sensor=self._sensors,
            temperature=values,
            status=np.where(np.isnan(values), _STATUS_MISSING, _STATUS_OK).astype(np.uint8),
            readings=min(readings, 2**16 - 1),
        )

    def displacement(self, stamp: int, values: NDArray[np.float64]) -> Any:
        """Return measured displacements; how well they were measured no CSV file says."""
        return message_type('fuzzycnc_msgs/msg/Displacement')(
            header=self._header(stamp, 'workpiece'),
            axis=self._axes,
            channel=self._channels,
            displacement=values,
            standard_deviation=self._unknown,
            includes_compensation=False,
        )

    def machine_state(self, stamp: int, speed: float) -> Any:
        """Return the state as far as the spindle tells; a recording takes no offsets."""
        return message_type('fuzzycnc_msgs/msg/MachineState')(
            header=self._header(stamp, 'machine'),
            state=_STATE_RUNNING if abs(speed) > 0.0 else _STATE_ON,
            homed=False,
            offsets_allowed=False,
            cold_since=self._cold_since,
            spindle_speed=speed,
            axis=[],
            position=np.empty(0),
        )

    def reference(self, stamp: int, values: NDArray[np.float64]) -> Any:
        """Return the mean of the first samples, NaN for a sensor that lacks one of them."""
        return message_type('fuzzycnc_msgs/msg/ThermalReference')(
            header=self._header(stamp, 'machine'),
            cold_since=self._cold_since,
            set_by='recording',
            sensor=self._sensors,
            temperature=values.mean(axis=0),
            samples=min(len(values), 2**16 - 1),
        )

    def _header(self, stamp: int, frame: str) -> Any:
        return message_type('std_msgs/msg/Header')(
            stamp=_time(stamp), frame_id=f'{self._machine}/{frame}'
        )


def _time(stamp: int) -> Any:
    seconds, rest = divmod(stamp, 10**9)
    return message_type('builtin_interfaces/msg/Time')(sec=seconds, nanosec=rest)
