# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Motion through timed waypoints, sampled by the period of a machine, and a way to rest on it.

Between two waypoints each axis moves on the polynomial that their values fix: of the third degree
by positions and velocities, of the fifth where accelerations are given too.  Waypoints without
velocities get those of the monotone interpolation of [fritsch1984], which never passes beyond a
waypoint.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array

_SHARES = (0.95, 0.8, 0.5, 0.25)
"""Shares of the largest braking that are tried for a way to rest; sampling rounds corners off."""
_ROOM = 1.005
"""Room that a sampled way to rest may take beyond a limit [-]."""
_NEIGHBOURS = np.arange(-1, 3)
"""Samples about the present one within which the motion of the next period lies."""


class WaypointCurve:
    """The curve through waypoints, from rest to rest.

    Parameters
    ----------
    time : ndarray, shape (n,)
        When each is passed, rising from 0 [s].
    position : ndarray, shape (n, axes)
        Waypoints [m].
    velocity, acceleration : ndarray, shape (n, axes), optional
        Those at the waypoints [m/s, m/s^2]; accelerations count beside velocities only.

    Examples
    --------
    >>> curve = WaypointCurve(np.array([0.0, 2.0]), np.array([[0.0], [0.1]]))
    >>> [round(float(value[0, 0]), 6) + 0.0 for value in curve.at(np.array([1.0]))]
    [0.05, 0.075, 0.0]
    """

    def __init__(
        self,
        time: Array,
        position: Array,
        velocity: Array | None = None,
        acceleration: Array | None = None,
    ) -> None:
        self._time, self.duration = time, float(time[-1])
        speed = _monotone(time, position) if velocity is None else velocity
        width = np.diff(time)[:, None]
        change = np.diff(position, axis=0)
        known = [position[:-1], speed[:-1]]
        if velocity is None or acceleration is None:
            slope = change / width
            known.append((3.0 * slope - 2.0 * speed[:-1] - speed[1:]) / width)
            known.append((speed[:-1] + speed[1:] - 2.0 * slope) / (width * width))
        else:
            known.append(0.5 * acceleration[:-1])
            # what is left to reach at the end of each piece, scaled to its width
            place = change - width * (known[1] + width * known[2])
            rate = width * (speed[1:] - known[1] - width * acceleration[:-1])
            bend = width * width * np.diff(acceleration, axis=0)
            cube = width * width * width
            known.append((10.0 * place - 4.0 * rate + 0.5 * bend) / cube)
            known.append((-15.0 * place + 7.0 * rate - bend) / (cube * width))
            known.append((6.0 * place - 3.0 * rate + 0.5 * bend) / (cube * (width * width)))
        self._known = np.stack(known)

    def at(self, time: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations, each shape (k, axes)."""
        piece = self.piece(time)
        since = (time - self._time[piece])[:, None]
        place, speed, bend = (np.zeros((len(time), self._known.shape[2])) for _ in range(3))
        for known in self._known[::-1, piece]:
            bend = bend * since + 2.0 * speed
            speed = speed * since + place
            place = place * since + known
        return place, speed, bend

    def piece(self, time: Array) -> NDArray[np.intp]:
        """Return which waypoint was passed last at each time, the last but one at most."""
        return np.clip(np.searchsorted(self._time, time, 'right') - 1, 0, len(self._time) - 2)


def _monotone(time: Array, position: Array) -> Array:
    """Return velocities at waypoints: 0 at both ends and where an axis turns back."""
    speed = np.zeros_like(position)
    width = np.diff(time)[:, None]
    slope = np.diff(position, axis=0) / width
    before, after = slope[:-1], slope[1:]
    first, second = 2.0 * width[1:] + width[:-1], width[1:] + 2.0 * width[:-1]
    same = before * after > 0.0
    with np.errstate(divide='ignore', invalid='ignore'):
        mean = (first + second) / (first / before + second / after)
    speed[1:-1] = np.where(same, mean, 0.0)
    return speed


@dataclass(frozen=True, eq=False)
class Sampled:
    """Samples of a motion: positions and velocities, shape (n, axes), way along it, shape (n,)."""

    position: Array
    velocity: Array
    arc_length: Array


class SampledCurve:
    """A curve in whole periods of a machine; it takes up to one period longer.

    Parameters
    ----------
    curve : WaypointCurve
        The curve.
    period : float
        Time between two samples [s].
    """

    def __init__(self, curve: WaypointCurve, period: float) -> None:
        count = max(1, int(np.ceil(curve.duration / period - 1e-9)))
        self._curve, self._period = curve, period
        self._rate = curve.duration / (count * period)
        self._time = np.linspace(0.0, curve.duration, count + 1)
        position, velocity, acceleration = curve.at(self._time)
        self._velocity = self._rate * velocity
        self._acceleration = self._rate * self._rate * acceleration
        steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
        self.samples = Sampled(position, self._velocity, np.append(0.0, np.cumsum(steps)))
        """All samples, from rest to rest."""

    def __len__(self) -> int:
        return len(self._time)

    def time(self, sample: float) -> float:
        """Return the time of the curve [s] at a sample, which need not be whole."""
        return min(max(sample, 0.0), len(self) - 1.0) * self._rate * self._period

    def part(self, low: int, high: int) -> Sampled:
        """Return the samples from `low` up to, but without, `high`."""
        every = self.samples
        return Sampled(
            every.position[low:high], every.velocity[low:high], every.arc_length[low:high]
        )

    def rest_after(self, sample: int, acceleration: float) -> Sampled:
        """Return a way to rest on the curve behind a sample, each axis within its acceleration.

        The curve is followed ever more slowly.  Where its own accelerations leave no room to
        brake, it is followed as it is; so such a way always exists and ends with the curve at the
        latest.

        Parameters
        ----------
        sample : int
            The last sample that is as before.
        acceleration : float
            Largest acceleration of an axis [m/s^2].
        """
        before = self.part(sample, sample + 1)
        most = _ROOM * acceleration * self._period
        for share in _SHARES:
            found = self._slowed(sample, share * acceleration)
            place = np.concatenate([before.position, found.position, found.position[-1:]])
            speed = np.concatenate([before.velocity, found.velocity])
            mean = np.vstack([before.velocity, np.diff(place, axis=0) / self._period])
            if all(
                np.abs(np.diff(values, axis=0)).max(initial=0.0) <= most
                for values in (mean[1:], speed)
            ):
                return found
        return self.part(sample + 1, len(self))

    def _slowed(self, sample: int, acceleration: float) -> Sampled:
        """Return the curve behind a sample, followed ever more slowly."""
        last = len(self) - 1.0
        place, rate = float(sample), 1.0  # both in samples
        places, rates = [], []
        while rate > 0.0 and place < last:
            room = self._braking(place, rate, acceleration)
            following = max(0.0, rate - room * self._period)
            place, rate = min(last, place + 0.5 * (rate + following)), following
            places.append(place)
            rates.append(rate)
        step = self._rate * self._period
        position, velocity, _ = self._curve.at(np.array(places) * step)
        speed = velocity * self._rate * np.array(rates)[:, None]
        speed[-1] = 0.0  # at rest, or at the end of the curve
        way = np.interp(places, np.arange(len(self)), self.samples.arc_length)
        return Sampled(position, speed, way)

    def _braking(self, place: float, rate: float, acceleration: float) -> float:
        """Return how fast the rate may fall [1/s] so that no axis passes its acceleration."""
        near = np.clip(int(place) + _NEIGHBOURS, 0, len(self) - 1)
        speed, bend = self._velocity[near], self._acceleration[near]
        room = acceleration + np.sign(speed) * bend * (rate * rate)
        with np.errstate(divide='ignore', invalid='ignore'):
            found = np.where(speed != 0.0, room / np.abs(speed), np.inf)
        return float(max(0.0, min(found.min(), 1.0 / self._period)))
