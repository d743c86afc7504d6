# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The ball screw of an axis: motion in, temperatures and the error along the travel out.

Heat flows in one dimension along the screw, by explicit finite volumes.  Lumps stand at its ends
and on it: motor, the housings of both bearings, nut, table.
"""

from dataclasses import dataclass, fields
from math import isfinite, pi

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.simulation.thermal.mill import MILL_STEP

MOUNTINGS = ('fixed_free', 'fixed_fixed', 'linear_scale')
"""Mountings of a screw: one that grows freely, one that is stretched between
two fixed bearings, or by a linear scale."""

SCREW_SENSORS = ('bearing', 'far_bearing', 'nut', 'table')
"""Places of the temperature sensors of an axis, in the order of its readings."""

AXIS_SPEED_MAX = 2.0
"""Largest speed of an axis that is taken [m/s]."""

_CELL = 0.0125  # length of a cell [m], or a little more; shorter ones need shorter steps
# Usual values of steel; within their usual spread those that agree best with the check values of
# the tests, whose source does not tell its own.
_CAPACITY = 7850.0 * 475.0  # [J/(m3 K)]
_CONDUCTIVITY = 50.0  # [W/(m K)]


@dataclass(frozen=True, kw_only=True)
class BallScrewConfig:
    """Properties of a screw: lengths in m from the fixed bearing on, positions of the machine.

    Friction is a force: times the speed of the axis it is the heat.
    """

    mounting: str = 'fixed_free'
    """One of `MOUNTINGS`."""
    length: float = 0.7
    """Length between the bearings [m]."""
    diameter: float = 0.032
    """Its thickness [m]."""
    expansion: float = 11.5e-6
    """Expansion of the screw [1/K]."""
    prestretch: float = 30e-6
    """Prestretch of a screw with two fixed bearings [-]."""
    scale_expansion: float = 8e-6
    """Expansion of a linear scale, which is as warm as the table [1/K]."""
    scale_fixed_at: float = 0.0
    """Position of the machine at which the scale is fixed [m]."""
    bearing_position: float = 0.1
    """Position of the machine at which the fixed bearing sits [m]."""
    direction: float = -1.0
    """Way from the fixed bearing to the far one, 1 or -1 in positions of the machine [-]."""
    convection: float = 12.0
    """Loss of the screw's surface at rest [W/(m2 K)]."""
    convection_rise: float = 56.0
    """Rise of that loss per speed of the axis [W/(m2 K) per m/s]."""
    nut_length: float = 0.08
    """Length of the nut, over which it spreads its heat [m]."""
    nut_friction: float = 152.0
    """Friction of the nut that heats the screw [N]."""
    nut_own_friction: float = 40.0
    """Friction that heats the nut itself [N]."""
    nut_conductance: float = 3.0
    """From the screw to the nut [W/K]."""
    nut_capacity: float = 1.5e3
    """Heat capacity of the nut [J/K]."""
    table_conductance: float = 2.5
    """From the nut to the table [W/K]."""
    table_capacity: float = 60e3
    """Heat capacity of the table [J/K]."""
    table_loss: float = 6.0
    """Loss of the table to the surroundings [W/K]."""
    bearing_friction: float = 32.0
    """Friction of the fixed bearing [N]."""
    far_bearing_friction: float = 12.0
    """Friction of the far bearing [N]."""
    bearing_conductance: float = 1.5
    """From the screw through the fixed bearing to its housing [W/K]."""
    far_bearing_conductance: float = 0.8
    """From the screw through the far bearing to its housing [W/K]."""
    housing_capacity: float = 9e3
    """Heat capacity of the housing of each bearing [J/K]."""
    housing_loss: float = 2.0
    """Loss of each housing to the surroundings and the bed [W/K]."""
    motor_friction: float = 120.0
    """Heat of the motor, as a friction force [N]."""
    motor_capacity: float = 6e3
    """Heat capacity of the motor [J/K]."""
    motor_loss: float = 2.5
    """Loss of the motor to the surroundings [W/K]."""
    coupling_conductance: float = 0.3
    """From the motor through the coupling to the screw [W/K]."""

    def __post_init__(self) -> None:
        if self.mounting not in MOUNTINGS:
            raise ValueError(
                f'mounting: expected one of {", ".join(MOUNTINGS)} but found {self.mounting!r}'
            )
        for item in fields(self)[1:]:
            value = getattr(self, item.name)
            if not isfinite(value):
                raise ValueError(f'{item.name}: expected a finite number but found {value}')
            if value < 0.0 and item.name not in _SIGNED:
                raise ValueError(f'{item.name}: expected 0 or more but found {value:g}')
        if abs(self.direction) != 1.0:
            raise ValueError(f'direction: expected 1 or -1 but found {self.direction:g}')
        if not 0.1 <= self.length <= 10.0:
            raise ValueError(f'length: expected 0.1 to 10 m but found {self.length:g} m')
        if not 0.005 <= self.diameter <= 0.2:
            raise ValueError(f'diameter: expected 0.005 to 0.2 m but found {self.diameter:g} m')
        self._check_step()

    def _check_step(self) -> None:
        """Refuse what an explicit step of `MILL_STEP` cannot follow."""
        cell = self.length / cell_count(self.length)
        volume = cell * pi / 4.0 * self.diameter * self.diameter
        bearing = max(self.bearing_conductance, self.far_bearing_conductance)
        nut = self.nut_conductance * min(1.0, cell / max(self.nut_length, cell))
        for what, capacity, conductance in (
            ('diameter', _CAPACITY * volume, bearing + self.coupling_conductance + nut),
            ('nut_capacity', self.nut_capacity, self.nut_conductance + self.table_conductance),
            ('table_capacity', self.table_capacity, self.table_conductance + self.table_loss),
            ('housing_capacity', self.housing_capacity, bearing + self.housing_loss),
            ('motor_capacity', self.motor_capacity, self.coupling_conductance + self.motor_loss),
        ):
            if conductance * MILL_STEP > 0.5 * capacity:
                raise ValueError(
                    f'{what}: expected a heat capacity of {2.0 * conductance * MILL_STEP:.3g} '
                    f'J/K or more at {conductance:.3g} W/K but found {capacity:.3g} J/K; '
                    'more of it or smaller conductances'
                )


