# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Compensated stitches as they travel on topics, and the tool path through them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.components.soft.stitch_patterns import (
    COORDINATE_MAX,
    STITCHES_MAX,
    primitive_kind,
)
from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.deformation import compensation
from fuzzycnc_ros.core.deformation.compensation import REFERENCE_LENGTH
from fuzzycnc_ros.core.deformation.stitch_path import Primitive, SheetMaterial
from fuzzycnc_ros.runtime.enums import Junction, SegmentKind
from fuzzycnc_ros.runtime.records import CompensatedPath, Floats, StitchPattern, ToolPath

PLANE = ('X', 'Y')
"""Axes of a pattern."""
_PER_LENGTH = 1e-3 / REFERENCE_LENGTH
"""Factor from the model's mm per 50 mm to a pure number."""


@dataclass(frozen=True)
class PatternPrimitives:
    """Primitives of a pattern, those with a length, and the number of each."""

    number: tuple[int, ...]
    primitive: tuple[Primitive, ...]

    @property
    def steps(self) -> tuple[int, ...]:
        """Number of steps of each."""
        return tuple(len(item.stitches()) for item in self.primitive)


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
    for name, length in (('nominal', points), ('offset', points), ('turn', steps)):
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
    bad = ~(np.isfinite(path.depth) & (path.depth > 0.0))
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
    primitives = course.primitive

    def per_step(values: Sequence[float]) -> Floats:
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
        kind=np.repeat([primitive_kind(item) for item in primitives], steps).astype(np.uint8),
        turn=per_step([item.turn for item in primitives]),
        depth=per_step([item.depth for item in primitives]),
        step=per_step([item.step for item in primitives]),
        compensation=(_PER_LENGTH * path.compensation).ravel(),
        support=path.support,
        flag=path.flag.astype(np.uint8),
    )


def stitching_tool_path(
    pattern: StitchPattern, course: PatternPrimitives, commanded: Floats, corner: float
) -> ToolPath:
    """Return the tool path through commanded points: lines, at speed within a primitive.

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
    turns = [
        _turn(_direction(before, at_end=True), _direction(after, at_end=False))
        for before, after in zip(course.primitive[:-1], course.primitive[1:], strict=True)
    ]
    junction[last[:-1][np.array(turns) > corner]] = Junction.EXACT_STOP
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


def _turn(before: float, after: float) -> float:
    """Return by how much a direction changes, 0 to pi [rad]."""
    change = after - before
    return abs(portable.arctan2(portable.sin(change), portable.cos(change)))
