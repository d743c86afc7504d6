# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc machine`: machine files written, shown and checked, axes identified."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.axes.excite import excite
from fuzzycnc_ros.cli.completion import word_or_file
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    check_new,
    progress_bar,
    remark,
    say,
    show,
    write_json,
    write_text,
)
from fuzzycnc_ros.cli.options import (
    BUILT_IN_MACHINES,
    MachineFile,
    OptionalNumber,
    OptionalPath,
    choice,
    given,
)
from fuzzycnc_ros.cli.quantities import number_in, quantity
from fuzzycnc_ros.core.units import FORCES, LENGTHS, TIMES

if TYPE_CHECKING:
    from fuzzycnc_ros.core.identify.axis_fit import AxisRecording
    from fuzzycnc_ros.core.identify.loop_fit import LoopFit
    from fuzzycnc_ros.core.machine.machine_data import MachineData

AXES = 'XYZ'


def identify(
    recordings: Annotated[
        list[Path],
        typer.Argument(metavar='FILE...', help='CSV or other text with columns, or bags.'),
    ],
    out: Annotated[Path, typer.Option(metavar='FILE.yaml', help='Machine file to write.')],
    machine_file: MachineFile = None,
    axis: Annotated[str, typer.Option(metavar='NAME', help='Axis that was recorded.')] = 'X',
    columns: Annotated[
        Optional[list[str]],  # noqa: UP045 - typer 0.9 does not read the newer form
        typer.Option(
            metavar='WHAT=NAME,...',
            show_default=False,
            help='Columns: t, command and position of an axis, and the reference that it '
            'followed; or t, commanded_X, actual_X, commanded_Y, ... of axes that follow a path. '
            'Numbers where there is no header.',
        ),
    ] = None,
    unit: Annotated[str, choice('Unit of the positions.', tuple(LENGTHS))] = 'mm',
    full: Annotated[float, typer.Option(help='Command at full duty, such as 10 for 10 V.')] = 1.0,
    force: Annotated[
        OptionalNumber,
        given(
            'Force at full duty, in N unless it has a unit; without it the mass is unknown '
            'and taken as 1 kg.',
            metavar='FORCE',
            read=number_in(FORCES, 'a force'),
        ),
    ] = None,
    reverse: Annotated[
        bool, typer.Option('--reversed', help='A positive command drives to negative positions.')
    ] = False,
    period: Annotated[
        str,
        typer.Option(
            metavar='TIME',
            show_default=False,
            help='Time between samples, such as 1ms, if no column has it.',
        ),
    ] = '',
    json_file: JsonFile = None,
) -> None:
    r"""Find a model from a recording, judge it on parts that it has not seen, and write it down.

    From command and position of a drive: mass, friction by direction, dead time, resonance. The
    structure is chosen by open-loop error on the half that a fit has not seen. From commanded and
    actual positions of axes that follow a path (a circle, a square, any program): gains of their
    loops, feedforward, dead time and the contour constant of each pair. What the data cannot tell
    is said, with what would tell it, and stays at a safe value.

        fuzzycnc machine identify drive.csv --columns command=vir,position=qm --unit m \
            --full 10 --force 351.5 --out axis.yaml
        fuzzycnc machine identify circle.txt --period 1ms \
            --columns commanded_X=1,actual_X=2,commanded_Y=3,actual_Y=4 --out mill.yaml
    """
    from fuzzycnc_ros.machine_file.reader import read_machine_file
    from fuzzycnc_ros.studies.servo.identify_recording import parse_columns

    check_new(out)
    check_folder(json_file)
    if not full > 0.0:
        raise ValueError(f'--full: expected a number above 0 but found {full:g}')
    if force is not None and not force > 0.0:
        raise ValueError(f'--force: expected a number above 0 but found {force:g}')
    every = quantity('--period', period, TIMES, example='1ms') if period else None
    wanted = parse_columns(columns or [])
    base = read_machine_file(machine_file) if machine_file is not None else None
    if any(what.startswith(('commanded', 'actual')) for what in wanted):
        found, document = _loops(recordings, wanted, LENGTHS[unit], every, base)
    else:
        sign = -1.0 if reverse else 1.0
        stretches = _drive_recordings(recordings, wanted, axis, (LENGTHS[unit], full, sign), every)
        found, document = _axis(stretches, axis, force, sign, base)
    names = ', '.join(path.name for path in recordings)
    text = _text(found, f'identified from {names}', machine_file)
    write_text(out, text)
    say(f'{out}: the machine file; check it with `fuzzycnc machine check {out}`')
    write_json(json_file, document)


