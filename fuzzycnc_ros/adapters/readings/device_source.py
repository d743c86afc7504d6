# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Driver: reads the devices of a file, whatever their protocols."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from queue import Empty

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from fuzzycnc_ros.adapters.readings.devices import SPINDLE, Device, DeviceChannel
from fuzzycnc_ros.adapters.readings.link import Reading
from fuzzycnc_ros.adapters.readings.polling import Polled, Poller
from fuzzycnc_ros.adapters.readings.reading_sets import ReadingSets
from fuzzycnc_ros.adapters.readings.source import Readings, Source
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisitionConfig
from fuzzycnc_ros.ros.clocks import wall_timer
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.ros.topics import RCLPY, create_publisher
from fuzzycnc_ros.runtime.component import STREAM, Health, Level
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.enums import SpeedStatus
from fuzzycnc_ros.runtime.records import SpindleSpeed

POSITIONS = 'axis_positions'
"""Topic of where axes are, as the devices say."""
LOOK_MIN, LOOK_MAX = 0.002, 0.1
"""Shortest and longest wall time between two looks at what the devices brought [s]."""
NAMED_MAX = 10
"""Most sensors that a line of the log names; /diagnostics names all."""


class DeviceSource(Source):
    """Read the devices of a file, each at its own pace, and publish sets of all their sensors.

    Raises
    ------
    ParameterError
        If the file cannot be used; the text names file, line and field.
    """

    def __init__(self, node: Node, config: TemperatureAcquisitionConfig, frame_id: str) -> None:
        if not config.device_file:
            raise ParameterError('parameter device_file: expected a file for the source devices')
        path = Path(config.device_file).expanduser()
        state_directory = str(node.get_parameter('state_directory').value)
        try:
            # Needs pydantic, which nobody else has to have.
            from fuzzycnc_ros.adapters.readings.device_file import read_devices

            self._devices = read_devices(path, state_directory)
            for device in self._devices:
                if device.period > config.interval:
                    raise ParameterError(
                        f'device {device.name}: period = {device.period:g} s is longer than the '
                        f'sampling interval = {config.interval:g} s; make interval at least '
                        'as long'
                    )
                device.check()
        except ParameterError as error:
            raise ParameterError(f'parameter device_file: {error}') from error
        self._node = node
        self._health = [DeviceHealth(device, config.interval) for device in self._devices]
        measuring = [i for i, device in enumerate(self._devices) if device.sensors]
        self._place = {index: place for place, index in enumerate(measuring)}
        chosen = [self._devices[index] for index in measuring]
        self._readings = Readings(node, [s for d in chosen for s in d.sensors], frame_id)
        self._sets = ReadingSets(
            [len(device.sensors) for device in chosen], max(device.period for device in chosen)
        )
        spindle = next((d.channels[-1] for d in self._devices if d.has_spindle), None)
        self._spindle = None if spindle is None else Spindle(node, frame_id, spindle)
        has_axes = any(device.axes for device in self._devices)
        self._positions = Positions(node, frame_id) if has_axes else None
        self._poller = Poller(self._devices, self._now)
        look = min(device.period for device in self._devices) / 2.0
        # Wall time: devices are read in real time, whatever the node's clock says.
        wall_timer(node, min(max(look, LOOK_MIN), LOOK_MAX), self._take)
        wall_timer(node, 1.0, self._tell)

    @property
    def sensor_limits(self) -> tuple[str, ...]:
        """Limits of single sensors that the file states, as the parameter of this name."""
        return tuple(
            f'{channel.name}:{limit}:{value:g}'
            for device in self._devices
            for channel in device.channels
            for limit, value in channel.limits
        )

    def health(self) -> list[Health]:
        """Report on each device, and on the spindle speed where a device has it."""
        items = [device.health() for device in self._health]
        return items if self._spindle is None else [*items, self._spindle.health()]

    def close(self) -> None:
        """End the connections."""
        self._poller.close()

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def _take(self) -> None:
        """Publish what the devices have brought."""
        while True:
            try:
                self._note(self._poller.results.get_nowait())
            except Empty:
                break
            self._publish()
        self._publish()

    def _note(self, polled: Polled) -> None:
        """Hand on what one device has brought."""
        device, health = self._devices[polled.device], self._health[polled.device]
        health.note(polled)
        # Of a lost device nothing is known.
        values = [_value(reading) for reading in polled.readings or ('',) * len(device.channels)]
        if device.has_spindle and self._spindle is not None:
            self._spindle.publish(polled.stamp, values.pop())
        if device.axes and self._positions is not None:
            first = len(device.sensors)
            self._positions.publish(polled.stamp, device.axes, values[first:])
            del values[first:]
        place = self._place.get(polled.device)
        if place is None:
            return
        if polled.readings is None:
            self._sets.lose(place)
        else:
            self._sets.take(place, polled.stamp, np.array(values))

    def _publish(self) -> None:
        complete = self._sets.complete(self._now())
        if complete is not None:
            self._readings.publish(*complete)

    def _tell(self) -> None:
        """Write into the log what has changed, at most once a second."""
        log = self._node.get_logger()
        for device in self._health:
            news = device.news()
            if news is None:
                continue
            # Two calls: rclpy lets no call change its severity.
            if news.level is Level.OK:
                log.info(f'{news.name}: {news.message}')
            else:
                log.warning(f'{news.name}: {news.message}')


