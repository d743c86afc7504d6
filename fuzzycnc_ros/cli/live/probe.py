# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc probe`: the program by which a control probes its own thermal error."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from fuzzycnc_ros.cli.console import check_folder, say, write_text
from fuzzycnc_ros.cli.options import choice

HELP = """Write the program by which a control probes its own thermal error.

    fuzzycnc probe write probe.yaml --control linuxcnc --out programs

docs/how-to/your-probe.md says how the control calls it, and when.
"""

CONTROLS = ('linuxcnc', 'fanuc', 'siemens')
"""Controls that programs are written for."""


def write(
    file: Annotated[
        Path,
        typer.Argument(metavar='FILE', help='Probing targets and their box, in YAML.'),
    ],
    out: Annotated[Path, typer.Option(help='Folder for the program; made if it is missing.')],
    control: Annotated[
        str,
        choice('Control that runs it.', CONTROLS),
    ] = 'linuxcnc',
    output: Annotated[
        int,
        typer.Option(
            min=0,
            max=62,
            help='First of the two analogue outputs (M68 E) that pass results on, on LinuxCNC.',
        ),
    ] = 0,
) -> None:
    """Write the program of a probing cycle.

    It works in machine coordinates, stays in the box of the file, backs off from a miss, and sets
    no work offset, no tool length and no tool table. What is tested of the programs for Fanuc and
    Siemens is their syntax alone: run them first without a workpiece, with a hand on the feed
    override.

        fuzzycnc probe write probe.yaml --out programs
        fuzzycnc probe write probe.yaml --control siemens --out programs
    """
    from fuzzycnc_ros.adapters.probing.probe_file import read_plan
    from fuzzycnc_ros.adapters.probing.programs import write_programs

    plan = read_plan(file)
    if out.exists() and not out.is_dir():
        raise ValueError(f'--out: expected a folder but found the file {out}')
    check_folder(out / 'program' if out.exists() else out)
    texts = write_programs(plan, control, output, output + 1)
    out.mkdir(exist_ok=True)
    for name, text in texts.items():
        write_text(out / name, text)
    places = ', '.join(f'{place.axis} at {1e3 * place.position:g} mm' for place in plan.places)
    say(f'{out}: {" and ".join(texts)}, {plan.count} touches; {places}')


COMMANDS: dict[str, Callable[..., Any]] = {'write': write}
