# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated vertical mill: spindle speed in, temperatures and tool displacement out.

It is a lumped thermal network with an implicit step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, pairwise
from math import isfinite, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.simulation.thermal.sensor_faults import FaultInjector, SensorFault
from fuzzycnc_ros.simulation.thermal.thermal_network import ThermalNetwork

MILL_STEP = 5
"""Internal step [s]; the check values belong to it."""

RPM = 2.0 * pi / 60.0
"""One revolution per minute [rad/s]."""

SPEED_MAX = 24_000.0 * RPM
"""Largest spindle speed that is taken [rad/s]; beyond it the heat sources mean nothing."""

_CARRIER_1 = tuple(f'b1{i}' for i in range(5))
_CARRIER_2 = tuple(f'b2{i}' for i in range(5))
_OUTER = ('co0', 'co1', 'co2')
_INNER = ('ci0', 'ci1', 'ci2')

# Heat capacity [kJ/K] and loss to the surroundings [W/K].
_NODES: dict[str, tuple[float, float]] = {
    'shaft': (5.5, 0.3),
    'fb': (2.0, 0.3),  # front bearing
    'rb': (1.5, 0.3),  # rear bearing
    'sh': (11.5, 2.5),  # spindle housing
    'tn': (3.0, 0.8),  # tool and tool nose
    'mo': (14.0, 6.0),  # motor
    'hd': (28.0, 4.0),  # head
    **dict.fromkeys(_CARRIER_1, (18.0, 2.5)),
    **dict.fromkeys(_CARRIER_2, (20.0, 2.5)),
    **dict.fromkeys(_OUTER, (55.0, 5.0)),  # column, outer wall
    **dict.fromkeys(_INNER, (55.0, 2.5)),  # column, inner wall
    'ct': (23.0, 3.0),  # column top
    'bt': (138.0, 8.0),  # bed top
    'bb': (138.0, 6.0),  # bed bottom
    'bs': (69.0, 6.0),  # bed side
    'bo': (18.0, 4.0),  # beam outside
    'zs': (2.8, 0.5),  # screw of Z
    'ys': (4.0, 0.8),  # screw of Y
}

# Conductance between two nodes [W/K].
_LINKS: dict[tuple[str, str], float] = {
    ('shaft', 'fb'): 12.0,
    ('shaft', 'rb'): 10.0,
    ('fb', 'sh'): 25.0,
    ('rb', 'sh'): 20.0,
    ('shaft', 'tn'): 6.0,
    ('tn', 'sh'): 4.0,
    ('sh', 'hd'): 30.0,
    ('mo', 'hd'): 12.0,
    ('mo', 'sh'): 6.0,
    ('hd', 'b10'): 25.0,
    ('hd', 'b20'): 25.0,
    **dict.fromkeys(pairwise(_CARRIER_1), 30.0),
    **dict.fromkeys(pairwise(_CARRIER_2), 24.0),
    **dict.fromkeys(chain(pairwise(_OUTER), pairwise(_INNER)), 12.0),
    **dict.fromkeys(zip(_OUTER, _INNER, strict=True), 6.0),
    ('b14', 'ct'): 15.0,
    ('b24', 'ci2'): 15.0,
    ('b12', 'bo'): 8.0,
    ('b22', 'bo'): 8.0,
    ('ct', 'co2'): 15.0,
    ('ct', 'ci2'): 15.0,
    ('bt', 'co0'): 10.0,
    ('bt', 'ci0'): 10.0,
    ('bt', 'bb'): 25.0,
    ('bt', 'bs'): 15.0,
    ('bb', 'bs'): 15.0,
    ('zs', 'b12'): 10.0,
    ('zs', 'hd'): 5.0,
    ('ys', 'bt'): 8.0,
}

_NETWORK = ThermalNetwork.of(_NODES, _LINKS)
_mean_row = _NETWORK.mean_row

MILL_NODES = _NETWORK.node
"""Names of the nodes, in the order of every array."""

_INDEX = {name: i for i, name in enumerate(MILL_NODES)}

MILL_CAPACITY = _NETWORK.capacity
"""Heat capacity of each node, shape (nodes,) [J/K]."""

