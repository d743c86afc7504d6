# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position control with and without rules, on axes, moves and variations not tuned on.

On the lathe axis every controller has its shipped settings, all found by one kind of search on
steps; here it makes random moves and follows random courses.  On the ball screw with the
parameters of the EMPS benchmark all are tuned here, with the same number of trials on the same
courses, and judged on others.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from fuzzy_worth_rows import FUZZY, LAW, NOTHING, PLAIN, Part, Way
from lathe_tuning import BOUNDS, production, tune
from scipy.io import loadmat
from scipy.optimize import differential_evolution

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.core.servo.axis_control import make_controller
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.feedback_watch import FeedbackLimits
from fuzzycnc_ros.core.servo.observer import ObserverNoise
from fuzzycnc_ros.core.servo.params import ServoParamsWarning, VariableUniverseParams
from fuzzycnc_ros.core.servo.pid_cascade import CascadeController, PidController
from fuzzycnc_ros.core.servo.profile import ProfileLimits, Reference, point_to_point
from fuzzycnc_ros.core.servo.variable_universe import (
    ContractedSurface,
    FixedSurface,
    VariableUniverseController,
)
from fuzzycnc_ros.simulation.servo.axes import BallscrewAxis
from fuzzycnc_ros.simulation.servo.lathe_axes import random_moves
from fuzzycnc_ros.simulation.servo.positioning import PositioningRun, position, position_many
from fuzzycnc_ros.studies.servo.servo_cases import ServoCase, drive_many

SETTLED, LEFT = 'settled to 2 um [s]', 'error after 3 s [um]'
RMS, LARGEST = 'rms error [um]', 'largest error [um]'
"""Headings of the figures."""

SEED = 4000
"""Of all moves and courses that are judged; those of the tuning have seeds below it."""

MOVES = 25
"""Random moves of the lathe axis with moderate friction, and as many with hard friction."""

COURSES = 2
"""Random courses under each variation of an axis."""

TRIALS, CANDIDATES = 120, 12
"""Settings that are tried for each controller of an axis, and about how many at a time."""

NOISE = 1e-7
"""RMS noise of the ball screw's readings [m], so that no bandwidth is free."""

FLAT = 1e4
"""How much wider than its universes the tangent's are, so that nothing of them contracts."""

LATHE_VARIATIONS: Mapping[str, dict[str, float]] = {
    'nominal': {},
    'gain x0.6': {'gain_factor': 0.6},
    'gain x1.4': {'gain_factor': 1.4},
    'load 8 %': {'load': 0.08},
    'friction x2': {'coulomb': 0.04, 'breakaway': 0.06},
}
BALLSCREW_VARIATIONS: Mapping[str, dict[str, float]] = {
    'nominal': {},
    'mass +30 %': {'mass_factor': 1.3},
    'mass -30 %': {'mass_factor': 0.7},
    'gain x0.7': {'gain_factor': 0.7},
    'gain x1.4': {'gain_factor': 1.4},
    'friction x0.5': {'friction_factor': 0.5},
    'friction x2': {'friction_factor': 2.0},
    'breakaway x1.5': {'breakaway_ratio': 1.5},
    'load of 40 N': {'load': 40.0},
}
TUNED_ON: Mapping[str, dict[str, float]] = {
    'nominal': {},
    'mass +25 %, friction x1.5': {'mass_factor': 1.25, 'friction_factor': 1.5},
    'mass -25 %, gain x1.3': {'mass_factor': 0.75, 'gain_factor': 1.3},
}
"""What is set of the axes; the ball screw is tuned on other variations than it is judged on."""

Make = Callable[[], AxisController]

_GIVEN_UP = 1.0
"""Cost of a controller that faults or cannot be [m]."""

_BEGUN = 0.5
"""Time after which a start amid a motion does not count any more [s]."""


def tangent(params: VariableUniverseParams) -> VariableUniverseParams:
    """Return parameters of the linear law with the slopes that the rules have at the origin."""
    return replace(
        params,
        error_range=FLAT * params.error_range,
        rate_range=FLAT * params.rate_range,
        output_gain=FLAT * params.output_gain,
        error_exponent=1.0,
        rate_exponent=1.0,
    )


def lawless(params: VariableUniverseParams) -> VariableUniverseParams:
    """Return parameters whose rules give nothing: observer and feedforward alone are left."""
    return replace(params, output_gain=1e-9)


