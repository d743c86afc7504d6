# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Progress for logs and pipes, where no bar can move: a line every ten seconds."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from fuzzycnc_ros.core.names import visible

PERIOD = 10.0
"""Time between two lines [s]."""

LOOK = 1.0
"""Time after which is looked whether a line is due [s]."""

COUNTED = 999
"""Largest total that counts things; a larger one is a scale, of which the share is told."""


class ProgressLines:
    """Says what is going on, how much of it is done, and for how long.

    Parameters
    ----------
    title : str
        What the work is called.
    write : callable
        Takes a line.
    clock : callable
        Returns the time [s].
    """

    def __init__(
        self, title: str, write: Callable[[str], None], clock: Callable[[], float]
    ) -> None:
        self._title, self._write, self._clock = title, write, clock
        self._text, self._done, self._total = '', 0, 0
        self._began = clock()
        self._due = self._began + PERIOD
        self._lock = threading.Lock()

    def tell(self, text: str, done: int, total: int) -> None:
        """Take what is going on, steps done and in all; write it if a line is due."""
        with self._lock:
            self._text, self._done, self._total = text, done, total
        self.look()

    def look(self) -> None:
        """Write a line if one is due."""
        with self._lock:
            now = self._clock()
            if now < self._due:
                return
            self._due = now + PERIOD
            line = self._line(now - self._began)
        self._write(line)

    def _line(self, elapsed: float) -> str:
        what = '; '.join(self._text.split('\n'))
        parts = [f'{self._title}: {what}' if what not in ('', self._title) else self._title]
        if 0 < self._total <= COUNTED:
            parts.append(f'{self._done} of {self._total}')
        elif self._total:
            parts.append(f'{self._done / self._total:.0%}'.replace('%', ' %'))
        return ', '.join([*parts, f'{elapsed:.0f} s so far'])


@contextmanager
def progress_lines(title: str) -> Iterator[ProgressLines]:
    """Write lines on some work to standard error as long as the block runs."""
    lines = ProgressLines(title, _write, time.monotonic)
    ended = threading.Event()

    def look() -> None:
        while not ended.wait(LOOK):
            lines.look()

    # A daemon: work that is given up must not wait for it.
    watch = threading.Thread(target=look, name='progress', daemon=True)
    watch.start()
    try:
        yield lines
    finally:
        ended.set()
        watch.join()


def _write(line: str) -> None:
    print(visible(line), file=sys.stderr, flush=True)
