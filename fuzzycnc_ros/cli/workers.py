# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Independent pieces of long work in processes of their own, with their progress.

Every piece is worked on in such a process, even a single one: numerical libraries round
differently with several threads, so what comes out must not depend on how many there are.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from multiprocessing.queues import Queue
from queue import Empty
from typing import Any, TypeVar

from fuzzycnc_ros.cli.console import Tell
from fuzzycnc_ros.cli.models.fit_progress import FitCounter
from fuzzycnc_ros.files.uninterrupted import uninterrupted

Item = TypeVar('Item')
Result = TypeVar('Result')
Progress = Callable[[str, str, int, int], None]
"""Told stage, name, steps done and in all."""

ONE_THREAD = {name: '1' for name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')}
"""Environment of the workers: each has one core to itself."""

NEWS_PERIOD = 0.1
"""Shortest time between two lines of news of a worker [s]; a bar cannot show more."""

END_PATIENCE = 5.0
"""Longest time that a piece of work gets to end by itself before its process is killed [s]."""

STEPS = 1000
"""Steps of the bar per piece of work."""

_news: 'Queue[News]'
_works = False  # whether this process is a worker with a piece in hand


@dataclass(frozen=True)
class News:
    """Present task of a worker: the number of its piece, words, and the share that is done [-]."""

    piece: int
    text: str
    share: float


def in_workers(
    work: Callable[[Item, Progress], Result],
    pieces: Sequence[Item],
    names: Sequence[str],
    jobs: int,
    tell: Tell,
) -> list[Result]:
    """Do pieces of work side by side.

    Parameters
    ----------
    work : callable
        Takes a piece and a callback for its progress; a function of a module, or a partial one.
    pieces : sequence
        What is worked on; has to be picklable, as do the results.
    names : sequence of str
        Name of each piece, for people.
    jobs : int
        Number of processes, at least 1.
    tell : callable
        Shows the progress.

    Returns
    -------
    list
        Results in the order of the pieces, whatever the number of processes.

    Notes
    -----
    An error of a piece, or an interrupt, ends all processes and comes through; what they work
    on is interrupted, and gets `END_PATIENCE` to leave nothing behind.  They end by themselves if
    this process is killed.
    """
    news: Queue[News] = get_context('spawn').Queue()
    board = _Board(names, tell)
    pool = WorkerPool(min(jobs, len(pieces)), news)
    try:
        futures = [
            pool.submit(partial(_work, work, piece, number)) for number, piece in enumerate(pieces)
        ]
        _watch(futures, news, board)
        return [future.result() for future in futures]
    except BaseException:
        pool.end()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        news.close()


class WorkerPool(ProcessPoolExecutor):
    """Processes of one thread each, which Ctrl-C does not reach.

    Parameters
    ----------
    jobs : int
        Number of processes, at least 1.
    news : Queue, optional
        Where they say how far they are.
    """

    def __init__(self, jobs: int, news: 'Queue[News] | None' = None) -> None:
        super().__init__(jobs, get_context('spawn'), _begin, (news,))
        self._others = set(active_children())

    def submit(
        self, work: Callable[..., Result], /, *arguments: Any, **named: Any
    ) -> 'Future[Result]':
        """Hand a piece of work out, for which a process may start."""
        # A worker that gets a half of what it starts with would print a traceback.
        with _environment(ONE_THREAD), uninterrupted(), _interrupts_held():
            return super().submit(work, *arguments, **named)

    def end(self) -> None:
        """End the processes, which first undo what they have begun."""
        _end(set(active_children()) - self._others)


def _end(workers: Collection[BaseProcess]) -> None:
    """End workers, which first undo what they have begun."""
    until = time.monotonic() + END_PATIENCE
    try:
        for worker in workers:
            worker.terminate()
        for worker in workers:
            worker.join(max(0.0, until - time.monotonic()))
    finally:
        for worker in workers:
            worker.kill()


class _Board:
    """The progress of all pieces in one line and one bar."""

    def __init__(self, names: Sequence[str], tell: Tell) -> None:
        self._names, self._tell = names, tell
        self._share = [0.0] * len(names)
        self._texts: dict[int, str] = {}

    def put(self, item: News) -> None:
        self._share[item.piece] = max(item.share, self._share[item.piece])
        self._texts[item.piece] = item.text
        if item.share >= 1.0:
            del self._texts[item.piece]
        self.show()

    def finish(self) -> None:
        """Show that all is done; the last news may still be under way."""
        self._share = [1.0] * len(self._names)
        self._texts.clear()
        self.show()

    def show(self) -> None:
        count = len(self._names)
        lines = [
            f'{self._names[piece]} ({piece + 1} of {count}): {text}'
            for piece, text in sorted(self._texts.items())
        ]
        done = int(STEPS * sum(self._share))
        self._tell('\n'.join(lines) or f'{count} to do', done, STEPS * count)


def _watch(futures: Sequence['Future[Any]'], news: 'Queue[News]', board: _Board) -> None:
    """Show news until all pieces are done, or one has failed."""
    board.show()
    while True:
        done, pending = wait(futures, timeout=NEWS_PERIOD, return_when=FIRST_EXCEPTION)
        try:
            while True:
                board.put(news.get_nowait())
        except Empty:
            pass
        for future in done:
            future.result()  # raises what the piece raised
        if not pending:
            board.finish()
            return


def _begin(news: 'Queue[News] | None') -> None:
    """Make this process a worker."""
    global _news
    if news is not None:
        _news = news
        # News that nobody reads any more must not keep the process.
        news.cancel_join_thread()
    signal.signal(signal.SIGTERM, _interrupt)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process when the one that started it is gone: its work is for nobody."""
    parent = parent_process()
    if parent is not None:
        parent.join()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(END_PATIENCE)
    os._exit(1)


def _interrupt(number: int, frame: Any) -> None:
    """Leave a piece of work, so that it ends what it has started; without one, end at once."""
    global _works
    if not _works:
        os._exit(1)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


def _work(work: Callable[[Any, Progress], Result], piece: Any, number: int) -> Result:
    """Do a piece of work in a worker."""
    words, told = FitCounter(), -NEWS_PERIOD

    def progress(stage: str, name: str, done: int, total: int) -> None:
        nonlocal told
        text, now = words(stage, name, done, total), time.monotonic()
        if now - told >= NEWS_PERIOD:
            told = now
            _news.put(News(number, text, 0.99 * done / max(total, 1)))

    global _works
    try:
        _works = True
        result = work(piece, progress)
    except KeyboardInterrupt:
        os._exit(1)  # there is nobody to take a result
    finally:
        _works = False
    _news.put(News(number, 'done', 1.0))
    return result


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set variables of the environment for a while."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back for a while; what is started meanwhile never gets one.

    A terminal sends it to the workers too, and each would print its traceback.  So it does with
    its own end.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
