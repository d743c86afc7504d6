# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Compensated stitches as they travel on topics, and the tool path through them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.soft.stitch_patterns import (
    COORDINATE_MAX,
    STITCHED,
    STITCHES_MAX,
    Travel,
    primitive_kind,
)
from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.deformation import compensation
from fuzzycnc_ros.core.deformation.compensation import REFERENCE_LENGTH
from fuzzycnc_ros.core.deformation.stitch_path import Primitive, SheetMaterial, StitchPath
from fuzzycnc_ros.runtime.enums import Junction, PrimitiveKind, SegmentKind
from fuzzycnc_ros.runtime.records import Bytes, CompensatedPath, Floats, StitchPattern, ToolPath

PLANE = ('X', 'Y')
"""Axes of a pattern."""
_PER_LENGTH = 1e-3 / REFERENCE_LENGTH
"""Factor from the model's mm per 50 mm to a pure number."""


def stitch_runs(kind: Bytes) -> list[NDArray[np.intp]]:
    """Return the points of each run of stitches, two at least.

    A jump or a trim ends a run, and a run begins at its end point as at the first point of all.
    A stop ends none and has no stitch.

    Parameters
    ----------
    kind : ndarray of int, shape (n,)
        `PrimitiveKind` of each step.

    Examples
    --------
    Two stitches, a jump, a stitch, a stop, and another stitch:

    >>> [run.tolist() for run in stitch_runs(np.array([0, 0, 2, 0, 4, 0]))]
    [[0, 1, 2], [3, 4, 6]]
    """
    begins = np.append(True, np.isin(kind, (PrimitiveKind.JUMP, PrimitiveKind.TRIM)))
    points = np.flatnonzero(np.append(True, kind != PrimitiveKind.STOP))
    runs = np.split(points, np.flatnonzero(begins[points])[1:])
    return [run for run in runs if len(run) > 1]


@dataclass(frozen=True)
class PatternPrimitives:
    """Primitives of a pattern, those with a length, and the number of each."""

    number: tuple[int, ...]
    primitive: tuple[Primitive | Travel, ...]

    @property
    def steps(self) -> tuple[int, ...]:
        """Number of steps of each."""
        return tuple(len(item.stitches()) for item in self.primitive)

    @property
    def points(self) -> Floats:
        """All points [m], shape (n + 1, 2)."""
        return np.concatenate(
            [[self.primitive[0].start], *(item.stitches() for item in self.primitive)]
        )

    @property
    def kind(self) -> Bytes:
        """Kind of each step, shape (n,)."""
        kinds = [primitive_kind(item) for item in self.primitive]
        return np.repeat(kinds, self.steps).astype(np.uint8)

    def runs(self) -> list[tuple[NDArray[np.intp], StitchPath]]:
        """Return the points and the path of each run of stitches."""
        groups: list[list[Primitive]] = [[]]
        for item in self.primitive:
            if isinstance(item, Primitive):
                groups[-1].append(item)
            elif item.kind != PrimitiveKind.STOP:
                groups.append([])
        paths = [StitchPath.of_primitives(group) for group in groups if group]
        return list(zip(stitch_runs(self.kind), paths, strict=True))


def check_compensated(path: CompensatedPath) -> None:
    """Refuse a path whose stitches cannot be made.

    Raises
    ------
    ValueError
        If its arrays do not fit each other, or hold what is no point, depth or turn.
    """
    steps = len(path.depth)
    if not 0 < steps <= STITCHES_MAX:
        raise ValueError(f'depth: expected 1 to {STITCHES_MAX} stitches but found {steps}')
    points = 2 * steps + 2
    for name, length in (
        ('nominal', points), ('offset', points), ('turn', steps), ('kind', steps),
    ):  # fmt: skip
        found = len(getattr(path, name))
        if found != length:
            raise ValueError(f'{name}: expected {length} values for {steps} stitches, not {found}')
    for name in ('nominal', 'offset'):
        bad = ~(np.abs(getattr(path, name)) <= COORDINATE_MAX)  # NaN is none either
        if bad.any():
            raise ValueError(
                f'{name}: expected up to {COORDINATE_MAX:g} m but found '
                f'{getattr(path, name)[bad][0]}'
            )
    unknown = ~np.isin(path.kind, list(PrimitiveKind))
    if unknown.any():
        raise ValueError(f'kind: expected 0 to 4 but found {path.kind[unknown][0]}')
    bad = np.isin(path.kind, STITCHED) & ~(np.isfinite(path.depth) & (path.depth > 0.0))
    if bad.any():
        raise ValueError(f'depth: expected more than 0 m but found {path.depth[bad][0]}')
    if not np.isfinite(path.turn).all():
        raise ValueError('turn: expected finite angles but found some that are not')


