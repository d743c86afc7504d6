# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One axis under control: where it is to be in each period, and the controller that sees to it."""

from math import isfinite, nan

from fuzzycnc_ros.components.servo.servo_plausibility import MotionDoubt, MotionWatch
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.profile import ProfileLimits, point_to_point

LONGEST_WAY = 600.0
"""Time that the way to a position may take [s]: it is held period by period."""

SAME_PLACE, STANDSTILL = 1e-12, 1e-9
"""Change of position [m] and velocity [m/s] that are rounding; paths leave 1e-17 and 1e-13."""

Way = list[tuple[float, float, float]]
"""Position, velocity and acceleration [m, m/s, m/s^2], period by period."""


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
    doubt : MotionDoubt, optional
        What its motion is judged by.

    Attributes
    ----------
    name, controller
        As given.
    motion : MotionWatch
        Judge of what its duties do.
    gain : float
        Factor on the controller's duty [-]: that of a trial, else 1.
    duty : float
        Duty of the last period [-].
    reference, velocity, acceleration : float
        Where the axis is to be [m], and how it is to move [m/s, m/s^2]; NaN before the first
        reading.
    """

    def __init__(
        self,
        name: str,
        controller: AxisController,
        travel: tuple[float, float],
        doubt: MotionDoubt | None = None,
    ) -> None:
        self.name, self.controller = name, controller
        self.motion = MotionWatch(controller.axis, controller.watch.limits, doubt)
        self._own = controller
        self._low, self._high = travel
        self.gain, self.duty = 1.0, 0.0
        self._silent = False
        self.release()

    @property
    def fault(self) -> str:
        """Why the axis is given up; empty while it is not."""
        return self.controller.watch.fault or self.motion.fault

    @property
    def moving(self) -> bool:
        """True while the axis is on the way to a position."""
        return self._next < len(self._rows)

    def release(self) -> None:
        """Forget where the axis is to be: it rests where the next reading finds it."""
        self.reference = float('nan')
        self.motion.reset()
        self.controller, self.gain, self.duty = self._own, 1.0, 0.0
        self.stop()

    def stop(self) -> None:
        """Stay where the axis is told to be now."""
        self.velocity = self.acceleration = 0.0
        self._rows: Way = []
        self._next = 0

    def hold(self, position: float) -> None:
        """Take control over where a reading [m] finds the axis at rest; a bad one is not taken."""
        if isfinite(position):
            self.controller.reset(position)
            self.reference = position

    def lend(self, controller: AxisController, gain: float, reading: float) -> None:
        """Have another controller drive the axis, with a factor on its duty.

        Parameters
        ----------
        controller : AxisController
            Takes over without a bump.
        gain : float
            Factor [-].
        reading : float
            Where the axis reads at rest [m].
        """
        controller.reset(reading, self.duty / gain)
        self.controller, self.gain = controller, gain

    def give_back(self, duty: float, reading: float) -> None:
        """Have the axis' own controller drive it again.

        Parameters
        ----------
        duty : float
            Duty that holds the axis at rest [-].
        reading : float
            Where it reads [m].
        """
        self._own.reset(reading, duty)
        self.controller, self.gain = self._own, 1.0

    def take_over(self, reading: float) -> None:
        """Have the controller that is there now decide the duty of this period."""
        self.duty = self.controller.step(self.reference, reading, self.velocity, self.acceleration)

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

    def way(self, target: float, limits: ProfileLimits) -> Way:
        """Return the way to a position [m] from the present motion.

        Raises
        ------
        ValueError
            If it leads beyond the travel or takes longer than `LONGEST_WAY`.
        """
        profile = point_to_point(
            self.reference,
            target,
            limits,
            velocity=self.velocity,
            acceleration=self.acceleration,
        )
        if not profile.duration <= LONGEST_WAY:
            raise ValueError(
                f'{self.name} would be on its way for more than {LONGEST_WAY:g} s; ask for a '
                'higher velocity or a nearer target'
            )
        way = profile.sample(self.controller.period)
        low, high = float(way.position.min()), float(way.position.max())
        # the axis itself may stand a little outside, and still come back
        if low < min(self._low, self.reference) or high > max(self._high, self.reference):
            raise ValueError(
                f'{self.name} moves too fast to come to rest within its travel on the way there'
            )
        columns = (way.position, way.velocity, way.acceleration)
        return list(zip(*(column.tolist() for column in columns), strict=True))

    def go(self, way: Way) -> None:
        """Go a way."""
        # the first row is the motion of the period before, which is over if there was any
        self._next = 1 if self.velocity or self.acceleration else 0
        self._rows = way

    def lead(self, position: float, velocity: float, acceleration: float) -> None:
        """Take where the axis is to be [m], and how it is to move in this period [m/s, m/s^2].

        An axis that rests while others move has the rounding of sums in its samples. It must not
        look like motion: friction would be fed forward for it, and the axis jump by 55 um.
        """
        change = abs(acceleration) * self.controller.period
        if abs(position - self.reference) <= SAME_PLACE and abs(velocity) + change <= STANDSTILL:
            position, velocity, acceleration = self.reference, 0.0, 0.0
        self.reference, self.velocity, self.acceleration = position, velocity, acceleration

    def step(self, reading: float) -> float:
        """Go on by a period; return the duty [-] for a reading [m], NaN where there is none."""
        watch = self.controller.watch
        if self._silent:
            watch.resume()
            self._silent = False
        duty = self._step(reading)
        if watch.bad:
            self.motion.interrupt()
        else:
            self.motion.judge(reading)
        return duty

    def bridge(self) -> float:
        """Go on by a period that nothing was heard of: the drive goes on as it was told last.

        It is no bad reading: how long silence may last is not for the controller to judge.
        """
        self._silent = True
        watch = self.controller.watch
        bad, total = watch.bad, watch.bad_total
        watch.bad = 0
        duty = self._step(nan)
        watch.bad, watch.bad_total = bad, total
        self.motion.interrupt()
        return duty

    def _step(self, reading: float) -> float:
        """Move the reference on by a period; return the duty [-]."""
        self.motion.hold(self.duty)
        if self._next < len(self._rows):
            self.reference, self.velocity, self.acceleration = self._rows[self._next]
            self._next += 1
        duty = self.controller.step(self.reference, reading, self.velocity, self.acceleration)
        top = self.controller.duty_max
        self.duty = min(max(self.gain * duty, -top), top)
        return self.duty
