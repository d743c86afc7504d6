# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`make soak`: hundreds of hours of machine time, and whether anything grows or gets lost."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    Tell,
    check_at_least,
    check_folder,
    progress_bar,
    say,
    show,
    write_json,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fuzzycnc_ros.cli.workers import Progress
    from fuzzycnc_ros.studies.page.table import Table
    from soak.growth import Growth
    from soak.run import SoakRun

HOURS_MAX = 1e5
"""Most hours: more than eleven years."""


def soak(
    hours: Annotated[
        float, typer.Option(help='Machine time while a duty runs [h], a tick a minute.')
    ] = 100.0,
    model: Annotated[
        Optional[Path],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            show_default=False,
            metavar='MODEL',
            help='Model file; trained on three simulated duties if left out.',
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help='Seed of all measuring noise.')] = 0,
    repeat: Annotated[
        int, typer.Option(help='Runs, side by side, that have to give the same hash.')
    ] = 1,
    live: Annotated[
        bool, typer.Option('--live', help='Over DDS, each node a process, in lock-step.')
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """Run the thermal graph for many hours of machine time and look for what grows.

    The simulated mill runs two duties in turn, one a day from cold, with temperatures, predictor
    and compensator; as fast as it goes. Shown are memory, Python's blocks, threads, open files
    and the time of each stage, from after the warm-up to the end; the hash of everything that
    was published; and messages that were missed.

    Ends with 1 if memory, blocks, threads or files grow by more than 5 % after the warm-up, a
    time doubles, a message is missed, or two runs differ.

        make soak ARGS='--hours 1000 --repeat 2'
        make soak ARGS='--hours 100 --live --json soak.json'
    """
    from soak.run import TICK, TICKS_MIN

    check_at_least('--hours', hours, TICKS_MIN * TICK / 3600.0)
    if hours > HOURS_MAX:
        raise ValueError(f'--hours: expected {HOURS_MAX:g} or less but found {hours:g}')
    check_at_least('--seed', seed, 0)
    check_at_least('--repeat', repeat, 1)
    check_folder(json_file)
    ticks = round(hours * 3600.0 / TICK)
    with progress_bar('soaking') as tell:
        text = _model_text(model, seed, tell)
        if live:
            from soak.live import soak_live

            runs = [soak_live(text, ticks, seed, tell) for _ in range(repeat)]
        else:
            runs = _soak_here(text, ticks, seed, repeat, tell)
    problems = []
    for number, run in enumerate(runs):
        name = '' if len(runs) == 1 else f'run {number + 1}: '
        show(_table(f'{name}{run.ticks} ticks', run.growths))
        say(f'{name}hash {run.hash}')
        problems += [f'{name}{problem}' for problem in run.problems]
        parted = runs[0].parts_at(run)
        if parted is not None:
            problems.append(f'{name}equals run 1 up to hour {parted:g} only')
    for problem in problems:
        say(f'PROBLEM {problem}')
    if not problems:
        same = f'; {len(runs)} runs with the same hash' if len(runs) > 1 else ''
        say(f'nothing grows, nothing was missed{same}')
    write_json(json_file, _document(hours, runs, problems))
    if problems:
        raise typer.Exit(1)


def soak_once(
    number: int, progress: 'Progress', *, model_text: str, ticks: int, seed: int
) -> 'SoakRun':
    """Run one soak in this process; `number` tells runs apart that are equal otherwise."""
    from soak.run import run_soak

    return run_soak(
        model_text,
        ticks,
        seed,
        progress=lambda done, total: progress('soaking', f'run {number + 1}', done, total),
    )


def _soak_here(text: str, ticks: int, seed: int, repeat: int, tell: Tell) -> 'list[SoakRun]':
    """Run soaks without DDS, each in a process of its own, which holds nothing else."""
    from fuzzycnc_ros.cli.workers import in_workers

    names = [f'run {number + 1}' for number in range(repeat)]
    work = partial(soak_once, model_text=text, ticks=ticks, seed=seed)
    return in_workers(work, range(repeat), names, repeat, tell)


def _model_text(model: Path | None, seed: int, tell: Tell) -> str:
    """Return the model of a file, or train one as `fuzzycnc simulate` does."""
    from fuzzycnc_ros.core.thermal.fit import train_model
    from fuzzycnc_ros.core.thermal.model import load_model
    from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration

    if model is not None:
        return load_model(model).to_json()
    calibration = record_calibration(seed=seed, progress=tell)
    return train_model(
        calibration.runs,
        progress=lambda stage, name, done, total: tell(f'{stage} {name}', done, total),
    ).to_json()


def _table(title: str, growths: 'Sequence[Growth]') -> 'Table':
    """Return how each figure changed."""
    from fuzzycnc_ros.studies.page.table import Column, Table

    columns = (
        Column('Figure', numeric=False),
        Column('after warm-up'),
        Column('at the end'),
        Column('largest'),
        Column('growth %'),
        Column('allowed %'),
    )
    rows = tuple(
        (
            item.name,
            *(f'{value:.6g}' for value in (item.before, item.after, item.largest)),
            f'{100.0 * item.growth:+.2f}',
            f'{100.0 * item.limit:.0f}',
        )
        for item in growths
    )
    grown = frozenset(row for row, item in enumerate(growths) if item.grows)
    return Table(title, columns, rows, highlight=grown)


def _document(
    hours: float, runs: 'Sequence[SoakRun]', problems: 'Sequence[str]'
) -> dict[str, Any]:
    """Return all figures."""
    return {
        'hours': hours,
        'passed': not problems,
        'problems': list(problems),
        'runs': [
            {
                'ticks': run.ticks,
                'hash': run.hash,
                'missed': dict(run.missed),
                'growth': {
                    item.name: {
                        'before': item.before,
                        'after': item.after,
                        'largest': item.largest,
                        'growth': item.growth,
                        'limit': item.limit,
                    }
                    for item in run.growths
                },
                'samples': dict(zip(run.figures, run.samples.T.tolist(), strict=True)),
            }
            for run in runs
        ],
    }
