# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Work by any executor, a bounded part of it at a time, so that memory does not grow with it.

Quick pieces go out several at a time: what an executor takes for each thing that it is given, a
few milliseconds where it is a scheduler on a network, is spent once for all of them.

A process that is killed takes the whole pool of Python's own executors with it.  What it worked on
is done again, one piece at a time, so that a piece that kills its process is found out.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from dataclasses import dataclass
from itertools import islice
from math import inf
from time import perf_counter
from typing import Generic, TypeVar

Item = TypeVar('Item')
Result = TypeVar('Result')

IN_FLIGHT = 64
"""Lots of pieces that an executor has at a time which does not say how many workers it has."""

WORTH, TOGETHER = 0.1, 16
"""Work [s] for which a process is given pieces, and the most pieces that it gets for it."""

TRIES = 2
"""Times that a piece which may have ended its process is done alone, before it is given up."""


class LostWorkersError(ValueError):
    """The workers are gone, and so is whoever could start others."""


@dataclass(frozen=True)
class Killed:
    """A piece of work that ended its process, each time it was tried."""


class Crew:
    """Workers that take one piece of work after another.

    Parameters
    ----------
    start : callable
        Returns an executor; called when there is something to do, and again when it broke.
    in_flight : int
        Lots of pieces that it has at a time, about twice as many as workers.
    killed : tuple of exception types
        What it raises for a piece that ended all the workers that it was given to.
    """

    def __init__(
        self,
        start: Callable[[], Executor],
        in_flight: int = IN_FLIGHT,
        killed: tuple[type[Exception], ...] = (),
    ) -> None:
        self.in_flight, self.killed = in_flight, killed
        self._begin = start
        self._executor: Executor | None = None

    def submit(self, work: Callable[..., Result], *given: object) -> 'Future[Result]':
        """Hand something out.

        Raises
        ------
        BrokenExecutor
            If a process of the executor was killed; what comes next goes to another one.
        LostWorkersError
            If there is no other.
        """
        if self._executor is None:
            self._executor = self._begin()
        try:
            return self._executor.submit(work, *given)
        except BrokenExecutor:
            self.broke()
            raise

    def broke(self) -> None:
        """Have another executor started for the next piece."""
        self._executor = None


class InFlight(Generic[Item, Result]):
    """Pieces of work on their way.

    Parameters
    ----------
    work : callable
        Takes a piece; a function of a module.
    crew : Crew, optional
        Who does it; this process if absent.
    """

    def __init__(self, work: Callable[[Item], Result], crew: Crew | None) -> None:
        self._work, self._crew = work, crew
        self._suspects: deque[Item] = deque()
        self._seconds = inf  # for a piece; it is not known before the first one is done

    def done(
        self, items: Iterable[Item], count: int | None = None
    ) -> Iterator[tuple[Item, Result | Killed]]:
        """Yield pieces and what came of them, in the order in which they are done.

        Parameters
        ----------
        items : iterable
            The pieces; they are taken as there is room for them.
        count : int, optional
            How many there are: the last ones are shared out in small lots, so that all end alike.

        Raises
        ------
        LostWorkersError
            If the executor broke and there is no other.
        """
        if self._crew is None:
            for item in items:
                yield item, self._work(item)
            return
        crew, source = self._crew, iter(items)
        running: dict[Future[tuple[list[Result], float]], tuple[Item, ...]] = {}
        more, left = True, inf if count is None else count
        while True:
            while more and not self._suspects and len(running) < crew.in_flight:
                share = min(self._together, left / (2.0 * crew.in_flight))
                pieces = tuple(islice(source, max(1, int(share))))
                more, left = bool(pieces), left - len(pieces)
                if more:
                    try:
                        running[crew.submit(_each, self._work, pieces)] = pieces
                    except BrokenExecutor:
                        self._suspects.extend(pieces)
            if not running and not self._suspects:
                return
            if running:
                yield from self._landed(running, crew)
            if self._suspects and not running:
                yield self._alone(self._suspects.popleft(), crew)

    @property
    def _together(self) -> int:
        """Number of pieces that take so long as is worth it; 0 if one takes longer."""
        return min(TOGETHER, int(WORTH / max(self._seconds, WORTH / TOGETHER)))

    def _landed(
        self,
        running: 'dict[Future[tuple[list[Result], float]], tuple[Item, ...]]',
        crew: Crew,
    ) -> Iterator[tuple[Item, Result | Killed]]:
        """Wait for some of what runs; of a broken executor all goes to the suspects."""
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            pieces = running.pop(future)
            try:
                results, seconds = future.result()
            except BrokenExecutor:
                self._suspects.extend(pieces)
                crew.broke()
            except CancelledError:
                raise _lost() from None
            except crew.killed:
                if len(pieces) == 1:
                    yield pieces[0], Killed()
                else:
                    self._suspects.extend(pieces)  # one of them ended its process
            else:
                self._learn(seconds / len(pieces))
                yield from zip(pieces, results, strict=True)

    def _learn(self, seconds: float) -> None:
        """Note how long a piece takes [s]; the newest ones count most."""
        known = self._seconds < inf
        self._seconds = 0.7 * self._seconds + 0.3 * seconds if known else seconds

    def _alone(self, item: Item, crew: Crew) -> tuple[Item, Result | Killed]:
        """Do one piece with nothing beside it."""
        for _ in range(TRIES):
            try:
                (result,), _ = crew.submit(_each, self._work, (item,)).result()
            except BrokenExecutor:
                crew.broke()
            except crew.killed:
                break
            else:
                return item, result
        return item, Killed()


def _each(work: Callable[[Item], Result], items: tuple[Item, ...]) -> tuple[list[Result], float]:
    """Do pieces one after the other; return what came of them, and how long they took [s]."""
    begin = perf_counter()
    return [work(item) for item in items], perf_counter() - begin


def only(executor: Executor) -> Callable[[], Executor]:
    """Return what starts a crew of an executor that is there, and of no other."""
    left = [executor]

    def start() -> Executor:
        if not left:
            raise _lost()
        return left.pop()

    return start


def _lost() -> LostWorkersError:
    return LostWorkersError(
        'expected the workers to stay but they, or their scheduler, are gone; finished '
        'results are kept: repeat the command'
    )
