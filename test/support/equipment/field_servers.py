# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Real Modbus TCP and OPC UA servers on loopback, and a route to them that fails on demand."""

import asyncio
import atexit
import ssl
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine
from functools import cache
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.server.address_space import AddressSpace, NodeManagementService
from asyncua.server.standard_address_space.standard_address_space import fill_address_space
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from fuzzycnc_ros.adapters.loops import LoopThread

LOCAL = '127.0.0.1'
REGISTERS = 200
"""Registers of the Modbus device; the next one is unknown to it."""
NAMESPACE = 'urn:fuzzycnc:test'


class Field:
    """An event loop in a thread of its own, in which the servers of a test live."""

    def __init__(self) -> None:
        self._loop = LoopThread('field')
        self._closers: list[Callable[[], Coroutine[Any, Any, None]]] = []

    def call(self, coroutine: Coroutine[Any, Any, Any]) -> Any:
        """Run a coroutine there; return its result."""
        return self._loop.call(coroutine, 60.0)

    def add(self, part: Any) -> Any:
        """Start a server or route, to be stopped in the end."""
        self.call(part.start())
        self._closers.append(part.stop)
        return part

    def close(self) -> None:
        """Stop everything."""
        for stop in reversed(self._closers):
            self.call(stop())
        self._loop.end(60.0)


class ModbusServer:
    """A Modbus TCP device with holding and input registers.

    Attributes
    ----------
    words : dict
        Register to word, for both tables.
    delay : float
        Time that it takes for each answer [s].
    """

    def __init__(self, words: dict[int, int] | None = None) -> None:
        self.words = words or {}
        self.delay = 0.0
        self.port = 0

    def device(self, unit: int) -> SimDevice:
        """Return a unit that holds the words."""

        async def act(function, start, address, count, registers, values):
            await asyncio.sleep(self.delay)
            for place, word in self.words.items():
                registers[place - start] = word

        block = [SimData(0, count=REGISTERS, values=0, datatype=DataType.REGISTERS)]
        bits = [SimData(0, count=8, values=False, datatype=DataType.BITS)]
        return SimDevice(unit, simdata=(bits, bits, block, block), action=act)

    async def start(self) -> None:
        self._server = ModbusTcpServer(self.device(1), address=(LOCAL, self.port))
        await self._server.serve_forever(background=True)
        self.port = self._server.transport.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        await self._server.shutdown()


@cache
def _standard() -> Path:
    """Return a file with the address space of the standard, which takes seconds to make."""
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    space = AddressSpace()
    fill_address_space(NodeManagementService(space))
    path = Path(folder.name, 'address_space')
    space.make_aspace_shelf(path)
    return path


async def new_opcua() -> Server:
    """Return a server that has nothing yet but the address space of the standard."""
    server = Server()
    await server.init(shelf_file=_standard())
    return server


async def stop_opcua(server: Server) -> None:
    """Stop a server, and drop the clients that have come back while it stopped."""
    await server.stop()
    await asyncio.sleep(0.05)  # what was accepted is known in a later turn of the loop
    for transport in list(server.iserver.asyncio_transports):
        transport.abort()


class OpcUaServer:
    """An OPC UA server with variables Objects/Mill/<name>, node ids ns=2;s=<name>.

    Attributes
    ----------
    values : dict
        Name to what is read from the variable: a value of any type, or a data value.
    """

    def __init__(self, values: dict[str, Any], secure: Callable[[Server], Any] | None = None):
        self.values = dict(values)
        self._secure = secure
        self.port = 0

    async def start(self) -> None:
        self.server = await new_opcua()
        self.server.set_endpoint(f'opc.tcp://{LOCAL}:{self.port}/')
        if self._secure is not None:
            await self._secure(self.server)
        self.index = await self.server.register_namespace(NAMESPACE)
        mill = await self.server.nodes.objects.add_object(self.index, 'Mill')
        for name, value in self.values.items():
            node_id = ua.NodeId(name, self.index)
            await mill.add_variable(node_id, f'{self.index}:{name}', value)
            # The server itself would refuse another type than the first.
            self.server.iserver.aspace.set_attribute_value_callback(
                node_id, ua.AttributeIds.Value, self._read
            )
        await self.server.start()
        self.port = self.server.bserver._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        await stop_opcua(self.server)

    def _read(self, node_id: ua.NodeId, attribute: ua.AttributeIds) -> ua.DataValue:
        value = self.values[node_id.Identifier]
        return value if isinstance(value, ua.DataValue) else ua.DataValue(ua.Variant(value))


class LocalServer(ABC):
    """A server of streams on a free port, which it has again when it is started again."""

    def __init__(self, tls: ssl.SSLContext | None = None) -> None:
        self.port = 0
        self._tls = tls
        self._writers: set[asyncio.StreamWriter] = set()

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._accept, LOCAL, self.port, ssl=self._tls)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        self._server.close()
        for writer in list(self._writers):
            writer.transport.abort()
        await asyncio.sleep(0)  # a connection ends in the next turn of the loop

    def _accept(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> Coroutine[Any, Any, None]:
        """Know a client at once, also one whose task has not begun when the server stops."""
        self._writers.add(writer)
        return self._tend(reader, writer)

    async def _tend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await self._serve(reader, writer)
        except (ConnectionError, asyncio.IncompleteReadError, asyncio.CancelledError):
            pass  # the other side has gone, or the test is over
        finally:
            self._writers.discard(writer)
            writer.transport.abort()

    @abstractmethod
    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a client, which is dropped afterwards."""


class Route(LocalServer):
    """A port that passes everything on to a server, until a fault is set.

    Attributes
    ----------
    fault : str
        `` passes on; `refuse` closes the port and all connections; `cut` passes on the first
        bytes of an answer and drops the connection; `hang` passes nothing on but stays open;
        `garble` overturns every byte of an answer; `late` passes each answer on after `delay`.
    delay : float
        How long `late` keeps an answer [s].
    """

    CUT = 6

    def __init__(self, target: Any) -> None:
        super().__init__()
        self._target = target
        self.fault = ''
        self.delay = 1.0
        self.connections = 0

    async def set(self, fault: str) -> None:
        """Begin a fault, or end it with an empty name."""
        if fault == 'refuse':
            await self.stop()
        elif self.fault == 'refuse':
            await self.start()
        self.fault = fault

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        there, out = await asyncio.open_connection(LOCAL, self._target.port)
        self._writers.add(out)
        try:
            await asyncio.gather(
                self._pass(reader, out, answers=False), self._pass(there, writer, answers=True)
            )
        finally:
            self._writers.discard(out)
            out.transport.abort()

    async def _pass(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, answers: bool
    ) -> None:
        while data := await reader.read(65536):
            if self.fault == 'hang':
                continue
            if answers and self.fault == 'late':
                await asyncio.sleep(self.delay)
            if answers and self.fault == 'cut':
                writer.write(data[: self.CUT])
                await writer.drain()
                raise ConnectionError
            if answers and self.fault == 'garble':
                data = bytes(255 - byte for byte in data)
            writer.write(data)
        raise ConnectionError


class HostileServer(LocalServer):
    """A server that answers whatever it gets with bytes of the test's choice."""

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        super().__init__()
        self._answer = answer
        self.asked = 0

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(65536):
            self.asked += 1
            writer.write(self._answer(data))
            await writer.drain()
