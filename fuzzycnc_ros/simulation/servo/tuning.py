# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of a controller from simulated moves, by differential evolution.

The spread of the axis' gain belongs into the moves: settings found
on the nominal axis alone swing on another.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
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

_SUBSTEPS = 5
"""Steps of the simulation per period; exact to 0.6 um of a second's motion."""

GAIN_SPREAD = (0.5, 0.75, 1.0, 1.25, 1.5)
"""Gains of the axis, as multiples of the nominal one, at which the loop has to settle."""

_PER_RADIUS = 100.0
"""Cost of what a spectral radius exceeds 1 by [-], which leads the search back."""

_Progress = Callable[[int, int, float], None]
"""Told after every generation: generation, their largest number, best cost so far."""

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


@dataclass(frozen=True, eq=False)
class TuningResult:
    """What the search found.

    Attributes
    ----------
    settings : dict of str to float
        Best settings by name.
    cost : float
        Their cost.
    history : tuple of float
        Best cost after every generation.
    evaluations : int
        Settings that were tried.
    moves : tuple of LatheMove
        What they were judged by.
    """

    settings: dict[str, float]
    cost: float
    history: tuple[float, ...]
    evaluations: int
    moves: tuple[LatheMove, ...] = field(repr=False)


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
    make: Make = production,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    moves: Sequence[LatheMove] | None = None,
    *,
    seed: int = 0,
    generations: int = 30,
    population: int = 6,
    duration: float = 1.5,
    progress: _Progress | None = None,
) -> TuningResult:
    """Search for settings that settle fast, do not overshoot and stay on target.

    Every generation makes all moves with all candidates side by side, so the cost of a candidate
    does not depend on the others and the result on nothing but the seed.  The cost is that of the
    moves (`move_costs`) and of gains at which the linear loop swings (`swing_cost`).

    Parameters
    ----------
    make : callable
        Makes a controller from an axis and settings by name; by default the production one.
    bounds : mapping of str to (float, float), optional
        Settings that are searched; those whose upper bound is ten times the lower or more by
        their logarithm.  By default `BOUNDS`.
    moves : sequence of LatheMove, optional
        Moves of the lathe axis; by default `tuning_moves()`.
    seed : int
        Seed of the search.
    generations : int
        Generations after the first population.
    population : int
        Candidates per setting.
    duration : float
        Length of the moves [s].
    progress : callable, optional
        Told after every generation.

    Raises
    ------
    ValueError
        If there is no move, or a bound is not an increasing pair of finite numbers.
    """
    ranges = dict(BOUNDS if bounds is None else bounds)
    for name, (low, high) in ranges.items():
        if not -np.inf < low < high < np.inf:
            raise ValueError(
                f'bounds: expected two increasing numbers for {name} but found {low} and {high}'
            )
    cases = tuning_moves() if moves is None else list(moves)
    if not ranges or not cases:
        raise ValueError('expected one setting to search and one move or more but found none')
    coarse = [replace(m, config=replace(m.config, substeps=_SUBSTEPS)) for m in cases]
    axes, places = _nominal(coarse)
    names = list(ranges)
    logarithmic = np.array([0.0 < low and 10.0 * low <= high for low, high in ranges.values()])
    ends = np.array(list(ranges.values()))
    ends[logarithmic] = np.log(ends[logarithmic])

    def settings(point: Array) -> dict[str, float]:
        values = np.where(logarithmic, np.exp(np.where(logarithmic, point, 0.0)), point)
        return dict(zip(names, values.tolist(), strict=True))

    def costs(points: Array) -> Array:
        columns = points.reshape(len(names), -1).T
        with warnings.catch_warnings():
            # candidates that do not settle are what the search is to find out
            warnings.simplefilter('ignore', ServoParamsWarning)
            made = [[make(axis, settings(point)) for axis in axes] for point in columns]
        # designing one takes longer than copying it
        controllers = [deepcopy(ones[place]) for ones in made for place in places]
        batch = position_many(controllers, coarse * len(columns), duration)
        total = np.asarray(move_costs(batch).reshape(len(columns), len(coarse)).sum(axis=1))
        total += [max(swing_cost(one, duration) for one in ones) for ones in made]
        seen.append(float(total.min()))
        tried.append(len(columns))
        return total

    seen: list[float] = []
    tried: list[int] = []
    history: list[float] = []

    def told(best: Array, convergence: float) -> None:
        history.append(min(seen))
        if progress is not None:
            progress(len(history), generations, history[-1])

    search: Any = differential_evolution  # its types do not know of vectorised costs
    found = search(
        costs,
        ends.tolist(),
        maxiter=generations,
        popsize=population,
        seed=np.random.default_rng(seed),  # SciPy before 1.15 knows no other name
        polish=False,
        updating='deferred',
        vectorized=True,
        callback=told,
        tol=0.0,
    )
    return TuningResult(
        settings(found.x), float(found.fun), tuple(history), sum(tried), tuple(cases)
    )


def _nominal(moves: Sequence[LatheMove]) -> tuple[list[LinearAxis], list[int]]:
    """Return the nominal models of the moves' axes, each once, and which one a move has."""
    found: dict[tuple[bytes, ...], int] = {}
    axes: list[LinearAxis] = []
    places = []
    for move in moves:
        axis = move.config.linear()
        key = axis.a.tobytes(), axis.b.tobytes(), axis.c.tobytes()
        if key not in found:
            found[key] = len(axes)
            axes.append(axis)
        places.append(found[key])
    return axes, places


def swing_cost(controller: AxisController, duration: float) -> float:
    """Return what it costs that a loop swings at a gain of `GAIN_SPREAD` [-].

    Friction hides a slow swing in moves that are over soon.  So each gain at which the spectral
    radius is 1 or more costs as much as a move of that duration [s] that does not settle, and
    what the radius exceeds 1 by in addition.  Controllers other than the variable-universe one
    are judged by their moves alone.
    """
    if not isinstance(controller, VariableUniverseController):
        return 0.0
    radii = np.array(list(spectral_radii(controller, GAIN_SPREAD).values()))
    return float((2.0 * duration + _PER_RADIUS * (radii - 1.0))[radii >= 1.0].sum())


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
