# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Temperatures of a printer that runs Klipper, by Moonraker's interface over HTTP or WebSocket."""

import asyncio
import http.client
import json
import re
import ssl
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote, urlsplit

from fuzzycnc_ros.adapters.opcua.file_fields import File
from fuzzycnc_ros.adapters.readings.device_fields import DeviceFields, Scaling, SensorFields
from fuzzycnc_ros.adapters.readings.devices import Device, DeviceChannel
from fuzzycnc_ros.adapters.readings.link import Link, LinkError, Reading
from fuzzycnc_ros.adapters.readings.plausible_value import reading_of, shown
from fuzzycnc_ros.adapters.yaml_model import (
    SWITCH,
    AfterValidator,
    Choice,
    Field,
    Shorthand,
    Text,
    address_of,
    model_validator,
    wrong,
)
from fuzzycnc_ros.bags.secret_file import check_secret
from fuzzycnc_ros.ros.parameters import ParameterError

ANSWER_MAX = 1 << 20
"""Longest answer that is read [bytes]."""
HOOKS, READY = 'webhooks', 'ready'
"""Klipper's object that tells its state, and the one in which its temperatures are alive."""
REFUSED_PAUSE = 30.0
"""Pause after a refused key [s]."""


@dataclass(frozen=True, kw_only=True)
class Heater(DeviceChannel):
    """A field of one of Klipper's objects."""

    object: str
    field: str = 'temperature'


@dataclass(frozen=True, kw_only=True)
class Moonraker(Device):
    """A Moonraker.

    Parameters
    ----------
    url : str
        http, https, ws or wss, host and port.
    ca_file : Path, optional
        Certificates of those who may vouch for it; None: those that the system trusts.
    api_key : Path, optional
        File with the key by which it lets clients in.
    """

    channels: tuple[Heater, ...]
    url: str
    ca_file: Path | None
    api_key: Path | None

    @property
    def address(self) -> str:
        """Address for messages."""
        return f'Moonraker {self.url}'

    def connect(self) -> Link:
        """Return a new link to it."""
        return WebSocketLink(self) if self.url.startswith('ws') else HttpLink(self)

    def check(self) -> None:
        """Refuse to begin without the library, or with a key that others can read."""
        try:
            if self.url.startswith('ws'):
                import websockets.asyncio.client  # noqa: F401
            self.headers()
        except ImportError as error:
            raise ParameterError(
                f'device {self.name}: a WebSocket needs websockets ({error}); run pip install '
                "'fuzzycnc_ros[page]', or write http:// in url"
            ) from error
        except (OSError, ValueError) as error:
            raise ParameterError(f'device {self.name}: {error}') from None

    def headers(self) -> dict[str, str]:
        """Return what lets us in."""
        if self.api_key is None:
            return {}
        check_secret(self.api_key, 'api_key')
        return {'X-Api-Key': self.api_key.read_text().strip()}

    def trust(self) -> ssl.SSLContext | None:
        """Return how its certificate is judged; None without encryption."""
        if self.url.startswith(('https:', 'wss:')):
            return ssl.create_default_context(cafile=self.ca_file)
        return None


def _url(text: str) -> str:
    parts = address_of(text, ('http', 'https', 'ws', 'wss'))
    if parts is None or parts.path.strip('/') or parts.query or parts.fragment:
        raise wrong(f'expected http://HOST:PORT or ws://HOST:PORT, port 7125, but found {text!r}')
    if '@' in parts.netloc:
        raise wrong('expected no user and password here; put the key into the file api_key')
    return text.rstrip('/')


class _SensorHeater(SensorFields, Scaling):
    CHANNEL = Heater

    object: Annotated[str, Text()] = Field(
        description="Klipper's object, such as heater_bed, extruder or temperature_sensor NAME"
    )
    field: Annotated[str, Text()] = Field('temperature', description='Field of the object')


class MoonrakerFields(DeviceFields):
    """A printer that runs Klipper, by its Moonraker."""

    INHERITED = ()
    SHORTHAND = 'object'

    protocol: Annotated[str, Choice(('moonraker',))]
    url: Annotated[str, Text(r'(http|ws)s?://.+'), AfterValidator(_url)] = Field(
        description='Address, http://HOST:PORT or ws://HOST:PORT, with s behind if encrypted'
    )
    ca_file: File = Field(
        default_factory=Path,
        description='Certificates of those who may vouch for it, PEM; without it those that the '
        'system trusts',
    )
    api_key: File = Field(
        default_factory=Path, description='File with the key, where Moonraker wants one'
    )
    allow_plain_password: Annotated[bool, Choice(SWITCH)] = Field(
        False, description='Whether the key may go out so that others can read it'
    )
    sensors: dict[str, Annotated[_SensorHeater, Shorthand('object')]] = Field(
        {}, description="Sensors by name; a mere text is Klipper's object"
    )

    @model_validator(mode='after')
    def _check_key(self) -> 'MoonrakerFields':
        safe = self.url.startswith(('https:', 'wss:')) or self.allow_plain_password
        if self.api_key != Path() and not safe:
            raise wrong(
                'expected https:// or wss:// in url beside it, since without it everybody on the '
                'network can read the key; change it, or say allow_plain_password: true',
                'api_key',
            )
        return self

    def device(self, folder: Path) -> Moonraker:
        """Return the device."""
        return Moonraker(
            **self.values(),
            timeout=self.timeout,
            url=self.url,
            ca_file=self.ca_file if self.ca_file != Path() else None,
            api_key=self.api_key if self.api_key != Path() else None,
        )


