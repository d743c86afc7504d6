# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Experiments and flux cases of the simulated grinder."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite, pi, sqrt

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.simulation.thermal.grinder import (
    FLUX_PLACES,
    GRINDER_AXES,
    GRINDER_SENSORS,
    MACHINE_SENSORS,
    AmbientCourse,
    Grinder,
    Heat,
    running_heat,
    surface_heat,
)

SAMPLE_INTERVAL = 60.0
"""Time between two rows of a recording [s]."""

_TEMPERATURE_NOISE = 0.1 / sqrt(5.0)
"""Standard deviation of a recorded temperature, the mean of five readings [K]."""

_DISPLACEMENT_NOISE = 0.1e-6
"""Standard deviation of a recorded displacement [m]."""

_HOUR = 3600.0
_LEVEL_SECONDS = 1200.0  # a random flux changes this often
_LEVELS = 48  # drawn of each random flux; eight hours use 24


@dataclass(frozen=True, eq=False)
class GrinderCase:
    """Heat sources of a grinder, its surroundings and the duration.

    Parameters
    ----------
    name : str
        Name of the case and of its runs.
    ambient : AmbientCourse
        Temperature of the surroundings.
    heat : callable
        Heat into each node, see `Grinder`.
    duration : float
        Length [s]; a multiple of `SAMPLE_INTERVAL`.
    """

    name: str
    ambient: AmbientCourse
    heat: Heat
    duration: float

    def grinder(self) -> Grinder:
        """Return a grinder at the start of the case."""
        return Grinder(self.ambient, self.heat)


