# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Jerk-limited point-to-point profiles of one axis, from rest or from any motion.

The axis first takes its acceleration down to zero, then goes to one steady velocity, keeps it for
a while and comes to rest at the target; each change of velocity is a pulse of acceleration that
rises and falls with the largest jerk.  From rest that is the fastest profile there is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import copysign, isfinite, sqrt

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array

_HALVINGS = 80
"""Halvings of the velocity's interval; beyond the digits of a double."""


@dataclass(frozen=True, kw_only=True)
class ProfileLimits:
    """Largest velocity [m/s], acceleration [m/s^2] and jerk [m/s^3] of a profile.

    Raises
    ------
    ValueError
        If one is not positive and finite.
    """

    velocity: float = 0.2
    acceleration: float = 1.5
    jerk: float = 30.0

    def __post_init__(self) -> None:
        for name in ('velocity', 'acceleration', 'jerk'):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0.0):
                raise ValueError(f'{name}: expected a positive number but found {value}')


@dataclass(frozen=True, eq=False)
class Profile:
    """Motion in phases of constant jerk.

    Attributes
    ----------
    time : ndarray, shape (k + 1,)
        Beginnings of the phases and the end [s].
    jerk : ndarray, shape (k,)
        Jerk in each [m/s^3].
    position, velocity, acceleration : ndarray, shape (k + 1,)
        Motion at those times [m, m/s, m/s^2].
    """

    time: Array
    jerk: Array
    position: Array
    velocity: Array
    acceleration: Array

    @property
    def duration(self) -> float:
        """Time from start to rest at the target [s]."""
        return float(self.time[-1])

    def at(self, time: ArrayLike) -> tuple[Array, Array, Array]:
        """Return position [m], velocity [m/s] and acceleration [m/s^2] at times [s].

        Before the start they are those of the start, after the end the axis rests.
        """
        when = np.clip(np.asarray(time, dtype=float), 0.0, self.duration)
        phase = np.clip(np.searchsorted(self.time, when, 'right') - 1, 0, len(self.jerk) - 1)
        since = when - self.time[phase]
        jerk, rise = self.jerk[phase], self.acceleration[phase]
        speed, place = self.velocity[phase], self.position[phase]
        over = np.asarray(time, dtype=float) >= self.duration
        return (
            np.where(
                over,
                self.position[-1],
                place + since * (speed + since * (rise / 2.0 + since * jerk / 6.0)),
            ),
            np.where(over, 0.0, speed + since * (rise + since * jerk / 2.0)),
            np.where(over, 0.0, rise + since * jerk),
        )

    def sample(self, period: float) -> Reference:
        """Return the profile every `period` [s]; the last sample is at rest on the target."""
        if not 0.0 < period < np.inf:
            raise ValueError(f'period: expected a positive number of s but found {period}')
        count = int(np.ceil(self.duration / period - 1e-9)) + 1
        return Reference(*self.at(period * np.arange(count)), period)


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference of an axis in each control period; afterwards it rests at the end.

    Attributes
    ----------
    position, velocity, acceleration : ndarray, shape (n,)
        Motion [m, m/s, m/s^2].
    period : float
        Control period [s].

    Raises
    ------
    ValueError
        If the shapes differ, there is no sample, or a number is not finite.
    """

    position: Array
    velocity: Array
    acceleration: Array
    period: float

    def __post_init__(self) -> None:
        shapes = {np.shape(part) for part in (self.position, self.velocity, self.acceleration)}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1 or not len(self.position):
            raise ValueError(
                'Reference: expected one position, velocity and acceleration per period, but '
                f'found the shapes {sorted(shapes)}'
            )
        if not np.isfinite([self.position, self.velocity, self.acceleration]).all():
            raise ValueError('Reference: expected finite numbers only')

    def over(self, duration: float | None) -> tuple[Array, Array, Array]:
        """Return the motion over a duration [s], by default its own; it rests at its end."""
        if duration is None:
            return self.position, self.velocity, self.acceleration
        count = round(duration / self.period)
        more = max(count - len(self.position), 0)
        return (
            np.pad(self.position, (0, more), mode='edge')[:count],
            np.pad(self.velocity, (0, more))[:count],
            np.pad(self.acceleration, (0, more))[:count],
        )


def step_reference(target: float, period: float) -> Reference:
    """Return a step to a target [m]."""
    return Reference(np.array([target]), np.zeros(1), np.zeros(1), period)


def point_to_point(
    start: float,
    target: float,
    limits: ProfileLimits | None = None,
    *,
    velocity: float = 0.0,
    acceleration: float = 0.0,
) -> Profile:
    """Return a jerk-limited motion to rest at a target.

    Parameters
    ----------
    start, target : float
        Where the motion begins and ends [m].
    limits : ProfileLimits, optional
        Limits; 0.2 m/s, 1.5 m/s^2 and 30 m/s^3 by default.
    velocity, acceleration : float
        Motion at the beginning [m/s, m/s^2], for a target that changes on the way.  Beyond the
        limits it is brought back within them.

    Raises
    ------
    ValueError
        If a number is not finite.

    Notes
    -----
    From rest it is the fastest motion within the limits.  From motion it passes through zero
    acceleration first, which costs at most acceleration / jerk seconds.

    Examples
    --------
    >>> profile = point_to_point(0.0, 0.05)
    >>> round(profile.duration, 4), round(float(profile.velocity.max()), 4)
    (0.4333, 0.2)
    """
    bounds = limits or ProfileLimits()
    for name, value in (('start', start), ('target', target), ('velocity', velocity)):
        if not isfinite(value):
            raise ValueError(f'{name}: expected a finite number but found {value}')
    if not isfinite(acceleration):
        raise ValueError(f'acceleration: expected a finite number but found {acceleration}')
    phases: list[tuple[float, float]] = []
    speed, way = velocity, target - start
    if acceleration:
        calm = abs(acceleration) / bounds.jerk
        phases.append((calm, -copysign(bounds.jerk, acceleration)))
        way -= calm * (velocity + calm * acceleration / 3.0)
        speed += 0.5 * calm * acceleration
    steady = _steady_velocity(way, speed, bounds)
    phases.extend(_change(speed, steady, bounds))
    left = way - _way(speed, steady, bounds) - _way(steady, 0.0, bounds)
    if steady and left / steady > 0.0:
        phases.append((left / steady, 0.0))
    phases.extend(_change(steady, 0.0, bounds))
    return _assembled(phases, (start, velocity, acceleration), target)


def _assembled(
    phases: list[tuple[float, float]], start: tuple[float, float, float], target: float
) -> Profile:
    """Return the motion that phases of duration and jerk make of a start."""
    if not phases:
        phases = [(0.0, 0.0)]
    courses = [start]
    for time, jerk in phases:
        place, speed, rise = courses[-1]
        courses.append(
            (
                place + time * (speed + time * (rise / 2.0 + time * jerk / 6.0)),
                speed + time * (rise + time * jerk / 2.0),
                rise + time * jerk,
            )
        )
    # what rounding has left over
    courses[-1] = (target, 0.0, 0.0)
    position, velocity, acceleration = np.array(courses).T
    durations, jerks = np.array(phases).T
    return Profile(np.append(0.0, np.cumsum(durations)), jerks, position, velocity, acceleration)


def _steady_velocity(way: float, velocity: float, limits: ProfileLimits) -> float:
    """Return the velocity that, reached and left again, covers the way or less."""

    def reach(steady: float) -> float:
        return _way(velocity, steady, limits) + _way(steady, 0.0, limits)

    stopping = reach(0.0)
    top = limits.velocity
    if way == stopping:
        return 0.0
    # the way grows with the steady velocity between these
    if way > stopping:
        low, high = velocity if 0.0 < velocity <= top else 0.0, top
    else:
        low, high = -top, velocity if -top <= velocity < 0.0 else 0.0
    if way > stopping and reach(high) <= way:
        return high
    if way < stopping and reach(low) >= way:
        return low
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if reach(middle) < way else (low, middle)
    return low if way > stopping else high


def _time(change: float, limits: ProfileLimits) -> float:
    """Return how long a change of velocity takes [s]."""
    size = abs(change)
    if size * limits.jerk < limits.acceleration * limits.acceleration:
        return 2.0 * sqrt(size / limits.jerk)
    return size / limits.acceleration + limits.acceleration / limits.jerk


def _way(first: float, last: float, limits: ProfileLimits) -> float:
    """Return the way covered during a change of velocity [m]: the mean of both, all the time."""
    return 0.5 * (first + last) * _time(last - first, limits)


def _change(first: float, last: float, limits: ProfileLimits) -> Iterator[tuple[float, float]]:
    """Yield duration [s] and jerk [m/s^3] of the phases of a change of velocity."""
    if first == last:
        return
    jerk = limits.jerk if last > first else -limits.jerk
    whole = _time(last - first, limits)
    ramp = min(limits.acceleration / limits.jerk, 0.5 * whole)
    yield ramp, jerk
    if whole > 2.0 * ramp:
        yield whole - 2.0 * ramp, 0.0
    yield ramp, -jerk