MILL_LOSS = _NETWORK.loss
"""Loss of each node to the surroundings at standstill, shape (nodes,) [W/K]."""

_FRONT, _REAR = _INDEX['fb'], _INDEX['rb']


@dataclass(frozen=True)
class _ThermalStep:
    """One implicit Euler step of the network at a fixed spindle speed.

    Losses depend on the spindle speed alone, so the solved matrix serves every step at that
    speed; only the friction of the two bearings follows the temperature and is taken from the
    old state.
    """

    matrix: NDArray[np.float64]
    """Maps [temperatures, ambient, front heat, rear heat, 1] to the new temperatures."""
    bearing_heat: tuple[float, float]
    """Friction of front and rear bearing at 20 degC [W]."""

    def advance(self, temperatures: NDArray[np.float64], ambient: float) -> NDArray[np.float64]:
        """Return the node temperatures one step later, shape (nodes,) [degC]."""
        front, rear = self.bearing_heat
        source = np.empty(len(MILL_NODES) + 4)
        source[: len(MILL_NODES)] = temperatures
        source[-4] = ambient
        source[-3] = front * portable.exp(-0.012 * (temperatures[_FRONT] - 20.0))
        source[-2] = rear * portable.exp(-0.012 * (temperatures[_REAR] - 20.0))
        source[-1] = 1.0
        return portable.matmul(self.matrix, source)


@lru_cache(maxsize=64)
def mill_step(spindle_speed: float) -> _ThermalStep:
    """Solve the implicit step of `MILL_STEP` at a spindle speed.

    Parameters
    ----------
    spindle_speed : float
        Spindle speed [rad/s]; the sign does not matter.

    Returns
    -------
    ThermalStep
        Step of the whole network; the sixty-four speeds used last are kept.

    Raises
    ------
    ValueError
        If the speed is not finite or beyond `SPEED_MAX`.
    """
    if not (isfinite(spindle_speed) and abs(spindle_speed) <= SPEED_MAX):
        raise ValueError(
            f'spindle_speed: expected a speed within {SPEED_MAX / RPM:.0f} rpm '
            f'but found {spindle_speed / RPM:.6g} rpm ({spindle_speed:.6g} rad/s)'
        )
    u = abs(spindle_speed) / RPM / 1000.0
    loss = MILL_LOSS.copy()
    loss[_INDEX['tn']] *= 1.0 + 1.2 * u
    loss[_INDEX['sh']] *= 1.0 + 0.3 * u
    loss[_INDEX['mo']] *= 1.0 + 0.5 * u
    heat = np.zeros(len(MILL_NODES))
    heat[_INDEX['mo']] = 40.0 * u + 25.0 * u * u
    if u > 0.0:  # the screws warm up while a program moves the axes
        heat[_INDEX['zs']] = 12.0
        heat[_INDEX['ys']] = 15.0
    solved, storage = _NETWORK.implicit_euler(MILL_STEP, loss)
    matrix = np.column_stack(
        [
            solved * storage,
            portable.matmul(solved, loss),
            solved[:, _FRONT],
            solved[:, _REAR],
            portable.matmul(solved, heat),
        ]
    )
    return _ThermalStep(matrix, (55.0 * u * sqrt(u), 35.0 * u * sqrt(u)))


def _along(names: tuple[str, ...], count: int) -> list[NDArray[np.float64]]:
    """Weights of `count` sensors spread evenly over a chain of nodes."""
    nodes = np.eye(len(MILL_NODES))[[_INDEX[name] for name in names]]
    place = np.linspace(0.0, len(names) - 1.0, count)
    left = np.minimum(place.astype(int), len(names) - 2)
    share = (place - left)[:, None]
    return list((1.0 - share) * nodes[left] + share * nodes[left + 1])


def sensor_weights() -> NDArray[np.float64]:
    """Return the sensors' weights of the nodes, shape (76, nodes) [-]; rows sum to 1."""
    single = {
        62: ('fb', 'sh'),
        63: ('rb', 'sh'),
        64: ('bb',),
        65: ('bb', 'bs'),
        66: ('bt',),
        67: ('bt', 'ys'),
        68: ('ct',),
        69: ('bo',),
        70: ('bs',),
        71: ('bs', 'bb'),
        72: ('hd',),
    }
    return np.array(
        [
            *_along(_OUTER, 7),
            *_along(_CARRIER_1, 25),
            *_along(_CARRIER_2, 29),
            *(_mean_row(*names) for names in single.values()),
            *(_mean_row(name) for name in _INNER),
            _mean_row('tn'),
        ]
    )


