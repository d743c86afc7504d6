# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Modbus RTU: the units of a serial line, which they share.

A frame of RTU names neither the request that it answers nor the register that it begins with.  So
an answer counts only where nothing else was on the line: each byte since a request is counted,
and what is neither the answer nor a short glitch disturbs the line for a while.
"""

import asyncio
import time
from collections.abc import Sequence
from typing import Any

from fuzzycnc_ros.adapters.modbus.devices import ModbusRtuDevice, SerialLine
from fuzzycnc_ros.adapters.modbus.link import ModbusLink, request
from fuzzycnc_ros.adapters.modbus.registers import RegisterBlock
from fuzzycnc_ros.adapters.readings.link import LinkError, Reading, port_trouble

FRAME_MIN = 4
"""Bytes of the shortest frame: unit, function, checksum.  Fewer are a glitch, as adapters make
them where a driver of the line turns round."""
FRAME_EXTRA = 5
"""Bytes of an answer beside its registers: unit, function, count, checksum."""
QUIET = 1.5
"""Time without other traffic after which a disturbed line is used again [s]."""
GAP_CHARACTERS, CHARACTER_BITS, GAP_MIN = 3.5, 11, 0.00175
"""Silence between frames as the specification lays down: characters, bits each, least [s]."""
DISTURBED = (
    'unrequested bytes on the line: another master, an answer that came too late, or '
    'noise; a line has one master, shielding and a terminator at each end'
)


class _Line:
    """An open line with the client of all its units."""

    def __init__(self, settings: SerialLine) -> None:
        from pymodbus.client import AsyncModbusSerialClient

        self.users: set[ModbusRtuLink] = set()
        self._port = settings.port
        self._gap = max(GAP_CHARACTERS * CHARACTER_BITS / settings.baud_rate, GAP_MIN)
        # Opening does not wait for the answer of another unit.
        self._opening, self._lock = asyncio.Lock(), asyncio.Lock()
        self.gone = self._opened = self._asking = False
        self._buffer = b''
        self._unit = b''  # who is asked, as its answer begins
        self._glitch = 0  # bytes before that
        # Bytes since the last request, and how many of them are accounted for
        self._heard = self._due = 0
        self._heard_at = 0.0
        self._disturbed_at = -QUIET
        self._client = AsyncModbusSerialClient(
            settings.port,
            baudrate=settings.baud_rate,
            parity=settings.parity[0].upper(),
            stopbits=settings.stop_bits,
            timeout=3600.0,  # each unit has its own, a shorter one
            retries=0,
            reconnect_delay=0,
            trace_packet=self._trace,
            trace_connect=self._connected,
        )

    @property
    def disturbed(self) -> bool:
        """True if something else was on the line a short while ago."""
        return time.monotonic() - self._disturbed_at < QUIET

    async def open(self) -> None:
        """Open the port if no other unit has."""
        async with self._opening:
            if not self._opened and not await self._connect():
                raise LinkError(port_trouble(self._port))
            self._opened = True

    def close(self) -> None:
        """Close the port."""
        self._client.close()

    async def ask(self, device: ModbusRtuDevice, block: RegisterBlock) -> Any:
        """Return the answer of a unit to a request for a block."""
        late = _LATE.get((self._port, device.unit), 0.0)
        await asyncio.sleep(max(late - time.monotonic(), 0.0))
        async with self._lock:
            await asyncio.sleep(max(self._heard_at + self._gap - time.monotonic(), 0.0))
            if self.gone:
                raise LinkError(self._lost())
            self._heard, self._due, self._asking = 0, 0, True
            self._unit = bytes([device.unit])
            try:
                return await self._answer(device, block)
            finally:
                self._asking = False
                if not self._due:  # told as what it is; the other units have no part in it
                    self._due = self._heard
                self._look()

    async def _connect(self) -> bool:
        import termios

        try:
            return bool(await self._client.connect())
        except (ValueError, termios.error) as error:
            raise LinkError(f'{self._port} refuses its settings ({error})') from error

    async def _answer(self, device: ModbusRtuDevice, block: RegisterBlock) -> Any:
        from pymodbus.exceptions import ModbusException

        try:
            answer = await asyncio.wait_for(
                request(self._client, block, device.unit), device.timeout
            )
        except (asyncio.TimeoutError, TimeoutError, ModbusException) as error:
            if self.gone:
                raise LinkError(self._lost()) from error
            _LATE[self._port, device.unit] = time.monotonic() + device.timeout
            text = f'no answer from unit {device.unit} within {device.timeout:g} s'
            if self._heard:
                text += (
                    f', but {self._heard} bytes that are none; compare baud_rate, parity and '
                    'stop_bits with its manual, and look for noise'
                )
            else:
                text += '; is it on, is the unit right, are A and B of the line exchanged?'
            raise LinkError(text) from error
        # The client has used up as many bytes as it got, so this many are left there.
        self._buffer = self._buffer[len(self._buffer) - self._glitch :]
        self._due = FRAME_EXTRA + (0 if answer.isError() else 2 * len(answer.registers))
        return answer

    def _trace(self, sending: bool, data: bytes) -> bytes:
        """Count what is heard; `data` is all that the client has not used yet.

        Returns
        -------
        bytes
            What the client gets: an answer without the glitch before it, which the client would
            take for the beginning of a frame.
        """
        if sending:
            self._buffer = b''
            return data
        grown = len(data) > len(self._buffer) and data.startswith(self._buffer)
        self._heard += len(data) - (len(self._buffer) if grown else 0)
        self._buffer, self._heard_at = data, time.monotonic()
        if not self._asking:
            self._look()
            return data
        begin = data.find(self._unit)
        self._glitch = begin if 0 < begin < FRAME_MIN else 0
        return data[self._glitch :]

    def _look(self) -> None:
        """Note if more was heard than was asked for."""
        if self._heard - self._due >= FRAME_MIN:
            self._disturbed_at = time.monotonic()

    def _connected(self, connected: bool) -> None:
        self.gone = not connected

    def _lost(self) -> str:
        return f'{self._port} has gone; is the adapter plugged in?'


_LATE: dict[tuple[str, int], float] = {}
"""Until when the last answer that a unit of a port has missed may still come [s]: that to the next
request would look the same."""
_LINES: dict[tuple[asyncio.AbstractEventLoop, str], _Line] = {}
"""Lines in use: a port can be opened once, by all units on it together."""


class ModbusRtuLink(ModbusLink):
    """One unit of a serial line.

    While the line is disturbed nothing is asked and no value is given: readings say why.

    Parameters
    ----------
    device : ModbusRtuDevice
        Its line and which registers hold what.
    """

    def __init__(self, device: ModbusRtuDevice) -> None:
        super().__init__(device)
        self._unit = device
        self._key = (asyncio.get_running_loop(), device.line.port)
        line = _LINES.get(self._key)
        if line is None or line.gone:
            line = _LINES[self._key] = _Line(device.line)
        self._line = line
        self._line.users.add(self)

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes; those of other units go in between."""
        return super().requests * len(self._line.users)

    async def open(self) -> None:
        """Open the line."""
        await self._line.open()

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel."""
        line, readings = self._line, None
        if not line.disturbed:
            try:
                readings = await super().read()
            except LinkError:
                if not line.disturbed:
                    raise
        if readings is None or line.disturbed:
            return [DISTURBED] * len(self._device.channels)
        return readings

    async def close(self) -> None:
        """Let go of the line; the last unit closes it."""
        line = self._line
        line.users.discard(self)
        if not line.users:
            line.close()
            if _LINES.get(self._key) is line:
                del _LINES[self._key]

    async def _request(self, block: RegisterBlock) -> Any:
        return await self._line.ask(self._unit, block)
