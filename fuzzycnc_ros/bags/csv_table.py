# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading a CSV recording, whatever program wrote it; every complaint names file, line and column.

From the bytes of a file to its text, from the text to header and rows, from the cells to numbers,
dates and times of day.
"""

import codecs
import csv
import itertools
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.errors import CsvError
from fuzzycnc_ros.bags.os_errors import os_sentence
from fuzzycnc_ros.core.names import repeated_names
from fuzzycnc_ros.core.thermal.run import JITTER_MAX, SAMPLES_MIN
from fuzzycnc_ros.core.thermal.spacing import sample_interval

DAY = 86400.0
"""Length of a day [s]."""

TIME_UNITS = {'s': 1.0, 'ms': 1e-3, 'min': 60.0, 'h': 3600.0, 'd': DAY}

ISO8601 = 'iso8601'
_CLOCKS = ('%H:%M:%S', '%H:%M', '%I:%M:%S %p', '%I:%M %p')
_DATES = ('%d.%m.%Y', '%d.%m.%y', '%Y/%m/%d', '%Y.%m.%d')
_EITHER = ('%d/%m/%Y', '%m/%d/%Y', '%d/%m/%y', '%m/%d/%y', '%d-%m-%Y', '%m-%d-%Y')
KNOWN_FORMATS = (
    ISO8601,
    *(f'{date} {clock}' for date in (*_DATES, *_EITHER) for clock in _CLOCKS[:2]),
    # Who writes AM and PM writes the month first.
    *(f'{date} {clock}' for date in (*_DATES, *_EITHER[::-1]) for clock in _CLOCKS[2:]),
    *_CLOCKS,
)
"""Forms that are recognised, as `strptime` writes them."""

_FRACTION = re.compile(r'(?<=:\d\d)[.,](\d+)')
_DATE_PART = re.compile(r'%[dmyYjbBDFxcUWGuw]')


_TOKEN = re.compile(r'yyyy|jjjj|yy|jj|dd|tt|hh?|mm|ss|am/pm', re.IGNORECASE)
_DIRECTIVES = {
    **dict.fromkeys(('yyyy', 'jjjj'), '%Y'),
    **dict.fromkeys(('yy', 'jj'), '%y'),
    **dict.fromkeys(('dd', 'tt'), '%d'),
    'ss': '%S',
    'am/pm': '%p',
}

_ENCODINGS = ('cp1252', 'latin-1', 'utf-16')
"""What programs write that do not write UTF-8, Excel on Windows first."""

_WORKBOOKS = (b'PK\x03\x04', b'\xd0\xcf\x11\xe0')
_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_WIDE = ('utf-16', 'utf-32')  # encodings with zero bytes in plain text

_DELIMITERS = (';', '\t', ',')
_EXCEL = re.compile(r'"?sep=(.)"?', re.IGNORECASE)  # it takes this line for an instruction

_MARK = re.compile(r'#+ *(?=\w)')
"""Mark of a comment before a name; a column may be called # itself."""

