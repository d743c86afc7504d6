# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The simulated surface grinder: heat in, temperatures and displacement of the wheel out.

It is a lumped thermal network.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import pairwise
from math import isfinite, pi

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.simulation.thermal.thermal_network import ThermalNetwork

GRINDER_STEP = 10
"""Internal step [s]; the check values belong to it."""

_COLUMN = ('c0', 'c1', 'c2', 'c3')
_SLIDE_Y = ('y0', 'y1', 'y2')
_SLIDE_Z = ('z0', 'z1', 'z2')
_TABLE = ('x0', 'x1', 'x2')
_BED = ('b0', 'b1', 'b2')

# Heat capacity [kJ/K] and loss to the surroundings [W/K].
_NODES: dict[str, tuple[float, float]] = {
    'sp': (6.0, 0.4),  # spindle
    'wh': (30.0, 4.0),  # wheel head
    'sh': (12.0, 3.0),  # spindle shield
    **dict.fromkeys(_COLUMN, (90.0, 6.0)),
    **dict.fromkeys(_SLIDE_Y, (25.0, 2.0)),
    **dict.fromkeys(_SLIDE_Z, (30.0, 2.5)),
    **dict.fromkeys(_TABLE, (60.0, 5.0)),
    **dict.fromkeys(_BED, (160.0, 9.0)),
    'oil': (80.0, 10.0),  # hydraulic tank
    'pipe': (10.0, 3.0),
}

# Conductance between two nodes [W/K].  The order matters: it numbers a node's neighbours.
_LINKS: dict[tuple[str, str], float] = {
    ('sp', 'wh'): 25.0,
    ('sp', 'sh'): 8.0,
    ('wh', 'sh'): 4.0,
    ('wh', 'y0'): 18.0,
    ('y0', 'y1'): 20.0,
    ('y1', 'y2'): 20.0,
    ('y1', 'c2'): 12.0,
    ('y0', 'c3'): 8.0,
    **dict.fromkeys(pairwise(_COLUMN), 30.0),
    ('c0', 'z1'): 20.0,
    ('z0', 'z1'): 22.0,
    ('z1', 'z2'): 22.0,
    ('z0', 'b0'): 15.0,
    ('z2', 'b1'): 15.0,
    ('x0', 'x1'): 15.0,
    ('x1', 'x2'): 15.0,
    ('x1', 'b1'): 12.0,
    ('b0', 'b1'): 40.0,
    ('b1', 'b2'): 40.0,
    ('oil', 'pipe'): 15.0,
    ('pipe', 'x1'): 10.0,
    ('oil', 'b2'): 6.0,
}

_NETWORK = ThermalNetwork.of(_NODES, _LINKS)
_mean_row = _NETWORK.mean_row

GRINDER_NODES = _NETWORK.node
"""Names of the nodes, in the order of every array."""

GRINDER_CAPACITY = _NETWORK.capacity
"""Heat capacity of each node, shape (nodes,) [J/K]."""

GRINDER_LOSS = _NETWORK.loss
"""Loss of each node to the surroundings, shape (nodes,) [W/K]."""

_SOLVED, _STORAGE = _NETWORK.implicit_euler(GRINDER_STEP)


def grinder_step(temperatures: Array, ambient: float, heat: Array) -> Array:
    """Return the node temperatures one implicit Euler step later, shape (nodes,) [degC].

    Parameters
    ----------
    temperatures : ndarray, shape (nodes,)
        Temperatures at the start of the step [degC].
    ambient : float
        Ambient temperature at its end [degC].
    heat : ndarray, shape (nodes,)
        Heat that flows into each node during the step [W].
    """
    return np.asarray(
        portable.matmul(_SOLVED, _STORAGE * temperatures + GRINDER_LOSS * ambient + heat)
    )


Heat = Callable[[float, Array], Array]
"""Heat into each node, shape (nodes,) [W], from the time [s] and the temperatures [degC]."""

_SPINDLE = GRINDER_NODES.index('sp')


def _row(**values: float) -> Array:
    return np.array([values.get(name, 0.0) for name in GRINDER_NODES])


