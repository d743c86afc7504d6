# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings for `fuzzycnc machine identify`: columns of text files, and bags."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.encodings import decoded
from fuzzycnc_ros.files.os_errors import os_sentence

SIZE_MAX = 500_000_000
"""Largest text file that is read [bytes]."""

GUESSES: Mapping[str, tuple[str, ...]] = {
    't': ('t', 'time', 'time_s', 'timestamp', 'sample_time'),
    'command': ('command', 'duty', 'voltage', 'vir', 'u', 'torque', 'force', 'current'),
    'position': ('position', 'actual', 'actual_mm', 'qm', 'pos', 'measured'),
    'reference': ('reference', 'commanded', 'commanded_mm', 'set_point', 'qg'),
}
"""Names of columns that are taken without being told; the first and the last may be missing."""

_JITTER = 0.25
"""Share of a period that a sample may be late."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of a recording without gaps.

    Attributes
    ----------
    values : dict of str to ndarray, shape (n,)
        Columns by what they are.
    period : float
        Time between two samples [s].
    """

    values: dict[str, Array]
    period: float


def parse_columns(texts: list[str]) -> dict[str, str]:
    """Return what a column is called, by what it is: `command=vir`.

    Raises
    ------
    ValueError
        If a text is no assignment, or something is named twice.
    """
    found: dict[str, str] = {}
    for text in (part for item in texts for part in item.split(',')):
        what, sign, name = text.partition('=')
        if not sign or not what.strip() or not name.strip() or what.strip() in found:
            raise ValueError(
                f'--columns: expected each column once, as command=vir, but found {text!r}'
            )
        found[what.strip()] = name.strip()
    return found


def read_columns(path: Path, wanted: Mapping[str, str], period: float | None) -> list[Columns]:
    """Read columns of a text file, in stretches without gaps.

    Columns are separated by commas, semicolons or blanks.  Without a header they are named by
    their numbers, from 1, as those of LinuxCNC's `halsampler` are.

    Parameters
    ----------
    path : Path
        The file.
    wanted : mapping of str to str
        Names of columns by what they are; `t` may be left out where `period` is given.
    period : float or None
        Time between two samples where the file has none [s].

    Raises
    ------
    ValueError
        If a column is missing or holds something else than numbers, or the times make no sense.
    """
    table, names = _table(path)
    values: dict[str, Array] = {}
    for what, name in wanted.items():
        if name not in names:
            raise ValueError(
                f'{path}: expected a column {name} ({what}) but found {", ".join(names)}; name '
                f'them by --columns {what}=...'
            )
        column = table[:, names.index(name)]
        if not np.isfinite(column).all():
            row = int(np.flatnonzero(~np.isfinite(column))[0])
            raise ValueError(
                f'{path}: row {row + 1} below the header: expected a number in {name} but found '
                'something else'
            )
        values[what] = column
    if 't' not in values:
        if period is None:
            raise ValueError(
                f'{path}: expected a column of times but found none; name it by --columns t=..., '
                'or give --period'
            )
        return [Columns(values, period)]
    return _stretches(path, values)


def guessed(path: Path, wanted: Mapping[str, str]) -> dict[str, str]:
    """Return the columns of an axis by name, those that are not told by their usual names."""
    _, names = _table(path, header_only=True)
    found = dict(wanted)
    for what, usual in GUESSES.items():
        if what in found:
            continue
        hits = [name for name in names if name.strip().lower() in usual]
        if len(hits) == 1:
            found[what] = hits[0]
        elif what not in ('t', 'reference'):
            raise ValueError(
                f'{path}: expected one column that is the {what} but found '
                f'{", ".join(hits) or "none"} among {", ".join(names)}; name it by '
                f'--columns {what}=...'
            )
    return found


def _table(path: Path, *, header_only: bool = False) -> tuple[Array, list[str]]:
    try:
        if path.stat().st_size > SIZE_MAX:
            raise ValueError(f'{path}: expected a file of at most {SIZE_MAX // 10**6} MB')
        with path.open('rb') as file:
            data = file.readline(SIZE_MAX) if header_only else file.read()
    except OSError as error:
        raise ValueError(os_sentence(error, path)) from error
    try:
        lines = decoded(data).splitlines()
    except ValueError as error:
        hint = '; save .mat files as CSV first' if path.suffix.lower() == '.mat' else ''
        raise ValueError(f'{path}: {error}{hint}') from error
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith('#')]
    if not lines:
        raise ValueError(f'{path}: expected rows of numbers but found an empty file')
    split = next((sign for sign in (';', '\t', ',') if sign in lines[0]), None)
    first = _cells(lines[0], split)
    numbered = all(_number(cell) for cell in first)
    names = [str(place) for place in range(1, len(first) + 1)] if numbered else first
    rows = lines if numbered else lines[1:]
    if header_only:
        return np.empty((0, len(names))), names
    table = np.full((len(rows), len(names)), np.nan)
    for place, line in enumerate(rows):
        cells = _cells(line, split)
        if len(cells) != len(names):
            raise ValueError(
                f'{path}: row {place + 1} below the header: expected {len(names)} columns but '
                f'found {len(cells)}'
            )
        table[place] = [float(cell) if _number(cell) else np.nan for cell in cells]
    if not len(table):
        raise ValueError(f'{path}: expected rows below the header but found none')
    return table, names


def _cells(line: str, split: str | None) -> list[str]:
    cells = line.split(split) if split else re.split(r'\s+', line.strip())
    return [cell.strip().strip('"') for cell in cells]


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _stretches(path: Path, values: dict[str, Array]) -> list[Columns]:
    """Cut where samples are missing; set small jitter to the period."""
    time = values.pop('t')
    steps = np.diff(time)
    if len(time) < 2 or not (steps > 0.0).all():
        place = int(np.flatnonzero(steps <= 0.0)[0]) + 2 if len(time) > 1 else 1
        raise ValueError(
            f'{path}: row {place} below the header: expected times that rise but found '
            f'{time[place - 1]:g} s'
        )
    period = float(np.median(steps))
    if not 1e-6 < period < 1.0:
        raise ValueError(
            f'{path}: expected times in seconds, 1 us to 1 s apart, but found {period:g}; are '
            'they ms or sample numbers? give --period and leave t out'
        )
    edges = np.flatnonzero(np.abs(steps - period) > _JITTER * period) + 1
    parts = np.split(np.arange(len(time)), edges)
    return [
        Columns({what: column[part] for what, column in values.items()}, period)
        for part in parts
        if len(part) >= 200
    ]
