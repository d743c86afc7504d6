# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The newest frame of each machine for every open page: replaced, never queued."""

import asyncio
import json
from collections.abc import Mapping
from typing import Any


class Frames:
    """The newest frames, and who waits for newer ones; of one event loop."""

    def __init__(self) -> None:
        self._frames: dict[str, tuple[int, str]] = {}
        self._hello: tuple[int, str] = (0, '{}')
        self._number = 0
        self.fresh = asyncio.Event()
        """Set when something is newer; another one takes its place then."""
        self.clients = 0
        """Open pages."""

    def put(self, machine: str, frame: str) -> None:
        """Replace the frame of a machine."""
        self._number += 1
        self._frames[machine] = self._number, frame
        self._wake()

    def greet(self, hello: Mapping[str, Any]) -> None:
        """Replace the greeting, which every page gets first, and each new one of it."""
        self._number += 1
        self._hello = self._number, json.dumps(hello)
        self._frames = {
            name: frame for name, frame in self._frames.items() if name in hello['machines']
        }
        self._wake()

    def leave(self) -> None:
        """Note that a page has closed; after the last one frames grow old, and are dropped."""
        self.clients -= 1
        if not self.clients:
            self._frames = {}

    def since(self, number: int) -> tuple[int, list[str]]:
        """Return what is newer than a number, and the number from which to ask next."""
        found = [self._hello, *self._frames.values()]
        return self._number, [frame for at, frame in sorted(found) if at > number]

    def _wake(self) -> None:
        self.fresh.set()
        self.fresh = asyncio.Event()
