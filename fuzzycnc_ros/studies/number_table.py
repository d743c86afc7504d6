# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""CSV files whose columns are numbers, found by the names in their header."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.encodings import decoded


@dataclass(frozen=True, eq=False)
class NumberTable:
    """The rows of a CSV file; empty lines are left out.

    Attributes
    ----------
    values : ndarray, shape (rows, columns)
        Finite numbers, in the order of the columns asked for.
    lines : ndarray of int, shape (rows,)
        Their lines in the file, from 1.
    labels : tuple of str or None
        Cells of the column of labels; None if the file has none.
    columns : tuple of str
        What the columns are: those asked for, then the optional ones that the file has.
    """

    values: Array
    lines: NDArray[np.int64]
    labels: tuple[str, ...] | None
    columns: tuple[str, ...]


def table_cells(path: Path, columns: Sequence[str]) -> tuple[list[str], dict[int, list[str]]]:
    """Return the header of a CSV file, and the cells of its rows by line; empty ones are left out.

    Raises
    ------
    ValueError
        If it is no text, a column is missing, or a cell is longer than any number or name; without
        the file's name.
    """
    try:
        lines = list(csv.reader(decoded(path.read_bytes()).splitlines()))
    except csv.Error as error:
        raise ValueError(f'expected a CSV file as text: {error}') from error
    header = [name.strip() for name in lines[0]] if lines else []
    missing = [name for name in columns if name not in header]
    if missing:
        hint = ''.join(
            f'; the cells are parted by {name}, write commas'
            for mark, name in ((';', 'semicolons'), ('\t', 'tabs'))
            if lines and mark in lines[0][0]
        )
        raise ValueError(
            f'line 1: expected the columns {",".join(columns)} but found no {", ".join(missing)}'
            f'{hint}'
        )
    rows = {
        number: cells
        for number, cells in enumerate(lines[1:], start=2)
        if any(cell.strip() for cell in cells)
    }
    return header, rows


def read_numbers(
    path: Path, columns: Sequence[str], label: str = '', optional: Sequence[str] = ()
) -> NumberTable:
    """Read columns of numbers, further ones that the file may have, and a column of labels.

    Raises
    ------
    ValueError
        If a column is missing, a cell is no finite number or there is no row; the message names
        the file and the line.
    """
    try:
        header, cells_of_line = table_cells(path, columns)
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error
    columns = (*columns, *(name for name in optional if name in header))
    places = [header.index(name) for name in columns]
    labelled = header.index(label) if label and label in header else None
    rows, labels = [], []
    for number, cells in cells_of_line.items():
        try:
            row = [float(cells[place]) for place in places]
        except (IndexError, ValueError):
            row = []
        if not row or not all(map(isfinite, row)):
            raise ValueError(
                f'{path}: line {number}: expected {len(columns)} finite numbers but found '
                f'{",".join(cells)!r}'
            )
        rows.append(row)
        if labelled is not None:
            labels.append(cells[labelled].strip() if labelled < len(cells) else '')
    if not rows:
        raise ValueError(f'{path}: expected rows below the header but found none')
    numbers = np.array(list(cells_of_line))
    found = None if labelled is None else tuple(labels)
    return NumberTable(np.array(rows), numbers, found, columns)
