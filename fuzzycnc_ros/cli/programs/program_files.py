# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Part programs on disk: read line by line, byte for byte, and written whole or not at all."""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import IO, TYPE_CHECKING

from fuzzycnc_ros.cli.console import check_folder
from fuzzycnc_ros.files.atomic import whole_file
from fuzzycnc_ros.ros.leftovers import TemporaryFolder
from fuzzycnc_ros.ros.streams import is_dropped

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.gcode.blocks import Program

STREAM = '-'
"""Name of the standard streams."""

_FILE_NAME = re.compile(r'[\w-][\w.-]*')


@contextmanager
def program_lines(path: Path) -> Iterator[Path]:
    """Have a program as a file that can be read more than once; `-` is standard input.

    Raises
    ------
    ValueError
        If there is no such file.
    """
    if str(path) != STREAM:
        if path.is_dir():
            raise ValueError(f'{path}: expected a part program but found a directory')
        if not path.exists():
            raise ValueError(f'{path}: expected a part program but nothing is there')
        yield path
        return
    with TemporaryFolder() as folder:
        copy = folder / 'part.ngc'
        with copy.open('wb') as file:
            shutil.copyfileobj(sys.stdin.buffer, file)
        yield copy


def open_program(path: Path) -> IO[str]:
    """Open a program so that writing its lines gives back every byte."""
    return open(path, encoding='utf-8', errors='surrogateescape', newline='')


def read_text(path: Path, units: str) -> Program:
    """Return a program as a whole, read.

    Raises
    ------
    ValueError
        If there is none, or it cannot be read as one.
    """
    from fuzzycnc_ros.core.feedrate.gcode.reader import read_program

    with program_lines(path) as source, open_program(source) as file:
        text = ''.join(file)
    try:
        return read_program(text, units)
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error


def subroutine_files(program: Path) -> Callable[[str], str | None]:
    """Return what finds subroutines in files beside a program, as LinuxCNC names them.

    It is told the name of a subroutine, and returns the text of its file, None where there is
    none.  Nothing lies beside standard input, and names that lead to other folders find nothing.
    """

    def found(name: str) -> str | None:
        path = program.parent / f'{name}.ngc'
        if str(program) == STREAM or not _FILE_NAME.fullmatch(name) or not path.is_file():
            return None
        return path.read_text(encoding='utf-8', errors='surrogateescape')

    return found


def check_output(program: Path, out: Path, in_place: bool) -> None:
    """Refuse an output before the work begins.

    Raises
    ------
    ValueError
        If it cannot be written, or is the program itself and nobody said so.
    """
    if str(out) == STREAM:
        if is_dropped(sys.stdout):
            raise ValueError('--out -: expected an open standard output but it is closed')
        return
    check_folder(out)
    if not os.access(out if out.exists() else out.absolute().parent, os.W_OK):
        raise ValueError(f'--out {out}: expected a file that may be written; choose another one')
    if not in_place and program.exists() and out.exists() and program.samefile(out):
        raise ValueError(
            f'--out {out}: expected another file than the program itself; choose another name, '
            'or say --in-place'
        )


@contextmanager
def new_program(out: Path) -> Iterator[IO[str]]:
    """Write a program that appears at the end of the block, whole; after an error not at all."""
    if str(out) == STREAM:
        with tempfile.TemporaryFile(
            'w+', encoding='utf-8', errors='surrogateescape', newline=''
        ) as file:
            yield file
            file.seek(0)
            sys.stdout.flush()
            shutil.copyfileobj(file.buffer, sys.stdout.buffer)
            sys.stdout.buffer.flush()
        return
    with whole_file(out) as draft:
        text = TextIOWrapper(draft, encoding='utf-8', errors='surrogateescape', newline='')
        yield text
        text.detach()  # which writes what it holds
