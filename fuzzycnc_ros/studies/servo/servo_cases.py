# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Position controllers on the cases of docs/explanation/methods/servo.md."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from typing import Any

import numpy as np

from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
from fuzzycnc_ros.core.servo.axis import LinearAxis
from fuzzycnc_ros.core.servo.axis_control import make_controller
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.profile import Reference, point_to_point, step_reference
from fuzzycnc_ros.simulation.servo.axes import LatheAxis
from fuzzycnc_ros.simulation.servo.lathe_axes import LatheAxes, random_moves
from fuzzycnc_ros.simulation.servo.positioning import PositioningRun, position, position_many
from fuzzycnc_ros.studies.servo.positioning_page import LABELS

Tell = Callable[[str, int, int], None]


OFF_GRID = 2.9e-7
"""Offset of targets from the counts of the sensor, so that these do not flatter [m]."""

STEADY = 2.0
"""Time from which on a move is to be steady, and at which the load steps in [s]."""

SINE, CIRCLE = 'sine', 'circle'
FREQUENCY, RADIUS, SPEED = 0.5, 0.02, 0.04  # [Hz, m, m/s]
AMPLITUDE = 0.01
"""Of the sine [m]."""

FRICTION_CASE = '-50'
"""Move with the axis' own friction."""

FRICTIONS = ('moderate', 'hard')
"""Frictions of random moves."""

LOADS = ('load +10 %', 'load -10 %')

PATIENCE = 40.0
"""Longest wait for a move without friction that has not settled [s]."""

_SMOOTH = {'coulomb': 0.0, 'breakaway': 0.0}


@dataclass(frozen=True, eq=False)
class StepFigures:
    """A move to a target: settling time to 2 um [s], overshoot and error after 2 s [m]."""

    settle: float
    overshoot: float
    steady_error: float


@dataclass(frozen=True, eq=False)
class RandomFigures:
    """Random moves: shares within 1 and 2 um after 3 s [-], largest error [m], given up."""

    within_1: float
    within_2: float
    error_max: float
    faults: int


@dataclass(frozen=True, eq=False)
class ControllerFigures:
    """Figures of one controller on all cases.

    Attributes
    ----------
    steps : mapping of str to StepFigures
        Moves by the name of their case.
    dip, recovery : float
        Largest error after a step of load [m], and time back to 2 um [s].
    sine, circle : tuple of float
        Largest and rms error [m] on a sine, and from a circle.
    random : mapping of str to RandomFigures
        Random moves, by the friction they were made with.
    runs : mapping of str to PositioningRun
        Courses by the name of their case.
    """

    steps: Mapping[str, StepFigures]
    dip: float
    recovery: float
    sine: tuple[float, float]
    circle: tuple[float, float]
    random: Mapping[str, RandomFigures]
    runs: Mapping[str, PositioningRun]


@dataclass(frozen=True, eq=False)
class ServoComparison:
    """Controllers side by side.

    Attributes
    ----------
    cases : mapping of str to str
        Names of the moves and what they are.
    figures : mapping of str to ControllerFigures
        Figures by controller.
    moves : int
        Random moves of each kind; 0 for none.
    seed : int
        Seed of noise and random moves.
    """

    cases: Mapping[str, str]
    figures: Mapping[str, ControllerFigures]
    moves: int
    seed: int


@dataclass(frozen=True, eq=False)
class ServoCase:
    """One axis and where it is to be over time.

    Parameters
    ----------
    label : str
        What the case is.
    reference : Reference
        Where the axis is to be.
    duration : float
        Length of the run [s].
    knobs : mapping
        What is set of the axis.
    start : float
        Where it rests at the beginning [m].
    """

    label: str
    reference: Reference
    duration: float = 4.0
    knobs: Mapping[str, Any] = field(default_factory=dict)
    start: float = 0.0


