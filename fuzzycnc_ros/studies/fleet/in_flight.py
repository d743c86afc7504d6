# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Work by any executor, a bounded part of it at a time, so that memory does not grow with it.

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
from typing import Generic, TypeVar

Item = TypeVar('Item')
Result = TypeVar('Result')

IN_FLIGHT = 64
"""Pieces that are handed to an executor that does not say how many workers it has."""


TRIES = 2
"""Times that a piece which may have ended its process is done alone, before it is given up."""


class LostWorkersError(ValueError):
    """The workers are gone, and so is whoever could start others."""


@dataclass(frozen=True)
class Killed:
    """A piece of work that ended its process, each time it was tried."""


class Crew:
    """Who does the work, one piece of it after another.

    Parameters
    ----------
    start : callable
        Returns an executor; called when the first piece is there, and again when it broke.
    in_flight : int
        Pieces that it has at a time, about twice as many as workers.
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

    def submit(self, work: Callable[[Item], Result], item: Item) -> 'Future[Result]':
        """Hand a piece out.

        Raises
        ------
        BrokenExecutor
            If a process of the executor was killed; the next piece goes to another one.
        LostWorkersError
            If there is no other.
        """
        if self._executor is None:
            self._executor = self._begin()
        try:
            return self._executor.submit(work, item)
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

    def done(self, items: Iterable[Item]) -> Iterator[tuple[Item, Result | Killed]]:
        """Yield pieces and what came of them, in the order in which they are done.

        Pieces are taken from `items` as there is room for them.

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
        running: dict[Future[Result], Item] = {}
        more = True
        while True:
            while more and not self._suspects and len(running) < crew.in_flight:
                try:
                    item = next(source)
                except StopIteration:
                    more = False
                else:
                    try:
                        running[crew.submit(self._work, item)] = item
                    except BrokenExecutor:
                        self._suspects.append(item)
            if not running and not self._suspects:
                return
            if running:
                yield from self._landed(running, crew)
            if self._suspects and not running:
                yield self._alone(self._suspects.popleft(), crew)

    def _landed(
        self, running: 'dict[Future[Result], Item]', crew: Crew
    ) -> Iterator[tuple[Item, Result | Killed]]:
        """Wait for some of what runs; of a broken executor all goes to the suspects."""
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            item = running.pop(future)
            try:
                result: Result | Killed = future.result()
            except BrokenExecutor:
                self._suspects.append(item)
            except CancelledError:
                raise _lost() from None
            except crew.killed:
                yield item, Killed()
            else:
                yield item, result
        if self._suspects:
            crew.broke()

    def _alone(self, item: Item, crew: Crew) -> tuple[Item, Result | Killed]:
        """Do one piece with nothing beside it."""
        for _ in range(TRIES):
            try:
                return item, crew.submit(self._work, item).result()
            except BrokenExecutor:
                crew.broke()
        return item, Killed()


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
        'expected the workers to stay but they, or their scheduler, are gone; what they have done '
        'is kept, so give the command again'
    )
