# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc fleet train` and `compare`: machine by machine."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuzzycnc_ros.bags.finding import find_bags
from fuzzycnc_ros.cli.completion import some_of
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_at_least,
    check_folder,
    progress_bar,
    say,
    show,
    write_json,
    write_text,
)
from fuzzycnc_ros.cli.fleet.crews import (
    Dask,
    MachineBy,
    Workers,
    crew_of,
    end_with,
)
from fuzzycnc_ros.cli.models.many_bags import ManyBags
from fuzzycnc_ros.cli.options import (
    ALL,
    Clusters,
    Interval,
    Seed,
    SensorLimits,
    Sensors,
    Speed,
    names_of,
)
from fuzzycnc_ros.core.thermal.candidate import CANDIDATES, STANDARD, UNCOMPENSATED
from fuzzycnc_ros.papers.names import COMPARED

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from fuzzycnc_ros.studies.fleet.evaluation import Problem
    from fuzzycnc_ros.studies.fleet.machines import MachineBags, MachineResult
    from fuzzycnc_ros.studies.page.table import Table

Runs = Annotated[
    int,
    typer.Option(
        metavar='N',
        help='Most bags of a machine that are used, evenly spread from its oldest to its newest.',
    ),
]


def train(
    bags: ManyBags,
    out: Annotated[
        Path, typer.Option(metavar='DIR', help='Folder of the models, made if it is not there.')
    ],
    models: Annotated[
        list[str],
        typer.Option(
            metavar='NAME,...',
            help=f'Models to fit, judge and choose from, or {ALL}.',
            autocompletion=some_of((ALL, *CANDIDATES)),
        ),
    ] = list(STANDARD),  # noqa: B006 - typer copies it
    runs: Runs = 20,
    dask: Dask = None,
    workers: Workers = None,
    machine_by: MachineBy = 'bag',
    interval: Interval = None,
    sensors: Sensors = 'auto',
    clusters: Clusters = 5,
    sensor_limits: SensorLimits = None,
    speed: Speed = True,
    seed: Seed = 0,
    force: Annotated[
        bool, typer.Option('--force', help='Train anew where there is a model already.')
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """Train a model for each machine on its own bags.

    Models are trained as by `fuzzycnc train`. Each is written when it is there, under the name of
    its machine; one that is there already stays, so that a command that was killed goes on where
    it was. A bag or a machine that cannot be used is named, and the command then ends with 1.

        fuzzycnc fleet train archive --out models
        fuzzycnc fleet train archive --out models --machine-by folder --runs 10 --force
    """
    from fuzzycnc_ros.studies.fleet.evaluation import model_file
    from fuzzycnc_ros.studies.fleet.machines import train_machine

    names = names_of('--models', models, CANDIDATES)
    check_folder(out / 'model.json' if out.is_dir() else out, json_file)
    out.mkdir(exist_ok=True)
    options = {
        'candidates': names,
        'interval': interval,
        'sensors': sensors,
        'n_clusters': clusters,
        'spindle_speed': speed,
        'random_state': seed,
    }

    def is_wanted(piece: 'MachineBags') -> bool:
        there = model_file(out, piece.machine).exists() and not force
        if there:
            say(f'{model_file(out, piece.machine)}: stays as it is; --force trains it anew')
        return not there

    def keep(found: 'MachineResult') -> None:
        if found.result is not None:
            write_text(model_file(out, found.machine), found.result['model'])

    found, problems = _by_machine(
        bags,
        partial(train_machine, options=options, sensor_limits=sensor_limits or ()),
        runs,
        dask,
        workers,
        machine_by,
        is_wanted,
        keep,
    )
    if any(item.result for item in found):
        show(trained_table(found))
    document = {
        item.machine: {
            'model': str(model_file(out, item.machine)),
            'runs': item.runs,
            **{key: value for key, value in item.result.items() if key != 'model'},
        }
        for item in found
        if item.result is not None
    }
    write_json(json_file, {'machines': document, 'left_out': [p._asdict() for p in problems]})
    end_with(problems)


def compare(
    bags: ManyBags,
    models: Annotated[
        list[str],
        typer.Option(
            metavar='NAME,...',
            help=f'Models to compare, or {ALL}: {", ".join(COMPARED)}.',
            autocompletion=some_of((ALL, *COMPARED)),
        ),
    ] = ['static_ridge', 'lag_ridge', 'stable_grey'],  # noqa: B006 - typer copies it
    runs: Runs = 20,
    dask: Dask = None,
    workers: Workers = None,
    machine_by: MachineBy = 'bag',
    interval: Interval = None,
    sensors: Sensors = 'auto',
    clusters: Clusters = 5,
    sensor_limits: SensorLimits = None,
    speed: Speed = True,
    seed: Seed = 0,
    json_file: JsonFile = None,
) -> None:
    """Compare models on each machine, on bags of it that they have not seen.

    Each bag of a machine is held out in turn, as by `fuzzycnc compare`. A bag or a machine that
    cannot be used is named, and the command then ends with 1.

        fuzzycnc fleet compare archive --json figures.json
        fuzzycnc fleet compare archive --models lag_ridge,stable_grey --runs 8
    """
    from fuzzycnc_ros.studies.fleet.machines import compare_machine

    names = names_of('--models', models, COMPARED)
    check_folder(json_file)
    options = {
        'candidates': names,
        'interval': interval,
        'sensors': sensors,
        'n_clusters': clusters,
        'spindle_speed': speed,
        'random_state': seed,
    }
    found, problems = _by_machine(
        bags,
        partial(compare_machine, options=options, sensor_limits=sensor_limits or ()),
        runs,
        dask,
        workers,
        machine_by,
    )
    if any(item.result for item in found):
        show(compared_table(found))
    document = {
        item.machine: {'runs': item.runs, **item.result}
        for item in found
        if item.result is not None
    }
    write_json(json_file, {'machines': document, 'left_out': [p._asdict() for p in problems]})
    end_with(problems)


def _by_machine(
    bags: 'Sequence[Path]',
    work: 'Callable[[MachineBags], MachineResult]',
    runs: int,
    dask: str | None,
    workers: int | None,
    machine_by: str,
    is_wanted: 'Callable[[MachineBags], bool]' = lambda piece: True,
    keep: 'Callable[[MachineResult], None]' = lambda found: None,
) -> 'tuple[list[MachineResult], list[Problem]]':
    """Find the machines of bags and do the work on each; return all that could not be used."""
    from fuzzycnc_ros.studies.fleet.machines import each_machine, group

    check_at_least('--runs', runs, 1)
    with progress_bar('machines') as tell, crew_of(workers, dask) as crew:
        machines, problems = group(find_bags(bags), machine_by, runs, crew, tell)
        wanted = [piece for piece in machines if is_wanted(piece)]
        found = each_machine(work, wanted, crew, tell, keep)
    return found, [*problems, *(problem for item in found for problem in item.problems)]


def trained_table(found: 'Sequence[MachineResult]') -> 'Table':
    """Return what the models of machines leave on held-out bags."""
    from fuzzycnc_ros.studies.page.table import Column, Table
    from fuzzycnc_ros.studies.thermal.summary import candidate_label

    rows = []
    for item, result in _with_results(found):
        for at, channel in enumerate(result['channel']):
            rows.append(
                (
                    item.machine,
                    channel,
                    str(len(item.runs)),
                    candidate_label(result['default'][at]),
                    f'{result["uncompensated_rms_um"][at]:.1f}',
                    f'{result["held_out_rms_um"][at]:.1f}',
                )
            )
    columns = (
        Column('Machine', numeric=False),
        Column('Channel', numeric=False),
        Column('bags'),
        Column('Model in use', numeric=False),
        Column('uncompensated'),
        Column('rms'),
    )
    return Table('Residual on held-out samples [µm]', columns, tuple(rows))


def compared_table(found: 'Sequence[MachineResult]') -> 'Table':
    """Return which model that can run is best on each machine and channel, and what it leaves."""
    from fuzzycnc_ros.studies.page.table import Column, Table
    from fuzzycnc_ros.studies.thermal.summary import candidate_label

    rows = []
    for item, result in _with_results(found):
        pooled = result['pooled']
        for channel, best in result['best'].items():
            left = [
                pooled[name][channel]['rms_um'] for name in (UNCOMPENSATED, best or UNCOMPENSATED)
            ]
            rows.append(
                (
                    item.machine,
                    channel,
                    str(len(result['held_out'])),
                    f'{left[0]:.1f}',
                    candidate_label(best or UNCOMPENSATED),
                    f'{left[1]:.1f}',
                    f'{pooled["default"][channel]["rms_um"]:.1f}',
                )
            )
    columns = (
        Column('Machine', numeric=False),
        Column('Channel', numeric=False),
        Column('held out'),
        Column('uncompensated'),
        Column('Best model that a machine can run', numeric=False),
        Column('rms', 'best'),
        Column('rms', 'automatic'),
    )
    return Table('Residual over all held-out bags [µm]', columns, tuple(rows))


def _with_results(
    found: 'Sequence[MachineResult]',
) -> list[tuple['MachineResult', dict[str, Any]]]:
    return [(item, item.result) for item in found if item.result is not None]