def course(seed: int, period: float = 1e-3) -> Reference:
    """Return six random moves by profile with rests between them, about 4 s.

    Ways of 0.2 to 50 mm, the logarithm uniform, within 60 mm of the start; velocity, acceleration
    and rests are drawn too.
    """
    rng = np.random.default_rng(seed)
    parts, place = [], 0.0
    for _ in range(6):
        way = float(np.exp(rng.uniform(np.log(2e-4), np.log(0.05)))) * rng.choice([-1.0, 1.0])
        target = place + (way if abs(place + way) <= 0.06 else -way)
        limits = ProfileLimits(
            velocity=rng.uniform(0.05, 0.2), acceleration=rng.uniform(0.5, 1.5), jerk=30.0
        )
        profile = point_to_point(place, target, limits)
        rest = profile.duration + rng.uniform(0.05, 0.3)
        parts.append(profile.at(np.arange(0.0, rest, period)))
        place = target
    return Reference(*np.concatenate(parts, axis=1), period)


@cache
def lathe_ways(trials: int) -> Mapping[str, tuple[str, Make]]:
    """Return the controllers of the lathe axis: as shipped, and tuned with some trials each.

    The shipped settings were all found by the same search, but for the tangent, whose are those of
    the rules.  It tunes for steps, gains from half to one and a half times nominal among them.
    """
    axis = LatheAxisConfig().linear()
    params = VariableUniverseParams()
    ways: dict[str, tuple[str, Make]] = {
        'variable universe, the default': (FUZZY, lambda: VariableUniverseController(axis)),
        'its tangent': (LAW, lambda: VariableUniverseController(axis, tangent(params))),
        'fixed universe': (FUZZY, lambda: make_controller('fixed_universe', axis)),
        'published recursion': (
            FUZZY, lambda: VariableUniverseController(axis, mode='paper_literal'),
        ),
        'cascade': (PLAIN, lambda: CascadeController(axis)),
        'PID with feedforward': (PLAIN, lambda: PidController(axis)),
        'observer and feedforward alone': (
            NOTHING, lambda: VariableUniverseController(axis, lawless(params)),
        ),
    }  # fmt: skip
    for name, tunable in LATHE_TUNABLES.items():
        population = max(round(min(trials, 2 * CANDIDATES) / len(tunable.bounds)), 1)
        generations = round(trials / (population * len(tunable.bounds))) - 1

        def make(
            axis: LinearAxis, settings: Mapping[str, float], tunable: Tunable = tunable
        ) -> AxisController:
            return tunable.make(axis, **settings)

        found = tune(make, tunable.bounds, generations=generations, population=population)
        ways[f'{name}, tuned'] = tunable.part, partial(made, tunable.make, axis, **found)
    return ways


def lathe_moves(quick: bool) -> Part:
    """Have the lathe axis make random moves by steps."""
    count = 2 if quick else MOVES
    moves = [
        move for hard in (False, True) for move in random_moves(count, hard=hard, seed=SEED + hard)
    ]
    makers = lathe_ways(_trials(quick))
    controllers = [made(make) for _, make in makers.values() for _ in moves]
    batch = position_many(controllers, moves * len(makers), 4.0)
    fine = np.array([not fault for fault in batch.fault])
    settled, left = (
        np.where(fine, found, inf).reshape(len(makers), -1)
        for found in (batch.settle(), 1e6 * batch.steady_error(3.0))
    )
    ways = [
        Way(name, part, {SETTLED: _floats(time), LEFT: _floats(error)})
        for (name, (part, _)), time, error in zip(makers.items(), settled, left, strict=True)
    ]
    cases = [
        f'{1e3 * move.target:.2f} mm, gain x{move.config.gain_factor:.2f}, '
        f'load {100 * move.config.load:.0f} %, friction {100 * move.config.coulomb:.1f} %'
        for move in moves
    ]
    title = 'Servo: lathe axis, random steps, gain x0.5 to x1.5, load within 10 %'
    return Part(title, tuple(cases), tuple(ways))


