# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How processes end: by SIGINT and SIGTERM whatever they inherited, and with their parent."""

import ctypes
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from fuzzycnc_ros.bags.uninterrupted import interrupt

WISHES = (signal.SIGINT, signal.SIGTERM)
"""Signals that ask a process to end."""
ONE_WISH = 1.0
"""Wall time [s] within which signals are one wish: some senders signal a process and its group."""
_PR_SET_PDEATHSIG = 1


class Wish:
    """What this process was asked to do.

    Attributes
    ----------
    number : int
        Signal that asked it first to end; 0 if none has.
    """

    def __init__(self) -> None:
        self.number = 0
        self._heard_at = -ONE_WISH

    def hear(self, number: int, frame: FrameType | None) -> None:
        """Take a signal."""
        now = time.monotonic()
        again = now - self._heard_at < ONE_WISH
        self.number, self._heard_at = self.number or number, now
        if not again:
            interrupt()


@contextmanager
def interruptible() -> Iterator[Wish]:
    """Let SIGINT and SIGTERM raise `Interrupted`, a KeyboardInterrupt, in the main thread alone.

    A shell starts what runs in its background with SIGINT ignored, and a parent may hold signals
    back; Python takes both as they are.  That would leave nothing but SIGKILL to end a process.
    """
    wish = Wish()
    before = {number: signal.signal(number, wish.hear) for number in WISHES}
    mask = signal.pthread_sigmask(signal.SIG_UNBLOCK, WISHES)
    try:
        yield wish
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)


def child_set_up() -> Callable[[], None]:
    """Return what a child process does before it begins, as `preexec_fn`.

    Signals reach it from its first moment on, and the kernel ends it when this process, or the
    thread that starts it, is gone, even if that was killed (Linux).
    """
    parent = os.getpid()
    # Elsewhere a killed parent leaves its children running.
    tell_kernel = getattr(ctypes.CDLL(None), 'prctl', lambda *_: 0)

    def set_up() -> None:
        for number in WISHES:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, WISHES)
        tell_kernel(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            os._exit(128 + signal.SIGTERM)  # it went before the kernel was told

    return set_up
