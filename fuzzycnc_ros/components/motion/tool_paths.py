# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Tool paths as they travel on topics: made of curves and programs, and turned into motion.

Every way in which one can be malformed is refused here, with its remedy.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.feedrate.gcode.arcs import (
    MISFIT_INCH,
    MISFIT_MOST,
    POINT_ROUNDING,
    RELATIVE_MISFIT,
    TURNS_MAX,
)
from fuzzycnc_ros.core.feedrate.gcode.segments import (
    ArcSegment,
    DwellSegment,
    LineSegment,
    NurbsSegment,
    Point,
    Segment,
)
from fuzzycnc_ros.core.feedrate.path.nurbs import (
    COORDINATE_MAX,
    DEGREE_MAX,
    NurbsCurve,
    check_machinable,
)
from fuzzycnc_ros.runtime.enums import Junction, SegmentKind
from fuzzycnc_ros.runtime.records import Floats, ToolPath

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.gcode.blocks import Program


PATH_AXES = ('X', 'Y', 'Z')
"""Axes that a tool path may have."""

_AXIS_MISFIT = 1e-9


class ToolPathSegments(Sequence[Segment]):
    """The segments of a tool path, made when they are asked for.

    All of the path is checked at once; what is made later takes no memory now.

    Parameters
    ----------
    path : ToolPath
        The path; axes that it does not name stand still at 0.

    Attributes
    ----------
    axis : tuple of str
        Names of its axes.
    columns : tuple of int
        Their places among X, Y and Z.
    start : tuple of float, length 3
        Where it starts [m].
    exact_stop : ndarray of bool, shape (n,)
        Whether the tool stands still at the end of each segment.
    block : ndarray, shape (n,)
        Line of the part program of each segment; -1 if none.

    Raises
    ------
    ValueError
        If the record is malformed; the message names the field and the segment.
    """

    def __init__(self, path: ToolPath) -> None:
        self.axis = path.axis
        self.columns = path_columns(path.axis)
        _check_arrays(path)
        _check_sizes(path, len(self.columns))
        self._path = path
        self._point = self._ends()
        self.start = _point(self._point[0])
        self._arcs = _arc_frames(path, self._point, self.columns)
        self._arc_row = np.cumsum(path.kind == SegmentKind.ARC) - 1
        self.exact_stop = path.junction == Junction.EXACT_STOP
        self.block = path.block
        # A run is what is moved without a stop: numbered as the reader of programs does.
        dwell, rapid = path.kind == SegmentKind.DWELL, np.isnan(path.feedrate)
        change = (rapid[1:] != rapid[:-1]) | dwell[1:] | dwell[:-1] | self.exact_stop[:-1]
        self._run = np.append(0, np.cumsum(change))

    def __len__(self) -> int:
        """Return the number of segments."""
        return len(self._path.kind)

    @overload
    def __getitem__(self, index: int) -> Segment: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Segment, ...]: ...

    def __getitem__(self, index: int | slice) -> Segment | tuple[Segment, ...]:
        """Make one segment, or several."""
        if isinstance(index, slice):
            return tuple(self._segment(number) for number in range(*index.indices(len(self))))
        if not -len(self) <= index < len(self):
            raise IndexError(f'expected an index below {len(self)} but found {index}')
        return self._segment(index % len(self))

    def _segment(self, index: int) -> Segment:
        path = self._path
        kind, line = path.kind[index], int(path.block[index])
        start, end = _point(self._point[index]), _point(self._point[index + 1])
        feed = float(path.feedrate[index])
        rapid = kind != SegmentKind.DWELL and feed != feed
        own = None if rapid or kind == SegmentKind.DWELL else feed
        common = (line, start, end, own, rapid, False, int(self._run[index]))
        if kind == SegmentKind.LINE:
            return LineSegment(*common)
        if kind == SegmentKind.ARC:
            row = int(self._arc_row[index])
            across = int(self._arcs.across[row])
            x, y = self._arcs.centre[row].tolist()
            axes = ((across + 1) % 3, (across + 2) % 3, across)
            return ArcSegment(*common, axes, (x, y), float(self._arcs.sweep[row]))
        if kind == SegmentKind.DWELL:
            return DwellSegment(*common, float(path.data[path.offset[index]]))
        return NurbsSegment(*common, _curve_of(self._path, index, self.columns), line)

    def _ends(self) -> Floats:
        """Return where each segment starts, and where the last one ends, shape (n + 1, 3)."""
        path, columns = self._path, list(self.columns)
        count, width = len(path.kind), len(columns)
        found = np.zeros((count + 1, 3))
        found[0, columns] = path.start
        simple = np.flatnonzero((path.kind == SegmentKind.LINE) | (path.kind == SegmentKind.ARC))
        place = path.offset[simple].astype(np.int64)[:, np.newaxis] + np.arange(width)
        found[simple[:, np.newaxis] + 1, columns] = path.data[place]
        first: dict[int, Floats] = {}
        for index in np.flatnonzero(path.kind == SegmentKind.NURBS).tolist():
            curve = _curve_of(self._path, index, self.columns)
            first[index], found[index + 1] = curve.point(list(curve.domain))
        # A dwell ends where the segment before it did.
        moved = np.append(True, path.kind != SegmentKind.DWELL)
        found = found[np.maximum.accumulate(np.where(moved, np.arange(count + 1), 0))]
        for index, begin in first.items():
            gap = portable.norm(begin - found[index])
            if gap > 1e-9:
                raise ValueError(
                    f'segment {index} (block {path.block[index]}): expected a curve that begins '
                    f'where the segment before it ends but found it {gap:.6g} m away; '
                    'put a line between them'
                )
        return found


