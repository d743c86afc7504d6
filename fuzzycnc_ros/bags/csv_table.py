# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading the numbers of a CSV recording; every complaint names file, line and column."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.csv_mapping import TIME_UNITS, CsvMapping
from fuzzycnc_ros.bags.csv_rows import is_number, read_rows
from fuzzycnc_ros.bags.csv_time import (
    ISO8601,
    first_misfit,
    has_date,
    is_day,
    known_forms,
    past_midnight,
    read_time,
)
from fuzzycnc_ros.bags.errors import CsvError
from fuzzycnc_ros.core.thermal.run import JITTER_MAX, SAMPLES_MIN

_EMPTY = ('', 'nan', 'na', 'n/a', 'null', 'none', '-')  # how programs write a missing number
_FEW = 0.1  # share of repeated times from which a clock is too coarse, and no row is doubled

_COMMA = re.compile(r'[+-]?\d+,\d+')
_THOUSANDS = re.compile(r'[+-]?\d{1,3}([.,])\d{3}(\1\d{3})*([.,]\d+)?')
_WITH_UNIT = re.compile(r'[+-]?\d+([.,]\d+)?\s*[^\d\s.,:+-]+')


@dataclass(frozen=True)
class Times:
    """The time column.

    Parameters
    ----------
    seconds : ndarray, shape (n,)
        Time of each row from the first one [s].
    date : float or None
        Seconds since 1970 of the first row, where the column says the day.
    form : str
        Form of the column, as `strptime` writes it; empty for numbers.
    midnights : list of int
        Rows before which a day was added.
    """

    seconds: NDArray[np.float64]
    date: float | None
    form: str
    midnights: list[int]


