# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated surface grinder: heat in, temperatures and displacement of the wheel out."""

from dataclasses import dataclass, fields
from math import isfinite, pi, sin

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.simulation.thermal.grinder_network import (
    NODES,
    SENSORS,
    STEP_SECONDS,
    Heat,
    thermal_displacement,
    thermal_step,
)

GRINDER_AXES = ('Y', 'Z')
"""Axes whose displacement the grinder gives; X is hydraulic and not compensated."""

_STEP_NS = STEP_SECONDS * 1_000_000_000


@dataclass(frozen=True)
class AmbientCourse:
    """Ambient temperature over time, a sine that begins at `base`.

    Parameters
    ----------
    base : float
        Temperature at the start of the run [degC].
    amplitude : float
        Half of the swing [K].
    phase : float
        Phase at the start [rad].
    period : float
        Time of a whole swing [s]; positive.

    Raises
    ------
    ValueError
        If a figure is not finite or the period not positive.

    Examples
    --------
    >>> AmbientCourse(22.0, 2.5, -0.9).at(0.0)
    22.0
    """

    base: float
    amplitude: float = 0.0
    phase: float = 0.0
    period: float = 86_400.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isfinite(value):
                raise ValueError(f'{field.name}: expected a finite number but found {value}')
        if not self.period > 0.0:
            raise ValueError(f'period: expected more than 0 s but found {self.period} s')

    def at(self, time: float) -> float:
        """Return the temperature at `time` [s] after the start of the run [degC]."""
        swing = sin(2.0 * pi * time / self.period + self.phase) - sin(self.phase)
        return self.base + self.amplitude * swing


class Grinder:
    """Lumped thermal model of a surface grinder with 38 temperature sensors.

    Parameters
    ----------
    ambient : AmbientCourse
        Temperature of the surroundings; all nodes begin at its first value.
    heat : callable
        Heat into each node, from `grinder_network.running_heat` or `surface_heat`.

    Notes
    -----
    Time is kept in whole nanoseconds and the heat equations in steps of ten seconds at
    multiples of ten seconds.  A step takes its heat from the state and time at its start, the
    ambient temperature at its end, as method sheet 003 section 8 does.  Between two multiples
    all states hold the value of the earlier one, however `advance` is split up.

    Examples
    --------
    The first check value of method sheet 003, an hour at work:

    >>> from fuzzycnc_ros.simulation.thermal.grinder_network import running_heat
    >>> grinder = Grinder(AmbientCourse(22.0, 2.5, -0.9), running_heat(lambda time: True))
    >>> grinder.advance(3600.0)
    >>> [f'{1e6 * value:.3f}' for value in grinder.displacement()]
    ['-5.307', '-1.149']
    """

    def __init__(self, ambient: AmbientCourse, heat: Heat) -> None:
        self._ambient = ambient
        self._heat = heat
        self._time_ns = 0
        self._steps = 0
        self._start = ambient.at(0.0)
        self._nodes = np.full(len(NODES), self._start)
        self._lagged = SENSORS.target(self._nodes, self._start)

    @property
    def time(self) -> float:
        """Time since the start of the run [s]."""
        return self._time_ns / 1e9

    @property
    def node_temperatures(self) -> Array:
        """Temperatures of the lumped nodes, shape (nodes,) [degC], in the order of `NODES`."""
        return self._nodes.copy()

    def advance(self, duration: float) -> None:
        """Let time pass.

        Parameters
        ----------
        duration : float
            How long [s], not negative; rounded to whole nanoseconds.  It need not be a
            multiple of the internal step: the rest is carried to the next call.

        Raises
        ------
        ValueError
            If the duration is negative or not finite.  The state is unchanged.
        """
        if not (isfinite(duration) and duration >= 0.0):
            raise ValueError(f'duration: expected 0 s or more but found {duration} s')
        time_ns = self._time_ns + round(duration * 1e9)
        steps = time_ns // _STEP_NS
        nodes, lagged = self._nodes, self._lagged
        for index in range(self._steps, steps):
            ambient = self._ambient.at(float((index + 1) * STEP_SECONDS))
            heat = self._heat(float(index * STEP_SECONDS), nodes)
            nodes = thermal_step(nodes, ambient, heat)
            target = SENSORS.target(nodes, ambient)
            lagged = target + SENSORS.memory * (lagged - target)
        self._time_ns, self._steps = time_ns, steps
        self._nodes, self._lagged = nodes, lagged

    def sensor_temperatures(self) -> Array:
        """Return what the sensors would show without noise, lag and offset included.

        Returns
        -------
        ndarray, shape (38,)
            Temperatures [degC], in the order of `GRINDER_SENSORS`.
        """
        return np.asarray(self._lagged + SENSORS.offset)

    def displacement(self) -> Array:
        """Return the true displacement since the start of the run, shape (2,): Y, Z [m].

        Actual minus nominal position of the wheel relative to the workpiece.
        """
        return thermal_displacement(self._nodes - self._start)
