# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Which controller suits an axis: all kinds tuned with equal effort, judged on other moves."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isfinite, log, sqrt
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.identify.robustness import AxisModels, LoopMargin
from fuzzycnc_ros.core.machine.axis_models import BallscrewAxisConfig, LatheAxisConfig
from fuzzycnc_ros.core.machine.machine_data import AxisData
from fuzzycnc_ros.core.servo.axis_control import (
    SETTINGS,
    make_axis_controller,
    setting_ranges,
    untuned_settings,
)
from fuzzycnc_ros.core.servo.controller import AxisController, closed_loop
from fuzzycnc_ros.core.servo.course import REST, AxisFigures, single_way, there_and_back
from fuzzycnc_ros.core.servo.feedback_watch import SWINGING
from fuzzycnc_ros.core.servo.params import ServoParamsWarning
from fuzzycnc_ros.core.servo.profile import ProfileLimits
from fuzzycnc_ros.simulation.servo.axes import AxisPlant, simulated_axis

GAINS = (0.5, 0.75, 1.0, 1.4, 2.0)
"""Factors on the gain for which an axis is tuned."""

MARGINS = (0.4, 2.4)
"""Gains beyond these, with a period more of dead time, on a long fast way with little friction:
what gives up there has no margin."""

HELD_OUT_GAINS = (0.5, 0.62, 0.85, 1.2, 1.7, 2.0)
"""Factors on the gain on which it is judged."""

KNOWN_GAIN_MAX = 1.5
"""Largest factor on the gain of an axis that was identified."""

PULSES = ((0.5, 1.0), (1.0, 0.8))
"""Pulses of load, on the way and at rest, for which an axis is tuned: share of the largest load,
and factor on the gain.  A load that sets in at rest alone says little of how stiff the loop is: on
the ball screw what had been tuned on that gave way to pulses twice as far as it needs to."""

HELD_OUT_PULSES = ((0.2, 1.15), (0.6, 0.9), (1.0, 1.0))
"""Pulses on which it is judged."""

_PULSE = 0.13
"""Time for which a pulse acts, and for which it then does not [s]."""

_EQUAL = 1.05
"""Factor between the errors of two controllers up to which the simpler one is taken [-]."""

_GIVEN_UP = 0.1
"""Error that a run counts which ends in a fault, as share of the axis' travel [-]."""

_UNSURE = 0.3
"""Share of a dead time that its interval may span [-]: more is what limits a loop."""

_STEPS, _STEP = 12, 1.2
"""Steps of the bandwidth, and their ratio, by which it is tried what knowing more would allow."""

_UNSTABLE = 1e6
"""Cost of a loop that is not stable over all that the axis may be [m]."""

_PUSHED = 300
"""Periods for which a force acts on a loop whose stiffness is reckoned."""

_SCANNED = 200
"""Settings whose margin is worked out before the first is driven."""

_STIFFER = 10
"""Generations of the search for the stiffest settings that are stable."""

_JUMPS, _JUMP_TIME = (1.0, -1.0, 0.0), 0.6
"""Set points, in jumps, to which an identified axis is sent without a profile, and the time for
each [s]: a loop may be stable where it is linear, and keep up an oscillation between the ends of
its duty once a jump has begun it."""

_JUMP, _JUMP_SHARE, _JUMP_COUNTS = 1e-3, 0.004, 30.0
"""Largest jump [m], as share of the travel, and the least one in counts."""

_CHATTER = 0.1
"""RMS of the duty about its mean in the second half of that time from which it chatters [-]."""

_PER_FAULT = 100.0
"""Factor on the cost for each case that is given up [-]."""

_Progress = Callable[[int, int], None]
"""Told how many generations are done, and how many there are."""

Judge = Callable[[AxisController], tuple[float, float]]
"""Tells what a loop lacks to be stable, 0 if nothing [-], and how far a force moves it
[m per unit of the duty]."""

