# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated axes: plants that hold a duty for one control period, and what they measure with.

References
----------
[janot2019] for the ball-screw axis.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import fields, replace
from math import copysign, inf, isfinite, nan, pi, sqrt
from typing import Any

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.axis_models import (
    BallscrewAxisConfig,
    LatheAxisConfig,
    PositionSensorConfig,
)
from fuzzycnc_ros.core.machine.machine_data import AxisData


class DutyDelay:
    """Dead time between the duty that is commanded and the one that drives.

    A dead time that is no whole number of periods takes the mean of the two duties that act in a
    period, weighted by how long each does.

    Parameters
    ----------
    delay : float
        Dead time [s]; not negative.
    period : float
        Control period [s].

    Attributes
    ----------
    part : float
        Share of a period by which the dead time is longer than whole periods [-].
    periods : int
        Number of duties that are kept.

    Examples
    --------
    >>> delay = DutyDelay(1.5e-3, 1e-3)
    >>> [delay.of(duty) for duty in (1.0, 1.0, 1.0, 1.0)]
    [0.0, 0.5, 1.0, 1.0]
    """

    def __init__(self, delay: float, period: float) -> None:
        whole, part = divmod(delay / period, 1.0)
        self.part = part if part > 1e-9 else 0.0
        self.periods = round(whole) + 1 + (self.part > 0.0)
        self._held = deque([0.0] * self.periods, maxlen=self.periods)

    def of(self, duty: float) -> float:
        """Return what drives in the period for which a duty [-] is commanded."""
        held = self._held
        held.append(duty)
        if not self.part:
            return held[0]
        return self.part * held[0] + (1.0 - self.part) * held[1]


class AxisPlant(ABC):
    """One driven linear axis; a control period is `measure`, then `drive`.

    The course of positions depends on the configuration, its seed and the duties alone.

    Attributes
    ----------
    period : float
        Control period [s].
    duty_max : float
        Largest magnitude of duty that the drive takes [-]; more is cut.
    travel : tuple of float
        Lowest and highest position that it is sent to [m].
    """

    period: float
    duty_max: float
    travel: tuple[float, float] = (-inf, inf)

    @property
    @abstractmethod
    def position(self) -> float:
        """True position of the slide [m]."""

    @property
    @abstractmethod
    def velocity(self) -> float:
        """True velocity of the slide [m/s]."""

    @abstractmethod
    def measure(self) -> float:
        """Return the position as the sensor gives it now [m]; NaN while it gives none.

        Asked again before the next `drive` it says the same.
        """

    @abstractmethod
    def drive(self, duty: float) -> None:
        """Hold a duty for one period.

        Parameters
        ----------
        duty : float
            Share of the drive's range [-]; cut at `duty_max`.

        Raises
        ------
        ValueError
            If the duty is not finite.  The state is unchanged.
        """

    def _cut(self, duty: float) -> float:
        """Return a duty within the drive's range."""
        if not isfinite(duty):
            raise ValueError(f'duty: expected a finite number but found {duty}')
        return min(max(duty, -self.duty_max), self.duty_max)


def stribeck_friction(
    velocity: float, drive: float, coulomb: float, breakaway: float, stribeck_velocity: float
) -> float:
    """Return what friction takes from the drive, in the drive's unit.

    At rest friction balances any drive up to the breakaway value; in motion, or above it, it is
    (coulomb + (breakaway - coulomb) exp(-(v/vs)^2)) against the motion.

    Parameters
    ----------
    velocity : float
        Velocity v [m/s]; exactly 0 is rest.
    drive : float
        What drives the axis, load already taken off.
    coulomb, breakaway : float
        Friction in fast motion and at the onset of motion, in the drive's unit; not negative.
    stribeck_velocity : float
        Velocity vs over which friction falls from one to the other [m/s]; positive.

    Returns
    -------
    float
        Friction, to be subtracted from the drive; the drive itself while the axis sticks.

    Examples
    --------
    >>> stribeck_friction(0.0, -0.025, 0.02, 0.03, 2e-3)
    -0.025
    >>> stribeck_friction(0.0, 0.04, 0.02, 0.03, 2e-3)
    0.03
    >>> round(stribeck_friction(-2e-3, 0.0, 0.02, 0.03, 2e-3), 6)
    -0.023679
    """
    if velocity == 0.0:
        return drive if abs(drive) <= breakaway else copysign(breakaway, drive)
    ratio = velocity / stribeck_velocity
    return copysign(coulomb + (breakaway - coulomb) * portable.exp(-ratio * ratio), velocity)


