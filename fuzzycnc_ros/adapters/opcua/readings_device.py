# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""OPC UA servers with sensors, and what a file says of them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from fuzzycnc_ros.adapters.opcua.file_fields import PlaceFields, ServerFields, read_credentials
from fuzzycnc_ros.adapters.opcua.session import Address, Server, library_trouble, node_id_trouble
from fuzzycnc_ros.adapters.readings.device_fields import (
    CONVERSION,
    Conversion,
    DeviceFields,
    Scaling,
    SensorFields,
    SpeedFields,
)
from fuzzycnc_ros.adapters.readings.devices import Device, DeviceChannel
from fuzzycnc_ros.adapters.readings.link import Link
from fuzzycnc_ros.adapters.yaml_model import Choice, Field, Shorthand
from fuzzycnc_ros.ros.parameters import ParameterError


@dataclass(frozen=True, kw_only=True)
class Variable(DeviceChannel, Address):
    """A value in a variable of an OPC UA server."""


@dataclass(frozen=True, kw_only=True)
class OpcUaDevice(Device, Server):
    """An OPC UA server with sensors."""

    channels: tuple[Variable, ...]

    @property
    def address(self) -> str:
        """Address for messages."""
        return f'OPC UA {self.url}'

    def connect(self) -> Link:
        """Return a new link to it."""
        from fuzzycnc_ros.adapters.opcua.readings_link import OpcUaLink

        return OpcUaLink(self)

    def check(self) -> None:
        """Refuse to begin without the library, with a node id or credentials of no use."""
        if library_trouble():
            raise ParameterError(f'device {self.name}: {library_trouble()}')
        for channel in self.channels:
            trouble = node_id_trouble(channel)
            if trouble:
                raise ParameterError(f'device {self.name}, sensor {channel.name}: {trouble}')
        if self.credentials is not None:
            read_credentials(self.credentials)


class _SensorVariable(SensorFields, PlaceFields, Conversion):
    CHANNEL = Variable


class _SpeedVariable(SpeedFields, PlaceFields, Scaling):
    CHANNEL = Variable


class OpcUa(Conversion, ServerFields, DeviceFields):
    """An OPC UA server with sensors."""

    INHERITED = CONVERSION
    SHORTHAND = 'node'

    protocol: Annotated[str, Choice(('opc_ua',))]
    sensors: dict[str, Annotated[_SensorVariable, Shorthand('node')]] = Field(
        {}, description='Sensors by name; a mere text is the node id'
    )
    spindle_speed: _SpeedVariable | None = Field(None, description='Spindle speed')

    def device(self, folder: Path) -> OpcUaDevice:
        """Return the device."""
        return OpcUaDevice(**self.values(), **vars(self.server(folder)))