Plant = Callable[['AxisCase'], AxisPlant]
"""Makes the axis that a case is driven on."""


@dataclass(frozen=True, kw_only=True)
class AxisCase:
    """A way there and back, with what is off against the nominal axis.

    Parameters
    ----------
    way : float
        Length of the way [m], with its sign.
    gain : float
        Factor on the axis' gain [-].
    friction : float
        Factor on its friction [-].
    load : float
        Load [-], as duty, that sets in amid the rest before the way back.
    pulse : float
        Load [-], as duty, that comes and goes throughout the case.
    pace : float
        Share of the axis' limits at which it goes [-].
    delay : float
        Dead time beyond that of the model [s].
    seed : int
        Seed of the noise.
    """

    way: float
    gain: float = 1.0
    friction: float = 1.0
    load: float = 0.0
    pulse: float = 0.0
    pace: float = 1.0
    delay: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class TunedController:
    """A controller with the settings that the search found.

    Attributes
    ----------
    name : str
        Of `AXIS_CONTROLLERS`.
    settings : dict of str to float
        Of `SETTINGS`.
    cost : float
        Cost on the cases of the search [m]; infinite without one.
    trials : int
        Settings that were tried.
    held_out : tuple of AxisFigures
        Figures on cases that nothing was tuned on.
    held_out_cost : float
        Cost on these [m].
    margin : LoopMargin or None
        Distance of its loop from instability; None where nothing is known but a model.
    calm : bool
        Whether it comes to rest after jumps of the set point, as far as that was asked.
    """

    name: str
    settings: dict[str, float]
    cost: float
    trials: int
    held_out: tuple[AxisFigures, ...]
    held_out_cost: float
    margin: LoopMargin | None = None
    calm: bool = True

    @property
    def robust(self) -> bool:
        """True if its loop is stable over all that the axis may be, as far as that is known."""
        return self.calm and (self.margin is None or self.margin.robust)

    @property
    def error(self) -> float:
        """Geometric mean of its errors on the held-out cases [m]."""
        return float(np.exp(_logs(self.held_out).mean()))

    @property
    def faults(self) -> int:
        """Held-out cases that it gave up."""
        return sum(bool(one.fault) for one in self.held_out)

    def against(self, other: TunedController) -> tuple[float, float]:
        """Return how much worse it is than another one on the held-out cases.

        Returns
        -------
        ratio : float
            Geometric mean of its errors over the other's [-].
        spread : float
            Factor of one standard error of it [-], from case to case.
        """
        logs = _logs(self.held_out) - _logs(other.held_out)
        error = float(logs.std(ddof=1)) / sqrt(len(logs))
        return float(np.exp(logs.mean())), float(np.exp(error))


@dataclass(frozen=True)
class AxisTuning:
    """All controllers after tuning with equal effort.

    Attributes
    ----------
    controllers : tuple of TunedController
        In the order of `AXIS_CONTROLLERS`, the simplest first; those without tuning after them.
    held_out : tuple of AxisCase
        What they were judged on.
    """

    controllers: tuple[TunedController, ...]
    held_out: tuple[AxisCase, ...]

    @property
    def best(self) -> TunedController:
        """The one with the least cost on the held-out cases; of equal faults."""
        return min(
            self.controllers, key=lambda one: (not one.robust, one.faults, one.held_out_cost)
        )

    @property
    def winner(self) -> TunedController:
        """The simplest of those that are as good as the best one, to 5 %."""
        best = self.best
        return next(
            one
            for one in self.controllers
            if one is best
            or (
                one.robust == best.robust
                and one.faults <= best.faults
                and one.against(best)[0] <= _EQUAL
            )
        )

    def tuned(self, data: AxisData) -> AxisData:
        """Return an axis with the controller that suits it and its settings.

        Raises
        ------
        ValueError
            If no controller is stable over all that the axis may be.
        """
        if not self.winner.robust:
            raise ValueError(
                'expected a controller that is stable over all that the axis may be, at half to '
                f'one and a half times its gain, but found none; {loop_limit(data, self.winner)}'
            )
        return replace(data, controller=self.winner.name, settings=self.winner.settings)


