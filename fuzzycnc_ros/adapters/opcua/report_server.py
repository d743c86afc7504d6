# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Serves the report of a machine over OPC UA, to be read and not written, in its own thread."""

import concurrent.futures
import hmac
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from fuzzycnc_ros.adapters.loops import LoopThread
from fuzzycnc_ros.adapters.opcua.session import library_trouble
from fuzzycnc_ros.components.report.reported_values import NO_VALUE, TOO_OLD, ReportedValue, told
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.component import Health, Level

NAMESPACE = 'urn:fuzzycnc:report'
APPLICATION = 'urn:fuzzycnc:report:server'
MESSAGE_MAX = 1 << 20
"""Longest message that a client may send, in bytes."""
BUFFER = 65535
"""Longest chunk of a message, in bytes."""
START_TIMEOUT, CLOSE_TIMEOUT = 60.0, 5.0
"""Longest wait for the start of the library, and for its end [s]."""
TAKE_TIMEOUT = 2.0
"""Longest wait until a report is written [s]."""
ALARMS = 'alarms'


@dataclass(frozen=True)
class ServerAccess:
    """Access to a server from other computers.

    Parameters
    ----------
    certificate, private_key : Path
        Its own certificate and key.
    username, password : str
        Who may read.
    """

    certificate: Path
    private_key: Path
    username: str
    password: str


