# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated vertical mill: spindle speed in, temperatures and tool displacement out."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, pi, sin

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.simulation.thermal.mill_network import (
    STEP_SECONDS,
    sensor_weights,
    thermal_displacement,
    thermal_step,
)
from fuzzycnc_ros.simulation.thermal.sensor_faults import FaultInjector, SensorFault

MILL_SENSORS = tuple(f'T{i}' for i in range(1, 77))
"""Names of the 76 temperature sensors, in the order of every array of readings."""

MILL_AXES = ('Y', 'Z')
"""Axes whose displacement the mill gives; X is neglected."""

TEMPERATURE_NOISE = 0.1
"""Standard deviation of one temperature reading [K]."""

DISPLACEMENT_NOISE = 0.3e-6
"""Standard deviation of one displacement reading [m]."""

_STEP_NS = STEP_SECONDS * 1_000_000_000
_DAY = 86_400.0


@dataclass(frozen=True)
class _Sensors:
    """How the 76 sensors see the machine; drawn once, the same for every mill."""

    weights: NDArray[np.float64]
    contact: NDArray[np.float64]
    memory: NDArray[np.float64]
    offset: NDArray[np.float64]


def _draw_sensors() -> _Sensors:
    count = len(MILL_SENSORS)
    rng = np.random.default_rng(76)
    contact = rng.uniform(0.85, 1.0, count)
    lag = rng.uniform(20.0, 90.0, count)
    offset = rng.normal(0.0, 0.15, count)
    return _Sensors(
        weights=contact[:, None] * sensor_weights(),
        contact=contact,
        memory=np.exp(-STEP_SECONDS / lag),
        offset=offset,
    )


_SENSORS = _draw_sensors()


class ThermalMill:
    """Lumped thermal model of a three-axis vertical mill with 76 temperature sensors.

    Parameters
    ----------
    base : float
        Ambient temperature at time zero [degC].
    amplitude : float
        Half of the daily swing of the ambient temperature [K].
    phase_hours : float
        Time of day at which the run starts, in hours after the upward passage [h].
    seed : int
        Seed of the readings' noise; temperatures and displacements have streams of their own,
        so reading one does not change the other.
    faults : sequence of SensorFault, optional
        What is wrong with the sensors; acts on `read` alone.

    Raises
    ------
    ValueError
        If an ambient figure is not finite or a fault names an unknown sensor.

    Notes
    -----
    Time is kept in whole nanoseconds and the heat equations in steps of five seconds at
    multiples of five seconds.  Between two multiples all states hold the value of the earlier
    one, and a step runs at the spindle speed in force at its end.  So the states depend on the
    speed over time alone, never on how `advance` was split up.

    Examples
    --------
    The first check value of method sheet 001, 80 min at 1000 rpm:

    >>> from math import pi
    >>> mill = ThermalMill(base=20.0, amplitude=2.0, phase_hours=0.0)
    >>> mill.advance(80 * 60.0, spindle_speed=1000 * 2 * pi / 60)
    >>> [f'{1e6 * value:.2f}' for value in mill.displacement()]
    ['11.15', '12.79']
    """

    def __init__(
        self,
        *,
        base: float,
        amplitude: float,
        phase_hours: float,
        seed: int = 0,
        faults: Sequence[SensorFault] = (),
    ) -> None:
        for name, value in (
            ('base', base),
            ('amplitude', amplitude),
            ('phase_hours', phase_hours),
        ):
            if not isfinite(value):
                raise ValueError(f'{name}: expected a finite number but found {value}')
        self._base = base
        self._amplitude = amplitude
        self._phase = 2.0 * pi * phase_hours / 24.0
        self._faults = FaultInjector(MILL_SENSORS, faults)
        self._reading_rng = np.random.default_rng([seed, 0])
        self._displacement_rng = np.random.default_rng([seed, 1])
        self._time_ns = 0
        self._steps = 0
        start = self.ambient(0.0)
        self._start = start
        self._nodes = np.full(_SENSORS.weights.shape[1], start)
        self._lagged = np.full(len(MILL_SENSORS), start)

    @property
    def time(self) -> float:
        """Time since the start of the run [s]."""
        return self._time_ns / 1e9

    @property
    def node_temperatures(self) -> NDArray[np.float64]:
        """Temperatures of the lumped nodes, shape (nodes,) [degC], in the order of `NODES`."""
        return self._nodes.copy()

    def ambient(self, time: float) -> float:
        """Return the ambient temperature at `time` [s] after the start of the run [degC]."""
        swing = sin(2.0 * pi * time / _DAY + self._phase) - sin(self._phase)
        return self._base + self._amplitude * swing

    def advance(self, duration: float, spindle_speed: float) -> None:
        """Let the mill run.

        Parameters
        ----------
        duration : float
            How long [s], not negative; rounded to whole nanoseconds.  It need not be a
            multiple of the internal step: the rest is carried to the next call.
        spindle_speed : float
            Spindle speed meanwhile [rad/s]; the sign does not matter.

        Raises
        ------
        ValueError
            If the duration is negative or not finite, or the speed is not finite or beyond
            24 000 rpm.  The state is unchanged.
        """
        if not (isfinite(duration) and duration >= 0.0):
            raise ValueError(f'duration: expected 0 s or more but found {duration} s')
        step = thermal_step(float(spindle_speed))
        self._time_ns += round(duration * 1e9)
        sensors, nodes, lagged = _SENSORS, self._nodes, self._lagged
        for index in range(self._steps + 1, self._time_ns // _STEP_NS + 1):
            ambient = self.ambient(float(index * STEP_SECONDS))
            nodes = step.advance(nodes, ambient)
            target = sensors.weights @ nodes + (1.0 - sensors.contact) * ambient
            lagged = target + sensors.memory * (lagged - target)
        self._steps = self._time_ns // _STEP_NS
        self._nodes, self._lagged = nodes, lagged

    def sensor_temperatures(self) -> NDArray[np.float64]:
        """Return what healthy sensors would show without noise: contact, lag, offset included.

        Returns
        -------
        ndarray, shape (76,)
            Temperatures [degC], in the order of `MILL_SENSORS`.
        """
        return self._lagged + _SENSORS.offset

    def read(self, rng: np.random.Generator | None = None) -> NDArray[np.float64]:
        """Read every sensor once, with noise and with the faults that act by now.

        Parameters
        ----------
        rng : numpy.random.Generator, optional
            Source of the noise; the mill's own seeded stream if left out.

        Returns
        -------
        ndarray, shape (76,)
            Readings [degC]; NaN for a dead sensor.
        """
        source = self._reading_rng if rng is None else rng
        noise = source.normal(0.0, TEMPERATURE_NOISE, len(MILL_SENSORS))
        return self._faults.apply(self.time, self.sensor_temperatures() + noise)

    def displacement(self) -> NDArray[np.float64]:
        """Return the true displacement since the start of the run, shape (2,): Y, Z [m].

        Actual minus nominal position relative to the workpiece, without any compensation.
        """
        return thermal_displacement(self._nodes - self._start)

    def measure_displacement(self, rng: np.random.Generator | None = None) -> NDArray[np.float64]:
        """Measure the displacement once, shape (2,): Y, Z [m], with 0.3 um of noise.

        Parameters
        ----------
        rng : numpy.random.Generator, optional
            Source of the noise; the mill's own seeded stream if left out.
        """
        source = self._displacement_rng if rng is None else rng
        return self.displacement() + source.normal(0.0, DISPLACEMENT_NOISE, len(MILL_AXES))