def loop_limit(data: AxisData, tuned: TunedController) -> str:
    """Return in one line what bounds a loop, and what knowing more would allow.

    Parameters
    ----------
    data : AxisData
        The axis, identified.
    tuned : TunedController
        A controller with its margin.
    """
    known, plant = data.knowledge, data.known_plant()
    assert tuned.margin is not None
    delay, least = plant.delay, known.delay_low
    if tuned.margin.frequency > known.known_to and not known.mode_high:
        why = f'its response above {known.known_to:.3g} Hz is unknown'
    elif delay - least > max(_UNSURE * delay, plant.period):
        why = f'its dead time is unknown up to {1e3 * delay:.2g} ms'
    elif isinstance(plant, BallscrewAxisConfig) and plant.mode:
        why = f'its mode at {plant.mode:.3g} Hz'
    else:
        why = f'its dead time of {1e3 * delay:.2g} ms'
    crossover = tuned.margin.crossover
    text = f'{why}: crossover at most {crossover:.0f} rad/s'
    nearer = replace(
        known,
        known_to=1e4,
        mode_low=max(known.mode_low, 1e4) if not known.mode_high else known.mode_low,
        remainder='',
        gain_low=1.0,
        gain_high=1.0,
    )
    better = replace(data, plant=replace(plant, delay=0.5 * (delay + least)), knowledge=nearer)
    models, allowed = AxisModels(better), crossover
    settings = dict(tuned.settings)
    for _ in range(_STEPS):
        settings['bandwidth'] = settings.get('bandwidth', 1.0) * _STEP
        if settings['bandwidth'] > SETTINGS['bandwidth'][1]:
            break
        margin = models.margin(untold_controller(better, tuned.name, settings))
        if not margin.robust:
            break
        allowed = max(allowed, margin.crossover)
    if allowed > 1.2 * crossover:
        text += f'; a recording with a chirp (`fuzzycnc machine excite`) might allow {allowed:.0f}'
    return text


def axis_cases(data: AxisData, *, held_out: bool = False, seed: int = 0) -> tuple[AxisCase, ...]:
    """Return the cases of an axis: ways from some counts to half its travel, gains, loads, pulses.

    Parameters
    ----------
    data : AxisData
        The axis.
    held_out : bool
        Whether those to judge by, with other ways, gains and seeds, instead of those to tune on.
    seed : int
        What the ways and loads are drawn from.
    """
    draw = np.random.default_rng([seed, int(held_out)])
    gains: tuple[float, ...] = HELD_OUT_GAINS if held_out else GAINS
    if data.knowledge.known_to:  # what is identified is tuned for half to one and a half times
        gains = tuple(min(gain, KNOWN_GAIN_MAX) for gain in gains)
    travel = data.limits.travel_high - data.limits.travel_low
    plant = data.known_plant()
    short = max(20.0 * plant.count, 2e-5)
    ways = np.exp(np.linspace(log(short), log(0.4 * travel), len(gains)))
    ways = draw.permutation(ways * np.exp(draw.uniform(-0.3, 0.0, len(gains))))
    load = data.limits.load * (1.0 if held_out else 0.9)
    cases = [
        AxisCase(
            way=float(way) * (-1.0 if draw.random() < 0.5 else 1.0),
            gain=gain,
            friction=float(draw.uniform(0.6, 1.6)),
            # A weaker axis bears less; a load beyond its force is nobody's to hold.
            load=float(draw.choice([-1.0, 0.0, 1.0])) * load * min(gain, 1.0),
            pace=min(float(draw.uniform(0.4, 1.0)), gain),
            seed=1000 * held_out + index,
        )
        for index, (gain, way) in enumerate(zip(gains, ways, strict=True))
    ]
    pulses = HELD_OUT_PULSES if held_out else PULSES
    cases += [
        AxisCase(
            way=float(draw.uniform(0.1, 0.3)) * travel * (-1.0 if draw.random() < 0.5 else 1.0),
            gain=gain,
            friction=float(draw.uniform(0.6, 1.6)),
            pulse=float(draw.choice([-1.0, 1.0])) * share * load * min(gain, 1.0),
            pace=float(draw.uniform(0.4, 0.8)) * min(gain, 1.0),
            seed=1000 * held_out + index,
        )
        for index, (share, gain) in enumerate(pulses, len(cases))
    ]
    if not held_out and not data.knowledge.known_to:
        cases += [
            AxisCase(
                way=0.3 * travel,
                gain=gain,
                friction=0.3,
                pace=min(gain, 1.0),
                delay=plant.period,
                seed=index,
            )
            for index, gain in enumerate(MARGINS, len(cases))
        ]
    return tuple(cases)


