# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Connections of the page's server: few enough, and none that only holds its place."""

import asyncio
import re
from typing import Any

from uvicorn.config import Config
from uvicorn.protocols.http import h11_impl
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

h11: Any = h11_impl.h11
"""The parser of HTTP that uvicorn brings along."""
HEADERS_MAX = 16384
"""Largest head of a request [bytes]."""
SOCKETS_MAX = 400
"""Connections that are open at once; what comes then is closed unheard."""
HEADERS_WITHIN = 5.0
"""Time [s] that a client has to say what it wants."""
STALLED = 20.0
"""Time [s] in which a client must take something of what it is sent, or send what it owes."""


LAST_WORDS = 2.0
"""Time [s] in which a client must take what it was sent before its socket was closed."""


_TORN = re.compile(rb'(?<!\r)\n|\r(?!\n|\Z)|\n[ \t]')
"""A line of a head that ends in another way than it should, or goes on in the next."""
_FRAMING = (b'content-length', b'transfer-encoding')


class StrictConnection(h11.Connection):
    """A connection that refuses heads which others may read in another way.

    A proxy before this server that takes another length of a body for the right one would let a
    second request pass that it has not seen (RFC 9112, 6.1 and 11.2).
    """

    def next_event(self) -> Any:
        """Return what comes next, as h11 does.

        Raises
        ------
        RemoteProtocolError
            If the head of a request can be read in two ways.
        """
        if self.their_state is h11.IDLE:
            head, whole, _ = self.trailing_data[0].partition(b'\r\n\r\n')
            if _TORN.search(head) or (whole and _ambiguous(head)):
                raise h11.RemoteProtocolError('a head that can be read in two ways')
        return super().next_event()


def _ambiguous(head: bytes) -> bool:
    """Return whether a whole head leaves open where its body ends, or what its body is."""
    first, *lines = head.split(b'\r\n')
    parts = [line.partition(b':') for line in lines]
    fields = [(name.strip().lower(), value) for name, _, value in parts]
    framing = [(name, value) for name, value in fields if name in _FRAMING]
    if not framing:
        return False
    name, value = framing[0]
    upgraded = any(name == b'upgrade' for name, _ in fields)
    old = first.rstrip().endswith(b'HTTP/1.0') and name == b'transfer-encoding'
    return len(framing) > 1 or b',' in value or upgraded or old


class WatchedConnection(H11Protocol):
    """A connection that is closed if its client is slow to speak or to listen."""

    open = 0
    """Number of connections in this process, WebSockets apart."""

    def __init__(self, config: Config, *rest: Any, **more: Any) -> None:
        super().__init__(config, *rest, **more)
        self.conn = StrictConnection(h11.SERVER, HEADERS_MAX)

    def connection_made(self, transport: Any) -> None:
        """Take a connection, or close it where there are enough."""
        super().connection_made(transport)
        WatchedConnection.open += 1
        self._counted = True
        self._moved_at = self.loop.time()
        self._unsent = 0
        self._watch: asyncio.TimerHandle | None = None
        if len(self.connections) > SOCKETS_MAX:
            transport.abort()
            return
        self._watch = self.loop.call_later(HEADERS_WITHIN, self._look)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget a connection."""
        self._let_go()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Hand a connection over to the protocol of WebSockets, which has its own watch."""
        self._let_go()
        super().handle_websocket_upgrade(event)

    def _let_go(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        WatchedConnection.open -= self._counted
        self._counted = False

    def _look(self) -> None:
        """Close a connection on which nothing has moved for too long."""
        now = self.loop.time()
        unsent = self.transport.get_write_buffer_size()
        serving = self.cycle is not None and not self.cycle.response_complete
        owes = serving and self.cycle.more_body
        if unsent != self._unsent or (serving and not owes and not unsent):
            self._moved_at, self._unsent = now, unsent
        allowed = STALLED if serving else HEADERS_WITHIN
        if now - self._moved_at >= allowed:
            self.transport.abort()
            return
        self._watch = self.loop.call_later(HEADERS_WITHIN / 2.0, self._look)

    def on_response_complete(self) -> None:
        """Give the client time for its next request."""
        self._moved_at = self.loop.time()
        super().on_response_complete()


class WatchedSocket(WebSocketsSansIOProtocol):
    """A WebSocket that is gone when it is closed, though its client takes nothing any more."""

    async def run_asgi(self) -> None:
        """Serve it, then let go of it."""
        await super().run_asgi()
        self.loop.call_later(LAST_WORDS, self.transport.abort)

    def keepalive_timeout(self) -> None:
        """Let go of a client that does not answer."""
        super().keepalive_timeout()
        self.transport.abort()
