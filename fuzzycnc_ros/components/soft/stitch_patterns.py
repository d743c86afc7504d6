# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Patterns and sheets as they travel on topics: checked, and made of primitives."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, isfinite

import numpy as np

from fuzzycnc_ros.core.deformation.stitch_path import Primitive, SheetMaterial
from fuzzycnc_ros.runtime.enums import PrimitiveKind
from fuzzycnc_ros.runtime.records import Floats, Material, StitchPattern

STITCHES_MAX = 200_000
"""Most stitches of a pattern: more are a mistaken unit and would fill the memory."""
COORDINATE_MAX = 1e3
"""Largest coordinate [m], as in tool paths."""
SAME_POINT = 1e-9
"""Length up to which a line is none [m]."""

STITCHED = (PrimitiveKind.LINE, PrimitiveKind.ARC)
"""Kinds of primitives that are stitched."""

_PER_PRIMITIVE = ('turn', 'depth', 'step', 'feedrate')
_POINTS = ('end', 'centre')


@dataclass(frozen=True)
class Travel:
    """A jump, a trim or a stop between the primitives that are stitched.

    Parameters
    ----------
    kind : PrimitiveKind
        Which of them.
    start, end : tuple of float
        Where the tool is before and after it [m].
    """

    kind: PrimitiveKind
    start: tuple[float, float]
    end: tuple[float, float]

    def stitches(self) -> Floats:
        """Return the point after the start, shape (1, 2) [m]; no stitch leads to it."""
        return np.array([self.end])


def sheet_material(record: Material) -> SheetMaterial:
    """Return the sheet that a record describes.

    Raises
    ------
    ValueError
        If a length is not positive, or the size is not one of X and Y.
    """
    size = record.size.tolist()
    if len(size) not in (0, 2):
        raise ValueError(
            f'size: expected the lengths along X and Y, or none if they are unknown, but found '
            f'{len(size)} numbers'
        )
    return SheetMaterial(record.thickness, (size[0], size[1]) if size else None, record.name)


def pattern_primitives(pattern: StitchPattern) -> tuple[tuple[int, Primitive | Travel], ...]:
    """Return the primitives of a pattern with their numbers; lines without a length are left out.

    Raises
    ------
    ValueError
        If the pattern is malformed; the message names the field and the primitive.
    """
    check_arrays(pattern)
    found: list[tuple[int, Primitive | Travel]] = []
    start = _pair(pattern.start, 0)
    for index, kind in enumerate(pattern.kind.tolist()):
        end = _pair(pattern.end, index)
        apart = hypot(end[0] - start[0], end[1] - start[1])
        if kind == PrimitiveKind.LINE and apart < SAME_POINT:
            continue
        if kind not in STITCHED:
            if kind != PrimitiveKind.JUMP and apart >= SAME_POINT:
                raise ValueError(
                    f'end: expected primitive {index} where the last one ends, since it is a '
                    f'{PrimitiveKind(kind).name.lower()}, but found it {1e3 * apart:g} mm away; '
                    'jump there'
                )
            found.append((index, Travel(PrimitiveKind(kind), start, end)))
            start = end
            continue
        try:
            primitive = Primitive(
                start,
                end,
                float(pattern.depth[index]),
                float(pattern.step[index]),
                _pair(pattern.centre, index) if kind == PrimitiveKind.ARC else None,
                float(pattern.turn[index]) if kind == PrimitiveKind.ARC else 0.0,
            )
        except ValueError as error:
            raise ValueError(f'primitive {index}: {error}') from error
        found.append((index, primitive))
        start = end
    stitched = [item for _, item in found if isinstance(item, Primitive)]
    if not stitched:
        raise ValueError('end: expected at least one primitive with a length but found none')
    stitches = len(found) - len(stitched) + sum(item.length / item.step for item in stitched)
    if not stitches <= STITCHES_MAX:
        raise ValueError(
            f'step: expected up to {STITCHES_MAX} stitches but found about {stitches:.3g}; '
            'lengths are in m'
        )
    return tuple(found)


