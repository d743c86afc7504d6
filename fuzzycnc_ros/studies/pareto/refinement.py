# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feed schedules against a measured contour error: the knob at a given error, and `refine`.

docs/explanation/methods/feedrate.md has what it gains.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import copysign, exp, isfinite, log
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d

from fuzzycnc_ros.core.arrays import Array

_EXPONENT, _STEP_LOW, _STEP_HIGH = 0.2, 0.5, 2.0
"""A round moves the feed by (tolerance / error)^0.2, at most by a factor of two."""

_BRACKET = 2.0
"""Factor by which the knob is moved until the tolerance lies between two runs."""


class ContourMeasurement(Protocol):
    """Contour error of a driven schedule, such as a `ContouringRun`, or one from a real machine.

    Attributes
    ----------
    arc_length : ndarray, shape (n,)
        Where on the path each sample belongs [m].
    error : ndarray, shape (n,)
        Contour error of each sample [m].
    duration : float
        Time of the motion [s].
    """

    @property
    def arc_length(self) -> Array:
        """Arc length of each sample on the path [m]."""

    @property
    def error(self) -> Array:
        """Contour error of each sample [m]."""

    @property
    def duration(self) -> float:
        """Time of the motion [s]."""


Run = TypeVar('Run', bound=ContourMeasurement)


class UnreachableToleranceError(ValueError):
    """No setting of the knob makes the largest contour error equal to the tolerance."""


@dataclass(frozen=True)
class KnobAtError(Generic[Run]):
    """Setting of a knob at which the largest contour error is the tolerance.

    Attributes
    ----------
    knob : float
        The setting, in the knob's unit.
    run : ContourMeasurement
        What was measured with it; its largest error is the tolerance or barely less.
    """

    knob: float
    run: Run


@dataclass(frozen=True)
class Refined(Generic[Run]):
    """A refined feed schedule.

    Attributes
    ----------
    feed : ndarray, shape (n,)
        Speed at each point of the schedule [m/s].
    run : ContourMeasurement
        What was measured with it.
    """

    feed: Array
    run: Run


def knob_at_error(
    drive: Callable[[float], Run],
    tolerance: float,
    guess: float,
    *,
    precision: float = 1e-3,
    low: float = 1e-9,
    high: float = 1e9,
) -> KnobAtError[Run]:
    """Turn a knob until the largest contour error is the tolerance.

    Parameters
    ----------
    drive : callable
        Drives the schedule at a setting of the knob and measures it.  The larger the setting, the
        larger the error.
    tolerance : float
        Largest contour error to reach [m]; positive.
    guess : float
        Setting to begin at; positive.
    precision : float
        By how much of itself the setting may be too small [-]; positive.
    low, high : float
        Settings that are not left.

    Returns
    -------
    KnobAtError
        The largest setting found whose error does not exceed the tolerance, and its run.

    Raises
    ------
    ValueError
        If tolerance, guess, precision or bounds are not positive and in order.
    UnreachableToleranceError
        If the error is above the tolerance at `low`, or below it at `high`.

    Examples
    --------
    Error grows with the square of the feed, 1 um at 10 mm/s:

    >>> from types import SimpleNamespace
    >>> def drive(feed):
    ...     return SimpleNamespace(error=np.array([0.01 * feed**2]), duration=1.0 / feed)
    >>> round(knob_at_error(drive, 4e-6, 0.005).knob, 4)
    0.02
    """
    _check_positive(tolerance=tolerance, guess=guess, precision=precision, low=low)
    if not low <= guess <= high:
        raise ValueError(f'guess: expected {low} to {high} but found {guess}')
    best: tuple[float, Run] | None = None

    def excess(logarithm: float) -> float:
        nonlocal best
        knob = min(max(exp(logarithm), low), high)
        run = drive(knob)
        largest = float(np.max(run.error))
        if not isfinite(largest):
            raise ValueError(f'expected a finite contour error but found {largest} at {knob}')
        if largest <= tolerance and (best is None or knob > best[0]):
            best = (knob, run)
        return log(max(largest, 1e-300) / tolerance)

    at = log(guess)
    value = excess(at)
    edge = log(low) if value > 0.0 else log(high)
    last, last_value = at, value
    while value * last_value > 0.0:
        if at == edge:
            raise UnreachableToleranceError(
                f'expected a setting whose largest contour error is {1e3 * tolerance:.6g} mm but '
                f'at {exp(at):.6g} it is still {1e3 * tolerance * exp(value):.6g} mm'
            )
        last, last_value = at, value
        reach = min(log(_BRACKET), abs(edge - at))
        at = edge if reach < log(_BRACKET) else at + copysign(reach, edge - at)
        value = excess(at)
    if value != 0.0 and last_value != 0.0:
        # Here, since programs that are scheduled look for no equal error: they start sooner.
        from scipy.optimize import brentq

        root = brentq(excess, at, last, xtol=0.25 * precision, rtol=1e-12)
        while best is None or log(best[0]) < root - precision:
            # the solver may have come from above only
            root -= 0.5 * precision
            excess(root)
    assert best is not None
    return KnobAtError(*best)


