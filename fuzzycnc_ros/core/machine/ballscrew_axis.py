# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A real ball-screw axis from its published parameters: the EMPS benchmark.

References
----------
A. Janot, M. Gautier, M. Brunot: Data set and reference models of EMPS. Workshop on Nonlinear
System Identification Benchmarks, 2019.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log1p

from fuzzycnc_ros.core.config import param
from fuzzycnc_ros.core.machine.axis_plant import AxisPlant, DutyDelay, LinearAxis
from fuzzycnc_ros.core.machine.position_sensor import PositionSensor, PositionSensorConfig


@dataclass(frozen=True, kw_only=True)
class BallscrewAxisConfig(PositionSensorConfig):
    """A mass behind a ball screw with viscous and Coulomb friction; published EMPS parameters.

    The screw's encoder is what the axis was measured with; its readings are multiples of 50 nm.
    """

    sensor: str = param(
        'encoder',
        '-',
        'Grating on the slide or encoder on the screw',
        choices=('grating', 'encoder'),
    )
    count: float = param(5e-8, 'm', 'One count of the sensor; 0 for no counts', low=0.0, high=1e-3)
    noise: float = param(0.0, 'm', 'RMS of the noise ahead of the counting', low=0.0, high=1e-3)
    periodic_error: float = param(
        0.0,
        'm',
        'Amplitude of the error once per turn of the screw; encoder only',
        low=0.0,
        high=1e-3,
    )
    pitch_error: float = param(
        0.0, '-', 'Error of the lead per way; encoder only', low=-0.01, high=0.01
    )
    mass: float = param(95.1089, 'kg', 'Moved mass, motor included', low=0.1, high=1e6)
    viscous_forward: float = param(
        203.5034, 'N s/m', 'Viscous friction in positive motion', low=1.0, high=1e6
    )
    viscous_backward: float = param(
        203.5034, 'N s/m', 'Viscous friction in negative motion', low=1.0, high=1e6
    )
    coulomb_forward: float = param(
        20.3935, 'N', 'Coulomb friction in positive motion', low=0.0, high=1e6
    )
    coulomb_backward: float = param(
        20.3935, 'N', 'Coulomb friction in negative motion', low=0.0, high=1e6
    )
    offset: float = param(-3.1648, 'N', 'Steady force against positive motion', low=-1e6, high=1e6)
    force_constant: float = param(35.15065188, 'N/V', 'Force per volt', low=1e-6, high=1e6)
    voltage_max: float = param(10.0, 'V', 'Voltage at full duty', low=1e-3, high=1e4)
    delay: float = param(
        0.0, 's', 'Dead time from a duty to the voltage it gives', low=0.0, high=0.1
    )
    drive_lag: float = param(
        0.0, 's', 'Time constant of the force after the voltage; 0 for none', low=0.0, high=0.1
    )
    mass_factor: float = param(
        1.0, '-', 'What the mass has changed by against the nominal one', low=0.01, high=100.0
    )
    friction_factor: float = param(
        1.0, '-', 'What both frictions have changed by', low=0.01, high=100.0
    )
    gain_factor: float = param(
        1.0, '-', 'What the force per volt has changed by', low=0.01, high=100.0
    )
    breakaway_ratio: float = param(
        1.0, '-', 'Friction at the onset of motion over Coulomb friction', low=1.0, high=10.0
    )
    stribeck_velocity: float = param(
        0.0,
        'm/s',
        'Velocity over which breakaway falls to Coulomb friction; 0 at the first motion',
        low=0.0,
        high=1.0,
    )
    load: float = param(0.0, 'N', 'Further force against positive motion', low=-1e6, high=1e6)
    load_time: float = param(0.0, 's', 'When the load sets in, after the start', low=0.0, high=1e6)
    direction: float = param(
        1.0, '-', 'Sign of the force that a positive duty gives', low=-1.0, high=1.0
    )
    period: float = param(1e-3, 's', 'Control period', low=1e-5, high=0.1)
    duty_max: float = param(1.0, '-', 'Largest magnitude of duty', low=1e-3, high=1.0)

    def __post_init__(self) -> None:
        """Check the fields.

        Raises
        ------
        ValueError
            If a field is out of its bounds or the direction is not a sign.
        """
        super().__post_init__()
        if abs(self.direction) != 1.0:
            raise ValueError(f'direction: expected 1 or -1 but found {self.direction}')

    @classmethod
    def by_direction(cls) -> BallscrewAxisConfig:
        """Return the published model whose frictions differ by direction and hold the offset."""
        return cls(
            viscous_forward=166.7061,
            viscous_backward=240.4236,
            coulomb_forward=20.1440,
            coulomb_backward=20.6277,
            offset=0.0,
        )

    @property
    def force_max(self) -> float:
        """Nominal force at full duty [N]."""
        return self.force_constant * self.voltage_max


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
        """Return the nominal linear model: without friction, load, faults and gain changes.

        Viscous friction is part of it, as the mean of both directions, and a dead time as a lag.
        """
        config = self._config
        viscous = 0.5 * (config.viscous_forward + config.viscous_backward)
        gain = config.direction * config.force_max / viscous
        lags = {'delay': config.delay, 'drive': config.drive_lag}
        return LinearAxis.chain(
            gain,
            {name: lag for name, lag in lags.items() if lag},
            config.mass / viscous,
            period=config.period,
        )

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