def _drive_case(
    controller: AxisController, plant: AxisPlant, data: AxisData, case: AxisCase
) -> AxisFigures:
    """Drive a case on a plant, and return the figures.

    Parameters
    ----------
    controller : AxisController
        The controller, made for the nominal axis.
    plant : AxisPlant
        The axis as it is in this case, at 0; its load sets in by itself (`load_time`).
    data : AxisData
        Limits of the way.
    case : AxisCase
        Way and pace.
    """
    period = plant.period
    course = there_and_back(case.way, _case_limits(data, case), period)
    width = round(_PULSE / period)
    controller.reset(plant.measure())
    errors = np.empty(len(course.rows))
    for step, (place, speed, rise) in enumerate(course.rows.tolist()):
        errors[step] = place - plant.position
        duty = controller.step(place, plant.measure(), speed, rise)
        # What acts on the drive is what loads it; its range has to hold both.
        plant.drive(duty - case.pulse * (step // width % 2) if case.pulse else duty)
        if controller.watch.fault:
            return _lost(data, controller.watch.fault)
    return course.figures(errors)


def _lost(data: AxisData, fault: str) -> AxisFigures:
    """Return the figures of a case that is given up."""
    lost = _GIVEN_UP * (data.limits.travel_high - data.limits.travel_low)
    return AxisFigures(rms=lost, largest=lost, rest=lost, fault=fault)


def cases_cost(data: AxisData, controller: AxisController, cases: Sequence[AxisCase]) -> float:
    """Return what cases of the simulated axis cost a controller, as `tune_controller` [m].

    One that takes gain back saves itself, but its loop swings: the case counts as given up, unless
    the axis has more dead time than its model.
    """
    figures = []
    for case in cases:
        one = _drive_case(controller, _simulated_case(data, case), data, case)
        swings = controller.taken_back and not case.delay
        figures.append(_lost(data, SWINGING) if swings else one)
    return tuning_cost(data, figures)


def load_time(data: AxisData, case: AxisCase, period: float) -> float:
    """Return when the load of a case sets in: amid the rest before the way back [s]."""
    there = single_way(case.way, _case_limits(data, case), period)
    return REST + len(there) * period + 0.3 * REST


def _simulated_case(data: AxisData, case: AxisCase) -> AxisPlant:
    """Return the axis of the machine file as it is in a case."""
    plant = data.known_plant()
    changes: dict[str, Any] = {
        'gain_factor': case.gain,
        'delay': plant.delay + case.delay,
        'seed': case.seed,
        'load_time': load_time(data, case, plant.period),
    }
    if isinstance(plant, LatheAxisConfig):
        changes |= {
            'coulomb': case.friction * plant.coulomb,
            'breakaway': case.friction * plant.breakaway,
            'load': case.load,
            'substeps': min(plant.substeps, 5),
        }
    else:
        changes |= {'friction_factor': case.friction, 'load': case.load * plant.force_max}
    return simulated_axis(data, **changes)


def tune_controller(
    data: AxisData,
    name: str,
    *,
    search: Sequence[str] = tuple(SETTINGS),
    seed: int = 0,
    generations: int = 8,
    population: int = 6,
    progress: _Progress | None = None,
) -> TunedController:
    """Tune one kind of controller for an axis by differential evolution.

    The cost of a case is the geometric mean of three errors: RMS and largest following error, and
    the RMS error at rest; that of several their geometric mean, so that none is all that counts.

    Parameters
    ----------
    data : AxisData
        The axis, with a plant.
    name : str
        Of `AXIS_CONTROLLERS`.
    search : sequence of str
        Settings that are searched; the others are not tuned.
    seed : int
        Seed of cases and search.
    generations, population : int
        Generations after the first population, and candidates per setting.
    progress : callable, optional
        Told after every generation: which, of how many.

    Raises
    ------
    ValueError
        If the axis has no plant or a name is unknown.
    """
    ranges = setting_ranges(data, name, search)
    cases = axis_cases(data, seed=seed)
    judge: Judge
    begin: Judge
    if data.knowledge.known_to:
        models = AxisModels(data)
        judge, begin = models.judge, partial(models.judge, spread=False)
    else:
        judge = begin = nominal_judge(data)
    tried = 0

    def cost(point: Array) -> float:
        nonlocal tried
        settings = settings_at(ranges, point)
        shortfall, _ = judge(untold_controller(data, name, settings))
        if shortfall:
            return _UNSTABLE * (1.0 + shortfall)
        if data.knowledge.known_to and not comes_to_rest(data, name, settings):
            return _UNSTABLE
        tried += 1
        return cases_cost(data, untold_controller(data, name, settings), cases)

    init = stiff_settings(data, name, ranges, begin, population, seed)
    if not data.knowledge.known_to:
        init[-1] = [log(plain) for _, _, plain in ranges.values()]
    outcome = evolved(cost, ranges, generations, seed, progress, popsize=population, init=init)
    judged = judged_controller(data, name, settings_at(ranges, outcome.x), seed=seed)
    return replace(judged, cost=float(outcome.fun), trials=tried)


def evolved(
    cost: Callable[[Array], float],
    ranges: Mapping[str, tuple[float, float, float]],
    generations: int,
    seed: int,
    progress: _Progress | None,
    **population: Any,
) -> Any:
    """Minimise a cost of the logarithms of settings by differential evolution.

    Parameters
    ----------
    cost : callable
        Of a point, whose settings `settings_at` returns.
    ranges : mapping of str to (float, float, float)
        Least and largest value of each setting, and its plain one.
    generations, seed, progress
        As `tune_controller`.
    **population
        Of `scipy.optimize.differential_evolution`: `popsize`, `init`.

    Returns
    -------
    scipy.optimize.OptimizeResult
        `x` is the best point and `fun` its cost.
    """
    done = 0

    def told(best: Array, convergence: float = 0.0) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, generations)

    evolve: Any = differential_evolution
    return evolve(
        cost,
        [(log(low), log(high)) for low, high, _ in ranges.values()],
        maxiter=generations,
        seed=np.random.default_rng(seed),  # SciPy before 1.15 knows no other name
        polish=False,
        updating='deferred',
        callback=told,
        tol=0.0,
        **population,
    )


def untuned_controllers(
    data: AxisData, names: Sequence[str], *, seed: int = 0
) -> tuple[TunedController, ...]:
    """Return controllers of an axis with the settings that they have without tuning.

    Parameters
    ----------
    data : AxisData
        The axis, with a plant.
    names : sequence of str
        Of `AXIS_CONTROLLERS`.
    seed : int
        Seed of the cases that they are judged on.
    """
    settings = untuned_settings(data)
    return tuple(judged_controller(data, name, settings, seed=seed) for name in names)


def untold_controller(data: AxisData, name: str, settings: Mapping[str, float]) -> AxisController:
    """Return a controller of an axis, without a warning where its loop does not settle."""
    with warnings.catch_warnings():
        # What does not settle shows in its figures.
        warnings.simplefilter('ignore', ServoParamsWarning)
        return make_axis_controller(data, name, settings)


def nominal_judge(data: AxisData) -> Judge:
    """Return the judge of loops of an axis of which no more than a model is known.

    They have to be stable at the gains `MARGINS`, with a period more of dead time up to half of
    the larger one: a loop that swings there has some gain to take back.
    """
    axis = data.known_plant().linear()
    dynamics, duty, _ = axis.discrete()
    size = len(duty)
    late, entry = np.zeros((size + 1, size + 1)), np.zeros(size + 1)
    late[:size, :size], late[:size, size], entry[size] = dynamics, duty, 1.0
    reading = np.append(axis.c, 0.0)
    low, high = MARGINS

    def judge(controller: AxisController) -> tuple[float, float]:
        law = controller.feedback_law()
        loops = [closed_loop(dynamics, duty, gain * axis.c, law) for gain in (low, 1.0, high)]
        loops += [closed_loop(late, entry, gain * reading, law) for gain in (low, 0.5 * high)]
        radius = max(float(np.abs(np.linalg.eigvals(loop)).max()) for loop in loops)
        if radius >= 1.0:
            return radius, 1.0
        whole = closed_loop(dynamics, duty, axis.c, law)
        state, gives = np.zeros(len(whole)), 0.0
        for _ in range(_PUSHED):
            state = whole @ state
            state[:size] += duty
            gives += abs(float(axis.c @ state[:size]))
        return 0.0, gives / _PUSHED

    return judge


def stiff_settings(
    data: AxisData,
    name: str,
    ranges: Mapping[str, tuple[float, float, float]],
    judge: Judge,
    population: int,
    seed: int,
) -> Array:
    """Return the logarithms of settings to begin with: stiff ones that are stable.

    Half of them are the stiffest of many that are drawn, half those to which a search for the
    stiffest has come.
    """
    low, high = np.log(np.array([(low, high) for low, high, _ in ranges.values()])).T

    def shortfall(point: Array) -> tuple[float, float]:
        return judge(untold_controller(data, name, settings_at(ranges, point)))

    draw = qmc.LatinHypercube(len(ranges), seed=np.random.default_rng([seed, 1]))
    points = low + (high - low) * draw.random(_SCANNED)
    points = np.array(sorted(points, key=shortfall))
    size = max(population * len(ranges), 6)

    def gives(point: Array) -> float:
        short, yielding = shortfall(point)
        return log(yielding) + (_UNSTABLE * (1.0 + short) if short else 0.0)

    evolve: Any = differential_evolution
    stiffest = evolve(
        gives,
        list(zip(low, high, strict=True)),
        init=points[:size],
        maxiter=_STIFFER,
        seed=np.random.default_rng([seed, 2]),
        polish=False,
        updating='deferred',
        tol=0.0,
    )
    order = np.argsort(stiffest.population_energies)
    best = stiffest.population[order[: (size + 1) // 2]]
    return np.concatenate([best, points[: size - len(best)]])


def judged_controller(
    data: AxisData,
    name: str,
    settings: Mapping[str, float],
    *,
    seed: int = 0,
    plant: Plant | None = None,
) -> TunedController:
    """Return a controller with its figures on the held-out cases, without a search.

    Parameters
    ----------
    data : AxisData
        The axis that the controller is made for.
    name : str
        Of `AXIS_CONTROLLERS`.
    settings : mapping of str to float
        Of `SETTINGS`.
    seed : int
        Seed of the cases.
    plant : callable, optional
        Makes the axis that is driven, by default the simulated one of the data.
    """
    cases = axis_cases(data, held_out=True, seed=seed)
    figures = _figures_of(data, name, settings, cases, plant)
    margin, calm = None, True
    if data.knowledge.known_to:
        margin = AxisModels(data).margin(untold_controller(data, name, settings))
        calm = comes_to_rest(data, name, settings)
    return TunedController(
        name, dict(settings), inf, 0, figures, tuning_cost(data, figures), margin, calm
    )


def comes_to_rest(data: AxisData, name: str, settings: Mapping[str, float]) -> bool:
    """Return True if a loop comes to rest after jumps of the set point, at all known gains.

    Parameters
    ----------
    data : AxisData
        The axis, identified.
    name : str
        Of `AXIS_CONTROLLERS`.
    settings : mapping of str to float
        Of `SETTINGS`.
    """
    travel = data.limits.travel_high - data.limits.travel_low
    jump = max(min(_JUMP, _JUMP_SHARE * travel), _JUMP_COUNTS * data.known_plant().count)
    for gain in (GAINS[0], 1.0, KNOWN_GAIN_MAX):
        plant = simulated_axis(data, gain_factor=gain)
        controller = untold_controller(data, name, settings)
        controller.reset(plant.measure())
        start, size = plant.position, round(_JUMP_TIME / plant.period)
        for share in _JUMPS:
            duties = []
            for _ in range(size):
                duty = controller.step(start + share * jump, plant.measure(), 0.0, 0.0)
                plant.drive(duty)
                duties.append(duty)
            if controller.watch.fault or float(np.std(duties[size // 2 :])) > _CHATTER:
                return False
    return True


def _figures_of(
    data: AxisData,
    name: str,
    settings: Mapping[str, float],
    cases: Sequence[AxisCase],
    plant: Plant | None = None,
) -> tuple[AxisFigures, ...]:
    """Return the figures of a controller on some cases.

    Parameters
    ----------
    data : AxisData
        The axis that the controller is made for.
    name : str
        Of `AXIS_CONTROLLERS`.
    settings : mapping of str to float
        Of `SETTINGS`.
    cases : sequence of AxisCase
        What is driven.
    plant : callable, optional
        Makes the axis that is driven, by default the simulated one of the data.
    """
    made = plant or (lambda case: _simulated_case(data, case))
    controller = untold_controller(data, name, settings)
    return tuple(_drive_case(controller, made(case), data, case) for case in cases)


def case_cost(data: AxisData, figures: AxisFigures) -> float:
    """Return what a case costs [m]: the geometric mean of its three errors, not below a count."""
    plant = data.known_plant()
    least = max(0.5 * plant.count, plant.noise, 1e-9)
    errors = (figures.rms, figures.largest, figures.rest)
    return float(np.exp(np.mean([log(max(error, least)) for error in errors])))


def tuning_cost(data: AxisData, figures: Sequence[AxisFigures]) -> float:
    """Return what figures of several cases cost [m]: the geometric mean of what each does."""
    costs = [case_cost(data, one) for one in figures]
    if not all(map(isfinite, costs)):
        return inf
    # No accuracy elsewhere makes up for a loop that gives up.
    lost = sum(bool(one.fault) for one in figures)
    return float(np.exp(np.mean(np.log(costs)))) * _PER_FAULT**lost


def _logs(figures: Sequence[AxisFigures]) -> Array:
    """Return logarithms of the errors of figures, one a case."""
    return np.array(
        [np.mean([log(max(e, 1e-9)) for e in (one.rms, one.largest, one.rest)]) for one in figures]
    )


def settings_at(
    ranges: Mapping[str, tuple[float, float, float]], point: Array
) -> dict[str, float]:
    """Return the settings at a point of the search, which has their logarithms."""
    return {
        name: float(np.clip(np.exp(value), low, high))
        for (name, (low, high, _)), value in zip(ranges.items(), point, strict=True)
    }


def _case_limits(data: AxisData, case: AxisCase) -> ProfileLimits:
    velocity, acceleration, jerk = data.limits.positioning
    return ProfileLimits(
        velocity=velocity * case.pace, acceleration=acceleration * case.pace, jerk=jerk
    )
