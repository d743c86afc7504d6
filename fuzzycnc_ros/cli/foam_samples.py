# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of feed compensation from CSV files and bags, for `fuzzycnc foam train`."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fuzzycnc_ros.core.deformation.features import check_process_values
from fuzzycnc_ros.core.deformation.samples import joined_groups, samples_of_paths
from fuzzycnc_ros.core.deformation.training import equal_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fuzzycnc_ros.core.arrays import Array

COLUMNS = ('direction_deg', 'depth_mm', 'type', 'step_mm', 'thickness_mm', 's_x_mm', 's_y_mm')
"""Columns of a CSV file: process values, and the offset needed per 50 mm of feed."""

SHEET = 'sheet'
"""Optional column: what sheet a sample is from."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples and what is to be said of them.

    Attributes
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    s : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    groups : ndarray of int, shape (k,)
        Samples that must not be torn apart between training and judgement.
    lines : tuple of str
        Where they are from, and what was left out.
    """

    x: Array
    s: Array
    groups: NDArray[np.int64]
    lines: tuple[str, ...]


def read_samples(sources: Sequence[Path]) -> Samples:
    """Read samples from one CSV file, or from bags.

    Raises
    ------
    BagError
        If a bag cannot be read or lacks a topic.
    ValueError
        If there is no such file, both kinds are mixed, or it holds no sample that can be used.
    """
    for source in sources:
        if not source.exists():
            raise ValueError(f'{source}: expected a bag or a .csv but nothing is there')
    tables = [source for source in sources if source.suffix.lower() == '.csv']
    if tables and len(sources) > 1:
        raise ValueError(
            f'{tables[0]}: expected one .csv alone, or bags, but found both or several'
        )
    return _read_csv(tables[0]) if tables else _read_bags(sources)


def _read_csv(path: Path) -> Samples:
    try:
        text = path.read_text(encoding='utf-8-sig')
    except UnicodeDecodeError as error:
        raise ValueError(f'{path}: expected a CSV file as text: {error}') from error
    lines = csv.reader(text.splitlines())
    header = [name.strip() for name in next(lines, [])]
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise ValueError(
            f'{path}: line 1: expected the columns {",".join(COLUMNS)} but found no '
            f'{", ".join(missing)}'
        )
    places = [header.index(name) for name in COLUMNS]
    sheet = header.index(SHEET) if SHEET in header else None
    rows, sheets, numbers = [], [], []
    for number, cells in enumerate(lines, start=2):
        if not any(cell.strip() for cell in cells):
            continue
        try:
            row = [float(cells[place]) for place in places]
        except (IndexError, ValueError):
            row = []
        if not row or not all(map(isfinite, row)):
            raise ValueError(
                f'{path}: line {number}: expected {len(COLUMNS)} finite numbers but found '
                f'{",".join(cells)!r}'
            )
        rows.append(row)
        numbers.append(number)
        sheets.append(cells[sheet].strip() if sheet is not None and sheet < len(cells) else '')
    if not rows:
        raise ValueError(f'{path}: expected rows below the header but found none')
    table = np.array(rows)
    for number, row in zip(numbers, table[:, :5], strict=True):
        try:
            check_process_values(row[np.newaxis])
        except ValueError as error:
            reason = str(error).removeprefix('x, row 0: ')
            raise ValueError(f'{path}: line {number}: {reason}') from error
    if sheet is None:
        groups, how = equal_rows(table[:, :5]), 'equal process'
    else:
        _, groups = np.unique(sheets, return_inverse=True)
        how = 'one sheet'
    said = f'{path}: {len(table)} samples in {len(np.unique(groups))} groups of {how}'
    return Samples(table[:, :5], table[:, 5:], groups, (said,))


def _read_bags(bags: Sequence[Path]) -> Samples:
    from fuzzycnc_ros.cli.foam_records import read_recordings

    recordings = read_recordings(bags)
    found = samples_of_paths(recordings.paths)
    left_out = Counter(recordings.left_out) + Counter(found.left_out)
    if not len(found.x):
        raise ValueError(
            f'{bags[0]}: expected primitives that give samples but found none: '
            f'{", ".join(left_out)}'
        )
    groups = joined_groups(equal_rows(found.x), found.path)
    fresh = len(found.x) - found.relaxed
    lines = [
        f'{len(recordings.paths)} recorded paths: {fresh} samples from fresh starts, '
        f'{found.relaxed} by the fading of the drift, in {len(np.unique(groups))} groups of one '
        'path or equal process'
    ]
    lines += [f'left out: {count} {reason}' for reason, count in sorted(left_out.items())]
    return Samples(found.x, found.s, groups, tuple(lines))