def _error_weights() -> NDArray[np.float64]:
    """Weights of the rises in the linear error of Y and Z, shape (2, nodes) [m/K]."""
    outer, inner = _mean_row(*_OUTER), _mean_row(*_INNER)
    shaft, head = _mean_row('shaft'), _mean_row('hd')
    y = (
        0.45 * _mean_row(*_CARRIER_1, *_CARRIER_2)
        + 0.25 * head
        + 0.10 * shaft
        + 1.6 * (inner - outer)
        - 0.20 * _mean_row('ys')
    )
    z = (
        0.22 * shaft
        + 0.12 * _mean_row('sh')
        + 0.08 * _mean_row('tn')
        + 0.20 * head
        - 0.70 * outer
        - 0.50 * inner
        + 0.30 * _mean_row('zs')
    )
    return 11e-6 * np.stack([y, z])


_ERROR_WEIGHTS = _error_weights()
_ERROR_SCALE = np.array([0.71607, 0.32550])


def mill_displacement(rise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacement of the tool in Y and Z that the rises of the nodes cause.

    Parameters
    ----------
    rise : ndarray, shape (..., nodes)
        Rise of each node over the start of the run [K].

    Returns
    -------
    ndarray, shape (..., 2)
        Actual minus nominal position in Y and Z [m].
    """
    linear = 1e6 * (
        portable.matmul(rise, _ERROR_WEIGHTS.T)
    )  # the quadratic term is defined in micrometres
    return np.asarray(1e-6 * _ERROR_SCALE * (linear + 0.0015 * (linear * linear)))


MILL_SENSORS = tuple(f'T{i}' for i in range(1, 77))
"""Names of the 76 temperature sensors, in the order of every array of readings."""

MILL_AXES = ('Y', 'Z')
"""Axes whose displacement the mill gives; X is neglected."""

TEMPERATURE_NOISE = 0.1
"""Standard deviation of one temperature reading [K]."""

DISPLACEMENT_NOISE = 0.3e-6
"""Standard deviation of one displacement reading [m]."""

_STEP_NS = MILL_STEP * 1_000_000_000
_DAY = 86_400.0


@dataclass(frozen=True)
class _Sensors:
    """Sensitivity of the 76 sensors to the machine; drawn once, the same for every mill."""

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
        memory=portable.exp(-MILL_STEP / lag),
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
    A check value, 80 min at 1000 rpm:

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
        """Temperatures of the lumped nodes, shape (nodes,) [degC], as in `MILL_NODES`."""
        return self._nodes.copy()

    def ambient(self, time: float) -> float:
        """Return the ambient temperature at `time` [s] after the start of the run [degC]."""
        swing = portable.sin(2.0 * pi * time / _DAY + self._phase) - portable.sin(self._phase)
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
        step = mill_step(float(spindle_speed))
        self._time_ns += round(duration * 1e9)
        sensors, nodes, lagged = _SENSORS, self._nodes, self._lagged
        for index in range(self._steps + 1, self._time_ns // _STEP_NS + 1):
            ambient = self.ambient(float(index * MILL_STEP))
            nodes = step.advance(nodes, ambient)
            target = portable.matmul(sensors.weights, nodes) + (1.0 - sensors.contact) * ambient
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
        return mill_displacement(self._nodes - self._start)

    def measure_displacement(
        self, rng: np.random.Generator | None = None, noise: float = DISPLACEMENT_NOISE
    ) -> NDArray[np.float64]:
        """Measure the displacement once, shape (2,): Y, Z [m].

        Parameters
        ----------
        rng : numpy.random.Generator, optional
            Source of the noise; the mill's own seeded stream if left out.
        noise : float
            Standard deviation of the measurement [m].
        """
        source = self._displacement_rng if rng is None else rng
        return self.displacement() + source.normal(0.0, noise, len(MILL_AXES))
