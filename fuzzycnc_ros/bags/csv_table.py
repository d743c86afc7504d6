# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading a CSV recording, whatever program wrote it; every complaint names file, line and column.

From the bytes of a file to its text, from the text to header and rows, from the cells to numbers.
"""

import codecs
import csv
import itertools
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.csv_time import (
    ISO8601,
    ClockChangeError,
    Zone,
    has_date,
    is_day,
    known_forms,
    past_midnight,
    read_date,
    seconds_of,
    zone_of,
)
from fuzzycnc_ros.bags.errors import BagError, CsvError
from fuzzycnc_ros.core.encodings import decoded, is_utf8
from fuzzycnc_ros.core.names import repeated_names
from fuzzycnc_ros.core.remedies import options_as
from fuzzycnc_ros.core.thermal.run import JITTER_MAX, SAMPLES_MIN
from fuzzycnc_ros.core.thermal.spacing import sample_interval
from fuzzycnc_ros.core.units import TIMES
from fuzzycnc_ros.files.os_errors import os_sentence

_WORKBOOKS = (b'PK\x03\x04', b'\xd0\xcf\x11\xe0')

_DELIMITERS = (';', '\t', ',')
_EXCEL = re.compile(r'"?sep=(.)"?', re.IGNORECASE)  # it takes this line for an instruction

_MARK = re.compile(r'#+ *(?=\w)')
"""Mark of a comment before a name; a column may be called # itself."""

_SAMPLE = 20
"""Last lines of a file that tell what stands between columns."""

STEP_MIN = 5e-3
"""Least time between rows of temperatures [s]: five minutes are 0.0035 days."""
TIME_MAX = 1e11
"""Latest time of a row [s], in the year 5138."""

_EMPTY = ('', 'nan', 'na', 'n/a', 'null', 'none', '-')  # how programs write a missing number
_FEW = 0.1  # share of repeated times from which a clock is too coarse, and no row is doubled