def servo_cases(period: float = 1e-3) -> dict[str, ServoCase]:
    """Return the cases by name: moves, a step of load, a sine, the axes of a circle."""

    def step(target: float, label: str, **knobs: float) -> ServoCase:
        return ServoCase(label, step_reference(target + OFF_GRID, period), knobs=knobs)

    def profile(target: float, label: str) -> ServoCase:
        return ServoCase(label, point_to_point(0.0, target + OFF_GRID).sample(period))

    def swing(size: float, rate: float, turns: float, phase: float, label: str) -> ServoCase:
        duration = 2.0 * pi * turns / rate
        angle = rate * period * np.arange(round(duration / period)) + phase
        course = Reference(
            size * np.sin(angle),
            size * rate * np.cos(angle),
            -size * rate**2 * np.sin(angle),
            period,
        )
        return ServoCase(label, course, duration, start=float(course.position[0]))

    turning = SPEED / RADIUS
    return {
        '-50 smooth': step(-0.05, '-50 mm without friction', **_SMOOTH),
        '-170 smooth': step(-0.17, '-170 mm without friction', **_SMOOTH),
        FRICTION_CASE: step(-0.05, '-50 mm'),
        'gain x0.5': step(-0.05, '-50 mm, gain x0.5', gain_factor=0.5),
        'gain x1.5': step(-0.05, '-50 mm, gain x1.5', gain_factor=1.5),
        '20 um': step(2e-5, '20 µm'),
        '-50 profile': profile(-0.05, '-50 mm by profile'),
        '-170 profile': profile(-0.17, '-170 mm by profile'),
        LOADS[0]: step(-0.05, 'load of +10 % after 2 s', load=0.1, load_time=STEADY),
        LOADS[1]: step(-0.05, 'load of -10 % after 2 s', load=-0.1, load_time=STEADY),
        SINE: swing(AMPLITUDE, 2.0 * pi * FREQUENCY, 3.0, 0.0, 'sine of 10 mm, 0.5 Hz'),
        f'{CIRCLE} X': swing(RADIUS, turning, 2.0, 0.5 * pi, 'circle, first axis'),
        f'{CIRCLE} Y': swing(RADIUS, turning, 2.0, 0.0, 'circle, second axis'),
    }


def step_names() -> dict[str, str]:
    """Return names and labels of the cases that are moves to a target, without load."""
    others = (SINE, CIRCLE, *LOADS)
    return {
        name: case.label for name, case in servo_cases().items() if not name.startswith(others)
    }


def drive_many(
    controllers: Sequence[AxisController], cases: Sequence[ServoCase], *, seed: int
) -> list[PositioningRun]:
    """Drive lathe axes side by side, each along its own reference; one controller per case."""
    axes = LatheAxes(
        [LatheAxisConfig(seed=seed, **case.knobs) for case in cases],
        [case.start for case in cases],
    )
    longest = max(case.duration for case in cases)
    courses = np.array([case.reference.over(longest) for case in cases]).transpose(1, 2, 0)
    count = courses.shape[1]
    truth, measured, duties = np.empty((3, count, len(cases)))
    for controller, reading in zip(controllers, axes.measure().tolist(), strict=True):
        controller.reset(reading)
    steps = [controller.step for controller in controllers]
    for k in range(count):
        truth[k], measured[k] = axes.position, axes.measure()
        motion = zip(steps, *courses[:1, k].tolist(), measured[k].tolist(),
                     *courses[1:, k].tolist(), strict=True)  # fmt: skip
        duties[k] = [step(*now) for step, *now in motion]
        axes.drive(duties[k])
    runs = []
    for i, case in enumerate(cases):
        kept = slice(round(case.duration / axes.period))
        runs.append(
            PositioningRun(
                axes.period * np.arange(kept.stop, dtype=np.float64),
                courses[0, kept, i],
                truth[kept, i],
                measured[kept, i],
                duties[kept, i],
                float(case.reference.position[-1]),
                case.start,
                controllers[i].status.fault,
            )
        )
    return runs


