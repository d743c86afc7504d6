# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feeds of a program as words in it, or as feed shares in a table beside it."""

from pathlib import Path
from typing import Annotated

from fuzzycnc_ros.cli.console import check_folder, progress_bar, say, say_unkept, write_text
from fuzzycnc_ros.cli.options import OptionalPath, choice, given
from fuzzycnc_ros.cli.programs.program_files import STREAM, new_program, read_text
from fuzzycnc_ros.cli.programs.scheduling_machine import SchedulingMachine, controller_limits

AS = ('words', 'adaptive')
"""Ways in which feeds reach the controller."""

NOTES = 8
"""Notes that are printed."""

FeedsAs = Annotated[
    str,
    choice(
        'Feeds as words of the program, or as shares along the path in a table that LinuxCNC '
        'follows by M52 P1 and the component fuzzycnc_feed.',
        AS,
        '--as',
    ),
]
FeedTableFile = Annotated[
    OptionalPath, given('The feed shares, with --as adaptive.', metavar='FILE')
]


def check_table(as_: str, out: Path | None, table: Path | None) -> None:
    """Refuse a choice without its files, and files without it, before the work begins.

    Raises
    ------
    ValueError
        If one lacks.
    """
    if (table is None) == (as_ == 'adaptive') and (out is not None or table is not None):
        raise ValueError(
            'expected --as adaptive and --table together but found one alone; the table is half '
            'of the program'
        )
    if table is None:
        return
    if out is None or str(out) == STREAM:
        raise ValueError('--out: expected a file beside --table; the table is for that program')
    check_folder(table)
    if table.absolute() == out.absolute():
        raise ValueError('--table: expected another file than --out; choose another name')


def schedule_shares(
    program: Path, out: Path, table: Path, machine: SchedulingMachine, units: str
) -> dict[str, object]:
    """Write a program and its feed shares, and say what they do; return the figures (SI)."""
    from fuzzycnc_ros.studies.programs.adaptive_feed import AdaptiveFeed

    read = read_text(program, units)
    tolerance = machine.scheduler.tolerance
    try:
        search = AdaptiveFeed(read.text, controller_limits(machine), machine.contouring, units)
        with progress_bar('refining') as tell:
            tell('feed shares', 0, 1)
            found, judged = search.keeping(tolerance / search.disagreement)
    except ValueError as error:
        raise ValueError(f'{program}: {error}') from error
    own = search.own()
    kept = judged.error * search.disagreement <= tolerance
    machine.say_constant()
    for note in read.notes[:NOTES]:
        say(f'note: {note}')
    say(f'as it is: {1e6 * own.error:.1f} µm in {own.duration:.2f} s on the simulated controller')
    text = f'with feed shares: {1e6 * judged.error:.1f} µm in {judged.duration:.2f} s'
    if kept:
        say(text)
    else:
        say_unkept(f'{text}, not {1e6 * tolerance:g} µm: `fuzzycnc advise` says what helps')
    with new_program(out) as file:
        file.write(found.program)
    write_text(table, found.text())
    say(f'{out}: the program with M52 P1; {table}: its feed shares')
    return {'tolerance': tolerance, 'kept': kept, 'own': own, 'shares': judged}