def lathe_courses(quick: bool) -> Part:
    """Have the lathe axis follow random courses."""
    cases = [
        ServoCase(f'{name}, course {number}', reference, _length(reference), knobs)
        for name, knobs in LATHE_VARIATIONS.items()
        for number, reference in enumerate(_courses(quick))
    ]
    makers = lathe_ways(_trials(quick))
    controllers = [made(make) for _, make in makers.values() for _ in cases]
    runs = drive_many(controllers, cases * len(makers), seed=SEED)
    ways = [
        Way(name, part, _following(runs[number * len(cases) :][: len(cases)]))
        for number, (name, (part, _)) in enumerate(makers.items())
    ]
    labels = tuple(case.label for case in cases)
    return Part('Servo: lathe axis, random courses by profile', labels, tuple(ways))


class LateBallscrew(BallscrewAxis):
    """The ball screw with a drive that takes up every duty a period late, as on a bus.

    The recorded axis had no such delay to speak of; without one any bandwidth settles, and a
    search ends at its bounds.  No controller knows of it.
    """

    _asked = 0.0

    def drive(self, duty: float) -> None:
        """Hold the duty [-] of the period before."""
        late, self._asked = self._asked, self._cut(duty)
        super().drive(late)


class EqualSurface(FixedSurface):
    """The rules on universes that do not shrink, equal at the origin to those that do."""

    def __init__(self, params: VariableUniverseParams, direction: float) -> None:
        ranges = {
            'error_range': params.error_range * params.error_floor,
            'rate_range': params.rate_range * params.rate_floor,
        }
        super().__init__(replace(params, **ranges), direction)


def ballscrew(
    bandwidth: float = 60.0,
    observer_bandwidth: float = 240.0,
    change: Callable[[VariableUniverseParams], VariableUniverseParams] = lambda p: p,
    surface: type[ContractedSurface] = ContractedSurface,
) -> VariableUniverseController:
    """Return the production controller of the ball screw; bandwidths in rad/s."""
    known = BallscrewAxisConfig()
    axis, coulomb = known.linear(), known.coulomb_forward / known.force_max
    return VariableUniverseController(
        axis,
        change(VariableUniverseParams.for_axis(axis, bandwidth, damping=1.0)),
        noise=ObserverNoise.of_bandwidth(axis, observer_bandwidth),
        surface=surface,
        settle=3.0 / observer_bandwidth,
        friction=(coulomb, coulomb),
        limits=FeedbackLimits.of(axis, count=known.count, load=0.6),
    )


def with_friction(kind: type[AxisController]) -> type[AxisController]:
    """Return a plain controller with the axis' known Coulomb friction fed forward.

    The ball screw's controller has it, and so the others get it too.  An observer sees the duty
    without it, as there.
    """

    class Fed(kind):  # type: ignore[misc, valid-type]
        def __init__(self, axis: Any, **options: Any) -> None:
            known = BallscrewAxisConfig()
            self._coulomb = known.coulomb_forward / known.force_max
            self._friction = 0.0
            super().__init__(axis, **options)

        def _wanted(
            self, reference: float, position: float, velocity: float, acceleration: float
        ) -> float:
            self._friction = self._coulomb * float(np.sign(velocity or acceleration))
            plain = super()._wanted(reference, position, velocity, acceleration)
            return float(plain) + self._friction

        def _commit(self, duty: float, position: float) -> None:
            super()._commit(duty - self._friction, position)

    return Fed


@dataclass(frozen=True)
class Tunable:
    """A controller whose settings are searched.

    Parameters
    ----------
    part : str
        As of `Way`.
    make : callable
        Makes it from settings by name; on the lathe axis the axis comes first.
    bounds : mapping of str to (float, float)
        Settings and what they lie between.
    """

    part: str
    make: Callable[..., AxisController]
    bounds: Mapping[str, tuple[float, float]]


def _cascade(
    position_gain: float, velocity_gain: float, observer_bandwidth: float
) -> AxisController:
    axis, known = BallscrewAxisConfig().linear(), BallscrewAxisConfig()
    return with_friction(CascadeController)(
        axis,
        position_gain=position_gain,
        velocity_gain=velocity_gain,
        velocity_max=abs(axis.gain),
        noise=ObserverNoise.of_bandwidth(axis, observer_bandwidth),
        limits=FeedbackLimits.of(axis, count=known.count),
    )


def _pid(**settings: float) -> AxisController:
    axis, known = BallscrewAxisConfig().linear(), BallscrewAxisConfig()
    limits = FeedbackLimits.of(axis, count=known.count)
    return with_friction(PidController)(axis, integral_band=1e-2, limits=limits, **settings)


