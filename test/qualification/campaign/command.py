# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`make faults`: break a live graph in many ways and show that the machine stays safe."""

import os
import tempfile
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_at_least,
    check_folder,
    check_new,
    check_ros,
    progress_bar,
    say,
    show,
    words,
    write_json,
)

if TYPE_CHECKING:
    from campaign.verdict import Verdict

UNSAFE = 1
"""Exit code where a scenario is not safe."""
SIDE_BY_SIDE = 2
"""Graphs at once that do not slow each other down where there are cores for them."""


def faults(
    only: Annotated[
        Optional[list[str]],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            metavar='NAME', help='Scenarios to run, repeated or with commas between; else all.'
        ),
    ] = None,
    list_all: Annotated[
        bool, typer.Option('--list', help='List the scenarios and what each states; run none.')
    ] = False,
    model: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help='Model file of the predictor; left out, one is trained.'),
    ] = None,
    out: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(help='New folder that keeps bags and logs; left out, nothing is kept.'),
    ] = None,
    jobs: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option(help='Graphs that run side by side; left out, two where there are cores.'),
    ] = None,
    seed: Annotated[int, typer.Option(help='Seed of all that is random.')] = 0,
    json_file: JsonFile = None,
) -> None:
    """Run the fault campaign on live graphs of the simulated machine.

    Nodes are killed and stopped, messages lost, delayed, doubled and reordered, values and clocks
    falsified, the disk filled, bags cut, models damaged, parameters set out of range, strangers
    let in: on a mill that is compensated, on axes that follow paths or are driven by the servo
    controller, and on patterns that are stitched. Each scenario states beforehand how long the
    machine may be out of a safe state, which is: at zero offset, or following a fresh and valid
    error; at rest, or moved by somebody who answers for it. It is judged by its bag: no limit
    exceeded in any sample, nothing lost from the recording but what the scenario destroys. The
    command ends with 1 if one is not safe.

        make faults ARGS='--json faults.json'

    One of them, with its bag to look at:

        make faults ARGS='--only kill_compensator --out killed'
        fuzzycnc info killed/kills_0/bag
    """
    check_ros('the fault campaign')
    from campaign.table import listing, result_tables

    names = words(only or [])
    if list_all:
        show(listing(names))
        return
    check_at_least('--jobs', jobs, 1)
    check_at_least('--seed', seed, 0)
    check_new(out)
    check_folder(json_file)
    started = time.monotonic()
    with ExitStack() as stack:
        if out is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix='fuzzycnc-')))
        else:
            folder = out
            folder.mkdir()
        verdicts = campaign(names, model, folder, seed, jobs)
    for table in result_tables(verdicts):
        show(table)
    for verdict in verdicts:
        for text in verdict.why:
            say(f'{verdict.name}: {text}')
    unsafe = [verdict.name for verdict in verdicts if not verdict.safe]
    wall = time.monotonic() - started
    say(
        f'{len(verdicts) - len(unsafe)} of {len(verdicts)} scenarios are safe; {wall:.0f} s in all'
    )
    write_json(json_file, {'scenarios': [vars(verdict) for verdict in verdicts]})
    if unsafe:
        raise typer.Exit(UNSAFE)


def campaign(
    names: tuple[str, ...], model: Path | None, folder: Path, seed: int, jobs: int | None
) -> 'list[Verdict]':
    """Run scenarios, all if none is named, and return the verdicts in the order of the list.

    Raises
    ------
    ValueError
        If a name is unknown or the model cannot be read.
    """
    from campaign.scenario import Kind
    from campaign.scenarios import chosen
    from campaign.stage import run_stage
    from fuzzycnc_ros.cli.workers import in_workers
    from fuzzycnc_ros.core.thermal.fit import train_model
    from fuzzycnc_ros.core.thermal.model import load_model
    from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration

    stages = chosen(names)
    file = folder / 'model.json'
    if model is not None:
        load_model(model)
        file.write_text(model.read_text(encoding='utf-8'), encoding='utf-8')
    elif any(stage.kind is Kind.OFFSETS for stage in stages):
        text = train_model(record_calibration(seed=seed).runs).to_json()
        file.write_text(text, encoding='utf-8')
    side_by_side = jobs or min(SIDE_BY_SIDE, os.cpu_count() or 1)
    work: Any = partial(run_stage, model=file, folder=folder, seed=seed)
    pieces = [tuple(scenario.name for scenario in stage.scenarios) for stage in stages]
    with progress_bar('faults') as tell:
        found = in_workers(work, pieces, [stage.name for stage in stages], side_by_side, tell)
    return [verdict for verdicts in found for verdict in verdicts]
