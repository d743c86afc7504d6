# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A connection to a Modbus device; here over TCP."""

from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from time import monotonic
from typing import Any

from fuzzycnc_ros.adapters.modbus.devices import ModbusDevice, ModbusTcpDevice
from fuzzycnc_ros.adapters.modbus.registers import (
    RegisterBlock,
    blocks,
    jump,
    lies_at_zero,
    single_blocks,
    suspects,
    value_of,
)
from fuzzycnc_ros.adapters.readings.devices import SPINDLE
from fuzzycnc_ros.adapters.readings.link import Link, LinkError, Reading

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
EXCEPTIONS = {
    ILLEGAL_FUNCTION: 'the device does not serve this table (illegal function)',
    ILLEGAL_ADDRESS: 'the device has no such register (illegal data address)',
    ILLEGAL_VALUE: 'the device refuses to read this many registers (illegal data value)',
    4: 'the device reports a failure of its own',
    5: 'the device asks for more time',
    6: 'the device is busy',
    10: 'the gateway has no way to this unit',
    11: 'the unit behind the gateway does not answer',
}
UNCHANGED_MAX = 600.0
"""Time for which a register may read the same to the bit after the connection begins, if it
holds a float [s]."""

COURSE = 8
"""Different readings by which the order of a number is judged."""

WRONG_MAP = (ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE)


class ModbusLink(Link):
    """One connection to a Modbus device.

    Parameters
    ----------
    device : ModbusDevice
        Where it is and which registers hold what.
    """

    def __init__(self, device: ModbusDevice) -> None:
        self._device = device
        self._blocks = blocks(device.channels)
        self._first: dict[int, tuple[list[int], float]] = {}
        """First reading of each register since the connection began, and its time."""
        self._moved: set[int] = set()
        """Registers that have read something else since."""
        self._course: dict[int, deque[list[int]]] = {}
        """Readings of registers, each time they changed."""

    @property
    def requests(self) -> int:
        """Number of requests that a reading takes."""
        return len(self._blocks)

    async def read(self) -> Sequence[Reading]:
        """Return a reading of each channel."""
        found: list[Reading] = [''] * len(self._device.channels)
        refused = []
        for block in self._blocks:
            answer = await self._ask(block)
            if isinstance(answer, int):
                if answer in WRONG_MAP and len(block.channels) > 1:
                    refused.append(block)
                for index in block.channels:
                    found[index] = self._refusal(index, answer)
                continue
            for index in block.channels:
                item = self._device.channels[index]
                start = item.register - block.register
                found[index] = self._reading(index, answer[start : start + item.count])
        # One wrong register must not cost the others of its block: from now on ask one by one.
        for block in refused:
            place = self._blocks.index(block)
            self._blocks[place : place + 1] = single_blocks(block, self._device.channels)
        return found

    def _reading(self, index: int, words: list[int]) -> Reading:
        """Return the reading of a channel.

        A float has to change now and then, and may not stay next to zero that would be in a shop
        in another order; a whole number may not jump that would be steady in another order.
        """
        item = self._device.channels[index]
        found = value_of(item, words)
        if item.name == SPINDLE or isinstance(found, str):
            return found
        course = self._course.setdefault(index, deque(maxlen=COURSE))
        if not course or course[-1] != words:
            course.append(words)
        if not item.type.startswith('float'):
            if len(course) == COURSE and (step := jump(item, course)):
                return (
                    f'jumps by {step:.3g} K from reading to reading, as no sensor does; '
                    f'{suspects(item, words)}'
                )
            return found
        if len(course) == COURSE and lies_at_zero(item, course):
            return f'stays at {found:.2g} degC; {suspects(item, words)}'
        if index in self._moved:
            return found
        first, since = self._first.setdefault(index, (words, monotonic()))
        if words != first:
            self._moved.add(index)
            return found
        if not any(words):
            return (
                f'register {item.register} of the table {item.table} has read 0 ever since; is it '
                'the right one? addresses count from 0'
            )
        unchanged = monotonic() - since
        if unchanged >= UNCHANGED_MAX:
            return (
                f'has not changed by a bit for {unchanged / 60.0:.0f} min, as no sensor does; '
                f'{suspects(item, words)}'
            )
        return found

    @abstractmethod
    async def _request(self, block: RegisterBlock) -> Any:
        """Return the answer to a request for a block.

        Raises
        ------
        LinkError
            If there is none.
        """

    async def _ask(self, block: RegisterBlock) -> list[int] | int:
        """Return the registers of a block, or the exception code of the device."""
        answer = await self._request(block)
        if answer.isError():
            return int(getattr(answer, 'exception_code', 0))
        registers = getattr(answer, 'registers', [])
        if answer.function_code != (3 if block.table == 'holding' else 4):
            raise LinkError(
                f'the device answers another request (function {answer.function_code})'
            )
        if len(registers) != block.count:
            raise LinkError(
                f'expected {block.count} registers from {block.register} of the table '
                f'{block.table} but the device sent {len(registers)}'
            )
        return list(registers)

    def _refusal(self, index: int, code: int) -> str:
        """Say in words that a value cannot be had, and what to do if the file is wrong."""
        item = self._device.channels[index]
        text = EXCEPTIONS.get(code, f'the device answers with the exception code {code}')
        last = item.register + item.count - 1
        place = f'register {item.register}' + (f' to {last}' if item.count > 1 else '')
        remedy = ''
        if code in WRONG_MAP:
            remedy = '; compare register, table and type with its manual; addresses count from 0'
        return f'{place} of the table {item.table}: {text}{remedy}'


class ModbusTcpLink(ModbusLink):
    """One connection to a Modbus TCP device.

    Parameters
    ----------
    device : ModbusTcpDevice
        Where it is and which registers hold what.
    """

    def __init__(self, device: ModbusTcpDevice) -> None:
        from pymodbus.client import AsyncModbusTcpClient

        super().__init__(device)
        self._address = f'{device.host}:{device.port}'
        # The poller reconnects with a new client: an old one may hold half a frame.
        self._client = AsyncModbusTcpClient(
            device.host,
            port=device.port,
            timeout=device.timeout,
            retries=0,
            reconnect_delay=0,
        )

    async def open(self) -> None:
        """Connect."""
        if not await self._client.connect():
            raise LinkError(
                f'cannot connect to {self._address}; is it on, is the address right, '
                'does it have a free connection?'
            )

    async def close(self) -> None:
        """Drop the connection."""
        self._client.close()

    async def _request(self, block: RegisterBlock) -> Any:
        from pymodbus.exceptions import ConnectionException, ModbusException

        device = self._device
        try:
            return await request(self._client, block, device.unit)
        except ConnectionException as error:
            raise LinkError('connection lost') from error
        except ModbusException as error:
            raise LinkError(
                f'no valid answer from unit {device.unit} within {device.timeout:g} s'
            ) from error


async def request(client: Any, block: RegisterBlock, unit: int) -> Any:
    """Ask a unit for the registers of a block."""
    ask = (
        client.read_holding_registers if block.table == 'holding' else client.read_input_registers
    )
    return await ask(block.register, count=block.count, device_id=unit)