_SIGNED = ('scale_fixed_at', 'bearing_position', 'direction')


def cell_count(length: float) -> int:
    """Return into how many cells a screw of a length [m] is cut."""
    return int(length / _CELL + 1e-6)


@dataclass(frozen=True)
class Stroke:
    """An axis that goes back and forth, or stands: where, and how fast on the average.

    Parameters
    ----------
    low, high : float
        Ends of the stroke, positions of the machine [m].
    speed : float
        Mean of the absolute speed [m/s]; 0 for an axis that stands.
    """

    low: float
    high: float
    speed: float

    def __post_init__(self) -> None:
        if not (isfinite(self.low) and isfinite(self.high) and self.low <= self.high):
            raise ValueError(
                f'stroke: expected low <= high in m but found {self.low} and {self.high}'
            )
        if not 0.0 <= self.speed <= AXIS_SPEED_MAX:  # true for NaN
            raise ValueError(
                f'speed: expected 0 to {AXIS_SPEED_MAX:g} m/s of a stroke '
                f'but found {self.speed} m/s'
            )

    @property
    def motion(self) -> Array:
        """Means over whole strokes, shape (4,).

        Absolute speed [m/s], its square [m2/s2], speed times position [m2/s] and squared position
        [m3/s].
        """
        middle, reach = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        mean_square = middle * middle + reach * reach / 3.0
        return self.speed * np.array([1.0, self.speed, middle, mean_square])

    def position(self, time: float) -> float:
        """Return where an axis is that left the high end at time 0 [m]."""
        span = self.high - self.low
        if span <= 0.0 or self.speed <= 0.0:
            return self.high
        done = self.speed * time % (2.0 * span)
        return self.high - done if done < span else self.low + (done - span)


