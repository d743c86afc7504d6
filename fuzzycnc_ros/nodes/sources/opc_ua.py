# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A connection to an OPC UA server."""

import asyncio
import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from fuzzycnc_ros.nodes.parameters import ParameterError
from fuzzycnc_ros.nodes.sources.device_file import (
    OpcUaDevice,
    Security,
    Variable,
    read_credentials,
)
from fuzzycnc_ros.nodes.sources.link import LinkError, Reading
from fuzzycnc_ros.nodes.sources.registers import scaled

if TYPE_CHECKING:
    from asyncua import ua

NODES_MAX = 100
"""Most nodes in one request; small servers take no more."""
SESSION_TIMEOUT = 60_000
"""Time after which a server forgets a session that it hears nothing of [ms]: a server that had
fallen silent must not run out of sessions while we come back."""
WATCHDOG = 10.0
"""Time between two looks of the library at the server's state [s], if a timeout is not longer;
the library takes a server that needs longer for one for dead."""
RESOLVE_AGAIN = 2.0
"""Time between two looks for nodes that a server does not have [s]: some fill up after their
start."""
REFUSED_PAUSE = 30.0
"""Pause after refused credentials [s]: servers lock users who try too often."""
MESSAGE_MAX, CHUNKS_MAX = 1 << 20, 16
"""Longest message [byte] and most parts of one that a server may send; ours need a hundredth."""
REFUSED_USER = ('BadUserAccessDenied', 'BadIdentityTokenInvalid', 'BadIdentityTokenRejected')
UNKNOWN_NODE = ('BadNodeIdUnknown', 'BadNodeIdInvalid')


def check(device: OpcUaDevice) -> None:
    """Check what only this protocol can check of a device of the file.

    Raises
    ------
    ParameterError
        If its library is missing, or a node id or the credentials are of no use.
    """
    try:
        from asyncua import ua
    except ImportError as error:
        raise ParameterError(
            f'device {device.name}: OPC UA needs asyncua ({error}); run pip install '
            "'fuzzycnc_ros[opcua]'"
        ) from error
    for channel in device.channels:
        if not channel.node:
            continue
        try:
            ua.NodeId.from_string(channel.node)
        except ua.UaError as error:
            raise ParameterError(
                f'device {device.name}, sensor {channel.name}: expected a node id but found '
                f'{channel.node!r}'
            ) from error
    if device.credentials is not None:
        read_credentials(device.credentials)


