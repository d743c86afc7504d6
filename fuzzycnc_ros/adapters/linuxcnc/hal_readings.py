# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values in the HAL of LinuxCNC: pins, signals and parameters, by a process that may read them."""

import asyncio
import contextlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from fuzzycnc_ros.adapters.linuxcnc import hal_process
from fuzzycnc_ros.adapters.readings.device_fields import (
    CONVERSION,
    Conversion,
    DeviceFields,
    Scaling,
    SensorFields,
    SpeedFields,
)
from fuzzycnc_ros.adapters.readings.devices import Device, DeviceChannel
from fuzzycnc_ros.adapters.readings.link import Link, LinkError, Reading
from fuzzycnc_ros.adapters.readings.plausible_value import reading_of
from fuzzycnc_ros.adapters.yaml_model import Choice, Field, Fields, Shorthand, Text

PROGRAM = str(Path(hal_process.__file__).with_name('hal_values.py'))


@dataclass(frozen=True, kw_only=True)
class Pin(DeviceChannel):
    """A value in HAL: name of the pin, signal or parameter, and of a bit that says it is none."""

    pin: str
    fault: str = ''


@dataclass(frozen=True, kw_only=True)
class Hal(Device):
    """The HAL of this computer; `interpreter` is the Python that its module is built for."""

    channels: tuple[Pin, ...]
    interpreter: str

    @property
    def address(self) -> str:
        """Address for messages."""
        return 'HAL of LinuxCNC'

    def connect(self) -> Link:
        """Return a new link to it."""
        return HalLink(self)


class _Pin(Fields):
    pin: Annotated[str, Text()] = Field(description='Name of the pin, signal or parameter')
    fault: Annotated[str, Text()] = Field(
        '', description='Pin or signal of type bit that is true while the value is none'
    )


class _SensorPin(SensorFields, _Pin, Conversion):
    CHANNEL = Pin


class _SpeedPin(SpeedFields, _Pin, Scaling):
    CHANNEL = Pin


class HalFields(Conversion, DeviceFields):
    """The HAL of a LinuxCNC on this computer."""

    DEVICE = Hal
    INHERITED = CONVERSION
    SHORTHAND = 'pin'

    protocol: Annotated[str, Choice(('linuxcnc_hal',))]
    interpreter: Annotated[str, Text()] = Field(
        '/usr/bin/python3', description="Python that LinuxCNC's modules are built for"
    )
    sensors: dict[str, Annotated[_SensorPin, Shorthand('pin')]] = Field(
        {}, description='Sensors by name; a mere text is the pin, signal or parameter'
    )
    spindle_speed: _SpeedPin | None = Field(None, description='Spindle speed')


class HalLink(Link):
    """One process that reads HAL: its library ends with LinuxCNC, and takes its process along."""

    def __init__(self, device: Hal) -> None:
        self._device = device
        self._names = [channel.pin for channel in device.channels]
        self._faults = [channel.fault for channel in device.channels if channel.fault]
        self._process: asyncio.subprocess.Process | None = None

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes."""
        return 1

    async def open(self) -> None:
        """Start the process and hear from it."""
        try:
            self._process = await asyncio.create_subprocess_exec(
                *(self._device.interpreter, '-I', PROGRAM, *self._names, *self._faults),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.DEVNULL,
            )
        except OSError as error:
            raise LinkError(f'interpreter = {self._device.interpreter}: {error}') from error
        await self._ask()

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel."""
        found = await self._ask()
        faults = dict(zip(self._faults, found[len(self._names) :], strict=True))
        pairs = zip(self._device.channels, found, strict=False)
        return [_reading(channel, raw, faults) for channel, raw in pairs]

    async def close(self) -> None:
        """End the process."""
        process = self._process
        if process is None:
            return
        assert process.stdin is not None
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), 0.5)
        except (asyncio.TimeoutError, TimeoutError):
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    async def _ask(self) -> list[Any]:
        process = self._process
        assert process is not None
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(ConnectionError):  # what it said last tells more
            process.stdin.write(b'\n')
            await process.stdin.drain()
        line = await process.stdout.readline()
        if not line:
            raise LinkError('the process that reads HAL has ended, as it does with LinuxCNC')
        found = json.loads(line)
        if isinstance(found, dict):
            raise LinkError(str(found['error']))
        return list(found)


def _reading(channel: Pin, raw: Any, faults: dict[str, Any]) -> Reading:
    if channel.fault and faults[channel.fault] is not False:
        if isinstance(faults[channel.fault], bool):
            return f'{channel.fault} is true: the card reports a fault of the sensor'
        return f'expected a bit at {channel.fault} but found {faults[channel.fault]!r}'
    if raw is None:
        return f'HAL has no pin, signal or parameter {channel.pin}; `halcmd show pin` lists them'
    return reading_of(
        channel,
        raw,
        channel.pin,
        'is it the right pin, and are its scale and offset in HAL set? an input in volts or '
        'counts needs scale and offset, or ntc, in the device file',
    )