def stribeck_frictions(
    velocity: Array, drive: Array, coulomb: Array, breakaway: Array, stribeck_velocity: Array
) -> Array:
    """Return `stribeck_friction` of many axes at once; all arguments of shape (cases,)."""
    ratio = velocity / stribeck_velocity
    moving = np.copysign(coulomb + (breakaway - coulomb) * portable.exp(-ratio * ratio), velocity)
    return np.where(velocity == 0.0, np.clip(drive, -breakaway, breakaway), moving)


_BLOCK = 1024
"""Samples of noise that are drawn in one go."""


class _SensorNoise:
    """Normal samples of unit variance from a seed, one at a time.

    Parameters
    ----------
    seed : int
        Seed; the same seed gives the same samples.
    """

    def __init__(self, seed: int) -> None:
        self._generator = np.random.default_rng(seed)
        self._ahead: list[float] = []

    def block(self) -> Array:
        """Return the next samples, shape (1024,) [-]."""
        return self._generator.standard_normal(_BLOCK)

    def draw(self) -> float:
        """Return the next sample [-]."""
        if not self._ahead:
            self._ahead = self.block()[::-1].tolist()
        return self._ahead.pop()


class PositionSensor:
    """Reads a position: screw error, noise, counts, and the faults that have begun.

    Parameters
    ----------
    config : PositionSensorConfig
        Sensor and faults.
    period : float
        Time between two readings [s]; positive.

    Examples
    --------
    >>> sensor = PositionSensor(PositionSensorConfig(noise=0.0), 1e-3)
    >>> f'{1e6 * sensor.read(1e-3):.3f}'
    '1000.000'
    >>> encoder = PositionSensor(PositionSensorConfig(sensor='encoder', noise=0.0), 1e-3)
    >>> f'{1e6 * encoder.read(2.5e-3):.3f}'
    '2493.750'
    """

    def __init__(self, config: PositionSensorConfig, period: float) -> None:
        self._config = config
        self._step = 0
        self._loses = round(config.count_loss_time / period)
        self._changes = round(config.count_change_time / period)
        self._fails = round(config.dropout_time / period)
        self._recovers = self._fails + round(config.dropout_duration / period)
        self._source = _SensorNoise(config.seed)
        self._noise = config.noise * self._source.draw()

    def read(self, position: float) -> float:
        """Return the reading [m] at a position [m]; NaN while readings are missing."""
        config, step = self._config, self._step
        if self._fails <= step < self._recovers:
            return nan
        if config.sensor == 'encoder':
            turn = 2.0 * pi / config.screw_lead * position
            position -= config.periodic_error * portable.sin(turn) + config.pitch_error * position
        position += self._noise
        if config.count:
            count = config.count * (config.count_factor if step >= self._changes else 1.0)
            position = round(position / count) * count
            if step >= self._loses:
                position -= config.counts_lost * config.count
        return position

    def advance(self) -> None:
        """Go on to the next reading."""
        self._step += 1
        self._noise = self._config.noise * self._source.draw()


