# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Tool paths as they travel on topics: made of curves and programs, and turned into motion."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, overload

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.motion.tool_path_checks import (
    PATH_AXES,
    arc_frames,
    check_arrays,
    check_sizes,
    curve_of,
    path_columns,
)
from fuzzycnc_ros.core.feedrate.gcode.segments import (
    ArcSegment,
    DwellSegment,
    LineSegment,
    NurbsSegment,
    Point,
    Segment,
)
from fuzzycnc_ros.core.feedrate.path.nurbs import NurbsCurve
from fuzzycnc_ros.runtime.enums import Junction, SegmentKind
from fuzzycnc_ros.runtime.records import Floats, ToolPath

if TYPE_CHECKING:
    from fuzzycnc_ros.core.feedrate.gcode.blocks import Program


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
        check_arrays(path)
        check_sizes(path, len(self.columns))
        self._path = path
        self._point = self._ends()
        self.start = _point(self._point[0])
        self._arcs = arc_frames(path, self._point, self.columns)
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
        return NurbsSegment(*common, self._curve(index), line)

    def _curve(self, index: int) -> NurbsCurve:
        return curve_of(self._path, index, self.columns)

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
            curve = self._curve(index)
            first[index], found[index + 1] = curve.point(list(curve.domain))
        # A dwell ends where the segment before it did.
        moved = np.append(True, path.kind != SegmentKind.DWELL)
        found = found[np.maximum.accumulate(np.where(moved, np.arange(count + 1), 0))]
        for index, begin in first.items():
            gap = float(np.linalg.norm(begin - found[index]))
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
        gap = float(np.linalg.norm(np.subtract(after.start, before.end)))
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