def refine(
    feed: ArrayLike,
    arc_length: ArrayLike,
    drive: Callable[[Array], Run],
    tolerance: float,
    *,
    feed_max: float,
    rounds: int = 30,
) -> Refined[Run]:
    """Refine a schedule against the contour error that a machine makes with it.

    Each round drives the schedule, takes the largest error around each point and moves the feed
    there by (tolerance / error)^0.2; at last the whole schedule is scaled to the tolerance.

    Parameters
    ----------
    feed : array_like, shape (n,)
        Schedule to begin with [m/s]; positive.
    arc_length : array_like, shape (n,)
        Increasing arc lengths of its points [m].
    drive : callable
        Drives a schedule, shape (n,) [m/s], and measures it.
    tolerance : float
        Largest contour error [m]; positive.
    feed_max : float
        Largest feed [m/s]; positive.
    rounds : int
        Number of rounds; 0 only scales.

    Returns
    -------
    Refined
        The schedule and its run, whose largest error does not exceed the tolerance.

    Raises
    ------
    ValueError
        If shapes differ, a number is not positive or finite, or arc lengths do not increase.
    UnreachableToleranceError
        If even a schedule a thousand times slower exceeds the tolerance.

    Notes
    -----
    Where `feed_max` binds everywhere and the error stays below the tolerance, the schedule is
    returned at that feed: it is not scaled up to the tolerance.
    """
    arc, speed = np.asarray(arc_length, dtype=np.float64), np.array(feed, dtype=np.float64)
    if arc.ndim != 1 or arc.shape != speed.shape or len(arc) < 2:
        raise ValueError(
            f'expected two or more arc lengths and as many feeds but found the shapes '
            f'{arc.shape} and {speed.shape}'
        )
    if not (np.isfinite(arc).all() and np.all(np.diff(arc) > 0.0)):
        raise ValueError('arc_length: expected finite, increasing numbers; drop duplicate points')
    if not (np.isfinite(speed).all() and np.all(speed > 0.0)):
        raise ValueError('feed: expected finite numbers above 0 m/s')
    _check_positive(tolerance=tolerance, feed_max=feed_max)
    if rounds < 0:
        raise ValueError(f'rounds: expected 0 or more but found {rounds}')
    speed = np.minimum(speed, feed_max)
    for _ in range(rounds):
        error = local_error(drive(speed), arc)
        factor = (tolerance / np.maximum(error, 1e-12 * tolerance)) ** _EXPONENT
        speed = np.minimum(speed * np.clip(factor, _STEP_LOW, _STEP_HIGH), feed_max)
    full = drive(np.full_like(speed, feed_max))
    if float(np.max(full.error)) <= tolerance:
        return Refined(np.full_like(speed, feed_max), full)
    # at this scale every point has the largest feed, which is too fast
    high = 2.0 * feed_max / float(speed.min())
    found = knob_at_error(
        lambda scale: drive(np.minimum(scale * speed, feed_max)),
        tolerance,
        1.0,
        low=1e-3,
        high=max(high, 2.0),
    )
    return Refined(np.minimum(found.knob * speed, feed_max), found.run)


def local_error(run: ContourMeasurement, arc_length: Array) -> Array:
    """Return the largest error around each point of a schedule.

    Parameters
    ----------
    run : ContourMeasurement
        Measured errors, each at its place.
    arc_length : ndarray, shape (n,)
        Increasing arc lengths of the schedule's points [m].

    Returns
    -------
    ndarray, shape (n,)
        Largest error of the samples nearest to the point or to one of its two neighbours [m];
        points between samples take it from the points beside them.
    """
    middle = 0.5 * (arc_length[1:] + arc_length[:-1])
    nearest: NDArray[np.intp] = np.searchsorted(middle, run.arc_length)
    largest = np.full(len(arc_length), -np.inf)
    np.maximum.at(largest, nearest, run.error)
    known = np.flatnonzero(np.isfinite(largest))
    filled = np.interp(arc_length, arc_length[known], largest[known])
    return np.asarray(maximum_filter1d(filled, 3, mode='nearest'))


def _check_positive(**values: float) -> None:
    """Refuse numbers that are not finite and positive, by name."""
    for name, value in values.items():
        if not (isfinite(value) and value > 0.0):
            raise ValueError(f'{name}: expected a finite number above 0 but found {value}')
