# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recording programs: moves, slow reversals and a chirp that tell what an axis is like."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.profile import ProfileLimits, point_to_point

_REST = 0.25
"""Rest between two moves [s]."""

_MOVES = (0.30, -0.30, 0.08, -0.16, 0.02, 0.06, -0.02, 0.005, -0.005, -0.14, 0.02, 0.05)
"""Moves as shares of the travel, which end where they began but for the last."""

_PACES = (1.0, 0.6, 0.3)
"""Shares of the limits at which they are made, in turn."""

_CARRIER, _SWING = 0.3, 0.25
"""Speed of the slow motion that carries the chirp, and of the chirp, over the largest: an axis
that does not come to rest shows its spring and its dead time, not its friction."""

_RISE, _TURN = 0.6, 0.35
"""Accelerations of the chirp and of the carrier's turns, as share of the largest [-]."""

_SPAN = 0.3
"""Way of the carrier as share of the travel [-]."""


@dataclass(frozen=True, kw_only=True)
class ExcitationLimits:
    """Limits of a recording program.

    Parameters
    ----------
    low, high : float
        Positions between which it stays [m].
    velocity, acceleration : float
        Largest speed and acceleration [m/s, m/s^2].
    duty : float
        Largest duty where it commands the drive itself [-].
    frequency : float
        Where the chirp ends [Hz].
    seconds : float
        How long the chirp lasts [s].

    Raises
    ------
    ValueError
        If a limit is out of its range.
    """

    low: float
    high: float
    velocity: float
    acceleration: float
    duty: float = 0.4
    frequency: float = 200.0
    seconds: float = 16.0

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(
                f'travel: expected low below high but found {self.low}, {self.high} m'
            )
        for name in ('velocity', 'acceleration', 'frequency', 'seconds'):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f'{name}: expected more than 0 but found {getattr(self, name)}')
        if not 0.0 < self.duty <= 1.0:
            raise ValueError(f'duty: expected more than 0, at most 1, but found {self.duty}')


def chirp(start: float, end: float, seconds: float, period: float) -> tuple[Array, Array]:
    """Return phase [rad] and frequency [Hz] of a sweep that is as long in every octave."""
    time = period * np.arange(round(seconds / period))
    frequency = np.asarray(start * (end / start) ** (time / seconds), np.float64)
    return np.asarray(2.0 * pi * np.cumsum(frequency) * period), frequency


def position_program(limits: ExcitationLimits, period: float) -> Array:
    """Return set points for a loop that exists, from the middle of the travel and back.

    Parameters
    ----------
    limits : ExcitationLimits
        What it keeps to.
    period : float
        Time between two set points [s].

    Returns
    -------
    ndarray, shape (n,)
        Positions [m].
    """
    travel = limits.high - limits.low
    middle = limits.low + 0.5 * travel
    place, parts = middle, []
    rest = round(_REST / period)
    for number, share in enumerate(_MOVES):
        pace = _PACES[number % len(_PACES)]
        parts += [np.full(rest, place), _move(place, share * travel, limits, pace, period)]
        place += share * travel
    # slow reversals: what friction and backlash take, both ways
    for way in (0.01, -0.02, 0.02, -0.01):
        parts.append(_move(place, way * travel, limits, 0.06, period))
        place += way * travel
    parts += [_move(place, middle - place, limits, 0.5, period), np.full(rest, middle)]
    parts += [_chirp_on_carrier(middle, limits, period), np.full(rest, middle)]
    return np.concatenate(parts)


def duty_program(limits: ExcitationLimits, period: float) -> Array:
    """Return duties that are added to what holds the axis in the middle of its travel.

    Steps back and forth whose length keeps speed and way within the limits, as far as full duty
    gives no more than four times the acceleration; on these a chirp.

    Parameters
    ----------
    limits : ExcitationLimits
        What it keeps to.
    period : float
        Time between two duties [s].

    Returns
    -------
    ndarray, shape (n,)
        Duties [-].
    """
    half = 0.5 * limits.duty
    rise = 4.0 * limits.acceleration * half
    length = min(0.6 * limits.velocity / rise, (0.15 * (limits.high - limits.low) / rise) ** 0.5)
    length = min(max(length, 20.0 * period), 0.5)
    phase, _ = chirp(1.0, limits.frequency, limits.seconds, period)
    time = period * np.arange(len(phase))
    steps = half * np.sign(np.sin(pi * time / length + 0.5 * pi))
    pairs = [np.zeros(round(_REST / period))]
    for share in (1.0, 0.6, 0.3):
        size = round(length / period)
        pulse = np.repeat([1.0, -1.0, -1.0, 1.0, 0.0], size)
        pairs += [share * limits.duty * pulse, -share * limits.duty * pulse]
    return np.concatenate([*pairs, steps + half * np.sin(phase), pairs[0]])


def _move(place: float, way: float, limits: ExcitationLimits, pace: float, period: float) -> Array:
    velocity, acceleration = pace * limits.velocity, pace * limits.acceleration
    bounds = ProfileLimits(
        velocity=velocity, acceleration=acceleration, jerk=20.0 * limits.acceleration
    )
    return np.asarray(point_to_point(place, place + way, bounds).sample(period).position)


def _chirp_on_carrier(middle: float, limits: ExcitationLimits, period: float) -> Array:
    phase, frequency = chirp(1.0, limits.frequency, limits.seconds, period)
    angle = 2.0 * pi * frequency
    swing = np.minimum(
        _SWING * limits.velocity / angle, _RISE * limits.acceleration / (angle * angle)
    )
    fade = np.minimum(1.0, np.minimum(np.arange(len(phase)), np.arange(len(phase))[::-1]) * 2e-3)
    # back and forth at a steady speed, with rounded ends
    span = min(_SPAN * (limits.high - limits.low), 1.5 * _CARRIER * limits.velocity)
    beat = 2.0 * span / (_CARRIER * limits.velocity)
    # so round that the turn takes no more acceleration than its share
    sharp = _TURN * limits.acceleration * span / (pi * (_CARRIER * limits.velocity) ** 2)
    sharp = min(sharp / (1.0 + sharp * sharp) ** 0.5, 0.98)
    turn = 2.0 * pi * np.arange(len(phase)) * period / beat
    carrier = (span / pi) * np.arcsin(sharp * np.sin(turn))
    return np.asarray(middle + fade * (carrier + swing * np.sin(phase)))
