# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A serial line of two pseudo-terminals with a real Modbus RTU server on it, and its faults."""

import asyncio
import fcntl
import math
import os
import random
import tty
from pathlib import Path

from equipment.field_servers import ModbusServer
from pymodbus.framer import FramerRTU
from pymodbus.server import ModbusSerialServer

OTHER_MASTER = bytes.fromhex('010300000001')
"""What another master asks: one holding register of unit 1, from register 0 on."""


LATE = 0.35
"""Time that late answers take [s]."""


class SerialServer(ModbusServer):
    """Units with holding and input registers on a serial line.

    Parameters
    ----------
    port : str
        File of the port.
    words : dict
        Register to word, for both tables.
    units : tuple of int
        Units that answer.
    """

    def __init__(self, port: str, words: dict[int, int], units: tuple[int, ...]) -> None:
        super().__init__(words)
        self._port, self._units = port, units

    async def start(self) -> None:
        self._server = ModbusSerialServer(
            [self.device(unit) for unit in self._units],
            port=self._port,
        )
        await self._server.serve_forever(background=True)


GLITCH = b'\0\xff'
"""What a driver makes of a line that it takes or leaves."""


class Cable:
    """A line between the port of a master and a server; both ends hear all that is on it.

    Parameters
    ----------
    port : Path
        Where the port of the master appears, as the file of an adapter does.
    words : dict
        Register to word.
    units : tuple of int
        Units that answer.
    patience : float
        Time [s] after which nothing is passed on where this end stood still, or took as long for
        its answer, on a busy computer: the master may wait for another one by then.

    Attributes
    ----------
    fault : str
        `` none; `unplugged` the adapter is pulled out and its file gone; `held` it is plugged in
        anew and another program has its port; `silent` nothing comes back; `garbled` answers come
        as with another baud rate or parity; `noise` bytes come all the time; `glitch before`,
        `glitch behind` and `glitch around` bytes stand there at each answer; `late` answers come
        after `LATE`; `master` another master asks too, and everybody hears it and its answers.
    """

    def __init__(
        self,
        port: Path,
        words: dict[int, int],
        units: tuple[int, ...] = (1,),
        patience: float = math.inf,
    ) -> None:
        self._path, self._patience = port, patience
        self._turn_at = self._asked_at = math.inf
        self._random = random.Random(1)
        self._words, self._units = words, units
        self.fault = ''

    async def start(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._far, self._far_slave = _terminal()
        self._loop.add_reader(self._far, self._answer)
        self._plug()
        self.server = SerialServer(os.ttyname(self._far_slave), self._words, self._units)
        await self.server.start()
        self._task = asyncio.create_task(self._disturb())

    async def stop(self) -> None:
        self._task.cancel()
        await self.server.stop()
        if self.fault != 'unplugged':
            self._unplug()
        self._loop.remove_reader(self._far)
        os.close(self._far)
        os.close(self._far_slave)

    async def set(self, fault: str) -> None:
        """Begin a fault, or end it with an empty name."""
        if fault in ('unplugged', 'held'):
            self._unplug()
        if fault == 'held' or self.fault == 'unplugged':
            self._plug()
        if 'held' in (fault, self.fault):
            # As pyserial does to a port that is its own
            fcntl.flock(self._near_slave, fcntl.LOCK_EX if fault else fcntl.LOCK_UN)
        self.fault = fault

    def _plug(self) -> None:
        self._near, self._near_slave = _terminal()
        self._path.symlink_to(os.ttyname(self._near_slave))
        self._loop.add_reader(self._near, self._ask)

    def _unplug(self) -> None:
        self._path.unlink()
        self._loop.remove_reader(self._near)
        os.close(self._near)
        os.close(self._near_slave)

    def _ask(self) -> None:
        data = os.read(self._near, 1024)
        if self._stood_still():
            return
        self._asked_at = self._loop.time()
        if data[0] in self._units:  # the server would answer for the others that it lacks them
            os.write(self._far, data)

    def _answer(self) -> None:
        data = os.read(self._far, 1024)
        if self._loop.time() - self._asked_at > self._patience:
            return
        if self.fault == 'late':
            self._loop.call_later(LATE, self._pass, data)
            return
        if self.fault == 'garbled':
            data = bytes(self._random.randrange(256) for _ in data)
        if self.fault in ('glitch before', 'glitch around'):
            data = GLITCH[:1] + data
        if self.fault in ('glitch behind', 'glitch around'):
            data += GLITCH
        self._pass(data)

    def _pass(self, data: bytes) -> None:
        if self.fault not in ('silent', 'unplugged') and not self._stood_still():
            os.write(self._near, data)

    def _stood_still(self) -> bool:
        return self._loop.time() - self._turn_at > self._patience

    async def _disturb(self) -> None:
        """Put on the line what the master did not ask for."""
        while True:
            self._turn_at = self._loop.time()
            await asyncio.sleep(0.03)
            if self.fault == 'noise':
                os.write(self._near, self._random.randbytes(self._random.randint(1, 12)))
            if self.fault == 'master':
                checksum = FramerRTU.compute_CRC(OTHER_MASTER).to_bytes(2, 'big')
                for end in (self._far, self._near):
                    os.write(end, OTHER_MASTER + checksum)


def _terminal() -> tuple[int, int]:
    """Return both ends of a pseudo-terminal that changes nothing."""
    master, slave = os.openpty()
    tty.setraw(slave)
    return master, slave