def check_arrays(pattern: StitchPattern) -> None:
    """Refuse arrays of a pattern that do not fit each other, and values that mean nothing.

    Raises
    ------
    ValueError
        If so.
    """
    if not pattern.path_id:
        raise ValueError('path_id: expected a name but found an empty text')
    count = len(pattern.kind)
    if not count:
        raise ValueError('kind: expected at least one primitive but found none')
    wanted = {'start': 2, **dict.fromkeys(_POINTS, 2 * count)}
    wanted |= dict.fromkeys(_PER_PRIMITIVE, count)
    for name, length in wanted.items():
        found = len(getattr(pattern, name))
        if found != length:
            raise ValueError(f'{name}: expected {length} values but found {found}')
    unknown = ~np.isin(pattern.kind, [int(kind) for kind in PrimitiveKind])
    if unknown.any():
        index = int(unknown.argmax())
        raise ValueError(
            'kind: expected 0 (line), 1 (arc), 2 (jump), 3 (trim) or 4 (stop) but found '
            f'{pattern.kind[index]} for primitive {index}'
        )
    arc = np.repeat(pattern.kind == PrimitiveKind.ARC, 2)
    for name, values, where in (
        ('start', pattern.start, np.ones(2, bool)),
        ('end', pattern.end, np.ones(2 * count, bool)),
        ('centre', pattern.centre, arc),
    ):
        bad = where & ~(np.abs(values) <= COORDINATE_MAX)  # NaN is none either
        if bad.any():
            at = int(bad.argmax())
            place = '' if name == 'start' else f' for primitive {at // 2}'
            raise ValueError(
                f'{name}: expected coordinates up to {COORDINATE_MAX:g} m but found '
                f'{values[at]}{place}'
            )
    stitched = np.isin(pattern.kind, STITCHED)
    for name, needed in (
        ('depth', stitched),
        ('step', stitched),
        ('feedrate', stitched | (pattern.kind == PrimitiveKind.JUMP)),
    ):
        values = getattr(pattern, name)
        bad = needed & ~(np.isfinite(values) & (values > 0.0))
        if bad.any():
            index = int(bad.argmax())
            unit = 'm/s' if name == 'feedrate' else 'm'
            raise ValueError(
                f'{name}: expected more than 0 {unit} but found {values[index]} for primitive '
                f'{index}'
            )
    for index, turn in enumerate(pattern.turn.tolist()):
        if not isfinite(turn):
            raise ValueError(
                f'turn: expected a finite angle but found {turn} for primitive {index}'
            )


def stitch_pattern(
    primitives: Sequence[Primitive],
    *,
    path_id: str,
    feed: float,
    stamp: int = 0,
    frame_id: str = '',
) -> StitchPattern:
    """Return the pattern of primitives in a row.

    Parameters
    ----------
    primitives : sequence of Primitive
        One at least; each begins where the one before ends.
    path_id : str
        Name of the pattern.
    feed : float
        Programmed feed of all of them [m/s].
    stamp : int
        When it was loaded [ns].
    frame_id : str
        Frame of its positions.
    """
    count = len(primitives)
    return StitchPattern(
        stamp=stamp,
        frame_id=frame_id,
        path_id=path_id,
        start=np.array(primitives[0].start, dtype=np.float64),
        kind=np.array([primitive_kind(item) for item in primitives], dtype=np.uint8),
        end=np.array([item.end for item in primitives], dtype=np.float64).ravel(),
        centre=np.array([item.centre or (np.nan, np.nan) for item in primitives]).ravel(),
        turn=np.array([item.turn for item in primitives], dtype=np.float64),
        depth=np.array([item.depth for item in primitives], dtype=np.float64),
        step=np.array([item.step for item in primitives], dtype=np.float64),
        feedrate=np.full(count, feed),
    )


def primitive_kind(primitive: Primitive | Travel) -> PrimitiveKind:
    """Return the kind of a primitive as patterns say it."""
    if isinstance(primitive, Travel):
        return primitive.kind
    return PrimitiveKind.LINE if primitive.centre is None else PrimitiveKind.ARC


def _pair(values: Floats, row: int) -> tuple[float, float]:
    return float(values[2 * row]), float(values[2 * row + 1])
