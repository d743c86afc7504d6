# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Where axes may be that follow tool paths: on the paths, and on the way to their beginnings."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fuzzycnc_ros.components.motion.tool_paths import tool_path_segments
from fuzzycnc_ros.core.feedrate.gcode.segments import NurbsSegment
from fuzzycnc_ros.runtime.records import Floats, ToolPath, Trajectory

SPACING = 1e-5
"""Distance of the points that a straight line is searched by [m]."""
CURVE_POINTS = 20_001
"""Points of a curve: the chords between them are less than 1 um off."""


class Programmed:
    """The places that some paths and the ways to them lead through.

    Parameters
    ----------
    paths : iterable of ToolPath
        The paths; those that no machine could follow lead nowhere.
    parts : iterable of Trajectory
        Parts of trajectories; the first of each path begins where the axes rest.
    """

    def __init__(self, paths: Iterable[ToolPath], parts: Iterable[Trajectory]) -> None:
        lines: dict[bytes, Floats] = {}
        starts: dict[str, list[Floats]] = {}
        for path in paths:
            key = b''.join([path.start.tobytes(), path.data.tobytes(), path.kind.tobytes()])
            if key not in lines:
                try:
                    lines[key] = _points(path)
                except ValueError:
                    continue
            starts.setdefault(path.path_id, []).append(lines[key][0])
        rapids: dict[bytes, Floats] = {}
        for part in parts:
            if part.part or not np.isfinite(part.position).all():
                continue
            rest = np.zeros(3)
            columns = ['XYZ'.index(name) for name in part.axis]
            rest[columns] = part.position[: len(columns)]
            for start in starts.get(part.path_id, ()):
                rapids.setdefault(np.append(rest, start).tobytes(), np.stack([rest, start]))
        self._lines = [_Line(line) for line in (*lines.values(), *rapids.values())]

    def distance(self, places: Floats) -> Floats:
        """Return how far places are from the nearest programmed one, shape (n,) [m].

        Parameters
        ----------
        places : ndarray, shape (n, 3)
            X, Y and Z [m].
        """
        found = np.full(len(places), np.inf)
        for line in self._lines:
            found = np.minimum(found, line.distance(places))
        return found


class _Line:
    """A polyline, searched by its points.

    Parameters
    ----------
    corner : ndarray, shape (n, 3)
        Its corners [m].
    """

    def __init__(self, corner: Floats) -> None:
        self._point = _dense(corner)
        self._tree = cKDTree(self._point)

    def distance(self, places: Floats) -> Floats:
        """Return how far places are from it, shape (n,) [m]."""
        nearest = np.asarray(self._tree.query(places)[1], dtype=np.int64)
        return np.minimum(
            self._to_piece(places, nearest), self._to_piece(places, np.maximum(nearest - 1, 0))
        )

    def _to_piece(self, places: Floats, first: NDArray[np.int64]) -> Floats:
        """Return the distance to the piece that begins at a point."""
        begin = self._point[first]
        along = self._point[np.minimum(first + 1, len(self._point) - 1)] - begin
        square = np.einsum('ij,ij->i', along, along)
        share = np.einsum('ij,ij->i', places - begin, along) / np.where(square, square, 1.0)
        foot = begin + np.clip(share, 0.0, 1.0)[:, None] * along
        return np.asarray(np.linalg.norm(places - foot, axis=1))


def _points(path: ToolPath) -> Floats:
    """Return the corners of a path and the points of its curves, shape (n, 3) [m]."""
    segments = tool_path_segments(path)
    rows = [np.array([segments.start])]
    for segment in segments[:]:
        if isinstance(segment, NurbsSegment):
            rows.append(segment.curve.point(np.linspace(*segment.curve.domain, CURVE_POINTS)))
        else:
            rows.append(np.array([segment.end]))
    return np.concatenate(rows)


def _dense(line: Floats) -> Floats:
    """Return a polyline with points in between where they lie far apart."""
    step = np.linalg.norm(np.diff(line, axis=0), axis=1)
    pieces = np.maximum(1, np.ceil(step / SPACING).astype(int))
    rows = [
        before + (after - before) * (np.arange(count)[:, None] / count)
        for before, after, count in zip(line[:-1], line[1:], pieces, strict=True)
    ]
    return np.concatenate([*rows, line[-1:]])