_SAMPLE = 20
"""Last lines of a file that tell what stands between columns."""

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
        if row == 0 and self.first == 0 and _is_of_units(self.rows[0]):
            last = self.first + len(self.rows) - 1
            return f'; leave out a line of units below the header with --rows 1:{last}'
        if _is_day(found):
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
            misfit = None if lost else _first_misfit(cells, form)
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
            raise CsvError(
                f'{self.place(lost[0], name)}: expected a time but found none'
                + self._hint(lost[0], '')
            )
        if form and not _has_date(form):
            seconds, midnights = _past_midnight(seconds)
        self._check_increasing(name, seconds)
        date = float(seconds[0]) if form and _has_date(form) else None
        return Times(seconds - seconds[0], date, form, midnights)

    def _form(self, name: str, cells: list[str]) -> str:
        """Return the form of dates or times of day; empty for numbers."""
        first = next((cell for cell in cells if cell.strip().lower() not in _EMPTY), '')
        if not first or _is_number(first):
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
        ends = [_first_misfit(known, form) for form in forms]
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
) -> Table:
    """Read the rows of a CSV file.

    Lines that begin with # above the table are notes; the last of them names the columns where
    values follow at once.  A line without any value below the names holds units.

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
    return Table(path, names, numbers, cells, decimal, begin, units)


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
    _check_lengths(path, numbers, rows, delimiter)
    if len(rows[0]) < 2:
        signs = [sign for sign in '|: ' if sign in rows[0][0]]
        raise CsvError(
            f'{path}, line {numbers[0]}: expected columns but found one, {rows[0][0]!r:.60}; name '
            f'what stands between them with --delimiter{f" {signs[0]!r}" if signs else ""}'
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


def _check_lengths(path: Path, numbers: list[int], rows: list[list[str]], delimiter: str) -> None:
    """Refuse rows of another length than the first one."""
    expected = len(rows[0])
    odd = next((place for place, cells in enumerate(rows) if len(cells) != expected), None)
    if odd is None:
        return
    usual = Counter(map(len, rows[-_SAMPLE:])).most_common(1)[0][0]
    begin = next(place for place, cells in enumerate(rows) if len(cells) == usual)
    if begin > 1 or (begin == 1 and expected == 1):
        raise CsvError(
            f'{path}, line {numbers[0]}: expected {usual} columns, as from line {numbers[begin]} '
            f'on, but found {delimiter.join(rows[0])!r:.60}; delete what stands above the names '
            'of the columns'
        )
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
    return all(_is_value(cell) or cell.strip().lower() in _EMPTY for cell in cells)


def _is_of_units(cells: Sequence[str]) -> bool:
    """Return whether a row holds no value, but says something."""
    filled = [cell for cell in cells if cell.strip().lower() not in _EMPTY]
    return bool(filled) and not any(map(_is_value, filled))


def _is_value(cell: str) -> bool:
    """Return whether a cell holds a number or a time."""
    return _is_number(cell) or bool(known_forms([cell]))


def _is_number(cell: str) -> bool:
    """Return whether a cell holds a number, with a point or a comma."""
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
    if (data.startswith(_UTF16_MARKS) or b'\0' in data) and not codec.startswith(_WIDE):
        raise CsvError(
            f'{path}: expected text in {encoding} but found what looks like UTF-16; import with '
            '--encoding utf-16'
        )
    if not codec.startswith('utf') and not data.isascii() and _is_utf8(data):
        raise CsvError(
            f'{path}: expected text in {encoding} but it is UTF-8; import without --encoding'
        )
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        line = data.count(b'\n', 0, error.start) + 1
        byte = data[error.start : error.start + 1]
        others = [name for name in _ENCODINGS if name != encoding]
        raise CsvError(
            f'{path}, line {line}: expected text in {encoding} but byte {error.start} is '
            f'0x{byte.hex()}, in cp1252 {byte.decode("cp1252", "replace")!r}; import with '
            f'--encoding {others[0]}, or else {" or ".join(others[1:])}'
        ) from error
    except UnicodeError as error:
        raise CsvError(f'{path}: expected text in {encoding} but found {error}') from error
    return text.removeprefix('\ufeff')


def _is_utf8(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


def strptime_form(text: str) -> str:
    """Return a form as `strptime` writes it, from that or from what spreadsheets call it.

    Raises
    ------
    ValueError
        If it is neither.

    Examples
    --------
    >>> strptime_form('dd.mm.yyyy hh:mm:ss'), strptime_form('TT.MM.JJJJ hh:mm')
    ('%d.%m.%Y %H:%M:%S', '%d.%m.%Y %H:%M')
    """
    if text == ISO8601:
        return text
    form = text if '%' in text else _from_spreadsheet(text)
    if '%' not in form or not _is_form(form):
        raise ValueError(
            'expected a form such as %d.%m.%Y %H:%M:%S, dd.mm.yyyy hh:mm:ss or iso8601 but '
            f'found {text!r}'
        )
    return form


def _is_form(form: str) -> bool:
    try:
        datetime.strptime('', form)
    except ValueError as error:
        return re.search('bad directive|stray', str(error)) is None
    return True


def _from_spreadsheet(text: str) -> str:
    hour = '%I' if re.search('am/pm', text, re.IGNORECASE) else '%H'
    names = [token.lower() for token in _TOKEN.findall(text)]
    places = iter(range(len(names)))

    def directive(_: re.Match[str]) -> str:
        place = next(places)
        name = names[place]
        if name == 'mm':  # minutes behind an hour or before a second, months else
            near = (names[place - 1 : place], names[place + 1 : place + 2])
            return '%M' if near[0] in (['h'], ['hh']) or near[1] == ['ss'] else '%m'
        return hour if name in ('h', 'hh') else _DIRECTIVES[name]

    return _TOKEN.sub(directive, text)


def _has_date(form: str) -> bool:
    """Return whether a form says the day."""
    return form == ISO8601 or _DATE_PART.search(form) is not None


def read_time(text: str, form: str) -> float:
    """Return the seconds of a date since 1970, or of a time of day since midnight.

    A zone that the text does not name is UTC.  A fraction of a second may stand behind a point
    or a comma.

    Raises
    ------
    ValueError
        If the text has another form.
    """
    text = text.strip()
    if form == ISO8601:
        # Python 3.10 does not know the Z of ISO 8601.
        date = datetime.fromisoformat(f'{text[:-1]}+00:00' if text.endswith('Z') else text)
        return _seconds(date)
    fraction = 0.0
    if '%f' not in form:
        found = _FRACTION.search(text)
        if found:
            fraction = float(f'0.{found[1]}')
            text = text[: found.start()] + text[found.end() :]
    date = datetime.strptime(text, form)
    if not _has_date(form):
        date = date.replace(year=1970, month=1, day=1)
    return _seconds(date) + fraction


def known_forms(cells: Sequence[str]) -> list[str]:
    """Return the known forms that all of some texts have; none if there is no text."""
    return [form for form in KNOWN_FORMATS if cells and all(_has(cell, form) for cell in cells)]


def _is_day(text: str) -> bool:
    """Return whether a text is a date in a known form, without a time of day."""
    return any(_has(text, form) for form in (*_DATES, *_EITHER))


def _first_misfit(cells: Sequence[str], form: str) -> int | None:
    """Return the number of the first text that has another form."""
    return next((row for row, cell in enumerate(cells) if not _has(cell, form)), None)


def _past_midnight(seconds: NDArray[np.float64]) -> tuple[NDArray[np.float64], list[int]]:
    """Return times of day with a day more after each midnight, and the rows that follow one.

    Midnight lies where the clock goes back by more than half a day; by less, it was set.
    """
    rows = np.flatnonzero(np.diff(seconds) < -0.5 * DAY) + 1
    days = np.zeros(len(seconds))
    days[rows] = 1.0
    return seconds + DAY * np.cumsum(days), rows.tolist()


def _has(text: str, form: str) -> bool:
    try:
        read_time(text, form)
    except ValueError:
        return False
    return True


def _seconds(date: datetime) -> float:
    zoned = date if date.tzinfo is not None else date.replace(tzinfo=timezone.utc)
    return zoned.timestamp()
