# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Devices as the drivers know them: where each is, and where its values lie."""

import math
import struct
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TypeAlias

from fuzzycnc_ros.adapters.opcua.session import Address, Server

FORMATS = {
    'int16': 'h',
    'uint16': 'H',
    'int32': 'i',
    'uint32': 'I',
    'int64': 'q',
    'uint64': 'Q',
    'float32': 'f',
    'float64': 'd',
}
"""Types of values in registers, as `struct` writes them."""
SPINDLE = 'spindle_speed'
"""Field, and name, of the channel that holds the spindle speed."""


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One value of a device: quantity = scale * raw + offset.

    Parameters
    ----------
    name : str
        Name of the sensor.
    scale, offset : float
        From the raw value to degC, for the spindle to rad/s, for an axis to m or rad.
    open_circuit : tuple of numbers
        Raw values by which the device says that no sensor is connected.
    largest : float
        Size beyond which a value is none; for the spindle, rad/s.
    limits : tuple of (str, float)
        Limits of the sensor in place of those of all, see `SensorLimits`.
    """

    name: str
    scale: float = 1.0
    offset: float = 0.0
    open_circuit: tuple[int | float, ...] = ()
    largest: float = math.inf
    limits: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Register(Channel):
    """A value in registers of a Modbus device.

    Parameters
    ----------
    table : {'holding', 'input'}
        Which registers.
    register : int
        Address of the first, counted from 0.
    type : str
        Type of the raw value, a key of `FORMATS`.
    word_order, byte_order : {'big', 'little'}
        Order of the registers of a value, and of the bytes in a register.
    """

    table: str
    register: int
    type: str
    word_order: str = 'big'
    byte_order: str = 'big'

    @property
    def count(self) -> int:
        """Number of registers."""
        return struct.calcsize(f'>{FORMATS[self.type]}') // 2


@dataclass(frozen=True, kw_only=True)
class Variable(Channel, Address):
    """A value in a variable of an OPC UA server."""


class Quantity(Enum):
    """What a data item of an MTConnect agent is read as."""

    TEMPERATURE = 'temperature'
    SPEED = 'speed'
    POSITION = 'position'


@dataclass(frozen=True, kw_only=True)
class Item(Channel):
    """A data item of an MTConnect agent; the raw value is brought to degC or to `unit` first.

    Parameters
    ----------
    item : str
        Its id, or its name.
    unit : float
        Unit of the raw value where the agent states none: degC 1, of a speed in rad/s.
    quantity : Quantity
        What it is read as.  A position has no unit of its own: the agent has to state it.
    """

    item: str
    unit: float = 1.0
    quantity: Quantity = Quantity.TEMPERATURE


@dataclass(frozen=True, kw_only=True)
class Device:
    """What all devices have.

    Parameters
    ----------
    name : str
        Name of the device in messages.
    period : float
        Time between two readings [s].
    timeout : float
        Longest wait for an answer [s].
    channels : tuple of Channel
        Sensors in the order of the file, then axes, the spindle speed last.
    has_spindle : bool
        Whether the last channel is the spindle speed.
    axes : tuple of str
        Names of the axes whose positions are read.
    """

    name: str
    period: float
    timeout: float
    channels: tuple[Channel, ...]
    has_spindle: bool
    axes: tuple[str, ...] = ()

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors."""
        count = len(self.channels) - len(self.axes) - self.has_spindle
        return tuple(channel.name for channel in self.channels[:count])


@dataclass(frozen=True, kw_only=True)
class ModbusDevice(Device):
    """A device with registers."""

    channels: tuple[Register, ...]
    unit: int


@dataclass(frozen=True, kw_only=True)
class ModbusTcpDevice(ModbusDevice):
    """A Modbus TCP device, or one behind a gateway."""

    host: str
    port: int

    @property
    def address(self) -> str:
        """Where it is, for messages."""
        return f'Modbus TCP {self.host}:{self.port} unit {self.unit}'


@dataclass(frozen=True)
class SerialLine:
    """A serial line as all units on it use it.

    Parameters
    ----------
    port : str
        File of the port, as /dev/ttyUSB0.
    baud_rate : int
        Bits per second.
    parity : {'even', 'odd', 'none'}
        What the parity bit makes of a character.
    stop_bits : int
        1 or 2.
    """

    port: str
    baud_rate: int
    parity: str
    stop_bits: int


@dataclass(frozen=True, kw_only=True)
class ModbusRtuDevice(ModbusDevice):
    """A Modbus RTU device: one unit on a serial line."""

    line: SerialLine

    @property
    def address(self) -> str:
        """Where it is, for messages."""
        return f'Modbus RTU {self.line.port} unit {self.unit}'


@dataclass(frozen=True, kw_only=True)
class OpcUaDevice(Device, Server):
    """An OPC UA server with sensors."""

    channels: tuple[Variable, ...]

    @property
    def address(self) -> str:
        """Where it is, for messages."""
        return f'OPC UA {self.url}'


@dataclass(frozen=True, kw_only=True)
class MtconnectDevice(Device):
    """An MTConnect agent.

    Parameters
    ----------
    host : str
        Name or address.
    port : int
        TCP port.
    path : str
        What its requests begin with, as `/mill`; empty for all of its machines.
    encrypted : bool
        Whether it speaks HTTPS.
    ca_file : Path, optional
        Certificates of those who may vouch for it; None: those that the system trusts.
    """

    channels: tuple[Item, ...]
    host: str
    port: int
    path: str
    encrypted: bool = False
    ca_file: Path | None = None

    @property
    def address(self) -> str:
        """Where it is, for messages."""
        scheme = 'https' if self.encrypted else 'http'
        return f'MTConnect {scheme}://{self.host}:{self.port}{self.path}'


AnyDevice: TypeAlias = ModbusTcpDevice | ModbusRtuDevice | OpcUaDevice | MtconnectDevice
