# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Modbus devices: what a file says of them, and what their registers mean."""

import struct
from dataclasses import dataclass
from typing import Annotated, Any

from fuzzycnc_ros.adapters.readings.device_fields import (
    CONVERSION,
    HOST,
    PORT,
    Conversion,
    DeviceFields,
    Scaling,
    SensorFields,
    SpeedFields,
    host_name,
    serial_port,
)
from fuzzycnc_ros.adapters.readings.devices import Device, DeviceChannel
from fuzzycnc_ros.adapters.readings.link import Link
from fuzzycnc_ros.adapters.yaml_model import (
    AfterValidator,
    Choice,
    Field,
    Fields,
    Number,
    Shorthand,
    Text,
    model_validator,
    wrong,
)
from fuzzycnc_ros.ros.parameters import ParameterError

ORDERS = ('big', 'little')
PARITIES = ('even', 'odd', 'none')
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


@dataclass(frozen=True, kw_only=True)
class Register(DeviceChannel):
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
class ModbusDevice(Device):
    """A device with registers."""

    channels: tuple[Register, ...]
    unit: int

    def check(self) -> None:
        """Refuse to begin without the library."""
        try:
            import pymodbus.client  # noqa: F401

            if isinstance(self, ModbusRtuDevice):
                import serial  # noqa: F401
        except ImportError as error:
            raise ParameterError(
                f'device {self.name}: Modbus needs pymodbus, on a serial line pyserial too '
                f"({error}); run pip install 'fuzzycnc_ros[modbus]'"
            ) from error


@dataclass(frozen=True, kw_only=True)
class ModbusTcpDevice(ModbusDevice):
    """A Modbus TCP device, or one behind a gateway."""

    host: str
    port: int

    @property
    def address(self) -> str:
        """Address for messages."""
        return f'Modbus TCP {self.host}:{self.port} unit {self.unit}'

    def connect(self) -> Link:
        """Return a new link to it."""
        from fuzzycnc_ros.adapters.modbus.link import ModbusTcpLink

        return ModbusTcpLink(self)


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
        """Address for messages."""
        return f'Modbus RTU {self.line.port} unit {self.unit}'

    def connect(self) -> Link:
        """Return a new link to it."""
        from fuzzycnc_ros.adapters.modbus.serial_line import ModbusRtuLink

        return ModbusRtuLink(self)


class _Layout(Fields):
    table: Annotated[str, Choice(('holding', 'input'))] = Field(
        'holding', description='Which registers: function 3 or 4'
    )
    type: Annotated[str, Choice(tuple(FORMATS))] = Field('int16', description='Type of raw values')
    word_order: Annotated[str, Choice(ORDERS)] = Field(
        'big', description='Which register of a longer value comes first'
    )
    byte_order: Annotated[str, Choice(ORDERS)] = Field(
        'big', description='Order of the bytes in a register'
    )


class _Register(_Layout, Scaling):
    CHANNEL = Register

    # `register` is a method of the metaclass
    first: Annotated[
        int,
        Number(
            0,
            65535,
            whole=True,
            remedy='count from 0: what manuals call 40001 is register 0 of the table holding, '
            '30001 is register 0 of the table input',
        ),
    ] = Field(alias='register', description='Address of the first register, counted from 0')

    @model_validator(mode='after')
    def _check_register(self) -> '_Register':
        made = self.channel('', 1.0)
        assert isinstance(made, Register)
        if made.register + made.count > 65536:
            raise wrong(f'a {made.type} does not fit behind {made.register}', 'register')
        bits = 16 * made.count
        for code in () if made.type.startswith('float') else made.open_circuit:
            if not isinstance(code, int) or not -(2 ** (bits - 1)) <= code < 2**bits:
                raise wrong(
                    f'expected raw values of a {made.type}, before scale and offset, such as '
                    f'0x7FFF but found {code}',
                    'open_circuit',
                )
        return self

    def own(self, names: set[str]) -> dict[str, Any]:
        """Return what the channel has beside what all have."""
        return super().own(names - {'register'}) | {'register': self.first}


class _SensorRegister(SensorFields, Conversion, _Register):
    pass


class _SpeedRegister(SpeedFields, _Register):
    pass


class _Modbus(_Layout, Conversion, DeviceFields):
    INHERITED = (*CONVERSION, *_Layout.model_fields)
    SHORTHAND = 'register'

    sensors: dict[str, Annotated[_SensorRegister, Shorthand('register')]] = Field(
        {}, description='Sensors by name; a mere number is the register'
    )
    spindle_speed: _SpeedRegister | None = Field(None, description='Spindle speed')


class ModbusTcp(_Modbus):
    """A Modbus TCP device, or one behind a gateway."""

    DEVICE = ModbusTcpDevice

    protocol: Annotated[str, Choice(('modbus_tcp',))]
    host: Annotated[str, Text(HOST), AfterValidator(host_name)] = Field(description='Address')
    port: Annotated[int, Number(1, 65535, whole=True)] = Field(502, description='TCP port')
    unit: Annotated[int, Number(0, 255, whole=True)] = Field(
        1, description='Unit of a device behind a gateway'
    )


class ModbusRtu(_Modbus):
    """A Modbus RTU device: one unit on a serial line."""

    DEVICE = ModbusRtuDevice

    protocol: Annotated[str, Choice(('modbus_rtu',))]
    port: Annotated[str, Text(PORT), AfterValidator(serial_port)] = Field(
        description='File of the serial port; all units of a line name the same'
    )
    baud_rate: Annotated[int, Number(300, 4_000_000, whole=True)] = Field(
        19200, description='Bits per second'
    )
    parity: Annotated[str, Choice(PARITIES)] = Field('even', description='Parity bit')
    stop_bits: Annotated[int, Number(1, 2, whole=True)] = Field(1, description='Stop bits')
    unit: Annotated[int, Number(1, 247, whole=True)] = Field(1, description='Unit on the line')
    timeout: Annotated[float, Number(0.05, 60.0, 's')] = Field(
        1.0, description='Longest wait for a whole answer [s]'
    )

    @property
    def line(self) -> SerialLine:
        """Settings of its serial line."""
        return SerialLine(self.port, self.baud_rate, self.parity, self.stop_bits)

    def clash(self, other: DeviceFields) -> str:
        """Return why two devices do not go together: all units of a line use it alike."""
        if getattr(other, 'port', '') != self.port or getattr(other, 'line', None) == self.line:
            return ''
        return (
            f'expected the same baud_rate, parity and stop_bits as device {other.name}, which is '
            f'on the same line, but found {self.baud_rate}, {self.parity}, {self.stop_bits}'
        )
