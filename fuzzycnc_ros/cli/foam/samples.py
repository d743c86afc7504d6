# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Samples of feed compensation from CSV files and bags, for `fuzzycnc foam train`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fuzzycnc_ros.cli.models.number_table import read_numbers
from fuzzycnc_ros.core.deformation.features import check_process_values
from fuzzycnc_ros.core.deformation.samples import joined_groups, samples_of_paths
from fuzzycnc_ros.core.deformation.training import equal_rows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fuzzycnc_ros.core.arrays import Array

COLUMNS = ('direction_deg', 'depth_mm', 'type', 'step_mm', 'thickness_mm', 's_x_mm', 's_y_mm')
"""Columns of a CSV file: process values, and the offset needed per 50 mm of feed."""

POSSIBLE = {'depth_mm': (0.1, 200.0), 'step_mm': (0.1, 100.0), 'thickness_mm': (0.3, 500.0)}
"""Lengths that a foot, a stitch and a soft sheet can have [mm]."""
NEEDED = (0.05, 50.0)
"""Largest compensations that are likely: less than a stitch can be placed, more than the feed."""

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
    found = read_numbers(path, COLUMNS, label=SHEET)
    table = found.values
    _check_units(path, table)
    for number, row in zip(found.lines.tolist(), table[:, :5], strict=True):
        try:
            check_process_values(row[np.newaxis])
        except ValueError as error:
            reason = str(error).removeprefix('x, row 0: ')
            raise ValueError(f'{path}: line {number}: {reason}') from error
    if found.labels is None:
        groups, how = equal_rows(table[:, :5]), 'equal process'
    else:
        _, groups = np.unique(found.labels, return_inverse=True)
        how = 'one sheet'
    said = f'{path}: {len(table)} samples in {len(np.unique(groups))} groups of {how}'
    return Samples(table[:, :5], table[:, 5:], groups, (said, *_doubts(table[:, 5:])))


def _check_units(path: Path, table: Array) -> None:
    """Refuse lengths that no soft sheet has in millimetres.

    Raises
    ------
    ValueError
        If all values of a column lie beyond what can be; the text names it and the likely unit.
    """
    for name, (low, high) in POSSIBLE.items():
        values = table[:, COLUMNS.index(name)]
        unit, remedy = '', ''
        if 0.0 < values.max() < low:
            unit, remedy = 'metres', 'multiply by 1000'
        elif values.min() > high:
            unit, remedy = 'micrometres', 'divide by 1000'
        if unit:
            raise ValueError(
                f'{path}: {name}: expected millimetres but found {values.min():g} to '
                f'{values.max():g}, which look like {unit}; {remedy}'
            )


def _doubts(needed: Array) -> list[str]:
    """Return what is strange about compensations, though it can be."""
    names, largest = ' and '.join(COLUMNS[5:]), float(np.abs(needed).max(initial=0.0))
    if 0.0 < largest < NEEDED[0]:
        return [f'note: {names} are {largest:g} at most; multiply by 1000 if they are metres']
    if largest > NEEDED[1]:
        return [
            f'note: {names} are up to {largest:g} mm per 50 mm of feed; divide by 1000 if they '
            'are micrometres'
        ]
    return []


def _read_bags(bags: Sequence[Path]) -> Samples:
    from fuzzycnc_ros.cli.foam.records import read_recordings

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
