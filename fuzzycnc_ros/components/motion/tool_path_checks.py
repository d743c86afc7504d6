# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a tool path must be: every way in which one can be malformed, with its remedy."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.feedrate.gcode.arcs import ABSOLUTE_MISFIT, POINT_ROUNDING, RELATIVE_MISFIT
from fuzzycnc_ros.core.feedrate.path.nurbs import (
    COORDINATE_MAX,
    DEGREE_MAX,
    NurbsCurve,
    check_machinable,
)
from fuzzycnc_ros.runtime.enums import Junction, SegmentKind
from fuzzycnc_ros.runtime.records import Floats, ToolPath

PATH_AXES = ('X', 'Y', 'Z')
"""Axes that a tool path may have."""

TURNS_MAX = 1000.0
"""Largest number of turns of an arc."""
_AXIS_MISFIT = 1e-9


@dataclass(frozen=True)
class ArcFrames:
    """Planes and angles of arcs: axis across (k,), centre in the plane (k, 2) [m], angle (k,)."""

    across: NDArray[np.intp]
    centre: Floats
    sweep: Floats


def path_columns(axis: tuple[str, ...]) -> tuple[int, ...]:
    """Return the places of a path's axes among X, Y and Z.

    Raises
    ------
    ValueError
        If there are none, one is another axis, or one comes twice.
    """
    unknown = [name for name in axis if name not in PATH_AXES]
    if unknown or not axis or len(set(axis)) != len(axis):
        raise ValueError(
            f'axis: expected distinct names of {", ".join(PATH_AXES)} but found '
            f'{", ".join(map(repr, axis)) or "none"}'
        )
    return tuple(PATH_AXES.index(name) for name in axis)


def check_arrays(path: ToolPath) -> None:
    """Refuse arrays that do not fit each other, and values that mean nothing.

    Raises
    ------
    ValueError
        If so.
    """
    if not path.path_id:
        raise ValueError('path_id: expected a name but found an empty text')
    count = len(path.kind)
    if count == 0:
        raise ValueError('kind: expected at least one segment but found none')
    for name, wanted in (
        ('start', len(path.axis)),
        ('junction', count),
        ('block', count),
        ('feedrate', count),
        ('offset', count + 1),
    ):
        found = len(getattr(path, name))
        if found != wanted:
            raise ValueError(f'{name}: expected {wanted} values but found {found}')
    for name, values in (('start', path.start), ('data', path.data)):
        _refuse(~np.isfinite(values), values, f'{name}: expected finite numbers')
    far = np.abs(path.start) > COORDINATE_MAX
    _refuse(far, path.start, f'start: expected coordinates up to {COORDINATE_MAX:g} m')
    known = np.isin(path.kind, [int(kind) for kind in SegmentKind])
    _refuse(~known, path.kind, 'kind: expected 0 to 3')
    known = np.isin(path.junction, [int(junction) for junction in Junction])
    _refuse(~known, path.junction, 'junction: expected 0 or 1')
    rapid = np.isnan(path.feedrate)
    good = rapid | ((path.feedrate > 0.0) & np.isfinite(path.feedrate))
    _refuse(~good, path.feedrate, 'feedrate: expected more than 0 m/s, or NaN for a rapid')
    offset = path.offset.astype(np.int64)
    size = np.diff(offset)
    if offset[0] != 0 or offset[-1] != len(path.data) or (size < 0).any():
        raise ValueError(
            f'offset: expected numbers that rise from 0 to {len(path.data)}, the length of data, '
            f'but found {offset[0]} to {offset[-1]}'
            + (', falling on the way' if (size < 0).any() else '')
        )


def check_sizes(path: ToolPath, width: int) -> None:
    """Refuse segments whose data is too short, too long or out of range.

    Parameters
    ----------
    path : ToolPath
        Path whose arrays fit each other.
    width : int
        Number of its axes.

    Raises
    ------
    ValueError
        If there is one.
    """
    size = np.diff(path.offset.astype(np.int64))
    first = path.offset[:-1].astype(np.int64)
    for kind, wanted in (
        (SegmentKind.LINE, width),
        (SegmentKind.ARC, 2 * width + 4),
        (SegmentKind.DWELL, 1),
    ):
        wrong = (path.kind == kind) & (size != wanted)
        if wrong.any():
            at = int(wrong.argmax())
            raise segment_error(
                path, at, f'{wanted} numbers of a {kind.name.lower()} but found {size[at]}'
            )
    points = ((SegmentKind.LINE, width), (SegmentKind.ARC, 2 * width))
    for kind, numbers in points:
        chosen = np.flatnonzero(path.kind == kind)
        values = path.data[first[chosen][:, np.newaxis] + np.arange(numbers)]
        wrong = (np.abs(values) > COORDINATE_MAX).any(axis=1)
        if wrong.any():
            at = int(wrong.argmax())
            raise segment_error(
                path,
                int(chosen[at]),
                f'coordinates up to {COORDINATE_MAX:g} m but found {np.abs(values[at]).max():g} m',
            )
    chosen = np.flatnonzero(path.kind == SegmentKind.DWELL)
    wrong = path.data[first[chosen]] < 0.0
    if wrong.any():
        at = int(chosen[wrong.argmax()])
        found = path.data[first[at]]
        raise segment_error(path, at, f'a dwell of 0 s or more but found {found:g} s')


