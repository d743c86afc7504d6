# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file that says which devices there are, and where each of their values lies.

docs/temperature-drivers.md describes it with examples.
"""

import math
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import urlsplit

from fuzzycnc_ros.nodes.parameters import ParameterError
from fuzzycnc_ros.nodes.sources.yaml_section import Section

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
ORDERS = ('big', 'little')
POLICIES = ('Basic256Sha256', 'Aes128Sha256RsaOaep', 'Aes256Sha256RsaPss')
MODES = ('Sign', 'SignAndEncrypt')
SPEED_UNITS = {'rpm': 2.0 * math.pi / 60.0, 'rad/s': 1.0}
INHERITED = ('table', 'type', 'word_order', 'byte_order', 'scale', 'offset', 'open_circuit')
"""Fields that a device may give for all of its sensors."""
SPINDLE = 'spindle_speed'
"""Field, and name, of the channel that holds the spindle speed."""

_HOST = re.compile(r'[A-Za-z0-9._:%-]+')
_NODE = re.compile(r'((ns=[0-9]+|nsu=[^;]+);)?(i=[0-9]+|[sgb]=.+)')


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One value of a device: quantity = scale * raw + offset.

    Parameters
    ----------
    name : str
        Name of the sensor.
    scale, offset : float
        From the raw value to degC, for the spindle to rad/s.
    open_circuit : tuple of numbers
        Raw values by which the device says that no sensor is connected.
    """

    name: str
    scale: float = 1.0
    offset: float = 0.0
    open_circuit: tuple[int | float, ...] = ()


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
class Variable(Channel):
    """A variable of an OPC UA server: node id, or browse path from the root."""

    node: str = ''
    path: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """The node id or path as it stands in the file."""
        return f'node {self.node}' if self.node else f'path {"/".join(self.path)}'


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
        Sensors in the order of the file, the spindle speed last.
    has_spindle : bool
        Whether the last channel is the spindle speed.
    """

    name: str
    period: float
    timeout: float
    channels: tuple[Channel, ...]
    has_spindle: bool

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors."""
        temperatures = self.channels[:-1] if self.has_spindle else self.channels
        return tuple(channel.name for channel in temperatures)


@dataclass(frozen=True, kw_only=True)
class ModbusDevice(Device):
    """A Modbus TCP device, or one behind a gateway."""

    channels: tuple[Register, ...]
    host: str
    port: int
    unit: int

    @property
    def address(self) -> str:
        """Where it is, for messages."""
        return f'Modbus TCP {self.host}:{self.port} unit {self.unit}'


@dataclass(frozen=True, kw_only=True)
class Security:
    """How a connection to an OPC UA server is secured: names and files."""

    policy: str
    mode: str
    certificate: Path
    private_key: Path
    server_certificate: Path


@dataclass(frozen=True, kw_only=True)
class OpcUaDevice(Device):
    """An OPC UA server."""

    channels: tuple[Variable, ...]
    url: str
    security: Security | None
    credentials: Path | None

    @property
    def address(self) -> str:
        """Where it is, for messages."""
        return f'OPC UA {self.url}'


AnyDevice: TypeAlias = ModbusDevice | OpcUaDevice


def read_devices(path: Path) -> tuple[AnyDevice, ...]:
    """Read and check a device file.

    Raises
    ------
    ParameterError
        If something in it is missing, unknown, out of bounds or there twice; the text names
        file, line and field.
    """
    whole = Section.read(path, 'a file of devices')
    devices: list[AnyDevice] = []
    sections = whole.sections('devices', 'device')
    whole.done()
    seen: dict[str, str] = {}
    for section in sections:
        device = _device(section)
        for channel in device.channels:
            spindle = device.has_spindle and channel is device.channels[-1]
            name = f'the {SPINDLE}' if spindle else f'sensor {channel.name}'
            if name in seen:
                raise section.error(
                    f'{name} is already read from {seen[name]}; every name can be used once'
                )
            seen[name] = f'device {device.name}'
        if any(device.name == other.name for other in devices):
            raise section.line_error('name', f'another device is called {device.name} too')
        devices.append(device)
    if not any(device.sensors for device in devices):
        raise whole.error('expected at least one device with sensors but none has any')
    return tuple(devices)


def _device(section: Section) -> AnyDevice:
    name = section.text('name')
    section.label = f'device {name}'
    kind = section.word('protocol', tuple(_KINDS))
    return _KINDS[kind](section, name)


def _modbus(section: Section, name: str) -> ModbusDevice:
    host = section.text('host')
    if not _HOST.fullmatch(host):
        raise section.line_error('host', f'expected a name or address but found {host!r}')
    port = section.whole('port', 1, 65535, 502)
    unit = section.whole('unit', 0, 255, 1)
    period, timeout = _times(section)
    channels, has_spindle = _channels(section, _register, 'register')
    section.done()
    return ModbusDevice(
        name=name,
        host=host,
        port=port,
        unit=unit,
        period=period,
        timeout=timeout,
        channels=channels,
        has_spindle=has_spindle,
    )


