# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc advise`: what to set so that a part program keeps a contour tolerance."""

from dataclasses import replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_folder,
    progress_bar,
    say,
    say_unkept,
    show,
    write_json,
    write_report,
    write_text,
)
from fuzzycnc_ros.cli.options import (
    PROGRAM_UNITS,
    OptionalPath,
    OptionalText,
    Report,
    choice,
    given,
)
from fuzzycnc_ros.cli.programs.adaptive import FeedsAs, FeedTableFile, check_table
from fuzzycnc_ros.cli.programs.program_files import (
    STREAM,
    check_output,
    new_program,
    read_text,
)
from fuzzycnc_ros.cli.programs.scheduling_machine import (
    Machine,
    SchedulingMachine,
    controller_limits,
    read_machine,
)
from fuzzycnc_ros.cli.quantities import quantity
from fuzzycnc_ros.core.units import LENGTHS

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.gcode.blocks import Program
    from fuzzycnc_ros.core.feedrate.schedule.program_settings import ProgramSettings
    from fuzzycnc_ros.simulation.controller.program import PathMode
    from fuzzycnc_ros.studies.programs.advice import Advice, Adviser, ProgramRemedy
    from fuzzycnc_ros.studies.programs.advice_page import AdviceFigures
    from fuzzycnc_ros.studies.programs.program_judge import ProgramPath, ProgramResult

CORNER_CHOICES = ('none', 'feed', 'split')
"""Treatments of corners."""

SLACK = 3.0
"""LinuxCNC may take that many times the simulated time, and `WAIT` [s] more."""
WAIT = 60.0