@dataclass(frozen=True)
class Table:
    """The rows of a CSV file as text.

    Parameters
    ----------
    path : Path
        The file.
    header : list of str
        Names of the columns.
    lines : list of int
        Line number of each row, the header being line 1.
    rows : list of list of str
        The cells.
    decimal : str
        Decimal sign.
    first : int
        Row of the file that is row 0 here, counted from 0 below the header.
    """

    path: Path
    header: list[str]
    lines: list[int]
    rows: list[list[str]]
    decimal: str
    first: int = 0

    def require(self, names: Sequence[str], option: str = '') -> None:
        """Refuse a file that lacks columns; the message lists what is there.

        Parameters
        ----------
        names : sequence of str
            The columns.
        option : str
            What names them on a command line.

        Raises
        ------
        CsvError
            If a column is missing.
        """
        missing = [name for name in names if name not in self.header]
        if missing:
            raise CsvError(
                f'{self.path}: expected the column {", ".join(repr(m) for m in missing)} but the '
                f'file has {", ".join(self.header)}'
                + (f'; name it with {option}' if option else '')
            )

    def column(self, name: str) -> NDArray[np.float64]:
        """Return a column as numbers, NaN where a cell is empty.

        Raises
        ------
        CsvError
            If a cell holds text.
        """
        cells = self.cells(name)
        if self.decimal == ',':
            pointed = next((row for row, cell in enumerate(cells) if '.' in cell), None)
            if (
                pointed is not None
            ):  # a point between thousands would be taken for the decimal sign
                self._refuse_number(pointed, name)
            cells = [cell.replace(',', '.') for cell in cells]
        try:
            return np.array(cells, dtype=np.float64)
        except ValueError:
            return np.array([self._number(row, name, cell) for row, cell in enumerate(cells)])

    def cells(self, name: str) -> list[str]:
        """Return the texts of a column."""
        place = self.header.index(name)
        return [row[place] for row in self.rows]

    def _number(self, row: int, name: str, cell: str) -> float:
        if cell.strip().lower() in _EMPTY:
            return np.nan
        try:
            return float(cell)
        except ValueError:
            self._refuse_number(row, name)

    def _refuse_number(self, row: int, name: str) -> NoReturn:
        found = self.cells(name)[row]
        raise CsvError(
            f'{self.place(row, name)}: expected a number but found {found!r}'
            f'{self._hint(row, found.strip())}'
        )

    def _hint(self, row: int, found: str) -> str:
        """Return what may help with a cell that is no number; empty if nothing is known."""
        if self.decimal == ',' and '.' in found:
            return (
                '; where the decimal sign is a comma, remove the points between thousands, or '
                'leave out --decimal'
            )
        if self.decimal == '.' and _COMMA.fullmatch(found):
            return '; with decimal commas import with --decimal ,'
        if _THOUSANDS.fullmatch(found):
            return '; remove what stands between thousands'
        if row == 0 and not any(is_number(cell) for cell in self.rows[0]):
            last = self.first + len(self.rows) - 1
            return f'; leave out a line of units below the header with --rows 1:{last}'
        if is_day(found):
            return '; it is a date without a time of day: name the column of these with --time'
        if known_forms([found]):
            return '; it looks like a time: name the time column with --time'
        if _WITH_UNIT.fullmatch(found):
            return '; remove the unit from the cells'
        return ''

    def time(self, name: str, unit: str, form: str | None = None) -> Times:
        """Return the time column.

        Parameters
        ----------
        name : str
            The column.
        unit : str
            Unit of numbers, or `iso8601`.
        form : str, optional
            Form of dates or times of day; a usual one is recognised.

        Raises
        ------
        CsvError
            If a time is missing, is no time, does not increase, or may be meant in two ways.
        """
        cells = self.cells(name)
        form = form or (ISO8601 if unit == ISO8601 else self._form(name, cells))
        midnights: list[int] = []
        if form:
            lost = [row for row, cell in enumerate(cells) if cell.strip().lower() in _EMPTY]
            misfit = None if lost else first_misfit(cells, form)
            if misfit is not None:
                looks = (
                    'date such as 2024-05-01T08:00:00Z' if form == ISO8601 else f'time as {form}'
                )
                raise CsvError(
                    f'{self.place(misfit, name)}: expected a {looks} but found '
                    f'{cells[misfit]!r}; another form can be named with --time-format'
                )
            seconds = np.array([np.nan if lost else read_time(cell, form) for cell in cells])
        else:
            seconds = self.column(name) * TIME_UNITS[unit]
            lost = np.flatnonzero(~np.isfinite(seconds)).tolist()
        if lost:
            raise CsvError(f'{self.place(lost[0], name)}: expected a time but found none')
        if form and not has_date(form):
            seconds, midnights = past_midnight(seconds)
        self._check_increasing(name, seconds)
        date = float(seconds[0]) if form and has_date(form) else None
        return Times(seconds - seconds[0], date, form, midnights)

    def _form(self, name: str, cells: list[str]) -> str:
        """Return the form of dates or times of day; empty for numbers."""
        first = next((cell for cell in cells if cell.strip().lower() not in _EMPTY), '')
        if not first or is_number(first):
            return ''
        forms = known_forms([first])
        if not forms:
            hint = self._hint(0, first.strip())
            raise CsvError(
                f'{self.place(cells.index(first), name)}: expected a time but found {first!r}'
                + (hint or '; name its form with --time-format, such as %d.%m.%Y %H:%M:%S')
            )
        known = [cell for cell in cells if cell.strip().lower() not in _EMPTY]
        # Of forms that do not fit, the one that fits longest says which cell is odd.
        ends = [first_misfit(known, form) for form in forms]
        whole = [form for form, end in zip(forms, ends, strict=True) if end is None]
        if not whole:
            return max(zip(forms, ends, strict=True), key=lambda item: item[1] or 0)[0]
        starts = [np.array([read_time(cell, form) for cell in known]) for form in whole]
        if any(np.ptp(start - starts[0]) > 0.0 for start in starts[1:]):
            raise CsvError(
                f'{self.place(cells.index(first), name)}: expected a date but {first!r} can be '
                f'read in more than one way; say how: --time-format '
                f'{" or ".join(repr(form) for form in whole)}'
            )
        return whole[0]

    def _check_increasing(self, name: str, seconds: NDArray[np.float64]) -> None:
        """Refuse times that stand still or go back."""
        steps = np.diff(seconds)
        late = np.flatnonzero(steps <= 0.0)
        if not len(late):
            return
        row = int(late[0]) + 1
        cells = self.cells(name)
        same = int((steps == 0.0).sum())
        if steps[row - 1] < 0.0 and _THOUSANDS.fullmatch(cells[row].strip()):
            remedy = 'remove what stands between thousands'
        elif steps[row - 1] < 0.0:
            end = self.first + len(self.rows) - 1
            remedy = (
                f'sort the file, or import runs one by one with --rows '
                f'{self.first}:{self.first + row - 1} and --rows {self.first + row}:{end}'
            )
        elif same > _FEW * len(seconds):
            remedy = f'{same} rows have the time of the row before: log finer times'
        else:
            remedy = f'delete one of the two rows{f", and {same - 1} like it" * (same > 1)}'
        raise CsvError(
            f'{self.place(row, name)}: expected a time after {cells[row - 1]} but found '
            f'{cells[row]}; {remedy}'
        )

    def check_even(self, name: str, time: NDArray[np.float64]) -> None:
        """Refuse rows that are not evenly spaced in time.

        Raises
        ------
        CsvError
            If a step deviates from the median by more than 10 %.
        """
        steps = np.diff(time)
        median = float(np.median(steps))
        worst = int(np.argmax(np.abs(steps - median)))
        if abs(steps[worst] - median) > JITTER_MAX * median:
            raise CsvError(
                f'{self.place(worst + 1, name)}: expected even steps of {median:.6g} s but found '
                f'a step of {steps[worst]:.6g} s; import with --resample {median:.4g}'
            )

    def place(self, row: int, name: str) -> str:
        """Return file, line and column of a cell, for a message."""
        return f'{self.path}, line {self.lines[row]}, column {name!r}'


def read_table(path: Path, mapping: CsvMapping) -> Table:
    """Read the rows of a CSV file that a mapping selects.

    Raises
    ------
    CsvError
        If the file cannot be read as `read_rows` says, or fewer than 8 rows are left.
    """
    header, numbers, rows = read_rows(path, mapping)
    begin, end = mapping.rows or (0, len(rows) - 1)
    if end >= len(rows):
        raise CsvError(
            f'{path}: expected rows {begin} to {end} but the file has rows 0 to {len(rows) - 1}'
        )
    numbers, rows = numbers[begin : end + 1], rows[begin : end + 1]
    if len(rows) < SAMPLES_MIN:
        raise CsvError(f'{path}: expected at least {SAMPLES_MIN} rows but found {len(rows)}')
    return Table(path, header, numbers, rows, mapping.decimal, begin)
