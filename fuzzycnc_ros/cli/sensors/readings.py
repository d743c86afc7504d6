# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Readings of sensors for a command: of a recording, or of devices without any node."""

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Empty
from typing import TYPE_CHECKING

import numpy as np

from fuzzycnc_ros.bags.csv_table import read_sensor_table
from fuzzycnc_ros.bags.runs import read_temperatures
from fuzzycnc_ros.cli.console import check_ros
from fuzzycnc_ros.runtime.records import SECOND, Floats

if TYPE_CHECKING:
    from fuzzycnc_ros.adapters.readings.devices import Device
    from fuzzycnc_ros.adapters.readings.link import Reading
    from fuzzycnc_ros.adapters.readings.polling import Polled

LOOK = 0.1
"""Wall time between two looks at what devices brought [s]."""


@dataclass(frozen=True)
class Recorded:
    """Temperatures of sensors.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Times [s].
    temperature : ndarray, shape (n, k)
        Readings [degC], NaN where there is none.
    sensor : tuple of str
        Names of the sensors.
    speed : ndarray, shape (n,), optional
        Spindle speed [rad/s].
    offset : dict
        Offsets of the device file, where there is one.
    """

    time: Floats
    temperature: Floats
    sensor: tuple[str, ...]
    speed: Floats | None = None
    offset: dict[str, float] = field(default_factory=dict)

    def without(self, names: Collection[str]) -> 'Recorded':
        """Return it without some sensors.

        Raises
        ------
        ValueError
            If one of them is not there.
        """
        unknown = sorted(set(names) - set(self.sensor))
        if unknown:
            raise ValueError(
                f'--drop-sensor: expected some of {", ".join(self.sensor)} but found '
                f'{", ".join(unknown)}'
            )
        keep = [place for place, name in enumerate(self.sensor) if name not in names]
        return replace(
            self,
            temperature=self.temperature[:, keep],
            sensor=tuple(self.sensor[place] for place in keep),
        )


def read_recording(path: Path, time_column: str) -> Recorded:
    """Return what a bag or a table holds.

    Raises
    ------
    BagError
        If it cannot be read.
    """
    if path.is_dir() or path.suffix == '.mcap':
        seconds, sensor, temperature, speed = read_temperatures(path)
        return Recorded(seconds, temperature, sensor, speed)
    sensor, seconds, temperature, _ = read_sensor_table(path, time_column)
    return Recorded(seconds - seconds[0], temperature, sensor)


class _Reading:
    """Devices of a file, read until it is closed."""

    def __init__(self, path: Path) -> None:
        check_ros('reading devices')
        from fuzzycnc_ros.adapters.readings.device_file import read_devices
        from fuzzycnc_ros.adapters.readings.polling import Poller

        self.devices: tuple[Device, ...] = read_devices(path)
        for device in self.devices:
            device.check()
        self.poller = Poller(self.devices, time.monotonic_ns)

    def __enter__(self) -> '_Reading':
        return self

    def __exit__(self, *error: object) -> None:
        self.poller.close()

    def next(self) -> 'Polled | None':
        """Return what a device has brought, None if nothing came for a while."""
        try:
            return self.poller.results.get(timeout=LOOK)
        except Empty:
            return None


def read_once(path: Path) -> 'dict[str, Reading]':
    """Return the first reading of each sensor, or why there is none."""
    from fuzzycnc_ros.adapters.readings.polling import BACK_OFF_MAX

    with _Reading(path) as reading:
        found: dict[str, Reading] = {}
        waits = {index for index, device in enumerate(reading.devices) if device.sensors}
        # A second try: a device may still be held by whoever let go of it just now.
        longest = max(device.timeout for device in reading.devices)
        end = time.monotonic() + 2.0 * longest + BACK_OFF_MAX
        while waits and time.monotonic() < end:
            polled = reading.next()
            if polled is None or polled.device not in waits:
                continue
            device = reading.devices[polled.device]
            trouble = f'{device.address}: {polled.trouble}'
            readings = polled.readings or [trouble] * len(device.sensors)
            found |= dict(zip(device.sensors, readings, strict=False))
            if polled.readings is not None:
                waits.discard(polled.device)
        names = [name for device in reading.devices for name in device.sensors]
        return {name: found.get(name, 'no answer yet') for name in names}


def read_for(path: Path, duration: float, tell: Callable[[str, int, int], None]) -> Recorded:
    """Return what the devices of a file read for a while [s]."""
    from fuzzycnc_ros.adapters.readings.reading_sets import ReadingSets

    with _Reading(path) as reading:
        measuring = [i for i, device in enumerate(reading.devices) if device.sensors]
        chosen = [reading.devices[index] for index in measuring]
        sets = ReadingSets([len(d.sensors) for d in chosen], max(d.period for d in chosen))
        rows: list[tuple[int, Floats]] = []
        begin = time.monotonic()
        while (passed := time.monotonic() - begin) < duration:
            tell('reading', int(passed), int(duration))
            polled = reading.next()
            if polled is not None and polled.device in measuring:
                place = measuring.index(polled.device)
                if polled.readings is None:
                    sets.lose(place)
                else:
                    values = polled.readings[: len(chosen[place].sensors)]
                    numbers = [np.nan if isinstance(v, str) else v for v in values]
                    sets.take(place, polled.stamp, np.array(numbers))
            complete = sets.complete(time.monotonic_ns())
            if complete is not None:
                rows.append(complete)
    channels = [channel for device in chosen for channel in device.channels]
    names = tuple(name for device in chosen for name in device.sensors)
    stamps = np.array([stamp for stamp, _ in rows], np.int64)
    return Recorded(
        (stamps - stamps[0]) / SECOND if len(rows) else np.zeros(0),
        np.array([values for _, values in rows]).reshape(len(rows), len(names)),
        names,
        offset={channel.name: channel.offset for channel in channels if channel.name in names},
    )
