# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors whose values come as messages of a broker, such as those of Tasmota or Zigbee2MQTT."""

import asyncio
import contextlib
import json
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from fuzzycnc_ros.adapters.mqtt.broker_file import Broker, BrokerFields
from fuzzycnc_ros.adapters.mqtt.connection import new_client
from fuzzycnc_ros.adapters.opcua.file_fields import read_credentials
from fuzzycnc_ros.adapters.readings.device_fields import (
    CONVERSION,
    Conversion,
    DeviceFields,
    Scaling,
    SensorFields,
    SpeedFields,
)
from fuzzycnc_ros.adapters.readings.devices import SPINDLE, Device, DeviceChannel
from fuzzycnc_ros.adapters.readings.lines import value_in
from fuzzycnc_ros.adapters.readings.link import Link, LinkError, Reading
from fuzzycnc_ros.adapters.readings.plausible_value import reading_of, shown
from fuzzycnc_ros.adapters.readings.pushed import Pushed
from fuzzycnc_ros.adapters.yaml_model import (
    AfterValidator,
    Choice,
    Field,
    Number,
    Shorthand,
    Text,
    wrong,
)
from fuzzycnc_ros.ros.parameters import ParameterError

PAYLOAD_MAX = 64 << 10
"""Longest message that is looked at [bytes]."""
MATCHES_MAX = 3
"""Most topics that are told apart behind one with wildcards."""
UNIT = 'TempUnit'
"""Field by which Tasmota says the unit of its temperatures."""
REFUSED_PAUSE = 30.0
"""Pause after refused credentials [s]: brokers may lock users who try too often."""


@dataclass(frozen=True, kw_only=True)
class Message(DeviceChannel):
    """A value in messages: their topic, with wildcards, and the way to it in a JSON document."""

    topic: str
    way: str = ''

    @property
    def place(self) -> str:
        """Topic and path of the reading, for messages."""
        return f'{self.topic} {self.way}'.rstrip()


@dataclass(frozen=True, kw_only=True)
class MqttDevice(Broker, Device):
    """A broker that has messages of sensors; older ones than `max_age` [s] are no reading."""

    channels: tuple[Message, ...]
    max_age: float

    def connect(self) -> Link:
        """Return a new link to it."""
        return MqttLink(self)

    def check(self) -> None:
        """Refuse to begin without the library, or with a certificate or secret of no use."""
        try:
            new_client(self)
            if self.credentials is not None:
                read_credentials(self.credentials)
        except ParameterError as error:
            raise ParameterError(f'device {self.name}: {error}') from None


def _filter(text: str) -> str:
    levels = text.split('/')
    if any(len(level) > 1 and set(level) & set('#+') for level in levels) or '#' in levels[:-1]:
        raise wrong(
            f'expected a topic, with + for one level and # for all that follow, but found {text!r}'
        )
    return text


class _Message(Scaling):
    CHANNEL = Message

    topic: Annotated[str, Text(), AfterValidator(_filter)] = Field(
        description='Topic; + stands for any one level, # for all that follow'
    )
    # `json` is a method of the class
    way: Annotated[str, Text()] = Field(
        '', alias='json', description='Way to the value in a JSON document, as A.B.0'
    )


class _SensorMessage(SensorFields, Conversion, _Message):
    pass


class _SpeedMessage(SpeedFields, _Message):
    pass


class MqttFields(Conversion, BrokerFields, DeviceFields):
    """A broker with messages of sensors."""

    INHERITED = CONVERSION
    SHORTHAND = 'topic'

    protocol: Annotated[str, Choice(('mqtt',))]
    keep_alive: Annotated[int, Number(1, 3600, 's', whole=True)] = Field(
        2, description='Time after which a silent connection counts as lost [s]'
    )
    max_age: Annotated[float, Number(0.1, 86400.0, 's')] = Field(
        60.0, description='Age from which the last message of a sensor is no reading [s]'
    )
    sensors: dict[str, Annotated[_SensorMessage, Shorthand('topic')]] = Field(
        {}, description='Sensors by name; a mere text is the topic'
    )
    spindle_speed: _SpeedMessage | None = Field(None, description='Spindle speed')

    def device(self, folder: Path) -> MqttDevice:
        """Return the device."""
        return MqttDevice(
            **self.values(), **self.way(), timeout=self.timeout, max_age=self.max_age
        )