def _text(machine: 'MachineData', about: str, base: str | None) -> str:
    from fuzzycnc_ros.machine_file.writer import machine_text

    ini = machine.source.get('linuxcnc.ini', '')
    if base is not None:
        about += f'; all else from {Path(base).name}'
    return machine_text(machine, ini=ini, about=about)


def _drive_recordings(
    paths: list[Path],
    wanted: dict[str, str],
    axis: str,
    scale: tuple[float, float, float],
    period: float | None,
) -> 'list[AxisRecording]':
    """Return stretches with positions in m and commands as duties."""
    from fuzzycnc_ros.core.identify.axis_fit import AxisRecording
    from fuzzycnc_ros.studies.servo.identify_recording import guessed, read_columns

    metres, full, sign = scale
    found = []
    for path in paths:
        if path.is_dir() or path.suffix == '.mcap':
            found += _of_bag(path, axis, sign)
            continue
        named = guessed(path, wanted)
        say(f'{path}: ' + ', '.join(f'{what} is {name}' for what, name in named.items()))
        if period is not None:
            named.pop('t', None)
        for part in read_columns(path, named, period):
            found.append(
                AxisRecording(
                    sign * part.values['command'] / full,
                    metres * part.values['position'],
                    part.period,
                    part.values.get('reference'),
                )
            )
    if not found:
        raise ValueError('expected 200 samples or more without a gap but found none')
    return found


def _of_bag(path: Path, axis: str, sign: float) -> 'list[AxisRecording]':
    """Return the stretches of a bag of a run with `servo_controller`."""
    import numpy as np

    from fuzzycnc_ros.core.identify.axis_fit import AxisRecording
    from fuzzycnc_ros.studies.servo.recorded_moves import read_bag

    moves = read_bag(path, axis)
    period = round(float(np.median(np.diff(moves.time))), 9)
    say(f'{path}: axis_command and axis_state of {axis}, every {1e3 * period:g} ms')
    return [
        AxisRecording(sign * moves.duty[part], moves.position[part], period)
        for part in moves.stretches(period)
    ]


def _axis(
    stretches: 'list[AxisRecording]',
    axis: str,
    force: float | None,
    sign: float,
    base: 'MachineData | None',
) -> 'tuple[MachineData, dict[str, Any]]':
    from fuzzycnc_ros.core.identify.axis_data import identify_axis
    from fuzzycnc_ros.core.machine.machine_data import AxisData, MachineData
    from fuzzycnc_ros.studies.servo.identification_tables import (
        axis_fit_document,
        axis_fit_remarks,
        axis_fit_table,
    )

    before = base.axes.get(axis, AxisData()) if base is not None else AxisData()
    with progress_bar('fitting') as tell:
        found = identify_axis(stretches, force=force, direction=sign, before=before, progress=tell)
    show(axis_fit_table(found, f'Axis {axis}'))
    for line in axis_fit_remarks(found, force):
        remark(line)
    machine = base or MachineData(name=f'axis {axis}')
    return (
        replace(machine, axes={**machine.axes, axis: found.data}),
        axis_fit_document(found),
    )


