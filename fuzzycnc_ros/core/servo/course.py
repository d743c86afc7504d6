# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A way there and back that controllers of an axis are judged by, and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.profile import ProfileLimits, point_to_point

REST = 0.3
"""Rest before, between and after the two ways [s]; the last third of those after is judged."""


@dataclass(frozen=True, kw_only=True)
class AxisFigures:
    """Figures of a controller in a case.

    Attributes
    ----------
    rms, largest, rest : float
        Following error [m]: RMS, largest, and RMS over the last parts of the rests.
    fault : str
        Why it gave up; empty if it did not.
    """

    rms: float
    largest: float
    rest: float
    fault: str = ''


@dataclass(frozen=True, eq=False)
class Course:
    """A way there and back, period by period.

    Attributes
    ----------
    rows : ndarray, shape (n, 3)
        Position from the start, velocity and acceleration of the reference [m, m/s, m/s^2].
    judged : ndarray of bool, shape (n,)
        Which periods are judged at rest.
    """

    rows: Array
    judged: NDArray[np.bool_]

    def figures(self, errors: Sequence[float] | Array) -> AxisFigures:
        """Return the figures of the following errors [m], shape (n,)."""
        found = np.asarray(errors, np.float64)
        return AxisFigures(
            rms=float(np.sqrt(np.square(found).mean())),
            largest=float(np.abs(found).max()),
            rest=float(np.sqrt(np.square(found[self.judged]).mean())),
        )


class LedCourse:
    """The same way along which somebody else leads an axis: over at the end of its second rest.

    Parameters
    ----------
    period : float
        Control period [s].
    """

    def __init__(self, period: float) -> None:
        self._rest = round(REST / period)
        self._still, self._moved, self._rests = 0, False, 0
        self._judged: list[bool] = []

    @property
    def over(self) -> bool:
        """True once the way there and back was made, each with its rest."""
        return self._rests >= 2

    @property
    def course(self) -> Course:
        """What was judged, without the way."""
        return Course(np.empty((len(self._judged), 0)), np.array(self._judged))

    def add(self, moves: bool) -> None:
        """Take a period in which the axis is to move, or to rest."""
        self._moved = self._moved or moves
        self._still = 0 if moves else self._still + 1
        rest = self._rest
        self._judged.append(self._moved and rest - rest // 3 < self._still <= rest)
        self._rests += self._moved and self._still == rest


def single_way(way: float, limits: ProfileLimits, period: float) -> Array:
    """Return position, velocity and acceleration over a way [m], shape (n, 3)."""
    course = point_to_point(0.0, way, limits).sample(period)
    return np.column_stack([course.position, course.velocity, course.acceleration])


def there_and_back(way: float, limits: ProfileLimits, period: float) -> Course:
    """Return a course: rest, a way [m], rest, the way back, rest."""
    there = single_way(way, limits, period)
    rest = round(REST / period)
    hold, end = np.zeros((rest, 3)), np.array([way, 0.0, 0.0])
    stay, back = hold + end, end - there
    rows = np.concatenate([hold, there, stay, back, hold])
    judged = np.zeros(len(rows), bool)
    late = rest // 3
    for place in (len(hold) + len(there) + len(stay), len(rows)):
        judged[place - late : place] = True
    return Course(rows, judged)
