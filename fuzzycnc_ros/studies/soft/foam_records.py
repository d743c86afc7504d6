# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded paths on soft material from bags, and samples of feed compensation, also from CSV."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.core.arrays import check_matrix
from fuzzycnc_ros.core.deformation.features import (
    PROCESS_VALUES,
    check_process_values,
    folded_samples,
)
from fuzzycnc_ros.core.deformation.samples import RecordedPath, joined_groups, samples_of_paths
from fuzzycnc_ros.core.deformation.stitch_path import ARC, LINE, SheetMaterial
from fuzzycnc_ros.core.deformation.training import equal_rows
from fuzzycnc_ros.runtime.enums import PrimitiveKind
from fuzzycnc_ros.studies.number_table import read_numbers

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from fuzzycnc_ros.core.arrays import Array
    from fuzzycnc_ros.runtime.records import CompensatedPath, Material, StitchedPath


SECOND = 1e9


@dataclass
class StitchRecordings:
    """Paths in bags, and their stitches.

    Attributes
    ----------
    paths : list of RecordedPath
        Paths with all their stitches, in the order of the recordings.
    left_out : Counter
        Why others were left out, and how many.
    """

    paths: list[RecordedPath] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)


def read_recordings(bags: Sequence[Path]) -> StitchRecordings:
    """Read the stitched paths of bags.

    Raises
    ------
    BagError
        If a bag cannot be read or lacks a topic.
    ValueError
        If a record contradicts itself, or no path was stitched to its end.
    """
    found = StitchRecordings()
    for bag in bags:
        before = len(found.paths)
        _read_bag(bag, found)
        if len(found.paths) == before:
            reasons = ', '.join(found.left_out) or 'the bag has no stitched path'
            raise ValueError(
                f'{bag}: expected a path that was stitched to its end but found none: {reasons}'
            )
    return found


def _read_bag(bag: Path, found: StitchRecordings) -> None:
    from fuzzycnc_ros.bags.reader import BagReader
    from fuzzycnc_ros.bags.runs import find_topic
    from fuzzycnc_ros.runtime.convert import decode
    from fuzzycnc_ros.runtime.records import CompensatedPath, Material, StitchedPath

    with BagReader(bag) as reader:
        topic = find_topic(reader, 'compensated_path', CompensatedPath.TYPE)
        space = topic.removesuffix('compensated_path')
        kinds: dict[str, Any] = {topic: CompensatedPath, f'{space}stitched_path': StitchedPath}
        reader.require({name: kind.TYPE for name, kind in kinds.items()})
        material = f'{space}material'
        if material in reader.connections:
            reader.require({material: Material.TYPE})
            kinds[material] = Material
        seen = [
            decode(kinds[message.topic], message.message)
            for message in reader.messages(list(kinds))
        ]
    # A path causes its stitches, and at one stamp the sheet is there before the path.
    order = {Material: 0, CompensatedPath: 1, StitchedPath: 2}
    seen.sort(key=lambda record: (record.stamp, order[type(record)]))
    sheets: dict[str, Material] = {}
    commanded: dict[str, CompensatedPath] = {}
    for record in seen:
        if isinstance(record, Material):
            sheets[record.name] = record
        elif isinstance(record, CompensatedPath):
            commanded[record.path_id] = record
        elif record.path_id not in commanded:
            found.left_out['stitches of a path that was not recorded'] += 1
        else:
            path = commanded[record.path_id]
            _add(found, bag, path, record, sheets.get(path.material))


