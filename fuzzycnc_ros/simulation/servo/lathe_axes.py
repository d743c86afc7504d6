# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Many lathe axes at once, for random moves and for tuning."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array, Seed
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.simulation.servo.axes import (
    PositionSensors,
    stribeck_frictions,
    substep_shares,
)


class LatheAxes:
    """Lathe axes with their own configurations, advanced together.

    Every axis moves as a `LatheAxis` of its configuration would, to rounding.

    Parameters
    ----------
    configs : sequence of LatheAxisConfig
        One per axis; period and substeps are the same in all.
    position : array_like, shape () or (cases,)
        Where the slides rest at the beginning [m].

    Attributes
    ----------
    period : float
        Control period [s].

    Raises
    ------
    ValueError
        If there is no axis, one has a dead time, or if periods or substeps differ.

    Examples
    --------
    >>> axes = LatheAxes([LatheAxisConfig(gain_factor=factor) for factor in (0.5, 1.0, 1.5)])
    >>> for _ in range(1000):
    ...     axes.drive([0.3, 0.3, 0.3])
    >>> (1e3 * axes.position).round(3).tolist()
    [39.258, 78.519, 117.779]
    """

    def __init__(self, configs: Sequence[LatheAxisConfig], position: ArrayLike = 0.0) -> None:
        if not configs:
            raise ValueError('configs: expected one or more axes but found none')
        if len({(config.period, config.substeps) for config in configs}) > 1:
            raise ValueError(
                'configs: expected one period and number of substeps for all axes but found '
                'several; simulate them in batches of their own'
            )
        if any(config.delay for config in configs):
            raise ValueError('delay: expected 0 s for all axes of a batch but found more')
        self.period, self._substeps = configs[0].period, configs[0].substeps
        self._sensors = PositionSensors(configs, self.period)
        self._shares = np.array([substep_shares(config) for config in configs]).T

        def column(name: str) -> Array:
            return np.array([getattr(config, name) for config in configs], dtype=np.float64)

        self._duty_max, self._direction = column('duty_max'), column('direction')
        self._gain = column('gain') * column('gain_factor')
        self._coulomb, self._breakaway = column('coulomb'), column('breakaway')
        self._stribeck_velocity = column('stribeck_velocity')
        self._play = 0.5 * column('backlash')
        self._load, self._load_step = column('load'), np.rint(column('load_time') / self.period)
        self._on_screw = np.array([config.sensor == 'encoder' for config in configs])
        self._amplifier, self._torque, self._velocity = np.zeros((3, len(configs)))
        self._screw = np.array(np.broadcast_to(position, len(configs)), dtype=np.float64)
        self._slide, self._sensed = self._screw, self._screw
        self._step = 0

    @property
    def position(self) -> Array:
        """True positions of the slides, shape (cases,) [m]."""
        return self._slide.copy()

    @property
    def velocity(self) -> Array:
        """True velocities of the slides, shape (cases,) [m/s]; 0 within backlash."""
        free = np.abs(self._screw - self._slide) < self._play
        return np.where(free, 0.0, self._velocity)

    def measure(self) -> Array:
        """Return the positions as the sensors give them now, shape (cases,) [m]."""
        return self._sensors.read(self._sensed)

    def drive(self, duty: ArrayLike) -> None:
        """Hold one duty per axis for one period.

        Parameters
        ----------
        duty : array_like, shape (cases,)
            Shares of the drives' ranges [-]; cut at each axis's `duty_max`.

        Raises
        ------
        ValueError
            If the shape is another or a duty is not finite.  The state is unchanged.
        """
        asked = np.asarray(duty, dtype=np.float64)
        if asked.shape != self._gain.shape or not np.isfinite(asked).all():
            raise ValueError(
                f'duty: expected {len(self._gain)} finite numbers but found the shape '
                f'{asked.shape}' + (', not all finite' if asked.shape == self._gain.shape else '')
            )
        asked = self._direction * np.clip(asked, -self._duty_max, self._duty_max)
        amplify, build, keep, sense = self._shares
        half_step = 0.5 * self.period / self._substeps
        load = np.where(self._step >= self._load_step, self._load, 0.0)
        friction = (self._coulomb, self._breakaway, self._stribeck_velocity)
        rubs, plays, encoders = self._breakaway > 0.0, self._play.any(), self._on_screw.any()
        amplifier, torque, velocity = self._amplifier, self._torque, self._velocity
        screw, slide, sensed = self._screw, self._slide, self._sensed
        for _ in range(self._substeps):
            before = amplifier
            amplifier = amplifier + (asked - amplifier) * amplify
            before, torque = torque, torque + (0.5 * (before + amplifier) - torque) * build
            push = 0.5 * (before + torque) - load
            push -= stribeck_frictions(velocity, push, *friction)
            steady = self._gain * push
            before, velocity = velocity, steady + (velocity - steady) * keep
            velocity[rubs & (before * velocity < 0.0)] = 0.0
            seen = np.where(self._on_screw, screw, slide) if encoders else slide
            screw = screw + half_step * (before + velocity)
            slide = np.clip(slide, screw - self._play, screw + self._play) if plays else screw
            now = np.where(self._on_screw, screw, slide) if encoders else slide
            sensed = sensed + (0.5 * (seen + now) - sensed) * sense
        self._amplifier, self._torque, self._velocity = amplifier, torque, velocity
        self._screw, self._slide, self._sensed = screw, slide, sensed
        self._step += 1
        self._sensors.advance()


@dataclass(frozen=True)
class LatheMove:
    """A move of the lathe axis: the axis with its knobs, and where it goes from 0 [m]."""

    config: LatheAxisConfig
    target: float


def random_moves(count: int = 200, *, hard: bool = False, seed: Seed = 0) -> list[LatheMove]:
    """Return random moves of the lathe axis.

    Gain x0.5 to x1.5, way 0.05 to 150 mm (its logarithm uniform) either way, steady load within
    +-0.1, noise up to 0.2 um rms, Coulomb friction up to 3 % and breakaway up to 1.5 times that.

    Parameters
    ----------
    count : int
        Number of moves.
    hard : bool
        Coulomb friction up to 5 % and breakaway up to 1.8 times that instead.
    seed : int or Generator
        What draws them.

    Returns
    -------
    list of LatheMove
        Moves; targets lie anywhere between the counts of the sensor.

    Examples
    --------
    >>> move = random_moves(1, seed=1)[0]
    >>> 5e-5 <= abs(move.target) <= 0.15
    True
    """
    rng = np.random.default_rng(seed)
    coulomb_max, ratio_max = (0.05, 1.8) if hard else (0.03, 1.5)
    moves = []
    for _ in range(count):
        coulomb = rng.uniform(0.0, coulomb_max)
        config = LatheAxisConfig(
            gain_factor=rng.uniform(0.5, 1.5),
            load=rng.uniform(-0.1, 0.1),
            noise=rng.uniform(0.0, 0.2e-6),
            coulomb=coulomb,
            breakaway=coulomb * rng.uniform(1.0, ratio_max),
            seed=int(rng.integers(2**31)),
        )
        way = float(portable.exp(rng.uniform(portable.log(5e-5), portable.log(0.15))))
        moves.append(LatheMove(config, float(rng.choice([-1.0, 1.0])) * way))
    return moves