_OIL_IDLE = _row(oil=15.0)
_RUNNING = _OIL_IDLE + _row(
    wh=60.0, x1=45.0, x0=20.0, x2=20.0, z1=60.0, y1=15.0, pipe=10.0, oil=160.0
)


def running_heat(running: Callable[[float], bool]) -> Heat:
    """Return the heat of the grinder at work.

    Parameters
    ----------
    running : callable
        Whether the spindle turns and the table cycles at a time [s].
    """

    def heat(time: float, temperatures: Array) -> Array:
        if not running(time):
            return _OIL_IDLE
        watts = _RUNNING.copy()
        # Warm grease rubs less.
        watts[_SPINDLE] += 230.0 * portable.exp(-0.010 * (float(temperatures[_SPINDLE]) - 22.0))
        return watts

    return heat


FLUX_PLACES = ('X', 'Y', 'Z', 'spindle')
"""Surfaces that the flux cases heat, in the order of every array of fluxes."""

_FLUX_AREA = np.array([0.28, 0.14, 0.21, 0.084])  # m^2
_FLUX_SPREAD = np.stack(
    [
        _row(x0=0.3, x1=0.4, x2=0.3),
        _row(y0=0.4, y1=0.3, y2=0.3),
        _row(z0=0.3, z1=0.4, z2=0.3),
        _row(sp=0.7, wh=0.3),
    ]
)


def surface_heat(flux: Callable[[float], Array]) -> Heat:
    """Return the heat of fluxes into the surfaces of a grinder that stands still.

    Parameters
    ----------
    flux : callable
        Flux into each of `FLUX_PLACES`, shape (4,) [W/m^2], at a time [s].
    """

    def heat(time: float, temperatures: Array) -> Array:
        return np.asarray(portable.matmul((_FLUX_AREA * flux(time)), _FLUX_SPREAD))

    return heat


# Groups of nodes whose mean rise moves the wheel, and by how much in Y and Z [m/m].
_ERROR_GROUPS: dict[tuple[str, ...], tuple[float, float]] = {
    ('sp',): (-0.02, -0.037),
    ('wh',): (-0.035, -0.118),
    _COLUMN: (-0.03, -0.065),
    ('c2', 'c3'): (-0.17, -0.298),
    _SLIDE_Y: (-0.22, -0.337),
    _SLIDE_Z: (0.30, 0.434),
    ('b0', 'b1'): (0.19, 0.302),
    ('x1',): (0.165, 0.232),
    ('oil',): (0.035, 0.347),
}
_EXPANSION = 10.2e-6  # of cast iron, m/(m K), on a length of 1 m
_ERROR_WEIGHTS = _EXPANSION * (
    portable.matmul(
        np.array(list(_ERROR_GROUPS.values())).T,
        np.array([_mean_row(*nodes) for nodes in _ERROR_GROUPS]),
    )
)


