# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories: positions over time within limits of velocity, acceleration and jerk.

Without limits of jerk the squared speed runs straight between the nodes (`axis_limits`).  With
them, the limits at each place are first shared out into the largest speed, acceleration and jerk
along the path; the fastest motion within speed and acceleration is then averaged over a window in
time (`stream`).  At stops the motion rests for the length of the window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.motion.pieces import Pieces, squares
from fuzzycnc_ros.core.feedrate.motion.stream import MotionPart, MotionStream, fastest_window
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry

_BATCH = 1024
"""Samples taken at a time."""
_SPARE = 256
"""Instants or pieces that have to be out of use before any is dropped."""


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """Samples of a trajectory: time (k,) [s]; derivatives of the position, each (k, d) [SI].

    `arc_length` is that from the start of the path, `speed` that along the path, both (k,)
    [m, m/s].
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    arc_length: Array
    speed: Array

    def __len__(self) -> int:
        return len(self.time)

    @classmethod
    def join(cls, parts: Sequence[MotionSamples], axes: int) -> MotionSamples:
        """Return samples that follow each other as one; `axes` is the number d."""
        row, table = np.empty(0), np.empty((0, axes))
        void = cls(row, table, table, table, row, row)
        rows = ([getattr(one, item.name) for one in (void, *parts)] for item in fields(cls))
        return cls(*(np.concatenate(row) for row in rows))


@dataclass(frozen=True, eq=False)
class PathMotion:
    """Motion along a path, or along the stretch of it that is still of use.

    `limit_motion` makes that of a whole path; `at_rest` and `extended` put together what a
    `MotionStream` returns.

    Attributes
    ----------
    pieces : Pieces
        At least those m that `arc_length` covers.
    rise : array, shape (m,)
        Largest change of speed that each of them leaves, for motion that is averaged [m/s^2].
    time, arc_length, speed, acceleration : array, shape (k,)
        Motion before averaging: from each instant on, the acceleration is constant until the
        next [s, m, m/s, m/s^2]; at rest before the first and after the last.
    window : float
        Length of the average [s]; 0 for none.
    """

    pieces: Pieces
    rise: Array
    time: Array
    arc_length: Array
    speed: Array
    acceleration: Array
    window: float

    @classmethod
    def at_rest(cls, pieces: Pieces, window: float) -> PathMotion:
        """Return the motion that rests at the beginning of some pieces at time 0."""
        still = np.zeros(1)
        return cls(pieces, np.zeros(len(pieces)), still, pieces.place[:1], still, still, window)

    @property
    def geometry(self) -> PathGeometry:
        """The pieces, node from 0."""
        return self.pieces.geometry

    @property
    def duration(self) -> float:
        """Time from the start of the path to the end of the motion, average included [s]."""
        return float(self.time[-1]) + self.window

    @property
    def rests(self) -> float:
        """Time at which the motion, average included, has come to its last place for good [s]."""
        arrived = int(np.searchsorted(self.arc_length, self.arc_length[-1]))
        return float(self.time[arrived]) + (self.window if arrived else 0.0)

    def extended(self, parts: Sequence[MotionPart]) -> PathMotion:
        """Return this motion and what follows it, one part or more."""
        pieces = [part.pieces for part in parts]
        rise = [np.zeros(len(part.pieces)) if part.rise is None else part.rise for part in parts]
        if self.pieces.place[-1] <= pieces[0].place[0]:
            pieces.insert(0, self.pieces)
            rise.insert(0, self.rise)
        time, arc_length, speed, acceleration = (
            np.concatenate(
                [
                    getattr(self, name)[:-1],
                    *(getattr(part, name)[:-1] for part in parts),
                    getattr(parts[-1], name)[-1:],
                ]
            )
            for name in ('time', 'arc_length', 'speed', 'acceleration')
        )
        return PathMotion(
            Pieces.join(pieces),
            np.concatenate(rise),
            time,
            arc_length,
            speed,
            acceleration,
            self.window,
        )

    def since(self, time: float) -> PathMotion:
        """Return the motion from the instant before a time on; the same if that is not less."""
        first = int(self._index(np.array([time]))[0])
        at = int(np.searchsorted(self.pieces.place, self.arc_length[first], 'right')) - 1
        at = int(np.clip(at, 0, len(self.pieces) - 1))
        if max(first, at) < _SPARE:
            return self
        return PathMotion(
            self.pieces.part(at, len(self.pieces)),
            self.rise[at:],
            self.time[first:],
            self.arc_length[first:],
            self.speed[first:],
            self.acceleration[first:],
            self.window,
        )

    def along(self, time: ArrayLike) -> tuple[Array, Array, Array]:
        """Return arc length, speed and acceleration along the path at times (k,) [s]."""
        at = np.asarray(time, dtype=float)
        order = np.argsort(at, kind='stable')
        found = np.empty((3, len(at)))
        for begin in range(0, len(at), _BATCH):
            some = order[begin : begin + _BATCH]
            found[:, some] = self._along(at[some])
        return found[0], found[1], found[2]

    def sample(self, period: float) -> MotionSamples:
        """Return samples every `period` [s] from 0; the last one is at or after the end.

        Raises
        ------
        ValueError
            If the period is not positive.
        """
        if not 0.0 < period < np.inf:
            raise ValueError(f'period: expected a positive number of s, but found {period}')
        return self.at(period * np.arange(int(np.ceil(self.duration / period - 1e-9)) + 1))

    def at(self, time: ArrayLike) -> MotionSamples:
        """Return samples at times (k,) [s]."""
        times = np.asarray(time, dtype=float)
        found = []
        for begin in range(0, len(times), _BATCH):
            some = times[begin : begin + _BATCH]
            place, speed, rise = self.along(some)
            position, tangent, bend = self._on_path(place)
            velocity = tangent * speed[:, np.newaxis]
            acceleration = tangent * rise[:, np.newaxis] + bend * np.square(speed[:, np.newaxis])
            speed = np.asarray(np.linalg.norm(velocity, axis=1))
            found.append(MotionSamples(some, position, velocity, acceleration, place, speed))
        return MotionSamples.join(found, self.geometry.axes)

    def state(self, time: float) -> tuple[float, float, float]:
        """Return arc length and speed before averaging [m, m/s], and how long it rests then [s].

        The rest behind the last instant does not count.
        """
        at = int(self._index(np.array([time]))[0])
        place, speed, _ = (float(found[0]) for found in self._plain(np.array([time])))
        rests = self.speed[at] == 0.0 and self.acceleration[at] == 0.0
        left = float(self.time[at + 1]) - time if rests and at + 1 < len(self.time) else 0.0
        return place, speed, left

    def passed(self, place: Array) -> Array:
        """Return when the motion left places that it has passed, shape (k,) [s]."""
        at = np.searchsorted(self.arc_length, place, 'right') - 1
        return np.asarray(self.time[np.maximum(at, 0)])

    def speed_at(self, arc_length: ArrayLike) -> Array:
        """Return the speeds at places on the path, shape (k,), none or more [m/s]."""
        place = np.asarray(arc_length, dtype=float)
        if self.window == 0.0:
            moving = np.append(np.diff(self.arc_length) > 0.0, True)
            square = np.square(self.speed[moving])
            return np.asarray(np.sqrt(np.interp(place, self.arc_length[moving], square)))
        low, high = np.full(len(place), self.time[0]), np.full(len(place), self.duration)
        for _ in range(52):  # halves the interval down to the spacing of doubles
            middle = 0.5 * (low + high)
            reached = self.along(middle)[0] >= place
            low, high = np.where(reached, low, middle), np.where(reached, middle, high)
        return self.along(high)[1]

    def until(self, time: float, square: float) -> tuple[Array, Array, Array, Array]:
        """Return the instants up to a time, where the motion is cut at a squared speed."""
        count = int(np.searchsorted(self.time, time, 'left'))
        place, _, _ = self.state(time)
        return (
            np.append(self.time[:count], time),
            np.append(self.arc_length[:count], place),
            np.append(self.speed[:count], np.sqrt(square)),
            np.append(self.acceleration[:count], 0.0),
        )

    def _index(self, at: Array) -> Array:
        return np.clip(np.searchsorted(self.time, at, 'right') - 1, 0, len(self.time) - 1)

    def _along(self, at: Array) -> tuple[Array, Array, Array]:
        """Return arc length, speed and acceleration along the path at rising times."""
        here, speed, rise = self._plain(at)
        if self.window == 0.0:
            return here, speed, rise
        there, speed_there, _ = self._plain(at - self.window)
        # Areas from a place and a time nearby, so that little cancels.
        first = self._index(at[:1] - self.window)[0]
        some = slice(first, self._index(at[-1:])[0] + 1)
        origin = self.arc_length[first]
        pieces = _area(
            self.arc_length[some][:-1] - origin,
            self.speed[some][:-1],
            self.acceleration[some][:-1],
            np.diff(self.time[some]),
        )
        area = np.append(0.0, np.cumsum(pieces))
        mean = (self._areas(at, area, first) - self._areas(at - self.window, area, first)) / (
            self.window
        )
        return (
            np.where(here == there, here, origin + mean),  # at rest, the very place
            (here - there) / self.window,
            (speed - speed_there) / self.window,
        )

    def _plain(self, at: Array) -> tuple[Array, Array, Array]:
        """Return arc length, speed and acceleration before averaging."""
        index = self._index(at)
        since = np.maximum(at - self.time[index], 0.0)
        rise, speed = self.acceleration[index], self.speed[index]
        return (
            np.asarray(self.arc_length[index] + (speed + 0.5 * rise * since) * since),
            np.maximum(speed + rise * since, 0.0),
            rise,
        )

    def _areas(self, at: Array, area: Array, first: int) -> Array:
        """Return integrals of arc length over time since instant `first`."""
        index = self._index(at)
        # Before the first instant the motion rests.
        since = at - self.time[index]
        moving = since >= 0.0
        return np.asarray(
            area[index - first]
            + _area(
                self.arc_length[index] - self.arc_length[first],
                np.where(moving, self.speed[index], 0.0),
                np.where(moving, self.acceleration[index], 0.0),
                since,
            )
        )

    def _on_path(self, place: Array) -> tuple[Array, Array, Array]:
        """Return positions and their first two derivatives at places (k,) [m]."""
        nodes = self.pieces.place
        low, high = np.searchsorted(nodes, [place.min(), place.max()], 'right') - 1
        low = int(np.clip(low, 0, len(self.pieces) - 1))
        geometry = self.geometry.part(low, max(int(high), low) + 1)
        local = place - nodes[low]
        return geometry.evaluate(local), geometry.evaluate(local, 1), geometry.evaluate(local, 2)


def _area(place: Array, speed: Array, rise: Array, since: Array) -> Array:
    return np.asarray(since * (place + since * (speed / 2.0 + rise * since / 6.0)))


def limit_motion(
    geometry: PathGeometry,
    speed: ArrayLike,
    limits: MotionLimits,
    *,
    window: float | None = None,
    feed_max: float | None = None,
) -> PathMotion:
    """Return the motion from rest to rest that follows desired speeds as far as limits allow.

    Parameters
    ----------
    geometry : PathGeometry
        Path of m segments; its corners are exact stops.
    speed : float or array, shape (m + 1,) or (m, 2)
        Desired speeds at the nodes, or at both ends of each segment where they jump, above 0
        [m/s]; lower values serve as given speeds of junctions.  In between the square is linear.
    limits : MotionLimits
        Kept at every moment.
    window : float, optional
        Length of the average [s]; by default the fastest of several with limits of jerk, and no
        average without.
    feed_max : float, optional
        Speed that segments are cut for [m/s]; by default the largest desired one.

    Raises
    ------
    ValueError
        If a speed is not positive and finite, a shape differs, or a number is out of its range.
    """
    pieces = Pieces.of_geometry(geometry, squares(speed, len(geometry.coefficient)))
    feed_max = feed_max or float(np.sqrt(pieces.square.max()))
    if window is None and limits.limits_jerk:
        window = fastest_window(pieces, limits.table(geometry.axes), feed_max)
    stream = MotionStream(limits, geometry.axes, feed_max=feed_max, window=window)
    parts = stream.take(pieces) + stream.finish()
    return PathMotion.at_rest(pieces, stream.window).extended(parts)
