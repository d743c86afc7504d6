# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A Moonraker before a stand-in for Klipper: the real one, or one that speaks its interface.

The real one is started where `MOONRAKER` names its executable (`pip install moonraker`, in an
environment of its own).
"""

import asyncio
import http
import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from equipment.field_servers import LOCAL
from processes import free_port
from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

MOONRAKER = os.environ.get('MOONRAKER', '')
END = b'\x03'
UNREACHABLE = {'code': 503, 'message': 'Klippy Host not connected'}


class Klipper:
    """What Klipper tells of its objects.

    Attributes
    ----------
    objects : dict
        Name of each object to its fields; without any it does not run.
    """

    def __init__(self) -> None:
        self.objects: dict[str, dict[str, Any]] = {
            'webhooks': {'state': 'ready', 'state_message': 'Printer is ready'},
            'heater_bed': {'temperature': 60.25, 'target': 60.0},
            'temperature_sensor chamber': {'temperature': 31.5},
        }

    def query(self, wanted: dict[str, Any]) -> dict[str, Any]:
        """Answer a query as Klipper does: an object that it lacks is empty."""
        status = {}
        for name, fields in wanted.items():
            known = self.objects.get(name, {})
            status[name] = {k: v for k, v in known.items() if not fields or k in fields}
        return {'eventtime': time.monotonic(), 'status': status}


class StandIn:
    """A server with the part of Moonraker's interface that queries objects."""

    def __init__(self, klipper: Klipper, key: str = '') -> None:
        self._klipper, self._key = klipper, key
        self.port = 0

    async def start(self) -> None:
        self._server = await serve(
            self._talk, LOCAL, self.port or free_port(), process_request=self._answer
        )
        self.port = next(iter(self._server.sockets)).getsockname()[1]

    async def stop(self) -> None:
        self._server.close()
        await self._server.wait_closed()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        if self._key and request.headers.get('X-Api-Key') != self._key:
            return connection.respond(http.HTTPStatus.UNAUTHORIZED, '{"error": {"code": 401}}')
        parts = urlsplit(request.path)
        if parts.path == '/websocket':
            return None
        if not self._klipper.objects:
            text = json.dumps({'error': UNREACHABLE})
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, text)
        asked = parse_qs(parts.query, keep_blank_values=True)
        wanted = {name: fields[0].split(',') for name, fields in asked.items()}
        return connection.respond(
            http.HTTPStatus.OK, json.dumps({'result': self._klipper.query(wanted)})
        )

    async def _talk(self, connection: ServerConnection) -> None:
        async for text in connection:
            request = json.loads(text)
            await connection.send('{"jsonrpc": "2.0", "method": "notify_proc_stat_update"}')
            answer = {'jsonrpc': '2.0', 'id': request['id']}
            if self._klipper.objects:
                answer['result'] = self._klipper.query(request['params']['objects'])
            else:
                answer['error'] = UNREACHABLE
            await connection.send(json.dumps(answer))


class RealMoonraker:
    """Moonraker itself, and the socket of a Klipper that answers it."""

    CONFIG = """
[server]
host: {host}
port: {port}
klippy_uds_address: {folder}/klippy.sock
[authorization]
trusted_clients: {trusted}
[machine]
provider: none
validate_service: False
validate_config: False
"""

    def __init__(self, klipper: Klipper, folder: Path, trusted: str = LOCAL) -> None:
        self._klipper, self._folder, self._trusted = klipper, folder, trusted
        self.port = free_port()
        self._process: subprocess.Popen[bytes] | None = None

    async def start(self) -> None:
        folder = self._folder
        (folder / 'config').mkdir(parents=True, exist_ok=True)
        places = {'host': LOCAL, 'port': self.port, 'folder': folder, 'trusted': self._trusted}
        text = self.CONFIG.format(**places)
        (folder / 'config' / 'moonraker.conf').write_text(text)
        self._server = await asyncio.start_unix_server(self._talk, folder / 'klippy.sock')
        self._process = subprocess.Popen(
            [MOONRAKER, '-d', str(folder)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    async def stop(self) -> None:
        assert self._process is not None
        self._process.terminate()
        await asyncio.to_thread(self._process.wait, 60.0)
        self._server.close()

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            try:
                request = json.loads((await reader.readuntil(END))[:-1])
            except asyncio.IncompleteReadError:
                return
            result = self._result(request['method'], request.get('params') or {})
            writer.write(json.dumps({'id': request['id'], 'result': result}).encode() + END)

    def _result(self, method: str, params: dict[str, Any]) -> Any:
        hooks = self._klipper.objects['webhooks']
        if method == 'info':
            return {
                **hooks,
                'hostname': 'printer',
                'klipper_path': str(self._folder),
                'python_path': '/usr/bin/python3',
                'process_id': os.getpid(),
                'user_id': os.getuid(),
                'group_id': os.getgid(),
                'log_file': str(self._folder / 'klippy.log'),
                'config_file': str(self._folder / 'config' / 'printer.cfg'),
                'software_version': 'v0.13.0',
                'cpu_info': '1 core',
            }
        if method == 'list_endpoints':
            return {'endpoints': ['info', 'objects/query', 'objects/list', 'objects/subscribe']}
        if method == 'objects/list':
            return {'objects': list(self._klipper.objects)}
        if method.startswith('objects/'):
            return self._klipper.query(params.get('objects', {}))
        return {}