class BallScrew:
    """A ball screw with its motor, bearings, nut and table; moves on in steps of five seconds.

    Parameters
    ----------
    config : BallScrewConfig
        What the screw is like.
    start : float
        Temperature of everything at the beginning, to which errors refer [degC].

    Attributes
    ----------
    stretched : bool
        Whether a screw between two fixed bearings still has its pre-stretch; a locknut that
        gives way is set here.

    Notes
    -----
    A motor encoder counts turns.  The error at a distance `x` from the fixed bearing is what the
    screw has grown up to there, `e(x) = integral of expansion * (T(s) - T0) ds`.  Between
    two fixed bearings the tension falls by the mean of that growth, so the ends stay, until the
    pre-stretch is used up; from there on, and once it is lost, the screw is as free as another
    and shorter by its pre-stretch.
    """

    def __init__(self, config: BallScrewConfig, start: float) -> None:
        self.config = config
        self.stretched = True
        count = cell_count(config.length)
        self._width = config.length / count
        self._edge = self._width * np.arange(count + 1)
        section = pi / 4.0 * config.diameter * config.diameter
        self._cell_capacity = _CAPACITY * section * self._width
        self._between = _CONDUCTIVITY * section / self._width
        self._surface = pi * config.diameter * self._width
        self._start = start
        self._cells = np.full(count, start)
        self._motor = self._housing = self._far_housing = self._nut = self._table = start

    def advance(self, ambient: float, stroke: Stroke) -> None:
        """Move on by one step of `MILL_STEP`.

        Parameters
        ----------
        ambient : float
            Temperature of the surroundings [degC].
        stroke : Stroke
            What the axis does meanwhile.
        """
        config, cells, speed = self.config, self._cells, stroke.speed
        share = self._nut_share(stroke)
        loss = self._surface * (config.convection + config.convection_rise * speed)
        power = loss * (ambient - cells)
        flow = self._between * (cells[1:] - cells[:-1])
        power[:-1] += flow
        power[1:] -= flow
        to_housing = config.bearing_conductance * (cells[0] - self._housing)
        to_far_housing = config.far_bearing_conductance * (cells[-1] - self._far_housing)
        from_motor = config.coupling_conductance * (self._motor - cells[0])
        to_nut = config.nut_conductance * (cells - self._nut) * share
        to_table = config.table_conductance * (self._nut - self._table)
        power += config.nut_friction * speed * share - to_nut
        power[0] += config.bearing_friction * speed + from_motor - to_housing
        power[-1] += config.far_bearing_friction * speed - to_far_housing
        self._cells = cells + power * (MILL_STEP / self._cell_capacity)
        motor_lost = config.motor_loss * (self._motor - ambient)
        self._motor += _rise(
            config.motor_friction * speed - from_motor - motor_lost, config.motor_capacity
        )
        self._housing += _rise(
            to_housing + config.housing_loss * (ambient - self._housing), config.housing_capacity
        )
        self._far_housing += _rise(
            to_far_housing + config.housing_loss * (ambient - self._far_housing),
            config.housing_capacity,
        )
        gained = float(np.cumsum(to_nut)[-1])
        self._nut += _rise(
            config.nut_own_friction * speed + gained - to_table, config.nut_capacity
        )
        self._table += _rise(
            to_table + config.table_loss * (ambient - self._table), config.table_capacity
        )

    def temperatures(self) -> Array:
        """Return the temperatures at `SCREW_SENSORS`, shape (4,) [degC]."""
        return np.array([self._housing, self._far_housing, self._nut, self._table], dtype=float)

    def error(self, position: Array) -> Array:
        """Return the error at positions of the axis.

        Parameters
        ----------
        position : ndarray, shape (n,)
            Positions of the machine [m]; beyond a bearing the error is that at the bearing.

        Returns
        -------
        ndarray, shape (n,)
            Actual minus nominal position since the start [m].
        """
        config = self.config
        if config.mounting == 'linear_scale':
            rise = self._table - self._start
            return config.scale_expansion * rise * (position - config.scale_fixed_at)
        place = np.clip(
            config.direction * (position - config.bearing_position), 0.0, config.length
        )
        grown = np.concatenate(
            [[0.0], np.cumsum(config.expansion * (self._cells - self._start) * self._width)]
        )
        error = np.interp(place, self._edge, grown)
        if config.mounting == 'fixed_fixed':
            held = min(grown[-1] / config.length, config.prestretch)
            error = error - place * (held if self.stretched else config.prestretch)
        return config.direction * error

    def _nut_share(self, stroke: Stroke) -> Array:
        """Return the share of each cell in the way that the nut goes, shape (cells,) [-]."""
        config = self.config
        ends = sorted(
            config.direction * (end - config.bearing_position) for end in (stroke.low, stroke.high)
        )
        half = 0.5 * config.nut_length
        shortest = 1e-3  # a stroke that is a point still has a place
        low = min(max(ends[0] - half, 0.0), config.length - shortest)
        high = min(max(ends[1] + half, low + shortest), config.length)
        covered = np.minimum(self._edge[1:], high) - np.maximum(self._edge[:-1], low)
        return np.maximum(covered, 0.0) / (high - low)


def _rise(power: float, capacity: float) -> float:
    """Return by how much a lump gets warmer in a step [K]."""
    return float(power * MILL_STEP / capacity)
