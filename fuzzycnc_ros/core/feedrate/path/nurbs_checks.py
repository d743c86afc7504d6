# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a NURBS curve must be, method sheet 002 section 9: each check says how to mend it."""

import operator

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array

COORDINATE_MAX = 1e3
"""Largest coordinate [m]: of no machine, and far from what doubles lose digits at."""
DEGREE_MAX = 15
WEIGHTS_MAX = 1e6
"""Largest ratio of two weights of a curve: beyond it, digits of its points are lost."""
SPAN_MIN = 1e-9
"""Least distance of two knots that differ, as a share of the domain."""


def read_only(name: str, value: ArrayLike) -> Array:
    """Return a read-only copy as doubles; refuse what is not finite."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f'expected numbers in {name} but found {value!r}') from error
    if not np.isfinite(array).all():
        raise ValueError(
            f'expected finite numbers in {name} but found {outlier(array)} at index '
            f'{tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])}'
        )
    array.setflags(write=False)
    return array


def outlier(array: Array) -> float:
    """Return a value to show of refused ones: one that is not finite, else the largest."""
    bad = array[~np.isfinite(array)]
    return float(bad.flat[0]) if bad.size else float(array.flat[np.abs(array).argmax()])


def checked_degree(degree: int) -> int:
    """Return the degree as an integer; refuse what is none or below 1."""
    try:
        number = operator.index(degree)
    except TypeError:
        number = 0
    if number < 1:
        raise ValueError(f'expected a degree that is an integer of 1 or more but found {degree!r}')
    return number


def check_points(control: Array, weight: Array, degree: int) -> None:
    """Refuse control points and weights that make no curve of this degree."""
    if control.ndim != 2 or control.shape[1] not in (2, 3):
        raise ValueError(
            f'expected control points of shape (n, 2) or (n, 3) but found {control.shape}'
        )
    if len(control) <= degree:
        raise ValueError(
            f'expected more than {degree} control points for degree {degree} '
            f'but found {len(control)}; add points or lower the degree'
        )
    if weight.shape != control.shape[:1]:
        raise ValueError(
            f'expected one weight per control point, shape ({len(control)},), '
            f'but found {weight.shape}'
        )
    if np.any(weight <= 0.0):
        index = int(np.argmax(weight <= 0.0))
        raise ValueError(
            f'expected positive weights but found {weight[index]:g} at index {index}; '
            'zero drops a point and a negative weight sends the curve to infinity'
        )


def check_knots(knot: Array, points: int, degree: int) -> None:
    """Refuse knots that do not fit the number of points and the degree, or tear the curve."""
    if knot.shape != (points + degree + 1,):
        raise ValueError(
            f'expected {points + degree + 1} knots, points + degree + 1, for {points} control '
            f'points of degree {degree}, but found shape {knot.shape}'
        )
    if np.any(np.diff(knot) < 0.0):
        index = int(np.argmax(np.diff(knot) < 0.0))
        raise ValueError(
            f'expected knots that never fall but found {knot[index + 1]:g} after '
            f'{knot[index]:g} at index {index + 1}'
        )
    first, last = knot[degree], knot[points]
    if not first < last:
        raise ValueError(
            f'expected a domain with length but found knots {degree} and {points} equal '
            f'to {first:g}'
        )
    value, count = np.unique(knot, return_counts=True)
    allowed = np.where((value > first) & (value < last), degree, degree + 1)
    if np.any(count > allowed):
        index = int(np.argmax(count > allowed))
        raise ValueError(
            f'expected the knot {value[index]:g} at most {allowed[index]} times for degree '
            f'{degree} but found it {count[index]} times; the curve tears there: split it'
        )


def check_machinable(control: Array, weight: Array, knot: Array, degree: int) -> None:
    """Refuse a curve that no machine follows, and whose motion would take for ever to find.

    Parameters
    ----------
    control : ndarray, shape (n, 3)
        Control points [m].
    weight : ndarray, shape (n,)
        Weights, all positive.
    knot : ndarray, shape (n + degree + 1,)
        Knots that never fall.
    degree : int
        Degree.

    Raises
    ------
    ValueError
        If it is.
    """
    if degree > DEGREE_MAX:
        raise ValueError(f'expected a degree from 1 to {DEGREE_MAX} but found {degree}')
    far = float(np.abs(control).max())
    if far > COORDINATE_MAX:
        raise ValueError(f'expected coordinates up to {COORDINATE_MAX:g} m but found {far:g} m')
    if weight.max() > WEIGHTS_MAX * weight.min():
        raise ValueError(
            f'expected weights no more than {WEIGHTS_MAX:g} times each other but found '
            f'{weight.min():g} and {weight.max():g}'
        )
    width = knot[len(control)] - knot[degree]
    step = np.diff(np.unique(knot))
    if not (step >= SPAN_MIN * width).all() or np.abs(knot).max() > width / SPAN_MIN:
        raise ValueError(
            f'expected knots that are equal or {SPAN_MIN:g} of the domain apart, not far from 0, '
            f'but found steps down to {step.min():g} over {width:g}'
        )
    if not np.ptp(control, axis=0).max() > 0.0:
        raise ValueError('expected points that differ but found one and the same')
