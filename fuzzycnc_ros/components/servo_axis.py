# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One axis under control: where it is to be in each period, and the controller that sees to it."""

from math import isfinite

from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.profile import ProfileLimits, point_to_point


class ServoAxis:
    """An axis that rests, goes to a position along a jerk-limited profile, or is led.

    Parameters
    ----------
    name : str
        Name of the axis.
    controller : AxisController
        Its controller.
    travel : tuple of float
        Lowest and highest position that it is sent to [m].

    Attributes
    ----------
    name, controller
        As given.
    reference, velocity, acceleration : float
        Where the axis is to be [m], and how it is to move [m/s, m/s^2]; NaN before the first
        reading.
    """

    def __init__(self, name: str, controller: AxisController, travel: tuple[float, float]) -> None:
        self.name, self.controller = name, controller
        self._low, self._high = travel
        self.release()

    @property
    def moving(self) -> bool:
        """Whether the axis is on the way to a position."""
        return self._next < len(self._rows)

    def release(self) -> None:
        """Forget where the axis is to be: it rests where the next reading finds it."""
        self.reference = float('nan')
        self.stop()

    def stop(self) -> None:
        """Stay where the axis is told to be now."""
        self.velocity = self.acceleration = 0.0
        self._rows: list[tuple[float, float, float]] = []
        self._next = 0

    def hold(self, position: float) -> None:
        """Take control over where a reading [m] finds the axis at rest; a bad one is not taken."""
        if isfinite(position):
            self.controller.reset(position)
            self.reference = position

    def refusal(self, target: float, velocity: float) -> str:
        """Say why the axis is not sent to a position [m] so fast [m/s]; empty if it may be."""
        if not self._low <= target <= self._high:  # also NaN
            return (
                f'position: expected {self.name} within {1e3 * self._low:g} to '
                f'{1e3 * self._high:g} mm but found {1e3 * target:g} mm'
            )
        if velocity == velocity and not velocity > 0.0:
            return f'velocity: expected more than 0 m/s for {self.name} but found {velocity}'
        return ''

    def go(self, target: float, limits: ProfileLimits) -> str:
        """Go to a position [m] from the present motion; return why not, or nothing."""
        profile = point_to_point(
            self.reference,
            target,
            limits,
            velocity=self.velocity,
            acceleration=self.acceleration,
        )
        way = profile.sample(self.controller.period)
        low, high = float(way.position.min()), float(way.position.max())
        # the axis itself may stand a little outside, and still come back
        if low < min(self._low, self.reference) or high > max(self._high, self.reference):
            return f'{self.name} moves too fast to come to rest within its travel on the way there'
        under_way = bool(self.velocity or self.acceleration)
        columns = (way.position, way.velocity, way.acceleration)
        self._rows = list(zip(*(column.tolist() for column in columns), strict=True))
        # the first row is the motion of the period before, which is over if there was any
        self._next = 1 if under_way else 0
        return ''

    def lead(self, position: float, velocity: float) -> None:
        """Take where the axis is to be in this period [m], and how fast it is to move [m/s]."""
        self.acceleration = (velocity - self.velocity) / self.controller.period
        self.reference, self.velocity = position, velocity

    def step(self, reading: float) -> float:
        """Go on by a period; return the duty [-] for a reading [m], NaN where there is none."""
        if self._next < len(self._rows):
            self.reference, self.velocity, self.acceleration = self._rows[self._next]
            self._next += 1
        return self.controller.step(self.reference, reading, self.velocity, self.acceleration)