_DIGITS = re.compile(r'(?:19|20)\d{12}')
_DIGITS_FORM = '%Y%m%d%H%M%S'
_COMMA = re.compile(r'[+-]?\d+,\d+|[+-]?\d{1,3}(\.\d{3})+,\d+')
_THOUSANDS = re.compile(r'[+-]?\d{1,3}([.,])\d{3}(\1\d{3})*([.,]\d+)?')
_GROUPED = {
    ',': re.compile(r'\s*[+-]?\d{1,3}(?:\.\d{3})+(,\d+)?\s*'),
    '.': re.compile(r'\s*[+-]?\d{1,3}(?:,\d{3})+(\.\d+)?\s*'),
}
"""Numbers with signs between thousands, by decimal sign, and their decimals."""
_ABOVE = 50
"""Rows among which the names of the columns are looked for."""
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
    zone : Zone or None
        Zone of dates that name none; None where there are no such dates.
    """

    seconds: NDArray[np.float64]
    date: float | None
    form: str
    midnights: list[int]
    zone: Zone | None


@dataclass(frozen=True)
class CsvTable:
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
    units : dict
        What a line of units below the header says of each column.
    """

    path: Path
    header: list[str]
    lines: list[int]
    rows: list[list[str]]
    decimal: str
    first: int = 0
    units: Mapping[str, str] = field(default_factory=dict)

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

    def with_joined(self, name: str) -> 'CsvTable':
        """Return the table with a column `Date+Time` made of two that it has, or as it is."""
        parts = name.split('+')
        if name in self.header or not all(part in self.header for part in parts):
            return self
        cells = zip(*(self.cells(part) for part in parts), strict=True)
        rows = [[*row, ' '.join(cell)] for row, cell in zip(self.rows, cells, strict=True)]
        return replace(self, header=[*self.header, name], rows=rows)

    def column(self, name: str) -> NDArray[np.float64]:
        """Return a column as numbers, NaN where a cell is empty.

        Raises
        ------
        CsvError
            If a cell holds text.
        """
        cells = self._ungrouped(self.cells(name))
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

    def _ungrouped(self, cells: list[str]) -> list[str]:
        """Return cells without signs between thousands, if one with both signs proves these."""
        if not any('.' in cell and ',' in cell for cell in cells):
            return cells
        grouped = [_GROUPED[self.decimal].fullmatch(cell) for cell in cells]
        if not any(found and found[1] for found in grouped):
            return cells
        between = '.' if self.decimal == ',' else ','
        return [
            cell.replace(between, '') if found else cell
            for cell, found in zip(cells, grouped, strict=True)
        ]

    def _number(self, row: int, name: str, cell: str) -> float:
        if _is_empty(cell):
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
        if is_day(found):
            return (
                '; it is a date without a time of day: name the column of these with --time, or '
                'both as --time DATE+TIME'
            )
        if self.decimal == ',' and '.' in found:
            return (
                '; where the decimal sign is a comma, remove the points between thousands, or '
                'leave out --decimal'
            )
        if self.decimal == '.' and _COMMA.fullmatch(found):
            return '; with decimal commas import with --decimal ,'
        if _THOUSANDS.fullmatch(found):
            return '; remove the signs between thousands'
        if row == 0 and self.first == 0 and _is_of_units(self.rows[0]):
            last = self.first + len(self.rows) - 1
            return f'; leave out a line of units below the header with --rows 1:{last}'
        if known_forms([found]):
            return '; it looks like a time: name the time column with --time'
        if _WITH_UNIT.fullmatch(found):
            return '; remove the unit from the cells'
        return ''

    def time(
        self, name: str, unit: str, form: str | None = None, zone: str | None = None
    ) -> Times:
        """Return the time column.

        Parameters
        ----------
        name : str
            The column.
        unit : str
            Unit of numbers, or `iso8601`.
        form : str, optional
            Form of dates or times of day; a usual one is recognised.
        zone : str, optional
            Zone of dates that name none; that of this computer if absent.

        Raises
        ------
        CsvError
            If a time is missing, is no time, does not increase, or may be meant in two ways.
        """
        cells = self.cells(name)
        form = form or (ISO8601 if unit == ISO8601 else self._form(name, cells))
        midnights: list[int] = []
        used: Zone | None = None
        if not form:
            seconds = self.column(name) * TIMES[unit]
            lost = np.flatnonzero(~np.isfinite(seconds)).tolist()
        else:
            lost = [row for row, cell in enumerate(cells) if _is_empty(cell)]
        if lost:
            raise CsvError(
                f'{self.place(lost[0], name)}: expected a time but found none'
                + self._hint(lost[0], '')
            )
        if form:
            dates = _read_dates(cells, form)
            if len(dates) < len(cells):
                looks = (
                    'date such as 2024-05-01T08:00:00Z' if form == ISO8601 else f'time as {form}'
                )
                raise CsvError(
                    f'{self.place(len(dates), name)}: expected a {looks} but found '
                    f'{cells[len(dates)]!r}; another form can be named with --time-format'
                )
            if not has_date(form):
                seconds, midnights = past_midnight(_clock_seconds(dates))
            else:
                known = zone_of(zone)
                used = known if any(date.tzinfo is None for date in dates) else None
                try:
                    seconds = seconds_of(dates, known)
                except ClockChangeError as error:
                    raise CsvError(f'{self.place(error.row, name)}: {error}') from error
        self._check_increasing(name, seconds)
        date = float(seconds[0]) if form and has_date(form) else None
        return Times(seconds - seconds[0], date, form, midnights, used)

    def _form(self, name: str, cells: list[str]) -> str:
        """Return the form of dates or times of day; empty for numbers."""
        known = [cell for cell in cells if not _is_empty(cell)]
        if not known:
            return ''
        first = known[0]
        if _is_number(first):
            # Fourteen digits that all are dates are no seconds.
            dated = _DIGITS.fullmatch(first.strip()) and len(_read_dates(known, _DIGITS_FORM))
            return _DIGITS_FORM if dated == len(known) else ''
        forms = known_forms([first])
        if not forms:
            hint = self._hint(0, first.strip())
            raise CsvError(
                f'{self.place(cells.index(first), name)}: expected a time but found {first!r}'
                + (hint or '; name its form with --time-format, such as %d.%m.%Y %H:%M:%S')
            )
        # Of forms that do not fit, the one that fits longest says which cell is odd.
        dates = [_read_dates(known, form) for form in forms]
        whole = [place for place, found in enumerate(dates) if len(found) == len(known)]
        if not whole:
            return max(zip(forms, dates, strict=True), key=lambda item: len(item[1]))[0]
        starts = [_clock_seconds(dates[place]) for place in whole]
        if any(np.ptp(start - starts[0]) > 0.0 for start in starts[1:]):
            raise CsvError(
                f'{self.place(cells.index(first), name)}: expected a date but {first!r} can be '
                f'read in more than one way; say how: --time-format '
                f'{" or ".join(repr(forms[place]) for place in whole)}'
            )
        return forms[whole[0]]

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
            remedy = 'remove the signs between thousands'
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
                f'a step of {steps[worst]:.6g} s; import with '
                f'--resample {sample_interval(time):.4g}'
            )

    def place(self, row: int, name: str) -> str:
        """Return file, line and column of a cell, for a message."""
        return f'{self.path}, line {self.lines[row]}, column {name!r}'


