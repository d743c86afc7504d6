# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Paths on which schedulers are compared: curves, a run of a part program, a table of points."""

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import StringIO
from math import isfinite
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.blocks import Program
from fuzzycnc_ros.core.feedrate.gcode.segments import NurbsSegment, Segment, sample_path
from fuzzycnc_ros.core.feedrate.path.curves import butterfly, infinity, trident
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.simulation.motion.contour import Contour

CURVES: Mapping[str, tuple[Callable[[float], NurbsCurve], float]] = MappingProxyType(
    {'infinity': (infinity, 0.65), 'trident': (trident, 2.3), 'butterfly': (butterfly, 0.875)}
)
"""Curves of the literature, each with the scale that fits the times of [lin2021]."""

POINTS = 2000
"""Points of a path that schedulers get."""

LENGTH_MAX = 0.5
"""Length of a run or a table that is driven [m]: enough bends, and few minutes at low feeds."""

SEGMENT_MAX = 20.0
"""Length of the last segment within `LENGTH_MAX` that is still divided into points [m]."""

REACH = 1000.0
"""Distance from the origin beyond which a point is a mistake [m]."""

ROUNDING = 0.5e-6
"""Largest rounding of a coordinate in files [m]: those of three decimals in millimetres."""

_DENSE = 8
"""Points of the contour to each point for the schedulers."""


@dataclass(frozen=True, eq=False)
class ParetoPath:
    """A path, and what machine and schedulers know of it.

    Attributes
    ----------
    name : str
        Which path it is, for people.
    contour : Contour
        The programmed path.
    arc_length : ndarray, shape (n,)
        Arc lengths of the points for the schedulers [m], from 0 to the contour's length.
    sampled : SampledPath
        Curvature at these points.
    """

    name: str
    contour: Contour
    arc_length: Array
    sampled: SampledPath


def curve_path(name: str) -> ParetoPath:
    """Return one of `CURVES`, by points at equal steps of its parameter."""
    make, scale = CURVES[name]
    curve = make(scale)
    parameter = np.linspace(0.0, 1.0, POINTS)
    contour = Contour.curve(curve.point)
    sampled = SampledPath.from_points(curve.point(parameter))
    length = 1e3 * contour.length
    return ParetoPath(
        f'{name}, scale {scale:g}, {length:.1f} mm',
        contour,
        contour.arc_length(parameter),
        sampled,
    )


def program_path(program: Program, run: int | None = None) -> ParetoPath:
    """Return a run of a part program.

    Parameters
    ----------
    program : Program
        The program.
    run : int, optional
        Number of the run from 1; by default the first one that bends.

    Returns
    -------
    ParetoPath
        The run, its first `LENGTH_MAX` if it is longer; its name says which it is.

    Raises
    ------
    ValueError
        If there is no such run, it does not bend, as a straight line has no contour error, or
        leaves what is driven by a segment longer than `SEGMENT_MAX`.
    """
    runs = [program.segments[first:last] for first, last in program.runs]
    bent = [number for number, segments in enumerate(runs, start=1) if _bends(segments)]
    if run is None and not bent:
        raise ValueError(
            f'expected a run that bends but found {len(runs)} straight ones: a straight line has '
            'no contour error to compare'
        )
    number = bent[0] if run is None else run
    if number not in bent:
        known = f'{", ".join(map(str, bent[:8]))}{", ..." if len(bent) > 8 else ""}' or 'none'
        raise ValueError(
            f'--run: expected a run that bends, of {len(runs)} in the program {known}, but found '
            f'{number}'
        )
    segments = runs[number - 1]
    whole = sum(segment.length for segment in segments)
    length = min(whole, LENGTH_MAX)
    dense = sample_path(_driven(segments), length / POINTS / _DENSE)
    new = np.diff(dense.segment, prepend=-1) != 0
    since = np.arange(len(new)) - np.maximum.accumulate(np.where(new, np.arange(len(new)), 0))
    kept = new | (since % _DENSE == 0)
    last = segments[-1]
    end = last.last_line if isinstance(last, NurbsSegment) else last.line
    lines = f'lines {segments[0].line} to {end}'
    return _of_points(f'run {number} of {len(runs)}, {lines}', dense.point, kept, whole)