def grinder_displacement(rise: Array) -> Array:
    """Displacement of the wheel in Y and Z that the rises of the nodes cause.

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
    return np.asarray(1e-6 * (linear + 0.006 * linear * np.abs(linear)))


AIR_SENSORS = tuple(f'air{i}' for i in range(1, 11))
"""Names of the ten sensors in the surrounding air."""

# Name and node of each sensor on the machine.
_PLACES: dict[str, str] = {
    'spindle1': 'sp',
    'spindle2': 'sp',
    'wheel_head1': 'wh',
    'wheel_head2': 'wh',
    'shield1': 'sh',
    'shield2': 'sh',
    **{f'column{2 * i + k}': node for i, node in enumerate(_COLUMN) for k in (1, 2)},
    **{f'slide_y{i}': node for i, node in enumerate(('y0', 'y1', 'y1', 'y2'), 1)},
    **{f'slide_z{i}': node for i, node in enumerate(('z0', 'z1', 'z1', 'z2'), 1)},
    'table1': 'x0',
    'table2': 'x1',
    'bed1': 'b0',
    'bed2': 'b2',
    'oil1': 'oil',
    'oil2': 'oil',
}
MACHINE_SENSORS = tuple(_PLACES)
"""Names of the 28 sensors on the machine."""

GRINDER_SENSORS = MACHINE_SENSORS + AIR_SENSORS
"""Names of all 38 sensors, in the order of every array of readings."""


@dataclass(frozen=True, eq=False)
class _GrinderSensors:
    """Sensitivity of the 38 sensors to nodes and air; drawn once, the same for every grinder.

    A sensor follows `weights` T + `air` ambient + `shift` through a first-order lag and shows
    that plus `offset`.

    Parameters
    ----------
    weights : ndarray, shape (38, nodes)
        Weight of each node [-]; zero for air sensors.
    air : ndarray, shape (38,)
        Weight of the ambient temperature [-].
    shift : ndarray, shape (38,)
        How much warmer than the ambient the air is at the sensor [K]; zero on the machine.
    memory : ndarray, shape (38,)
        What a step leaves of a sensor's distance from its target [-].
    offset : ndarray, shape (38,)
        Calibration error [K].
    """

    weights: Array
    air: Array
    shift: Array
    memory: Array
    offset: Array

    def target(self, temperatures: Array, ambient: float) -> Array:
        """Return where the sensors are heading, shape (38,) [degC]."""
        return np.asarray(
            portable.matmul(self.weights, temperatures) + self.air * ambient + self.shift
        )


def _draw_sensors() -> _GrinderSensors:
    """Draw the sensors as the sheet does; the order of the draws is part of it."""
    rng = np.random.default_rng(28)
    machine, count = len(MACHINE_SENSORS), len(GRINDER_SENSORS)
    weights = np.zeros((count, len(GRINDER_NODES)))
    for row, node in zip(weights, _PLACES.values(), strict=False):
        neighbours = [b if a == node else a for a, b in _LINKS if node in (a, b)]
        rng.integers(21)  # of no consequence but for the stream
        other = neighbours[rng.integers(len(neighbours))]
        row[GRINDER_NODES.index(node)] += 0.9
        row[GRINDER_NODES.index(other)] += 0.1
    lag = rng.uniform(60.0, 200.0, count)  # the last ten are replaced by those of the air
    air = np.ones(count)
    air[:machine] = rng.uniform(0.0, 0.3, machine)
    offset = rng.normal(0.0, 0.3, count)
    shift = np.zeros(count)
    shift[machine:] = 0.3 * rng.uniform(-1.0, 1.0, count - machine)
    lag[machine:] = rng.uniform(600.0, 2400.0, count - machine)
    return _GrinderSensors(
        weights=(1.0 - air)[:, np.newaxis] * weights,
        air=air,
        shift=shift,
        memory=portable.exp(-GRINDER_STEP / lag),
        offset=offset,
    )


SENSORS = _draw_sensors()
"""The sensors of every grinder."""


GRINDER_AXES = ('Y', 'Z')
"""Axes whose displacement the grinder gives; X is hydraulic and not compensated."""

_STEP_NS = GRINDER_STEP * 1_000_000_000


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
        swing = portable.sin(2.0 * pi * time / self.period + self.phase) - portable.sin(self.phase)
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
    ambient temperature at its end.  Between two multiples
    all states hold the value of the earlier one, however `advance` is split up.

    Examples
    --------
    A check value, an hour at work:

    >>> from fuzzycnc_ros.simulation.thermal.grinder import running_heat
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
        self._nodes = np.full(len(GRINDER_NODES), self._start)
        self._lagged = SENSORS.target(self._nodes, self._start)

    @property
    def time(self) -> float:
        """Time since the start of the run [s]."""
        return self._time_ns / 1e9

    @property
    def node_temperatures(self) -> Array:
        """Temperatures of the lumped nodes, shape (nodes,) [degC], as in `GRINDER_NODES`."""
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
            ambient = self._ambient.at(float((index + 1) * GRINDER_STEP))
            heat = self._heat(float(index * GRINDER_STEP), nodes)
            nodes = grinder_step(nodes, ambient, heat)
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
        return grinder_displacement(self._nodes - self._start)
