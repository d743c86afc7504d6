# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Many bags on one command line: work on all of them, and what becomes of bad ones."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeVar

import typer

from fuzzycnc_ros.bags.finding import NamedBag
from fuzzycnc_ros.cli.console import Tell, say
from fuzzycnc_ros.cli.options import OptionalWhole, given
from fuzzycnc_ros.cli.remedies import sentence
from fuzzycnc_ros.core.remedies import RemediedError, remedied
from fuzzycnc_ros.files.os_errors import os_sentence

if TYPE_CHECKING:
    from fuzzycnc_ros.cli.workers import Progress
    from fuzzycnc_ros.core.thermal.run import ThermalRun

Result = TypeVar('Result')

ManyBags = Annotated[
    list[Path],
    typer.Argument(
        metavar='BAG...',
        help='Bags of runs, each from a cold start; folders of bags; patterns in quotes.',
    ),
]

Jobs = Annotated[
    OptionalWhole,
    given('Processes that work side by side; as many as there are cores if left out.'),
]


SkipBad = Annotated[
    bool,
    typer.Option('--skip-bad', help='Leave out bags that cannot be used, and say which and why.'),
]


@dataclass(frozen=True)
class BadBag:
    """A bag that could not be used, and why in one line."""

    bag: NamedBag
    reason: str


@dataclass(frozen=True)
class _Refused:
    """A bag that could not be used, and what helps, as data."""

    bag: NamedBag
    error: RemediedError


@dataclass(frozen=True)
class BatchResults(Generic[Result]):
    """Results of all bags, in the order of the bags."""

    results: tuple[Result, ...]
    bad: tuple[BadBag, ...]

    def used(self, bags: Sequence[NamedBag]) -> list[NamedBag]:
        """Return those of the bags that were not left out."""
        bad = {item.bag.name for item in self.bad}
        return [bag for bag in bags if bag.name not in bad]


def with_each(
    work: 'Callable[[NamedBag, Progress], Result]',
    bags: Sequence[NamedBag],
    jobs: int,
    tell: Tell,
) -> BatchResults[Result]:
    """Do the same with each bag, side by side; a bag that cannot be used hides no other.

    Parameters
    ----------
    work : callable
        Takes a bag and a callback for its progress; a function of a module, or a partial one.
    bags : sequence of NamedBag
        The bags.
    jobs : int
        Number of processes.
    tell : callable
        Shows the progress.

    Raises
    ------
    ValueError
        If none of the bags can be used.
    """
    from fuzzycnc_ros.cli.workers import in_workers
    from fuzzycnc_ros.core.threads import single_threaded

    if len(bags) == 1:
        # Rounds as a worker does, which takes a second to start.
        tell(bags[0].name, 0, 1)
        found = [single_threaded(_attempt)(work, bags[0], _nobody)]
    else:
        names = [bag.name for bag in bags]
        found = in_workers(partial(_attempt, work), bags, names, jobs, tell)
    judged = [_in_words(item) for item in found]
    bad = tuple(item for item in judged if isinstance(item, BadBag))
    good = tuple(item for item in judged if not isinstance(item, BadBag))
    check_some_left(len(good), bad)
    return BatchResults(good, bad)


def runs_of(
    bags: Sequence[NamedBag], interval: float | None, tell: Tell, *, skip: bool, **options: Any
) -> 'BatchResults[ThermalRun]':
    """Read the runs of all bags; options are those of `read_run`.

    Parameters
    ----------
    bags : sequence of NamedBag
        The bags.
    interval : float, optional
        Interval that they are to be used at [s]; their own if left out.
    tell : callable
        Shows the progress.
    skip : bool
        Whether a bag that cannot be used, or has other sensors or channels than most, is left
        out.

    Raises
    ------
    ValueError
        If a bag cannot be read and none is left out, or none is left.
    """
    from fuzzycnc_ros.bags.runs import read_run
    from fuzzycnc_ros.studies.thermal.missing_readings import read_usable

    def usable(bag: NamedBag, _: object) -> 'ThermalRun':
        return read_usable(bag.path, interval, name=bag.name, **options)

    runs: list[ThermalRun] = []
    found: list[ThermalRun | BadBag] = []
    for done, bag in enumerate(bags):
        tell(f'reading {bag.name}', done, len(bags))
        if skip:
            found.append(_in_words(_attempt(usable, bag, _nobody)))
        else:
            runs.append(read_run(bag.path, name=bag.name, **options))
    return without_odd(bags, found) if skip else BatchResults(tuple(runs), ())


def without_odd(
    bags: Sequence[NamedBag], found: 'Sequence[ThermalRun | BadBag]'
) -> 'BatchResults[ThermalRun]':
    """Return the runs that have the sensors and channels of most of them, and what is left out.

    A run that is the recording of an earlier one is left out, too.

    Raises
    ------
    ValueError
        If none is left.
    """
    from fuzzycnc_ros.core.thermal.fingerprint import Fingerprint, copies
    from fuzzycnc_ros.core.thermal.fit.training_runs import unlike_most

    named = [
        (bag, run) for bag, run in zip(bags, found, strict=True) if not isinstance(run, BadBag)
    ]
    odd = copies([Fingerprint.of(run) for _, run in named])
    odd |= unlike_most([run for _, run in named])
    bad = [item for item in found if isinstance(item, BadBag)]
    bad += [BadBag(named[place][0], reason) for place, reason in odd.items()]
    good = tuple(run for place, (_, run) in enumerate(named) if place not in odd)
    check_some_left(len(good), bad)
    return BatchResults(good, tuple(bad))


def check_some_left(good: int, bad: Sequence[BadBag]) -> None:
    """Refuse to go on without a single bag.

    Raises
    ------
    ValueError
        If none is left; it says why, of all of them.
    """
    if not good and bad:
        reasons = '; '.join(item.reason for item in bad)
        several = f'expected a bag that can be used but found none of {len(bad)}: '
        raise ValueError(f'{several if len(bad) > 1 else ""}{reasons}')


def say_bad(bad: Sequence[BadBag]) -> None:
    """Name the bags that were left out."""
    for item in bad:
        say(f'left out {item.bag.name}: {item.reason}')


def jobs_of(jobs: int | None) -> int:
    """Return the number of processes that an option asks for.

    Raises
    ------
    ValueError
        If it is below one.
    """
    from fuzzycnc_ros.cli.console import check_at_least

    check_at_least('--jobs', jobs, 1)
    return jobs if jobs is not None else cores()


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _attempt(
    work: 'Callable[[NamedBag, Progress], Result]', bag: NamedBag, progress: 'Progress'
) -> 'Result | BadBag | _Refused':
    """Work on a bag; what is wrong with it becomes a line."""
    try:
        return work(bag, progress)
    except (ValueError, OSError) as error:
        if (refusal := remedied(error)) is not None:
            return _Refused(bag, refusal)
        text = os_sentence(error) if isinstance(error, OSError) else str(error)
        return BadBag(bag, _one_line(text))


def _in_words(item: 'Result | BadBag | _Refused') -> 'Result | BadBag':
    """Return a result as it is, and a refusal with the options of this command.

    In a worker nobody knows these.
    """
    if isinstance(item, _Refused):
        return BadBag(item.bag, _one_line(sentence(item.error)))
    return item


def _one_line(text: str) -> str:
    return ' '.join(text.split())


def _nobody(stage: str, name: str, done: int, total: int) -> None:
    """Tell nobody how far a single bag is."""
