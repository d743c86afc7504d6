# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Event loops beside a node: one that lets go of its connections, and a thread that runs it."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar('T')

HELD_MAX = 2 << 20
"""Most of an unfinished message that a connection holds, in bytes: twice the largest of OPC UA."""
_HELD = ('receive_buffer', 'recv_buffer')
"""Names of the receive buffer in protocols of asyncua and pymodbus."""


class ConnectionLoop(asyncio.SelectorEventLoop):
    """An event loop that ends its tasks, servers and connections when it is closed.

    asyncio leaves open what nobody closed: a client that was accepted while its server stopped, a
    connection that was made while its caller lost patience.
    """

    def __init__(self) -> None:
        super().__init__()
        self._connections: list[tuple[socket.socket, asyncio.Transport]] = []
        self._listening: list[socket.socket] = []
        # What a protocol's callback could not make sense of ends its connection, which is
        # reported; asyncio would write a traceback for each.
        self.set_exception_handler(lambda loop, context: None)

    def _make_socket_transport(
        self, sock: socket.socket, protocol: Any, *args: Any, **options: Any
    ) -> asyncio.Transport:
        _check_serving(sock, options.get('server'))
        _bound(protocol)
        made: asyncio.Transport = super()._make_socket_transport(sock, protocol, *args, **options)  # type: ignore[misc]
        self._keep(sock)
        return made

    def _make_ssl_transport(
        self, rawsock: socket.socket, protocol: Any, *args: Any, **options: Any
    ) -> asyncio.Transport:
        _check_serving(rawsock, options.get('server'))
        _bound(protocol)
        made: asyncio.Transport = super()._make_ssl_transport(rawsock, protocol, *args, **options)  # type: ignore[misc]
        self._keep(rawsock)
        return made

    def _keep(self, sock: socket.socket) -> None:
        # One that is closing is open as long as nobody takes what was written to it.
        self._connections = [item for item in self._connections if item[0].fileno() >= 0]
        # Below encryption: what lies above is of no use any more once it closes.
        self._connections.append((sock, self._transports[sock.fileno()]))  # type: ignore[attr-defined]

    def _start_serving(
        self, protocol_factory: Any, sock: socket.socket, *args: Any, **options: Any
    ) -> None:
        self._listening = [item for item in self._listening if item.fileno() >= 0]
        self._listening.append(sock)
        super()._start_serving(protocol_factory, sock, *args, **options)  # type: ignore[misc]

    def close(self) -> None:
        """End all tasks, servers and connections, then the loop, which must not run."""
        if not self.is_closed():
            self.run_until_complete(self._let_go())
        super().close()

    async def _let_go(self) -> None:
        for server in self._listening:
            if server.fileno() >= 0:
                self._stop_serving(server)  # type: ignore[attr-defined]
        # Who was accepted in the last turn becomes a connection in this one.
        await asyncio.sleep(0)
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for _, connection in self._connections:
            connection.abort()
        await asyncio.sleep(0)  # a connection ends in the next turn of the loop


def _bound(protocol: Any) -> None:
    """End a connection whose protocol holds too much of what is no whole message yet.

    asyncua and pymodbus gather what a peer announces, 4 GB if it says so, until somebody loses
    patience; a peer on this computer sends hundreds of megabytes by then.
    """
    take = getattr(protocol, 'data_received', None)
    if take is None:
        return

    def data_received(data: bytes) -> None:
        take(data)
        if any(len(getattr(protocol, name, None) or b'') > HELD_MAX for name in _HELD):
            protocol.transport.abort()

    protocol.data_received = data_received


def _check_serving(sock: socket.socket, server: asyncio.Server | None) -> None:
    """Drop who was accepted by a server that has closed since: asyncio would leave it open."""
    if server is not None and not server.sockets:
        sock.close()
        raise ConnectionAbortedError


class LoopThread:
    """Run coroutines beside a node, which waits for them as long as it likes.

    Parameters
    ----------
    name : str
        Name of the thread.
    """

    def __init__(self, name: str) -> None:
        self._loop = ConnectionLoop()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """True if the thread has not ended."""
        return self._thread.is_alive()

    def call(self, coroutine: Coroutine[Any, Any, T], timeout: float) -> T:
        """Run a coroutine; return its result.

        Raises
        ------
        concurrent.futures.TimeoutError
            If it takes longer than `timeout` [s].
        """
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(timeout)

    def soon(self, work: Callable[..., object], *arguments: Any) -> None:
        """Let the loop call something; do not wait for it."""
        self._loop.call_soon_threadsafe(work, *arguments)

    def end(self, timeout: float) -> None:
        """End the thread with all its connections; wait for no longer than `timeout` [s]."""
        with contextlib.suppress(RuntimeError):  # it has ended
            self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(timeout)

    def _run(self) -> None:
        try:
            self._loop.run_forever()
        finally:
            self._loop.close()