def tool_path_segments(path: ToolPath) -> ToolPathSegments:
    """Return the segments of a tool path; see `ToolPathSegments`."""
    return ToolPathSegments(path)


def curve_tool_path(
    curve: NurbsCurve, *, path_id: str, feed: float, stamp: int = 0, frame_id: str = ''
) -> ToolPath:
    """Return the tool path along a curve.

    Parameters
    ----------
    curve : NurbsCurve
        In the plane (X and Y) or in space.
    path_id : str
        Name of the path.
    feed : float
        Programmed feed [m/s].
    stamp : int
        When it was made [ns].
    frame_id : str
        Frame of its positions.
    """
    control = np.zeros((len(curve.control), 3))
    control[:, : curve.dimension] = curve.control
    lifted = NurbsCurve(control, curve.weight, curve.knot, curve.degree)
    start, end = (_point(place) for place in lifted.point(list(curve.domain)))
    segment = NurbsSegment(-1, start, end, feed, False, False, 0, lifted, -1)
    axis = PATH_AXES[: curve.dimension]
    return segments_tool_path(
        [segment], path_id=path_id, stamp=stamp, frame_id=frame_id, axis=axis
    )


def program_tool_path(
    program: Program, *, path_id: str = 'program', stamp: int = 0, frame_id: str = ''
) -> ToolPath:
    """Return the tool path of a part program, with its own feeds; it starts at the origin.

    Parameters
    ----------
    program : Program
        The program.
    path_id, stamp, frame_id
        As `curve_tool_path`.

    Raises
    ------
    ValueError
        If the machine would move in a way that the program's text does not tell: cycles, calls,
        other axes, feeds per revolution, or places that are not known.  The message names the
        line.
    """
    # Here, as a machine without programs does without their reader.
    from fuzzycnc_ros.core.feedrate.gcode.blocks import Role

    for block in program.blocks:
        segment = block.segment
        moves = block.role in (Role.RAPID, Role.KEPT, Role.SEALED)
        if moves and (segment is None or not np.isfinite([segment.start, segment.end]).all()):
            raise ValueError(
                f'line {block.line}: expected a motion whose place the program tells but found '
                f'{block.text.strip()!r}, which is up to the machine; it cannot be run from here'
            )
        if segment is not None and segment.turning:
            raise ValueError(
                f'line {block.line}: expected motion of X, Y and Z but found other axes in '
                f'{block.text.strip()!r}'
            )
        moving = segment is not None and segment.length > 0.0
        if segment is not None and moving and segment.feed is None and not segment.rapid:
            raise ValueError(
                f'line {block.line}: expected a feed in length per time but found none for '
                f'{block.text.strip()!r}'
            )
    kept = [s for s in program.segments if s.length > 0.0 or isinstance(s, DwellSegment)]
    return segments_tool_path(kept, path_id=path_id, stamp=stamp, frame_id=frame_id)


