# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Serves lines of SHDR to agents of MTConnect, in a thread of its own."""

import asyncio
import contextlib
from collections.abc import Sequence

from fuzzycnc_ros.adapters.loops import LoopThread
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.component import Health, Level

HEARTBEAT = 10.0
"""Time within which an agent that asks for it is to ask again [s]."""
BEHIND_MAX = 256 * 1024
"""Most bytes that wait for a client; one that takes them slower is dropped."""
CLIENTS_MAX = 16
"""Most clients; further ones are dropped at once."""
LINE_MAX = 1024
"""Longest line that a client may send, in bytes."""
START_TIMEOUT, CLOSE_TIMEOUT = 10.0, 2.0
"""Longest wait for the port, and for the end of the thread [s]."""
PING = b'* PING'


class ShdrServer:
    """Send lines to all clients; what they send is read for `* PING` alone.

    Parameters
    ----------
    address : str
        Address to listen on.
    port : int
        TCP port; 0 takes a free one.

    Raises
    ------
    ParameterError
        If the port cannot be had.
    """

    def __init__(self, address: str, port: int) -> None:
        self._address, self.port = address, port
        self._everything: bytes = b''
        self._clients: set[asyncio.StreamWriter] = set()
        self.dropped = 0
        self._loop = LoopThread('shdr')
        try:
            self._server = self._loop.call(self._listen(), START_TIMEOUT)
        except OSError as error:
            self._loop.end(CLOSE_TIMEOUT)
            raise ParameterError(
                f'parameter port: expected a free port on {address} but {port} cannot be had '
                f'({error.strerror}); is another adapter running?'
            ) from error
        self.port = self._server.sockets[0].getsockname()[1]

    def publish(self, news: Sequence[str], everything: Sequence[str]) -> None:
        """Send news to the clients that are there; who comes later gets everything first."""
        self._loop.soon(self._send, _bytes(news), _bytes(everything))

    def health(self) -> Health:
        """Say who listens."""
        count = len(self._clients)
        values = {'clients': str(count), 'dropped': str(self.dropped)}
        where = f'SHDR {self._address}:{self.port}'
        text = f'{where}: {count} agents' if count else f'{where}: no agent is connected'
        return Health('adapter', Level.OK, text, values)

    def close(self) -> None:
        """Drop all clients and end the thread."""
        self._loop.soon(self._server.close)
        self._loop.end(CLOSE_TIMEOUT)

    async def _listen(self) -> asyncio.Server:
        return await asyncio.start_server(self._serve, self._address, self.port, limit=LINE_MAX)

    def _send(self, news: bytes, everything: bytes) -> None:
        self._everything = everything
        for writer in list(self._clients):
            if writer.transport.get_write_buffer_size() > BEHIND_MAX:
                self._drop(writer)
            elif news:
                writer.write(news)

    def _drop(self, writer: asyncio.StreamWriter) -> None:
        self.dropped += 1
        self._clients.discard(writer)
        writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._clients) >= CLIENTS_MAX:
            self._drop(writer)
            return
        self._clients.add(writer)
        writer.write(self._everything)
        wait: float | None = None  # who never asks is not waited for
        try:
            while line := await asyncio.wait_for(reader.readline(), wait):
                if line.strip() != PING:
                    continue
                if writer.transport.get_write_buffer_size() > BEHIND_MAX:
                    break
                wait = 2.0 * HEARTBEAT
                writer.write(b'* PONG %d\n' % (HEARTBEAT * 1e3))
        except (OSError, ValueError, asyncio.TimeoutError):
            pass  # it is gone, sends no lines, or asks no more
        finally:
            self._clients.discard(writer)
            with contextlib.suppress(RuntimeError):
                writer.transport.abort()


def _bytes(lines: Sequence[str]) -> bytes:
    return ''.join(f'{line}\n' for line in lines).encode()
