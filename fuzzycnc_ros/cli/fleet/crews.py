# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Workers of a fleet, and the options that all its commands share."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from fuzzycnc_ros.cli.console import check_at_least, say
from fuzzycnc_ros.cli.models.many_bags import cores
from fuzzycnc_ros.cli.options import OptionalText, OptionalWhole, choice, given

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fuzzycnc_ros.studies.fleet.evaluation import Problem
    from fuzzycnc_ros.studies.fleet.in_flight import Crew

MACHINE_BY = ('bag', 'folder')
"""Sources of a machine's name in a bag; where that is used would load numpy."""

MachineBy = Annotated[
    str,
    choice(
        'What names the machine of a bag: the namespace of its topics, or the folder that it lies '
        'in. A bag without a namespace is of its folder.',
        MACHINE_BY,
    ),
]

Workers = Annotated[
    OptionalWhole,
    given('Processes on this host; as many as there are cores if left out.'),
]

Dask = Annotated[
    OptionalText,
    given(
        'Scheduler of Dask whose workers do it, such as tcp://10.0.0.7:8786; they need this '
        'fuzzycnc, and bags and models under the same paths.',
        metavar='ADDRESS',
    ),
]


@contextmanager
def crew_of(workers: int | None, dask: str | None) -> 'Iterator[Crew]':
    """Hold the workers that the options ask for, and end them with the block.

    Raises
    ------
    ValueError
        If both are asked for, or no scheduler answers.
    ModuleNotFoundError
        If Dask is not installed.
    """
    check_at_least('--workers', workers, 1)
    if dask is not None:
        if workers is not None:
            raise ValueError(
                '--dask: expected no --workers beside it but found both; the number of workers '
                'is that of the scheduler'
            )
        from fuzzycnc_ros.studies.fleet.dask_crew import dask_crew

        with dask_crew(dask) as crew:
            yield crew
        return
    from fuzzycnc_ros.cli.workers import WorkerPool
    from fuzzycnc_ros.studies.fleet.in_flight import Crew

    count = cores() if workers is None else workers
    pools: list[WorkerPool] = []

    def start() -> WorkerPool:
        pools.append(WorkerPool(count))
        return pools[-1]

    try:
        yield Crew(start, in_flight=2 * count)
    except BaseException:
        for pool in pools:
            pool.end()
        raise
    finally:
        for pool in pools:
            pool.shutdown(wait=True, cancel_futures=True)


def end_with(problems: 'Sequence[Problem]') -> None:
    """Name what could not be used, and end with 1 if there is anything."""
    for problem in problems:
        say(f'left out {problem.name}: {problem.reason}')
    if problems:
        raise typer.Exit(1)
