# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of all subcommands: tables, progress, files of figures."""

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.progress_lines import progress_lines
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.files.atomic import destination, is_written_through
from fuzzycnc_ros.files.atomic import write_text as write_whole
from fuzzycnc_ros.files.os_errors import STANDARD_OUTPUT, about, no_folder
from fuzzycnc_ros.studies.page.document import to_document

if TYPE_CHECKING:
    from rich.console import Console

    from fuzzycnc_ros.studies.page.html import Page, Remark
    from fuzzycnc_ros.studies.page.table import Column, Table

JsonFile = Annotated[
    Optional[Path],  # noqa: UP045  typer 0.9 reads this form on every Python
    typer.Option(
        '--json',
        show_default=False,
        metavar='FILE',
        help='Write the figures to this file as JSON.',
    ),
]

PLAIN_WIDTH = 100
"""Characters of a line where the output is no terminal and COLUMNS is not set."""

Tell = Callable[[str, int, int], None]
"""Told what is going on, steps done and in all."""


def show(table: 'Table') -> None:
    """Print a table: with emphasis on a terminal, as plain text elsewhere."""
    if not sys.stdout.isatty():
        width = plain_width()
        parts = fitting(table, lambda part: part.least_width() <= width)
        _put('\n\n'.join(part.to_text(width) for part in parts))
        return
    from fuzzycnc_ros.cli.terminal import Terminal

    console = Terminal()
    for part in fitting(table, partial(fits_terminal, console=console)):
        console.print(part.to_rich())


def plain_width() -> int:
    """Return how many characters a line of a table has in a pipe or file."""
    columns = os.environ.get('COLUMNS', '')
    return int(columns) if columns.isdecimal() and int(columns) else PLAIN_WIDTH


def fits_terminal(table: 'Table', console: 'Console') -> bool:
    """Return whether a terminal shows a table without cutting a number."""
    endless = console.options.update(max_width=10_000)
    return console.measure(table.to_rich(), options=endless).minimum <= console.width


def fitting(table: 'Table', fits: 'Callable[[Table], bool]') -> 'list[Table]':
    """Return a table in parts that fit, so that no figure is cut short.

    Each part repeats the first columns that name a row, one where they leave too little room.
    Columns of one group stay together, and so do groups whose names begin with the same word,
    such as the axes of a run, if a part can hold them.
    """
    for named in dict.fromkeys((_naming(table), 1)):
        for key in (_family, _group, id):
            parts: list[list[int]] = []
            for _, members in groupby(table.columns[named:], key):
                first = parts[-1][-1] + 1 if parts else named
                columns = list(range(first, first + len(list(members))))
                if parts and fits(_columns(table, named, [*parts[-1], *columns])):
                    parts[-1] += columns
                else:
                    parts.append(columns)
            found = [_columns(table, named, part) for part in parts]
            if all(map(fits, found)):
                return found or [table]
    return found or [table]


def _naming(table: 'Table') -> int:
    """Return how many of the first columns name a row: texts, until no two rows have the same."""
    for count, column in enumerate(table.columns):
        if count and column.numeric:
            return count
        if len({row[: count + 1] for row in table.rows}) == len(table.rows):
            return count + 1
    return 1


def _group(column: 'Column') -> str:
    return column.group


def _family(column: 'Column') -> str:
    return column.group.partition(' ')[0]


def _columns(table: 'Table', named: int, chosen: list[int]) -> 'Table':
    """Return a table with its first columns and some others."""
    columns = [*range(named), *chosen]
    return replace(
        table,
        columns=tuple(table.columns[c] for c in columns),
        rows=tuple(tuple(row[c] for c in columns) for row in table.rows),
        strong=frozenset((r, columns.index(c)) for r, c in table.strong if c in columns),
        warning=frozenset((r, columns.index(c)) for r, c in table.warning if c in columns),
    )


def say(text: str) -> None:
    """Print a line of the result; control characters of foreign names are spelt out."""
    _put(visible(text))


def _put(text: str) -> None:
    """Print to standard output; an error names it."""
    try:
        print(text, flush=True)
    except OSError as error:
        raise about(error, STANDARD_OUTPUT) from None


def flush() -> None:
    """Write out what was printed; an error names standard output."""
    try:
        sys.stdout.flush()
    except OSError as error:
        raise about(error, STANDARD_OUTPUT) from None


