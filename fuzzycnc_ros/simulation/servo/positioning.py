# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Moves of a simulated axis under a controller, and what they are judged by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from numbers import Real
from typing import Protocol

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.servo.controller import AxisController
from fuzzycnc_ros.core.servo.profile import Reference, step_reference
from fuzzycnc_ros.simulation.servo.lathe_axes import LatheAxes, LatheMove


@dataclass(frozen=True, eq=False)
class PositioningRun:
    """A move: one row per control period, from the first reading on.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Time since the start [s].
    reference, position, measured : ndarray, shape (n,)
        Where the slide was to be, was, and was read [m].
    duty : ndarray, shape (n,)
        Duty held from then on [-].
    target, start : float
        Where the move ends and began [m].
    fault : str
        Why the controller gave up; empty if it did not.
    """

    time: Array
    reference: Array
    position: Array
    measured: Array
    duty: Array
    target: float
    start: float
    fault: str = ''

    @property
    def error(self) -> Array:
        """Reference less true position, shape (n,) [m]."""
        return np.asarray(self.reference - self.position)

    def settle(self, tolerance: float = 2e-6) -> float:
        """Return the last time at which the slide was further from the target [s].

        Infinite if it still is at the end.
        """
        return float(settle_times(self.time, self.target - self.position, tolerance))

    @property
    def overshoot(self) -> float:
        """Overshoot of the slide beyond the target [m]; 0 if there was none."""
        direction = np.sign(self.target - self.start)
        return float(max(0.0, ((self.position - self.target) * direction).max()))

    def steady_error(self, since: float) -> float:
        """Return the largest distance to the target from a time [s] on [m]."""
        late = self.time > since
        if not late.any():
            raise ValueError(f'since: expected less than {self.time[-1]} s but found {since} s')
        return float(np.abs(self.target - self.position[late]).max())

    def following_error(self, since: float = 0.0) -> tuple[float, float]:
        """Return the largest and the rms distance to the reference from a time [s] on [m]."""
        error = self.error[self.time >= since]
        return float(np.abs(error).max()), float(np.sqrt((error * error).mean()))


def settle_times(time: Array, error: Array, tolerance: float) -> Array:
    """Return when errors, shape (..., n), came within a tolerance for good, shape (...) [s]."""
    far = np.abs(error) > tolerance
    last = far.shape[-1] - 1 - np.argmax(far[..., ::-1], axis=-1)
    after = np.append(time, inf)[last + 1]
    return np.asarray(np.where(far.any(axis=-1), after, time[0]))


class DrivenAxis(Protocol):
    """A driven axis of your own: a control period is `measure`, then `drive`.

    It may have a `travel` too, its lowest and highest position [m].
    """

    @property
    def period(self) -> float:
        """Control period [s], that of the controller."""

    @property
    def position(self) -> float:
        """True position of the slide [m]; what it is judged by."""

    def measure(self) -> float:
        """Return the position as the sensor gives it now [m]; NaN while it gives none."""

    def drive(self, duty: float) -> None:
        """Hold a duty, -1 to 1 of the full drive [-], for one period."""


DURATION_MAX = 3600.0
"""Longest run in one go [s]."""

NEEDED = {
    'period': 'the control period [s]',
    'position': 'the true position [m]',
    'measure': 'a method that returns the measured position [m]',
    'drive': 'a method that holds a duty, -1 to 1, for one period',
}
"""Attributes of a `DrivenAxis`, and what they give."""


def check_plant(plant: object) -> None:
    """Refuse what cannot be driven as an axis.

    Raises
    ------
    TypeError
        If an attribute of `NEEDED` is missing or of another kind.
    """
    kind = type(plant).__name__
    for name, meaning in NEEDED.items():
        if not hasattr(plant, name):
            raise TypeError(
                f'plant: expected {name}, {meaning}, but found none in {kind}; an axis has '
                f'{", ".join(NEEDED)}'
            )
        value = getattr(plant, name)
        if callable(value) != meaning.startswith('a method'):
            raise TypeError(
                f'plant: expected {name} to be {meaning} but found {value!r} in {kind}'
                + ('; make it a property' if callable(value) else '')
            )
    reading = plant.measure()  # type: ignore[attr-defined]
    if not isinstance(reading, Real):
        raise TypeError(
            f'plant: expected measure() to return a position [m] but found {reading!r} of {kind}'
        )


