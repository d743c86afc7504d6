# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors on a 1-Wire bus, such as DS18B20, by the files of the kernel's driver w1_therm."""

import asyncio
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from fuzzycnc_ros.adapters.readings.device_fields import DeviceFields, Scaling, SensorFields
from fuzzycnc_ros.adapters.readings.devices import Device, DeviceChannel
from fuzzycnc_ros.adapters.readings.link import Link, LinkError, Reading
from fuzzycnc_ros.adapters.readings.plausible_value import reading_of, shown
from fuzzycnc_ros.adapters.yaml_model import AfterValidator, Choice, Field, Shorthand, Text, wrong

FOLDER = '/sys/bus/w1/devices'
IDENTIFIER = r'[0-9a-f]{2}-[0-9a-f]{12}'
POWER_ON = 85.0
"""Reading of a sensor that was powered on and has not measured since [degC]."""
BELIEVED = 3.0
"""Distance of the last reading from it within which it is believed [K]."""
FILE_MAX = 4096
"""Most characters of a file that are read."""
NAMED_MAX = 5
"""Most sensors that a message names."""
_OF_SLAVE = re.compile(r't=(-?[0-9]+)\s*$')


@dataclass(frozen=True, kw_only=True)
class Slave(DeviceChannel):
    """A sensor on the bus, by its identifier."""

    id: str


@dataclass(frozen=True, kw_only=True)
class OneWire(Device):
    """The buses of this computer; `folder` is where the kernel shows their sensors."""

    channels: tuple[Slave, ...]
    folder: str

    @property
    def address(self) -> str:
        """Address for messages."""
        return f'1-Wire {self.folder}'

    def connect(self) -> Link:
        """Return a new link to it."""
        return OneWireLink(self)


def _identifier(text: str) -> str:
    if not re.fullmatch(IDENTIFIER, text):
        raise wrong(
            f'expected an identifier such as 28-0316a2791cff, as `ls {FOLDER}` shows it, but '
            f'found {text!r}'
        )
    return text


class _SensorSlave(SensorFields, Scaling):
    CHANNEL = Slave

    id: Annotated[str, Text(IDENTIFIER), AfterValidator(_identifier)] = Field(
        description='Identifier of the sensor'
    )


class OneWireFields(DeviceFields):
    """1-Wire sensors of this computer."""

    DEVICE = OneWire
    INHERITED = ()
    SHORTHAND = 'id'

    protocol: Annotated[str, Choice(('one_wire',))]
    folder: Annotated[str, Text()] = Field(FOLDER, description='Where the kernel shows sensors')
    sensors: dict[str, Annotated[_SensorSlave, Shorthand('id')]] = Field(
        {}, description='Sensors by name; a mere text is the identifier'
    )


class OneWireLink(Link):
    """The files of some sensors; the kernel measures while one is read, for up to 0.75 s."""

    def __init__(self, device: OneWire) -> None:
        self._device = device
        self._folder = Path(device.folder)
        self._last: dict[str, float] = {}

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes; a bus serves one sensor at a time."""
        return len(self._device.channels)

    async def open(self) -> None:
        """See that there is a bus."""
        if not self._folder.is_dir():
            raise LinkError(
                f'no folder {self._folder}; load the driver of the bus (w1-gpio or that of the '
                'adapter) and w1_therm'
            )

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel."""
        await self.open()
        asked = (asyncio.to_thread(self._read, channel) for channel in self._device.channels)
        return await asyncio.gather(*asked)

    async def close(self) -> None:
        """Do nothing: no file stays open."""

    def _read(self, channel: Slave) -> Reading:
        folder = self._folder / channel.id
        found: float | str = ''
        for name, parse in (('w1_slave', of_slave), ('temperature', of_temperature)):
            try:
                with (folder / name).open(encoding='ascii', errors='replace') as file:
                    found = parse(file.read(FILE_MAX))
            except FileNotFoundError:
                continue
            except OSError as error:
                return f'{channel.id}: cannot be read ({error.strerror}); look at its wiring'
            break
        else:
            return f'{channel.id}: the bus has no such sensor{self._others()}'
        if isinstance(found, str):
            return f'{channel.id}: {found}'
        last = self._last.get(channel.id, 0.0)
        if found == POWER_ON and abs(last - POWER_ON) > BELIEVED:
            return (
                f'{channel.id}: reads {POWER_ON:g} degC, as after power-on without a measurement; '
                'look at its supply (3 wires are better than parasitic power)'
            )
        self._last[channel.id] = found
        return reading_of(channel, found, channel.id, 'compare scale and offset')

    def _others(self) -> str:
        names = sorted(path.name for path in self._folder.glob('*-*'))
        wanted = {channel.id for channel in self._device.channels}
        others = [n for n in names if re.fullmatch(IDENTIFIER, n) and n not in wanted][:NAMED_MAX]
        return f'; others there are {", ".join(others)}' if others else '; look at its wiring'


def of_slave(text: str) -> float | str:
    """Return the temperature [degC] in a file `w1_slave`, or why there is none.

    Examples
    --------
    >>> of_slave('72 01 4b 46 7f ff 0e 10 57 : crc=57 YES 72 01 4b 46 7f ff 0e 10 57 t=23125')
    23.125
    """
    if text.startswith('00 00 00 00 00 00 00 00 00'):
        return 'reads zeros, whose checksum is right by chance; is the bus shorted to ground?'
    if 'YES' not in text:
        return (
            'the checksum is wrong; look at cable length, its shield and the resistor of 4.7 kohm '
            'to the supply'
        )
    found = _OF_SLAVE.search(text)
    return 1e-3 * int(found[1]) if found else f'expected t=TEMPERATURE but found {shown(text)}'


def of_temperature(text: str) -> float | str:
    """Return the temperature [degC] in a file `temperature`, or why there is none."""
    if re.fullmatch(r'-?[0-9]+', text.strip()):
        return 1e-3 * int(text)
    return f'expected thousandths of a degree but found {shown(text)}'
