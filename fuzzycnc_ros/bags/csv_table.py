# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading the numbers of a CSV recording; every complaint names file, line and column."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.csv_mapping import ISO8601, TIME_UNITS, CsvMapping
from fuzzycnc_ros.bags.errors import CsvError
from fuzzycnc_ros.core.repeated_names import repeated_names
from fuzzycnc_ros.core.thermal.run import JITTER_MAX, SAMPLES_MIN

_EMPTY = ('', 'nan', 'na', 'n/a', 'null', 'none', '-')  # how programs write a missing number
_DELIMITERS = (',', ';', '\t')


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
    """

    path: Path
    header: list[str]
    lines: list[int]
    rows: list[list[str]]
    decimal: str

    def require(self, names: Sequence[str]) -> None:
        """Refuse a file that lacks a column; the message lists what is there.

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
            )

    def column(self, name: str) -> NDArray[np.float64]:
        """Return a column as numbers, NaN where a cell is empty.

        Raises
        ------
        CsvError
            If a cell holds text.
        """
        place = self.header.index(name)
        cells = [row[place] for row in self.rows]
        if self.decimal == ',':
            cells = [cell.replace(',', '.') for cell in cells]
        try:
            return np.array(cells, dtype=np.float64)
        except ValueError:
            return np.array([self._number(k, name, cell) for k, cell in enumerate(cells)])

    def _number(self, row: int, name: str, cell: str) -> float:
        if cell.strip().lower() in _EMPTY:
            return np.nan
        try:
            return float(cell)
        except ValueError as error:
            found = self.rows[row][self.header.index(name)]
            raise CsvError(
                f'{self.place(row, name)}: expected a number but found {found!r}'
            ) from error

    def time(self, name: str, unit: str) -> tuple[NDArray[np.float64], float | None]:
        """Return the time of each row from the first one [s], and the first date if it has one.

        Raises
        ------
        CsvError
            If a time is missing, is no time, or does not increase.
        """
        if unit == ISO8601:
            place = self.header.index(name)
            seconds = np.array(
                [self._date(k, name, row[place]) for k, row in enumerate(self.rows)]
            )
            first: float | None = float(seconds[0])
        else:
            seconds, first = self.column(name) * TIME_UNITS[unit], None
        lost = np.flatnonzero(~np.isfinite(seconds))
        if len(lost):
            raise CsvError(f'{self.place(int(lost[0]), name)}: expected a time but found none')
        backwards = np.flatnonzero(np.diff(seconds) <= 0.0)
        if len(backwards):
            row = int(backwards[0]) + 1
            cell, before = (self.rows[k][self.header.index(name)] for k in (row, row - 1))
            raise CsvError(
                f'{self.place(row, name)}: expected a time after {before} but found {cell}; '
                'sort the file, or import runs one by one with --rows'
            )
        return seconds - seconds[0], first

    def _date(self, row: int, name: str, cell: str) -> float:
        text = cell.strip()
        try:
            # Python 3.10 does not know the Z of ISO 8601.
            date = datetime.fromisoformat(f'{text[:-1]}+00:00' if text.endswith('Z') else text)
        except ValueError as error:
            raise CsvError(
                f'{self.place(row, name)}: expected a date such as 2024-05-01T08:00:00Z but '
                f'found {cell!r}'
            ) from error
        if date.tzinfo is None:
            date = date.replace(tzinfo=timezone.utc)
        return date.timestamp()

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
        If the file is missing, empty, no text, names a column twice, has rows of different
        length, or fewer than 8 rows are left.
    """
    try:
        with path.open(encoding='utf-8-sig', newline='') as file:
            return _parse(path, file.read(), mapping)
    except OSError as error:
        raise CsvError(f'{path}: cannot be read: {error.strerror}') from error
    except UnicodeDecodeError as error:
        raise CsvError(
            f'{path}: expected text in UTF-8 but byte {error.start} is none; '
            'save the file as CSV in UTF-8'
        ) from error


def _parse(path: Path, text: str, mapping: CsvMapping) -> Table:
    first = next((line for line in text.splitlines() if line.strip()), '')
    if not first:
        raise CsvError(f'{path}: expected a header and rows but the file is empty')
    delimiter = mapping.delimiter or max(_DELIMITERS, key=first.count)
    if delimiter == mapping.decimal:
        raise CsvError(
            f'{path}: expected columns between ; or tab where the decimal sign is '
            f'{mapping.decimal!r}; name the delimiter'
        )
    reader = csv.reader(text.splitlines(keepends=True), delimiter=delimiter)
    header: list[str] = []
    lines: list[int] = []
    rows: list[list[str]] = []
    try:
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if not header:
                header = [cell.strip() for cell in cells]
                continue
            if len(cells) != len(header):
                raise CsvError(
                    f'{path}, line {reader.line_num}: expected {len(header)} columns as in the '
                    f'header but found {len(cells)}'
                )
            lines.append(reader.line_num)
            rows.append(cells)
    except csv.Error as error:
        raise CsvError(
            f'{path}, line {reader.line_num}: expected CSV but found {error}'
        ) from error
    repeated = repeated_names(header)
    if repeated:
        raise CsvError(
            f'{path}, line 1: expected each column once but found '
            f'{", ".join(repr(name) for name in repeated)} more than once; rename them in the file'
        )
    if mapping.rows is not None:
        begin, end = mapping.rows
        if end >= len(rows):
            raise CsvError(
                f'{path}: expected rows {begin} to {end} but the file has rows 0 to '
                f'{len(rows) - 1}'
            )
        lines, rows = lines[begin : end + 1], rows[begin : end + 1]
    if len(rows) < SAMPLES_MIN:
        raise CsvError(f'{path}: expected at least {SAMPLES_MIN} rows but found {len(rows)}')
    return Table(path, header, lines, rows, mapping.decimal)
