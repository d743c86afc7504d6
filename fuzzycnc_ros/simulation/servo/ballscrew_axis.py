# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A real ball-screw axis from its published parameters: the EMPS benchmark.

References
----------
A. Janot, M. Gautier, M. Brunot: Data set and reference models of EMPS. Workshop on Nonlinear
System Identification Benchmarks, 2019.
"""

from __future__ import annotations

from math import exp, log1p

from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.simulation.servo.axis_plant import AxisPlant, DutyDelay
from fuzzycnc_ros.simulation.servo.position_sensor import PositionSensor


class BallscrewAxis(AxisPlant):
    """The EMPS axis; a duty of 1 is 10 V.

    Between two stops the motion is an exponential, which is followed exactly up to the moment of
    each stop; there the axis sticks or turns round.

    Parameters
    ----------
    config : BallscrewAxisConfig, optional
        Axis, sensor and faults.
    position, velocity : float
        Where the slide is [m] and how it moves [m/s] at the beginning.

    Examples
    --------
    >>> axis = BallscrewAxis()
    >>> for _ in range(1000):
    ...     axis.drive(0.04)
    >>> axis.position
    0.0
    >>> for _ in range(1000):
    ...     axis.drive(0.2)
    >>> f'{axis.position:.4f} {axis.velocity:.4f}'
    '0.1533 0.2301'
    """

    def __init__(
        self,
        config: BallscrewAxisConfig | None = None,
        *,
        position: float = 0.0,
        velocity: float = 0.0,
    ) -> None:
        self._config = config = config or BallscrewAxisConfig()
        self.period = config.period
        self.duty_max = config.duty_max
        self._sensor = PositionSensor(config, self.period)
        self._velocity = velocity
        self._screw = self._slide = position
        self._step = 0
        self._load_step = round(config.load_time / self.period)
        self._delay = DutyDelay(config.delay, self.period)
        self._drive = 0.0
        self._mass = config.mass * config.mass_factor
        factor = config.friction_factor
        # (sign of motion, viscous, Coulomb, breakaway)
        self._forward, self._backward = (
            (sign, factor * viscous, factor * coulomb, config.breakaway_ratio * factor * coulomb)
            for sign, viscous, coulomb in (
                (1.0, config.viscous_forward, config.coulomb_forward),
                (-1.0, config.viscous_backward, config.coulomb_backward),
            )
        )

    @property
    def position(self) -> float:
        """True position of the slide [m]."""
        return self._slide

    @property
    def velocity(self) -> float:
        """True velocity of the slide [m/s]; 0 while the screw turns through backlash."""
        free = abs(self._screw - self._slide) < 0.5 * self._config.backlash
        return 0.0 if free else self._velocity

    def measure(self) -> float:
        """Return the position as the sensor gives it now [m]; NaN while it gives none."""
        return self._sensor.read(self._screw if self._config.sensor == 'encoder' else self._slide)

    def drive(self, duty: float) -> None:
        """Hold a duty [-] for one period; refuses one that is not finite."""
        config = self._config
        acting = self._delay.of(self._cut(duty))
        if config.drive_lag:
            acting = self._lagged(acting)
        force = config.direction * config.gain_factor * config.force_max * acting
        force -= config.offset + (config.load if self._step >= self._load_step else 0.0)
        left, velocity = self.period, self._velocity
        while left > 0.0:
            sign, viscous, coulomb, breakaway = (
                self._forward
                if velocity > 0.0 or (velocity == 0.0 and force > 0.0)
                else self._backward
            )
            if velocity == 0.0 and abs(force) <= breakaway:
                break
            if config.stribeck_velocity:
                ratio = velocity / config.stribeck_velocity
                coulomb += (breakaway - coulomb) * exp(-ratio * ratio)
            steady, lag = (force - sign * coulomb) / viscous, self._mass / viscous
            stops = sign * velocity > 0.0 > sign * steady
            time = min(lag * log1p(-velocity / steady), left) if stops else left
            keep = exp(-time / lag)
            self._move(steady * time + (velocity - steady) * lag * (1.0 - keep))
            velocity = 0.0 if time < left else steady + (velocity - steady) * keep
            left -= time
        self._velocity = velocity
        self._step += 1
        self._sensor.advance()

    def linear(self) -> LinearAxis:
        """Return the nominal linear model: without friction, load, faults and gain changes."""
        return self._config.linear()

    def _lagged(self, duty: float) -> float:
        """Return the mean of the lagged duty [-] over the next period."""
        lag = self._config.drive_lag
        keep = exp(-self.period / lag)
        away = self._drive - duty
        self._drive = duty + away * keep
        return duty + away * (1.0 - keep) * lag / self.period

    def _move(self, way: float) -> None:
        """Turn the screw on by a way [m] without a stop in it; backlash takes its part."""
        self._screw += way
        play = 0.5 * self._config.backlash
        self._slide = min(max(self._slide, self._screw - play), self._screw + play)