def position(
    controller: AxisController,
    plant: DrivenAxis,
    reference: float | Reference,
    duration: float | None = None,
) -> PositioningRun:
    """Move a simulated axis and return the run.

    The controller is reset to where the axis reads at the start.

    Parameters
    ----------
    controller : AxisController
        Controller with the plant's period.
    plant : DrivenAxis
        Axis, simulated or your own; it keeps its state, so that moves can follow each other.
    reference : float or Reference
        Target of a step [m], or positions, velocities and accelerations over time.
    duration : float, optional
        Length of the run [s]; by default that of the reference.  A reference that is over rests
        at its end.

    Raises
    ------
    TypeError
        If the plant lacks an attribute; the message says which and what it gives.
    ValueError
        If the periods differ, a duration is none or longer than `DURATION_MAX`, a step has none,
        or the reference leaves the travel of the plant.

    Examples
    --------
    >>> from fuzzycnc_ros.core.machine.axis_models import LatheAxisConfig
    >>> from fuzzycnc_ros.simulation.servo.axes import LatheAxis
    >>> from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController
    >>> axis = LatheAxis()
    >>> run = position(VariableUniverseController(LatheAxisConfig().linear()), axis, 1e-3, 0.5)
    >>> run.settle() < 0.4, run.fault
    (True, '')
    """
    check_plant(plant)
    if controller.period != plant.period:
        raise ValueError(
            f'expected one period but found {controller.period} s in the controller and '
            f'{plant.period} s in the plant'
        )
    if not isinstance(reference, Reference):
        if duration is None:
            raise ValueError('duration: expected a time for a step but found none')
        reference = step_reference(reference, plant.period)
    if duration is not None and not plant.period <= duration <= DURATION_MAX:
        raise ValueError(
            f'duration: expected {plant.period:g} s, one period, to {DURATION_MAX:g} s but found '
            f'{duration:g} s'
        )
    low, high = getattr(plant, 'travel', (-inf, inf))
    beyond = reference.position[(reference.position < low) | (reference.position > high)]
    if len(beyond):
        raise ValueError(
            f'reference: expected positions from {low:g} to {high:g} m, the travel of the axis, '
            f'but found {beyond[0]:g} m; divide by 1000 if it is in millimetres'
        )
    course = reference.over(duration)
    places, velocities, accelerations = (values.tolist() for values in course)
    count = len(places)
    truth, measured, duties = np.empty((3, count))
    start = plant.position
    controller.reset(plant.measure())
    for k in range(count):
        truth[k] = plant.position
        measured[k] = reading = plant.measure()
        duties[k] = duty = controller.step(places[k], reading, velocities[k], accelerations[k])
        plant.drive(duty)
    return PositioningRun(
        plant.period * np.arange(count, dtype=np.float64),
        np.array(places),
        truth,
        measured,
        duties,
        places[-1],
        start,
        controller.status.fault,
    )


@dataclass(frozen=True, eq=False)
class PositioningBatch:
    """True courses of many step moves.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Time since the start [s].
    position : ndarray, shape (cases, n)
        Where the slides were [m].
    target : ndarray, shape (cases,)
        Where they were to be [m].
    fault : tuple of str, length cases
        Why a controller gave up.
    """

    time: Array
    position: Array
    target: Array
    fault: tuple[str, ...]

    @property
    def error(self) -> Array:
        """Target less true position, shape (cases, n) [m]."""
        return np.asarray(self.target[:, np.newaxis] - self.position)

    def settle(self, tolerance: float = 2e-6) -> Array:
        """Return the settling times, shape (cases,) [s]; infinite if not settled."""
        return settle_times(self.time, self.error, tolerance)

    @property
    def overshoot(self) -> Array:
        """Overshoot of the slides beyond their targets, shape (cases,) [m]."""
        beyond = -self.error * np.sign(self.target)[:, np.newaxis]
        return np.asarray(np.maximum(beyond.max(axis=1), 0.0))

    def steady_error(self, since: float) -> Array:
        """Return the largest distances to the targets from a time [s] on, shape (cases,) [m]."""
        return np.asarray(np.abs(self.error[:, self.time > since]).max(axis=1))


def position_many(
    controllers: Sequence[AxisController], moves: Sequence[LatheMove], duration: float
) -> PositioningBatch:
    """Make step moves of the lathe axis from 0 side by side.

    Parameters
    ----------
    controllers : sequence of AxisController
        One per move.
    moves : sequence of LatheMove
        Axes and targets.
    duration : float
        Length of the runs [s].

    Raises
    ------
    ValueError
        If there is not one controller per move.
    """
    if len(controllers) != len(moves):
        raise ValueError(
            f'controllers: expected one for each of {len(moves)} moves but found '
            f'{len(controllers)}'
        )
    axes = LatheAxes([move.config for move in moves])
    targets = [move.target for move in moves]
    count = round(duration / axes.period)
    course = np.empty((len(moves), count))
    for controller in controllers:
        controller.reset(0.0)
    steps = [controller.step for controller in controllers]
    for k in range(count):
        course[:, k] = axes.position
        readings = axes.measure().tolist()
        duties = [
            step(target, reading)
            for step, target, reading in zip(steps, targets, readings, strict=True)
        ]
        axes.drive(duties)
    faults = tuple(controller.status.fault for controller in controllers)
    time = axes.period * np.arange(count, dtype=np.float64)
    return PositioningBatch(time, course, np.array(targets), faults)
