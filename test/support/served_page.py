# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A server of the page without ROS, and what a client does with it at the lowest level."""

import asyncio
import http.client
import json
import socket
import threading
from urllib.parse import urlsplit

import pytest

pytest.importorskip('starlette', reason="the page needs pip install 'fuzzycnc_ros[page]'")

from fuzzycnc_ros.web.app import ActionRefusedError
from fuzzycnc_ros.web.guard import Token
from fuzzycnc_ros.web.recordings import BagFolder
from fuzzycnc_ros.web.server import PageServer

SECRET = 'a-token-of-the-tests'


class Machines:
    """Machines that do whatever they are asked, and write it down."""

    def __init__(self):
        self.machines = ['mill', 'shop/lathe']
        self.done = []
        self.refusal = None

    def history(self, machine, series, begin, end, points):
        """Return nothing, in the form of a stretch."""
        return {'machine': machine, 'series': series, 'time': [begin, end], 'points': points}

    async def act(self, machine, action, body):
        """Write an action down, or refuse it."""
        await asyncio.sleep(0)
        if self.refusal is not None:
            raise self.refusal
        self.done.append((machine, action, body))
        return 'done'


class Served:
    """A server that runs, and its client."""

    def __init__(self, server, machines):
        self.server, self.machines = server, machines
        parts = urlsplit(server.url)
        self.address = parts.hostname, parts.port
        self.host = parts.netloc

    def request(self, method, path, body=None, headers=(), timeout=30.0):
        """Send one request as it stands; return status, headers and body."""
        connection = http.client.HTTPConnection(*self.address, timeout=timeout)
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            given = dict(headers)
            given.setdefault('Host', self.host)
            if body is not None:
                given.setdefault('Content-Type', 'application/json')
                given.setdefault('Content-Length', str(len(body)))
            for name, value in given.items():
                if value is not None:
                    connection.putheader(name, value)
            connection.endheaders(body)
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            connection.close()

    def act(self, action, body=None, machine='mill', **headers):
        """Ask for an action; return the status and what the server says."""
        text = json.dumps(body or {}).encode()
        status, _, answer = self.request('POST', f'/act/{machine}/{action}', text, headers)
        return status, json.loads(answer)

    def open(self, send=b''):
        """Open a connection, and send something."""
        connection = socket.create_connection(self.address, timeout=60.0)
        connection.sendall(send)
        return connection

    def socket(self, headers=()):
        """Return the request of a WebSocket."""
        given = {
            'Host': self.host,
            'Origin': f'http://{self.host}',
            'Upgrade': 'websocket',
            'Connection': 'Upgrade',
            'Sec-WebSocket-Key': 'dGhlIHNhbXBsZSBub25jZQ==',
            'Sec-WebSocket-Version': '13',
            **dict(headers),
        }
        lines = [f'{name}: {value}' for name, value in given.items() if value is not None]
        return '\r\n'.join(['GET /live HTTP/1.1', *lines, '', '']).encode()


@pytest.fixture
def serve(tmp_path):
    """Serve the page with settings."""
    running = []

    def start(secret='', bags=None, **settings):
        machines = Machines()
        server = PageServer(machines, BagFolder(bags), token=Token(secret), **settings)
        server.start()
        running.append(server)
        server.greet({'type': 'hello', 'machines': machines.machines})
        return Served(server, machines)

    yield start
    for server in running:
        server.stop()
    assert not [thread for thread in threading.enumerate() if thread.name == 'page']


@pytest.fixture
def page(serve):
    """Serve the page to this computer alone, without a token."""
    return serve()


@pytest.fixture
def refusing(page):
    """Serve the page of machines that refuse every action."""
    page.machines.refusal = ActionRefusedError('because; do that', needs='force')
    return page