def read_table(
    path: Path,
    *,
    encoding: str = 'utf-8',
    delimiter: str | None = None,
    decimal: str = '.',
    header: bool = True,
    rows: tuple[int, int] | None = None,
) -> CsvTable:
    """Read the rows of a CSV file.

    Lines that begin with # above the table are notes; the last of them names the columns where
    values follow at once.  Other lines above the names, which fill fewer cells, are passed over,
    and so are empty cells behind the last column.  A line without any value below the names holds
    units.

    Parameters
    ----------
    path : Path
        The file.
    encoding : str
        Its encoding.
    delimiter : str, optional
        Character between columns; found out if absent.
    decimal : {'.', ','}
        Decimal sign.
    header : bool
        Whether the first line names the columns; if not, they are called c1, c2 and so on.
    rows : (int, int), optional
        First and last row that are wanted, counted from 0 below the header.

    Raises
    ------
    CsvError
        If the file is missing, empty, no text, has no header or a single column, names a column
        twice, has rows of different length, or fewer than 8 rows are left.
    """
    names, numbers, cells = _read_rows(path, encoding, delimiter, header)
    begin, end = rows or (0, len(cells) - 1)
    units: dict[str, str] = {}
    if header and rows is None and len(cells) > 1 and _is_of_units(cells[0]):
        begin, units = 1, dict(zip(names, map(str.strip, cells[0]), strict=True))
    if end >= len(cells):
        raise CsvError(
            f'{path}: expected rows {begin} to {end} but the file has rows 0 to {len(cells) - 1}'
        )
    numbers, cells = numbers[begin : end + 1], cells[begin : end + 1]
    if len(cells) < SAMPLES_MIN:
        raise CsvError(f'{path}: expected at least {SAMPLES_MIN} rows but found {len(cells)}')
    return CsvTable(path, names, numbers, cells, decimal, begin, units)


def _read_rows(
    path: Path, encoding: str, delimiter: str | None, named: bool
) -> tuple[list[str], list[int], list[list[str]]]:
    """Return the names of the columns, and line number and cells of each row of a file."""
    lines = _read_text(path, encoding).splitlines(keepends=True)
    filled = [number for number, line in enumerate(lines) if line.strip()]
    told = _EXCEL.fullmatch(lines[filled[0]].strip()) if filled else None
    if told:
        delimiter = delimiter or told[1]
        lines[filled.pop(0)] = '\n'
    if not filled:
        raise CsvError(f'{path}: expected a header and rows but the file is empty')
    notes = list(itertools.takewhile(lambda number: lines[number].startswith('#'), filled[:-1]))
    first = filled[len(notes)]
    sample = [lines[number] for number in filled[-_SAMPLE:]]
    delimiter = delimiter or _delimiter_of(lines[first], sample)
    if notes and named and _is_row(_cells(lines[first], delimiter)):
        names = notes.pop()  # as `numpy.savetxt` marks them
        lines[names] = _MARK.sub('', lines[names])
    for number in notes:
        lines[number] = '\n'
    numbers, rows = _split(path, lines, delimiter)
    begin = _names_at(rows) if named else 0
    numbers, rows = numbers[begin:], _without_empty_ends(rows[begin:])
    _check_lengths(path, numbers, rows, delimiter)
    if len(rows[0]) < 2:
        signs = [sign for sign in '|: ' if sign in rows[0][0]]
        raise CsvError(
            f'{path}, line {numbers[0]}: expected columns but found one, {rows[0][0]!r:.60}; '
            f'name the separator with --delimiter{f" {signs[0]!r}" if signs else ""}'
        )
    if named:
        header = [' '.join(cell.split()) for cell in rows[0]]  # lines may be broken in a name
        _check_header(path, header, numbers[0])
        numbers, rows = numbers[1:], rows[1:]
    else:
        header = [f'c{place + 1}' for place in range(len(rows[0]))]
        if not any(map(_is_value, rows[0])):
            raise CsvError(
                f'{path}, line {numbers[0]}: expected values but found '
                f'{", ".join(rows[0][:4])}; where the first line names the columns, leave out '
                '--no-header'
            )
    return header, numbers, rows