class PositionSensors:
    """Position sensors of many axes; each reads what a `PositionSensor` would, to rounding.

    Parameters
    ----------
    configs : sequence of PositionSensorConfig
        One per axis.
    period : float
        Time between two readings [s]; positive.
    """

    def __init__(self, configs: Sequence[PositionSensorConfig], period: float) -> None:
        def column(name: str) -> Array:
            return np.array([getattr(config, name) for config in configs], dtype=np.float64)

        def steps(name: str) -> Array:
            return np.rint(column(name) / period)

        self._step = 0
        self._counts = column('count')
        self._counted = self._counts > 0.0
        self._factors, self._changes = column('count_factor'), steps('count_change_time')
        self._lost = column('counts_lost') * self._counts
        self._loses = steps('count_loss_time')
        self._fails = steps('dropout_time')
        self._recovers = self._fails + steps('dropout_duration')
        encoder = np.array([config.sensor == 'encoder' for config in configs])
        self._periodic = np.where(encoder, column('periodic_error'), 0.0)
        self._pitch = np.where(encoder, column('pitch_error'), 0.0)
        self._turns = 2.0 * pi / column('screw_lead')
        self._amplitude = column('noise')
        self._sources = [_SensorNoise(config.seed) for config in configs]
        self._ahead = self._block()

    def read(self, position: Array) -> Array:
        """Return the readings [m] at positions [m], shape (cases,); NaN where one is missing."""
        step = self._step
        wrong = self._periodic * portable.sin(self._turns * position) + self._pitch * position
        position = position - wrong + self._amplitude * self._ahead[step % _BLOCK]
        count = self._counts * np.where(step >= self._changes, self._factors, 1.0)
        count[~self._counted] = 1.0
        reading = np.where(self._counted, np.rint(position / count) * count, position)
        reading -= np.where(step >= self._loses, self._lost, 0.0)
        reading[(self._fails <= step) & (step < self._recovers)] = nan
        return reading

    def advance(self) -> None:
        """Go on to the next reading."""
        self._step += 1
        if self._step % _BLOCK == 0:
            self._ahead = self._block()

    def _block(self) -> Array:
        """Return the next noise of all axes, shape (1024, cases) [-]."""
        return np.column_stack([source.block() for source in self._sources])


class _Slide(AxisPlant):
    """A screw that moves a slide through backlash, driven late and measured as its sensor does."""

    def __init__(
        self, config: LatheAxisConfig | BallscrewAxisConfig, position: float, velocity: float
    ) -> None:
        self.period, self.duty_max = config.period, config.duty_max
        self._backlash = config.backlash
        self._sensor = PositionSensor(config, self.period)
        self._delay = DutyDelay(config.delay, self.period)
        self._screw = self._slide = position
        self._velocity = velocity
        self._step = 0
        self._load_step = round(config.load_time / self.period)

    @property
    def position(self) -> float:
        """True position of the slide [m]."""
        return self._slide

    @property
    def velocity(self) -> float:
        """True velocity of the slide [m/s]; 0 while the screw turns through backlash."""
        free = abs(self._screw - self._slide) < 0.5 * self._backlash
        return 0.0 if free else self._velocity


class LatheAxis(_Slide):
    """The lathe axis, simulated in exact first-order substeps.

    Parameters
    ----------
    config : LatheAxisConfig, optional
        Axis, sensor and faults; by default the friction case of the sheet.
    position : float
        Where the slide rests at the beginning [m].

    Notes
    -----
    An encoder's screw error is taken at the lagged position, where it is read; that order
    is a choice, and at rest it is the same.

    Examples
    --------
    >>> axis = LatheAxis(LatheAxisConfig(coulomb=0.0, breakaway=0.0))
    >>> for _ in range(1000):
    ...     axis.drive(0.3)
    >>> f'{1e3 * axis.position:.3f} {1e3 * axis.velocity:.3f}'
    '84.144 85.800'
    """

    def __init__(self, config: LatheAxisConfig | None = None, *, position: float = 0.0) -> None:
        self.config = config = config or LatheAxisConfig()
        super().__init__(config, position, 0.0)
        self._shares = substep_shares(config)
        self._amplifier = self._torque = 0.0
        self._sensed = position

    def measure(self) -> float:
        """Return the position as the sensor gives it now [m]; NaN while it gives none."""
        return self._sensor.read(self._sensed)

    def drive(self, duty: float) -> None:
        """Hold a duty [-] for one period; refuses one that is not finite."""
        config = self.config
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
        1.0 - portable.exp(-step / config.amplifier_lag),
        1.0 - portable.exp(-step / config.torque_lag),
        portable.exp(-step / config.velocity_lag),
        1.0 - portable.exp(-step / config.sensor_lag),
    )