class _MoonrakerLink(Link):
    """One connection to a Moonraker, which is asked for each reading.

    It is not subscribed to: a subscription is silent where nothing changes.
    """

    def __init__(self, device: Moonraker) -> None:
        self._device = device
        self._wanted: dict[str, list[str]] = {HOOKS: ['state', 'state_message']}
        for channel in device.channels:
            self._wanted.setdefault(channel.object, []).append(channel.field)

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes."""
        return 1

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel."""
        answer = await self._ask()
        found = answer.get('status') if isinstance(answer, dict) else None
        if not isinstance(found, dict):
            raise LinkError(f'expected the status of objects but found {shown(answer)}')
        hooks = found.get(HOOKS)
        hooks = hooks if isinstance(hooks, dict) else {}
        if hooks.get('state') != READY:
            said = ' '.join(str(hooks.get('state_message', '')).split())
            return [
                f'Klipper is in the state {shown(hooks.get("state"))}, in which its temperatures '
                f'do not change: {said[:200]}'
            ] * len(self._device.channels)
        return [_reading(channel, found) for channel in self._device.channels]

    @abstractmethod
    async def _ask(self) -> Any:
        """Return the result of a query for all objects."""


def _reading(channel: Heater, found: Mapping[str, Any]) -> Reading:
    place = f'{channel.object} {channel.field}'
    values = found.get(channel.object)
    if not isinstance(values, dict) or channel.field not in values:
        what = f'field {channel.field}' if values else 'such object'
        return (
            f'{place}: Klipper has no {what}; its section of the configuration is the name, and '
            '/printer/objects/list shows all'
        )
    return reading_of(channel, values[channel.field], place, 'is it the right field?')


class HttpLink(_MoonrakerLink):
    """By HTTP; each request has a thread, since the library waits."""

    def __init__(self, device: Moonraker) -> None:
        super().__init__(device)
        fields = '&'.join(f'{quote(o)}={quote(",".join(f))}' for o, f in self._wanted.items())
        self._path = f'/printer/objects/query?{fields}'
        self._connection: http.client.HTTPConnection | None = None

    async def open(self) -> None:
        """Connect."""
        await asyncio.to_thread(self._connect)

    async def close(self) -> None:
        """Drop the connection."""
        if self._connection is not None:
            self._connection.close()

    def _connect(self) -> None:
        parts, trust = urlsplit(self._device.url), self._device.trust()
        make: Callable[..., http.client.HTTPConnection] = http.client.HTTPConnection
        if trust is not None:
            make = partial(http.client.HTTPSConnection, context=trust)
        self._connection = make(parts.hostname, parts.port, timeout=self._device.timeout)
        self._connection.connect()

    async def _ask(self) -> Any:
        status, data = await asyncio.to_thread(self._get)
        try:
            answer = json.loads(data)
        except ValueError:
            answer = None
        if status != http.client.OK or not isinstance(answer, dict) or 'result' not in answer:
            raise _refusal(answer, status)
        return answer['result']

    def _get(self) -> tuple[int, bytes]:
        assert self._connection is not None
        try:
            self._connection.request('GET', self._path, headers=self._device.headers())
            response = self._connection.getresponse()
            data = response.read(ANSWER_MAX + 1)
        except http.client.HTTPException as error:
            raise LinkError(f'expected an answer of HTTP but found {error!r}') from error
        if len(data) > ANSWER_MAX:
            raise LinkError(f'expected an answer of at most {ANSWER_MAX >> 20} MiB')
        return response.status, data


class WebSocketLink(_MoonrakerLink):
    """By JSON-RPC over a WebSocket."""

    def __init__(self, device: Moonraker) -> None:
        super().__init__(device)
        self._socket: Any = None
        self._number = 0

    async def open(self) -> None:
        """Connect."""
        from websockets.asyncio.client import connect
        from websockets.exceptions import InvalidStatus, WebSocketException

        try:
            self._socket = await connect(
                f'{self._device.url}/websocket',
                additional_headers=self._device.headers(),
                ssl=self._device.trust(),
                max_size=ANSWER_MAX,
                proxy=None,
                open_timeout=None,  # the poller has one for the whole
                close_timeout=0.5,
            )
        except InvalidStatus as error:
            raise _refusal(None, error.response.status_code) from error
        except WebSocketException as error:
            raise LinkError(f'expected a WebSocket but found {error}') from error

    async def close(self) -> None:
        """Drop the connection."""
        if self._socket is not None:
            await self._socket.close()

    async def _ask(self) -> Any:
        from websockets.exceptions import WebSocketException

        self._number += 1
        request = {
            'jsonrpc': '2.0',
            'method': 'printer.objects.query',
            'params': {'objects': self._wanted},
            'id': self._number,
        }
        try:
            await self._socket.send(json.dumps(request))
            # It tells much that nobody asked for in between.
            while True:
                text = await asyncio.wait_for(self._socket.recv(), self._device.timeout)
                answer = json.loads(text)
                if isinstance(answer, dict) and answer.get('id') == self._number:
                    break
        except WebSocketException as error:
            raise LinkError(f'connection lost ({error})') from error
        if 'result' not in answer:
            raise _refusal(answer, http.client.OK)
        return answer['result']


def _refusal(answer: Any, status: int) -> LinkError:
    """Return what a refusal means, by the words that come with it."""
    error = answer.get('error') if isinstance(answer, dict) else None
    said = error.get('message', '') if isinstance(error, dict) else ''
    said = re.sub(r'\s+', ' ', str(said))[:200]
    if status in (http.client.UNAUTHORIZED, http.client.FORBIDDEN) or 'nauthorized' in said:
        return LinkError(
            'Moonraker lets us not in; name the key as api_key, or add this computer to its '
            'trusted_clients',
            REFUSED_PAUSE,
        )
    return LinkError(f'Moonraker answers {said or f"HTTP status {status}"}; does Klipper run?')
