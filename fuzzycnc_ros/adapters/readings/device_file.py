# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file that says which devices there are, and where each of their values lies.

docs/how-to/temperature-drivers.md describes it with examples.
"""

import math
import re
import ssl
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar
from urllib.parse import urlsplit

from fuzzycnc_ros.adapters.opcua.file_fields import File, PlaceFields, ServerFields, pin_folder
from fuzzycnc_ros.adapters.readings.devices import (
    FORMATS,
    SPINDLE,
    AnyDevice,
    Channel,
    Item,
    ModbusRtuDevice,
    ModbusTcpDevice,
    MtconnectDevice,
    OpcUaDevice,
    Quantity,
    Register,
    SerialLine,
    Variable,
)
from fuzzycnc_ros.adapters.yaml_model import (
    NO_FIELDS,
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Fields,
    Number,
    Numbers,
    Shorthand,
    Tag,
    Text,
    Word,
    full,
    model_validator,
    read_file,
    wrong,
)
from fuzzycnc_ros.core.thermal.sensor_limits import LIMIT_BOUNDS
from fuzzycnc_ros.core.units import SPEEDS

ORDERS = ('big', 'little')
PARITIES = ('even', 'odd', 'none')
PROTOCOLS = ('modbus_tcp', 'modbus_rtu', 'opc_ua', 'mtconnect')

_HOST = r'[A-Za-z0-9._:%-]+'
_PORT = r'/[^:]+'


def nonzero(value: float) -> float:
    """Refuse a scale of 0."""
    if value == 0.0:
        raise wrong('expected another number than 0')
    return value


Scale = Annotated[float, Number(-1e9, 1e9), AfterValidator(nonzero)]
SpeedUnit = Annotated[str, Word(tuple(SPEEDS))]


class _Scaling(Fields):
    scale: Scale = Field(1.0, description='degC = scale * raw + offset')
    offset: Annotated[float, Number(-1e9, 1e9)] = Field(
        0.0, description='degC = scale * raw + offset; -273.15 for kelvin'
    )
    open_circuit: Annotated[tuple[int | float, ...], Numbers()] = Field(
        (), description='Raw values that mean no sensor, before the scale'
    )


_Limit = {name: Number(*bounds) for name, bounds in LIMIT_BOUNDS.items()}


class _Limits(Fields):
    """Limits of a sensor in place of the parameters of these names."""

    range_low: Annotated[float, _Limit['range_low']] = Field(
        default_factory=lambda: math.nan, description='Lowest plausible reading [degC]'
    )
    range_high: Annotated[float, _Limit['range_high']] = Field(
        default_factory=lambda: math.nan, description='Highest plausible reading [degC]'
    )
    rate_max: Annotated[float, _Limit['rate_max']] = Field(
        default_factory=lambda: math.nan, description='Fastest plausible change [K/s]'
    )
    noise_band: Annotated[float, _Limit['noise_band']] = Field(
        default_factory=lambda: math.nan,
        description='Change between two readings that is never an error [K]',
    )

    def limits(self) -> tuple[tuple[str, float], ...]:
        """Return those that are stated."""
        found = ((name, getattr(self, name)) for name in LIMIT_BOUNDS)
        return tuple((name, value) for name, value in found if not math.isnan(value))


class _Layout(_Scaling):
    table: Annotated[str, Word(('holding', 'input'))] = Field(
        'holding', description='Which registers: function 3 or 4'
    )
    type: Annotated[str, Word(tuple(FORMATS))] = Field('int16', description='Type of raw values')
    word_order: Annotated[str, Word(ORDERS)] = Field(
        'big', description='Which register of a longer value comes first'
    )
    byte_order: Annotated[str, Word(ORDERS)] = Field(
        'big', description='Order of the bytes in a register'
    )


class _Register(_Layout):
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

    def channel(self, name: str, unit: float, largest: float = math.inf) -> Register:
        """Return the channel."""
        return Register(
            **_scaled(self, unit),
            name=name,
            largest=largest,
            table=self.table,
            register=self.first,
            type=self.type,
            word_order=self.word_order,
            byte_order=self.byte_order,
        )


class _Variable(_Scaling, PlaceFields):
    def channel(self, name: str, unit: float, largest: float = math.inf) -> Variable:
        """Return the channel."""
        return Variable(
            **_scaled(self, unit), name=name, largest=largest, node=self.node, path=self.path
        )


class _Item(_Scaling):
    item: Annotated[str, Text()] = Field(description='Id of the data item, or its name')

    def channel(self, name: str, unit: float, largest: float = math.inf) -> Item:
        """Return the channel."""
        return Item(
            **_scaled(self, unit),
            name=name,
            largest=largest,
            item=self.item,
            unit=unit,
            quantity=Quantity.SPEED if isinstance(self, _Speed) else Quantity.TEMPERATURE,
        )


def _scaled(fields: _Scaling, unit: float) -> dict[str, Any]:
    return {
        'scale': unit * fields.scale,
        'offset': unit * fields.offset,
        'open_circuit': fields.open_circuit,
    }


class _Speed(Fields):
    unit: SpeedUnit = Field('rpm', description='Unit of the speed')
    max: Annotated[float, Number(0.0, 1e6)] = Field(
        default_factory=lambda: math.inf, description='Greatest speed of the spindle, in `unit`'
    )


class _SensorRegister(_Limits, _Register):
    pass


class _SensorVariable(_Limits, _Variable):
    pass


class _SensorItem(_Limits, _Item):
    pass


class _SpeedRegister(_Speed, _Register):
    pass


class _SpeedVariable(_Speed, _Variable):
    pass


class _SpeedItem(_Speed, _Item):
    pass


class _Device(Fields):
    INHERITED: ClassVar[tuple[str, ...]]
    SHORTHAND: ClassVar[str]

    name: Annotated[str, Text()] = Field(description='Name in messages')
    period: Annotated[float, Number(0.005, 3600.0, 's')] = Field(
        1.0, description='Time between two readings [s]'
    )

    @model_validator(mode='before')
    @classmethod
    def _inherit(cls, data: Any) -> Any:
        """Give the sensors what the device says for all of them."""
        sensors = data.get('sensors') if isinstance(data, dict) else None
        if not isinstance(sensors, dict):
            return data
        common = {name: data[name] for name in cls.INHERITED if name in data}
        inner = {name: full(entry, cls.SHORTHAND) for name, entry in sensors.items()}
        return data | {
            'sensors': {
                name: common | entry if isinstance(entry, dict) else entry
                for name, entry in inner.items()
            }
        }

    def values(self) -> dict[str, Any]:
        """Return what all devices have, the spindle speed as the last channel."""
        sensors, spindle = getattr(self, 'sensors'), getattr(self, SPINDLE)  # noqa: B009
        channels = [
            replace(entry.channel(name, 1.0), limits=entry.limits())
            for name, entry in sensors.items()
        ]
        axes = self.axes()
        channels += axes.values()
        if spindle is not None:
            unit = SPEEDS[spindle.unit]
            channels.append(spindle.channel(SPINDLE, unit, spindle.max * unit))
        return {
            'name': self.name,
            'period': self.period,
            'channels': tuple(channels),
            'has_spindle': spindle is not None,
            'axes': tuple(axes),
        }

    def axes(self) -> dict[str, Channel]:
        """Return the channels of axes by the names of these; most protocols have none."""
        return {}

    @model_validator(mode='after')
    def _check_channels(self) -> '_Device':
        if not self.values()['channels']:
            raise wrong('expected sensors, as sensors: {T1: ...}, but found none')
        return self


def _host(text: str) -> str:
    if not re.fullmatch(_HOST, text):
        raise wrong(f'expected a name or address but found {text!r}')
    return text


def _port(text: str) -> str:
    if not re.fullmatch(_PORT, text):
        raise wrong(
            f'expected the file of a serial port, such as /dev/ttyUSB0, but found {text!r}'
        )
    return text


class _Modbus(_Layout, _Device):
    INHERITED = tuple(_Layout.model_fields)
    SHORTHAND = 'register'

    sensors: dict[str, Annotated[_SensorRegister, Shorthand('register')]] = Field(
        {}, description='Sensors by name; a mere number is the register'
    )
    spindle_speed: _SpeedRegister | None = Field(None, description='Spindle speed')


class _ModbusTcp(_Modbus):
    """A Modbus TCP device, or one behind a gateway."""

    protocol: Annotated[str, Word(('modbus_tcp',))]
    host: Annotated[str, Text(_HOST), AfterValidator(_host)] = Field(description='Address')
    port: Annotated[int, Number(1, 65535, whole=True)] = Field(502, description='TCP port')
    unit: Annotated[int, Number(0, 255, whole=True)] = Field(
        1, description='Unit of a device behind a gateway'
    )
    timeout: Annotated[float, Number(0.05, 60.0, 's')] = Field(
        2.0, description='Longest wait for an answer [s]'
    )

    def device(self, folder: Path) -> ModbusTcpDevice:
        """Return the device."""
        return ModbusTcpDevice(
            **self.values(), timeout=self.timeout, host=self.host, port=self.port, unit=self.unit
        )


class _ModbusRtu(_Modbus):
    """A Modbus RTU device: one unit on a serial line."""

    protocol: Annotated[str, Word(('modbus_rtu',))]
    port: Annotated[str, Text(_PORT), AfterValidator(_port)] = Field(
        description='File of the serial port; all units of a line name the same'
    )
    baud_rate: Annotated[int, Number(300, 4_000_000, whole=True)] = Field(
        19200, description='Bits per second'
    )
    parity: Annotated[str, Word(PARITIES)] = Field('even', description='Parity bit')
    stop_bits: Annotated[int, Number(1, 2, whole=True)] = Field(1, description='Stop bits')
    unit: Annotated[int, Number(1, 247, whole=True)] = Field(1, description='Unit on the line')
    timeout: Annotated[float, Number(0.05, 60.0, 's')] = Field(
        1.0, description='Longest wait for a whole answer [s]'
    )

    def device(self, folder: Path) -> ModbusRtuDevice:
        """Return the device."""
        return ModbusRtuDevice(
            **self.values(), timeout=self.timeout, unit=self.unit, line=self.line()
        )

    def line(self) -> SerialLine:
        """Return how its line is used."""
        return SerialLine(self.port, self.baud_rate, self.parity, self.stop_bits)


class _OpcUa(_Scaling, _Device, ServerFields):
    """An OPC UA server with sensors."""

    INHERITED = tuple(_Scaling.model_fields)
    SHORTHAND = 'node'

    protocol: Annotated[str, Word(('opc_ua',))]
    sensors: dict[str, Annotated[_SensorVariable, Shorthand('node')]] = Field(
        {}, description='Sensors by name; a mere text is the node id'
    )
    spindle_speed: _SpeedVariable | None = Field(None, description='Spindle speed')

    def device(self, folder: Path) -> OpcUaDevice:
        """Return the device."""
        return OpcUaDevice(**self.values(), **vars(self.server(folder)))


def _agent(text: str) -> str:
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(''), None
    if parts.scheme not in ('http', 'https') or not parts.hostname or port is None:
        raise wrong(
            'expected http://HOST:PORT/MACHINE or https://HOST:PORT/MACHINE, usual port 5000, but '
            f'found {text!r}'
        )
    if '@' in parts.netloc:
        raise wrong('expected no user and password in the address of an agent')
    if not re.fullmatch(r'[A-Za-z0-9._~%/-]*', parts.path) or parts.query or parts.fragment:
        raise wrong(f'expected the name of a machine behind the port but found {parts.path!r}')
    return text


class _Mtconnect(_Scaling, _Device):
    """An MTConnect agent with sensors."""

    INHERITED = tuple(_Scaling.model_fields)
    SHORTHAND = 'item'

    protocol: Annotated[str, Word(('mtconnect',))]
    url: Annotated[str, Text(r'https?://.+'), AfterValidator(_agent)] = Field(
        description='Address, http:// or https://HOST:PORT, and /MACHINE where the agent has '
        'several'
    )
    ca_file: File = Field(
        default_factory=Path,
        description='Certificates of those who may vouch for the agent, PEM; without it those '
        'that the system trusts',
    )
    timeout: Annotated[float, Number(0.05, 60.0, 's')] = Field(
        2.0, description='Longest wait for an answer [s]'
    )
    sensors: dict[str, Annotated[_SensorItem, Shorthand('item')]] = Field(
        {}, description='Sensors by name; a mere text is the id or name of the data item'
    )
    positions: dict[str, Annotated[str, Text()]] = Field(
        {}, description='Id or name of the data item of the position of each axis'
    )
    spindle_speed: _SpeedItem | None = Field(None, description='Spindle speed')

    def axes(self) -> dict[str, Channel]:
        """Return the channels of axes by the names of these."""
        return {
            name: Item(name=f'axis {name}', item=item, quantity=Quantity.POSITION)
            for name, item in self.positions.items()
        }

    @model_validator(mode='after')
    def _check_trust(self) -> '_Mtconnect':
        if self.ca_file == Path():
            return self
        if not self.url.startswith('https:'):
            raise wrong(
                'expected https:// in url beside it, since http has no certificate', 'ca_file'
            )
        try:
            ssl.create_default_context(cafile=self.ca_file)
        except OSError as error:  # those of ssl are among them
            raise wrong(
                f'expected certificates in PEM but {self.ca_file} holds none ({error})', 'ca_file'
            ) from error
        return self

    def device(self, folder: Path) -> MtconnectDevice:
        """Return the device."""
        parts = urlsplit(self.url)
        return MtconnectDevice(
            **self.values(),
            timeout=self.timeout,
            host=parts.hostname or '',
            port=parts.port or 0,
            path=parts.path.rstrip('/'),
            encrypted=parts.scheme == 'https',
            ca_file=self.ca_file if self.ca_file != Path() else None,
        )


def _check_protocol(data: Any) -> Any:
    if not isinstance(data, dict):
        raise wrong(NO_FIELDS)
    for name in ('name', 'protocol'):
        if name not in data:
            raise wrong(f'expected the field {name!r} but it is missing')
    node = data['protocol']
    if isinstance(node, (dict, list)) or node.value not in PROTOCOLS:
        found = 'a list or fields' if isinstance(node, (dict, list)) else repr(node.value)
        raise wrong(f'expected one of {", ".join(PROTOCOLS)} but found {found}', 'protocol')
    return data


def _list(data: Any) -> Any:
    if not isinstance(data, list) or not data:
        raise wrong('expected a list, each item with a dash, of device')
    return data


_AnyDevice = Annotated[
    Annotated[
        Annotated[_ModbusTcp, Tag('<modbus_tcp>')]
        | Annotated[_ModbusRtu, Tag('<modbus_rtu>')]
        | Annotated[_OpcUa, Tag('<opc_ua>')]
        | Annotated[_Mtconnect, Tag('<mtconnect>')],
        Discriminator(lambda data: f'<{data["protocol"].value}>'),
    ],
    BeforeValidator(_check_protocol),
]


class DeviceFile(Fields):
    """Devices with sensors, and where each of their values lies."""

    devices: Annotated[list[_AnyDevice], BeforeValidator(_list)] = Field(
        description='Devices', min_length=1
    )

    @model_validator(mode='after')
    def _check_devices(self) -> 'DeviceFile':
        seen: dict[str, str] = {}
        names: set[str] = set()
        lines: dict[str, tuple[str, SerialLine]] = {}
        for index, device in enumerate(self.devices):
            spindle = [f'the {SPINDLE}'] if device.spindle_speed is not None else []
            axes = [f'axis {name}' for name in device.axes()]
            for name in [*(f'sensor {name}' for name in device.sensors), *axes, *spindle]:
                if name in seen:
                    raise wrong(
                        f'{name} is already read from {seen[name]}; every name can be used once',
                        'devices',
                        index,
                    )
                seen[name] = f'device {device.name}'
            if device.name in names:
                raise wrong(
                    f'another device is called {device.name} too',
                    'devices',
                    index,
                    'name',
                )
            names.add(device.name)
            if isinstance(device, _ModbusRtu):
                other, line = lines.setdefault(device.port, (device.name, device.line()))
                if line != device.line():
                    raise wrong(
                        f'expected the same baud_rate, parity and stop_bits as device {other}, '
                        f'which is on the same line, but found {device.baud_rate}, '
                        f'{device.parity}, {device.stop_bits}',
                        'devices',
                        index,
                        'port',
                    )
        if not any(device.sensors for device in self.devices):
            raise wrong('expected at least one device with sensors but none has any')
        return self


def read_devices(path: Path, state_directory: str = '') -> tuple[AnyDevice, ...]:
    """Read and check a device file.

    Parameters
    ----------
    path : Path
        The file.
    state_directory : str
        Where certificates are pinned on first use; empty: beside the file.

    Raises
    ------
    ParameterError
        If something in it is missing, unknown, out of bounds or there twice; the text names
        file, line and field.
    """
    file = read_file(path, DeviceFile, 'a file of devices')
    return tuple(device.device(pin_folder(path, state_directory)) for device in file.devices)
