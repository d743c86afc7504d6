# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc machine`: machine files written, shown and checked."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.axes.machine_identify import identify
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    check_new,
    remark,
    say,
    show,
    write_json,
    write_text,
)
from fuzzycnc_ros.cli.options import BUILT_IN_MACHINES

HELP = """Write down what is known of your machine, in one file for all commands.

    fuzzycnc machine new mill.yaml --linuxcnc-ini mill.ini
    fuzzycnc machine show mill.yaml
    fuzzycnc machine check mill.yaml
    fuzzycnc machine identify drive.csv --columns command=duty,position=pos --out axis.yaml

`schedule`, `pareto`, `position`, `servo`, `up` and the nodes take it as --machine-file.
"""

File = Annotated[
    str,
    typer.Argument(
        metavar='FILE|NAME',
        help=f'Machine file, or one that is built in: {", ".join(BUILT_IN_MACHINES)}.',
    ),
]


def new(
    out: Annotated[Path, typer.Argument(metavar='FILE.yaml', help='New machine file.')],
    like: Annotated[
        str, typer.Option(metavar='|'.join(BUILT_IN_MACHINES), help='Machine to begin from.')
    ] = BUILT_IN_MACHINES[0],
    linuxcnc_ini: Annotated[
        Optional[Path],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            metavar='FILE.ini',
            show_default=False,
            help='LinuxCNC configuration whose limits count; the file refers to it.',
        ),
    ] = None,
    name: Annotated[
        str, typer.Option(show_default=False, help='What the machine is called.')
    ] = '',
) -> None:
    """Write a machine file with every value, its unit and its meaning.

    Change what you know better, and take out what you do not know: it is the default then. With
    --linuxcnc-ini velocities, accelerations and travels are read from the configuration each time
    the file is read.

        fuzzycnc machine new mill.yaml
        fuzzycnc machine new mill.yaml --linuxcnc-ini ~/linuxcnc/configs/mill/mill.ini
        fuzzycnc machine new axis.yaml --like ballscrew
    """
    import os
    from dataclasses import replace

    from fuzzycnc_ros.machine_file.linuxcnc_ini import read_linuxcnc_ini
    from fuzzycnc_ros.machine_file.reader import read_machine_file
    from fuzzycnc_ros.machine_file.writer import machine_text

    check_new(out)
    if like not in BUILT_IN_MACHINES:
        raise ValueError(
            f'--like: expected one of {", ".join(BUILT_IN_MACHINES)} but found {like!r}'
        )
    machine = read_machine_file(like)
    # What follows from limits above it is written by those who want it otherwise.
    left_out = frozenset(
        {'loop.velocity_max', 'loop.acceleration_max', 'loop.path_acceleration_max'}
    )
    ini = ''
    if linuxcnc_ini is not None:
        limits = read_linuxcnc_ini(linuxcnc_ini)
        first = next(iter(machine.axes.values()))
        axes = {axis: machine.axes.get(axis, replace(first, plant=None)) for axis in limits.axes}
        machine = replace(machine, axes=axes, name=limits.name or machine.name)
        left_out |= {
            f'axes.{axis}.limits.{key}' for axis, found in limits.axes.items() for key in found
        }
        left_out |= {f'path.{key}' for key in limits.path}
        ini = os.path.relpath(linuxcnc_ini, out.parent)
    machine = replace(machine, name=name or out.stem if like == machine.name else machine.name)
    write_text(out, machine_text(machine, ini=ini, without=left_out))
    read_machine_file(out)
    say(f'{out}: a machine file; see what it says with `fuzzycnc machine show {out}`')


def show_machine(file: File, json_file: JsonFile = None) -> None:
    """Print every value of a machine and where it comes from.

    Sources are lines of the file, the LinuxCNC configuration that it names, or defaults.

        fuzzycnc machine show mill.yaml
        fuzzycnc machine show ballscrew --json ballscrew.json
    """
    from fuzzycnc_ros.machine_file.feeds import scheduler_parameters
    from fuzzycnc_ros.machine_file.listing import machine_values
    from fuzzycnc_ros.machine_file.reader import read_machine_file
    from fuzzycnc_ros.studies.page.table import Column, Table

    check_folder(json_file)
    machine = read_machine_file(file)
    values = machine_values(machine)
    columns = (
        Column('Place', numeric=False),
        Column('Value', numeric=False),
        Column('From', numeric=False),
    )
    rows = tuple((item.place, item.text, item.source) for item in values)
    show(Table(f'Machine {machine.name}', columns, rows))
    constant = scheduler_parameters(machine)['machine_constant']
    say(f'feeds are chosen for a contour error of {constant:.4g} s² times normal acceleration')
    write_json(
        json_file,
        {
            'machine': machine.name,
            'values': {item.place: item.value for item in values},
            'source': {item.place: item.source for item in values},
        },
    )


def check(file: File, json_file: JsonFile = None) -> None:
    """Check that a machine file can be read, and that its values fit together.

    The exit code is 1 if something is doubtful, 2 if the file cannot be read.

        fuzzycnc machine check mill.yaml
    """
    from fuzzycnc_ros.machine_file.doubts import machine_doubts
    from fuzzycnc_ros.machine_file.reader import read_machine_file
    from fuzzycnc_ros.studies.page.html import Remark

    check_folder(json_file)
    machine = read_machine_file(file)
    doubts = machine_doubts(machine)
    models = {axis: data.model for axis, data in machine.axes.items()}
    for axis, model in models.items():
        say(f'{axis}: ' + (f'limits and a model ({model})' if model else 'limits, no model'))
    say(f'feeds: contour constant {machine.machine_constant:.4g} s²')
    for doubt in doubts:
        remark(Remark(doubt, warning=True))
    write_json(json_file, {'machine': machine.name, 'models': models, 'doubts': doubts})
    if doubts:
        raise typer.Exit(1)
    say(f'{file}: all values fit together')


COMMANDS: dict[str, Callable[..., Any]] = {
    'new': new,
    'show': show_machine,
    'identify': identify,
    'check': check,
}
"""The commands on machine files in the order of the help."""
