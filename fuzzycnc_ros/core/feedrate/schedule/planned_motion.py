# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Planned motion along the stretch of a path that is still of use, and samples of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.pieces import Pieces
from fuzzycnc_ros.core.feedrate.motion.stream import MotionPart

_BATCH = 1024
"""Samples taken at a time."""
_SPARE = 256
"""Instants or pieces that have to be out of use before any is dropped."""


@dataclass(frozen=True, eq=False)
class PlannedSamples:
    """Samples one period apart: position and velocity (k, d) [m, m/s].

    `arc_length` is that from the start of the path, `speed` that along the path, both (k,)
    [m, m/s].
    """

    position: Array
    velocity: Array
    arc_length: Array
    speed: Array

    def __len__(self) -> int:
        return len(self.arc_length)

    @classmethod
    def join(cls, parts: list[PlannedSamples], axes: int) -> PlannedSamples:
        """Return samples that follow each other as one."""
        if not parts:
            return cls(np.empty((0, axes)), np.empty((0, axes)), np.empty(0), np.empty(0))
        names = ('position', 'velocity', 'arc_length', 'speed')
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """Motion before averaging, and the pieces that it leads along.

    Attributes
    ----------
    pieces : Pieces
        At least those that `arc_length` covers.
    rise : array, shape (m,)
        Largest change of speed that each of them leaves, for motion that is averaged [m/s^2].
    time, arc_length, speed, acceleration : array, shape (k,)
        From each instant on, the acceleration is constant until the next [s, m, m/s, m/s^2]; at
        rest before the first and after the last.
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
    def at_rest(cls, pieces: Pieces, window: float) -> PlannedMotion:
        """Return the motion that rests at the beginning of some pieces at time 0."""
        still = np.zeros(1)
        return cls(pieces, np.zeros(len(pieces)), still, pieces.place[:1], still, still, window)

    @property
    def end(self) -> float:
        """When the motion ends, average included [s]."""
        return float(self.time[-1]) + self.window

    @property
    def rests(self) -> float:
        """When the motion, average included, has come to its last place for good [s]."""
        arrived = int(np.searchsorted(self.arc_length, self.arc_length[-1]))
        return float(self.time[arrived]) + (self.window if arrived else 0.0)

    def extended(self, parts: Sequence[MotionPart]) -> PlannedMotion:
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
        return PlannedMotion(
            Pieces.join(pieces),
            np.concatenate(rise),
            time,
            arc_length,
            speed,
            acceleration,
            self.window,
        )

    def since(self, time: float) -> PlannedMotion:
        """Return the motion from the instant before a time on; the same if that is not less."""
        first = int(self._index(np.array([time]))[0])
        at = int(np.searchsorted(self.pieces.place, self.arc_length[first], 'right')) - 1
        at = int(np.clip(at, 0, len(self.pieces) - 1))
        if max(first, at) < _SPARE:
            return self
        return PlannedMotion(
            self.pieces.part(at, len(self.pieces)),
            self.rise[at:],
            self.time[first:],
            self.arc_length[first:],
            self.speed[first:],
            self.acceleration[first:],
            self.window,
        )

    def along(self, time: ArrayLike) -> tuple[Array, Array]:
        """Return arc length and speed along the path, averaged, at times (k,) [s]."""
        at = np.asarray(time, dtype=float)
        if self.window == 0.0:
            return self._plain(at)
        here, there = self._plain(at)[0], self._plain(at - self.window)[0]
        # Areas from a place and a time nearby, so that little cancels.
        first = self._index(at[:1] - self.window)[0]
        some = slice(first, self._index(at[-1:])[0] + 1)
        step = np.diff(self.time[some])
        origin = self.arc_length[first]
        area = np.append(
            0.0,
            np.cumsum(
                _area(
                    self.arc_length[some][:-1] - origin,
                    self.speed[some][:-1],
                    self.acceleration[some][:-1],
                    step,
                )
            ),
        )
        mean = (self._areas(at, area, first) - self._areas(at - self.window, area, first)) / (
            self.window
        )
        # At rest, the very place
        return np.where(here == there, here, origin + mean), (here - there) / self.window

    def sample(self, time: ArrayLike) -> PlannedSamples:
        """Return samples at rising times (k,) [s]."""
        at = np.asarray(time, dtype=float)
        found = []
        for begin in range(0, len(at), _BATCH):
            place, speed = self.along(at[begin : begin + _BATCH])
            position, tangent = self.on_path(place)
            velocity = tangent * speed[:, np.newaxis]
            speed = np.asarray(np.linalg.norm(velocity, axis=1))
            found.append(PlannedSamples(position, velocity, place, speed))
        return PlannedSamples.join(found, self.pieces.geometry.axes)

    def on_path(self, place: Array) -> tuple[Array, Array]:
        """Return positions and tangents at rising places (k,) [m]."""
        nodes = self.pieces.place
        low, high = np.searchsorted(nodes, [place.min(), place.max()], 'right') - 1
        low = int(np.clip(low, 0, len(self.pieces) - 1))
        geometry = self.pieces.geometry.part(low, max(int(high), low) + 1)
        local = place - nodes[low]
        return geometry.evaluate(local), geometry.evaluate(local, 1)

    def state(self, time: float) -> tuple[float, float, float]:
        """Return arc length and speed before averaging [m, m/s], and how long it rests then [s].

        The rest behind the last instant does not count.
        """
        at = int(self._index(np.array([time]))[0])
        place, speed = (float(found[0]) for found in self._plain(np.array([time])))
        rests = self.speed[at] == 0.0 and self.acceleration[at] == 0.0
        left = float(self.time[at + 1]) - time if rests and at + 1 < len(self.time) else 0.0
        return place, speed, left

    def passed(self, place: Array) -> Array:
        """Return when the motion left places that it has passed, shape (k,) [s]."""
        at = np.searchsorted(self.arc_length, place, 'right') - 1
        return np.asarray(self.time[np.maximum(at, 0)])

    def speed_at(self, place: Array) -> Array:
        """Return averaged speeds at places, shape (k,), none or more [m/s]."""
        if not len(place):
            return np.zeros(0)
        if self.window == 0.0:
            moving = np.append(np.diff(self.arc_length) > 0.0, True)
            square = self.speed[moving] ** 2
            return np.asarray(np.sqrt(np.interp(place, self.arc_length[moving], square)))
        low, high = np.full(len(place), self.time[0]), np.full(len(place), self.end)
        for _ in range(52):  # halves the interval down to the spacing of doubles
            middle = 0.5 * (low + high)
            order = np.argsort(middle)
            reached = np.empty(len(place))
            reached[order] = self.along(middle[order])[0]
            low, high = (
                np.where(reached >= place, low, middle),
                np.where(reached >= place, middle, high),
            )
        order = np.argsort(high)
        found = np.empty(len(place))
        found[order] = self.along(high[order])[1]
        return found

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

    def _plain(self, at: Array) -> tuple[Array, Array]:
        """Return arc length and speed before averaging."""
        index = self._index(at)
        since = np.maximum(at - self.time[index], 0.0)
        rise, speed = self.acceleration[index], self.speed[index]
        return (
            np.asarray(self.arc_length[index] + (speed + 0.5 * rise * since) * since),
            np.maximum(speed + rise * since, 0.0),
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


def _area(place: Array, speed: Array, rise: Array, since: Array) -> Array:
    return np.asarray(since * (place + since * (speed / 2.0 + rise * since / 6.0)))