def _add(
    found: StitchRecordings,
    bag: Path,
    path: CompensatedPath,
    stitches: StitchedPath,
    sheet: Material | None,
) -> None:
    """Add a path with its stitches."""
    from fuzzycnc_ros.components.soft.compensated_paths import stitch_runs

    where = f'{bag}: {path.path_id} at {path.stamp / SECOND:.3f} s'
    steps = len(path.depth)
    for name, wanted in (
        ('nominal', 2 * steps + 2),
        ('offset', 2 * steps + 2),
        *((name, steps) for name in ('primitive', 'kind', 'turn', 'step')),
    ):
        if len(getattr(path, name)) != wanted:
            raise ValueError(
                f'{where}: {name}: expected {wanted} values for {steps} steps but found '
                f'{len(getattr(path, name))}'
            )
    if len(stitches.stitched) != 2 * steps + 2:
        found.left_out['paths that were not stitched to their end'] += 1
        return
    runs = stitch_runs(path.kind)
    if not runs:
        found.left_out['paths without a stitch'] += 1
        return
    at = np.concatenate(runs)
    leading = at[1:] - 1
    points = tuple(
        _points(values)[at] for values in (path.nominal, path.offset, stitches.stitched)
    )
    if not all(np.isfinite(values).all() for values in (*points, path.depth, path.step)):
        found.left_out['paths with points that are not finite'] += 1
        return
    fits = sheet is not None and abs(sheet.thickness - path.thickness) < 1e-9
    size = sheet.size.tolist() if sheet is not None and fits else []
    try:
        material = SheetMaterial(
            path.thickness, (size[0], size[1]) if len(size) == 2 else None, path.material
        )
    except ValueError as error:
        raise ValueError(f'{where}: {error}') from error
    jump = np.isin(path.kind, (PrimitiveKind.JUMP, PrimitiveKind.TRIM))[leading]
    primitive = path.primitive[leading].astype(np.int64)
    primitive[jump] = primitive[np.flatnonzero(jump) + 1]  # a side begins where it leads to
    found.paths.append(
        RecordedPath(
            path_id=path.path_id,
            material=material,
            nominal=points[0],
            offset=points[1],
            stitched=points[2],
            primitive=primitive,
            kind=np.where(path.kind == PrimitiveKind.ARC, float(ARC), float(LINE))[leading],
            turn=path.turn[leading],
            depth=path.depth[leading],
            step=path.step[leading],
            source=where,
            jump=jump,
        )
    )


CLOSEST, FARTHEST = 1e-4, 0.1
"""Spacing of stitches that is likely [m]."""
APART = 0.05
"""Largest likely distance of a stitch from its commanded place [m]."""


def recorded_run(
    commanded: Array,
    stitched: Array,
    offset: Array,
    *,
    path_id: str,
    material: SheetMaterial,
    source: str,
    places: Sequence[str],
    jump: NDArray[np.bool_] | None = None,
) -> RecordedPath:
    """Return a run of a track from its points, shape (n + 1, 2) [m].

    Parameters
    ----------
    commanded, stitched, offset : ndarray, shape (n + 1, 2)
        Commanded points with their offsets, where the stitches lie, and the offsets [m].
    path_id : str
        Name of the track.
    material : SheetMaterial
        The sheet.
    source : str
        Where the run is from, for messages.
    places : sequence of str
        Where each point is from.
    jump : ndarray of bool, shape (n + 1,), optional
        Points to which no stitch leads: each begins a side of its own.

    Raises
    ------
    ValueError
        If there are no two points, or they do not lie as stitches do.
    """
    if len(commanded) < 2:
        raise ValueError(f'{source}: expected two points or more but found {len(commanded)}')
    apart = np.hypot(*(stitched - commanded).T)
    if apart.max() > APART:
        raise ValueError(
            f'{source}: {places[int(apart.argmax())]}: expected a stitch within '
            f'{1e3 * APART:g} mm of its place but found it {1e3 * apart.max():.4g} mm away; '
            'compare units and origin of both'
        )
    spacing = float(np.median(np.hypot(*np.diff(commanded, axis=0).T)))
    if not CLOSEST < spacing < FARTHEST:
        raise ValueError(
            f'{source}: expected stitches {1e3 * CLOSEST:g} to {1e3 * FARTHEST:g} mm apart but '
            f'found them {1e3 * spacing:.3g} mm apart; are lengths millimetres, or metres?'
        )
    steps = len(commanded) - 1
    return RecordedPath(
        path_id=path_id,
        material=material,
        nominal=commanded - offset,
        offset=offset,
        stitched=stitched,
        primitive=np.zeros(steps, np.int64) if jump is None else np.cumsum(jump[1:]),
        kind=np.full(steps, float(LINE)),
        turn=np.zeros(steps),
        depth=np.zeros(steps),
        step=np.zeros(steps),
        source=source,
        jump=None if jump is None else jump[1:],
    )


def _points(values: Array) -> Array:
    return np.asarray(values, dtype=np.float64).reshape(-1, 2)


COLUMNS = ('direction_deg', 'depth_mm', 'type', 'step_mm', 'thickness_mm', 's_x_mm', 's_y_mm')
"""Columns of a CSV file: process values, and the offset needed per 50 mm of feed."""

POSSIBLE = {'depth_mm': (0.1, 200.0), 'step_mm': (0.1, 100.0), 'thickness_mm': (0.3, 500.0)}
"""Lengths that a foot, a stitch and a soft sheet can have [mm]."""
STEP_LIKELY = 0.4
"""Stitch step [mm] that the largest one is likely to reach."""
NEEDED = (0.05, 50.0)
"""Largest compensations that are likely: less than a stitch can be placed, more than the feed."""