def segments_tool_path(
    segments: Iterable[Segment],
    *,
    path_id: str,
    stamp: int = 0,
    frame_id: str = '',
    axis: tuple[str, ...] = PATH_AXES,
) -> ToolPath:
    """Return the tool path of segments; it stops exactly where their run changes, and at its end.

    Parameters
    ----------
    segments : iterable of Segment
        Segments that follow each other.
    axis : tuple of str
        Axes of the path; no other may move.
    path_id, stamp, frame_id
        As `curve_tool_path`.

    Raises
    ------
    ValueError
        If there are none, or they do not follow each other.
    """
    columns = list(path_columns(axis))
    chain = list(segments)
    if not chain:
        raise ValueError('segments: expected at least one that moves but found none')
    run = np.array([segment.run for segment in chain])
    moving = [segment for segment in chain if not isinstance(segment, DwellSegment)]
    for before, after in pairwise(moving):
        gap = portable.norm(np.subtract(after.start, before.end))
        if not gap <= 1e-9:
            raise ValueError(
                f'line {after.line}: expected a start where line {before.line} ends but found a '
                f'gap of {gap:.6g} m'
            )
    kinds, rows = zip(*(_row(segment, columns) for segment in chain), strict=True)
    feeds = [np.nan if segment.feed is None else segment.feed for segment in chain]
    return ToolPath(
        stamp=stamp,
        frame_id=frame_id,
        path_id=path_id,
        includes_compensation=False,
        axis=axis,
        start=np.array((moving or chain)[0].start)[columns],
        kind=np.array(kinds, dtype=np.uint8),
        junction=np.append(run[1:] != run[:-1], True).astype(np.uint8),
        block=np.array([segment.line for segment in chain], dtype=np.int64),
        feedrate=np.array(feeds, dtype=np.float64),
        offset=np.append(0, np.cumsum([len(row) for row in rows])).astype(np.uint32),
        data=np.concatenate(rows),
    )


def _row(segment: Segment, columns: list[int]) -> tuple[SegmentKind, Floats]:
    """Return kind and geometry of a segment as the message has them."""
    if isinstance(segment, DwellSegment):
        return SegmentKind.DWELL, np.array([segment.duration])
    end = np.array(segment.end)[columns]
    if isinstance(segment, LineSegment):
        return SegmentKind.LINE, end
    if isinstance(segment, ArcSegment):
        first, second, across = segment.axes
        centre, turn = np.array(segment.start), np.zeros(3)
        centre[[first, second]] = segment.centre
        turn[across] = 1.0
        return SegmentKind.ARC, np.concatenate([end, centre[columns], turn, [segment.sweep]])
    if isinstance(segment, NurbsSegment):
        curve = segment.curve
        points = curve.control[:, columns].ravel()
        head = [float(curve.degree), float(len(curve.control))]
        return SegmentKind.NURBS, np.concatenate([head, curve.knot, curve.weight, points])
    raise ValueError(f'expected a line, an arc, a curve or a dwell but found {segment!r}')


def _point(row: NDArray[np.float64]) -> Point:
    x, y, z = row.tolist()
    return x, y, z


@dataclass(frozen=True)
class _ArcFrames:
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


def _check_arrays(path: ToolPath) -> None:
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


def _check_sizes(path: ToolPath, width: int) -> None:
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
        found = f'{wanted} numbers of a {kind.name.lower()} but found {{:d}}'
        _refuse_segments(path, (path.kind == kind) & (size != wanted), found, size)
    for kind, numbers in ((SegmentKind.LINE, width), (SegmentKind.ARC, 2 * width)):
        chosen = np.flatnonzero(path.kind == kind)
        values = path.data[first[chosen][:, np.newaxis] + np.arange(numbers)]
        far = np.abs(values).max(axis=1, initial=0.0)
        found = f'coordinates up to {COORDINATE_MAX:g} m but found {{:g}} m'
        _refuse_segments(path, far > COORDINATE_MAX, found, far, chosen=chosen)
    chosen = np.flatnonzero(path.kind == SegmentKind.DWELL)
    times = path.data[first[chosen]]
    found = 'a dwell of 0 s or more but found {:g} s'
    _refuse_segments(path, times < 0.0, found, times, chosen=chosen)