class OpcUaLink:
    """One connection to an OPC UA server.

    Parameters
    ----------
    device : OpcUaDevice
        Where it is and which variables to read.
    """

    def __init__(self, device: OpcUaDevice) -> None:
        from asyncua import Client

        self._device = device
        client = Client(
            device.url,
            timeout=device.timeout,
            watchdog_intervall=max(WATCHDOG, device.timeout),
        )
        client.name = 'fuzzycnc temperature_acquisition'
        client.session_timeout = SESSION_TIMEOUT
        client.max_messagesize, client.max_chunkcount = MESSAGE_MAX, CHUNKS_MAX
        self._client = client
        self._node: list[ua.NodeId | None] = [None] * len(device.channels)
        self._missing: list[str] = [''] * len(device.channels)
        self._resolve_at = 0.0
        self._well = False

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes."""
        return -(-len(self._node) // NODES_MAX)

    async def open(self) -> None:
        """Connect, log in and find the nodes."""
        from asyncua import ua

        device = self._device
        if device.security is not None:
            await self._secure(device.security)
        if device.credentials is not None:
            try:
                user, password = read_credentials(device.credentials)
            except ParameterError as error:
                raise LinkError(str(error)) from error
            self._client.set_user(user)
            self._client.set_password(password)
        try:
            await self._client.connect()
        except ua.UaStatusCodeError as error:
            name = ua.StatusCode(error.code).name
            if name in REFUSED_USER:
                who = device.credentials or 'users without credentials'
                raise LinkError(f'the server refuses {who} ({name})', REFUSED_PAUSE) from error
            raise LinkError(
                f'the server refuses the connection ({name}); compare security and certificates '
                'with its settings'
            ) from error
        except ua.UaError as error:
            raise LinkError(
                f'the server does not offer this connection ({error}); compare security with its '
                'settings'
            ) from error
        self._well = True
        await self._resolve()

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel."""
        from asyncua import ua

        if None in self._node and asyncio.get_running_loop().time() >= self._resolve_at:
            await self._resolve()
        found: list[Reading] = list(self._missing)
        known = [(index, node) for index, node in enumerate(self._node) if node is not None]
        try:
            for start in range(0, len(known), NODES_MAX):
                part = known[start : start + NODES_MAX]
                nodes = [self._client.get_node(node) for _, node in part]
                values = await self._client.read_attributes(nodes)
                if len(values) != len(part):
                    raise LinkError(
                        f'expected {len(part)} values but the server sent {len(values)}'
                    )
                for (index, _), value in zip(part, values, strict=True):
                    found[index] = reading_of(self._device.channels[index], value)
        except ua.UaStatusCodeError as error:
            name = ua.StatusCode(error.code).name
            raise LinkError(f'the server refuses to be read ({name})') from error
        except Exception:
            self._well = False
            raise
        return found

    async def close(self) -> None:
        """Say goodbye where that is heard, and let go of everything."""
        if not self._well:
            self._client.disconnect_socket()
        try:
            # Without a socket this only ends what the library runs in the background.
            await self._client.disconnect()
        finally:
            self._client.disconnect_socket()

    async def _secure(self, security: Security) -> None:
        """Set policy, mode and certificates."""
        from asyncua import ua
        from asyncua.crypto import security_policies, uacrypto
        from cryptography import x509

        client = self._client
        try:
            own = await uacrypto.load_certificate(security.certificate)
            # Servers compare the name in the certificate with the one that we tell.
            with contextlib.suppress(x509.ExtensionNotFound, IndexError):
                names = own.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
                kind = x509.UniformResourceIdentifier
                client.application_uri = names.get_values_for_type(kind)[0]
            await client.set_security(
                getattr(security_policies, f'SecurityPolicy{security.policy}'),
                str(security.certificate),
                str(security.private_key),
                server_certificate=str(security.server_certificate),
                mode=getattr(ua.MessageSecurityMode, security.mode),
            )
        except (ValueError, TypeError, OSError, ua.UaError) as error:
            raise LinkError(f'the certificates cannot be used: {error}') from error

    async def _resolve(self) -> None:
        """Find the nodes that are not known yet; say of the others why not."""
        from asyncua import ua

        self._resolve_at = asyncio.get_running_loop().time() + RESOLVE_AGAIN
        open_ones = [index for index, node in enumerate(self._node) if node is None]
        namespaces: list[str] = []
        if any(self._device.channels[index].node.startswith('nsu=') for index in open_ones):
            namespaces = await self._client.get_namespace_array()

        async def find(index: int) -> None:
            channel = self._device.channels[index]
            try:
                self._node[index] = await self._find(channel, namespaces)
                self._missing[index] = ''
            except (ua.UaStatusCodeError, LookupError) as error:
                code = getattr(error, 'code', None)
                why = ua.StatusCode(code).name if code is not None else str(error)
                self._missing[index] = _unknown(channel, why)

        await asyncio.gather(*(find(index) for index in open_ones))

    async def _find(self, channel: Variable, namespaces: Sequence[str]) -> 'ua.NodeId':
        from asyncua import ua

        if channel.path:
            root = self._client.nodes.root
            return (await root.get_child(list(channel.path))).nodeid
        if not channel.node.startswith('nsu='):
            return ua.NodeId.from_string(channel.node)
        uri, _, identifier = channel.node.removeprefix('nsu=').partition(';')
        if uri not in namespaces:
            raise LookupError(f'no namespace {uri}')
        return ua.NodeId.from_string(f'ns={list(namespaces).index(uri)};{identifier}')


def reading_of(channel: Variable, data: Any) -> Reading:
    """Return the quantity that a server sent for a variable, or why there is none."""
    status = data.StatusCode
    if status is not None and not status.is_good():
        if status.name in UNKNOWN_NODE:
            return _unknown(channel, status.name)
        return f'{channel.place}: the server reports {status.name}'
    raw = data.Value.Value if data.Value is not None else None
    if isinstance(raw, bool) or not isinstance(raw, (int, float)):
        text = repr(raw)
        shown = text if len(text) <= 40 else f'{text[:40]}...'
        return f'{channel.place}: expected a number but the variable holds {shown}'
    if raw in channel.open_circuit:
        return f'open circuit (raw value {raw})'
    return scaled(channel.scale, channel.offset, raw)


def _unknown(channel: Variable, why: str) -> str:
    return (
        f'{channel.place}: the server has no such node ({why}); compare it with the address space '
        'of the server'
    )
