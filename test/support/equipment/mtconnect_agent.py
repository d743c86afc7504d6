# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""An MTConnect agent on loopback that fails on demand, and that of the MTConnect Institute."""

import asyncio
import contextlib
import os
import re
import shutil
import ssl
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest
from equipment.field_servers import LOCAL, LocalServer

SPACE = 'urn:mtconnect.org:MTConnect{kind}:1.3'
BOUNDARY = 'a4f1c0'
ITEMS = (
    ('t1', 'front', 'TEMPERATURE', 'CELSIUS'),
    ('t2', 'rear', 'TEMPERATURE', 'FAHRENHEIT'),
    ('s1', 'Srpm', 'ROTARY_VELOCITY', 'REVOLUTION/MINUTE'),
    ('x1', 'Xact', 'POSITION', 'MILLIMETER'),
    ('b1', 'Bact', 'ANGLE', 'DEGREE'),
    ('l1', 'load', 'LOAD', 'PERCENT'),
    ('m1', 'mode', 'CONTROLLER_MODE', ''),
)


class Agent(LocalServer):
    """An agent that keeps observations and streams them.

    Attributes
    ----------
    instance : int
        Its run.
    observations : list
        Pairs of data item and text; the place is the sequence number.
    first : int
        The oldest one that it still gives.
    streams : bool
        Whether it answers `interval` with a stream, or else with one document.
    chunked : bool
        Whether its stream is sent in chunks of HTTP.
    kind : str
        What it calls its stream.
    paths : str
        What it makes of `path=`: `filters`, `refuses`, `ignores`, or `empties`, as one that finds
        none of the data items.
    requests : list of str
        What it was asked.
    """

    def __init__(self, tls: ssl.SSLContext | None = None) -> None:
        super().__init__(tls)
        self.kind = 'multipart/x-mixed-replace'
        self.paths = 'filters'
        self.instance = 1
        self.observations: list[tuple[str, str]] = []
        self.first = 1
        self.streams = True
        self.chunked = False
        self.requests: list[str] = []
        self._news = asyncio.Event()

    async def observe(self, **texts: object) -> None:
        """Take new observations: id and text."""
        self.observations += [(item, str(text)) for item, text in texts.items()]
        self._news.set()

    async def lose(self, count: int, **texts: object) -> None:
        """Take so many observations at once that the old ones are gone."""
        for _ in range(count):
            self.observations += [(item, str(text)) for item, text in texts.items()]
        self.first = self.following - 1
        self._news.set()

    async def restart(self, **texts: object) -> None:
        """Begin a new run with other observations."""
        self.instance += 1
        self.first = 1
        self.observations = [(item, str(text)) for item, text in texts.items()]
        self._news.set()

    @property
    def following(self) -> int:
        """The sequence number of the next observation."""
        return len(self.observations) + 1

    def document(self, kind: str, body: str, following: int | None = None) -> bytes:
        """Return a document."""
        return (
            f'<?xml version="1.0" encoding="UTF-8"?>\n<MTConnect{kind} '
            f'xmlns="{SPACE.format(kind=kind)}"><Header creationTime="2026-01-01T00:00:00Z" '
            f'sender="test" instanceId="{self.instance}" version="1.3.0.10" bufferSize="1000" '
            f'firstSequence="{self.first}" lastSequence="{self.following - 1}" '
            f'nextSequence="{following or self.following}"/>{body}</MTConnect{kind}>'
        ).encode()

    def _streams(self, begin: int, end: int, query: Mapping[str, Sequence[str]]) -> bytes:
        wanted = {item for item, *_ in ITEMS}
        if 'path' in query and self.paths in ('filters', 'empties'):
            (path,) = query['path']
            assert re.fullmatch(r'//DataItem\[@id="\w+"( or @id="\w+")*\]', path)
            wanted = {*re.findall(r'"(\w+)"', path)} if self.paths == 'filters' else set()
        found = ''.join(
            f'<Value dataItemId="{item}" sequence="{place}" '
            f'timestamp="2020-01-01T00:00:00Z">{text}</Value>'
            for place, (item, text) in list(enumerate(self.observations, 1))[begin - 1 : end - 1]
            if item in wanted
        )
        body = f'<Streams><DeviceStream name="mill"><Samples>{found}</Samples></DeviceStream>'
        return self.document('Streams', f'{body}</Streams>', end)

    def reply(self, path: str) -> bytes:
        """Return the document that answers a request."""
        if path.endswith('/probe'):
            items = ''.join(
                f'<DataItem category="SAMPLE" id="{key}" name="{name}" type="{kind}" '
                f'{f"units={chr(34)}{units}{chr(34)}" if units else ""}/>'
                for key, name, kind, units in ITEMS
            )
            body = f'<Devices><Device id="d" name="mill"><DataItems>{items}</DataItems></Device>'
            return self.document('Devices', f'{body}</Devices>')
        query = parse_qs(urlsplit(path).query)
        if 'path' in query and self.paths == 'refuses':
            return self.document('Error', '<Errors><Error errorCode="INVALID_XPATH"/></Errors>')
        if urlsplit(path).path.endswith('/current'):
            return self._streams(1, self.following, query)
        begin = int(query['from'][0])
        if not self.first <= begin <= self.following:
            text = f"'from' must be from {self.first} to {self.following}"
            error = f'<Errors><Error errorCode="OUT_OF_RANGE">{text}</Error></Errors>'
            return self.document('Error', error)
        return self._streams(begin, self.following, query)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = (await reader.readuntil(b'\r\n\r\n')).decode()
        path = head.split(' ')[1]
        self.requests.append(path)
        if 'interval=' in path and self.streams and b'<Errors>' not in self.reply(path):
            await self._stream(path, writer)
        else:
            writer.write(http(self.reply(path)))
            await writer.drain()
        writer.close()
        await writer.wait_closed()

    async def _stream(self, path: str, writer: asyncio.StreamWriter) -> None:
        query = parse_qs(urlsplit(path).query)
        begin, silence = int(query['from'][0]), float(query['heartbeat'][0]) / 1e3
        coding = 'Transfer-Encoding: chunked\r\n' if self.chunked else ''
        writer.write(
            'HTTP/1.1 200 OK\r\nConnection: close\r\n'
            f'Content-Type: {self.kind};boundary={BOUNDARY}\r\n{coding}\r\n'.encode()
        )
        while not writer.transport.is_closing():
            document = self._streams(begin, self.following, query)
            begin = self.following
            part = (
                f'--{BOUNDARY}\r\nContent-type: text/xml\r\n'
                f'Content-length: {len(document)}\r\n\r\n'.encode()
                + document
                + b'\r\n'
            )
            writer.write(b'%x\r\n%s\r\n' % (len(part), part) if self.chunked else part)
            await writer.drain()
            self._news.clear()
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._news.wait(), silence)


