# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Models of a driven axis as parameters: sensor, lathe axis of Long et al. (2014), ball screw.

Controllers take their linear model from them, simulations everything.
"""

from __future__ import annotations

from dataclasses import dataclass

from fuzzycnc_ros.core.config import Config, param
from fuzzycnc_ros.core.servo.axis import LinearAxis


@dataclass(frozen=True, kw_only=True)
class PositionSensorConfig(Config):
    """Position sensor of an axis, and its errors.

    A linear grating sits on the slide; an encoder on the screw does not see backlash, and what
    the screw is wrong by.
    """

    sensor: str = param(
        'grating',
        '-',
        'Grating on the slide or encoder on the screw',
        choices=('grating', 'encoder'),
    )
    count: float = param(
        0.625e-6, 'm', 'One count of the sensor; 0 for no counts', low=0.0, high=1e-3
    )
    noise: float = param(0.1e-6, 'm', 'RMS of the noise ahead of the counting', low=0.0, high=1e-3)
    periodic_error: float = param(
        6e-6,
        'm',
        'Amplitude of the error once per turn of the screw; encoder only',
        low=0.0,
        high=1e-3,
    )
    screw_lead: float = param(
        0.01, 'm', 'Way of the slide per turn of the screw', low=1e-4, high=1.0
    )
    pitch_error: float = param(
        8e-5, '-', 'Error of the lead per way; encoder only', low=-0.01, high=0.01
    )
    backlash: float = param(
        0.0, 'm', 'Way that the screw turns freely when it reverses', low=0.0, high=1e-2
    )
    counts_lost: int = param(
        0, '-', 'Counts lost at `count_loss_time`', low=-10_000_000, high=10_000_000
    )
    count_loss_time: float = param(
        0.0, 's', 'When counts get lost, after the start', low=0.0, high=1e6
    )
    count_factor: float = param(
        1.0, '-', 'Factor on the count from `count_change_time` on', low=1e-3, high=1e3
    )
    count_change_time: float = param(
        0.0, 's', 'When the count changes, after the start', low=0.0, high=1e6
    )
    dropout_time: float = param(
        0.0, 's', 'When readings begin to be missing (NaN), after the start', low=0.0, high=1e6
    )
    dropout_duration: float = param(
        0.0, 's', 'How long readings are missing; 0 for no dropout', low=0.0, high=1e6
    )
    seed: int = param(0, '-', 'Seed of the noise', low=0, high=2**31 - 1)


@dataclass(frozen=True, kw_only=True)
class LatheAxisConfig(PositionSensorConfig):
    """The lathe axis of [long2014], identified from its table 1; friction and load as duty."""

    gain: float = param(0.286, 'm/s', 'Steady velocity at full duty', low=1e-6, high=100.0)
    gain_factor: float = param(
        1.0, '-', 'What the gain has changed by against the nominal one', low=0.01, high=100.0
    )
    direction: float = param(
        1.0, '-', 'Sign of the velocity that a positive duty drives', low=-1.0, high=1.0
    )
    amplifier_lag: float = param(8e-4, 's', 'Time constant of the amplifier', low=1e-6, high=1.0)
    torque_lag: float = param(1.5e-3, 's', 'Time constant of the torque', low=1e-6, high=1.0)
    velocity_lag: float = param(0.017, 's', 'Time constant of the mechanics', low=1e-5, high=10.0)
    sensor_lag: float = param(6e-3, 's', 'Time constant of the sensor', low=1e-6, high=1.0)
    delay: float = param(0.0, 's', 'Dead time from a duty to the amplifier', low=0.0, high=0.1)
    coulomb: float = param(0.02, '-', 'Friction in motion, as duty', low=0.0, high=1.0)
    breakaway: float = param(0.03, '-', 'Friction at the onset of motion', low=0.0, high=1.0)
    stribeck_velocity: float = param(
        2e-3, 'm/s', 'Velocity over which breakaway falls to Coulomb friction', low=1e-7, high=1.0
    )
    load: float = param(0.0, '-', 'Load against positive motion, as duty', low=-1.0, high=1.0)
    load_time: float = param(0.0, 's', 'When the load sets in, after the start', low=0.0, high=1e6)
    period: float = param(1e-3, 's', 'Control period', low=1e-5, high=0.1)
    substeps: int = param(20, '-', 'Steps of the simulation per period', low=1, high=1000)
    duty_max: float = param(1.0, '-', 'Largest magnitude of duty', low=1e-3, high=1.0)

    def __post_init__(self) -> None:
        """Check the fields and how they fit together.

        Raises
        ------
        ValueError
            If a field is out of its bounds, breakaway is below Coulomb friction, or the
            direction is not a sign.
        """
        super().__post_init__()
        if self.breakaway < self.coulomb:
            raise ValueError(
                f'breakaway: expected coulomb = {self.coulomb} or more but found {self.breakaway}'
            )
        if abs(self.direction) != 1.0:
            raise ValueError(f'direction: expected 1 or -1 but found {self.direction}')

    def linear(self) -> LinearAxis:
        """Return the nominal linear model: without friction, load, faults and gain changes."""
        return LinearAxis.chain(
            self.direction * self.gain,
            {
                **({'delay': self.delay} if self.delay else {}),
                'amplifier': self.amplifier_lag,
                'torque': self.torque_lag,
            },
            self.velocity_lag,
            sensor_lag=self.sensor_lag,
            period=self.period,
        )


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
    mode: float = param(
        0.0,
        'Hz',
        'Frequency at which the axis swings on its spring; 0 for none',
        low=0.0,
        high=1e4,
    )
    mode_damping: float = param(0.05, '-', 'Damping of that mode', low=1e-4, high=1.0)
    mode_ratio: float = param(
        1.0,
        '-',
        'Response far above the mode over that far below: 0 where the sensor is behind the '
        'spring, above 1 where it is at the motor',
        low=0.0,
        high=100.0,
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

    def linear(self) -> LinearAxis:
        """Return the nominal linear model: without friction, load, faults and gain changes.

        Viscous friction is part of it, as the mean of both directions, and a dead time as a lag.
        """
        viscous = 0.5 * (self.viscous_forward + self.viscous_backward)
        gain = self.direction * self.force_max / viscous
        lags = {'delay': self.delay, 'drive': self.drive_lag}
        return LinearAxis.chain(
            gain,
            {name: lag for name, lag in lags.items() if lag},
            self.mass / viscous,
            period=self.period,
        )
