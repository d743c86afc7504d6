# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc schedule`: a part program with feeds that keep a contour tolerance."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import nullcontext, redirect_stdout
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuzzycnc_ros.cli.completion import one_of
from fuzzycnc_ros.cli.console import (
    JsonFile,
    Tell,
    check_folder,
    progress_bar,
    say,
    say_unkept,
    show,
    write_json,
    write_report,
)
from fuzzycnc_ros.cli.options import PROGRAM_UNITS, OptionalText, Report, choice, given
from fuzzycnc_ros.cli.programs.adaptive import (
    FeedsAs,
    FeedTableFile,
    check_table,
    schedule_shares,
)
from fuzzycnc_ros.cli.programs.program_files import (
    STREAM,
    check_output,
    new_program,
    open_program,
    program_lines,
    subroutine_files,
)
from fuzzycnc_ros.cli.programs.scheduling_machine import Machine, SchedulingMachine, read_machine
from fuzzycnc_ros.cli.quantities import quantity
from fuzzycnc_ros.core.units import FEEDS, LENGTHS, SHARES

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.gcode.blocks import Block, Program
    from fuzzycnc_ros.core.feedrate.gcode.reader import ProgramReader
    from fuzzycnc_ros.core.feedrate.schedule.program_settings import ProgramSettings
    from fuzzycnc_ros.studies.programs.program_judge import ProgramResult
    from fuzzycnc_ros.studies.programs.program_page import ScheduleFigures
    from fuzzycnc_ros.studies.programs.schedule_trace import PathTrace

NOTES = 8
"""Notes that are printed; the report and the figures have all."""

METHODS = (
    'log_fuzzy',
    'tolerance',
    'fuzzy',
    'constant',
    'normal_acceleration',
    'chord_error',
    'look_ahead',
    'jerk_limited',
)
"""Rules that choose the feed; where they are made would load numpy."""

STRETCH, STRETCH_BLOCKS = 20.0, 2000
"""Motion that a report drives with every method at most [s], and blocks of it."""

STEP = 500
"""Lines after which the bar moves."""


@dataclass
class Words:
    """Feed words of a program: those added, and those that were there and changed."""

    added: int = 0
    changed: int = 0
    unchanged: str = ''
    """Why no word is another one; empty where one is."""
    stretch: int = 0
    """Blocks at the beginning whose motion takes `STRETCH` or less, and one that moves."""
    begun: 'list[tuple[Block, float | None]]' = field(default_factory=list)
    """Blocks at the beginning with their feeds, whose motion and rests take no longer."""


