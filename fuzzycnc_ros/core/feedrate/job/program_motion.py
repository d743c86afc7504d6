# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The time that scheduled paths take within the limits of a machine, part by part."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.job.settings import AXES, ProgramSettings
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.stream import MotionPart, MotionStream
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry
from fuzzycnc_ros.core.feedrate.reference.nodes import own_curvature, with_ramps
from fuzzycnc_ros.core.feedrate.reference.reference_path import ReferencePath
from fuzzycnc_ros.core.feedrate.schedulers.approach import APPROACH

_GATHERED = 4096
"""Pieces that are gathered before they are driven: a stream costs time for each push."""

_STRAIGHT = 1e-6
"""Turn of a piece up to which it is straight [rad]; rounding of doubles stays below."""


class ProgramMotion:
    """Time of the motion along paths that arrive in parts, at rest before and after each run.

    Parameters
    ----------
    settings : ProgramSettings
        Limits, rest at stops and the machine constant.

    Attributes
    ----------
    duration : float
        Time of what is over [s]; all of it after `finish`.
    acceleration : float
        Largest acceleration across the path, curvature times squared speed, with what braking
        before a bend adds and speeding up out of it takes away [m/s^2].  The contour error is no
        more than the machine constant times this: in bends that are over before the axes react
        less.
    """

    def __init__(self, settings: ProgramSettings) -> None:
        self._settings = settings
        velocity, rise, _ = settings.limits.table(AXES)
        self._speed_max = min(float(velocity[0]), float(np.linalg.norm(velocity[1:])))
        self._ramp = float(rise.min())
        self._stream: MotionStream | None = None
        self._running = 0.0  # time of the stream
        self._place = 0.0
        self._kept: list[tuple[ReferencePath, Array]] = []
        self._pieces = 0
        self.duration = 0.0
        self.acceleration = 0.0

    def push(self, path: ReferencePath, speed: Array) -> None:
        """Take the next part, with the speeds wanted at both ends of its pieces, (m, 2) [m/s]."""
        speed = np.minimum(speed, self._speed_max)
        self.duration += self._settings.settle * int(path.stop[1:].sum())
        if not self._settings.limits.limits_jerk:
            path, speed = self._without_lines(path, speed)
            if not len(speed):
                return
        self._kept.append((path, speed))
        self._pieces += len(speed)
        if self._pieces >= _GATHERED:
            self._drive()

    def finish(self) -> None:
        """Come to rest."""
        self._drive()
        if self._stream is not None:
            self._take(self._stream.finish())
            self.duration += self._running + self._stream.window
            self._stream = None

    def _without_lines(self, path: ReferencePath, speed: Array) -> tuple[ReferencePath, Array]:
        """Count lines of one feed between stops, whose times are a formula; return the rest."""
        geometry = path.geometry
        fence = np.flatnonzero(path.stop)
        if len(fence) < 2:
            return path, speed
        first, last = fence[:-1], fence[1:] - 1
        turn = own_curvature(geometry).max(axis=1) * np.diff(geometry.node)
        ends = np.append(first, fence[-1])  # the last one only closes the span before it
        bent, low, high = (
            choose.reduceat(np.append(values, values[-1:]), ends)[:-1]
            for choose, values in (
                (np.maximum, turn),
                (np.minimum, speed.min(axis=1)),
                (np.maximum, speed.max(axis=1)),
            )
        )
        alone = (bent < _STRAIGHT) & (low == high)
        if alone.any():
            way = geometry.coefficient[last[alone], -1] - geometry.coefficient[first[alone], 0]
            time = straight_time(way, low[alone], self._settings.limits)
            self.duration += float(time.sum())
        rest = np.ones(len(speed), bool)
        rest[first[0] : fence[-1]] = ~np.repeat(alone, fence[1:] - fence[:-1])
        if not rest.any():
            return path, speed[:0]
        return _chosen(path, rest), speed[rest]

    def _drive(self) -> None:
        if not self._kept:
            return
        path, speed = _joined(self._kept, self._place)
        self._kept, self._pieces = [], 0
        self._place += path.geometry.length
        if self._stream is None:
            self._stream = MotionStream(
                self._settings.limits,
                AXES,
                feed_max=self._speed_max,
                window=self._settings.window,
            )
        self._take(self._stream.push(*with_ramps(path, speed, self._ramp)))

    def _take(self, parts: list[MotionPart]) -> None:
        for part in parts:
            self._running = float(part.time[-1])
            node = part.place + part.geometry.node
            moving = np.append(np.diff(part.arc_length) > 0.0, True)
            square = np.interp(node, part.arc_length[moving], part.speed[moving] ** 2)
            speed = np.sqrt(square)
            bend = own_curvature(part.geometry)
            across = square * self._approach(node, speed)
            most = self._turned(speed)
            for column, nodes in ((0, slice(None, -1)), (1, slice(1, None))):
                sharp = np.minimum(bend[:, column] * across[nodes], most[nodes])
                self.acceleration = max(self.acceleration, float(sharp.max()))

    def _turned(self, speed: Array) -> Array:
        """Return the acceleration whose error no bend exceeds, however sharp it is [m/s^2].

        Where the path turns back on the spot, axes with a position gain Kv stay v/Kv behind;
        C is about 1/(2 Kv^2).
        """
        return np.asarray(speed * sqrt(2.0 / self._settings.machine_constant))

    def _approach(self, node: Array, speed: Array) -> Array:
        """Return what the approach to each node adds to its contour error, as a factor."""
        behind = node - APPROACH * sqrt(self._settings.machine_constant) * speed
        before = np.interp(behind, node, speed)
        moving = speed > 0.0
        return np.where(moving, 0.5 + 0.5 * before / np.where(moving, speed, 1.0), 1.0)