GRINDER_EXPERIMENTS: Mapping[str, GrinderCase] = {
    case.name: case
    for case in (
        GrinderCase(
            'E1', AmbientCourse(22.0, 2.5, -0.9), running_heat(lambda time: True), 8.0 * _HOUR
        ),
        GrinderCase(
            'E2', AmbientCourse(27.0, 2.5, 1.6), running_heat(lambda time: True), 7.5 * _HOUR
        ),
        GrinderCase(
            'E3',
            AmbientCourse(24.0, 2.0, -0.4),
            running_heat(lambda time: time // 1800.0 % 2.0 == 0.0),
            5.0 * _HOUR,
        ),
    )
}
"""Experiments by name, in the order in which their noise is drawn.

Continuous work on an ordinary day, the same on a warm one, and 30 min on, 30 min off.
"""


def _constant(*flux: float) -> Callable[[float], Array]:
    levels = np.array(flux)
    return lambda time: levels


_FLUX_MAX = np.array([1000.0, 300.0, 500.0, 1000.0])  # W/m^2, regular and random
_REGULAR_PERIOD = 60.0 * np.array([120.0, 96.0, 80.0, 160.0])  # s


def _regular(time: float) -> Array:
    wave = portable.sin(2.0 * pi * time / _REGULAR_PERIOD - pi / 2.0)
    return np.asarray(0.5 * _FLUX_MAX * (1.0 + wave))


def _random() -> Callable[[float], Array]:
    levels = _FLUX_MAX * np.random.default_rng(5).uniform(0.0, 1.0, (len(FLUX_PLACES), _LEVELS)).T
    return lambda time: np.asarray(levels[int(time // _LEVEL_SECONDS)])


_DAY_CURVE = AmbientCourse(20.0, 7.2, 0.0, 16.0 * _HOUR)

FLUX_CASES: Mapping[str, GrinderCase] = {
    case.name: case
    for case in (
        GrinderCase(name, ambient, surface_heat(flux), 8.0 * _HOUR)
        for name, ambient, flux in (
            ('constant1', AmbientCourse(22.0), _constant(600.0, 200.0, 400.0, 800.0)),
            ('constant2', AmbientCourse(22.0), _constant(1000.0, 150.0, 700.0, 1500.0)),
            ('regular', _DAY_CURVE, _regular),
            ('random', _DAY_CURVE, _random()),
        )
    )
}
"""Heat fluxes into the surfaces of a grinder that stands still, by name."""


@lru_cache(maxsize=16)
def simulate_grinder(case: GrinderCase) -> ThermalRun:
    """Run a case and record it without noise; its displacement is the truth.

    Parameters
    ----------
    case : GrinderCase
        What to run.

    Returns
    -------
    ThermalRun
        A row a minute with all 38 sensors and both axes, from time 0 to the end of the case,
        both included: 481 rows for eight hours.

    Raises
    ------
    ValueError
        If the duration is not a positive multiple of `SAMPLE_INTERVAL`.
    """
    rows = round(case.duration / SAMPLE_INTERVAL) if isfinite(case.duration) else 0
    if rows < 1 or abs(rows * SAMPLE_INTERVAL - case.duration) > 1e-6:
        raise ValueError(
            f'duration: expected a positive multiple of {SAMPLE_INTERVAL:g} s in case '
            f'{case.name} but found {case.duration:g} s'
        )
    grinder = case.grinder()
    temperature, displacement = [grinder.sensor_temperatures()], [grinder.displacement()]
    for _ in range(rows):
        grinder.advance(SAMPLE_INTERVAL)
        temperature.append(grinder.sensor_temperatures())
        displacement.append(grinder.displacement())
    return _run(case.name, GRINDER_SENSORS, np.array(temperature), np.array(displacement))


def record_grinder(
    names: Iterable[str] = tuple(GRINDER_EXPERIMENTS), seed: int = 0, *, sensors: int = 38
) -> dict[str, ThermalRun]:
    """Record experiments with seeded noise, one row a minute.

    Parameters
    ----------
    names : iterable of str
        Experiments of `GRINDER_EXPERIMENTS`.
    seed : int
        Seed s: noise comes from `default_rng(300 + s)`, drawn for E1, E2, E3 in
        this order, per run first all temperatures row by row, then Y, then Z.  A run's noise
        is the same whichever names and sensors are asked for.
    sensors : {28, 38}
        28 leaves out the ten sensors in the air, which come last.

    Returns
    -------
    dict of str to ThermalRun
        The runs in the order asked for.  The true displacement is `simulate_grinder`'s.

    Raises
    ------
    ValueError
        If a name is no experiment, or there is no such set of sensors.

    Notes
    -----
    Published rises are those over the first reading: `run.rise(run.temperature[0])`.
    """
    wanted = _known(names, GRINDER_EXPERIMENTS, 'names: expected experiments')
    sets = {len(MACHINE_SENSORS): MACHINE_SENSORS, len(GRINDER_SENSORS): GRINDER_SENSORS}
    if sensors not in sets:
        raise ValueError(
            f'sensors: expected 28 (machine) or 38 (machine and air) but found {sensors}'
        )
    rng = np.random.default_rng(300 + seed)
    # A run that was not asked for still takes its noise, else the later ones would change.
    recorded = {}
    for name, case in GRINDER_EXPERIMENTS.items():
        truth = simulate_grinder(case)
        temperature = truth.temperature + rng.normal(
            0.0, _TEMPERATURE_NOISE, truth.temperature.shape
        )
        noise = [rng.normal(0.0, _DISPLACEMENT_NOISE, len(truth.time)) for _ in GRINDER_AXES]
        recorded[name] = _run(
            name,
            sets[sensors],
            temperature[:, :sensors],
            truth.displacement + np.column_stack(noise),
        )
    return {name: recorded[name] for name in wanted}


def record_flux_case(name: str, noise: float = 0.0, seed: int = 0) -> ThermalRun:
    """Record a flux case: 28 sensors, and noise in proportion to the rise.

    Parameters
    ----------
    name : str
        One of `FLUX_CASES`.
    noise : float
        Each rise is multiplied by 1 + uniform(-noise, noise) [-]; in [0, 1].  The displacement
        stays clean.
    seed : int
        Seed of the noise; each case draws noise of its own.

    Returns
    -------
    ThermalRun
        A row a minute.  Its first row is free of noise, so that
        `run.rise(run.temperature[0])` is the noisy rise.

    Raises
    ------
    ValueError
        If the name is no flux case, or the noise is outside [0, 1].

    Notes
    -----
    Y alone is judged.  Z is there too, about twice as large.
    """
    _known([name], FLUX_CASES, 'name: expected a flux case')
    if not 0.0 <= noise <= 1.0:
        raise ValueError(f'noise: expected a fraction from 0 to 1 but found {noise}')
    truth = simulate_grinder(FLUX_CASES[name])
    clean = truth.temperature[:, : len(MACHINE_SENSORS)]
    rise = clean - clean[0]
    # Cases have streams of their own, else a model would be judged under the noise it learnt.
    rng = np.random.default_rng([seed, tuple(FLUX_CASES).index(name)])
    factor = 1.0 + rng.uniform(-noise, noise, rise.shape)
    return _run(name, MACHINE_SENSORS, clean[0] + factor * rise, truth.displacement)


def _known(names: Iterable[str], table: Mapping[str, GrinderCase], what: str) -> tuple[str, ...]:
    """Return the names after refusing those that are not in the table."""
    wanted = tuple(names)
    unknown = [name for name in wanted if name not in table]
    if unknown:
        raise ValueError(f'{what} among {", ".join(table)} but found {", ".join(unknown)}')
    return wanted


def _run(
    name: str, sensors: tuple[str, ...], temperature: Array, displacement: Array
) -> ThermalRun:
    return ThermalRun(
        name=name,
        time=SAMPLE_INTERVAL * np.arange(len(temperature), dtype=np.float64),
        sensor=sensors,
        temperature=temperature,
        channel=GRINDER_AXES,
        axis=GRINDER_AXES,
        displacement=displacement,
    )