class MqttLink(Link):
    """One connection to a broker; the library calls from a thread of its own."""

    def __init__(self, device: MqttDevice) -> None:
        self._device = device
        self._pushed = Pushed(device.max_age)
        self._loop = asyncio.get_running_loop()
        self._ready = asyncio.Event()
        self._failure: LinkError | None = None
        self._client: Any = None
        self._topics: defaultdict[str, set[str]] = defaultdict(set)
        self._kept: set[str] = set()
        """Sensors of which the broker had a message of unknown age."""

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes."""
        return 1

    async def open(self) -> None:
        """Connect, enter and subscribe."""
        device = self._device
        self._client = client = new_client(device)
        if device.credentials is not None:
            client.username_pw_set(*read_credentials(device.credentials))
        client.on_connect, client.on_connect_fail = self._on_connect, self._on_connect_fail
        client.on_subscribe, client.on_message = self._on_subscribe, self._on_message
        client.on_disconnect = self._on_disconnect
        client.connect_async(device.host, device.port, device.keep_alive)
        client.loop_start()
        await self._ready.wait()
        if self._failure is not None:
            raise self._failure

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel, once a message has come."""
        channels = self._device.channels
        await self._pushed.wait(self._device.timeout, [channel.name for channel in channels])
        if self._failure is not None:
            raise self._failure
        return [self._reading(channel) for channel in channels]

    async def close(self) -> None:
        """Drop the connection, and wait for the library's thread."""
        if self._client is not None:
            await asyncio.to_thread(self._end)

    def _end(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def _reading(self, channel: Message) -> Reading:
        topics = self._topics[channel.name]
        if len(topics) > 1:
            return f'{channel.topic}: {", ".join(sorted(topics))} fit; name one of them'
        payload, trouble = self._pushed.fresh(channel.name)
        if trouble:
            if channel.name in self._kept:
                trouble += ' but a message that the broker had kept, of unknown age'
            return (
                f'{channel.topic}: {trouble}; compare topic and max_age with what '
                f'`mosquitto_sub -v` shows, and have it send more often'
            )
        assert isinstance(payload, bytes)
        found, unit = value_at(payload, channel.way)
        if found is None:
            return f'{channel.place}: expected this path but found {shown(payload)}'
        if isinstance(found, str):
            found = value_in(found.strip())
        if unit and channel.name != SPINDLE and isinstance(found, (int, float)):
            found = value_in(f'{found}{unit}')
        remedy = 'is it the right topic and json? for degF or ohms say scale and offset, or ntc'
        return reading_of(channel, found, channel.place, remedy)

    def _soon(self, work: Callable[..., None], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            self._loop.call_soon_threadsafe(work, *arguments)

    def _fail(self, text: str, pause: float = 0.0) -> None:
        if self._failure is None:
            self._failure = LinkError(text, pause)
        self._ready.set()
        self._pushed.end()

    def _on_connect(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        if reason.is_failure:
            text = f'the broker refuses the connection ({reason}); compare credentials'
            self._soon(self._fail, text, REFUSED_PAUSE)
            return
        client.subscribe([(topic, 0) for topic in {c.topic for c in self._device.channels}])

    def _on_connect_fail(self, client: Any, data: Any) -> None:
        # Called where the failure is handled; the library does not say it otherwise.
        error = sys.exc_info()[1]
        text = f'cannot connect ({error}); is it on, are host, port and tls right?'
        self._soon(self._fail, text)

    def _on_subscribe(self, client: Any, data: Any, mid: int, reasons: Any, more: Any) -> None:
        refused = [str(reason) for reason in reasons if reason.is_failure]
        if refused:
            self._soon(
                self._fail, f'the broker refuses a topic ({refused[0]}); may this user read it?'
            )
        self._soon(self._ready.set)

    def _on_disconnect(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        self._soon(self._fail, f'connection lost ({reason})')

    def _on_message(self, client: Any, data: Any, message: Any) -> None:
        if len(message.payload) <= PAYLOAD_MAX:
            self._soon(self._take, message.topic, bytes(message.payload), message.retain)

    def _take(self, topic: str, payload: bytes, kept: bool) -> None:
        """Take a message for all channels that it has a value for."""
        from paho.mqtt.client import topic_matches_sub

        for channel in self._device.channels:
            if not topic_matches_sub(channel.topic, topic):
                continue
            if topic != channel.topic and value_at(payload, channel.way)[0] is None:
                continue  # of another kind behind the wildcard
            if kept:
                self._kept.add(channel.name)
                continue
            if len(self._topics[channel.name]) < MATCHES_MAX:
                self._topics[channel.name].add(topic)
            self._pushed.put(channel.name, payload)


def value_at(payload: bytes, path: str) -> tuple[object, str]:
    """Return the value at a path of a message, None if there is none, and the unit that it states.

    Examples
    --------
    >>> value_at(b'{"DS18B20": {"Temperature": 71.6}, "TempUnit": "F"}', 'DS18B20.Temperature')
    (71.6, 'F')
    >>> value_at(b'21.5', '')
    ('21.5', '')
    """
    text = payload.decode(errors='replace')
    if not path:
        return text, ''
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return None, ''
    unit = found.get(UNIT) if isinstance(found, dict) else None
    for step in path.split('.'):
        if isinstance(found, dict):
            found = found.get(step)
        elif isinstance(found, list) and step.isdecimal() and int(step) < len(found):
            found = found[int(step)]
        else:
            return None, ''
    return found, unit if unit in ('C', 'F') else ''
