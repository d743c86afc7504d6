# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc pareto`: time against contour error of all scheduling methods on a path."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fuzzycnc_ros.cli.completion import some_of, word_or_file
from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_at_least,
    check_folder,
    progress_bar,
    say,
    show,
    words,
    write_json,
    write_report,
)
from fuzzycnc_ros.cli.options import ALL, OptionalWhole, Report, given, names_of
from fuzzycnc_ros.cli.programs.scheduling_machine import Machine, read_machine
from fuzzycnc_ros.cli.quantities import quantity
from fuzzycnc_ros.core.encodings import decoded
from fuzzycnc_ros.core.units import LENGTHS

if TYPE_CHECKING:
    from fuzzycnc_ros.cli.programs.scheduling_machine import SchedulingMachine
    from fuzzycnc_ros.studies.pareto.pareto_path import ParetoPath

CURVES = ('infinity', 'trident', 'butterfly')
"""Published curves."""

METHODS = (
    'constant',
    'fuzzy',
    'log_fuzzy',
    'normal_acceleration',
    'chord_error',
    'look_ahead',
    'jerk_limited',
    'refined',
)
"""Scheduling methods that are compared; where they are made would load numpy."""

ERROR_MIN, ERROR_MAX = 1e-6, 1e-3
"""Errors that may be compared [m]."""


def pareto(
    path: Annotated[
        str,
        typer.Argument(
            metavar='CURVE|FILE',
            help=f'{", ".join(CURVES)}; a part program; or points as .csv, columns '
            'x,y or x,y,z in mm.',
            autocompletion=word_or_file(CURVES, '.ngc', '.nc', '.csv'),
        ),
    ],
    errors: Annotated[
        list[str],
        typer.Option(metavar='LENGTH,...', help='Largest contour errors to compare at.'),
    ] = ['0.01mm,0.05mm,0.1mm'],  # noqa: B006 - typer copies it
    methods: Annotated[
        list[str],
        typer.Option(
            metavar='NAME,...',
            help=f'Methods to compare, or {ALL}: {", ".join(METHODS)}.',
            autocompletion=some_of((ALL, *METHODS)),
        ),
    ] = [ALL],  # noqa: B006
    run: Annotated[
        OptionalWhole,
        given('Run of the part program, from 1; the first that bends without it.', metavar='N'),
    ] = None,
    machine: Machine = None,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Show what contour error each scheduling method leaves, and in what time.

    Every method is turned by its own knob, and every schedule is driven on the simulated machine,
    with the limits and the schedulers' parameters of the machine file. Compared are the times at
    equal largest contour error; `-` marks an error that a method cannot reach, with the reason
    below the table. A curve takes about 20 s. The row `refined` is the default method, refined in
    30 rounds against the error measured on this very path.

        fuzzycnc pareto butterfly
        fuzzycnc pareto trident --errors 0.02mm --json figures.json --report pareto.html
        fuzzycnc pareto part.ngc --run 3 --methods fuzzy,log_fuzzy
    """
    from fuzzycnc_ros.studies.pareto.pareto import KNOBS, pareto_of
    from fuzzycnc_ros.studies.pareto.pareto_page import pareto_document, pareto_lines, pareto_table

    compared = _errors(errors)
    names = names_of('--methods', methods, tuple(KNOBS))
    check_at_least('--run', run, 1)
    for file in (report, json_file):
        check_folder(file)
    known = read_machine(machine)
    chosen = _path(path, run)
    with progress_bar('driving') as tell:
        found = pareto_of(
            chosen,
            known.scheduler,
            known.contouring,
            errors=compared,
            methods=names,
            progress=tell,
        )
    table, lines = pareto_table(found, KNOBS), pareto_lines(found)
    known.say_constant()
    show(table)
    for line in lines:
        say(line)
    if report is not None:
        from fuzzycnc_ros.studies.pareto.pareto_page import pareto_page

        page = pareto_page(found, table, _facts(chosen, machine, known), lines)
        write_report(report, page)
    write_json(json_file, pareto_document(found))


def _errors(texts: list[str]) -> tuple[float, ...]:
    """Return the errors to compare at, each once, from the smallest [m]."""
    found = [quantity('--errors', text, LENGTHS, example='0.05mm') for text in words(texts)]
    if not found:
        raise ValueError('--errors: expected lengths such as 0.01mm,0.05mm but found none')
    for error in found:
        if not ERROR_MIN <= error <= ERROR_MAX:
            raise ValueError(
                f'--errors: expected {1e3 * ERROR_MIN:g} mm to {1e3 * ERROR_MAX:g} mm but found '
                f'{1e3 * error:g} mm'
            )
    return tuple(sorted(set(found)))


def _path(path: str, run: int | None) -> 'ParetoPath':
    """Return the path that is meant."""
    from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
    from fuzzycnc_ros.studies.pareto.pareto_path import (
        CURVES,
        curve_path,
        program_path,
        table_path,
    )

    file = Path(path)
    table = file.suffix.lower() == '.csv'
    if run is not None and (path in CURVES or table):
        raise ValueError(f'--run: expected a part program, which has runs, but found {path}')
    if path in CURVES:
        return curve_path(path)
    if not file.is_file():
        raise ValueError(
            f'{path}: expected {", ".join(CURVES)}, a part program or points as .csv but no such '
            'file exists'
        )
    try:
        text = decoded(file.read_bytes(), errors='surrogateescape')
        return table_path(text) if table else program_path(read_program(text), run)
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error


def _facts(path: 'ParetoPath', machine: str | None, known: 'SchedulingMachine') -> dict[str, str]:
    """Return what the report says about path and machine."""
    scheduler, simulated = known.scheduler, known.contouring
    return {
        'Path': f'{path.name}; {len(path.arc_length)} points',
        'Machine': machine if machine is not None else 'built-in defaults',
        'Largest feed': f'{1e3 * min(scheduler.feed_max, simulated.velocity_max):g} mm/s',
        'Path acceleration': f'{simulated.path_acceleration_max:g} m/s²',
        'Machine constant': f'{scheduler.machine_constant:g} s² in the schedulers, '
        f'{simulated.contour_constant:.5g} s² by the gains of the simulated machine',
    }
