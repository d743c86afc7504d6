# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Points along the path of a part program."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.gcode.segments import LineSegment, Segment

_GAP = 1e-9
"""Distance up to which two segments meet [m]."""


@dataclass(frozen=True, eq=False)
class ProgramPoints:
    """Points along the path of a program.

    Parameters
    ----------
    point : ndarray, shape (n, 3)
        Points [m].
    segment : ndarray, shape (n,)
        Index of the segment of each point; where two meet, of the later one.
    curvature : ndarray, shape (n,)
        Exact curvature of that segment [1/m]: 0 on lines, whose corners are no matter of
        curvature; where two segments meet, the larger one of both.
    """

    point: Array
    segment: NDArray[np.intp]
    curvature: Array


def sample_path(segments: Sequence[Segment], spacing: float) -> ProgramPoints:
    r"""Return points along segments that follow each other, all ends included.

    Parameters
    ----------
    segments : sequence of Segment
        A run of a program, or any part of it that has no gap.  Dwells and segments of no length
        add no points.
    spacing : float
        Largest distance of points along the path [m].

    Returns
    -------
    ProgramPoints
        Points in equal steps inside each segment; no two in a row are the same.

    Raises
    ------
    ValueError
        If the spacing is not above 0, nothing moves, or there is a gap.

    Examples
    --------
    >>> from fuzzycnc_ros.core.feedrate.gcode.reader import read_program
    >>> program = read_program('F600 G1 X3\nX4\n')
    >>> path = sample_path(program.segments, 0.002)
    >>> path.point[:, 0].tolist(), path.segment.tolist()
    ([0.0, 0.0015, 0.003, 0.004], [0, 0, 1, 1])
    """
    if not 0.0 < spacing < np.inf:
        raise ValueError(f'expected a spacing above 0 but found {spacing} m')
    length = np.array([segment.length for segment in segments])
    moving = np.flatnonzero(length > 0.0)
    part = [segments[index] for index in moving.tolist()]
    if not part:
        raise ValueError('expected segments that move but found none')
    start = np.array([segment.start for segment in part])
    end = np.array([segment.end for segment in part])
    gap = np.linalg.norm(start[1:] - end[:-1], axis=1)
    if (gap > _GAP).any():
        first = int(np.argmax(gap > _GAP))
        raise ValueError(
            f'expected segments that follow each other but found a gap of {gap[first]:.6g} m '
            f'before line {part[first + 1].line}; sample each run by itself'
        )
    count = np.ceil(length[moving] / spacing * (1.0 - 1e-12)).astype(np.intp)
    count = np.maximum(count, 1)
    owner = np.repeat(np.arange(moving.size), count)
    offset = np.concatenate([[0], np.cumsum(count)])
    share = (np.arange(offset[-1]) - offset[owner]) / count[owner]
    point = np.empty((offset[-1] + 1, 3))
    point[:-1] = start[owner] + (end - start)[owner] * share[:, np.newaxis]
    point[-1] = end[-1]
    curvature = np.zeros(offset[-1] + 1)
    for index, segment in enumerate(part):
        if not isinstance(segment, LineSegment):
            steps = int(count[index])
            own = slice(offset[index], offset[index] + steps)
            point[own] = segment.points(steps)[:-1]
            bent = segment.curvatures(steps)
            curvature[own] = np.maximum(curvature[own], bent[:-1])
            curvature[own.stop] = bent[-1]
    return ProgramPoints(point, np.append(moving[owner], moving[-1]), curvature)
