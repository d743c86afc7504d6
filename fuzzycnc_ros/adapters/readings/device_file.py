# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file that says which devices there are, and where each of their values lies.

docs/temperature-drivers.md describes it with examples.
"""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fuzzycnc_ros.adapters.opcua.file_fields import read_address, read_server
from fuzzycnc_ros.adapters.readings.devices import (
    FORMATS,
    SPINDLE,
    AnyDevice,
    Channel,
    ModbusDevice,
    OpcUaDevice,
    Register,
    Variable,
)
from fuzzycnc_ros.adapters.yaml_section import Section

ORDERS = ('big', 'little')
SPEED_UNITS = {'rpm': 2.0 * math.pi / 60.0, 'rad/s': 1.0}
INHERITED = ('table', 'type', 'word_order', 'byte_order', 'scale', 'offset', 'open_circuit')
"""Fields that a device may give for all of its sensors."""

_HOST = re.compile(r'[A-Za-z0-9._:%-]+')


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
    whole = Section.read(path, 'a file of devices')
    devices: list[AnyDevice] = []
    sections = whole.sections('devices', 'device')
    whole.done()
    seen: dict[str, str] = {}
    for section in sections:
        device = _device(section, state_directory)
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


def _device(section: Section, state_directory: str) -> AnyDevice:
    name = section.text('name')
    section.label = f'device {name}'
    kind = section.word('protocol', tuple(_KINDS))
    return _KINDS[kind](section, name, state_directory)


def _modbus(section: Section, name: str, state_directory: str) -> ModbusDevice:
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


def _opc_ua(section: Section, name: str, state_directory: str) -> OpcUaDevice:
    period, _ = _times(section)
    server = read_server(section, state_directory)
    channels, has_spindle = _channels(section, _variable, 'node')
    section.done()
    return OpcUaDevice(
        name=name, period=period, channels=channels, has_spindle=has_spindle, **vars(server)
    )


_KINDS: dict[str, Callable[[Section, str, str], AnyDevice]] = {
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
        # Without one any finite speed counts.
        largest = spindle.number('max', 0.0, 1e6, math.inf) * unit
        channels.append(make(spindle, **_scaled(spindle, SPINDLE, unit), largest=largest))
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
    return Variable(**vars(read_address(entry)), **common)
