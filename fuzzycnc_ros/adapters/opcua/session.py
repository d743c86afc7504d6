# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A connection to an OPC UA server: security, login, and nodes by id or browse path."""

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from fuzzycnc_ros.adapters.link import LinkError
from fuzzycnc_ros.adapters.opcua.pins import check_pin
from fuzzycnc_ros.bags.secret_file import check_secret

if TYPE_CHECKING:
    from asyncua import Client, ua

NODES_MAX = 100
"""Most nodes in one request; small servers take no more."""
SESSION_TIMEOUT = 60_000
"""Time after which a server forgets a session that it hears nothing of [ms]: a server that had
fallen silent must not run out of sessions while we come back."""
WATCHDOG = 10.0
"""Time between two looks of the library at the server's state [s], if a timeout is not longer;
the library takes a server that needs longer for one for dead."""
REFUSED_PAUSE = 30.0
"""Pause after refused credentials [s]: servers lock users who try too often."""
MESSAGE_MAX, CHUNKS_MAX = 1 << 20, 16
"""Longest message [byte] and most parts of one that a server may send; ours need a hundredth."""
REFUSED_USER = ('BadUserAccessDenied', 'BadIdentityTokenInvalid', 'BadIdentityTokenRejected')
UNKNOWN_NODE = ('BadNodeIdUnknown', 'BadNodeIdInvalid')


@dataclass(frozen=True, kw_only=True)
class Security:
    """Security of the connection to an OPC UA server: names and files."""

    policy: str
    mode: str
    certificate: Path
    private_key: Path
    server_certificate: Path
    pinned: bool
    """True if `server_certificate` is the one that the server showed first, made when it does."""


@dataclass(frozen=True, kw_only=True)
class Server:
    """Address of an OPC UA server, and the credentials for it."""

    url: str
    timeout: float
    """Longest wait for an answer [s]."""
    security: Security | None
    credentials: Path | None


@dataclass(frozen=True, kw_only=True)
class Address:
    """A variable of an OPC UA server: node id, or browse path from the root."""

    node: str = ''
    path: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """The node id or path as it stands in the file."""
        return f'node {self.node}' if self.node else f'path {"/".join(self.path)}'


class AnyServer(Protocol):
    """Settings of a server that a session needs."""

    @property
    def url(self) -> str:
        """Address of the server."""

    @property
    def timeout(self) -> float:
        """Longest wait for an answer [s]."""

    @property
    def security(self) -> Security | None:
        """Security of the connection."""

    @property
    def credentials(self) -> Path | None:
        """File with user name and password."""


class OpcUaSession:
    """One connection to a server; it is opened once and closed once.

    Parameters
    ----------
    server : AnyServer
        Where it is and how it is entered.
    application : str
        What we call ourselves.
    login : callable
        Returns user name and password of a credentials file; raises ValueError.
    """

    def __init__(
        self,
        server: AnyServer,
        application: str,
        login: Callable[[Path], tuple[str, str]],
    ) -> None:
        self._server, self._application, self._login = server, application, login
        self.client = self._new_client()
        self.well = False
        """True if the server still answers: then it is told of the end of the session."""

    def _new_client(self) -> 'Client':
        from asyncua import Client

        server = self._server
        client = Client(
            server.url,
            timeout=server.timeout,
            watchdog_intervall=max(WATCHDOG, server.timeout),
        )
        client.name = self._application
        client.session_timeout = SESSION_TIMEOUT
        client.max_messagesize, client.max_chunkcount = MESSAGE_MAX, CHUNKS_MAX
        return client

    async def open(self) -> None:
        """Connect and log in.

        Raises
        ------
        LinkError
            If the server refuses, shows another certificate than before, or the files of security
            and login are of no use.
        """
        from asyncua import ua

        server = self._server
        if server.credentials is not None:
            try:
                user, password = self._login(server.credentials)
            except ValueError as error:
                raise LinkError(str(error)) from error
            self.client.set_user(user)
            self.client.set_password(password)
        try:
            if server.security is not None:
                if server.security.pinned:
                    # Before anything else is said: a password must not reach a stranger.
                    check_pin(server.security.server_certificate, await self._shown())
                await self._secure(server.security)
            await self.client.connect()
        except ua.UaStatusCodeError as error:
            name = ua.StatusCode(error.code).name
            if name in REFUSED_USER:
                who = server.credentials or 'users without credentials'
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
        self.well = True

    async def close(self) -> None:
        """Say goodbye where that is heard, and let go of everything."""
        if not self.well:
            self.client.disconnect_socket()
        try:
            # Without a socket this only ends what the library runs in the background.
            await self.client.disconnect()
        finally:
            self.client.disconnect_socket()

    async def find(self, addresses: Sequence[Address]) -> 'list[ua.NodeId | str]':
        """Return the node of each address, or why there is none."""
        from asyncua import ua

        namespaces: list[str] = []
        if any(address.node.startswith('nsu=') for address in addresses):
            namespaces = await self.client.get_namespace_array()

        async def find(address: Address) -> 'ua.NodeId | str':
            try:
                return await self._find(address, namespaces)
            except (ua.UaStatusCodeError, LookupError) as error:
                code = getattr(error, 'code', None)
                return unknown(
                    address, ua.StatusCode(code).name if code is not None else str(error)
                )

        return list(await asyncio.gather(*(find(address) for address in addresses)))

    async def _find(self, address: Address, namespaces: Sequence[str]) -> 'ua.NodeId':
        from asyncua import ua

        if address.path:
            root = self.client.nodes.root
            return (await root.get_child(list(address.path))).nodeid
        if not address.node.startswith('nsu='):
            return ua.NodeId.from_string(address.node)
        uri, _, identifier = address.node.removeprefix('nsu=').partition(';')
        if uri not in namespaces:
            raise LookupError(f'no namespace {uri}')
        return ua.NodeId.from_string(f'ns={list(namespaces).index(uri)};{identifier}')

    async def _shown(self) -> bytes:
        """Return the certificate that the server shows to whoever asks, DER."""
        from asyncua import ua
        from asyncua.crypto import security_policies

        security = self._server.security
        assert security is not None
        client = self._new_client()
        endpoint = client.find_endpoint(
            await client.connect_and_get_server_endpoints(),
            getattr(ua.MessageSecurityMode, security.mode),
            getattr(security_policies, f'SecurityPolicy{security.policy}').URI,
        )
        return bytes(endpoint.ServerCertificate or b'')

    async def _secure(self, security: Security) -> None:
        """Set policy, mode and certificates."""
        from asyncua import ua
        from asyncua.crypto import security_policies, uacrypto
        from cryptography import x509

        client = self.client
        try:
            check_secret(security.private_key, 'private_key')
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


def node_id_trouble(address: Address) -> str:
    """Say why the node id of an address is none; empty if it is one, or a path."""
    from asyncua import ua

    if not address.node:
        return ''
    try:
        ua.NodeId.from_string(address.node)
    except ua.UaError:
        return f'expected a node id but found {address.node!r}'
    return ''


def unknown(address: Address, why: str) -> str:
    """Return what is told of an address that a server does not have."""
    return (
        f'{address.place}: the server has no such node ({why}); compare it with the address space '
        'of the server'
    )


def library_trouble() -> str:
    """Say that the library is missing; empty if it is there."""
    try:
        import asyncua  # noqa: F401
    except ImportError as error:
        return f"OPC UA needs asyncua ({error}); run pip install 'fuzzycnc_ros[opcua]'"
    return ''


def value_of(data: Any) -> Any:
    """Return the value in what a server sent of a variable; None if there is none."""
    return data.Value.Value if data.Value is not None else None
