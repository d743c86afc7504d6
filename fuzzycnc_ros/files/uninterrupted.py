# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Put off the wish to end a process while a file begins or is finished."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Interrupted(KeyboardInterrupt):
    """A signal asked this process to end."""


class _Held:
    """State of the main thread, the only one that is interrupted."""

    depth = 0
    wished = False


def interrupt() -> None:
    """Interrupt the main thread, which calls this in a signal handler; later if it may not be.

    Raises
    ------
    Interrupted
        Here, or at the end of the outermost `uninterrupted` block.
    """
    if _Held.depth:
        _Held.wished = True
    else:
        raise Interrupted


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let no wish to end tear what the block does, which has to be short."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _Held.depth += 1
    try:
        yield
    finally:
        _Held.depth -= 1
        if not _Held.depth and _Held.wished:
            _Held.wished = False
            raise Interrupted