def schedule(
    program: Annotated[
        Path, typer.Argument(metavar='PROGRAM', help='Part program (G-code); - is standard input.')
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar='FILE', help='The program with its new feed words; - is standard output.'
        ),
    ],
    tolerance: Annotated[
        OptionalText,
        given(
            'Largest contour error, such as 0.01mm or 10um; that of the machine file without it.',
            metavar='LENGTH',
        ),
    ] = None,
    machine: Machine = None,
    method: Annotated[
        OptionalText,
        given(
            f'Rule that chooses the feed: {", ".join(METHODS)}; tolerance is log_fuzzy. That of '
            'the machine file without it.',
            metavar='NAME',
            complete=one_of(METHODS),
        ),
    ] = None,
    blend: Annotated[
        OptionalText,
        given(
            'How far the controller may round corners off, such as 0.01mm; 0mm stops at '
            'every corner.  What the program says (G64 P, G61) without it, else that of the '
            'machine file.',
            metavar='LENGTH',
        ),
    ] = None,
    feed: Annotated[
        OptionalText,
        given(
            "Upper bound of the feed instead of the program's own feed words, such as "
            '12000mm/min or 0.2m/s.',
            metavar='FEED',
        ),
    ] = None,
    override: Annotated[
        OptionalText,
        given(
            'Feed override, such as 120%; above 100% the tolerance still counts.', metavar='SHARE'
        ),
    ] = None,
    feed_step: Annotated[
        str,
        typer.Option(
            metavar='SHARE', help='Neighbouring blocks whose feeds differ by less share one word.'
        ),
    ] = '5%',
    units: Annotated[
        str, choice('Unit before the program says G20 or G21.', PROGRAM_UNITS)
    ] = 'mm',
    as_: FeedsAs = 'words',
    table: FeedTableFile = None,
    in_place: Annotated[
        bool, typer.Option('--in-place', help='FILE may be the program itself.')
    ] = False,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    r"""Choose the feeds of a part program, so that the contour error keeps a tolerance.

    Every line comes out again, in its order; feed words alone are added or changed. The feeds of
    the program are upper bounds, unless --feed gives another one: where the path bends, the feed
    falls as the tolerance asks for. Cycles, calls and words of the control are passed through
    untouched and reported. Times are those of the machine's limits, for the program as it was
    and as it is now; the first 20 s of both are driven on a simulated controller with look-ahead.
    Exit code 1 if that leaves more than the tolerance: `fuzzycnc advise` says what helps.

        fuzzycnc schedule part.ngc --tolerance 0.01mm --out part_scheduled.ngc
        fuzzycnc schedule part.ngc --tolerance 10um --blend 0.01mm --feed 12000mm/min \
            --machine params/feedrate_scheduler.yaml --out fast.ngc --report fast.html
        fuzzycnc schedule part.ngc --tolerance 20um --as adaptive --out fast.ngc --table fast.feed

    With --as adaptive feed words stay as they are; docs/how-to/linuxcnc.md has the rest.
    """
    from fuzzycnc_ros.core.feedrate.gcode.outline import outline_of
    from fuzzycnc_ros.core.feedrate.gcode.reader import ProgramReader
    from fuzzycnc_ros.core.feedrate.schedule.program_schedule import ProgramScheduler
    from fuzzycnc_ros.studies.programs.program_page import (
        ScheduleFigures,
        schedule_document,
        schedule_table,
    )
    from fuzzycnc_ros.studies.programs.schedule_trace import PathTrace

    known = _settled(read_machine(machine), tolerance, method, blend, feed, override)
    settings = replace(_settings(known, feed, feed_step), own_corners=blend is None)
    check_output(program, out, in_place)
    check_folder(report, json_file)
    check_table(as_, out, table)
    if table is not None:
        _refuse(method=method, blend=blend, feed=feed, override=override, report=report)
        shares = schedule_shares(program, out, table, known, units)
        write_json(json_file, shares)
        if not shares['kept']:
            raise typer.Exit(1)
        return
    with program_lines(program) as source:
        files = subroutine_files(program)
        words, trace = Words(), PathTrace()
        with open_program(source) as file:
            outline = outline_of(file)
        reader = ProgramReader(units, follow=True, files=files, outline=outline)
        rest = 0.0 if settings.blend else settings.settle  # at corners
        scheduler = ProgramScheduler(settings, trace.add if report is not None else None)
        try:
            with (
                progress_bar('scheduling') as tell,
                open_program(source) as file,
                new_program(out) as new,
            ):
                blocks = reader.blocks(_told(file, source.stat().st_size, tell))
                new.writelines(_counted(scheduler.schedule(blocks), words, rest))
        except ValueError as error:
            raise ValueError(f'{program}: {error}') from error
        driven = _driven(words, settings, known)
        figures = ScheduleFigures(
            str(program), known.scheduler.method, known.scheduler.tolerance,
            settings, scheduler.times, reader.notes,
            words.added, words.changed, *driven,
            _name(words.begun[-1][0].line, scheduler.times.blocks), sorted(scheduler.corners),
        )  # fmt: skip
        with redirect_stdout(sys.stderr) if str(out) == STREAM else nullcontext():
            known.say_constant()
            show(schedule_table(figures))
            for line in _lines(figures, words, out):
                say(line)
            if not figures.kept:
                say_unkept(figures.verdict)
        write_json(json_file, schedule_document(figures))
        if report is not None:
            reader = ProgramReader(units, follow=True, files=files, outline=outline)
            stretch = _stretch(source, reader, words.stretch, figures.times.blocks)
            _write_report(report, stretch, figures, trace, known)
    if not figures.kept:
        raise typer.Exit(1)


def _refuse(**options: object) -> None:
    """Refuse options that choose feed words where there are none."""
    for name, value in options.items():
        if value is not None:
            raise ValueError(f'--{name}: expected none with --as adaptive but found it; leave it')


def _settled(
    machine: SchedulingMachine,
    tolerance: str | None,
    method: str | None,
    blend: str | None,
    feed: str | None,
    override: str | None,
) -> SchedulingMachine:
    """Return a machine with what the options say."""
    given: dict[str, Any] = {}
    if tolerance is not None:
        given['tolerance'] = quantity('--tolerance', tolerance, LENGTHS, example='0.01mm')
    if method is not None:
        given['method'] = method
    if blend is not None:
        given['blend'] = quantity('--blend', blend, LENGTHS, example='0.01mm', zero=True)
    if override is not None:
        given['feed_override'] = quantity('--override', override, SHARES, example='120%')
    if feed is not None:
        most = quantity('--feed', feed, FEEDS, example='12000mm/min')
        config = machine.scheduler
        # A feed above what the machine reaches would be clamped, and the tolerance not kept.
        given['feed_max'] = min(most, config.path_velocity)
        given['feed_min'] = min(config.feed_min, given['feed_max'])
    return replace(machine, scheduler=replace(machine.scheduler, **given))


