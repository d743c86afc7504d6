# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reads devices over the network in a thread of its own, so that the node never waits for one."""

import asyncio
import contextlib
import logging
import threading
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from queue import SimpleQueue

from fuzzycnc_ros.adapters.link import trouble_in_words
from fuzzycnc_ros.adapters.loops import ConnectionLoop
from fuzzycnc_ros.adapters.readings.devices import Device
from fuzzycnc_ros.adapters.readings.link import Link, LinkError, Reading

BACK_OFF_FIRST, BACK_OFF_MAX = 0.25, 2.0
"""Pause after the first failed connection, and the longest [s]: it doubles in between.

With a timeout of 2 s a device is read again at most 4 s and its first answer after its return.
"""
CATCH_UP = 0.5
"""Time by which readings may be late and still be made up for [s]; what is later is left out."""
CLOSE_TIMEOUT = 1.0
"""Longest wait for a device that shall say goodbye [s]."""
LIBRARIES = ('asyncua', 'paho', 'pymodbus', 'websockets')
"""Libraries of protocols that write a log."""
TEXT_MAX = 300
"""Longest text that is passed on: a part of it may come from the device."""


@dataclass(frozen=True)
class Polled:
    """Result of one request to a device.

    Attributes
    ----------
    device : int
        Its place among the devices.
    stamp : int
        Machine time at which the answer was complete [ns].
    readings : sequence of Reading, optional
        A reading of each channel; None if the device is lost.
    trouble : str
        Why it is lost.
    facts : mapping
        What the link tells beside the readings.
    took : float
        How long the device took to answer, and so how old its values may be [s].
    """

    device: int
    stamp: int
    readings: Sequence[Reading] | None
    trouble: str = ''
    facts: Mapping[str, str] = field(default_factory=dict)
    took: float = 0.0


class Poller:
    """Ask each device again and again; start anew with a fresh connection after any failure.

    Parameters
    ----------
    devices : sequence of Device
        What to read.
    now : callable
        Returns machine time [ns]; called in the thread.

    Attributes
    ----------
    results : SimpleQueue of Polled
        What came of it, in order.
    """

    def __init__(
        self,
        devices: Sequence[Device],
        now: Callable[[], int],
    ) -> None:
        # What they have to say is in what is polled, in the operator's words.
        for name in LIBRARIES:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        self.results: SimpleQueue[Polled] = SimpleQueue()
        self._devices, self._now = tuple(devices), now
        self._loop: asyncio.AbstractEventLoop | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name='devices', daemon=True)
        self._thread.start()
        self._ready.wait()

    def close(self) -> None:
        """Let go of all devices and end the thread."""
        if self._thread.is_alive() and self._loop is not None:
            with contextlib.suppress(RuntimeError):  # it ends just now
                self._loop.call_soon_threadsafe(self._cancel)
            self._thread.join(2.0 * CLOSE_TIMEOUT)

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=ConnectionLoop) as runner:
            runner.run(self._serve_all())

    def _cancel(self) -> None:
        for task in self._tasks:
            task.cancel()

    async def _serve_all(self) -> None:
        self._loop = asyncio.get_running_loop()
        serve = self._serve
        self._tasks = [asyncio.create_task(serve(i, d)) for i, d in enumerate(self._devices)]
        self._ready.set()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _serve(self, index: int, device: Device) -> None:
        """Read one device for ever."""
        pause = BACK_OFF_FIRST
        while True:
            least = 0.0
            link = device.connect()
            try:
                await asyncio.wait_for(link.open(), device.timeout)
                async for readings, took in _paced(link, device):
                    polled = Polled(index, self._now(), readings, facts=link.facts, took=took)
                    self.results.put(polled)
                    pause = BACK_OFF_FIRST
            except LinkError as error:
                trouble, least = str(error), error.pause
            except Exception as error:
                trouble = trouble_in_words(error, device.timeout)
            finally:
                with contextlib.suppress(Exception):  # it is gone either way
                    await asyncio.wait_for(link.close(), CLOSE_TIMEOUT)
            self.results.put(Polled(index, self._now(), None, trouble[:TEXT_MAX]))
            await asyncio.sleep(max(pause, least))
            pause = min(2.0 * pause, BACK_OFF_MAX)


async def _paced(link: Link, device: Device) -> AsyncIterator[tuple[Sequence[Reading], float]]:
    """Yield readings and how long they took [s], one per period, or as a slower device does."""
    loop = asyncio.get_running_loop()
    due = loop.time()
    while True:
        asked = loop.time()
        # Each request has a timeout of its own; this one is for a device that never ends.
        readings = await asyncio.wait_for(link.read(), device.timeout * (link.requests + 1))
        yield readings, loop.time() - asked
        due = max(due + device.period, loop.time() - CATCH_UP)
        await asyncio.sleep(max(due - loop.time(), 0.0))
