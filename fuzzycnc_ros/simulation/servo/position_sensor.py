# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position sensor of an axis: linear grating or rotary encoder, counts, noise and faults."""

from collections.abc import Sequence
from math import nan, pi, sin

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.axis_models import PositionSensorConfig

_BLOCK = 1024
"""Samples of noise that are drawn in one go."""


class SensorNoise:
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
        self._source = SensorNoise(config.seed)
        self._noise = config.noise * self._source.draw()

    def read(self, position: float) -> float:
        """Return the reading [m] at a position [m]; NaN while readings are missing."""
        config, step = self._config, self._step
        if self._fails <= step < self._recovers:
            return nan
        if config.sensor == 'encoder':
            turn = 2.0 * pi / config.screw_lead * position
            position -= config.periodic_error * sin(turn) + config.pitch_error * position
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
        self._sources = [SensorNoise(config.seed) for config in configs]
        self._ahead = self._block()

    def read(self, position: Array) -> Array:
        """Return the readings [m] at positions [m], shape (cases,); NaN where one is missing."""
        step = self._step
        wrong = self._periodic * np.sin(self._turns * position) + self._pitch * position
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