def compensated_record(
    pattern: StitchPattern,
    course: PatternPrimitives,
    material: SheetMaterial,
    path: compensation.OffsetPath,
    model: str,
) -> CompensatedPath:
    """Return the record of a compensated pattern.

    Parameters
    ----------
    pattern : StitchPattern
        The pattern, whose stamp and name it gets.
    course : PatternPrimitives
        Its primitives.
    material : SheetMaterial
        The sheet.
    path : core.deformation.OffsetPath
        Nominal stitches and their offsets.
    model : str
        Hash of what gave the offsets.
    """
    steps = course.steps

    def per_step(name: str) -> Floats:
        values = [getattr(item, name, 0.0) for item in course.primitive]
        return np.repeat(np.array(values, dtype=np.float64), steps)

    return CompensatedPath(
        stamp=pattern.stamp,
        frame_id=pattern.frame_id,
        path_id=pattern.path_id,
        material=material.name,
        thickness=material.thickness,
        model=model,
        nominal=path.nominal.ravel(),
        offset=path.offset.ravel(),
        primitive=np.repeat(np.array(course.number, dtype=np.uint32), steps),
        kind=course.kind,
        turn=per_step('turn'),
        depth=per_step('depth'),
        step=per_step('step'),
        compensation=(_PER_LENGTH * path.compensation).ravel(),
        support=path.support,
        flag=path.flag.astype(np.uint8),
    )


def stitching_tool_path(
    pattern: StitchPattern, course: PatternPrimitives, commanded: Floats, corner: float
) -> ToolPath:
    """Return the tool path through commanded points: lines, at speed within a primitive.

    The tool stops before and after a jump, a trim and a stop.

    Parameters
    ----------
    pattern : StitchPattern
        The pattern, whose stamp, name and feeds it gets.
    course : PatternPrimitives
        Its primitives.
    commanded : ndarray, shape (n + 1, 2)
        Points that the needle is to go through [m].
    corner : float
        Change of the nominal direction between two primitives beyond which the tool stops
        there [rad].

    Raises
    ------
    ValueError
        If the tool would not move at all.
    """
    steps = course.steps
    last = np.cumsum(steps) - 1
    junction = np.full(len(commanded) - 1, Junction.CONTINUOUS, dtype=np.uint8)
    stops = [_stops(before, after, corner) for before, after in pairwise(course.primitive)]
    junction[last[:-1][np.array(stops, bool)]] = Junction.EXACT_STOP
    junction[-1] = Junction.EXACT_STOP
    feed = np.repeat(pattern.feedrate[list(course.number)], steps)
    moved = (np.diff(commanded, axis=0) != 0.0).any(axis=1)
    kept = np.flatnonzero(moved)
    if not len(kept):
        raise ValueError('commanded: expected points that differ but found all in one place')
    # A stop at the end of a step that is left out is made at the end of the one before.
    owner = np.searchsorted(kept, np.flatnonzero(junction), side='right') - 1
    stop = np.zeros(len(kept), dtype=np.uint8)
    stop[owner[owner >= 0]] = Junction.EXACT_STOP
    return ToolPath(
        stamp=pattern.stamp,
        frame_id=pattern.frame_id,
        path_id=pattern.path_id,
        includes_compensation=True,
        axis=PLANE,
        start=commanded[0].copy(),
        kind=np.full(len(kept), SegmentKind.LINE, dtype=np.uint8),
        junction=stop,
        block=np.full(len(kept), -1, dtype=np.int64),
        feedrate=feed[kept],
        offset=(2 * np.arange(len(kept) + 1)).astype(np.uint32),
        data=commanded[1:][kept].ravel(),
    )


def _direction(primitive: Primitive, *, at_end: bool) -> float:
    """Return the direction of a primitive where it begins or ends [rad]."""
    if primitive.centre is None:
        start, end = primitive.start, primitive.end
        return portable.arctan2(end[1] - start[1], end[0] - start[0])
    place = primitive.end if at_end else primitive.start
    arm = portable.arctan2(place[1] - primitive.centre[1], place[0] - primitive.centre[0])
    return arm + (0.5 if primitive.turn > 0.0 else -0.5) * np.pi


def _stops(before: Primitive | Travel, after: Primitive | Travel, corner: float) -> bool:
    """Return whether the tool stops between two primitives."""
    if isinstance(before, Travel) or isinstance(after, Travel):
        return True
    change = _direction(after, at_end=False) - _direction(before, at_end=True)
    return abs(portable.arctan2(portable.sin(change), portable.cos(change))) > corner
