# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""MTConnect agents, and what a file says of them."""

import math
import re
import ssl
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

from fuzzycnc_ros.adapters.opcua.file_fields import File
from fuzzycnc_ros.adapters.readings.device_fields import (
    DeviceFields,
    Scaling,
    SensorFields,
    SpeedFields,
)
from fuzzycnc_ros.adapters.readings.devices import Device, DeviceChannel
from fuzzycnc_ros.adapters.readings.link import Link
from fuzzycnc_ros.adapters.yaml_model import (
    AfterValidator,
    Choice,
    Field,
    Shorthand,
    Text,
    address_of,
    model_validator,
    wrong,
)


class Quantity(Enum):
    """Quantities of data items of an MTConnect agent."""

    TEMPERATURE = 'temperature'
    SPEED = 'speed'
    POSITION = 'position'


@dataclass(frozen=True, kw_only=True)
class DataItemChannel(DeviceChannel):
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

    channels: tuple[DataItemChannel, ...]
    host: str
    port: int
    path: str
    encrypted: bool = False
    ca_file: Path | None = None

    @property
    def address(self) -> str:
        """Address for messages."""
        scheme = 'https' if self.encrypted else 'http'
        return f'MTConnect {scheme}://{self.host}:{self.port}{self.path}'

    def connect(self) -> Link:
        """Return a new link to it."""
        from fuzzycnc_ros.adapters.mtconnect.link import MtconnectLink

        return MtconnectLink(self)


class _ItemFields(Scaling):
    CHANNEL = DataItemChannel

    item: Annotated[str, Text()] = Field(description='Id of the data item, or its name')

    def own(self, names: set[str]) -> dict[str, Any]:
        """Return what the channel has beside what all have."""
        return {'item': self.item}


class _SensorItem(SensorFields, _ItemFields):
    pass


class _SpeedItem(SpeedFields, _ItemFields):
    def channel(self, name: str, unit: float, largest: float = math.inf) -> DeviceChannel:
        """Return the channel; the agent may state the unit."""
        made = super().channel(name, unit, largest)
        return replace(made, unit=unit, quantity=Quantity.SPEED)  # type: ignore[call-arg]


def _agent(text: str) -> str:
    parts = address_of(text, ('http', 'https'))
    if parts is None:
        raise wrong(
            'expected http://HOST:PORT/MACHINE or https://HOST:PORT/MACHINE, usual port 5000, but '
            f'found {text!r}'
        )
    if '@' in parts.netloc:
        raise wrong('expected no user and password in the address of an agent')
    if not re.fullmatch(r'[A-Za-z0-9._~%/-]*', parts.path) or parts.query or parts.fragment:
        raise wrong(f'expected the name of a machine behind the port but found {parts.path!r}')
    return text


class Mtconnect(Scaling, DeviceFields):
    """An MTConnect agent with sensors."""

    INHERITED = tuple(Scaling.model_fields)
    SHORTHAND = 'item'

    protocol: Annotated[str, Choice(('mtconnect',))]
    url: Annotated[str, Text(r'https?://.+'), AfterValidator(_agent)] = Field(
        description='Address, http:// or https://HOST:PORT, and /MACHINE where the agent has '
        'several'
    )
    ca_file: File = Field(
        default_factory=Path,
        description='Certificates of those who may vouch for the agent, PEM; without it those '
        'that the system trusts',
    )
    sensors: dict[str, Annotated[_SensorItem, Shorthand('item')]] = Field(
        {}, description='Sensors by name; a mere text is the id or name of the data item'
    )
    positions: dict[str, Annotated[str, Text()]] = Field(
        {}, description='Id or name of the data item of the position of each axis'
    )
    spindle_speed: _SpeedItem | None = Field(None, description='Spindle speed')

    def axes(self) -> dict[str, DeviceChannel]:
        """Return the channels of axes by the names of these."""
        return {
            name: DataItemChannel(name=f'axis {name}', item=item, quantity=Quantity.POSITION)
            for name, item in self.positions.items()
        }

    @model_validator(mode='after')
    def _check_trust(self) -> 'Mtconnect':
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
