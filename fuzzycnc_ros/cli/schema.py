# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc schema`: JSON Schemas of configuration files, for editors."""

from pathlib import Path
from typing import Annotated, Optional

import typer

from fuzzycnc_ros.cli.console import check_folder, say, write_text

KINDS = ('machine',)
"""Files that have a schema."""


def schema(
    kind: Annotated[
        str, typer.Argument(metavar='|'.join(KINDS), help='Which file the schema is of.')
    ],
    out: Annotated[
        Optional[Path],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(metavar='FILE.json', show_default=False, help='Write it here.'),
    ] = None,
) -> None:
    """Print the JSON Schema of a configuration file, so that editors complete and check it.

    Editors with a YAML language server take it from the first line of the file:
    # yaml-language-server: $schema=machine.schema.json

        fuzzycnc schema machine --out machine.schema.json
    """
    import json

    from fuzzycnc_ros.machine_file.schema import machine_schema

    check_folder(out)
    if kind not in KINDS:
        raise ValueError(f'schema: expected {" or ".join(KINDS)} but found {kind!r}')
    text = json.dumps(machine_schema(), indent=2, ensure_ascii=False) + '\n'
    if out is None:
        typer.echo(text, nl=False)
        return
    write_text(out, text)
    say(f'{out}: the schema of {kind} files')