def compare_controllers(
    names: Sequence[str] = tuple(LABELS),
    *,
    moves: int = 200,
    seed: int = 0,
    progress: Tell | None = None,
) -> ServoComparison:
    """Put controllers on all cases.

    Parameters
    ----------
    names : sequence of str
        Of `LATHE_CONTROLLERS`.
    moves : int
        Random moves with moderate friction, and as many with hard; 0 for none.  Controllers that
        do not settle with friction at all make none.
    seed : int
        Seed of noise and random moves.
    progress : callable, optional
        Told what is going on, steps done and in all.
    """
    tell = progress or (lambda text, done, total: None)
    tell('all cases', 0, 1)
    cases, axis = servo_cases(), LatheAxisConfig().linear()
    controllers = [make_controller(name, axis) for name in names for _ in cases]
    every = drive_many(controllers, list(cases.values()) * len(names), seed=seed)
    figures = {}
    for number, name in enumerate(names):
        runs = dict(zip(cases, every[number * len(cases) :][: len(cases)], strict=True))
        tell(f'{name}, random moves', 1 + number, 1 + len(names))
        # what does not even settle with friction has no business there
        settles = moves and np.isfinite(runs[FRICTION_CASE].settle())
        random = _random(name, axis, moves, seed) if settles else {}
        figures[name] = _judged(name, runs, random, seed)
    return ServoComparison(step_names(), figures, moves, seed)


def _judged(
    name: str,
    runs: Mapping[str, PositioningRun],
    random: Mapping[str, RandomFigures],
    seed: int,
) -> ControllerFigures:
    """Return the figures of a controller's runs."""
    steps = {}
    for case in step_names():
        run = runs[case]
        settle = run.settle()
        if 'smooth' in case and not np.isfinite(settle) and not run.fault:
            settle = _waited(name, case, seed)
        steps[case] = StepFigures(settle, run.overshoot, run.steady_error(STEADY))
    loaded = [runs[load] for load in LOADS]
    late = [np.abs(run.error[run.time >= STEADY]).max() for run in loaded]
    x, y = runs[f'{CIRCLE} X'], runs[f'{CIRCLE} Y']
    radial = (np.hypot(x.position, y.position) - RADIUS)[len(x.time) // 2 :]
    return ControllerFigures(
        steps,
        float(max(late)),
        max(run.settle() for run in loaded) - STEADY,
        runs[SINE].following_error(1.0 / FREQUENCY),
        (float(np.abs(radial).max()), float(np.sqrt((radial**2).mean()))),
        random,
        runs,
    )


def _waited(name: str, case: str, seed: int) -> float:
    """Return the settling time of a move that takes long [s]."""
    move, axis = servo_cases()[case], LatheAxisConfig().linear()
    plant = LatheAxis(LatheAxisConfig(seed=seed, substeps=5, **move.knobs))
    return position(make_controller(name, axis), plant, move.reference, PATIENCE).settle()


def _random(name: str, axis: LinearAxis, count: int, seed: int) -> dict[str, RandomFigures]:
    """Make random moves of both kinds and return how far from their targets they end."""
    moves = [
        move
        for kind in FRICTIONS
        for move in random_moves(count, hard=kind == FRICTIONS[-1], seed=seed)
    ]
    batch = position_many([make_controller(name, axis) for _ in moves], moves, 4.0)
    errors = batch.steady_error(3.0).reshape(len(FRICTIONS), count)
    faults = np.array([bool(fault) for fault in batch.fault]).reshape(errors.shape)
    return {
        kind: RandomFigures(
            float((error <= 1e-6).mean()),
            float((error <= 2e-6).mean()),
            float(error.max()),
            int(faulty.sum()),
        )
        for kind, error, faulty in zip(FRICTIONS, errors, faults, strict=True)
    }
