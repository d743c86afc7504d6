# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc papers`: published figures beside those of the same method here."""

from typing import Annotated

import typer

from fuzzycnc_ros.cli.completion import one_of
from fuzzycnc_ros.cli.console import JsonFile, check_folder, progress_bar, say, show, write_json

KEYS = ('ding_zeng', 'kang2007', 'lin2021', 'long2014', 'deng2014')
"""Papers by their keys in the bibliography, in the order of their numbers."""


def papers(
    paper: Annotated[
        str,
        typer.Argument(
            metavar='|'.join(('1..5', *KEYS)),
            help='Number of the paper, or its key in the bibliography.',
            autocompletion=one_of(KEYS),
        ),
    ],
    json_file: JsonFile = None,
) -> None:
    """Print the figures of a paper beside those of the same method on the simulated machine.

    1 (ding_zeng) is the grey model with clustered sensors, 2 (kang2007) the network with hybrid
    filters, 3 (lin2021) the fuzzy feedrate, 4 (long2014) the variable-universe servo, 5 (deng2014)
    the network for soft material. All figures of this package are computed anew, which takes up
    to a minute.

        fuzzycnc papers lin2021
        fuzzycnc papers 4 --json servo.json
    """
    from fuzzycnc_ros.studies.published.papers import find_paper

    chosen = find_paper(paper)
    check_folder(json_file)
    say(f'{chosen.title} [{chosen.key}]')
    with progress_bar(chosen.key) as tell:
        table = chosen.compute(tell)
    show(table)
    say('')
    say(chosen.text)
    say(f'docs/explanation/methods/{chosen.page} describes it and what the paper leaves unclear')
    columns = [column.full_heading for column in table.columns]
    write_json(json_file, {'paper': chosen.key, 'columns': columns, 'rows': table.rows})
