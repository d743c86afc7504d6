# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Event loops that let go of their connections."""

import asyncio
import contextlib
import gc
import inspect
import socket
import ssl
import warnings

import pytest
from equipment.certificates import certificate

from fuzzycnc_ros.adapters.loops import HELD_MAX, ConnectionLoop

MUCH = 16 << 20
"""More bytes than a connection takes while nobody reads."""


def test_a_connection_that_closes_but_cannot_deliver_is_dropped_as_well():
    """`close` waits for a reader; a loop that ends does not."""
    loop = ConnectionLoop()
    accepted = []

    async def serve(reader, writer):
        accepted.append(writer.get_extra_info('socket'))
        writer.write(bytes(MUCH))
        writer.close()

    async def connect():
        server = await asyncio.start_server(serve, '127.0.0.1', 0)
        for _ in range(2):  # the second looks for what is over
            client = socket.create_connection(server.sockets[0].getsockname())
            stack.callback(client.close)
            while len(accepted) == len(clients):
                await asyncio.sleep(0.01)
            clients.append(client)
        server.close()

    clients = []
    with contextlib.ExitStack() as stack:
        loop.run_until_complete(connect())
        assert all(item.fileno() >= 0 for item in accepted)
        loop.close()
        assert [item.fileno() for item in accepted] == [-1, -1]


def test_who_connects_while_the_loop_ends_is_dropped():
    """Nobody has taken them yet, and nobody will."""
    loop = ConnectionLoop()

    async def serve(reader, writer):
        await reader.read()

    server = loop.run_until_complete(asyncio.start_server(serve, '127.0.0.1', 0))
    address = server.sockets[0].getsockname()
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(socket.create_connection(address)) for _ in range(3)]
        loop.close()
        for client in clients:
            client.settimeout(10.0)
            with contextlib.suppress(ConnectionResetError):
                assert client.recv(1) == b''


@pytest.mark.parametrize('trust', [False, True], ids=['in the handshake', 'established'])
def test_encrypted_connections_are_dropped_as_well(tmp_path, trust):
    """One who never says hello, and one who has nothing to say."""
    loop = ConnectionLoop()
    file = certificate(tmp_path)
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    tls.load_cert_chain(file, tmp_path / 'broker-key.pem')

    async def serve(reader, writer):
        kept.append(writer)
        await reader.read()

    async def connect():
        server = await asyncio.start_server(serve, '127.0.0.1', 0, ssl=tls)
        address = server.sockets[0].getsockname()
        if trust:
            known = ssl.create_default_context(cafile=str(file))
            known.check_hostname = False
            client = stack.enter_context(socket.create_connection(address))
            shaken = await asyncio.to_thread(known.wrap_socket, client)
            clients.append(stack.enter_context(shaken))
            while not kept:
                await asyncio.sleep(0.01)
        else:
            clients.append(stack.enter_context(socket.create_connection(address)))
            await asyncio.sleep(0.1)

    clients, kept = [], []
    with contextlib.ExitStack() as stack:
        loop.run_until_complete(connect())
        loop.close()
        clients[0].settimeout(10.0)
        with contextlib.suppress(ConnectionResetError, ssl.SSLEOFError):
            assert clients[0].recv(1) == b''


@pytest.mark.parametrize(
    'tls', [None, ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)], ids=['plain', 'TLS']
)
def test_who_was_accepted_by_a_server_that_closes_is_dropped(tls):
    """Between a client's acceptance and its connection is a turn of the loop."""
    loop = ConnectionLoop()

    async def serve(reader, writer):
        raise AssertionError('expected nobody to be served')

    async def accept(clients):
        server = await asyncio.start_server(serve, '127.0.0.1', 0, ssl=tls)
        clients.append(socket.create_connection(server.sockets[0].getsockname()))
        while len(asyncio.all_tasks()) == 1:
            await asyncio.sleep(0)
        server.close()
        await asyncio.sleep(0)

    clients = []
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter('always')
        loop.run_until_complete(accept(clients))
        with clients.pop() as client:
            client.settimeout(10.0)
            assert client.recv(1) == b''
        loop.close()
        gc.collect()
    assert not [str(item.message) for item in told]


class Gathering(asyncio.Protocol):
    """Gathers a message that has no end, as a library does that believes its length."""

    def __init__(self, name):
        self.name, self.most, self.lost = name, 0, asyncio.Event()
        setattr(self, name, b'')

    def connection_made(self, transport):
        self.transport = transport

    def data_received(self, data):
        setattr(self, self.name, getattr(self, self.name) + data)
        self.most = len(getattr(self, self.name))

    def connection_lost(self, error):
        self.lost.set()


@pytest.mark.parametrize('name', ['receive_buffer', 'recv_buffer'])
def test_a_message_without_end_is_not_gathered(name):
    loop, made = ConnectionLoop(), Gathering(name)

    async def flood(reader, writer):
        with contextlib.suppress(ConnectionError):
            while True:
                writer.write(bytes(1 << 16))
                await writer.drain()

    async def scenario():
        server = await asyncio.start_server(flood, '127.0.0.1', 0)
        await loop.create_connection(lambda: made, *server.sockets[0].getsockname())
        await made.lost.wait()

    loop.run_until_complete(scenario())
    loop.close()
    assert HELD_MAX < made.most < 2 * HELD_MAX


def test_the_libraries_hold_what_they_gather_where_it_is_looked_for():
    pytest.importorskip('asyncua')
    pytest.importorskip('pymodbus')
    from asyncua.client.ua_client import UASocketProtocol
    from pymodbus.transport import transport

    assert 'self.receive_buffer = ' in inspect.getsource(UASocketProtocol)
    assert 'self.recv_buffer = ' in inspect.getsource(transport)
