# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc train`: recorded runs in, a model file out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    check_new,
    progress_bar,
    say,
    show,
    write_json,
    write_text,
)

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal import ThermalModel
    from fuzzycnc_ros.report import Table


def train(
    bags: Annotated[
        list[Path], typer.Argument(metavar='BAG...', help='Bags of runs, each from a cold start.')
    ],
    out: Annotated[Path, typer.Option(metavar='MODEL', help='Model file to write.')],
    model: Annotated[
        str,
        typer.Option(
            metavar='NAME',
            help='Model to use on every channel: least_squares, static_ridge, stable_grey, '
            'lag_ridge or classical_grey; auto takes the best on what was held out.',
        ),
    ] = 'auto',
    interval: Annotated[
        float, typer.Option(help='Sampling interval of the model [s]; faster runs are averaged.')
    ] = 60.0,
    sensors: Annotated[
        str,
        typer.Option(
            help='clusters = one sensor per cluster, all = every sensor that warms up, '
            'auto = all up to 24 sensors, clusters above.'
        ),
    ] = 'auto',
    clusters: Annotated[int, typer.Option(help='Number of clusters.')] = 5,
    start: Annotated[
        Optional[float],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            show_default=False, help="First second to train on, from the bag's first sample."
        ),
    ] = None,
    end: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            show_default=False, help="Last second to train on, from the bag's first sample."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help='Seed of the clustering.')] = 0,
    force: Annotated[bool, typer.Option('--force', help='Overwrite the model file.')] = False,
    json_file: JsonFile = None,
) -> None:
    """Train thermal models on recorded runs, and write them with their scores to one file.

    Sensors are chosen, every candidate model is fitted, and each is judged on what it was not
    fitted to: whole runs where there are several, contiguous stretches of a single one. The file
    keeps all candidates; each channel uses the best, unless --model names one.

    A bag holds `temperatures` and `displacement`; `fuzzycnc import-csv` makes one of a table.

        fuzzycnc train monday tuesday wednesday --out mill.json
        fuzzycnc train shift --end 86850 --out spindle.json --sensors all
        fuzzycnc train shift --model lag_ridge --out mill.json --force
    """
    from fuzzycnc_ros.bags.runs import read_run
    from fuzzycnc_ros.core.thermal import train_model

    if not force:
        check_new(out, remedy='add --force')
    for path in (out, json_file):
        check_folder(path)
    with progress_bar('training') as tell:
        runs = []
        for done, bag in enumerate(bags):
            tell(f'reading {bag.name}', done, len(bags))
            runs.append(read_run(bag, start=start, stop=end))
        trained = train_model(
            runs,
            model=model,
            interval=interval,
            sensors=sensors,
            n_clusters=clusters,
            random_state=seed,
            progress=lambda stage, name, done, total: tell(f'{stage} {name}', done, total),
        )
    text = trained.to_json()
    write_text(out, text)
    say(f'trained on {", ".join(trained.runs)}, a sample every {trained.interval:g} s')
    say(f'sensors: {", ".join(trained.inputs)}')
    if trained.selection.dropped:
        say(f'left out, as they never warmed up: {", ".join(trained.selection.dropped)}')
    show(candidate_table(trained))
    for line in problem_lines(trained):
        say(line)
    say(f'in use: {default_text(trained)}')
    say(f'{out}: written, hash {trained.hash[:16]}')
    write_json(json_file, _document(trained, out, trained.hash))


def candidate_table(model: 'ThermalModel') -> 'Table':
    """Return the candidates' residuals on what they were not fitted to."""
    from fuzzycnc_ros.report import Column, Table, candidate_label
    from fuzzycnc_ros.report.summary import micrometres

    columns = [Column('Model', numeric=False)]
    for channel in model.channel:
        columns += [Column('rms', channel), Column('max', channel)]
    rows = []
    for name, item in model.candidates.items():
        figures = zip(item.held_out_rms, item.held_out_max, strict=True)
        cells = [micrometres(value) for pair in figures for value in pair]
        rows.append((candidate_label(name), *cells))
    names = list(model.candidates)
    strong = {
        (names.index(name), 1 + 2 * column + figure)
        for column, name in enumerate(model.default)
        for figure in (0, 1)
    }
    return Table(
        'Residual on held-out samples [µm]', tuple(columns), tuple(rows), frozenset(strong)
    )


def problem_lines(model: 'ThermalModel') -> list[str]:
    """Return what is wrong with candidates, a line each."""
    from fuzzycnc_ros.report import candidate_label

    flagged = [
        f'{candidate_label(name)} is not to be trusted: {problem}'
        for name, item in model.candidates.items()
        for problem in item.problems
    ]
    left_out = [
        f'{candidate_label(name)} was left out: {reason}' for name, reason in model.omitted.items()
    ]
    return flagged + left_out


def default_text(model: 'ThermalModel') -> str:
    """Return which candidate each channel uses."""
    from fuzzycnc_ros.report import candidate_label

    if len(set(model.default)) == 1:
        return candidate_label(model.default[0])
    pairs = zip(model.channel, model.default, strict=True)
    return ', '.join(f'{channel} {candidate_label(name)}' for channel, name in pairs)


def _document(model: 'ThermalModel', path: Path, digest: str) -> dict[str, Any]:
    return {
        'model': str(path),
        'hash': digest,
        'runs': model.runs,
        'interval_s': model.interval,
        'sensors': model.inputs,
        'dropped': model.selection.dropped,
        'clusters': [
            {'chosen': item.chosen, 'member': item.member, 'substitute': item.substitute}
            for item in model.selection.clusters
        ],
        'default': dict(zip(model.channel, model.default, strict=True)),
        'candidates': {
            name: {
                'settings': item.settings,
                'problems': item.problems,
                'held_out': {
                    channel: {'rms_um': 1e6 * rms, 'max_um': 1e6 * largest}
                    for channel, rms, largest in zip(
                        model.channel,
                        item.held_out_rms.tolist(),
                        item.held_out_max.tolist(),
                        strict=True,
                    )
                },
            }
            for name, item in model.candidates.items()
        },
        'omitted': dict(model.omitted),
    }