class ReportServer:
    """Hold the newest values of a machine for clients.

    Parameters
    ----------
    machine : str
        Name of the machine, which node ids begin with.
    address : str
        Address to listen on.
    port : int
        TCP port; 0 takes a free one.
    age_max : float
        Age [s] beyond which a value has a bad status.
    entry : ServerAccess, optional
        How it is entered; None: by anybody, not encrypted.

    Raises
    ------
    ParameterError
        If the library is missing, the port cannot be had, or a certificate is of no use.
    """

    def __init__(
        self,
        machine: str,
        address: str,
        port: int,
        age_max: float,
        entry: ServerAccess | None = None,
    ) -> None:
        if library_trouble():
            raise ParameterError(library_trouble())
        # What it has to say is in the health, in the operator's words.
        logging.getLogger('asyncua').setLevel(logging.CRITICAL + 1)
        self._machine, self._address, self.port = machine, address, port
        self._age_max, self._entry = age_max, entry
        self._nodes: dict[tuple[str, str], Any] = {}
        self._folders: dict[str, Any] = {}
        self._trouble = ''
        self._loop = LoopThread('opcua')
        try:
            self._loop.call(self._start(), START_TIMEOUT)
        except OSError as error:
            self._loop.end(CLOSE_TIMEOUT)
            raise ParameterError(
                f'expected a free port on {address} and files that can be read but: {error}'
            ) from error
        except Exception as error:
            self._loop.end(CLOSE_TIMEOUT)
            raise ParameterError(f'OPC UA cannot be served ({error})') from error

    def publish(self, document: Mapping[str, Any]) -> None:
        """Take a report."""
        try:
            self._loop.call(self._take(document), TAKE_TIMEOUT)
            self._trouble = ''
        except concurrent.futures.TimeoutError:
            self._trouble = f'a report took longer than {TAKE_TIMEOUT:g} s; too many clients?'

    def health(self) -> Health:
        """Say how it is entered and how much it holds."""
        how = 'encrypted, with a user' if self._entry else 'open to this computer'
        text = f'OPC UA {self._address}:{self.port}: {how}'
        if self._trouble:
            return Health('server', Level.WARN, self._trouble)
        return Health('server', Level.OK, text, {'variables': str(len(self._nodes))})

    def close(self) -> None:
        """Drop all clients and end the thread."""
        try:
            self._loop.call(self._server.stop(), CLOSE_TIMEOUT)
        finally:
            self._loop.end(CLOSE_TIMEOUT)

    async def _start(self) -> None:
        from asyncua import Server
        from asyncua.common.connection import TransportLimits

        ua = _library()
        server: Any = Server()
        self._server = server
        server.limits = TransportLimits(BUFFER, BUFFER, MESSAGE_MAX // BUFFER + 1, MESSAGE_MAX)
        await server.init()
        await server.set_application_uri(APPLICATION)
        server.set_server_name('fuzzycnc')
        server.set_endpoint(f'opc.tcp://{self._address}:{self.port}/')
        server.iserver.user_manager = Readers(self._entry)
        if self._entry is None:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
            server.set_identity_tokens([ua.AnonymousIdentityToken])
        else:
            server.set_security_policy(
                [
                    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
                    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
                ]
            )
            server.set_identity_tokens([ua.UserNameIdentityToken])
            await server.load_certificate(str(self._entry.certificate))
            await server.load_private_key(str(self._entry.private_key))
        self._index = await server.register_namespace(NAMESPACE)
        node_id = ua.NodeId(self._machine, self._index)
        self._root = await server.nodes.objects.add_object(
            node_id, f'{self._index}:{self._machine}'
        )
        self._alarms = ua.NodeId(f'{self._machine}/{ALARMS}', self._index)
        empty = ua.Variant([], ua.VariantType.String, is_array=True)
        await self._root.add_variable(self._alarms, f'{self._index}:{ALARMS}', empty)
        await server.start()
        self.port = server.bserver._server.sockets[0].getsockname()[1]

    async def _take(self, document: Mapping[str, Any]) -> None:
        ua = _library()
        now = datetime.fromisoformat(document['time'])
        missing = dict(self._nodes)
        for item in told(document, self._age_max):
            place = (item.kind, item.name)
            missing.pop(place, None)
            if place not in self._nodes:
                self._nodes[place] = await self._add(item)
            await self._write(self._nodes[place], item.value, item.trouble, now)
        for node in missing.values():
            await self._write(node, None, NO_VALUE, now)
        alarms = [
            f'{alarm["level"]}: {alarm["node"]}: {alarm["name"]}: {alarm["text"]}'
            for alarm in document['alarms']
        ]
        value = ua.DataValue(
            ua.Variant(alarms, ua.VariantType.String, is_array=True), SourceTimestamp=now
        )
        await self._server.write_attribute_value(self._alarms, value)

    async def _add(self, item: ReportedValue) -> Any:
        """Add a variable; its id is made of names alone, so that it is the same at every start."""
        ua = _library()
        parent, place = self._root, f'{self._machine}/{item.kind}'
        if item.name:
            if item.kind not in self._folders:
                self._folders[item.kind] = await self._root.add_folder(
                    ua.NodeId(place, self._index), f'{self._index}:{item.kind}'
                )
            parent, place = self._folders[item.kind], f'{place}/{item.name}'
        node_id = ua.NodeId(place, self._index)
        name = ua.QualifiedName(item.name or item.kind, self._index)
        made = await parent.add_variable(node_id, name, 0.0, ua.VariantType.Double)
        text = ua.LocalizedText(f'{item.kind} {item.name} [{item.unit}]'.replace('  ', ' '))
        await made.write_attribute(ua.AttributeIds.Description, ua.DataValue(ua.Variant(text)))
        return node_id

    async def _write(self, node: Any, value: float | None, trouble: str, now: datetime) -> None:
        ua = _library()
        codes = {
            '': ua.StatusCodes.Good,
            NO_VALUE: ua.StatusCodes.BadNoData,
            TOO_OLD: ua.StatusCodes.BadNoCommunication,
        }
        status = ua.StatusCode(ua.UInt32(codes.get(trouble, ua.StatusCodes.BadSensorFailure)))
        held = ua.Variant() if value is None else ua.Variant(value, ua.VariantType.Double)
        data = ua.DataValue(held, StatusCode=status, SourceTimestamp=now)
        await self._server.write_attribute_value(node, data)


class Readers:
    """Everybody who may enter reads; nobody has the rights of an administrator, who may write."""

    def __init__(self, entry: ServerAccess | None) -> None:
        self._entry = entry

    def get_user(
        self, iserver: Any, username: Any = None, password: Any = None, certificate: Any = None
    ) -> Any:
        """Return who enters, None if that is not allowed."""
        from asyncua.server.user_managers import User, UserRole

        if self._entry is None:
            return User(role=UserRole.User, name='reader')
        pairs = ((username, self._entry.username), (password, self._entry.password))
        same = [hmac.compare_digest(_raw(given), _raw(wanted)) for given, wanted in pairs]
        return User(role=UserRole.User, name=username) if all(same) else None


def _library() -> Any:
    """Return the types of OPC UA; loaded on use, since most nodes do without."""
    from asyncua import ua

    return ua


def _raw(text: str | bytes | None) -> bytes:
    return text if isinstance(text, bytes) else (text or '').encode()
