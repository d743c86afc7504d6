# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A connection to an MTConnect agent: its present state, then all that changes."""

import asyncio
import contextlib
import http.client
import math
import re
import socket
import ssl
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime, timezone
from functools import partial
from urllib.parse import quote

from fuzzycnc_ros.adapters.mtconnect.device import DataItemChannel, MtconnectDevice, Quantity
from fuzzycnc_ros.adapters.mtconnect.documents import DataItem, Document, parse
from fuzzycnc_ros.adapters.readings.link import Link, LinkError, Reading
from fuzzycnc_ros.adapters.readings.plausible_value import NUMBER, no_temperature, scaled, shown

HEARTBEAT = 1.0
"""Longest silence that the agent is asked for while nothing changes [s]."""
COUNT = 1000
"""Most observations that are asked for at once."""
DOCUMENT_MAX = 8 << 20
"""Longest document that is read, in bytes; a machine with 1000 data items needs about 0.3 MB."""
LINE_MAX, HEADERS_MAX = 1000, 32
"""Longest line, and most lines, before each document of a stream."""
NAMED_MAX = 5
"""Most data items that a message names."""
UNAVAILABLE = 'UNAVAILABLE'
OUT_OF_RANGE = 'OUT_OF_RANGE'
TEMPERATURES = {
    'CELSIUS': (1.0, 0.0),
    'FAHRENHEIT': (5.0 / 9.0, -160.0 / 9.0),
    'KELVIN': (1.0, -273.15),
}
"""Factor and offset from the units of MTConnect to degC."""
SPEEDS = {
    'REVOLUTION/MINUTE': (2.0 * math.pi / 60.0, 0.0),
    'REVOLUTION/SECOND': (2.0 * math.pi, 0.0),
    'DEGREE/SECOND': (math.pi / 180.0, 0.0),
    'RADIAN/SECOND': (1.0, 0.0),
}
"""Factor and offset to rad/s."""
POSITIONS = {
    'MILLIMETER': (1e-3, 0.0),
    'INCH': (25.4e-3, 0.0),
    'METER': (1.0, 0.0),
    'DEGREE': (math.pi / 180.0, 0.0),
    'RADIAN': (1.0, 0.0),
}
"""Factor and offset to m, of axes that turn to rad."""
UNITS = {
    Quantity.TEMPERATURE: TEMPERATURES,
    Quantity.SPEED: SPEEDS,
    Quantity.POSITION: POSITIONS,
}
FILTER_MAX = 4000
"""Longest XPath in a request, as it is sent: the C++ agent takes a head of 8 KiB in all."""
_PLAIN_ID = re.compile(r'[\w.-]+', re.ASCII)  # agents rewrite a path at slashes and colons


