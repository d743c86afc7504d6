# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rational B-spline curves in the plane and in space."""

import operator
from functools import cached_property
from math import comb, factorial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

COORDINATE_MAX = 1e3
"""Largest coordinate [m]: of no machine, and far from what doubles lose digits at."""
DEGREE_MAX = 15
_WEIGHTS_MAX = 1e6
"""Largest ratio of two weights of a curve: beyond it, digits of its points are lost."""
_SPAN_MIN = 1e-9
"""Least distance of two knots that differ, as a share of the domain."""


def _read_only(name: str, value: ArrayLike) -> Array:
    """Return a read-only copy as doubles; refuse what is not finite."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f'expected numbers in {name} but found {value!r}') from error
    if not np.isfinite(array).all():
        raise ValueError(
            f'expected finite numbers in {name} but found {_outlier(array)} at index '
            f'{tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])}'
        )
    array.setflags(write=False)
    return array


def _outlier(array: Array) -> float:
    """Return a value to show of refused ones: one that is not finite, else the largest."""
    bad = array[~np.isfinite(array)]
    return float(bad.flat[0]) if bad.size else float(array.flat[np.abs(array).argmax()])


def _checked_degree(degree: int) -> int:
    """Return the degree as an integer; refuse what is none or below 1."""
    try:
        number = operator.index(degree)
    except TypeError:
        number = 0
    if number < 1:
        raise ValueError(f'expected a degree that is an integer of 1 or more but found {degree!r}')
    return number


def _check_points(control: Array, weight: Array, degree: int) -> None:
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


def _check_knots(knot: Array, points: int, degree: int) -> None:
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
    if weight.max() > _WEIGHTS_MAX * weight.min():
        raise ValueError(
            f'expected weights no more than {_WEIGHTS_MAX:g} times each other but found '
            f'{weight.min():g} and {weight.max():g}'
        )
    width = knot[len(control)] - knot[degree]
    step = np.diff(np.unique(knot))
    if not (step >= _SPAN_MIN * width).all() or np.abs(knot).max() > width / _SPAN_MIN:
        raise ValueError(
            f'expected knots that are equal or {_SPAN_MIN:g} of the domain apart, not far from 0, '
            f'but found steps down to {step.min():g} over {width:g}'
        )
    if not np.ptp(control, axis=0).max() > 0.0:
        raise ValueError('expected points that differ but found one and the same')


# 16 Gauss nodes integrate a smooth piece to rounding; pieces that are not are halved until they
# are.  60 halvings go below the spacing of doubles.
_NODE, _WEIGHT = np.polynomial.legendre.leggauss(16)
_HALVINGS_MAX = 60
_LENGTH_TOLERANCE = 1e-13

# A derivative below this part of the curve's size, per domain, is rounding of zero.
_STILL = 1e-12


class NurbsCurve:
    """Rational B-spline curve C(u) of any degree in 2-D or 3-D.

    It is evaluated as a polynomial spline of one more dimension, (w P, w), and then divided;
    derivatives follow by the quotient rule.  The last knot span is closed, so that both ends of
    the domain lie on the curve.

    Parameters
    ----------
    control : array_like, shape (n, d)
        Control points [m], d = 2 or 3, more of them than `degree`.
    weight : array_like, shape (n,)
        Weights, positive.  Equal weights give a plain B-spline.
    knot : array_like, shape (n + degree + 1,)
        Knots, never falling.  No knot inside the domain may occur more than `degree` times, for
        the curve would tear there, and none at its ends more than `degree` + 1 times.
    degree : int
        Degree, at least 1.

    Attributes
    ----------
    control, weight, knot, degree
        As given; the arrays are copies and read-only.
    domain : tuple of two floats
        First and last parameter, knots number `degree` and n.

    Raises
    ------
    ValueError
        If an argument is none of that, or holds a value that is not finite.

    Examples
    --------
    A quarter of a circle of radius 10 mm:

    >>> arc = NurbsCurve(
    ...     control=[[0.01, 0.0], [0.01, 0.01], [0.0, 0.01]],
    ...     weight=[1.0, 0.5**0.5, 1.0],
    ...     knot=[0, 0, 0, 1, 1, 1],
    ...     degree=2,
    ... )
    >>> arc.curvature([0.0, 0.3, 1.0]).round(9)
    array([100., 100., 100.])
    >>> round(arc.length, 12) == round(0.005 * np.pi, 12)
    True
    """

    def __init__(
        self, control: ArrayLike, weight: ArrayLike, knot: ArrayLike, degree: int = 3
    ) -> None:
        self.degree = _checked_degree(degree)
        self.control = _read_only('control', control)
        self.weight = _read_only('weight', weight)
        self.knot = _read_only('knot', knot)
        _check_points(self.control, self.weight, self.degree)
        _check_knots(self.knot, len(self.control), self.degree)
        self.domain = (float(self.knot[self.degree]), float(self.knot[len(self.control)]))
        self._origin = self.control[0]

    @property
    def dimension(self) -> int:
        """Number of coordinates, 2 or 3."""
        return int(self.control.shape[1])

    def point(self, u: ArrayLike) -> Array:
        """Return the points C(u).

        Parameters
        ----------
        u : array_like, shape (...)
            Parameters in the domain.

        Returns
        -------
        ndarray, shape (..., d)
            Points [m].

        Raises
        ------
        ValueError
            If a parameter lies outside the domain or is not a number.
        """
        parameter = self._parameters(u)
        lifted = self._spline(parameter)
        found = np.empty((*parameter.shape, self.dimension))
        # One coordinate at a time: several times faster than an inner loop over two or three.
        for k, origin in enumerate(self._origin):
            np.divide(lifted[..., k], lifted[..., -1], out=found[..., k])
            found[..., k] += origin
        return found

    def derivative(self, u: ArrayLike, order: int = 1) -> Array:
        """Return the derivative of C(u) by u, exactly, by the quotient rule.

        At a knot of multiplicity `degree`, where the curve has a corner, and wherever the
        derivative jumps, it is that of the span that begins there.

        Parameters
        ----------
        u : array_like, shape (...)
            Parameters in the domain.
        order : int
            Order, 1 or more.

        Returns
        -------
        ndarray, shape (..., d)
            Derivatives [m].

        Raises
        ------
        ValueError
            If a parameter lies outside the domain or is not a number, or `order` is below 1.
        """
        if order < 1:
            raise ValueError(f'expected an order of 1 or more but found {order}; see point()')
        return _points_last(self._derivatives(self._parameters(u), order)[order])

    def curvature(self, u: ArrayLike) -> Array:
        """Return the exact curvature, unsigned.

        Parameters
        ----------
        u : array_like, shape (...)
            Parameters in the domain.

        Returns
        -------
        ndarray, shape (...)
            Curvature [1/m].  Where the first derivative vanishes, as at a doubled control point
            at the end, it is the limit: 0 on a straight piece and infinite on any other.

        Raises
        ------
        ValueError
            If a parameter lies outside the domain or is not a number.
        """
        parameter = self._parameters(u)
        _, first, second = self._derivatives(parameter, 2)
        square = np.sum(first * first, axis=0)
        span = self.domain[1] - self.domain[0]
        still = square * (span * span) <= _STILL * self._size * (_STILL * self._size)
        square = np.where(still, 1.0, square)
        # What is left of the second derivative across the tangent: unlike the difference of
        # squares under a root, it keeps its digits where the curve is almost straight.
        across = second - np.sum(first * second, axis=0) / square * first
        value = np.asarray(np.sqrt(np.sum(across * across, axis=0)) / square)
        if np.any(still):
            value[still] = self._curvature_at_rest(parameter[still])
        return value

    @property
    def length(self) -> float:
        """Length of the whole curve [m], to about 12 digits."""
        return float(self._pieces[1][-1])

    def arc_length(self, u: ArrayLike) -> Array:
        """Return the length of the curve from its start to the parameters u.

        Parameters
        ----------
        u : array_like, shape (...)
            Parameters in the domain.

        Returns
        -------
        ndarray, shape (...)
            Arc length [m], to about 12 digits of the whole.

        Raises
        ------
        ValueError
            If a parameter lies outside the domain or is not a number.
        """
        parameter = self._parameters(u)
        edge, length = self._pieces
        piece = np.clip(np.searchsorted(edge, parameter, side='right') - 1, 0, len(edge) - 2)
        return np.asarray(length[piece] + self._integral(edge[piece], parameter))

    def parameter(self, arc_length: ArrayLike) -> Array:
        """Return the parameters at which the curve has a length, the inverse of `arc_length`.

        Parameters
        ----------
        arc_length : array_like, shape (...)
            Arc length from the start [m], from 0 to `length`.

        Returns
        -------
        ndarray, shape (...)
            Parameters in the domain, whose arc lengths are right to about 12 digits of the whole.

        Raises
        ------
        ValueError
            If a length lies outside the curve or is not a number.
        """
        wanted = np.asarray(arc_length, dtype=np.float64)
        edge, length = self._pieces
        slack = _STILL * length[-1]
        if not np.all((wanted >= -slack) & (wanted <= length[-1] + slack)):
            raise ValueError(
                f'expected arc lengths from 0 to {length[-1]:g} m but found {_outlier(wanted)}; '
                'take them within the curve'
            )
        wanted = np.clip(wanted, 0.0, length[-1])
        piece = np.clip(np.searchsorted(length, wanted, side='right') - 1, 0, len(edge) - 2)
        low, high = edge[piece], edge[piece + 1]
        span = length[piece + 1] - length[piece]  # 0 where the curve stands still
        share = (wanted - length[piece]) / np.where(span > 0.0, span, 1.0)
        found = low + share * (high - low)
        for _ in range(_HALVINGS_MAX):
            excess = length[piece] + self._integral(edge[piece], found) - wanted
            settled = (np.abs(excess) <= slack) | (high - low <= np.spacing(np.abs(high)))
            if settled.all():
                break
            low, high = np.where(excess < 0.0, found, low), np.where(excess > 0.0, found, high)
            speed = self._speed(found)
            newton = found - excess / np.where(speed > 0.0, speed, np.inf)
            inside = (newton > low) & (newton < high)
            found = np.where(settled, found, np.where(inside, newton, 0.5 * (low + high)))
        return np.asarray(found)

    def sample(self, n: int, *, even: bool = False) -> Array:
        """Return n points from the first to the last of the curve, as [lin2021] samples it.

        Parameters
        ----------
        n : int
            Number of points, at least 2.
        even : bool
            False takes equal steps of the parameter, as published; True equal steps of length.

        Returns
        -------
        ndarray, shape (n, d)
            Points [m].

        Raises
        ------
        ValueError
            If n is below 2.
        """
        if n < 2:
            raise ValueError(f'expected 2 or more points, for both ends, but found n = {n}')
        if even:
            return self.point(self.parameter(np.linspace(0.0, self.length, n)))
        return self.point(np.linspace(*self.domain, n))

    @cached_property
    def _spline(self) -> 'PPoly[np.float64]':
        """The curve (w (P - origin), w) as one polynomial per knot span.

        That takes half the time of the basis functions.  The origin is the first point: far from
        it the quotient rule would cancel digits.
        """
        # Here, since many nodes read tool paths that have no such curve: they start sooner.
        from scipy.interpolate import BSpline, PPoly

        lifted = np.column_stack(
            [self.weight[:, np.newaxis] * (self.control - self._origin), self.weight]
        )
        spline = BSpline(self.knot, lifted, self.degree)
        edge = np.unique(self.knot[self.degree : len(self.control) + 1])
        orders = range(self.degree, -1, -1)
        return PPoly(np.stack([spline(edge[:-1], nu=k) / factorial(k) for k in orders]), edge)

    @cached_property
    def _size(self) -> float:
        """Largest extent of the control points [m]."""
        return float(np.ptp(self.control, axis=0).max())

    def _parameters(self, u: ArrayLike) -> Array:
        parameter = np.asarray(u, dtype=np.float64)
        first, last = self.domain
        # Extremes of an empty array do not exist; those of one with NaN are NaN and fail here.
        if parameter.size and not (parameter.min() >= first and parameter.max() <= last):
            outside = parameter[~((parameter >= first) & (parameter <= last))]
            raise ValueError(
                f'expected parameters from {first:g} to {last:g} but found {outside.flat[0]:g}; '
                'take them within the domain of the curve'
            )
        return parameter

    def _derivatives(self, parameter: Array, order: int) -> list[Array]:
        """Return C less the first control point and its derivatives, each of shape (d, ...).

        Coordinates come first, for the sake of fast inner loops.
        """
        lifted = [np.moveaxis(self._spline(parameter, nu=k), -1, 0) for k in range(order + 1)]
        found: list[Array] = []
        for k, part in enumerate(lifted):
            rest = part[:-1]
            for j in range(1, k + 1):
                rest = rest - comb(k, j) * lifted[j][-1] * found[k - j]
            found.append(np.asarray(rest / lifted[0][-1]))
        return found

    def _curvature_at_rest(self, parameter: Array) -> Array:
        """Return the limit of the curvature where the first derivative vanishes.

        The curve leaves such a point along its first derivative that does not vanish, and it is
        straight if all the others have this direction too.
        """
        span = self.domain[1] - self.domain[0]
        higher = self._derivatives(parameter, self.degree + 1)[2:]
        of_span = portable.whole_powers(span, self.degree + 1)
        direction = np.stack(
            [part.T * of_span[k] for k, part in enumerate(higher, 2)],
            axis=-2,
        )
        norm = np.sqrt(np.sum(direction * direction, axis=-1, keepdims=True))
        still = norm <= _STILL * self._size
        direction = np.where(still, 0.0, direction / np.where(still, 1.0, norm))
        singular = np.linalg.svd(direction, compute_uv=False)
        return np.where(singular[..., 1] > 1e-9 * singular[..., 0], np.inf, 0.0)

    def _speed(self, parameter: Array) -> Array:
        """Return the length of the first derivative [m], shape (...)."""
        first = self._derivatives(parameter, 1)[1]
        return np.asarray(np.sqrt(np.sum(first * first, axis=0)))

    def _integral(self, low: Array, high: Array) -> Array:
        """Return the length between parameters [m] by one Gauss rule each."""
        half = 0.5 * (high - low)
        node = (0.5 * (high + low))[..., np.newaxis] + half[..., np.newaxis] * _NODE
        return np.asarray(
            half * (portable.matmul(self._speed(np.clip(node, *self.domain)), _WEIGHT))
        )

    @cached_property
    def _pieces(self) -> tuple[Array, Array]:
        """Edges of pieces on each of which one Gauss rule is exact, and the length up to them."""
        edge = self._spline.x
        low, high = edge[:-1], edge[1:]
        whole = self._integral(low, high)
        tolerance = _LENGTH_TOLERANCE * whole.sum()
        edges, lengths = [], []
        for last in range(_HALVINGS_MAX, -1, -1):
            middle = 0.5 * (low + high)
            left, right = self._integral(low, middle), self._integral(middle, high)
            settled = (np.abs(left + right - whole) <= tolerance) | (last == 0)
            edges.append(low[settled])
            lengths.append((left + right)[settled])
            if settled.all():
                break
            rest = ~settled
            low, high = (
                np.concatenate([low[rest], middle[rest]]),
                np.concatenate([middle[rest], high[rest]]),
            )
            whole = np.concatenate([left[rest], right[rest]])
        begin, length = np.concatenate(edges), np.concatenate(lengths)
        order = np.argsort(begin, kind='stable')
        total = np.concatenate([[0.0], np.cumsum(length[order])])
        return np.append(begin[order], edge[-1]), total


def _points_last(array: Array) -> Array:
    """Return an array of shape (d, ...) as (..., d)."""
    return np.ascontiguousarray(np.moveaxis(array, 0, -1))
