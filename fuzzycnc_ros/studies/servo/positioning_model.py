# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a comparison of position controllers came to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fuzzycnc_ros.simulation.servo.positioning import PositioningRun

LABELS = {
    'variable_universe_paper': 'as published',
    'variable_universe_static': 'published, floors raised',
    'fixed_universe_paper': 'fixed universe, published',
    'pid': 'PID',
    'variable_universe_model_free': 'variable, integral',
    'variable_universe': 'variable, observer (default)',
    'fixed_universe': 'fixed, observer',
    'cascade': 'P-PI cascade',
}
"""Controllers by name, as tables and plots call them, in the order of a comparison."""

DEFAULT = 'variable_universe'
"""Name of the controller in use."""


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
    """What one controller does on all cases.

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