class MtconnectLink(Link):
    """One connection to an agent.

    A thread reads, since the agent sends when it likes; a reading is what was said last.  The
    agent's clock stamps nothing here: readings have the machine time at which they are taken.

    Parameters
    ----------
    device : MtconnectDevice
        Where it is and which data items to read.
    """

    def __init__(self, device: MtconnectDevice) -> None:
        self._device = device
        # How often changes are sent, and the state is asked for where the agent sends none.
        self._pause = min(device.period, HEARTBEAT)
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._trust: ssl.SSLContext | None = None
        self._socket: socket.socket | None = None
        self._found: list[DataItem | str] = []
        self._values: dict[str, str] = {}
        self._events: Counter[str] = Counter()
        self._ahead = math.nan
        self._heard = 0.0
        self._failure: Exception | None = None
        self._ended: asyncio.Event | None = None

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes."""
        return 1

    @property
    def facts(self) -> Mapping[str, str]:
        """Events since the connection was made, and the lead of the agent's clock."""
        with self._lock:
            facts = {name: str(self._events[name]) for name in ('sequence_gaps', 'restarts')}
            if math.isfinite(self._ahead):
                facts['clock_ahead'] = f'{self._ahead:.1f} s'
            return facts

    async def open(self) -> None:
        """Ask for the data items and their present state."""
        loop = asyncio.get_running_loop()
        ready, ended = asyncio.Event(), asyncio.Event()
        self._ended = ended

        def tell(event: asyncio.Event) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                loop.call_soon_threadsafe(event.set)

        def run() -> None:
            self._run(partial(tell, ready))
            tell(ended)

        threading.Thread(target=run, name='mtconnect', daemon=True).start()
        await ready.wait()
        if self._failure is not None:
            raise self._failure

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel."""
        with self._lock:
            if self._failure is not None:
                raise self._failure
            silent = time.monotonic() - self._heard
            if silent > HEARTBEAT + self._device.timeout:
                raise LinkError(f'the agent is silent for {silent:.1f} s; is it still running?')
            pairs = zip(self._device.channels, self._found, strict=True)
            return [self._reading(channel, item) for channel, item in pairs]

    async def close(self) -> None:
        """Drop the connection, which ends the thread."""
        self._closed.set()
        with self._lock:
            self._drop()
        if self._ended is not None:
            await self._ended.wait()

    def _reading(self, channel: DataItemChannel, item: DataItem | str) -> Reading:
        if isinstance(item, str):
            return item
        if item.identifier not in self._values:
            return f'data item {channel.item}: the agent has no value for it'
        return reading_of(channel, item, self._values[item.identifier])

    def _run(self, tell: Callable[[], None]) -> None:
        """Read until something is wrong, or the link is closed; the thread's whole life."""
        failure: Exception
        try:
            self._follow(tell)
        except http.client.HTTPException as error:
            failure = LinkError(f'expected an answer of HTTP but found {error!r}')
        except Exception as error:
            failure = error
        with self._lock:
            self._failure = failure
            self._drop()
        tell()

    def _drop(self) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # it is gone already
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()
            self._socket = None

    def _follow(self, tell: Callable[[], None]) -> None:
        """Take the present state, then what changes; begin anew after a restart or a gap."""
        if self._device.encrypted:
            self._trust = ssl.create_default_context(cafile=self._device.ca_file)
        while True:
            probe = self._document('probe', 'MTConnectDevices')
            found = [find(channel, probe.items) for channel in self._device.channels]
            current, chosen = self._present(
                {i.identifier for i in found if isinstance(i, DataItem)}
            )
            if current.following is None:
                raise LinkError('expected nextSequence in the header but it is missing')
            with self._lock:
                self._found = found
                self._values.clear()
            self._take(current)
            tell()
            event = self._listen(current, current.following, chosen)
            with self._lock:
                self._events[event] += 1
            self._rest()

    def _present(self, wanted: set[str]) -> tuple[Document, str]:
        """Return the present state, and the path by which the agent sends no more than is wanted.

        An agent that refuses the path, or leaves out what it has, is asked for everything.
        """
        if chosen := path_of(wanted):
            with contextlib.suppress(LinkError):
                current = self._document(f'current?path={chosen}', 'MTConnectStreams')
                if wanted <= current.observations.keys():
                    return current, f'&path={chosen}'
        return self._document('current', 'MTConnectStreams'), ''

    def _listen(self, current: Document, following: int, chosen: str) -> str:
        """Take what changes; return what ended that: `restarts` or `sequence_gaps`."""
        count = min(COUNT, current.buffer_size or COUNT)
        times = f'interval={self._pause * 1e3:.0f}&heartbeat={HEARTBEAT * 1e3:.0f}'
        while True:
            for document in self._documents(
                f'sample?from={following}&count={count}&{times}{chosen}'
            ):
                if document.instance != current.instance:
                    return 'restarts'
                lost = document.first is not None and document.first > following
                if lost or OUT_OF_RANGE in document.errors:
                    return 'sequence_gaps'
                self._take(_checked(document, 'MTConnectStreams'))
                if document.following is not None:
                    following = document.following
            # It ended the stream in good order, or sends none.
            self._rest()

    def _rest(self) -> None:
        if self._closed.wait(self._pause):
            raise LinkError('closed')

    def _take(self, document: Document) -> None:
        ahead, told = _ahead(document.created), document.observations
        with self._lock:
            self._heard = time.monotonic()
            # No others: an agent that tells of ever new ones would fill the memory.
            wanted = [item.identifier for item in self._found if isinstance(item, DataItem)]
            self._values.update((name, told[name]) for name in wanted if name in told)
            self._ahead = ahead

    def _document(self, request: str, kind: str) -> Document:
        """Return the one document that answers a request."""
        for document in self._documents(request):
            return _checked(document, kind)
        raise LinkError(f'{request}: expected a document but the agent sent none')

    def _documents(self, request: str) -> Iterator[Document]:
        """Yield the documents that answer a request."""
        with self._ask(request) as response:
            kind = response.headers.get_content_type()
            if kind.startswith('multipart/'):  # which one differs from agent to agent
                yield from _parts(response)
                return
            data = response.read(DOCUMENT_MAX + 1)
        _check_size(len(data))
        if response.status != http.client.OK and not kind.endswith('xml'):
            raise LinkError(
                f'{request.partition("?")[0]}: the agent answers HTTP status {response.status}; '
                'is the url right?'
            )
        yield parse(data)

    def _ask(self, request: str) -> http.client.HTTPResponse:
        device = self._device
        make: Callable[..., http.client.HTTPConnection] = http.client.HTTPConnection
        if self._trust is not None:
            make = partial(http.client.HTTPSConnection, context=self._trust)
        connection = make(device.host, device.port, timeout=HEARTBEAT + device.timeout)
        try:
            connection.connect()
        except ssl.SSLCertVerificationError as error:
            raise LinkError(
                f'the certificate of the agent is not trusted ({error.verify_message}); compare '
                'the host in url with the names in it, or name the certificate of who vouches for '
                'it as ca_file'
            ) from error
        except ssl.SSLError as error:
            raise LinkError(
                f'expected TLS but the agent speaks none ({error.reason}); does it serve https?'
            ) from error
        with self._lock:
            self._drop()
            if self._closed.is_set():
                connection.close()
                raise LinkError('closed')
            self._socket = connection.sock
        connection.request('GET', f'{device.path}/{request}', headers={'Accept': 'text/xml'})
        return connection.getresponse()


