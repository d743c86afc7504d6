# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Run the commands of a set-up side by side, show how far they are, and leave none behind."""

from __future__ import annotations

import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

PATIENCE = 10.0  # [s] for a command that was told to end
SPARSE = 10.0  # [s] between two lines about the same stage where nothing can be rewritten


class JobError(Exception):
    """A command failed; the message says which."""


class Interrupted(BaseException):
    """The set-up was told to end by a signal."""


class Signals:
    """SIGINT and SIGTERM raise `Interrupted`; while commands run, `run` does, which ends them."""

    def __init__(self) -> None:
        self.caught = 0
        self._deferred = False
        self._awake, self._wake = os.pipe()
        os.set_blocking(self._wake, False)

    def __enter__(self) -> Signals:
        signal.set_wakeup_fd(self._wake, warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        signal.set_wakeup_fd(-1)

    def _handle(self, number: int, _frame: object) -> None:
        first, self.caught = not self.caught, number
        if first and not self._deferred:
            raise Interrupted(number)

    @contextmanager
    def deferred(self) -> Iterator[int]:
        """Raise nothing; give a file that can be read from when a signal has come."""
        self._deferred = True
        try:
            yield self._awake
        finally:
            self._deferred = False


class Progress:
    """How far each stage is: one line rewritten on a terminal, now and then a line elsewhere."""

    def __init__(
        self, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.stream = stream or sys.stderr
        self.clock = clock
        self.live = self.stream.isatty()
        self._running: dict[str, str] = {}
        self._said: dict[str, float] = {}

    def begin(self, stage: str) -> None:
        """Say that a stage begins."""
        self._said[stage] = self.clock()
        self._running[stage] = f'{stage} ...'
        self._show() if self.live else self._say(f'{stage} ...')

    def step(self, stage: str, done: int, total: int, detail: str = '', unit: str = '') -> None:
        """Say how far a stage is: `done` of `total`, and what it is at."""
        text = f'{stage} {done} of {total}{unit}{f" ({detail})" if detail else ""}'
        self._running[stage] = text
        if self.live:
            self._show()
        elif self.clock() - self._said.get(stage, -SPARSE) >= SPARSE:
            self._said[stage] = self.clock()
            self._say(text)

    def end(self, stage: str, seconds: float) -> None:
        """Say that a stage is done."""
        self._running.pop(stage, None)
        self.clear()
        self._say(f'{stage}: {seconds:.0f} s')
        if self.live and self._running:
            self._show()

    def clear(self) -> None:
        """Remove the line that is being rewritten."""
        if self.live:
            self.stream.write('\r\x1b[K')
            self.stream.flush()

    def _say(self, text: str) -> None:
        print(f'set-up: {text}', file=self.stream, flush=True)

    def _show(self) -> None:
        width = _columns(self.stream)
        text = f'set-up: {"; ".join(self._running.values())}'
        self.stream.write(f'\r\x1b[K{text[: width - 1]}')
        self.stream.flush()


def _columns(stream: TextIO) -> int:
    try:
        return os.get_terminal_size(stream.fileno()).columns or 80
    except (OSError, ValueError):
        return 80


@dataclass
class Job:
    """One command of a stage; `read` is told every line that it prints."""

    stage: str
    command: Sequence[str | Path]
    needs: Sequence[Job] = ()
    read: Callable[[str], None] = lambda _line: None
    environment: dict[str, str] = field(default_factory=dict)
    done: bool = False


class _Child:
    """A command at work, in a session of its own so that all of it can be ended."""

    def __init__(self, job: Job, folder: Path, environment: dict[str, str]) -> None:
        self.job = job
        self.lines: list[str] = []
        self._rest = b''
        self.process = subprocess.Popen(
            [str(part) for part in job.command],
            cwd=folder,
            env={**environment, **job.environment},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            close_fds=False,  # the lock stays held while a child of a killed set-up still works
            start_new_session=True,
        )
        assert self.process.stdout is not None
        self.output = self.process.stdout

    def read(self) -> bool:
        """Take what was printed; return False when nobody can print any more."""
        data = os.read(self.output.fileno(), 1 << 16)
        *whole, self._rest = (self._rest + data).split(b'\n')
        for part in [*whole, self._rest] if not data else whole:
            line = part.decode(errors='replace').rstrip()
            self.lines.append(line)
            self.job.read(line)
        return bool(data)

    def signal(self, number: int) -> None:
        """Send a signal to the command and to all that it started."""
        try:
            os.killpg(self.process.pid, number)
        except ProcessLookupError:
            pass

    def close(self) -> int:
        """Return the status of a command whose output has ended."""
        self.output.close()
        return self.process.wait()


def run(
    jobs: Sequence[Job],
    folder: Path,
    environment: dict[str, str],
    progress: Progress,
    signals: Signals,
    width: int = 3,
) -> None:
    """Run jobs side by side, each as soon as those that it needs are done.

    Raises
    ------
    JobError
        If a command fails; the others are ended then.
    Interrupted
        If a signal comes; all are ended then.
    """
    waiting = list(jobs)
    begun: dict[str, float] = {}
    working: list[_Child] = []
    with signals.deferred() as awake, selectors.DefaultSelector() as selector:
        selector.register(awake, selectors.EVENT_READ)
        try:
            while waiting or working:
                if signals.caught:
                    raise Interrupted(signals.caught)
                for job in [job for job in waiting if all(need.done for need in job.needs)]:
                    if len(working) < width:
                        waiting.remove(job)
                        if job.stage not in begun:
                            begun[job.stage] = time.monotonic()
                            progress.begin(job.stage)
                        working.append(_Child(job, folder, environment))
                        selector.register(working[-1].output, selectors.EVENT_READ, working[-1])
                for child in [key.data for key, _ in selector.select() if key.data]:
                    if child.read():
                        continue
                    selector.unregister(child.output)
                    working.remove(child)
                    if child.close():
                        progress.clear()
                        print('\n'.join(child.lines), file=sys.stderr)
                        raise JobError(f'{child.job.stage} failed, see above')
                    child.job.done = True
                    stage = child.job.stage
                    if all(job.done for job in jobs if job.stage == stage):
                        progress.end(stage, time.monotonic() - begun[stage])
        except BaseException:
            progress.clear()
            _end(working)
            raise


def _end(children: Sequence[_Child]) -> None:
    """End commands with all that they started; their output ends when the last one has."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        for child in children:
            child.signal(number)
        deadline = time.monotonic() + PATIENCE
        while children and time.monotonic() < deadline:
            with selectors.DefaultSelector() as selector:
                for child in children:
                    selector.register(child.output, selectors.EVENT_READ, child)
                ended = [
                    key.data
                    for key, _ in selector.select(deadline - time.monotonic())
                    if not os.read(key.fd, 1 << 16)
                ]
            for child in ended:
                child.close()
            children = [child for child in children if child not in ended]
