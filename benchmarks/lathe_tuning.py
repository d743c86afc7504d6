# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The search by which the settings of the lathe axis were found, for controllers of any kind.

The spread of the axis' gain belongs into the moves: settings found
on the nominal axis alone swing on another.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.observer import ObserverNoise
from fuzzycnc_ros.core.servo.params import ServoParamsWarning, VariableUniverseParams
from fuzzycnc_ros.core.servo.stability import spectral_radii
from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
from fuzzycnc_ros.simulation.servo.lathe_axes import LatheMove
from fuzzycnc_ros.simulation.servo.positioning import PositioningBatch, position_many

_TOLERANCE = 2e-6
"""Distance to the target within which a move counts as settled [m]."""

_DURATION = 1.5
"""Length of the moves [s]."""

_SUBSTEPS = 5
"""Steps of the simulation per period; exact to 0.6 um of a second's motion."""

GAIN_SPREAD = (0.5, 0.75, 1.0, 1.25, 1.5)
"""Gains of the axis, as multiples of the nominal one, at which the loop has to settle."""

_PER_RADIUS = 100.0
"""Cost of what a spectral radius exceeds 1 by [-], which leads the search back."""

Make = Callable[[LinearAxis, Mapping[str, float]], AxisController]
"""Makes a controller of an axis from settings by name."""

BOUNDS: dict[str, tuple[float, float]] = {
    'error_exponent': (0.4, 1.0),
    'rate_exponent': (0.4, 1.0),
    'error_floor': (0.01, 0.3),
    'rate_floor': (0.05, 1.0),
    'output_gain': (0.8, 4.0),
    'rate_range': (0.2587, 1.5),
    'disturbance': (1e-3, 2e-2),
}
"""Settings of the production controller that are searched, with their bounds.

Floors, ranges and the observer's disturbance are searched by their logarithm.
"""


def production(axis: LinearAxis, settings: Mapping[str, float]) -> VariableUniverseController:
    """Return the production controller with settings of `BOUNDS`; those left out are default."""
    given: dict[str, Any] = dict(settings)
    noise = ObserverNoise()
    if 'disturbance' in given:
        noise = replace(noise, disturbance=given.pop('disturbance'))
    params = replace(VariableUniverseParams(), **given)
    return VariableUniverseController(axis, params, noise=noise)


def tuning_moves() -> list[LatheMove]:
    """Return eight moves with the gain from half to one and a half times nominal.

    Short and long ways, with and without friction and load; targets off the grid of counts.
    """
    smooth = {'coulomb': 0.0, 'breakaway': 0.0}
    cases: list[tuple[float, dict[str, float]]] = [
        (-0.05, smooth),
        (-0.05, {}),
        (0.17, {}),
        (0.05, {'gain_factor': 0.5}),
        (-0.05, {'gain_factor': 1.5}),
        (2e-5, {}),
        (-0.01, {'gain_factor': 0.7, 'load': 0.1}),
        (0.01, {'gain_factor': 1.5, 'load': -0.1, 'coulomb': 0.03, 'breakaway': 0.045}),
    ]
    return [
        LatheMove(LatheAxisConfig(**{'seed': seed, **knobs}), target + 2.9e-7)  # type: ignore[arg-type]
        for seed, (target, knobs) in enumerate(cases)
    ]


def tune(
    make: Make, bounds: Mapping[str, tuple[float, float]], *, generations: int, population: int
) -> dict[str, float]:
    """Search for settings that settle fast, do not overshoot and stay on target.

    Every generation makes all moves with all candidates side by side, so the cost of a candidate
    does not depend on the others.  The cost is that of the moves (`move_costs`) and of gains at
    which the linear loop swings (`swing_cost`).

    Parameters
    ----------
    make : callable
        Makes a controller from an axis and settings by name.
    bounds : mapping of str to (float, float)
        Settings that are searched; those whose upper bound is ten times the lower or more by
        their logarithm.
    generations : int
        Generations after the first population.
    population : int
        Candidates per setting.
    """
    moves = [
        replace(move, config=replace(move.config, substeps=_SUBSTEPS)) for move in tuning_moves()
    ]
    names = list(bounds)
    logarithmic = np.array([0.0 < low and 10.0 * low <= high for low, high in bounds.values()])
    ends = np.array(list(bounds.values()))
    ends[logarithmic] = np.log(ends[logarithmic])
    axis = LatheAxisConfig().linear()

    def settings(point: Array) -> dict[str, float]:
        values = np.where(logarithmic, np.exp(np.where(logarithmic, point, 0.0)), point)
        return dict(zip(names, values.tolist(), strict=True))

    def costs(points: Array) -> Array:
        columns = points.reshape(len(names), -1).T
        with warnings.catch_warnings():
            # candidates that do not settle are what the search is to find out
            warnings.simplefilter('ignore', ServoParamsWarning)
            made = [make(axis, settings(point)) for point in columns]
        # designing one takes longer than copying it
        controllers = [deepcopy(one) for one in made for _ in moves]
        batch = position_many(controllers, moves * len(columns), _DURATION)
        total = np.asarray(move_costs(batch).reshape(len(columns), len(moves)).sum(axis=1))
        return total + [swing_cost(one) for one in made]

    search: Any = differential_evolution  # its types do not know of vectorised costs
    found = search(
        costs,
        ends.tolist(),
        maxiter=generations,
        popsize=population,
        seed=np.random.default_rng(0),
        polish=False,
        updating='deferred',
        vectorized=True,
        tol=0.0,
    )
    return settings(found.x)


def swing_cost(controller: AxisController) -> float:
    """Return what it costs that a loop swings at a gain of `GAIN_SPREAD` [-].

    Friction hides a slow swing in moves that are over soon.  So each gain at which the spectral
    radius is 1 or more costs as much as a move that does not settle, and
    what the radius exceeds 1 by in addition.  Controllers other than the variable-universe one
    are judged by their moves alone.
    """
    if not isinstance(controller, VariableUniverseController):
        return 0.0
    radii = np.array(list(spectral_radii(controller, GAIN_SPREAD).values()))
    return float((2.0 * _DURATION + _PER_RADIUS * (radii - 1.0))[radii >= 1.0].sum())


def move_costs(batch: PositioningBatch) -> Array:
    """Return what every move costs, shape (cases,) [-].

    Settling time to 2 um in seconds, 0.3 per decade of overshoot and of error at the end above
    1 um; the run's length twice over for a move that does not settle or ends in a fault.
    """
    length = float(batch.time[-1])
    settle = batch.settle(_TOLERANCE)
    late = 1e6 * batch.steady_error(0.9 * length)
    cost = np.where(np.isfinite(settle), settle, 2.0 * length)
    cost += 0.3 * np.log10(1.0 + 1e6 * batch.overshoot) + 0.3 * np.log10(1.0 + late)
    faulty = np.array([bool(fault) for fault in batch.fault])
    return np.where(faulty, cost + 2.0 * length, cost)