def _settings(machine: SchedulingMachine, feed: str | None, feed_step: str) -> 'ProgramSettings':
    """Return how programs are scheduled."""
    from fuzzycnc_ros.components.motion.program_request import program_settings

    step = quantity('--feed-step', feed_step, SHARES, example='5%', zero=True)
    bound = None if feed is None else quantity('--feed', feed, FEEDS, example='12000mm/min')
    return replace(program_settings(machine.scheduler), feed=bound, feed_step=step)


def _told(lines: Iterable[str], size: int, tell: Tell) -> Iterator[str]:
    """Yield lines, and tell how many and which part of the file they are."""
    done = 0
    for number, line in enumerate(lines):
        if number % STEP == 0:
            tell(f'{number:,} blocks', done, size)
        done += len(line)
        yield line


def _counted(
    scheduled: 'Iterable[tuple[Block, float | None]]', words: Words, rest: float
) -> Iterator[str]:
    """Yield the lines of the program with its new feeds; count the words that changed."""
    from fuzzycnc_ros.core.feedrate.gcode.blocks import FeedTally
    from fuzzycnc_ros.core.feedrate.gcode.writer import write_blocks

    tally = FeedTally()
    held: dict[int, Block] = {}

    def noted() -> 'Iterator[tuple[Block, float | None]]':
        time, timed, moved = 0.0, 0, 0
        for count, (block, feed) in enumerate(scheduled, 1):
            held.setdefault(block.line, block)
            tally.take(block, feed)
            if block.segment is not None:
                moved += 1
                own = block.segment.feed if feed is None else feed
                if own:
                    time += block.segment.length / own
                    timed += 1
            if moved <= STRETCH_BLOCKS:
                if time <= STRETCH or timed <= 1:
                    words.stretch = count
                if time + rest * timed <= STRETCH or timed <= 1:
                    words.begun.append((block, feed))
            yield block, feed

    for number, line in enumerate(write_blocks(noted()), 1):
        block = held.pop(number)
        if line != block.text:
            words.added += block.word is None
            words.changed += block.word is not None
        yield line
    words.unchanged = '' if words.added or words.changed else tally.reason


def _driven(
    words: Words, settings: 'ProgramSettings', machine: SchedulingMachine
) -> 'tuple[ProgramResult | None, ProgramResult | None]':
    """Drive the first lines as they were and as they are on the simulated controller."""
    from fuzzycnc_ros.studies.programs.program_drive import drive_words

    return drive_words(words.begun, settings, machine.contouring)


def _name(lines: int, total: int) -> str:
    """Return what the first lines of a program are called."""
    return 'the whole program' if lines >= total else f'lines 1 to {lines:,} of {total:,}'


@dataclass(frozen=True)
class Stretch:
    """The beginning of a program, and what it is called."""

    program: 'Program'
    name: str


def _stretch(source: Path, reader: 'ProgramReader', count: int, total: int) -> Stretch:
    """Read the beginning of a program again."""
    from fuzzycnc_ros.core.feedrate.gcode.blocks import Program

    with open_program(source) as file:
        blocks = list(islice(reader.blocks(file), count))
    return Stretch(Program(tuple(blocks), reader.notes), _name(count, total))


def _write_report(
    report: Path,
    stretch: Stretch,
    figures: 'ScheduleFigures',
    trace: 'PathTrace',
    machine: SchedulingMachine,
) -> None:
    """Drive a stretch of the program with every method, and write the page."""
    from fuzzycnc_ros.studies.programs.program_drive import compare_methods
    from fuzzycnc_ros.studies.programs.program_page import schedule_page, speed

    config = machine.scheduler
    with progress_bar('driving') as tell:
        found = compare_methods(
            stretch.program, config, figures.settings, machine.contouring, progress=tell
        )
    facts = {
        'Program': figures.program,
        'Method': config.method,
        'Tolerance': f'{1e3 * config.tolerance:g} mm',
        'Corners': figures.corner_text,
        'Upper bound of the feed': 'the feed words of the program'
        if figures.settings.feed is None
        else speed(figures.settings.feed),
        'Machine constant': f'{config.machine_constant:g} s²',
        'Rest at exact stops': f'{config.settle:g} s',
        'Simulated machine': f'position loop {machine.contouring.position_gain:g} 1/s, velocity '
        f'loop {machine.contouring.velocity_bandwidth:g} rad/s',
    }
    page = schedule_page(figures, trace, found, stretch.name, facts)
    write_report(report, page)


def _lines(figures: 'ScheduleFigures', words: Words, out: Path) -> list[str]:
    """Return what is printed below the table."""
    notes = [f'note: {note}' for note in figures.notes]
    if len(notes) > NOTES:
        notes[NOTES:] = [f'note: {len(notes) - NOTES} more; --json and --report have all']
    lines = figures.remarks()
    if words.unchanged:
        lines.append(f'unchanged: {words.unchanged}')
    lines += notes
    if str(out) != STREAM:
        lines.append(f'{out}: the program with its new feeds')
    return lines