def advise(
    program: Annotated[Path, typer.Argument(metavar='PROGRAM', help='Part program (G-code).')],
    tolerance: Annotated[
        OptionalText,
        given(
            'Largest contour error, such as 20um; that of the machine file without it.',
            metavar='LENGTH',
        ),
    ] = None,
    machine: Machine = None,
    corners: Annotated[
        str,
        choice(
            'Feeds refined until corners keep the tolerance too: not at all, by feed words, or by '
            'cutting blocks near corners along the same path.',
            CORNER_CHOICES,
        ),
    ] = 'feed',
    blend: Annotated[
        OptionalText,
        given(
            'P of G64 before the program says so; without it G64 alone, as LinuxCNC starts.',
            metavar='LENGTH',
        ),
    ] = None,
    units: Annotated[
        str, choice('Unit before the program says G20 or G21.', PROGRAM_UNITS)
    ] = 'mm',
    linuxcnc: Annotated[
        bool,
        typer.Option(
            '--linuxcnc',
            help='Run every remedy on the LinuxCNC that is installed here, without a screen and '
            'in real time; one that leaves too much is looked for again with a lower aim.',
        ),
    ] = False,
    out: Annotated[OptionalPath, given('The program as recommended.', metavar='FILE')] = None,
    as_: FeedsAs = 'words',
    table: FeedTableFile = None,
    in_place: Annotated[
        bool, typer.Option('--in-place', help='FILE may be the program itself.')
    ] = False,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Show which settings keep a contour tolerance on LinuxCNC, and recommend the fastest.

    What costs nothing comes first: a lower MAX_ACCELERATION and another P of G64. Then scheduled
    feeds, mixtures of all, and feeds that are refined on the simulated controller. Each is judged
    by time and contour error there: trapezoids of velocity within the limits of the axes,
    look-ahead, merged lines and rounded corners as in LinuxCNC 2.9, and axes that follow with the
    lags of the machine file. Exit code 1 if nothing keeps the tolerance.

        fuzzycnc advise part.ngc --machine-file mill.yaml --tolerance 20um
        fuzzycnc advise part.ngc --tolerance 20um --corners split --out best.ngc --report page.html
        fuzzycnc advise part.ngc --tolerance 20um --as adaptive --out best.ngc --table best.feed

    With --as adaptive feed shares along the path compete, which LinuxCNC follows by M52 P1 and
    the component fuzzycnc_feed; docs/how-to/linuxcnc.md says how it is set up.
    """
    from fuzzycnc_ros.studies.programs.advice import Adviser, advised_program
    from fuzzycnc_ros.studies.programs.advice_page import (
        advice_document,
        advice_table,
        settings_lines,
    )

    known = read_machine(machine)
    if tolerance is not None:
        wanted = quantity('--tolerance', tolerance, LENGTHS, example='20um')
        known = replace(known, scheduler=replace(known.scheduler, tolerance=wanted))
    check_folder(report, json_file)
    if out is not None:
        if str(out) == STREAM:
            raise ValueError('--out: expected a file, since the table is on standard output')
        check_output(program, out, in_place)
    check_table(as_, out, table)
    given = read_text(program, units)
    before = _mode(blend)
    try:
        adviser = Adviser(
            given, known.scheduler.tolerance, controller_limits(known), known.contouring,
            _settings(known, before), before, units,
        )  # fmt: skip
        with progress_bar('trying') as tell:
            advice = adviser.advise(corners, tell, as_ == 'adaptive')
    except ValueError as error:
        raise ValueError(f'{program}: {error}') from error
    measured = None
    if linuxcnc:
        advice, measured = _measured(given, advice, adviser, known, before, units)
    figures = _figures(str(program), advice, measured)
    known.say_constant()
    show(advice_table(figures))
    notes = _notes(given, adviser.path)
    for line in notes:
        say(line)
    if figures.verdict.warning:
        say_unkept(figures.verdict.text)
    else:
        say(figures.verdict.text)
    if measured is None:
        say(figures.remark)
    for line in settings_lines(figures):
        say(line)
    write_json(json_file, advice_document(figures))
    if out is not None:
        chosen = advice.remedies[figures.best]
        with new_program(out) as file:
            file.write(advised_program(given, chosen, units))
        say(f'{out}: the program as recommended')
        if table is not None and chosen.table is not None:
            write_text(table, chosen.table.text())
            say(f'{table}: its feed shares')
        elif table is not None:
            say(f'{table}: not written, as {chosen.name} needs no feed shares')
    if report is not None:
        _write_report(report, figures, known, notes)
    if not figures.kept:
        raise typer.Exit(1)


def _mode(blend: str | None) -> 'PathMode':
    """Return the path mode before the program says so."""
    from fuzzycnc_ros.simulation.controller.program import PathMode

    if blend is None:
        return PathMode(inf, 0.0)
    length = quantity('--blend', blend, LENGTHS, example='0.01mm')
    return PathMode(length, length)


def _settings(machine: SchedulingMachine, before: 'PathMode') -> 'ProgramSettings':
    """Return how feeds are scheduled for this controller."""
    from fuzzycnc_ros.components.motion.program_request import program_settings

    settings = program_settings(machine.scheduler)
    if settings.blend or before.rounding == inf:
        return settings
    return replace(settings, blend=before.rounding)


def _measured(
    given: 'Program',
    advice: 'Advice',
    adviser: 'Adviser',
    machine: SchedulingMachine,
    before: 'PathMode',
    units: str,
) -> 'tuple[Advice, list[ProgramResult]]':
    """Run every remedy on LinuxCNC, and those that leave too much again with a lower aim."""
    from fuzzycnc_ros.adapters.linuxcnc.recorder import PERIOD, recording
    from fuzzycnc_ros.studies.programs.advice import advised_program, with_lower_aims

    limits, path = controller_limits(machine), adviser.path
    with progress_bar('LinuxCNC') as tell, recording() as recorder:

        def run(remedy: 'ProgramRemedy', number: int) -> 'ProgramResult':
            tell(remedy.name, min(number, len(advice.remedies)), len(advice.remedies))
            recorder.limit(limits.velocity, limits.acceleration)
            recorder.origin(before.word)
            recorder.limit(limits.velocity, remedy.acceleration)
            if remedy.table is not None:
                recorder.follow(remedy.table.text())
            text = advised_program(given, remedy, units)
            samples = recorder.run(text, SLACK * remedy.judged.duration + WAIT)
            return path.judge(path.recorded(samples, PERIOD), machine.contouring)

        return with_lower_aims(advice, adviser, run)


def _figures(
    name: str, advice: 'Advice', measured: 'list[ProgramResult] | None'
) -> 'AdviceFigures':
    from fuzzycnc_ros.studies.programs.advice import best_of
    from fuzzycnc_ros.studies.programs.advice_page import AdviceFigures, AdviceRow

    rows = [
        AdviceRow(
            one.name,
            one.acceleration,
            _mode_word(one),
            one.judged,
            None if measured is None else measured[index],
        )
        for index, one in enumerate(advice.remedies)
    ]
    best = advice.best if measured is None else best_of(measured, advice.tolerance)
    return AdviceFigures(name, advice.tolerance, advice.aim, rows, best)


def _mode_word(remedy: 'ProgramRemedy') -> str:
    from fuzzycnc_ros.studies.programs.adaptive_feed import ADAPTIVE_MODE

    if remedy.table is not None:
        return f'{ADAPTIVE_MODE.word}, M52 P1'
    return 'as programmed' if remedy.mode is None else remedy.mode.word


def _notes(given: 'Program', path: 'ProgramPath') -> list[str]:
    """Return what was left out."""
    notes = [f'note: {note}' for note in given.notes[:8]]
    if path.program.unknown:
        notes.append(
            f'left out: {path.program.unknown:,} motions whose end or feed the program does '
            'not state'
        )
    return notes


def _write_report(
    report: Path, figures: 'AdviceFigures', machine: SchedulingMachine, notes: list[str]
) -> None:
    from fuzzycnc_ros.studies.programs.advice_page import advice_page

    loop = machine.contouring
    facts = {
        'Program': figures.program,
        'Tolerance': f'{1e6 * figures.tolerance:g} µm',
        'Contour constant of the loop': f'{loop.contour_constant:.4g} s²',
        'Position loop': f'{loop.position_gain:g} 1/s',
        'Velocity loop': f'{loop.velocity_bandwidth:g} rad/s',
    }
    write_report(report, advice_page(figures, facts, notes))
