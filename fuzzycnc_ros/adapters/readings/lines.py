# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Plain lines of text over a serial line or TCP, as a few lines of firmware or a script send them.

`T1 21.5 T2 22.0`, `T1=21.5`, `T1: 21.5C` and JSON objects are pairs of a name and a value; with
`columns` a line is values in that order, separated by commas, semicolons, tabs or spaces.
"""

import asyncio
import contextlib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from fuzzycnc_ros.adapters.readings.device_fields import (
    CONVERSION,
    Conversion,
    DeviceFields,
    Scaling,
    SensorFields,
    SpeedFields,
)
from fuzzycnc_ros.adapters.readings.devices import Device, DeviceChannel
from fuzzycnc_ros.adapters.readings.link import Link, LinkError, Reading, port_trouble
from fuzzycnc_ros.adapters.readings.plausible_value import NUMBER, reading_of, shown
from fuzzycnc_ros.adapters.readings.pushed import Pushed
from fuzzycnc_ros.adapters.yaml_model import (
    AfterValidator,
    BeforeValidator,
    Choice,
    Field,
    Fields,
    Number,
    Shorthand,
    Text,
    model_validator,
    wrong,
)
from fuzzycnc_ros.ros.parameters import ParameterError

LINE_MAX = 4096
"""Longest line [bytes]; what is longer is no line."""
ADDRESS = r'/[^:]+|[A-Za-z0-9._%-]+:[0-9]{1,5}'
NO_COLUMN = '-'
"""Name of a column that is not read."""
UNITS = {'c': (1.0, 0.0), 'f': (5.0 / 9.0, -160.0 / 9.0), 'k': (1.0, -273.15)}
"""Factor and offset to degC of the letter behind a value."""
_UNIT = re.compile(r'(?:deg|°|º)?([cfk])', re.I)
_BETWEEN = re.compile(r'[\s=:;]+|,(?!\d+(?:[\s;]|$))')
"""Between names and values; a comma before a mere number is one of a decimal fraction."""
_COLUMN = re.compile(r'\s*[,;\t]\s*|\s+')


@dataclass(frozen=True, kw_only=True)
class Named(DeviceChannel):
    """A value in lines, by its name there."""

    key: str


@dataclass(frozen=True, kw_only=True)
class LineDevice(Device):
    """A device that sends lines.

    Parameters
    ----------
    port : str
        File of a serial port, or host and TCP port as HOST:PORT.
    baud_rate : int
        Bits per second of a serial port.
    columns : tuple of str
        Names of the values of a line in their order; empty where lines are pairs.
    """

    channels: tuple[Named, ...]
    port: str
    baud_rate: int
    columns: tuple[str, ...]

    @property
    def is_serial(self) -> bool:
        """True if it is a serial port."""
        return self.port.startswith('/')

    @property
    def address(self) -> str:
        """Address for messages."""
        return f'lines from {self.port}'

    def connect(self) -> Link:
        """Return a new link to it."""
        return LineLink(self)

    def check(self) -> None:
        """Refuse to begin without the library of serial ports."""
        try:
            if self.is_serial:
                import serial  # noqa: F401
        except ImportError as error:
            raise ParameterError(
                f'device {self.name}: a serial port needs pyserial ({error}); run pip install '
                "'fuzzycnc_ros[modbus]'"
            ) from error


class _Key(Fields):
    key: Annotated[str, Text()] = Field(description='Name of the value in the lines')


class _SensorKey(SensorFields, _Key, Conversion):
    CHANNEL = Named


class _SpeedKey(SpeedFields, _Key, Scaling):
    CHANNEL = Named


def _address(text: str) -> str:
    if not re.fullmatch(ADDRESS, text):
        raise wrong(
            'expected the file of a serial port, such as /dev/ttyUSB0, or HOST:PORT but found '
            f'{text!r}'
        )
    return text


def _texts(node: Any) -> list[str]:
    return [Text().read(item) for item in (node if isinstance(node, list) else [node])]


class LineFields(Conversion, DeviceFields):
    """A device that sends lines of text."""

    DEVICE = LineDevice
    INHERITED = CONVERSION
    SHORTHAND = 'key'

    protocol: Annotated[str, Choice(('lines',))]
    port: Annotated[str, Text(ADDRESS), AfterValidator(_address)] = Field(
        description='File of a serial port, or HOST:PORT'
    )
    baud_rate: Annotated[int, Number(300, 4_000_000, whole=True)] = Field(
        115200, description='Bits per second of a serial port'
    )
    timeout: Annotated[float, Number(0.05, 60.0, 's')] = Field(
        2.0, description='Longest silence between two lines [s]'
    )
    columns: Annotated[
        tuple[str, ...], BeforeValidator(_texts, json_schema_input_type=list[str])
    ] = Field(
        (), description='Names of the values of a line in their order, - for one that is not read'
    )
    sensors: dict[str, Annotated[_SensorKey, Shorthand('key')]] = Field(
        {}, description='Sensors by name; a mere text is the name of the value in the lines'
    )
    spindle_speed: _SpeedKey | None = Field(None, description='Spindle speed')

    @model_validator(mode='after')
    def _check_columns(self) -> 'LineFields':
        spindle = () if self.spindle_speed is None else (self.spindle_speed,)
        for entry in (*self.sensors.values(), *spindle) if self.columns else ():
            if self.columns.count(entry.key) != 1 or entry.key == NO_COLUMN:
                raise wrong(
                    f'expected {entry.key!r} once among them but found {", ".join(self.columns)}',
                    'columns',
                )
        return self

    def clash(self, other: DeviceFields) -> str:
        """Return why two devices do not go together: one reads a serial port."""
        if getattr(other, 'port', None) != self.port or not self.port.startswith('/'):
            return ''
        return f'{self.port} is already read by device {other.name}; name all sensors there'


class LineLink(Link):
    """One connection to a device that sends lines."""

    def __init__(self, device: LineDevice) -> None:
        self._device = device
        self._keys = [channel.key for channel in device.channels]
        self._pushed = Pushed(device.timeout)
        self._held: bytes | None = None  # of the first line an unknown part was missed
        self._refused = 0
        self._last = self._failure = ''
        self._serial: Any = None
        self._writer: asyncio.StreamWriter | None = None
        self._task: asyncio.Task[None] | None = None

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes."""
        return 1

    @property
    def facts(self) -> dict[str, str]:
        """Number of refused lines since the connection was made."""
        return {'lines_refused': str(self._refused)}

    async def open(self) -> None:
        """Open the port, or connect."""
        if self._device.is_serial:
            self._open_serial()
            return
        host, _, port = self._device.port.rpartition(':')
        reader, self._writer = await asyncio.open_connection(host, int(port))
        self._task = asyncio.create_task(self._receive(reader))

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel, once something has come."""
        device = self._device
        await self._pushed.wait(device.timeout, self._keys)
        if self._failure:
            raise LinkError(self._failure)
        silence = self._pushed.silence
        if silence > device.timeout and not device.is_serial:
            raise LinkError(f'no line for {silence:.1f} s; is the other end still there?')
        return [self._reading(channel) for channel in device.channels]

    async def close(self) -> None:
        """Let go of the port, or of the connection."""
        if self._serial is not None:
            with contextlib.suppress(OSError, ValueError):  # it has gone
                asyncio.get_running_loop().remove_reader(self._serial.fileno())
            self._serial.close()
        if self._task is not None:
            self._task.cancel()
        if self._writer is not None:
            self._writer.close()

    def _open_serial(self) -> None:
        import serial

        port = self._device.port
        try:
            self._serial = serial.Serial(port, self._device.baud_rate, timeout=0, exclusive=True)
        except (OSError, ValueError) as error:  # those of the library are among them
            raise LinkError(port_trouble(port)) from error
        # To wait for silence to end costs nothing; to open it anew resets many boards.
        asyncio.get_running_loop().add_reader(self._serial.fileno(), self._receive_serial)

    def _receive_serial(self) -> None:
        try:
            data = self._serial.read(LINE_MAX)
        except (OSError, TypeError):  # as the library says that the port has gone
            data = b''
        if not data:
            with contextlib.suppress(OSError, ValueError):
                asyncio.get_running_loop().remove_reader(self._serial.fileno())
            self._fail(f'{self._device.port} has gone; is it plugged in?')
            return
        self._feed(data)

    async def _receive(self, reader: asyncio.StreamReader) -> None:
        try:
            while data := await reader.read(LINE_MAX):
                self._feed(data)
            self._fail('connection closed by the other end')
        except OSError as error:
            self._fail(f'connection lost ({error})')

    def _fail(self, text: str) -> None:
        self._failure = text
        self._pushed.end()

    def _feed(self, data: bytes) -> None:
        *lines, rest = re.split(rb'[\r\n]+', (self._held or b'') + data)
        if self._held is None and lines:
            del lines[0]
            self._held = b''
        if self._held is not None or len(rest) > LINE_MAX:
            self._refused += len(rest) > LINE_MAX
            self._held = rest if len(rest) <= LINE_MAX else None
        for line in filter(bytes.strip, lines):
            self._last = shown(line)
            self._pushed.hear()
            self._refused += not self._take(line)

    def _take(self, line: bytes) -> bool:
        """Take the values of a line; return whether it has any."""
        try:
            text = line.decode()
        except UnicodeDecodeError:
            return False
        found = list(values_of(text, self._keys, self._device.columns))
        for key, value in found:
            self._pushed.put(key, value)
        return bool(found)

    def _reading(self, channel: Named) -> Reading:
        raw, trouble = self._pushed.fresh(channel.key)
        if trouble:
            if self._last:
                trouble += f'; compare baud_rate, key and columns with the last line, {self._last}'
            return f'{channel.key}: {trouble}'
        remedy = 'the lines are in degC? for volts, counts or ohms say ntc, or scale and offset'
        return reading_of(channel, raw, channel.key, remedy)


def values_of(
    line: str, keys: Sequence[str], columns: Sequence[str]
) -> Iterator[tuple[str, object]]:
    """Yield the names and values in a line: a number, or the text that stands for one.

    Examples
    --------
    >>> list(values_of('12:30 T1=21.5 T2: 71.6F', ['T1', 'T2'], []))
    [('T1', 21.5), ('T2', 22.0)]
    >>> list(values_of('7; 21,5', ['T1'], ['-', 'T1']))
    []
    """
    if columns:
        cells = _COLUMN.split(line.strip())
        if len(cells) == len(columns):
            yield from ((k, value_in(c)) for k, c in zip(columns, cells, strict=True) if k in keys)
        return
    if line.lstrip().startswith('{'):
        with contextlib.suppress(ValueError, RecursionError):
            found = json.loads(line)
            for key in found.keys() & set(keys):
                value = found[key]
                yield key, value_in(value.strip()) if isinstance(value, str) else value
        return
    words = [word for word in _BETWEEN.split(line) if word]
    at = 0
    while at + 1 < len(words):
        name, value = words[at], value_in(words[at + 1])
        if name in keys:
            at += 2
            apart = words[at] if at < len(words) else ''  # a unit may stand apart
            if isinstance(value, float) and apart not in keys and _UNIT.fullmatch(apart):
                value, at = value_in(words[at - 1] + apart), at + 1
            yield name, value
        else:
            at += 1


def value_in(text: str) -> object:
    """Return the number in a text, with a unit behind it in degC; the text itself if it has none.

    Examples
    --------
    >>> value_in('21.5'), value_in('295.15K'), value_in('10kohm')
    (21.5, 22.0, '10kohm')
    """
    found = NUMBER.match(text)
    if found is None:
        return text
    unit = text[found.end() :]
    if not unit:
        return float(found[0])
    matched = _UNIT.fullmatch(unit)
    if matched is None:
        return text
    factor, offset = UNITS[matched[1].lower()]
    return factor * float(found[0]) + offset