def table_path(text: str) -> ParetoPath:
    """Return a table of points, joined by straight lines.

    Parameters
    ----------
    text : str
        CSV with the columns x, y and perhaps z [mm].

    Returns
    -------
    ParetoPath
        The path, its first `LENGTH_MAX` if it is longer.

    Raises
    ------
    ValueError
        If the header or a number is wrong, which names the line, or the points are no path that
        bends.
    """
    corner = _table(text)
    corner = corner[np.append(True, np.any(np.diff(corner, axis=0) != 0.0, axis=1))]
    length = np.linalg.norm(np.diff(corner, axis=0), axis=1)
    whole = float(length.sum())
    corners = len(corner)
    if corners < 3 or not _turns(np.diff(corner, axis=0)):
        raise ValueError(
            f'expected points on a path that bends but found {corners} different ones on a '
            'straight line: it has no contour error to compare'
        )
    begin = np.cumsum(length) - length
    driven = int(np.count_nonzero(begin < LENGTH_MAX))
    corner, length = corner[: driven + 1].copy(), length[:driven]
    if length[-1] > LENGTH_MAX:  # it is left within, and must not be divided to its end
        corner[-1] = corner[-2] + (corner[-1] - corner[-2]) * (LENGTH_MAX / length[-1])
        length[-1] = LENGTH_MAX
    count = np.maximum(np.ceil(length / (min(whole, LENGTH_MAX) / POINTS)), 1.0).astype(int)
    place = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(place)) - np.repeat(np.cumsum(count) - count, count)) / count[place]
    point = corner[place] + share[:, np.newaxis] * (corner[place + 1] - corner[place])
    point = np.vstack([point, corner[-1:]])
    return _of_points(f'{corners} points', point, np.ones(len(point), dtype=bool), whole)


def _driven(segments: tuple[Segment, ...]) -> tuple[Segment, ...]:
    """Return the segments of a run up to `LENGTH_MAX`."""
    found, length = [], 0.0
    for segment in segments:
        if length >= LENGTH_MAX:
            break
        if segment.length > SEGMENT_MAX:
            raise ValueError(
                f'line {segment.line}: expected segments of at most {SEGMENT_MAX:g} m but found '
                f'{segment.length:g} m'
            )
        found.append(segment)
        length += segment.length
    return tuple(found)


def _of_points(name: str, point: Array, kept: NDArray[np.bool_], whole: float) -> ParetoPath:
    """Return the path through points, of which the schedulers get those that are kept."""
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(point, axis=0), axis=1)))
    if arc[-1] > LENGTH_MAX:
        last = int(np.searchsorted(arc, LENGTH_MAX, side='right'))
        point, arc, kept = point[:last], arc[:last], kept[:last].copy()
    kept[[0, -1]] = True
    length = f'{1e3 * arc[-1]:.1f} mm'
    if whole > LENGTH_MAX:
        length = f'its first {length} of {1e3 * whole:.1f} mm'
    # of corners too, which have none of their own: by the points around them
    sampled = SampledPath.from_points(point[kept], rounding=ROUNDING)
    # the points are dense enough, and the search takes time where they are more than that
    contour = Contour.polyline(point, vertices=2)
    return ParetoPath(f'{name}, {length}', contour, arc[kept], sampled)


def _bends(segments: tuple[Segment, ...]) -> bool:
    """Return True if a run is more than a straight line."""
    moving = [segment for segment in segments if segment.length > 0.0]
    if any(np.any(segment.curvatures(2) > 0.0) for segment in moving):
        return True
    return _turns(np.array([np.subtract(segment.end, segment.start) for segment in moving]))


def _turns(step: Array) -> bool:
    """Return True if steps differ in direction."""
    direction = step / np.linalg.norm(step, axis=1, keepdims=True)
    return bool(np.any(np.abs(direction - direction[0]) > 1e-6))


def _table(text: str) -> Array:
    """Return the points of a CSV table [m]."""
    rows = [(number, row) for number, row in _rows(text) if row]
    if not rows:
        raise ValueError('expected a table of points but it is empty')
    header = tuple(name.strip().lower() for name in rows[0][1])
    if header not in (('x', 'y'), ('x', 'y', 'z')):
        raise ValueError(
            f'line {rows[0][0]}: expected the columns x,y or x,y,z, in mm, but found '
            f'{",".join(rows[0][1])!r}'
        )
    points = []
    for number, row in rows[1:]:
        try:
            values = [float(cell) for cell in row]
        except ValueError as error:
            raise ValueError(f'line {number}: expected numbers, but: {error}') from error
        if len(values) != len(header) or not all(map(isfinite, values)):
            raise ValueError(
                f'line {number}: expected {len(header)} finite numbers but found {",".join(row)!r}'
            )
        if max(map(abs, values)) > 1e3 * REACH:
            raise ValueError(
                f'line {number}: expected places within {REACH:g} m but found {",".join(row)!r}'
            )
        points.append(values)
    if len(points) < 3:
        raise ValueError(f'expected three points or more but found {len(points)}')
    return 1e-3 * np.array(points)


def _rows(text: str) -> list[tuple[int, list[str]]]:
    """Return numbered rows."""
    reader = csv.reader(StringIO(text.lstrip('\ufeff')))
    try:
        return [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise ValueError(f'line {reader.line_num}: expected a CSV table, but: {error}') from error
