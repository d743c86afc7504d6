# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded paths on soft material, from bags, for `fuzzycnc foam train` and `learn`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.core.deformation.samples import RecordedPath
from fuzzycnc_ros.core.deformation.stitch_path import ARC, LINE, SheetMaterial
from fuzzycnc_ros.runtime.enums import PrimitiveKind

if TYPE_CHECKING:
    from fuzzycnc_ros.core.arrays import Array
    from fuzzycnc_ros.runtime.records import CompensatedPath, Material, StitchedPath

SECOND = 1e9


@dataclass
class Recordings:
    """What bags hold of paths and their stitches.

    Attributes
    ----------
    paths : list of RecordedPath
        Paths with all their stitches, in the order of the recordings.
    left_out : Counter
        Why others were left out, and how many.
    """

    paths: list[RecordedPath] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)


def read_recordings(bags: Sequence[Path]) -> Recordings:
    """Read the stitched paths of bags.

    Raises
    ------
    BagError
        If a bag cannot be read or lacks a topic.
    ValueError
        If a record contradicts itself, or no path was stitched to its end.
    """
    found = Recordings()
    for bag in bags:
        before = len(found.paths)
        _read_bag(bag, found)
        if len(found.paths) == before:
            reasons = ', '.join(found.left_out) or 'the bag has no stitched path'
            raise ValueError(
                f'{bag}: expected a path that was stitched to its end but found none: {reasons}'
            )
    return found


def _read_bag(bag: Path, found: Recordings) -> None:
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
    found: Recordings,
    bag: Path,
    path: CompensatedPath,
    stitches: StitchedPath,
    sheet: Material | None,
) -> None:
    """Add a path with its stitches."""
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
    points = (_points(path.nominal), _points(path.offset), _points(stitches.stitched))
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
    found.paths.append(
        RecordedPath(
            path_id=path.path_id,
            material=material,
            nominal=points[0],
            offset=points[1],
            stitched=points[2],
            primitive=path.primitive.astype(np.int64),
            kind=np.where(path.kind == PrimitiveKind.ARC, float(ARC), float(LINE)),
            turn=path.turn,
            depth=path.depth,
            step=path.step,
            source=where,
        )
    )


def _points(values: Array) -> Array:
    return np.asarray(values, dtype=np.float64).reshape(-1, 2)