def _curve_of(path: ToolPath, index: int, columns: tuple[int, ...]) -> NurbsCurve:
    """Return the curve of a segment, in three dimensions.

    Raises
    ------
    ValueError
        If its data makes none.
    """
    data = path.data[int(path.offset[index]) : int(path.offset[index + 1])]
    width = len(columns)
    if len(data) < 2 or data[0] != np.floor(data[0]) or data[1] != np.floor(data[1]):
        raise _segment_error(
            path, index, 'the whole numbers degree and points first but found others'
        )
    if not (1.0 <= data[0] <= DEGREE_MAX and 2.0 <= data[1] <= len(data)):
        raise _segment_error(
            path,
            index,
            f'a degree from 1 to {DEGREE_MAX} and at least 2 points but found {data[0]:g} and '
            f'{data[1]:g}',
        )
    degree, count = int(data[0]), int(data[1])
    knots = count + degree + 1
    wanted = 2 + knots + count * (1 + width)
    if len(data) != wanted:
        raise _segment_error(
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


def _arc_frames(path: ToolPath, point: Floats, columns: tuple[int, ...]) -> _ArcFrames:
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
    found = 'a turn axis of length 1 along X, Y or Z but found {}; give other arcs as curves'
    _refuse_segments(path, wrong, found, turn, chosen=chosen)
    wrong = np.zeros(len(row), bool)
    for missing in set(range(3)) - set(columns):
        wrong |= across != missing
    found = f'an arc in the plane of {", ".join(path.axis)} but found one about {{}}'
    _refuse_segments(path, wrong, found, np.array(PATH_AXES)[across], chosen=chosen)
    sweep = sign * data[:, -1]
    wrong = ~((np.abs(sweep) > 0.0) & (np.abs(sweep) <= TURNS_MAX * 2.0 * np.pi))
    found = f'an angle other than 0, up to {TURNS_MAX:g} turns, but found {{:g}} rad'
    _refuse_segments(path, wrong, found, sweep, chosen=chosen)
    centre = np.zeros((len(chosen), 3))
    centre[:, columns] = data[:, width : 2 * width]
    plane = (across[:, np.newaxis] + [1, 2]) % 3
    middle = np.take_along_axis(centre, plane, axis=1)
    start = np.take_along_axis(point[chosen], plane, axis=1) - middle
    end = np.take_along_axis(point[chosen + 1], plane, axis=1) - middle
    _check_circles(path, chosen, start, end, sweep)
    return _ArcFrames(across, middle, sweep)


def _check_circles(
    path: ToolPath, chosen: NDArray[np.intp], start: Floats, end: Floats, sweep: Floats
) -> None:
    """Refuse arcs whose end is not where their start turned by their angle lies."""
    first, last = np.hypot(*start.T), np.hypot(*end.T)
    # The path does not say in which unit its program was written: the wider tolerance of both.
    room = np.clip(
        RELATIVE_MISFIT * np.maximum(first, last), MISFIT_INCH, MISFIT_MOST * MISFIT_INCH
    )
    wrong = (first < POINT_ROUNDING) | (np.abs(last - first) > room)
    found = 'start and end of the arc equally far from its centre but found {:.6g} m and {:.6g} m'
    _refuse_segments(path, wrong, found, first, last, chosen=chosen)
    turned = (
        portable.arctan2(end[:, 1], end[:, 0]) - portable.arctan2(start[:, 1], start[:, 0]) - sweep
    )
    apart = np.abs(turned - 2.0 * np.pi * np.round(turned / (2.0 * np.pi))) * last
    found = 'an end where the angle of {:.9g} rad leads but found it {:.6g} m away'
    _refuse_segments(path, apart > POINT_ROUNDING, found, sweep, apart, chosen=chosen)


def _segment_error(path: ToolPath, index: int, text: str) -> ValueError:
    """Return the refusal of a segment: what was expected of it and what was found."""
    return ValueError(f'segment {index} (block {path.block[index]}): expected {text}')


def _refuse_segments(
    path: ToolPath,
    wrong: NDArray[np.bool_],
    expected: str,
    *found: NDArray[Any],
    chosen: NDArray[np.intp] | None = None,
) -> None:
    """Refuse the first segment that is wrong.

    Parameters
    ----------
    path : ToolPath
        The path.
    wrong : ndarray of bool, shape (k,)
        Which segments are wrong, of those that are `chosen` or of all.
    expected : str
        What was expected, and places for what was found.
    found : ndarray, shape (k, ...)
        What was found, for each place of the text.
    chosen : ndarray, shape (k,), optional
        Numbers of the segments.

    Raises
    ------
    ValueError
        If one is wrong.
    """
    if wrong.any():
        at = int(wrong.argmax())
        number = at if chosen is None else int(chosen[at])
        raise _segment_error(
            path, number, expected.format(*(values[at].tolist() for values in found))
        )


def _refuse(wrong: NDArray[np.bool_], values: NDArray[np.generic], expected: str) -> None:
    """Refuse values, naming the first wrong one."""
    if wrong.any():
        at = int(wrong.argmax())
        raise ValueError(f'{expected}; found {values[at]} at {at}')
