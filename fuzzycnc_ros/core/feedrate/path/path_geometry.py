# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reference path of a trajectory: quintic segments over arc length, exact stops at corners.

Points alone do not tell what happens between them, so limits checked at points are no guarantee.
Here every piece between two points is a polynomial, with position, tangent and curvature equal to
the neighbour's unless there is a corner, and the bounds of its derivatives hold for all of it:
those of a Bernstein polynomial lie within its coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import comb, perm
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array, dot_products, vector_lengths

SMOOTH_TURN = 1e-6
"""Turns above this are corners [rad]; rounding of doubles stays far below."""

_DEGREE = 5
_PROBES = 9
_PIECES = 64
_CHUNK = 8192
"""Segments whose probes are held at a time."""


@dataclass(frozen=True)
class PathGeometry:
    """Path of m segments in d axes.

    Attributes
    ----------
    coefficient : array, shape (m, 6, d)
        Bernstein coefficients of each segment over its own length [m].
    node : array, shape (m + 1,)
        Arc length at the ends of the segments, from 0 [m].
    stop : array of bool, shape (m + 1,)
        Inner nodes at which the tangent jumps, where only a stop keeps the path; False at both
        ends.
    """

    coefficient: Array
    node: Array
    stop: NDArray[np.bool_]

    @classmethod
    def from_samples(
        cls,
        points: ArrayLike,
        tangent: ArrayLike | None = None,
        curvature: ArrayLike | None = None,
        arc_length: ArrayLike | None = None,
    ) -> PathGeometry:
        """Return the smooth path through samples of a curve; it has no corners.

        Parameters
        ----------
        points : array, shape (n, 2) or (n, 3)
            Samples [m], no two neighbours equal.
        tangent : array, same shape, optional
            Directions of travel; their lengths do not matter.
        curvature : array, same shape, optional
            Curvature vectors, second derivatives with respect to arc length [1/m].  Without it,
            or without `tangent`, both are those of the cubic spline through the points over the
            lengths of their chords, a periodic one where the last point is the first.
        arc_length : array, shape (n,), optional
            Increasing [m]; by default that of the circle through neighbours.

        Raises
        ------
        ValueError
            If shapes differ, a value is not finite, points repeat, or arc length falls.

        Examples
        --------
        >>> turn = np.linspace(0.0, np.pi, 50)
        >>> arc = PathGeometry.from_samples(0.01 * np.stack([np.cos(turn), np.sin(turn)], axis=1))
        >>> f'{1e3 * arc.length:.3f} mm'
        '31.416 mm'
        """
        if tangent is None or curvature is None:
            tangent, curvature = _spline_shape(_checked(points, 'points'))
        point, along, bend = (
            _checked(values, name)
            for values, name in (
                (points, 'points'),
                (tangent, 'tangent'),
                (curvature, 'curvature'),
            )
        )
        if not point.shape == along.shape == bend.shape:
            raise ValueError(
                f'expected points, tangent and curvature of one shape, but found {point.shape}, '
                f'{along.shape} and {bend.shape}'
            )
        size = vector_lengths(along)[:, np.newaxis]
        chord = vector_lengths(np.diff(point, axis=0))
        if not (size > 0.0).all() or not (chord > 0.0).all():
            raise ValueError(
                'expected tangents that are not zero and neighbours that differ, but found '
                f'{int((size <= 0.0).sum())} zero tangents and '
                f'{int((chord <= 0.0).sum())} repeated points; drop repeated points first'
            )
        along = along / size
        if arc_length is None:
            half = 0.25 * chord * (vector_lengths(bend[:-1]) + vector_lengths(bend[1:]))
            half = np.minimum(half, 1.0)
            length = chord * portable.arcsin(half) / np.where(half > 1e-4, half, 1.0)
            length = np.where(half > 1e-4, length, chord * (1.0 + half * half / 6.0))
        else:
            length = np.diff(np.asarray(arc_length, dtype=float))
            if len(length) != len(chord) or not (length > 0.0).all():
                raise ValueError(
                    f'arc_length: expected {len(point)} increasing numbers [m], but found '
                    f'shape {np.shape(arc_length)} or a step that is not positive'
                )
        return cls(
            hermite(point, along, bend, length),
            np.append(0.0, np.cumsum(length)),
            np.zeros(len(point), bool),
        )

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.node[-1])

    @property
    def axes(self) -> int:
        """Number of axes d."""
        return int(self.coefficient.shape[2])

    def derivative(self, order: int) -> Array:
        """Return Bernstein coefficients of a derivative, shape (m, 6 - order, d)."""
        return self._derivative(self.coefficient, order)

    def end_derivatives(self) -> tuple[Array, Array]:
        """Return the first and second derivatives at both ends, each of shape (m, 2, d)."""
        ends = self.coefficient[:, [0, 1, 2]], self.coefficient[:, [-3, -2, -1]]
        first, last = (self._derivative(end, 1) for end in ends)
        bends = [self._derivative(end, 2) for end in ends]
        return np.stack([first[:, 0], last[:, 1]], axis=1), np.concatenate(bends, axis=1)

    def _derivative(self, coefficient: Array, order: int) -> Array:
        length = np.diff(self.node)[:, np.newaxis, np.newaxis]
        # Differences first: they are nearly exact, quotients are not.
        found = np.diff(coefficient, order, axis=1)
        width = portable.whole_powers(length, order)[..., order]
        return np.asarray(found * (perm(_DEGREE, order) / width))

    def evaluate(self, arc_length: ArrayLike, order: int = 0) -> Array:
        """Return the path, or a derivative, at arc lengths of shape (k,); shape (k, d)."""
        place = np.clip(np.asarray(arc_length, dtype=float), 0.0, self.node[-1])
        index = np.clip(np.searchsorted(self.node, place, 'right') - 1, 0, len(self.node) - 2)
        share = (place - self.node[index]) / np.diff(self.node)[index]
        weight = bernstein(_DEGREE - order, share)
        found = np.einsum('kb,kbd->kd', weight, self.derivative(order)[index])
        return np.asarray(found, dtype=float)

    def bounds(self) -> tuple[Array, Array, Array]:
        """Return bounds on the sizes of the first three derivatives, each of shape (m, d + 1).

        The first column is that of the path itself: of |p'| and its derivatives, which are 1, 0
        and 0 where the parameter is the true arc length.  These three are taken from probes with
        a tenth on top; those of the axes are strict.
        """
        found = np.empty((3, len(self.coefficient), self.axes + 1))
        wild = np.zeros(len(self.coefficient), bool)
        for begin in range(0, len(wild), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            found[:, part], wild[part] = self.part(begin, begin + _CHUNK)._bounds()
        # Where the parameter strays far from arc length, as around a cusp between two samples,
        # probes lie too far apart.
        strayed, length = np.flatnonzero(wild), np.diff(self.node)
        for begin in range(0, len(strayed), _CHUNK // _PIECES):
            few = strayed[begin : begin + _CHUNK // _PIECES]
            node = np.append(0.0, np.cumsum(length[few]))
            path = PathGeometry(self.coefficient[few], node, np.zeros(len(node), bool))
            closer, _ = path.split(np.full(len(few), _PIECES))._bounds()
            found[:, few] = closer.reshape(3, len(few), _PIECES, -1).max(axis=2)
        return found[0], found[1], found[2]

    def _bounds(self) -> tuple[Array, NDArray[np.bool_]]:
        """Return the bounds, shape (3, m, d + 1), and where |p'| varies too much for them."""
        derivatives = [self.derivative(order) for order in (1, 2, 3)]
        share = np.linspace(0.0, 1.0, _PROBES)
        one, two, three = (
            _probed(bernstein(_DEGREE - 1 - order, share), derivative)
            for order, derivative in enumerate(derivatives)
        )
        speed = np.maximum(vector_lengths(one), 1e-9)
        rise = dot_products(one, two) / speed
        bend = (dot_products(two, two) + dot_products(one, three) - rise * rise) / speed
        path = [
            vector_lengths(derivatives[0]).max(axis=1),
            1.1 * np.abs(rise).max(axis=0),
            1.1 * np.abs(bend).max(axis=0),
        ]
        found = [
            np.column_stack([along, np.abs(derivative).max(axis=1)])
            for along, derivative in zip(path, derivatives, strict=True)
        ]
        return np.stack(found), speed.max(axis=0) > 1.02 * speed.min(axis=0)

    def part(self, begin: int, end: int) -> PathGeometry:
        """Return the segments from `begin` up to, without, `end`; arc length starts anew."""
        node, stop = self.node[begin : end + 1], self.stop[begin : end + 1].copy()
        stop[[0, -1]] = False
        return PathGeometry(self.coefficient[begin:end], node - node[0], stop)

    def split(self, pieces: NDArray[np.int_]) -> PathGeometry:
        """Return the same path with segment k cut into `pieces[k]`, shorter towards its ends."""
        node = np.empty(int(pieces.sum()) + 1)
        node[-1] = self.node[-1]
        first = np.append(0, np.cumsum(pieces))
        found = np.empty((int(pieces.sum()), _DEGREE + 1, self.axes))
        for count in np.unique(pieces):
            chosen = np.flatnonzero(pieces == count)
            cut = 0.5 - 0.5 * portable.cos(np.pi * np.arange(count + 1) / count)
            place = first[chosen, np.newaxis] + np.arange(count)
            length = np.diff(self.node)[chosen, np.newaxis]
            node[place] = self.node[chosen, np.newaxis] + length * cut[:-1]
            for k in range(count):
                blend = _restriction(cut[k], cut[k + 1])
                found[place[:, k]] = np.einsum('ij,mjd->mid', blend, self.coefficient[chosen])
        stop = np.zeros(len(node), bool)
        stop[first] = self.stop
        return PathGeometry(found, node, stop)


def _probed(weight: Array, coefficient: Array) -> Array:
    """Return what weights (k, b) make of coefficients (m, b, d): values (k, m, d).

    In memory the long axis comes last: so all sums run along it.
    """
    column = np.ascontiguousarray(np.moveaxis(coefficient, 0, -1))
    found = weight[:, :1, np.newaxis] * column[0]
    for number in range(1, len(column)):
        found += weight[:, number, np.newaxis, np.newaxis] * column[number]
    return np.moveaxis(found, -1, 1)


def bernstein(degree: int, share: Array) -> Array:
    """Return the Bernstein polynomials at `share` (k,) in 0..1, shape (k, degree + 1)."""
    count = np.array([comb(degree, k) for k in range(degree + 1)])
    at = np.asarray(share)
    rest = portable.whole_powers(1.0 - at, degree)[:, ::-1]
    return np.asarray(count * portable.whole_powers(at, degree) * rest)


@lru_cache(maxsize=4096)
def _restriction(low: float, high: float) -> Array:
    """Matrix that takes a quintic's coefficients to those of its part from `low` to `high`."""
    found = np.zeros((_DEGREE + 1, _DEGREE + 1))
    for row in range(_DEGREE + 1):
        # Blossom: the part's coefficient k takes `high` k times and `low` the other times.
        left = bernstein(_DEGREE - row, np.array([low]))[0]
        right = bernstein(row, np.array([high]))[0]
        found[row] = portable.convolve(left, right)
    return found


def hermite(point: Array, tangent: Array, curvature: Array, length: Array) -> Array:
    """Return quintics through points with given tangents and curvature vectors.

    Parameters
    ----------
    point, tangent, curvature : array, shape (m + 1, d)
        Points [m], unit tangents and curvature vectors [1/m].
    length : array, shape (m,)
        Length of each piece [m].

    Returns
    -------
    array, shape (m, 6, d)
        Bernstein coefficients [m].
    """
    h = length[:, np.newaxis]
    first, last = point[:-1], point[1:]
    return np.stack(
        [
            first,
            first + h / 5.0 * tangent[:-1],
            first + 2.0 * h / 5.0 * tangent[:-1] + h * h / 20.0 * curvature[:-1],
            last - 2.0 * h / 5.0 * tangent[1:] + h * h / 20.0 * curvature[1:],
            last - h / 5.0 * tangent[1:],
            last,
        ],
        axis=1,
    )


def _checked(values: ArrayLike, name: str) -> Array:
    """Return finite values of shape (n, 2) or (n, 3), n at least 2, as a copy."""
    found = np.array(values, dtype=float)
    if found.ndim != 2 or len(found) < 2 or found.shape[1] not in (2, 3):
        raise ValueError(
            f'{name}: expected shape (n, 2) or (n, 3) with n at least 2, but found {found.shape}'
        )
    if not np.isfinite(found).all():
        row = int(np.flatnonzero(~np.isfinite(found).all(axis=1))[0])
        raise ValueError(f'{name}: expected finite numbers, but found {found[row]} in row {row}')
    return found


def _spline_shape(point: Array) -> tuple[Array, Array]:
    """Return directions and curvature vectors of the cubic spline through points, (n, d) each."""
    # Here, since programs of lines and arcs need no splines: they start half a second sooner.
    from scipy.interpolate import CubicSpline

    chord = vector_lengths(np.diff(point, axis=0))
    if not (chord > 0.0).all():
        raise ValueError(
            f'points: expected neighbours that differ, but found {int((chord <= 0.0).sum())} '
            'repeated points; drop repeated points first'
        )
    closed = len(point) > 3 and bool((point[0] == point[-1]).all())
    ends: Literal['periodic', 'not-a-knot', 'natural'] = (
        'periodic' if closed else 'not-a-knot' if len(point) > 3 else 'natural'
    )
    spline = CubicSpline(np.append(0.0, np.cumsum(chord)), point, bc_type=ends)
    first, second = spline(spline.x, 1), spline(spline.x, 2)
    size = vector_lengths(first)[:, np.newaxis]
    if not (size > 0.0).all():
        index = int(np.argmin(size))
        raise ValueError(
            f'points: expected a path that goes on but found it straight back on itself at point '
            f'{index}, {point[index].tolist()} m; end one path there and begin the next'
        )
    along = first / size
    across = second - (second * along).sum(axis=1, keepdims=True) * along
    return along, np.asarray(across / (size * size))


def turn_angles(before: Array, after: Array) -> Array:
    """Return angles between directions (m, d) [rad], exact also where they are small; (m,)."""
    a = before / vector_lengths(before)[:, np.newaxis]
    b = after / vector_lengths(after)[:, np.newaxis]
    return np.asarray(2.0 * portable.arctan2(vector_lengths(b - a), vector_lengths(b + a)))
