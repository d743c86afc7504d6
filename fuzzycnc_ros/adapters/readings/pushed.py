# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Values that a device sends when it likes, kept until a reading is wanted."""

import asyncio
import contextlib
import time
from collections.abc import Collection


class Pushed:
    """The newest value of each key, and when it came.

    Parameters
    ----------
    age_max : float
        Time after which a value is too old to be a reading [s].
    """

    def __init__(self, age_max: float) -> None:
        self._age_max = age_max
        self._newest: dict[str, tuple[object, float]] = {}
        self._news = asyncio.Event()
        self._begun = self.ended = False
        self._heard_at = time.monotonic()

    @property
    def silence(self) -> float:
        """Time since anything came, or since the beginning [s]."""
        return time.monotonic() - self._heard_at

    def put(self, key: str, value: object) -> None:
        """Take a value."""
        self._newest[key] = (value, time.monotonic())
        self.hear()
        self._news.set()

    def hear(self) -> None:
        """Note that something came, whatever it is worth."""
        self._heard_at = time.monotonic()

    async def wait(self, timeout: float, keys: Collection[str]) -> None:
        """Wait until something has come since the last call, the first time of all keys.

        Parameters
        ----------
        timeout : float
            Longest wait [s].
        keys : collection of str
            Keys that are wanted.
        """
        with contextlib.suppress(asyncio.TimeoutError, TimeoutError):
            await asyncio.wait_for(self._wait(keys), timeout)
        self._begun = True
        self._news.clear()

    async def _wait(self, keys: Collection[str]) -> None:
        await self._news.wait()
        while not (self._begun or self.ended or all(key in self._newest for key in keys)):
            self._news.clear()
            await self._news.wait()

    def end(self) -> None:
        """Let nobody wait any longer: nothing comes any more."""
        self.ended = True
        self._news.set()

    def fresh(self, key: str) -> tuple[object, str]:
        """Return the value of a key and an empty text, or None and why there is none."""
        if key not in self._newest:
            return None, 'nothing came yet'
        value, came = self._newest[key]
        age = time.monotonic() - came
        if age > self._age_max:
            return None, f'nothing came for {age:.0f} s'
        return value, ''
