# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Friction that a moving reference will meet, fed forward, and how an observer learns it."""

from __future__ import annotations

from fuzzycnc_ros.core.servo.constants import Constant

_MEMORY = 0.05
"""Time of motion over which the disturbance seen in it is averaged [s]."""


class MovingDisturbance:
    """Disturbance observed while an axis moved, by direction.

    At rest friction takes whatever force there is, and the observer learns that instead: an axis
    that set off with it was up to 28 um behind or ahead.

    Parameters
    ----------
    period : float
        Control period [s].
    settle : float
        Time of motion after which the observer has found the disturbance [s].

    Examples
    --------
    >>> memory = MovingDisturbance(1e-3, settle=2e-3)
    >>> memory.reset(0.02)
    >>> memory.recall(1)
    0.02
    >>> for seen in 0.01, 0.03, 0.05:
    ...     memory.learn(1, seen)
    >>> memory.recall(1), memory.recall(-1)
    (0.05, 0.05)
    """

    def __init__(self, period: float, settle: float) -> None:
        self._share = period / _MEMORY
        self._settle = round(settle / period)
        self.reset(0.0)

    def reset(self, disturbance: float) -> None:
        """Forget what was seen; a disturbance [-] is all that is known."""
        self._first = disturbance
        self._seen: dict[int, float] = {}
        self._count = {1: 0, -1: 0}
        self.rest()

    def rest(self) -> None:
        """Note a period in which the axis may be at rest, or turns back."""
        self._moved = 0

    def learn(self, way: int, disturbance: float) -> None:
        """Take the disturbance [-] of a period of motion in the direction 1 or -1."""
        self._moved += 1
        if self._moved <= self._settle:
            return
        self._count[way] += 1
        before = self._seen.get(way, disturbance)
        share = max(1.0 / self._count[way], self._share)
        self._seen[way] = before + (disturbance - before) * share

    def constants(self) -> list[Constant]:
        """Return the numbers that it computes with."""
        return [
            Constant('SEEN_SHARE', self._share, '-', 'Share of a new disturbance in its mean'),
            Constant('SETTLE_PERIODS', self._settle, '', 'Motion before that is seen'),
        ]

    def recall(self, way: int) -> float:
        """Return the mean disturbance [-] of motion in a direction, else in the other one."""
        return self._seen.get(way, self._seen.get(-way, self._first))


class ReferenceFriction:
    """Coulomb friction that a moving reference will meet.

    Where the reference comes to rest it stays fed forward until the axis has arrived: the axis
    lags, and what is left of its way meets the same friction.

    Parameters
    ----------
    forward, backward : float
        Duty [-] that friction takes in positive and in negative motion, with the sign of the axis.

    Attributes
    ----------
    way : int
        Direction of the motion that is under way, 1 or -1; 0 for none.

    Examples
    --------
    >>> friction = ReferenceFriction(0.06, 0.04)
    >>> friction.reset()
    >>> friction.of(0.1, 0.0, 1e-5), friction.of(0.0, 0.0, 1e-6), friction.of(0.0, 0.0, 0.0)
    (0.06, 0.06, 0.0)
    >>> friction.of(-0.1, 0.0, 0.0)
    -0.04
    """

    def __init__(self, forward: float, backward: float) -> None:
        self._forward, self._backward = forward, backward
        self.reset()

    def reset(self) -> None:
        """Begin at rest."""
        self.way = 0

    def constants(self) -> list[Constant]:
        """Return the numbers that it computes with."""
        return [
            Constant('FRICTION_FORWARD', self._forward, '-', 'Duty of friction, forward'),
            Constant('FRICTION_BACKWARD', self._backward, '-', 'The same, backward'),
        ]

    def of(self, velocity: float, acceleration: float, error: float) -> float:
        """Return the friction [-] at a reference's motion [m/s, m/s^2] and an error [m]."""
        motion = velocity or acceleration  # it sets off in the period that begins
        if motion:
            self.way = 1 if motion > 0.0 else -1
        elif self.way and error * self.way <= 0.0:
            self.way = 0  # arrived
        return (0.0, self._forward, -self._backward)[self.way]