def remark(line: 'Remark') -> None:
    """Print a sentence on the result, one that warns in the colour of warnings."""
    if not line.warning or not sys.stdout.isatty():
        say(line.text)
        return
    from fuzzycnc_ros.cli.terminal import Terminal

    Terminal().print(line.text, style='yellow', soft_wrap=True, highlight=False)


def complain(text: str) -> None:
    """Print a line on what went wrong."""
    print(f'error: {visible(text)}', file=sys.stderr, flush=True)


@contextmanager
def progress_bar(title: str) -> Iterator[Tell]:
    """Show the progress of long work on standard error: a bar, or lines if it is no terminal."""
    if not sys.stderr.isatty():
        with progress_lines(title) as lines:
            yield lines.tell
        return
    from rich.progress import BarColumn, Progress, TimeElapsedColumn

    from fuzzycnc_ros.cli.terminal import Description, Terminal

    columns = (Description(), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Terminal(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)

        def tell(text: str, done: int, total: int) -> None:
            bar.update(task, description=text, completed=done, total=total)

        yield tell


def write_json(path: Path | None, document: Any) -> None:
    """Write figures to a file, as `to_document` gives them."""
    if path is not None:
        write_text(path, json.dumps(to_document(document), indent=2, allow_nan=False) + '\n')


def write_text(path: Path, text: str) -> None:
    """Write a file as a whole: after an error or a kill it is the old one or none.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    check_folder(path)
    write_whole(path, text)


def write_report(path: Path, page: 'Page') -> None:
    """Write the page of a report, and say so.

    Raises
    ------
    ModuleNotFoundError
        If jinja2 is not installed; the message says how to install it.
    """
    from fuzzycnc_ros.studies.page.html import render_page

    write_text(path, render_page(page))
    say(f'{path}: the report; open it in a browser')


def check_ros(what: str) -> None:
    """Refuse what needs a graph where there is no ROS 2.

    Raises
    ------
    ModuleNotFoundError
        If ROS 2 is not installed.
    """
    if find_spec('rclpy') is None:
        raise ModuleNotFoundError(
            f'{what} needs ROS 2 (rclpy), which is not installed: source a ROS 2 Jazzy '
            'workspace, or run make setup and use .venv/bin/fuzzycnc'
        )


def check_new(path: Path | None, remedy: str = 'remove it') -> None:
    """Refuse an output file that would overwrite another one, before the work begins.

    Raises
    ------
    ValueError
        If it exists, other than as a device or a pipe, or its folder does not.
    """
    if path is not None and not is_written_through(path):
        check_new_folder(path, remedy)


def check_new_folder(path: Path | None, remedy: str = 'remove it') -> None:
    """Refuse an output folder, such as a bag, that exists, before the work begins.

    Raises
    ------
    ValueError
        If it exists, or the folder around it does not.
    """
    if path is not None and path.exists():
        raise ValueError(
            f'{path}: expected a new name but it exists; choose another one or {remedy}'
        )
    check_folder(path)


def check_folder(*paths: Path | None) -> None:
    """Refuse outputs whose folder does not exist, or that are folders themselves.

    Raises
    ------
    ValueError
        If there is no such folder, or a path is one.
    """
    for path in paths:
        if path is None:
            continue
        if path.is_dir():
            raise ValueError(f'{path}: expected a file to write but found a directory')
        place = destination(path)
        if not place.parent.is_dir():
            raise ValueError(no_folder(place if path.is_symlink() else path))


def check_at_least(option: str, value: float | None, low: float) -> None:
    """Refuse a number below its bound.

    Raises
    ------
    ValueError
        If it is below.
    """
    if value is not None and not value >= low:
        raise ValueError(f'{option}: expected {low:g} or more but found {value:g}')


def words(texts: list[str]) -> tuple[str, ...]:
    """Return the parts of options that may be repeated or hold several, with commas between."""
    return tuple(part.strip() for text in texts for part in text.split(',') if part.strip())


def say_unkept(text: str) -> None:
    """Print that a tolerance is not kept: in red on a terminal, after a mark elsewhere."""
    if not sys.stdout.isatty():
        say(f'! {text}')
        return
    from fuzzycnc_ros.cli.terminal import Terminal

    Terminal().print(text, style='bold red', soft_wrap=True, highlight=False)
