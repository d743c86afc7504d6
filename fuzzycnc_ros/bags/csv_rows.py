# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Header and rows of a CSV file: what stands between columns, which line names them."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from fuzzycnc_ros.bags.csv_mapping import CsvMapping
from fuzzycnc_ros.bags.csv_text import read_text
from fuzzycnc_ros.bags.csv_time import known_forms
from fuzzycnc_ros.bags.errors import CsvError
from fuzzycnc_ros.core.names import repeated_names

_DELIMITERS = (';', '\t', ',')
_EXCEL = re.compile(r'"?sep=(.)"?', re.IGNORECASE)  # it takes this line for an instruction

SAMPLE = 20
"""Last lines of a file that tell what stands between columns."""


def read_rows(path: Path, mapping: CsvMapping) -> tuple[list[str], list[int], list[list[str]]]:
    """Return the names of the columns, and line number and cells of each row of a file.

    Raises
    ------
    CsvError
        If the file is missing, empty, no text, has no header or a single column, names a column
        twice, or has rows of different length.
    """
    lines = read_text(path, mapping.encoding).splitlines(keepends=True)
    delimiter = mapping.delimiter
    filled = [number for number, line in enumerate(lines) if line.strip()]
    told = _EXCEL.fullmatch(lines[filled[0]].strip()) if filled else None
    if told:
        delimiter = delimiter or told[1]
        lines[filled.pop(0)] = '\n'
    if not filled:
        raise CsvError(f'{path}: expected a header and rows but the file is empty')
    sample = [lines[number] for number in filled[-SAMPLE:]]
    delimiter = delimiter or _delimiter_of(lines[filled[0]], sample)
    numbers, rows = _split(path, lines, delimiter)
    _check_lengths(path, numbers, rows, delimiter)
    if len(rows[0]) < 2:
        signs = [sign for sign in '|: ' if sign in rows[0][0]]
        raise CsvError(
            f'{path}, line {numbers[0]}: expected columns but found one, {rows[0][0]!r:.60}; name '
            f'what stands between them with --delimiter{f" {signs[0]!r}" if signs else ""}'
        )
    if mapping.header:
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
        sign: Counter(_width(line, sign) for line in sample).most_common(1)[0][0]
        for sign in _DELIMITERS
    }
    found = [sign for sign in _DELIMITERS if widths[sign] > 1]
    alike = [sign for sign in found if _width(head, sign) == widths[sign]]
    likely = max(_DELIMITERS[::-1], key=head.count)
    return (alike or found or [likely])[0]


def _width(line: str, delimiter: str) -> int:
    """Return how many columns a line has; 1 if it is no CSV, which is refused where it is read."""
    try:
        return len(next(csv.reader([line], delimiter=delimiter)))
    except csv.Error:
        return 1


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
    usual = Counter(map(len, rows[-SAMPLE:])).most_common(1)[0][0]
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
    if all(map(_is_value, named)):
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


def _is_value(cell: str) -> bool:
    """Return whether a cell holds a number or a time."""
    return is_number(cell) or bool(known_forms([cell]))


def is_number(cell: str) -> bool:
    """Return whether a cell holds a number, with a point or a comma."""
    try:
        float(cell.strip().replace(',', '.'))
    except ValueError:
        return False
    return True