def path_of(identifiers: set[str]) -> str:
    """Return the XPath of data items as it is sent; empty where an agent might not take it."""
    if not identifiers or not all(_PLAIN_ID.fullmatch(name) for name in identifiers):
        return ''
    tests = ' or '.join(f'@id="{name}"' for name in sorted(identifiers))
    made = quote(f'//DataItem[{tests}]', safe='')
    return made if len(made) <= FILTER_MAX else ''


def find(channel: DataItemChannel, items: Sequence[DataItem]) -> DataItem | str:
    """Return the data item of a channel, by id or else by name; or why there is none."""
    wanted = channel.item
    found = [item for item in items if item.identifier == wanted]
    found = found or [item for item in items if item.name == wanted]
    if not found:
        units = UNITS[channel.quantity]
        fit = [item.identifier for item in items if item.units in units]
        more = ', '.join(fit[:NAMED_MAX]) + (', ...' if len(fit) > NAMED_MAX else '')
        remedy = f'; of this kind it has {more}' if fit else ''
        return f'data item {wanted}: the agent has none of this id or name{remedy}'
    if len(found) > 1:
        ids = ', '.join(item.identifier for item in found[:NAMED_MAX])
        return f'data item {wanted}: several have this name; write the id, one of {ids}'
    return found[0]


def reading_of(channel: DataItemChannel, item: DataItem, text: str) -> Reading:
    """Return the quantity that an agent tells of a data item, or why there is none."""
    place = f'data item {channel.item}'
    if text == UNAVAILABLE:
        return f'{place}: the agent reports {UNAVAILABLE}'
    if not NUMBER.fullmatch(text):
        return f'{place}: expected a number but found {shown(text)}'
    raw = float(text)
    if raw in channel.open_circuit:
        return f'open circuit (raw value {text})'
    if item.units or channel.quantity is Quantity.POSITION:
        units = UNITS[channel.quantity]
        if item.units not in units:
            found = item.units[:40] or 'no unit'
            return f'{place}: expected one of {", ".join(units)} but found {found}'
        factor, offset = units[item.units]
        raw = (factor * raw + offset) / channel.unit
    value = scaled(channel, raw)
    if channel.quantity is not Quantity.TEMPERATURE:
        return value
    if trouble := no_temperature(float(text), value):
        return f'{place}: {trouble}; is it the right data item, and the right scale?'
    return value


def _checked(document: Document, kind: str) -> Document:
    """Return a document of the wanted kind."""
    if document.kind != kind:
        said = '; '.join(f'{code} {text}' for code, text in document.errors.items())
        raise LinkError(f'expected {kind} but the agent sent {document.kind}: {said}')
    return document


def _check_size(size: int) -> None:
    if size > DOCUMENT_MAX:
        raise LinkError(
            f'expected a document up to {DOCUMENT_MAX >> 20} MiB but found a larger one; name one '
            'machine of the agent in the url, http://HOST:PORT/MACHINE'
        )


def _parts(response: http.client.HTTPResponse) -> Iterator[Document]:
    """Yield the documents of a stream until the agent ends it."""
    boundary = response.headers.get_boundary('')
    if not boundary:
        raise LinkError('expected a boundary of the stream but it is missing')
    while True:
        headers = _part_headers(response, boundary.removeprefix('--').encode())
        if headers is None:
            return
        length = headers.get('content-length', '')
        if not (length.isascii() and length.isdecimal() and len(length) < 20):
            raise LinkError(f'expected a Content-length in the stream but found {length[:40]!r}')
        _check_size(int(length))
        data = response.read(int(length))
        if len(data) < int(length):
            return
        yield parse(data)


def _part_headers(response: http.client.HTTPResponse, boundary: bytes) -> Mapping[str, str] | None:
    """Return what stands before the next document, None if the stream is at its end."""
    inside, headers = False, {}
    for _ in range(HEADERS_MAX):
        line = response.readline(LINE_MAX)
        if not line:
            return None
        line = line.strip()
        if not inside:
            inside = line.lstrip(b'-') == boundary.lstrip(b'-')
            if line == b'--' + boundary + b'--':
                return None
            if line and not inside:
                raise LinkError(f'expected a boundary of the stream but found {line[:40]!r}')
        elif line:
            name, _, value = line.decode('latin-1').partition(':')
            headers[name.strip().lower()] = value.strip()
        elif headers:
            return headers
    raise LinkError(f'expected at most {HEADERS_MAX} lines before a document but found more')


def _ahead(created: str) -> float:
    """Return by how much a time of day is ahead of ours [s], NaN if it is none."""
    try:
        stamp = datetime.fromisoformat(created.replace('Z', '+00:00'))
    except ValueError:
        return math.nan
    if stamp.tzinfo is None:
        stamp = stamp.replace(tzinfo=timezone.utc)
    return (stamp - datetime.now(timezone.utc)).total_seconds()
