# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Marks on a sheet by which a photograph of it is measured: ArUco squares at known places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.studies.number_table import read_numbers
from fuzzycnc_ros.studies.requirement import require

COLUMNS = ('id', 'x_mm', 'y_mm', 'size_mm')
"""Columns of a file of marks: number of the mark, its middle and the length of its sides."""

MARK_MAX = 50
"""Marks of the dictionary DICT_4X4_50."""

LEAST = 3
"""Fewest marks that a photograph must show."""

_CELLS = 6


@dataclass(frozen=True)
class Mark:
    """A square mark, upright on the sheet.

    Parameters
    ----------
    number : int
        Which mark of the dictionary.
    middle : tuple of float
        Its middle [m].
    size : float
        Length of a side, black border included [m].
    """

    number: int
    middle: tuple[float, float]
    size: float

    def corners(self) -> Array:
        """Return its corners as OpenCV lists them: from the upper left one, clockwise, (4, 2)."""
        around = 0.5 * self.size * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
        return np.asarray(self.middle + around)


def marks_around(size: tuple[float, float], side: float = 10e-3) -> list[Mark]:
    """Return eight marks along the edges of a sheet [m]: at its corners and amid its sides."""
    low, (width, height) = 0.8 * side, size
    across, up = (low, 0.5 * width, width - low), (low, 0.5 * height, height - low)
    places = [(x, y) for y in up for x in across if (x, y) != (across[1], up[1])]
    return [Mark(number, place, side) for number, place in enumerate(places)]


def write_marks(marks: Sequence[Mark]) -> str:
    """Return marks as a CSV file."""
    rows = [
        ','.join([str(mark.number), *(f'{1e3 * v:.3f}' for v in (*mark.middle, mark.size))])
        for mark in marks
    ]
    return '\n'.join([','.join(COLUMNS), *rows, ''])


def read_marks(path: Path) -> list[Mark]:
    """Read a file of marks.

    Raises
    ------
    ValueError
        If it is none, or a mark is there twice or cannot be.
    """
    if not path.is_file():
        raise ValueError(f'{path}: expected a file of marks but found none')
    found = read_numbers(path, COLUMNS)
    marks: list[Mark] = []
    for line, (number, x, y, size) in zip(
        found.lines.tolist(), found.values.tolist(), strict=True
    ):
        known = {mark.number for mark in marks}
        if number != int(number) or not 0 <= number < MARK_MAX or int(number) in known:
            raise ValueError(
                f'{path}: line {line}: id: expected each mark of 0 to {MARK_MAX - 1} once but '
                f'found {number:g}'
            )
        if not size > 0.0:
            raise ValueError(
                f'{path}: line {line}: size_mm: expected more than 0 but found {size:g}'
            )
        marks.append(Mark(int(number), (1e-3 * x, 1e-3 * y), 1e-3 * size))
    if len(marks) < LEAST:
        raise ValueError(f'{path}: expected {LEAST} marks or more but found {len(marks)}')
    return marks


def dictionary() -> Any:
    """Return the marks as OpenCV has them."""
    cv2 = require('cv2')
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)


def mark_cells(mark: Mark) -> Array:
    """Return the cells of a mark from its upper left, shape (6, 6): 0 black, 1 white."""
    image = require('cv2').aruco.generateImageMarker(dictionary(), mark.number, _CELLS)
    return np.asarray(image > 127, float)


def printed_marks(marks: Sequence[Mark], size: tuple[float, float]) -> str:
    """Return a page with the marks at their places, to be printed at 100 %, as SVG."""
    width, height = 1e3 * size[0], 1e3 * size[1]
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">',
        f'<rect width="{width:g}" height="{height:g}" fill="none" stroke="black" '
        'stroke-width="0.2"/>',
    ]
    for mark in marks:
        cell = 1e3 * mark.size / _CELLS
        left, top = 1e3 * mark.corners()[0]
        lines += [
            f'<rect x="{left + column * cell:.4f}" y="{height - top + row * cell:.4f}" '
            f'width="{cell:.4f}" height="{cell:.4f}"/>'
            for row, column in np.argwhere(mark_cells(mark) == 0.0).tolist()
        ]
    return '\n'.join([*lines, '</svg>', ''])