def rest_to_rest(start: ArrayLike, end: ArrayLike, limits: MotionLimits) -> float:
    """Return the least time of a straight rapid from rest to rest within the limits of the axes.

    Parameters
    ----------
    start, end : array_like, shape (3,)
        Its ends [m].
    limits : MotionLimits
        Those of the axes count; of a quantity that has none of these, that of the path.

    Returns
    -------
    float
        Time [s]; NaN if an end is unknown.

    Examples
    --------
    >>> limits = MotionLimits(velocity=(0.25, 0.25, 0.1), acceleration=(4.0, 4.0, 2.0))
    >>> rest_to_rest([0.0, 0.0, 0.0], [0.3, 0.0, -0.1], limits)
    1.2625
    """
    way = np.subtract(end, start, dtype=float)
    length = float(np.linalg.norm(way))
    if not isfinite(length) or length == 0.0:
        return length
    own: dict[str, Any] = {
        f'path_{name}': np.inf
        for name in ('velocity', 'acceleration', 'jerk')
        if np.isfinite(getattr(limits, name) or (np.inf,)).all()
    }
    rapid = replace(limits, **own)
    return float(straight_time(way[np.newaxis], np.array([np.inf]), rapid)[0])


def straight_time(way: Array, speed: Array, limits: MotionLimits) -> Array:
    """Return the least times of straight ways from rest to rest.

    Parameters
    ----------
    way : ndarray, shape (k, d)
        From start to end [m], not zero.
    speed : ndarray, shape (k,)
        Largest speeds [m/s]; infinite for those of the limits.
    limits : MotionLimits
        Kept by the path and by every axis, jerk included.

    Returns
    -------
    ndarray, shape (k,)
        Times [s].
    """
    length = np.linalg.norm(way, axis=1)
    share = np.column_stack([np.ones(len(way)), np.abs(way) / length[:, np.newaxis]])
    with np.errstate(divide='ignore'):
        velocity, rise, jolt = ((row / share).min(axis=1) for row in limits.table(way.shape[1]))
    top = np.minimum(speed, velocity)
    build = rise / jolt  # time in which acceleration is there; 0 without a limit of jerk
    with np.errstate(invalid='ignore'):
        # To full speed and back to rest, in units of the mean speed
        ramp = np.where(top < rise * build, 2.0 * np.sqrt(top / jolt), top / rise + build)
        short = np.where(
            length >= 2.0 * rise * build**2,
            build + np.sqrt(build**2 + 4.0 * length / rise),
            4.0 * np.cbrt(0.5 * length / jolt),
        )
    return np.asarray(np.where(length >= top * ramp, length / top + ramp, short))


def _chosen(path: ReferencePath, pieces: NDArray[np.bool_]) -> ReferencePath:
    """Return a path without some pieces that lie between stops; arc length closes up."""
    if pieces.all():
        return path
    length = np.diff(path.geometry.node)[pieces]
    nodes = np.append(pieces, False)
    last = int(np.flatnonzero(pieces)[-1]) + 1
    nodes[last] = True
    nodes[last + 1 :] = False
    # Where pieces are left out, the node before them is the same stop as the one behind.
    stop = path.stop[nodes]
    inner = stop.copy()
    inner[[0, -1]] = False
    return ReferencePath(
        PathGeometry(path.geometry.coefficient[pieces], np.append(0.0, np.cumsum(length)), inner),
        0.0,
        path.curvature[nodes],
        path.owner[pieces],
        path.blend[pieces],
        path.feed[pieces],
        stop,
        path.rest[nodes],
    )


def _joined(parts: list[tuple[ReferencePath, Array]], place: float) -> tuple[ReferencePath, Array]:
    """Return parts as one path from an arc length on; runs are put end to end."""
    paths = [path for path, _ in parts]
    length = np.concatenate([np.diff(path.geometry.node) for path in paths])

    def nodes(name: str) -> Any:
        first = [getattr(paths[0], name)[:1]]
        return np.concatenate(first + [getattr(path, name)[1:] for path in paths])

    def pieces(name: str) -> Any:
        return np.concatenate([getattr(path, name) for path in paths])

    stop = nodes('stop')
    inner = stop.copy()
    inner[[0, -1]] = False
    geometry = PathGeometry(
        np.concatenate([path.geometry.coefficient for path in paths]),
        np.append(0.0, np.cumsum(length)),
        inner,
    )
    return ReferencePath(
        geometry,
        place,
        nodes('curvature'),
        pieces('owner'),
        pieces('blend'),
        pieces('feed'),
        stop,
        nodes('rest'),
    ), np.concatenate([speed for _, speed in parts])
