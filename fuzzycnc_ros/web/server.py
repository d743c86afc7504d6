# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The server of the live page, in a thread of its own with an event loop of its own."""

import asyncio
import contextlib
import json
import socket
import threading
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import uvicorn

from fuzzycnc_ros.web.app import LivePage, Machines, Recordings, page_app
from fuzzycnc_ros.web.connections import WatchedConnection, WatchedSocket
from fuzzycnc_ros.web.guard import Token
from fuzzycnc_ros.web.live import Frames

FRAME_MAX = 1024
"""Largest frame that a page may send [bytes]; it has nothing to say."""
WAITING = 128
"""Connections that the system holds until they are taken."""
STOPPED_WITHIN = 5.0
"""Time [s] in which the server must have ended."""

_TICKS = 5
"""Ticks of uvicorn, 0.1 s each, that are passed over at once."""


class PageServer:
    """Serve the page; what it is told from other threads never waits for a browser.

    Parameters
    ----------
    machines : Machines
        What is shown.
    recordings : Recordings
        Bags.
    address, port : str, int
        Where to listen; port 0 takes a free one.
    token : Token
        Who may act.
    hosts : collection of str
        Further names of this computer.
    certificate : (Path, Path), optional
        Files of certificate and key; without them there is no encryption.

    Raises
    ------
    OSError
        If nothing can listen there.
    """

    def __init__(
        self,
        machines: Machines,
        recordings: Recordings,
        *,
        address: str = '127.0.0.1',
        port: int = 0,
        token: Token,
        hosts: Collection[str] = (),
        certificate: tuple[Path, Path] | None = None,
    ) -> None:
        self._socket = _listening(address, port)
        self._loop = asyncio.new_event_loop()
        self._frames = Frames()
        page = LivePage(machines, self._frames, recordings, token, address, hosts)
        scheme = 'http' if certificate is None else 'https'
        shown = f'[{address}]' if ':' in address else address
        self.url = f'{scheme}://{shown}:{self._socket.getsockname()[1]}/'
        """Address for browsers."""
        config = uvicorn.Config(
            page_app(page),
            http=WatchedConnection,
            ws=WatchedSocket,
            ws_max_size=FRAME_MAX,
            ws_per_message_deflate=False,
            lifespan='off',
            log_config=None,
            log_level='error',
            access_log=False,
            proxy_headers=False,
            server_header=False,
            timeout_graceful_shutdown=1,
            ssl_certfile=None if certificate is None else certificate[0],
            ssl_keyfile=None if certificate is None else certificate[1],
        )
        self._server = _Server(config)
        self._thread = threading.Thread(target=self._run, name='page', daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def stop(self) -> None:
        """Serve no more."""
        if self._thread.is_alive():
            self._tell(self._server.end)
            self._thread.join(STOPPED_WITHIN)
        else:
            self._loop.close()
        self._socket.close()

    @property
    def clients(self) -> int:
        """Pages that are open."""
        return self._frames.clients

    def greet(self, hello: Mapping[str, Any]) -> None:
        """Tell all pages which machines there are."""
        self._tell(self._frames.greet, dict(hello))

    def show(self, machine: str, view: Mapping[str, Any]) -> None:
        """Give all pages the view of a machine."""
        frame = {'type': 'view', 'machine': machine, 'view': view}
        self._tell(self._frames.put, machine, json.dumps(frame, allow_nan=False))

    def _tell(self, call: Callable[..., None], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # it has ended
            self._loop.call_soon_threadsafe(call, *arguments)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._server._serve(sockets=[self._socket]))
        finally:
            self._loop.close()


class _Server(uvicorn.Server):
    """Uvicorn's server, which ends at once when it is told to."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self._told = asyncio.Event()

    def end(self) -> None:
        """End, from within the loop."""
        self.should_exit = True
        self._told.set()

    async def main_loop(self) -> None:
        """Tell the server's ticks.

        Uvicorn tells ten a second: that would be a fifth of what a page costs that nobody watches.
        """
        tick = 0
        while not await self.on_tick(tick):  # each tenth renews the date of all answers
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._told.wait(), 0.1 * _TICKS)
            tick = (tick + _TICKS) % 864_000


def _listening(address: str, port: int) -> socket.socket:
    """Return a socket that listens."""
    family = socket.AF_INET6 if ':' in address else socket.AF_INET
    found = socket.socket(family, socket.SOCK_STREAM)
    try:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((address, port))
        found.listen(WAITING)
    except OSError:
        found.close()
        raise
    return found
