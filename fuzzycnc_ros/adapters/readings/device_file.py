# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The file that says which devices there are, and where each of their values lies.

docs/how-to/your-sensors.md describes it with examples.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, Union

from fuzzycnc_ros.adapters.opcua.file_fields import pin_folder
from fuzzycnc_ros.adapters.readings.device_fields import DeviceFields
from fuzzycnc_ros.adapters.readings.devices import SPINDLE, Device
from fuzzycnc_ros.adapters.yaml_model import (
    NO_FIELDS,
    BeforeValidator,
    Discriminator,
    Field,
    Fields,
    Tag,
    model_validator,
    read_file,
    wrong,
)

DRIVERS = {
    'modbus_tcp': 'modbus.devices:ModbusTcp',
    'modbus_rtu': 'modbus.devices:ModbusRtu',
    'opc_ua': 'opcua.readings_device:OpcUa',
    'mtconnect': 'mtconnect.device:Mtconnect',
    'linuxcnc_hal': 'linuxcnc.hal_readings:HalFields',
    'lines': 'readings.lines:LineFields',
    'one_wire': 'readings.one_wire:OneWireFields',
    'mqtt': 'mqtt.readings:MqttFields',
    'moonraker': 'readings.moonraker:MoonrakerFields',
}
"""Module below `fuzzycnc_ros.adapters`, and class, of the fields of each protocol."""


def _check_protocol(data: Any) -> Any:
    if not isinstance(data, dict):
        raise wrong(NO_FIELDS)
    for name in ('name', 'protocol'):
        if name not in data:
            raise wrong(f'expected the field {name!r} but it is missing')
    node = data['protocol']
    if isinstance(node, (dict, list)) or node.value not in DRIVERS:
        found = 'a list or fields' if isinstance(node, (dict, list)) else repr(node.value)
        raise wrong(f'expected one of {", ".join(DRIVERS)} but found {found}', 'protocol')
    return data


def _list(data: Any) -> Any:
    if not isinstance(data, list) or not data:
        raise wrong('expected a list, each item with a dash, of device')
    return data


def _fields(place: str) -> type[DeviceFields]:
    module, _, name = place.partition(':')
    found: type[DeviceFields] = getattr(import_module(f'fuzzycnc_ros.adapters.{module}'), name)
    return found


if TYPE_CHECKING:
    _AnyDevice: TypeAlias = DeviceFields
else:
    _AnyDevice = Annotated[
        Annotated[
            Union[tuple(Annotated[_fields(p), Tag(f'<{name}>')] for name, p in DRIVERS.items())],  # noqa: UP007
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
        for index, device in enumerate(self.devices):
            spindle = [f'the {SPINDLE}'] if device.spindle is not None else []
            axes = [f'axis {name}' for name in device.axes()]
            for name in [*(f'sensor {name}' for name in device.measured), *axes, *spindle]:
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
            for other in self.devices[:index]:
                if text := device.clash(other):
                    raise wrong(text, 'devices', index, 'port')
        if not any(device.measured for device in self.devices):
            raise wrong('expected at least one device with sensors but none has any')
        return self


def read_devices(path: Path, state_directory: str = '') -> tuple[Device, ...]:
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