class ModalSwing:
    """Swing of an axis on its spring as it is read, beside the motion of the rigid axis.

    Parameters
    ----------
    config : BallscrewAxisConfig
        Frequency, damping and ratio of the mode.

    Attributes
    ----------
    position : float
        What it adds to the reading [m].
    """

    def __init__(self, config: BallscrewAxisConfig) -> None:
        rate, period = 2.0 * pi * config.mode, config.period
        decay = config.mode_damping * rate
        damped = rate * sqrt(1.0 - config.mode_damping * config.mode_damping) or 1e-9
        keep = portable.exp(-decay * period)
        sine, cosine = portable.sin(damped * period), portable.cos(damped * period)
        self._rows = (
            (keep * (cosine + decay / damped * sine), keep * sine / damped),
            (-keep * rate * rate / damped * sine, keep * (cosine - decay / damped * sine)),
        )
        push = (config.mode_ratio - 1.0) / period
        self._entry = (
            push * (1.0 - self._rows[0][0]) / (rate * rate),
            push * self._rows[0][1],
        )
        self.position = self._rate = 0.0

    @property
    def numbers(self) -> tuple[float, ...]:
        """Transition of place and rate in a period, row by row, and what a change adds to them."""
        return (*self._rows[0], *self._rows[1], *self._entry)

    def advance(self, change: float) -> None:
        """Go on by a period in which the velocity of the rigid axis changes [m/s]."""
        (a, b), (c, d) = self._rows
        place, rate = self.position, self._rate
        self.position = a * place + b * rate + self._entry[0] * change
        self._rate = c * place + d * rate + self._entry[1] * change


def drive_keep(config: BallscrewAxisConfig) -> float:
    """Return the share of its deviation that the force of a drive with a lag keeps [-]."""
    return portable.exp(-config.period / config.drive_lag)


class BallscrewAxis(_Slide):
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
        self.config = config = config or BallscrewAxisConfig()
        super().__init__(config, position, velocity)
        self._drive = 0.0
        self._mode = ModalSwing(config) if config.mode else None
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
        """True position [m], as far as the axis swings where it is read."""
        return self._slide + (self._mode.position if self._mode is not None else 0.0)

    def measure(self) -> float:
        """Return the position as the sensor gives it now [m]; NaN while it gives none."""
        place = self._screw if self.config.sensor == 'encoder' else self._slide
        return self._sensor.read(place + (self._mode.position if self._mode is not None else 0.0))

    def drive(self, duty: float) -> None:
        """Hold a duty [-] for one period; refuses one that is not finite."""
        config = self.config
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
                coulomb += (breakaway - coulomb) * portable.exp(-ratio * ratio)
            steady, lag = (force - sign * coulomb) / viscous, self._mass / viscous
            stops = sign * velocity > 0.0 > sign * steady
            time = min(lag * portable.log1p(-velocity / steady), left) if stops else left
            keep = portable.exp(-time / lag)
            self._move(steady * time + (velocity - steady) * lag * (1.0 - keep))
            velocity = 0.0 if time < left else steady + (velocity - steady) * keep
            left -= time
        if self._mode is not None:
            self._mode.advance(velocity - self._velocity)
        self._velocity = velocity
        self._step += 1
        self._sensor.advance()

    def _lagged(self, duty: float) -> float:
        """Return the mean of the lagged duty [-] over the next period."""
        lag = self.config.drive_lag
        keep = drive_keep(self.config)
        away = self._drive - duty
        self._drive = duty + away * keep
        return duty + away * (1.0 - keep) * lag / self.period

    def _move(self, way: float) -> None:
        """Turn the screw on by a way [m] without a stop in it; backlash takes its part."""
        self._screw += way
        play = 0.5 * self.config.backlash
        self._slide = min(max(self._slide, self._screw - play), self._screw + play)


SimulatedAxis = LatheAxis | BallscrewAxis
"""An axis of either model."""


def simulated_axis(data: AxisData, **changes: Any) -> SimulatedAxis:
    """Return an axis as a simulated plant.

    Parameters
    ----------
    data : AxisData
        The axis.
    **changes
        What differs from the plant's parameters, faults among them: `load=0.1`.

    Raises
    ------
    ValueError
        If the data have no plant, or a change is unknown or out of its bounds.
    """
    known = data.known_plant()
    names = {item.name for item in fields(known)}
    for name in changes:
        if name not in names:
            raise ValueError(
                f'{name}: expected a parameter of the model {data.model}: '
                f'{", ".join(sorted(names))}'
            )
    plant = replace(known, **changes)
    axis = LatheAxis(plant) if isinstance(plant, LatheAxisConfig) else BallscrewAxis(plant)
    axis.travel = data.limits.travel_low, data.limits.travel_high
    return axis