_BANDWIDTHS = {'bandwidth': (15.0, 300.0), 'observer_bandwidth': (40.0, 1500.0)}

VARIABLE = Tunable(FUZZY, ballscrew, _BANDWIDTHS)

TUNABLES: Mapping[str, Tunable] = {
    'variable universe': VARIABLE,
    'tangent': Tunable(LAW, partial(ballscrew, change=tangent), _BANDWIDTHS),
    'fixed universe': Tunable(FUZZY, partial(ballscrew, surface=EqualSurface), _BANDWIDTHS),
    'cascade': Tunable(
        PLAIN,
        _cascade,
        {
            'position_gain': (10.0, 300.0),
            'velocity_gain': (5.0, 500.0),
            'observer_bandwidth': (40.0, 1500.0),
        },
    ),
    'PID with feedforward': Tunable(
        PLAIN,
        _pid,
        {
            'proportional': (100.0, 1e5),
            'integral': (100.0, 1e7),
            'derivative': (3.0, 1e3),
            'rate_lag': (5e-5, 5e-3),
        },
    ),
}


def _lathe_tangent(
    axis: LinearAxis, error_gain: float, rate_gain: float, disturbance: float
) -> AxisController:
    """Return the linear law with gains of its own [1/m, s/m]."""
    plain = VariableUniverseParams()
    scaled = replace(
        plain,
        error_range=plain.error_range * plain.error_gain / error_gain,
        rate_range=plain.rate_range * plain.rate_gain / rate_gain,
    )
    return VariableUniverseController(
        axis, tangent(scaled), noise=replace(ObserverNoise(), disturbance=disturbance)
    )


def _lathe_fixed(axis: LinearAxis, disturbance: float, **settings: float) -> AxisController:
    noise = replace(ObserverNoise(), disturbance=disturbance)
    params = VariableUniverseParams(**settings)
    return VariableUniverseController(axis, params, noise=noise, surface=FixedSurface)


def _lathe_cascade(axis: LinearAxis, disturbance: float, **settings: float) -> AxisController:
    noise = replace(ObserverNoise(), disturbance=disturbance)
    return CascadeController(axis, noise=noise, **settings)


_DISTURBANCE = {'disturbance': BOUNDS['disturbance']}

LATHE_TUNABLES: Mapping[str, Tunable] = {
    'variable universe': Tunable(
        FUZZY, lambda axis, **settings: production(axis, settings), BOUNDS
    ),
    'tangent': Tunable(
        LAW,
        _lathe_tangent,
        {'error_gain': (50.0, 1000.0), 'rate_gain': (1.0, 20.0), **_DISTURBANCE},
    ),
    'fixed universe': Tunable(
        FUZZY,
        _lathe_fixed,
        {
            'error_range': (5e-3, 0.19),
            'rate_range': (0.1, 1.5),
            'output_gain': (0.8, 10.0),
            **_DISTURBANCE,
        },
    ),
    'cascade': Tunable(
        PLAIN,
        _lathe_cascade,
        {
            'position_gain': (5.0, 100.0),
            'velocity_gain': (0.5, 20.0),
            'velocity_max': (0.15, 0.4),
            **_DISTURBANCE,
        },
    ),
    'PID with feedforward': Tunable(
        PLAIN,
        PidController,
        {
            'proportional': (50.0, 1000.0),
            'integral': (100.0, 2e4),
            'derivative': (1.0, 20.0),
            'rate_lag': (2e-4, 5e-3),
            'integral_band': (5e-5, 5e-3),
        },
    ),
}


