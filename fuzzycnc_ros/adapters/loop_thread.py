# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""An event loop in a thread of its own, for a server beside a node."""

import asyncio
import threading
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar('T')


class LoopThread:
    """Run coroutines beside a node, which waits for them as long as it likes.

    Parameters
    ----------
    name : str
        Name of the thread.
    """

    def __init__(self, name: str) -> None:
        self._loop = asyncio.new_event_loop()
        # A client that goes in the middle of an answer is no news.
        self._loop.set_exception_handler(lambda loop, context: None)
        self._thread = threading.Thread(target=self._loop.run_forever, name=name, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread has not ended."""
        return self._thread.is_alive()

    def call(self, coroutine: Coroutine[Any, Any, T], timeout: float) -> T:
        """Run a coroutine; return its result.

        Raises
        ------
        concurrent.futures.TimeoutError
            If it takes longer than `timeout` [s].
        """
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(timeout)

    def soon(self, work: Callable[..., object], *arguments: Any) -> None:
        """Let the loop call something; do not wait for it."""
        self._loop.call_soon_threadsafe(work, *arguments)

    def end(self, timeout: float) -> None:
        """End the thread; wait for that for no longer than `timeout` [s]."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(timeout)
        self._loop.close()
