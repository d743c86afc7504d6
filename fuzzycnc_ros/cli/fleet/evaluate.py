# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc fleet evaluate` and `report`: a table of all bags, and a page of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fuzzycnc_ros.bags.finding import find_bags
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    progress_bar,
    remark,
    say,
    show,
    write_json,
    write_report,
)
from fuzzycnc_ros.cli.fleet.crews import (
    Dask,
    MachineBy,
    Workers,
    crew_of,
    end_with,
)
from fuzzycnc_ros.cli.models.many_bags import ManyBags
from fuzzycnc_ros.cli.options import OptionalPath, given
from fuzzycnc_ros.studies.page.html import Remark

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.fleet.evaluation import FleetSummary


def evaluate(
    bags: ManyBags,
    model: Annotated[
        list[Path],
        typer.Option(
            metavar='MODEL',
            help='Model file for all bags, or a folder of `fuzzycnc fleet train`, of which each '
            'file is for the bags of its machine; repeat it for more.',
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar='FILE.parquet', help='Table to write; an old one is replaced.')
    ],
    dask: Dask = None,
    workers: Workers = None,
    machine_by: MachineBy = 'bag',
    cache: Annotated[
        OptionalPath,
        given(
            'Folder, on a disk of this host, of what was judged before; .fuzzycnc-fleet beside '
            'the table if left out.',
            metavar='DIR',
        ),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Judge each bag with each model, and write a table of it.

    The table is a Parquet file with a row per bag, model and channel: what the machine does
    without compensation, what the model leaves, how much of the bag is in its domain, which
    sensors were missing. A bag that a model cannot be judged on has a row with the reason; it is
    named, and the command then ends with 1.

    What was judged once is not judged again: the cache knows bags and models by their content.
    An unchanged bag, by size and time of change of its files, is not even read. A command that was
    killed goes on where it was. Figures do not depend on the number of workers.

    Where the band of a model holds far less than 95 % of the residuals over all bags of a
    machine, the first lines say so, and `false_bands` of --json; `fuzzycnc evaluate` says what is
    far.

        fuzzycnc fleet evaluate archive --model mill.json --out shop.parquet
        fuzzycnc fleet evaluate 'archive/2026-*' --model models --out shop.parquet --workers 8
        fuzzycnc fleet evaluate archive --model models --out shop.parquet --dask tcp://10.0.0.7:8786
    """
    from fuzzycnc_ros.studies.fleet.evaluation import evaluate_fleet, read_models

    check_folder(out, json_file)
    models, broken = read_models(model)
    with progress_bar('evaluating') as tell, crew_of(workers, dask) as crew:
        summary = evaluate_fleet(
            find_bags(bags),
            models,
            out,
            crew=crew,
            machine_by=machine_by,
            cache=cache,
            tell=tell,
        )
    problems = [*broken, *summary.problems]
    for line in summary.false_bands():
        remark(Remark(line, True))
    say(summary_text(summary))
    say(f'{out}: written, {summary.rows} rows')
    write_json(
        json_file,
        {
            'table': out,
            'bags': summary.bags,
            'rows': summary.rows,
            'judged': summary.judged,
            'from_cache': summary.from_cache,
            'models': {item.label: item.hash for item in models},
            'false_bands': summary.false_bands(),
            'left_out': [item._asdict() for item in problems],
        },
    )
    end_with(problems)


def summary_text(summary: 'FleetSummary') -> str:
    """Return how many bags were judged and how many were known."""
    return (
        f'{summary.bags} bags: {summary.judged} judged now, {summary.from_cache} known from before'
    )


def report(
    table: Annotated[
        Path,
        typer.Argument(metavar='FILE.parquet', help='Table that `fuzzycnc fleet evaluate` wrote.'),
    ],
    out: Annotated[Path, typer.Option(metavar='FILE.html', help='Page to write.')],
    json_file: JsonFile = None,
) -> None:
    """Show which machine drifts, which model is stale, which sensor fails.

    All is sorted by urgency. A drift is a trend of what a model leaves, over the time of the bags,
    whose confidence interval is above zero; a model is stale when the newest bags leave more than
    training had promised, or leave its domain; a sensor fails when it is missing in the newest
    bags.

        fuzzycnc fleet report shop.parquet --out shop.html
    """
    from fuzzycnc_ros.studies.fleet.condition import shop_condition
    from fuzzycnc_ros.studies.fleet.results import read_rows
    from fuzzycnc_ros.studies.fleet.shop_page import shop_document, shop_page, shop_tables

    check_folder(out, json_file)
    condition = shop_condition(read_rows(table))
    for shown in filter(lambda table: table.rows, shop_tables(condition)):
        show(shown)
        say('')
    write_report(out, shop_page(condition, table.name))
    write_json(json_file, shop_document(condition))