class DeviceHealth:
    """Health of a device, for /diagnostics and the log.

    Parameters
    ----------
    device : Device
        The device.
    interval : float
        Sampling interval [s]; values may not be older than that unnoticed.
    """

    def __init__(self, device: Device, interval: float) -> None:
        self._device, self._interval = device, interval
        self._slow = ''
        self._lost: str | None = 'not connected yet'
        self._bad: dict[str, str] = {}
        self._facts: Mapping[str, str] = {}
        self._readings = self._losses = 0
        self._told: tuple[str | None, dict[str, str], bool] = (self._lost, {}, False)

    def note(self, polled: Polled) -> None:
        """Note what came of asking it once."""
        if polled.readings is None:
            self._losses += 1
            self._lost = polled.trouble
            return
        self._readings += 1
        self._lost = None
        self._facts = polled.facts
        self._slow = ''
        if polled.took > self._interval:
            self._slow = (
                f'an answer took {polled.took:.3g} s, longer than interval = {self._interval:g} '
                's, and its values may be as old; find out what holds the device up, or make '
                'interval longer'
            )
        self._bad = {
            channel.name: reading
            for channel, reading in zip(self._device.channels, polled.readings, strict=True)
            if isinstance(reading, str)
        }

    def health(self) -> Health:
        """Return a line on the device, with the trouble of each of its channels."""
        device = self._device
        name = f'device {device.name}'
        counts = {'readings': str(self._readings), 'failures': str(self._losses), **self._facts}
        if self._lost is not None:
            return Health(name, Level.ERROR, f'{device.address}: {self._lost}', counts)
        if self._slow and not self._bad:
            return Health(name, Level.WARN, f'{device.address}: {self._slow}', counts)
        if self._bad:
            shown = [f'{key}: {text}' for key, text in self._bad.items()][:NAMED_MAX]
            more = len(self._bad) - len(shown)
            text = '; '.join([*shown, *([f'and {more} more'] if more else [])])
            return Health(name, Level.WARN, text, {**counts, **self._bad})
        return Health(name, Level.OK, f'{device.address}: all values read', counts)

    def news(self) -> Health | None:
        """Return the line on the device if its trouble is another than at the last call."""
        state = (self._lost, {} if self._lost is not None else self._bad, bool(self._slow))
        if state == self._told:
            return None
        self._told = state
        return self.health()


class Spindle:
    """Publish the spindle speed."""

    def __init__(self, node: Node, frame_id: str, channel: DeviceChannel) -> None:
        self._frame_id, self._channel = frame_id, channel
        self._publisher = create_publisher(node, SpindleSpeed.TYPE, SPINDLE, STREAM)
        self._speed, self._status = np.nan, SpeedStatus.MISSING

    def publish(self, stamp: int, speed: float) -> None:
        """Publish a speed [rad/s], NaN if it is not known."""
        self._speed, self._status = speed, SpeedStatus.OK
        if not np.isfinite(speed):
            self._speed, self._status = np.nan, SpeedStatus.MISSING
        elif abs(speed) > self._channel.largest:
            self._status = SpeedStatus.OUT_OF_RANGE
        record = SpindleSpeed(
            stamp=stamp, frame_id=self._frame_id, speed=self._speed, status=self._status
        )
        self._publisher.publish(encode(record, RCLPY))

    def health(self) -> Health:
        """Say what the newest reading is worth."""
        if self._status is SpeedStatus.OK:
            return Health(SPINDLE, Level.OK, f'{self._speed:.4g} rad/s')
        if self._status is SpeedStatus.MISSING:
            return Health(SPINDLE, Level.WARN, 'no reading')
        text = (
            f'{self._speed:.4g} rad/s is more than max = {self._channel.largest:.4g} rad/s; '
            'compare unit and scale in the device file'
        )
        return Health(SPINDLE, Level.WARN, text)


class Positions:
    """Publish where axes are, for people and plots; no node reads it."""

    def __init__(self, node: Node, frame_id: str) -> None:
        self._frame_id = frame_id
        self._publisher = create_publisher(node, 'sensor_msgs/msg/JointState', POSITIONS, STREAM)

    def publish(self, stamp: int, axes: Sequence[str], position: Sequence[float]) -> None:
        """Publish the positions of the axes of a device [m, rad], NaN where one is not known."""
        header = RCLPY.header(stamp, self._frame_id)
        self._publisher.publish(JointState(header=header, name=axes, position=position))


def _value(reading: Reading) -> float:
    return np.nan if isinstance(reading, str) else reading