def _delimiter_of(head: str, sample: Sequence[str]) -> str:
    """Return what stands between columns, from the first line and the last ones.

    A comma may be the decimal sign too: the others go first, if all lines are alike with them.
    """
    widths = {
        sign: Counter(len(_cells(line, sign)) for line in sample).most_common(1)[0][0]
        for sign in _DELIMITERS
    }
    found = [sign for sign in _DELIMITERS if widths[sign] > 1]
    alike = [sign for sign in found if len(_cells(head, sign)) == widths[sign]]
    likely = max(_DELIMITERS[::-1], key=head.count)
    return (alike or found or [likely])[0]


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; one if it is no CSV, which is refused where it is read."""
    try:
        return next(csv.reader([line], delimiter=delimiter))
    except csv.Error:
        return [line]


def _split(path: Path, lines: list[str], delimiter: str) -> tuple[list[int], list[list[str]]]:
    """Return line number and cells of each row that is not empty."""
    reader = csv.reader(lines, delimiter=delimiter)
    numbers: list[int] = []
    rows: list[list[str]] = []
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                numbers.append(reader.line_num)
                rows.append(cells)
    except csv.Error as error:
        raise CsvError(
            f'{path}, line {reader.line_num}: expected CSV but found {error}'
        ) from error
    if not rows:
        raise CsvError(f'{path}: expected a header and rows but the file is empty')
    return numbers, rows


def _names_at(rows: Sequence[Sequence[str]]) -> int:
    """Return the row that names the columns: the first of the fullest above the values."""
    said = [[cell for cell in cells if not _is_empty(cell)] for cells in rows[:_ABOVE]]
    above = list(
        itertools.takewhile(lambda cells: 2 * sum(map(_is_value, cells)) <= len(cells), said)
    )
    if len(above) == len(said):  # no row of values: the columns hold text
        return 0
    return max(range(len(above)), key=lambda at: len(above[at]), default=0)


def _without_empty_ends(rows: list[list[str]]) -> list[list[str]]:
    """Return rows without the empty cells that follow the last column in all of them."""
    longest = width = max(map(len, rows))
    while width > 1 and not any(
        cells[width - 1 : width] and cells[width - 1].strip() for cells in rows
    ):
        width -= 1
    return rows if width == longest else [cells[:width] for cells in rows]


def _check_lengths(path: Path, numbers: list[int], rows: list[list[str]], delimiter: str) -> None:
    """Refuse rows of another length than the first one."""
    expected = len(rows[0])
    odd = next((place for place, cells in enumerate(rows) if len(cells) != expected), None)
    if odd is None:
        return
    found, hint = len(rows[odd]), ''
    if found > expected and delimiter == ',':
        hint = (
            '; where the comma is the decimal sign too, export with ; between the columns and '
            'import with --decimal ,'
        )
    raise CsvError(
        f'{path}, line {numbers[odd]}: expected {expected} columns as in the header but found '
        f'{found}{hint}'
    )


def _check_header(path: Path, header: list[str], line: int) -> None:
    """Refuse a first line that holds a row, or names a column twice."""
    named = [name for name in header if name]
    if _is_row(named):
        raise CsvError(
            f'{path}, line {line}: expected the names of the columns but found '
            f'{", ".join(header[:4])}; add a line of names, or import with --no-header, which '
            f'calls the columns c1 to c{len(header)}'
        )
    repeated = repeated_names(named)
    if repeated:
        raise CsvError(
            f'{path}, line {line}: expected each column once but found '
            f'{", ".join(repr(name) for name in repeated)} more than once; rename them in the file'
        )


def _is_row(cells: Sequence[str]) -> bool:
    """Return whether cells hold values, some of them missing, and no names."""
    return all(_is_value(cell) or _is_empty(cell) for cell in cells)


def _is_of_units(cells: Sequence[str]) -> bool:
    """Return whether a row holds no value, but says something."""
    filled = [cell for cell in cells if not _is_empty(cell)]
    return bool(filled) and not any(map(_is_value, filled))


def _is_empty(cell: str) -> bool:
    """Return whether a cell says that nothing is there."""
    return cell.strip().lower() in _EMPTY


def _read_dates(cells: Sequence[str], form: str) -> list[datetime]:
    """Return the dates up to the first cell that has another form."""
    dates = []
    for cell in cells:
        try:
            dates.append(read_date(cell, form))
        except ValueError:
            break
    return dates


def _clock_seconds(dates: Sequence[datetime]) -> NDArray[np.float64]:
    """Return the seconds since 1970 that a clock shows, whatever its zone."""
    start = datetime(1970, 1, 1)
    return np.array([(date.replace(tzinfo=None) - start).total_seconds() for date in dates])


def _is_value(cell: str) -> bool:
    """Return whether a cell holds a number or a time."""
    return _is_number(cell) or bool(known_forms([cell]))


def _is_number(cell: str) -> bool:
    """Return whether a cell holds a number, with a point or a comma."""
    if '_' in cell:  # which Python takes for nothing between digits
        return False
    try:
        float(cell.strip().replace(',', '.'))
    except ValueError:
        return False
    return True


def _read_text(path: Path, encoding: str) -> str:
    """Return the text of a file without a byte order mark."""
    codec = codecs.lookup(encoding).name
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CsvError(os_sentence(error, path)) from error
    if data.startswith(_WORKBOOKS):
        raise CsvError(
            f'{path}: expected a CSV file but found a workbook; save its sheet as CSV (UTF-8)'
        )
    if not codec.startswith('utf') and not data.isascii() and is_utf8(data):
        raise CsvError(
            f'{path}: expected text in {encoding} but it is UTF-8; import without --encoding'
        )
    try:
        return decoded(data, encoding, remedy=_import_with)
    except ValueError as error:
        comma = ', ' if str(error).startswith('line') else ': '
        raise CsvError(f'{path}{comma}{error}') from error


def _import_with(likely: Sequence[str]) -> str:
    others = ', or else ' * (len(likely) > 1) + ' or '.join(likely[1:])
    return f'import with --encoding {likely[0]}{others}'


def read_sensor_table(
    path: Path, time_column: str
) -> tuple[tuple[str, ...], NDArray[np.float64], NDArray[np.float64], str]:
    """Read a table of a time column [s], or of dates, and one column per sensor [degC].

    Returns
    -------
    tuple
        Names of the sensors, times [s], temperatures [degC], shape (n, k), and the zone that dates
        without one were read in, empty if there are none.

    Raises
    ------
    BagError
        If it cannot be read; whatever else a table may need is an option of the command that makes
        a bag of it.
    """
    with options_as('`fuzzycnc import-csv --{}`'.format):
        table = read_table(path)
        table.require([time_column])
        sensors = tuple(name for name in table.header if name != time_column)
        if not sensors:
            raise BagError(f'{path}: expected a column for each sensor beside {time_column!r}')
        times = table.time(time_column, 's')
        start = times.date or 0.0 if times.form else float(table.column(time_column)[0])
        step = float(np.median(np.diff(times.seconds)))
        likely = 'days of a spreadsheet' if step < STEP_MIN else 'ms or us since 1970'
        if not times.form and (step < STEP_MIN or abs(start) > TIME_MAX):
            raise BagError(
                f'{path}, column {time_column!r}: expected seconds but found {start:.12g} and '
                f'steps of {step:.3g}, which look like {likely}; write seconds, or dates as text'
            )
        values = np.stack([table.column(name) for name in sensors], axis=1)
    return sensors, start + times.seconds, values, times.zone.name if times.zone else ''