def _opc_ua(section: Section, name: str) -> OpcUaDevice:
    url = section.text('url')
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(''), None
    if parts.scheme != 'opc.tcp' or not parts.hostname or port is None:
        raise section.line_error(
            'url', f'expected opc.tcp://HOST:PORT/PATH, usual port 4840, but found {url!r}'
        )
    if '@' in parts.netloc:
        raise section.line_error(
            'url', 'expected no user and password here; put them into the file credentials'
        )
    period, timeout = _times(section)
    security = _security(section.section('security'))
    credentials = _file(section, 'credentials') if 'credentials' in section else None
    channels, has_spindle = _channels(section, _variable, 'node')
    section.done()
    return OpcUaDevice(
        name=name,
        url=url,
        security=security,
        credentials=credentials,
        period=period,
        timeout=timeout,
        channels=channels,
        has_spindle=has_spindle,
    )


_KINDS: dict[str, Callable[[Section, str], AnyDevice]] = {
    'modbus_tcp': _modbus,
    'opc_ua': _opc_ua,
}


def _times(section: Section) -> tuple[float, float]:
    period = section.number('period', 0.005, 3600.0, 1.0, unit='s')
    return period, section.number('timeout', 0.05, 60.0, 2.0, unit='s')


def _channels(section: Section, make: Callable[..., Channel], shorthand: str) -> tuple[Any, bool]:
    """Return the channels of a device, the spindle speed last, and whether there is one."""
    channels = []
    for name, entry in section.named('sensors', 'sensor', shorthand, INHERITED):
        channels.append(make(entry, **_scaled(entry, name, 1.0)))
        entry.done()
    spindle = section.section(SPINDLE)
    if spindle is not None:
        unit = SPEED_UNITS[spindle.word('unit', tuple(SPEED_UNITS), 'rpm')]
        channels.append(make(spindle, **_scaled(spindle, SPINDLE, unit)))
        spindle.done()
    if not channels:
        raise section.error('expected sensors, as sensors: {T1: ...}, but found none')
    return tuple(channels), spindle is not None


def _scaled(entry: Section, name: str, unit: float) -> dict[str, Any]:
    """Return the fields that all channels have."""
    scale = entry.number('scale', -1e9, 1e9, 1.0)
    if scale == 0.0:
        raise entry.line_error('scale', 'expected another number than 0')
    return {
        'name': name,
        'scale': unit * scale,
        'offset': unit * entry.number('offset', -1e9, 1e9, 0.0),
        'open_circuit': entry.numbers('open_circuit'),
    }


def _register(entry: Section, **common: Any) -> Register:
    register = Register(
        table=entry.word('table', ('holding', 'input'), 'holding'),
        register=entry.whole(
            'register',
            0,
            65535,
            remedy='count from 0: what manuals call 40001 is register 0 of the table holding, '
            '30001 is register 0 of the table input',
        ),
        type=entry.word('type', tuple(FORMATS), 'int16'),
        word_order=entry.word('word_order', ORDERS, 'big'),
        byte_order=entry.word('byte_order', ORDERS, 'big'),
        **common,
    )
    if register.register + register.count > 65536:
        raise entry.line_error(
            'register', f'a {register.type} does not fit behind {register.register}'
        )
    if not register.type.startswith('float'):
        bits = 16 * register.count
        for code in register.open_circuit:
            if not isinstance(code, int) or not -(2 ** (bits - 1)) <= code < 2**bits:
                raise entry.line_error(
                    'open_circuit',
                    f'expected raw values of a {register.type}, before scale and offset, such '
                    f'as 0x7FFF but found {code}',
                )
    return register


def _variable(entry: Section, **common: Any) -> Variable:
    if ('node' in entry) == ('path' in entry):
        raise entry.error(
            'expected either node, such as ns=2;s=Spindle.T1, or path, such as '
            '0:Objects/2:Spindle/2:T1'
        )
    if 'path' in entry:
        steps = tuple(entry.text('path').strip('/').split('/'))
        wrong = [step for step in steps if not re.fullmatch(r'[0-9]{1,5}:.+', step)]
        if wrong:
            raise entry.line_error(
                'path',
                'expected steps from the root as namespace:name, such as '
                f'0:Objects/2:Spindle/2:T1, but found {wrong[0]!r}',
            )
        return Variable(path=steps, **common)
    node = entry.text('node')
    if not _NODE.fullmatch(node):
        raise entry.line_error(
            'node',
            'expected a node id such as ns=2;s=Spindle.T1, ns=2;i=1001 or nsu=urn:mill;s=T1 but '
            f'found {node!r}',
        )
    return Variable(node=node, **common)


def _security(section: Section | None) -> Security | None:
    if section is None:
        return None
    security = Security(
        policy=section.word('policy', POLICIES),
        mode=section.word('mode', MODES, 'SignAndEncrypt'),
        certificate=_file(section, 'certificate'),
        private_key=_file(section, 'private_key'),
        # Without it any server could pass itself off as this one.
        server_certificate=_file(section, 'server_certificate'),
    )
    section.done()
    return security


def _file(section: Section, name: str) -> Path:
    """Return a file that a field names, relative to the device file."""
    path = section.path.parent / Path(section.text(name)).expanduser()
    if not path.is_file():
        raise section.line_error(name, f'expected a file but nothing is at {path}')
    return path


def read_credentials(path: Path) -> tuple[str, str]:
    """Return user name and password of a credentials file.

    Raises
    ------
    ParameterError
        If others than its owner can read it, or it does not hold the two.
    """
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise ParameterError(f'{path}: expected credentials but: {error.strerror}') from error
    if mode & 0o077:
        raise ParameterError(
            f'{path}: expected a file that only its owner can read; run chmod 600 {path}'
        )
    section = Section.read(path, 'username and password')
    found = section.text('username'), section.text('password')
    section.done()
    return found
