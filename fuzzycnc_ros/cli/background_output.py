# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Output that never holds up what a command does: a thread writes it, and drops what nobody reads.

A terminal that is stopped, or a pipe whose reader sleeps, blocks whoever writes to it.  A command
that watches over nodes must not wait for that, nor must the middleware within it, which writes to
the descriptors themselves.
"""

import contextlib
import io
import os
import select
import sys
import threading
from collections import deque
from collections.abc import Iterator
from typing import TextIO

PENDING_MAX = 256 * 1024
"""Characters that wait for a reader; what comes on top is dropped and counted."""
FLUSH_TIME = 1.0
"""Wall time [s] that a reader has at the end of the process to take what waits."""
FLUSH_TURNS = 20
"""Parts of it: in one of them at most the whole process may stand still, on a busy computer."""


class BackgroundOutput(io.TextIOBase):
    """A text stream to which nobody waits to write.

    Parameters
    ----------
    stream : text stream
        Where the thread writes: to its descriptor, past its buffer.
    pending_max : int
        Characters that may wait.
    descriptor : int, optional
        Descriptor to write to instead of that of the stream.

    Notes
    -----
    Once something was dropped, all is dropped until the reader has taken what waits; then one
    line says how much was left out.  A reader that is gone ends the writing, not the command.
    """

    def __init__(
        self, stream: TextIO, pending_max: int = PENDING_MAX, descriptor: int | None = None
    ) -> None:
        self._stream = stream
        self._descriptor = stream.fileno() if descriptor is None else descriptor
        self._pending_max = pending_max
        self._queue: deque[str] = deque()
        self._pending = 0
        self._begun = ''  # a line that is not complete
        self._dropped = 0
        self._finished = False
        self._ready = threading.Condition()
        # A daemon: one that is stuck in a write must not keep the process from ending.
        self._thread = threading.Thread(target=self._run, name='output', daemon=True)
        self._thread.start()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Encoding of the stream."""
        return self._stream.encoding

    def fileno(self) -> int:
        """Return the descriptor that is written to."""
        return self._descriptor

    def isatty(self) -> bool:
        """Return True if the stream is a terminal."""
        return os.isatty(self._descriptor)

    def writable(self) -> bool:
        """Return True."""
        return True

    @property
    def behind(self) -> bool:
        """True if output waits for the reader."""
        return self._pending > 0 or self._dropped > 0

    def write(self, text: str) -> int:
        """Queue a text, once a line of it is complete, or drop and count it."""
        with self._ready:
            self._begun += text
            if '\n' in text:
                self._queue_or_drop()
        return len(text)

    def flush(self) -> None:
        """Queue what is no complete line either."""
        with self._ready:
            if self._begun:
                self._queue_or_drop()

    def _queue_or_drop(self) -> None:
        text, self._begun = self._begun, ''
        if self._dropped or self._pending + len(text) > self._pending_max:
            # On a terminal each line brings along the table that is drawn below it.
            self._dropped += 1 if self.isatty() else max(1, text.count('\n'))
        else:
            self._queue.append(text)
            self._pending += len(text)
        self._ready.notify()

    def finish(self, timeout: float) -> None:
        """Give the reader some wall time [s] to take what waits; write no more after that."""
        self.flush()
        with self._ready:
            self._finished = True
            self._ready.notify()
        _wait_for(self._thread, timeout)

    def _next(self) -> str:
        """Wait for the next text to write; empty if there will be none."""
        with self._ready:
            while not (self._queue or self._dropped or self._finished):
                self._ready.wait()
            if self._queue:
                return self._queue.popleft()
            if not self._dropped:
                return ''
            note = f'\n[output was not read: {self._dropped} lines omitted here]\n'
            self._dropped, self._pending = 0, len(note)
            return note

    def _run(self) -> None:
        try:
            while text := self._next():
                self._put(text.encode(self.encoding, 'replace'))
                with self._ready:
                    self._pending -= len(text)
        except OSError:  # nobody will read any more
            with self._ready:
                self._pending_max, self._dropped = 0, 0

    def _put(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self.fileno(), data) :]
            except BlockingIOError:  # somebody else has made the terminal non-blocking
                select.select([], [self.fileno()], [])


@contextlib.contextmanager
def background_output() -> Iterator[None]:
    """Let nothing that is printed in the block wait for a reader."""
    with (
        _passed_on(sys.stdout) as out,
        _passed_on(sys.stderr) as err,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        yield


@contextlib.contextmanager
def _passed_on(stream: TextIO) -> Iterator[BackgroundOutput]:
    """Yield the output of a stream, to whose descriptor anybody may write meanwhile."""
    stream.flush()
    number = stream.fileno()
    reader = os.dup(number)
    output = BackgroundOutput(stream, descriptor=reader)
    reading, writing = os.pipe()
    os.dup2(writing, number)
    os.close(writing)
    others = threading.Thread(target=_pass_on, args=(reading, output), daemon=True)
    others.start()
    try:
        yield output
    finally:
        os.dup2(reader, number)  # nobody writes into the pipe any more
        # Another wish to end: the reader has had its time.
        with contextlib.suppress(KeyboardInterrupt):
            _wait_for(others, FLUSH_TIME)
            output.finish(FLUSH_TIME)


def _wait_for(thread: threading.Thread, timeout: float) -> None:
    """Wait for a thread, for some time [s] in which this process is there itself."""
    for _ in range(FLUSH_TURNS):
        thread.join(timeout / FLUSH_TURNS)


def _pass_on(reading: int, output: BackgroundOutput) -> None:
    """Take what is written into a pipe."""
    with open(reading, encoding='utf-8', errors='replace') as pipe:
        for line in pipe:
            output.write(line)
