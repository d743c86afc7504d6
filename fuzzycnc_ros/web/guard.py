# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Access rules of the page: hosts, origins, the token, and the rights of browsers."""

import ipaddress
import socket
from collections.abc import Collection, MutableMapping
from hmac import compare_digest
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fuzzycnc_ros.runtime.addresses import is_loopback

HEADERS = {
    'Content-Security-Policy': (
        "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'; "
        "object-src 'none'"
    ),
    'X-Content-Type-Options': 'nosniff',
    'Referrer-Policy': 'no-referrer',
    'X-Frame-Options': 'DENY',
    'Cross-Origin-Opener-Policy': 'same-origin',
    'Cross-Origin-Resource-Policy': 'same-origin',
}
"""Headers of every answer to browsers."""
REFUSED = 1008
"""Close code of a WebSocket that the rules refuse."""


def refused(status: int, says: str, **more: Any) -> Response:
    """Return an answer that says why something is not done, and what to do."""
    return JSONResponse({'done': False, 'says': says, **more}, status)


class Guard:
    """Let through what comes from the page itself, and give each answer its headers.

    A page of another site can have a browser send requests here, and by its own DNS server even
    under a name of its own.  So the name must be one of this computer's, and the origin this page.

    Parameters
    ----------
    app : ASGI application
        What is guarded.
    address : str
        Where the server listens.
    hosts : collection of str
        Further names that this computer is called by.
    """

    def __init__(self, app: ASGIApp, *, address: str, hosts: Collection[str] = ()) -> None:
        self._app = app
        self._loopback = is_loopback(address)
        own = () if self._loopback else (socket.gethostname(), f'{socket.gethostname()}.local')
        self._names = {name.lower() for name in ('localhost', *own, *hosts)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope['type'] not in ('http', 'websocket'):
            await self._app(scope, receive, send)
            return
        doubt = self.doubt(Headers(scope=scope), scope['scheme'])

        async def sending(message: Message) -> None:
            if message['type'] == 'http.response.start':
                _add_headers(message)
            await send(message)

        if not doubt:
            await self._app(scope, receive, sending)
        elif scope['type'] == 'http':
            await refused(403, doubt)(scope, receive, sending)
        else:
            await send({'type': 'websocket.close', 'code': REFUSED, 'reason': doubt[:100]})

    def doubt(self, headers: Headers, scheme: str) -> str:
        """Say why a request is not served; empty if it is."""
        hosts = headers.getlist('host')
        if len(hosts) != 1 or not self._known(hosts[0]):
            return (
                'Host: expected a name of this computer; open the page by its address, or add '
                'the name to the parameter hosts of dashboard'
            )
        origins = headers.getlist('origin')
        page = 'https' if scheme in ('https', 'wss') else 'http'
        if origins and origins != [f'{page}://{hosts[0]}']:
            return 'Origin: expected this page itself; pages of others are not let in'
        return ''

    def _known(self, host: str) -> bool:
        try:
            name = urlsplit(f'//{host}').hostname or ''
        except ValueError:
            return False
        if name in self._names:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        # A number cannot be pointed elsewhere by a DNS server.
        return address.is_loopback or not self._loopback


def _add_headers(message: MutableMapping[str, Any]) -> None:
    headers = MutableHeaders(scope=message)
    for name, value in HEADERS.items():
        headers.setdefault(name, value)  # an answer may be stricter
    headers.setdefault('Cache-Control', 'no-store')


class Token:
    """Token of those who may act.

    Parameters
    ----------
    secret : str
        The token; empty if none is demanded.
    """

    def __init__(self, secret: str = '') -> None:
        self._secret = secret.encode()

    @property
    def demanded(self) -> bool:
        """True if acting needs it."""
        return bool(self._secret)

    def shown(self, headers: Headers) -> bool:
        """Return True if a request shows it, or need not; compared in constant time."""
        kind, _, given = headers.get('authorization', '').partition(' ')
        same = compare_digest(given.strip().encode(), self._secret)
        return not self.demanded or (kind.lower() == 'bearer' and same)