def _loops(
    paths: list[Path],
    wanted: dict[str, str],
    metres: float,
    period: float | None,
    base: 'MachineData | None',
) -> 'tuple[MachineData, dict[str, Any]]':
    from itertools import combinations

    from fuzzycnc_ros.core.identify.loop_fit import fit_loop
    from fuzzycnc_ros.core.machine.machine_data import MachineData
    from fuzzycnc_ros.studies.servo.identification_tables import (
        loop_document,
        loop_remarks,
        loop_table,
    )
    from fuzzycnc_ros.studies.servo.identify_recording import read_columns

    axes = [axis for axis in AXES if f'commanded_{axis}' in wanted or f'actual_{axis}' in wanted]
    for axis in axes:
        for what in (f'commanded_{axis}', f'actual_{axis}'):
            if what not in wanted:
                raise ValueError(f'--columns: expected {what} beside its partner but found none')
    if not axes:
        raise ValueError(
            '--columns: expected commanded_X and actual_X, or those of Y or Z, but found '
            f'{", ".join(wanted)}'
        )
    (path, *more) = paths
    if more:
        raise ValueError('expected one recording of a path but found several')
    parts = read_columns(path, wanted, period)
    if not parts:
        raise ValueError(f'{path}: expected 200 samples or more without a gap but found none')
    longest = max(parts, key=lambda part: len(next(iter(part.values.values()))))
    loops: dict[str, LoopFit] = {}
    with progress_bar('fitting') as tell:
        for number, axis in enumerate(axes):
            tell(axis, number, len(axes))
            try:
                loops[axis] = fit_loop(
                    metres * longest.values[f'commanded_{axis}'],
                    metres * longest.values[f'actual_{axis}'],
                    longest.period,
                )
            except ValueError as error:
                raise ValueError(f'{path}: {axis}: {error}') from error
    show(loop_table(loops))
    for line in loop_remarks(loops):
        remark(line)
    constant = {
        first + second: max(loops[first].contour_constant, loops[second].contour_constant, 1e-9)
        for first, second in combinations(axes, 2)
    } or dict.fromkeys(('XY', 'XZ', 'YZ'), max(loops[axes[0]].contour_constant, 1e-9))
    slow = min(loops.values(), key=lambda loop: loop.position_gain)
    machine = base or MachineData(name=path.stem)
    steps = machine.loop.control_steps
    while slow.velocity_bandwidth * machine.loop.interpolation_period / steps > 0.5:
        steps += 1
    loop = replace(
        machine.loop,
        position_gain=slow.position_gain,
        velocity_bandwidth=slow.velocity_bandwidth,
        control_steps=steps,
    )
    return (
        replace(machine, loop=loop, contour_constant={**machine.contour_constant, **constant}),
        loop_document(loops, constant),
    )


HELP = """Describe your machine in one file for all commands.

    fuzzycnc machine new mill.yaml --linuxcnc-ini mill.ini
    fuzzycnc machine show mill.yaml
    fuzzycnc machine check mill.yaml
    fuzzycnc machine excite x.ngc --machine-file mill.yaml --axis X
    fuzzycnc machine identify drive.csv --columns command=duty,position=pos --out axis.yaml

`schedule`, `pareto`, `position`, `servo`, `up` and the nodes take it as --machine-file.
"""

File = Annotated[
    str,
    typer.Argument(
        metavar='FILE|NAME',
        help=f'Machine file, or one that is built in: {", ".join(BUILT_IN_MACHINES)}.',
        autocompletion=word_or_file(BUILT_IN_MACHINES, '.yaml'),
    ),
]


def new(
    out: Annotated[Path, typer.Argument(metavar='FILE.yaml', help='New machine file.')],
    like: Annotated[str, choice('Machine to begin from.', BUILT_IN_MACHINES)] = BUILT_IN_MACHINES[
        0
    ],
    linuxcnc_ini: Annotated[
        OptionalPath,
        given(
            'LinuxCNC configuration whose limits count; the file refers to it.', metavar='FILE.ini'
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

    from fuzzycnc_ros.files.atomic import is_written_through
    from fuzzycnc_ros.machine_file.linuxcnc_ini import read_linuxcnc_ini
    from fuzzycnc_ros.machine_file.reader import read_machine_file
    from fuzzycnc_ros.machine_file.writer import machine_text

    check_new(out)
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
    if not is_written_through(out):  # a pipe has given all of it to its reader
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
    'excite': excite,
    'identify': identify,
    'check': check,
}
"""The commands on machine files in the order of the help."""