SHEET = 'sheet'
"""Optional column: what sheet a sample is from."""


NAMED = 10
"""Outliers that are named one by one."""


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
    where : tuple of str
        Where each one is from.
    """

    x: Array
    s: Array
    groups: NDArray[np.int64]
    lines: tuple[str, ...]
    where: tuple[str, ...]


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


def array_samples(x: ArrayLike, s: ArrayLike, groups: ArrayLike | None = None) -> Samples:
    """Return samples of arrays, checked like those of a file.

    Parameters
    ----------
    x : array_like, shape (k, 5)
        Process values: direction [deg], feed depth [mm], type (1 arc, 2 line), stitch step [mm],
        thickness [mm].
    s : array_like, shape (k, 2)
        Compensations along X and Y [mm per 50 mm of feed].
    groups : array_like, shape (k,), optional
        Sheet of each sample; equal processes belong together without it.

    Raises
    ------
    ValueError
        If shapes differ, a value is not finite or none of a primitive, or the lengths are not in
        millimetres.
    """
    rows, needed = np.asarray(x, float), check_matrix(s, 's')
    if rows.ndim == 2 and rows.shape[1] == len(PROCESS_VALUES) and rows.size:
        _check_units('x', rows)
    rows = check_process_values(rows)
    labels = None if groups is None else np.asarray(groups)
    if needed.shape != (len(rows), 2) or (labels is not None and labels.shape != (len(rows),)):
        found = '' if labels is None else f' and groups of {labels.shape}'
        raise ValueError(
            f's, groups: expected two compensations and one group for each of {len(rows)} rows '
            f'of x but found s of {needed.shape}{found}'
        )
    rows, needed = folded_samples(rows, needed)
    group = equal_rows(rows) if labels is None else np.unique(labels, return_inverse=True)[1]
    where = tuple(f'row {number}' for number in range(len(rows)))
    return Samples(rows, needed, group, tuple(_doubts(rows, needed)), where)


def _read_csv(path: Path) -> Samples:
    found = read_numbers(path, COLUMNS, label=SHEET)
    table = found.values
    _check_units(str(path), table)
    for number, row in zip(found.lines.tolist(), table[:, :5], strict=True):
        try:
            check_process_values(row[np.newaxis])
        except ValueError as error:
            reason = str(error).removeprefix('x, row 0: ')
            raise ValueError(f'{path}: line {number}: {reason}') from error
    x, s = folded_samples(table[:, :5], table[:, 5:])
    if found.labels is None:
        groups, how = equal_rows(x), 'equal process'
    else:
        _, groups = np.unique(found.labels, return_inverse=True)
        how = 'one sheet'
    said = f'{path}: {len(table)} samples in {len(np.unique(groups))} groups of {how}'
    where = tuple(f'line {number}' for number in found.lines)
    return Samples(x, s, groups, (said, *_doubts(x, s)), where)


def _check_units(where: str, table: Array) -> None:
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
                f'{where}: {name}: expected millimetres but found {values.min():g} to '
                f'{values.max():g}, which look like {unit}; {remedy}'
            )


def _doubts(x: Array, needed: Array) -> list[str]:
    """Return what is strange about process values or compensations, though it can be."""
    step = float(x[:, COLUMNS.index('step_mm')].max())
    if step < STEP_LIKELY:
        return [
            f'note: step_mm is {step:g} at most; multiply all lengths by 25.4 if they are inches'
        ]
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

    recordings = read_recordings(bags)
    found = samples_of_paths(recordings.paths)
    left_out = Counter(recordings.left_out) + Counter(found.left_out)
    if not len(found.x):
        raise ValueError(
            f'{bags[0]}: expected primitives that give samples but found none: '
            f'{", ".join(left_out)}'
        )
    x, s = folded_samples(found.x, found.s)
    groups = joined_groups(equal_rows(x), found.path)
    fresh = len(found.x) - found.relaxed
    lines = [
        f'{len(recordings.paths)} recorded paths: {fresh} samples from fresh starts, '
        f'{found.relaxed} by the fading of the drift, in {len(np.unique(groups))} groups of one '
        'path or equal process'
    ]
    lines += [f'left out: {count} {reason}' for reason, count in sorted(left_out.items())]
    where = tuple(recordings.paths[number].source for number in found.path)
    return Samples(x, s, groups, tuple(lines), where)