def curve_of(path: ToolPath, index: int, columns: tuple[int, ...]) -> NurbsCurve:
    """Return the curve of a segment, in three dimensions.

    Raises
    ------
    ValueError
        If its data makes none.
    """
    data = path.data[int(path.offset[index]) : int(path.offset[index + 1])]
    width = len(columns)
    if len(data) < 2 or data[0] != np.floor(data[0]) or data[1] != np.floor(data[1]):
        raise segment_error(
            path, index, 'the whole numbers degree and points first but found others'
        )
    if not (1.0 <= data[0] <= DEGREE_MAX and 2.0 <= data[1] <= len(data)):
        raise segment_error(
            path,
            index,
            f'a degree from 1 to {DEGREE_MAX} and at least 2 points but found {data[0]:g} and '
            f'{data[1]:g}',
        )
    degree, count = int(data[0]), int(data[1])
    knots = count + degree + 1
    wanted = 2 + knots + count * (1 + width)
    if len(data) != wanted:
        raise segment_error(
            path,
            index,
            f'{wanted} numbers of a curve of degree {degree} through {count} points but found '
            f'{len(data)}',
        )
    knot, weight = data[2 : 2 + knots], data[2 + knots : 2 + knots + count]
    points = data[2 + knots + count :].reshape(count, width)
    control = np.zeros((count, 3))
    control[:, columns] = points
    try:
        curve = NurbsCurve(control, weight, knot, degree)
        check_machinable(control, weight, knot, degree)
    except ValueError as error:
        raise ValueError(f'segment {index} (block {path.block[index]}): {error}') from error
    return curve


def arc_frames(path: ToolPath, point: Floats, columns: tuple[int, ...]) -> ArcFrames:
    """Return the frames of all arcs, in the order of their segments.

    Parameters
    ----------
    path : ToolPath
        Path whose sizes are right.
    point : ndarray, shape (n + 1, 3)
        Where its segments start and the last one ends [m].
    columns : tuple of int
        Places of its axes among X, Y and Z.

    Raises
    ------
    ValueError
        If an arc does not turn about X, Y or Z, needs an axis that the path does not have, or
        does not end where its angle leads.
    """
    chosen, width = np.flatnonzero(path.kind == SegmentKind.ARC), len(columns)
    place = path.offset[chosen].astype(np.int64)[:, np.newaxis] + np.arange(2 * width + 4)
    data = path.data[place]
    row = np.arange(len(chosen))
    turn = data[:, 2 * width : 2 * width + 3]
    across = np.argmax(np.abs(turn), axis=1)
    sign = np.where(turn[row, across] > 0.0, 1.0, -1.0)
    exact = np.zeros((len(chosen), 3))
    exact[row, across] = sign
    wrong = np.abs(turn - exact).max(axis=1, initial=0.0) > _AXIS_MISFIT
    if wrong.any():
        at = int(wrong.argmax())
        raise segment_error(
            path,
            int(chosen[at]),
            f'a turn axis of length 1 along X, Y or Z but found {turn[at].tolist()}; give other '
            'arcs as curves',
        )
    missing = [k for k in range(3) if k not in columns]
    wrong = np.any([across != k for k in missing], axis=0) if missing else np.zeros(len(row), bool)
    if wrong.any():
        at = int(wrong.argmax())
        raise segment_error(
            path,
            int(chosen[at]),
            f'an arc in the plane of {", ".join(path.axis)} but found one about '
            f'{PATH_AXES[across[at]]}',
        )
    sweep = sign * data[:, -1]
    wrong = ~((np.abs(sweep) > 0.0) & (np.abs(sweep) <= TURNS_MAX * 2.0 * np.pi))
    if wrong.any():
        at = int(wrong.argmax())
        raise segment_error(
            path,
            int(chosen[at]),
            f'an angle other than 0, up to {TURNS_MAX:g} turns, but found {sweep[at]:g} rad',
        )
    centre = np.zeros((len(chosen), 3))
    centre[:, columns] = data[:, width : 2 * width]
    plane = (across[:, np.newaxis] + [1, 2]) % 3
    middle = np.take_along_axis(centre, plane, axis=1)
    start = np.take_along_axis(point[chosen], plane, axis=1) - middle
    end = np.take_along_axis(point[chosen + 1], plane, axis=1) - middle
    _check_circles(path, chosen, start, end, sweep)
    return ArcFrames(across, middle, sweep)


def _check_circles(
    path: ToolPath, chosen: NDArray[np.intp], start: Floats, end: Floats, sweep: Floats
) -> None:
    """Refuse arcs whose end is not where their start turned by their angle lies."""
    first, last = np.hypot(*start.T), np.hypot(*end.T)
    room = np.maximum(ABSOLUTE_MISFIT, RELATIVE_MISFIT * first)
    wrong = (first < POINT_ROUNDING) | (np.abs(last - first) > room)
    if wrong.any():
        at = int(wrong.argmax())
        raise segment_error(
            path,
            int(chosen[at]),
            f'start and end of the arc equally far from its centre but found {first[at]:.6g} m '
            f'and {last[at]:.6g} m',
        )
    turned = np.arctan2(end[:, 1], end[:, 0]) - np.arctan2(start[:, 1], start[:, 0]) - sweep
    apart = np.abs(turned - 2.0 * np.pi * np.round(turned / (2.0 * np.pi))) * last
    wrong = apart > POINT_ROUNDING
    if wrong.any():
        at = int(wrong.argmax())
        raise segment_error(
            path,
            int(chosen[at]),
            f'an end where the angle of {sweep[at]:.9g} rad leads but found it {apart[at]:.6g} m '
            'away',
        )


def segment_error(path: ToolPath, index: int, text: str) -> ValueError:
    """Return the refusal of a segment: what was expected of it and what was found."""
    return ValueError(f'segment {index} (block {path.block[index]}): expected {text}')


def _refuse(wrong: NDArray[np.bool_], values: NDArray[np.generic], expected: str) -> None:
    """Refuse values, naming the first wrong one."""
    if wrong.any():
        at = int(wrong.argmax())
        raise ValueError(f'{expected}; found {values[at]} at {at}')