def http(body: bytes, status: str = '200 OK', kind: str = 'text/xml') -> bytes:
    """Return an answer of HTTP."""
    return (
        f'HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n'
        'Connection: close\r\n\r\n'
    ).encode() + body


class InstituteAgent:
    """The C++ agent of the MTConnect Institute as a process.

    Neither Debian nor PyPI has it: who wants the test builds it, elsewhere the test says what it
    lacks, and `Agent` stands for one.

    Parameters
    ----------
    folder : Path
        Where its files go.
    devices : Path
        The file of devices.
    adapter : int
        TCP port of the adapter that it reads.
    port : int
        TCP port that it answers on.
    """

    def __init__(self, folder: Path, devices: Path, adapter: int, port: int) -> None:
        program = os.environ.get('MTCONNECT_AGENT') or shutil.which('mtconnect-agent')
        if not program:
            pytest.skip('needs the C++ agent of MTConnect: MTCONNECT_AGENT=path of its executable')
        self.port = port
        (folder / 'agent.cfg').write_text(
            f'Devices = {devices}\nPort = {port}\nServerIp = {LOCAL}\nBufferSize = 10\n'
            'ReconnectInterval = 200\nSchemaVersion = 1.3\n'
            f'Adapters {{\n  mill {{\n    Host = {LOCAL}\n    Port = {adapter}\n  }}\n}}\n'
            f'logger_config {{\n  output = file {folder / "agent.log"}\n}}\n'
        )
        self._command = [program, 'run', 'agent.cfg']
        self._folder = folder

    def start(self) -> None:
        """Run it."""
        self.process = subprocess.Popen(
            self._command,
            cwd=self._folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def stop(self) -> None:
        """Kill it."""
        self.process.kill()
        self.process.wait(10.0)