def made(
    make: Callable[..., AxisController], *axis: LinearAxis, **settings: Any
) -> AxisController:
    """Return a controller; what it warns of is what the comparison is to show."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', ServoParamsWarning)
        return make(*axis, **settings)


def tuned(tunable: Tunable, trials: int) -> dict[str, float]:
    """Return the settings with the least sum of rms errors on the courses of the tuning.

    Parameters
    ----------
    tunable : Tunable
        The controller.
    trials : int
        Settings that are tried, the same for every controller, however many it has.

    Returns
    -------
    dict of str to float
        Settings by name.
    """
    ends = np.log(np.array(list(tunable.bounds.values())))
    start = np.random.default_rng(0).uniform(*ends.T, (CANDIDATES, len(ends)))
    references = [course(seed) for seed in range(1)]

    def cost(point: Array) -> float:
        try:
            controller = made(tunable.make, **_settings(tunable, point))
        except ValueError:
            return _GIVEN_UP  # a bandwidth that this axis does not allow
        total = 0.0
        for knobs in TUNED_ON.values():
            for reference in references:
                run = _run(controller, BallscrewAxisConfig(**knobs), reference)
                total += run.following_error()[1] + _GIVEN_UP * bool(run.fault)
        return total

    found = differential_evolution(
        cost,
        ends,
        init=start,
        maxiter=trials // CANDIDATES - 1,
        polish=False,
        tol=0.0,
        seed=np.random.default_rng(0),
    )
    return _settings(tunable, found.x)


def _settings(tunable: Tunable, point: Array) -> dict[str, float]:
    return dict(zip(tunable.bounds, np.exp(point).tolist(), strict=True))


def ballscrew_courses(recording: Path | None, quick: bool) -> Part:
    """Have the ball screw follow random courses, and the recorded reference where there is one.

    Parameters
    ----------
    recording : Path or None
        The EMPS recording.
    quick : bool
        Whether few trials and courses do.
    """
    runs = {
        f'{name}, course {number}': (BallscrewAxisConfig(**knobs), reference)
        for name, knobs in BALLSCREW_VARIATIONS.items()
        for number, reference in enumerate(_courses(quick))
    }
    if recording is not None and not quick:
        runs['EMPS reference, friction by direction'] = (
            BallscrewAxisConfig.by_direction(), recorded_reference(recording),
        )  # fmt: skip
    ways: list[Way] = []
    notes = []
    makers: dict[str, tuple[str, Make]] = {
        'variable universe, as shipped': (FUZZY, ballscrew),
    }
    trials = _trials(quick)
    for name, tunable in TUNABLES.items():
        settings = tuned(tunable, trials)
        notes.append(f'{name}: ' + ', '.join(f'{key} {one:.4g}' for key, one in settings.items()))
        makers[f'{name}, tuned'] = tunable.part, partial(made, tunable.make, **settings)
        if tunable is VARIABLE:
            makers['its tangent'] = LAW, partial(made, ballscrew, change=tangent, **settings)
    makers['observer and feedforward alone'] = NOTHING, partial(made, ballscrew, change=lawless)
    for name, (part, make) in makers.items():
        controller = make()
        driven = [_run(controller, config, reference) for config, reference in runs.values()]
        ways.append(Way(name, part, _following(driven)))
    title = f'Servo: ball screw (EMPS), random courses by profile, {trials} trials of tuning each'
    return Part(title, tuple(runs), tuple(ways), tuple(notes))


def recorded_reference(path: Path) -> Reference:
    """Return the reference of the EMPS recording, which begins amid a ramp."""
    period = 1e-3
    places = loadmat(path)['qg'].ravel().astype(float)
    acceleration = np.zeros_like(places)  # rates are differences
    acceleration[1:-1] = np.diff(places, 2) / period**2
    return Reference(places, np.gradient(places, period), acceleration, period)


def _run(
    controller: AxisController, config: BallscrewAxisConfig, reference: Reference
) -> PositioningRun:
    start = float(reference.position[0])
    plant = LateBallscrew(replace(config, noise=NOISE, seed=SEED), position=start)
    return position(controller, plant, reference)


def _trials(quick: bool) -> int:
    return CANDIDATES if quick else TRIALS


def _courses(quick: bool) -> Sequence[Reference]:
    return [course(SEED + number) for number in range(1 if quick else COURSES)]


def _length(reference: Reference) -> float:
    return len(reference.position) * reference.period


def _following(runs: Sequence[PositioningRun]) -> dict[str, tuple[float, ...]]:
    """Return rms and largest following errors; infinite where the controller gave up.

    References that begin in motion are judged once that is made up for.
    """
    errors = [
        (inf, inf) if run.fault else run.following_error(_BEGUN if _moving(run) else 0.0)
        for run in runs
    ]
    return {
        RMS: tuple(1e6 * rms for _, rms in errors),
        LARGEST: tuple(1e6 * largest for largest, _ in errors),
    }


def _moving(run: PositioningRun) -> bool:
    return abs(run.reference[1] - run.reference[0]) > 1e-6


def _floats(values: Array) -> tuple[float, ...]:
    return tuple(map(float, values))
