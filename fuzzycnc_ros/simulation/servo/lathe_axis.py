# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The lathe's X axis: amplifier, torque motor, friction with breakaway, grating or encoder."""

from math import exp

from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.simulation.servo.axis_plant import AxisPlant, DutyDelay, stribeck_friction
from fuzzycnc_ros.simulation.servo.position_sensor import PositionSensor


class LatheAxis(AxisPlant):
    """The lathe axis, simulated in exact first-order substeps (method sheet 004 section 9).

    Parameters
    ----------
    config : LatheAxisConfig, optional
        Axis, sensor and faults; by default the friction case of the sheet.
    position : float
        Where the slide rests at the beginning [m].

    Notes
    -----
    An encoder's screw error is taken at the lagged position, where it is read; the sheet leaves
    the order open, and at rest it is the same.

    Examples
    --------
    >>> axis = LatheAxis(LatheAxisConfig(coulomb=0.0, breakaway=0.0))
    >>> for _ in range(1000):
    ...     axis.drive(0.3)
    >>> f'{1e3 * axis.position:.3f} {1e3 * axis.velocity:.3f}'
    '84.144 85.800'
    """

    def __init__(self, config: LatheAxisConfig | None = None, *, position: float = 0.0) -> None:
        self._config = config = config or LatheAxisConfig()
        self.period = config.period
        self.duty_max = config.duty_max
        self._sensor = PositionSensor(config, self.period)
        self._shares = substep_shares(config)
        self._amplifier = self._torque = self._velocity = 0.0
        self._screw = self._slide = self._sensed = position
        self._delay = DutyDelay(config.delay, self.period)
        self._step = 0
        self._load_step = round(config.load_time / self.period)

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
        return self._sensor.read(self._sensed)

    def drive(self, duty: float) -> None:
        """Hold a duty [-] for one period; refuses one that is not finite."""
        config = self._config
        asked = config.direction * self._delay.of(self._cut(duty))
        amplify, build, keep, sense = self._shares
        gain, half_step = config.gain * config.gain_factor, 0.5 * self.period / config.substeps
        load = config.load if self._step >= self._load_step else 0.0
        friction = (config.coulomb, config.breakaway, config.stribeck_velocity)
        rubs, play, on_screw = (
            config.breakaway > 0.0,
            0.5 * config.backlash,
            config.sensor == 'encoder',
        )
        amplifier, torque, velocity = self._amplifier, self._torque, self._velocity
        screw, slide, sensed = self._screw, self._slide, self._sensed
        for _ in range(config.substeps):
            before = amplifier
            amplifier += (asked - amplifier) * amplify
            before, torque = torque, torque + (0.5 * (before + amplifier) - torque) * build
            push = 0.5 * (before + torque) - load
            if rubs:
                push -= stribeck_friction(velocity, push, *friction)
            before, velocity = velocity, gain * push + (velocity - gain * push) * keep
            if rubs and before * velocity < 0.0:
                velocity = 0.0
            seen = screw if on_screw else slide
            screw += half_step * (before + velocity)
            slide = min(max(slide, screw - play), screw + play) if play else screw
            sensed += (0.5 * (seen + (screw if on_screw else slide)) - sensed) * sense
        self._amplifier, self._torque, self._velocity = amplifier, torque, velocity
        self._screw, self._slide, self._sensed = screw, slide, sensed
        self._step += 1
        self._sensor.advance()

    def linear(self) -> LinearAxis:
        """Return the nominal linear model: without friction, load, faults and gain changes."""
        return self._config.linear()


def substep_shares(config: LatheAxisConfig) -> tuple[float, float, float, float]:
    """Return what a substep does to the states of an axis.

    Returns
    -------
    amplify, build : float
        Share of the way to their inputs that amplifier and torque go [-].
    keep : float
        Share of its deviation from the steady velocity that the velocity keeps [-].
    sense : float
        Share of the way to the position that the sensor goes [-].
    """
    step = config.period / config.substeps
    return (
        1.0 - exp(-step / config.amplifier_lag),
        1.0 - exp(-step / config.torque_lag),
        exp(-step / config.velocity_lag),
        1.0 - exp(-step / config.sensor_lag),
    )
