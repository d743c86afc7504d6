# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A connection to an OPC UA server."""

import asyncio
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.adapters.opcua.file_fields import read_credentials
from fuzzycnc_ros.adapters.opcua.readings_device import OpcUaDevice, Variable
from fuzzycnc_ros.adapters.opcua.session import (
    MESSAGE_MAX,
    NODES_MAX,
    UNKNOWN_NODE,
    OpcUaSession,
    unknown,
    value_of,
)
from fuzzycnc_ros.adapters.readings.link import Link, LinkError, Reading
from fuzzycnc_ros.adapters.readings.plausible_value import reading_of as reading

if TYPE_CHECKING:
    from asyncua import ua

TOO_LARGE = (
    'BadRequestTooLarge',  # what the library calls any message beyond our own limit
    'BadResponseTooLarge',
    'BadTcpMessageTooLarge',
)
RESOLVE_AGAIN = 2.0
"""Time between two looks for nodes that a server does not have [s]: some fill up after their
start."""


class OpcUaLink(Link):
    """One connection to an OPC UA server.

    Parameters
    ----------
    device : OpcUaDevice
        Where it is and which variables to read.
    """

    def __init__(self, device: OpcUaDevice) -> None:
        self._device = device
        self._session = OpcUaSession(device, 'fuzzycnc temperature_acquisition', read_credentials)
        self._node: list[ua.NodeId | None] = [None] * len(device.channels)
        self._missing: list[str] = [''] * len(device.channels)
        self._resolve_at = 0.0

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes."""
        return -(-len(self._node) // NODES_MAX)

    async def open(self) -> None:
        """Connect, log in and find the nodes."""
        await self._session.open()
        await self._resolve()

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel."""
        from asyncua import ua

        if None in self._node and asyncio.get_running_loop().time() >= self._resolve_at:
            await self._resolve()
        found: list[Reading] = list(self._missing)
        known = [(index, node) for index, node in enumerate(self._node) if node is not None]
        client = self._session.client
        try:
            for start in range(0, len(known), NODES_MAX):
                part = known[start : start + NODES_MAX]
                nodes = [client.get_node(node) for _, node in part]
                values = await client.read_attributes(nodes)
                if len(values) != len(part):
                    raise LinkError(
                        f'expected {len(part)} values but the server sent {len(values)}'
                    )
                for (index, _), value in zip(part, values, strict=True):
                    found[index] = reading_of(self._device.channels[index], value)
        except ua.UaStatusCodeError as error:
            name = ua.StatusCode(error.code).name
            if name in TOO_LARGE:
                raise LinkError(
                    f'expected numbers but an answer is larger than {MESSAGE_MAX >> 20} MiB '
                    f'({name}): one of the nodes holds a long text or list; look at each with a '
                    'browser for OPC UA'
                ) from error
            if name.startswith('BadSession'):
                raise LinkError(f'the server has ended the session ({name})') from error
            raise LinkError(f'the server refuses to be read ({name})') from error
        except Exception:
            self._session.well = False
            raise
        return found

    async def close(self) -> None:
        """Say goodbye where that is heard, and let go of everything."""
        await self._session.close()

    async def _resolve(self) -> None:
        """Find the nodes that are not known yet; say of the others why not."""
        self._resolve_at = asyncio.get_running_loop().time() + RESOLVE_AGAIN
        open_ones = [index for index, node in enumerate(self._node) if node is None]
        found = await self._session.find([self._device.channels[index] for index in open_ones])
        for index, node in zip(open_ones, found, strict=True):
            if isinstance(node, str):
                self._missing[index] = node
            else:
                self._node[index], self._missing[index] = node, ''


def reading_of(channel: Variable, data: Any) -> Reading:
    """Return the quantity that a server sent for a variable, or why there is none."""
    status = data.StatusCode
    if status is not None and not status.is_good():
        if status.name in UNKNOWN_NODE:
            return unknown(channel, status.name)
        return f'{channel.place}: the server reports {status.name}'
    remedy = 'is it the right variable, and the right scale?'
    return reading(channel, value_of(data), channel.place, remedy, 'the variable holds')
