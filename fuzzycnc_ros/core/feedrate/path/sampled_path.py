# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Sampled path for schedulers: arc length, curvature and reversals.

The curvature of samples is that of their circle, in any dimension, with rules for duplicate
points, corners and reversals, closed paths and rounded coordinates.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.windows import arc_window_maximum

CORNER_ANGLE = math.radians(60.0)
"""Turn [rad] from which three points no longer show a smooth curve."""

_Index = NDArray[np.intp]
_Rule = Callable[[Array, Array, Array], Array]  # of the steps before and after and their bend
_OfPath = Callable[[Array], tuple[Array, float]]  # values and the shortest step

# Steps below this many units in the last place of the largest coordinate are rounding.
_ROUNDING_STEPS = 4.0 * float(np.finfo(np.float64).eps)

# Points a block: its arrays stay in the cache, which halves the time of a long path.
_CURVATURE_BLOCK = 8192

_CORNER_BEND = 4.0 * portable.sin(0.5 * CORNER_ANGLE) * portable.sin(0.5 * CORNER_ANGLE)
_FOLDED = 1e-6  # of the stencil: chords so short have no direction


def curvature(
    points: ArrayLike,
    *,
    closed: bool = False,
    rounding: float = 0.0,
    stencil: float | None = None,
) -> Array:
    """Return the curvature at the points of a path through three points each, [lin2021] eq. (9).

    A parabola goes through each point and its neighbours; where the path turns by more than
    `CORNER_ANGLE` the curvature is at least that of an arc of this turn and length, because the
    parabola of a reversal is straight.

    Parameters
    ----------
    points : array_like, shape (n, d)
        Points in order [m], n >= 2, any dimension d >= 1.  A point on top of the one before it
        (nearer than `rounding`, or than the doubles can tell) shares its value.
    closed : bool
        Whether the path goes on from the last point to the first, which may be repeated at the
        end.  If not, the ends take the values of their neighbours.
    rounding : float
        Largest error of a coordinate [m], half of the last decimal of a part program; 0 for
        coordinates with all their digits.
    stencil : float, optional
        Least arc length [m] from the middle to the outer points of a parabola; those nearer are
        replaced by points of the polyline at this distance.  A sharp corner inside it is not
        lost: the result is never below that of the turn that `rounding` cannot explain.  By
        default 0 if `rounding` is 0 and else `arc_stencil(rounding)`.

    Returns
    -------
    ndarray, shape (n,)
        Curvature [1/m], unsigned and finite; 0 for a path of two distinct points.

    Raises
    ------
    ValueError
        If `points` is not of that shape, holds a value that is not finite or fewer than two
        distinct points, or `rounding` or `stencil` is negative.

    Examples
    --------
    >>> angle = np.linspace(0.0, 1.0, 101)
    >>> arc = 0.02 * np.column_stack([np.cos(angle), np.sin(angle)])
    >>> round(float(curvature(arc)[50]), 2)
    50.0

    Back on the same line, with legs of 2 and 1 mm: as sharp as an arc of half a turn.

    >>> curvature([[0.0, 0.0], [0.002, 0.0], [0.001, 0.0]]).round(3)
    array([2094.395, 2094.395, 2094.395])
    """
    _check_rounding(rounding)
    if stencil is None:
        stencil = arc_stencil(rounding) if rounding > 0.0 else 0.0
    if not (math.isfinite(stencil) and stencil >= 0.0):
        raise ValueError(f'expected a stencil of 0 m or more but found {stencil!r}')
    array = _checked(points)

    def of_distinct(path: Array) -> tuple[Array, float]:
        ring = _ring(path) if closed else path
        inner, shortest = _along(ring, _three_points)
        if stencil > 0.0 and shortest > 0.0:
            certain, _ = _along(ring, _certain_turn(rounding * math.sqrt(path.shape[1])))
            inner = np.maximum(_stencil_curvature(path, closed, stencil), certain)
        return (inner if closed else _with_ends(inner)), shortest

    return _shared(array, closed, rounding, of_distinct)


def turning_angle(points: ArrayLike, *, closed: bool = False) -> Array:
    """Return the angle by which a path turns at each point.

    Parameters
    ----------
    points : array_like, shape (n, d)
        Points in order [m], n >= 2; one on top of the one before it shares its angle.
    closed : bool
        Whether the path goes on from the last point to the first.

    Returns
    -------
    ndarray, shape (n,)
        Angles [rad], 0 straight on, pi at a reversal; 0 at the ends of an open path.

    Raises
    ------
    ValueError
        As `curvature`.
    """

    def of_distinct(path: Array) -> tuple[Array, float]:
        inner, shortest = _along(_ring(path) if closed else path, _turn_alone)
        return (inner if closed else np.pad(inner, 1)), shortest

    return _shared(_checked(points), closed, 0.0, of_distinct)


def arc_stencil(rounding: float, error: float = 20.0) -> float:
    """Return the stencil that keeps the effect of rounding on curvature small.

    A point that is off by r bends a parabola of half-length h by up to 4 r / h**2.

    Parameters
    ----------
    rounding : float
        Largest error of a coordinate [m], 0 or more.
    error : float
        Error of the curvature to put up with [1/m], positive.

    Returns
    -------
    float
        Half-length [m] for `curvature`.

    Raises
    ------
    ValueError
        If `rounding` is negative or `error` not positive.

    Examples
    --------
    Three decimals of a millimetre:

    >>> round(arc_stencil(0.5e-6), 6)
    0.000316
    """
    _check_rounding(rounding)
    if not (math.isfinite(error) and error > 0.0):
        raise ValueError(f'expected a positive error of curvature but found {error!r}')
    return math.sqrt(4.0 * rounding / error)


def arc_length(points: ArrayLike) -> Array:
    """Return the length of a polyline from its first point to each.

    Parameters
    ----------
    points : array_like, shape (n, d)
        Points in order [m], n >= 2.

    Returns
    -------
    ndarray, shape (n,)
        Arc length [m], from 0.

    Raises
    ------
    ValueError
        If `points` is not of that shape or holds a value that is not finite.

    Examples
    --------
    >>> arc_length([[0.0, 0.0], [3.0, 4.0], [3.0, 4.0], [3.0, 0.0]]).tolist()
    [0.0, 5.0, 5.0, 9.0]
    """
    step = np.diff(_checked(points), axis=0)
    return np.concatenate([[0.0], np.cumsum(np.sqrt(np.einsum('ij,ij->i', step, step)))])


def _check_rounding(rounding: float) -> None:
    if not (math.isfinite(rounding) and rounding >= 0.0):
        raise ValueError(f'expected a rounding of 0 m or more but found {rounding!r}')


def _checked(points: ArrayLike) -> Array:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or len(array) < 2 or array.shape[1] < 1:
        raise ValueError(f'expected 2 or more points, shape (n, d), but found {array.shape}')
    if not np.isfinite(array).all():
        index = int(np.argmin(np.isfinite(array).all(axis=1)))
        raise ValueError(
            f'expected finite coordinates but found {array[index].tolist()} at point {index}; '
            'a path with a gap is not bridged: cut it there'
        )
    return array


def _shared(points: Array, closed: bool, rounding: float, of_distinct: _OfPath) -> Array:
    """Return a value of each point, the same for points in one place.

    Most paths have none such, which shows in the shortest step; others are done again.
    """
    resolution = max(rounding, _ROUNDING_STEPS * float(np.abs(points).max()))
    value, shortest = of_distinct(points)
    if shortest > resolution:
        return value
    kept, of_point = _distinct(points, resolution, closed)
    if len(kept) < 2:
        raise ValueError('expected at least 2 distinct points but found all in one place')
    return np.asarray(of_distinct(points[kept])[0][of_point])


def _distinct(points: Array, resolution: float, closed: bool) -> tuple[_Index, _Index]:
    """Return which points are not on top of the kept one before, and for each point its own."""
    # Equal ones, the usual case, all at once; near ones need a look at which was kept before.
    moved = np.append(True, np.any(points[1:] != points[:-1], axis=1))
    path = points[moved]
    step = np.diff(path, axis=0)
    kept = np.ones(len(path), dtype=np.bool_)
    done = 0
    for k in np.flatnonzero(np.sum(step * step, axis=1) <= resolution * resolution).tolist():
        if k < done:
            continue
        done = k + 1
        while done < len(path) and math.dist(path[done], path[k]) <= resolution:
            kept[done] = False
            done += 1
    index = np.flatnonzero(moved)[kept]
    of_point = (np.cumsum(kept) - 1)[np.cumsum(moved) - 1]
    if closed:
        while len(index) > 1 and math.dist(points[index[-1]], points[0]) <= resolution:
            index = index[:-1]
        of_point[of_point >= len(index)] = 0
    return index, of_point


def _ring(points: Array) -> Array:
    """Return a closed path with its last point also before and its first also after it."""
    return np.concatenate([points[-1:], points, points[:1]])


def _with_ends(inner: Array) -> Array:
    """Return values of inner points with those of the ends, which copy their neighbours."""
    return np.pad(inner, 1, mode='edge') if len(inner) else np.zeros(2)


def _along(points: Array, rule: _Rule) -> tuple[Array, float]:
    """Return a rule's value at each inner point, NaN at duplicates, and the shortest step [m]."""
    value = np.empty(len(points) - 2)
    shortest = math.inf
    for begin in range(0, len(points) - 1, _CURVATURE_BLOCK):
        block = np.ascontiguousarray(points[begin : begin + _CURVATURE_BLOCK + 2].T)
        length, bend = _legs(block)
        value[begin : begin + _CURVATURE_BLOCK] = rule(length[:-1], length[1:], bend)
        shortest = min(shortest, float(length.min()))
    return value, shortest


def _legs(block: Array) -> tuple[Array, Array]:
    """Return lengths of the steps, (m - 1,), and the bends between them, |f_b - f_a|^2, (m - 2,).

    The bend is 4 sin(turn / 2)^2.  In it all formulas below hold in any dimension, and the
    difference of two almost equal directions keeps the digits that their products would lose.
    """
    step = block[:, 1:] - block[:, :-1]
    length = np.sqrt(np.einsum('ij,ij->j', step, step))
    with np.errstate(divide='ignore', invalid='ignore'):
        step /= length
    bend = step[:, 1:] - step[:, :-1]
    return length, np.minimum(np.einsum('ij,ij->j', bend, bend), 4.0)


def _three_points(before: Array, after: Array, bend: Array) -> Array:
    """Return the curvature of the parabola, [lin2021] eq. (9), at corners at least that of an arc.

    With a3 = (f_b - f_a) / t and t = t_a + t_b: |a2|^2 = 1 - t_a t_b |f_b - f_a|^2 / t^2, and
    |a2 x a3| = |f_a x f_b| / t, where |f_a x f_b| is the sine of the turn.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        total = before + after
        slope = 1.0 - before * after * bend / (total * total)
        sine = np.sqrt(bend * (1.0 - 0.25 * bend))
        value = 2.0 * sine / (total * slope * np.sqrt(slope))
    corner = np.flatnonzero(bend > _CORNER_BEND)
    if corner.size:
        parabola = np.where(slope[corner] > 0.0, value[corner], 0.0)
        value[corner] = np.maximum(parabola, 2.0 * _angle(bend[corner]) / total[corner])
    return np.asarray(value)


def _angle(bend: Array) -> Array:
    return np.asarray(2.0 * portable.arcsin(0.5 * np.sqrt(bend)))


def _turn_alone(before: Array, after: Array, bend: Array) -> Array:
    return _angle(bend)


def _certain_turn(error: float) -> _Rule:
    """Return the rule of the curvature that points, each off by no more than `error`, prove."""

    def rule(before: Array, after: Array, bend: Array) -> Array:
        with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
            explained = 2.0 * error / before + 2.0 * error / after
            return 2.0 * np.maximum(_angle(bend) - explained, 0.0) / (before + after)

    return rule


def _stencil_curvature(path: Array, closed: bool, stencil: float) -> Array:
    """Return the curvature at inner points from points of the polyline at least a stencil away.

    Near the ends of an open path the whole stencil is moved inside.
    """
    polyline = np.concatenate([path, path[:1]]) if closed else path
    arc = arc_length(polyline)
    total = float(arc[-1])
    if closed:
        half, middle = min(stencil, 0.25 * total), arc[:-1]
        before, after = np.append(arc[-2] - total, arc[:-2]), arc[1:]
    else:
        half = min(stencil, 0.5 * total)
        middle = np.clip(arc[1:-1], half, total - half)
        before, after = arc[:-2], arc[2:]
    before, after = np.minimum(before, middle - half), np.maximum(after, middle + half)
    place = np.stack([before, middle, after])
    if closed:
        place %= total
    step = np.diff([np.interp(place, arc, column) for column in polyline.T], axis=1)
    length = np.sqrt(np.sum(step * step, axis=0))
    # Back where it came from within the stencil, the path has no direction but has turned round.
    folded = length.min(axis=0) <= _FOLDED * half
    length = np.where(folded, [middle - before, after - middle], length)
    bend = np.sum(np.square(np.diff(step / length, axis=1)), axis=(0, 1))
    return _three_points(length[0], length[1], np.where(folded, 4.0, np.minimum(bend, 4.0)))


REVERSAL_ANGLE = math.radians(150.0)
"""Turn at one point [rad] from which a path counts as going back on itself."""

WINDOW_EDGE = 1.0 + 1e-6
"""Windows in arc length take in points at their very edge, which rounding may move: factor."""

_BLOCK = 4096


@dataclass(frozen=True, eq=False)
class SampledPath:
    """Curvature along a path at its distinct points.

    Parameters
    ----------
    arc_length : array_like, shape (m,)
        Arc length [m], finite, increasing, m >= 1.
    curvature : array_like, shape (m,)
        Magnitude of the curvature [1/m], finite, not negative.
    lap : float, optional
        Arc length at which a closed path is back at its first point [m], above that of the last
        point, which is another one.  Windows and averages then run across the start.
    reversal : array_like of bool, shape (m,), optional
        Where the path turns back; nowhere if absent.
    place : array_like of int, shape (n,), optional
        Place among the m points of each of the n points that the path was made of.
    programmed : array_like, shape (m,), optional
        Feed that is not exceeded in any case [m/s]: what the machine sees of a point depends on
        how fast it comes there.

    Raises
    ------
    ValueError
        If an argument is not as said.
    """

    arc_length: Array
    curvature: Array
    lap: float | None = None
    reversal: Any = None
    place: Any = None
    programmed: Any = None

    def __post_init__(self) -> None:
        arc_length = _vector('arc_length', self.arc_length)
        bend = _vector('curvature', self.curvature)
        if len(arc_length) == 0:
            raise ValueError('arc_length: expected one point or more, but found none')
        if len(bend) != len(arc_length):
            raise ValueError(
                f'curvature: expected {len(arc_length)} values, one for each arc length, '
                f'but found {len(bend)}'
            )
        _refuse(
            np.diff(arc_length, prepend=-np.inf) <= 0.0,
            arc_length,
            'arc_length: expected increasing arc lengths; leave out points on top of each other',
        )
        _refuse(bend < 0.0, bend, 'curvature: expected magnitudes; take the absolute value')
        if self.lap is not None and not arc_length[-1] < self.lap < math.inf:
            raise ValueError(
                f'lap: expected a length above that of the last point, {arc_length[-1]} m, '
                f'but found {self.lap}; leave out a last point that repeats the first'
            )
        reversal = np.zeros(len(bend), dtype=bool)
        if self.reversal is not None:
            reversal |= np.asarray(self.reversal, dtype=bool)
        if self.programmed is not None:
            programmed = np.asarray(self.programmed, dtype=np.float64)
            if programmed.shape != bend.shape or not (programmed > 0.0).all():
                raise ValueError(
                    f'programmed: expected {len(bend)} feeds above 0 m/s, but found shape '
                    f'{programmed.shape} or a feed that is not'
                )
            object.__setattr__(self, 'programmed', programmed)
        object.__setattr__(self, 'arc_length', arc_length)
        object.__setattr__(self, 'curvature', bend)
        object.__setattr__(self, 'reversal', reversal)

    @classmethod
    def from_points(
        cls, points: ArrayLike, *, closed: bool = False, rounding: float = 0.0
    ) -> 'SampledPath':
        """Return the curvature along a path given by points.

        Parameters
        ----------
        points : array_like, shape (n, d)
            Points in order [m], at least two distinct ones.
        closed : bool
            Whether the path goes on from the last point to the first, which may be repeated.
        rounding : float
            Largest error of a coordinate [m], 0 for coordinates with all their digits.

        Returns
        -------
        SampledPath
            The distinct points, with the place among them of each point given.

        Raises
        ------
        ValueError
            If the points are no path.

        Examples
        --------
        >>> path = SampledPath.from_points([[0.0, 0.0], [0.001, 0.0], [0.001, 0.0], [0.003, 0.0]])
        >>> path.arc_length.tolist(), path.place.tolist()
        ([0.0, 0.001, 0.003], [0, 1, 1, 2])
        """
        bend = curvature(points, closed=closed, rounding=rounding)
        path = np.asarray(points, dtype=np.float64)
        step = np.diff(path, axis=0)
        arc_length = np.zeros(len(path))
        np.cumsum(np.sqrt(np.einsum('ij,ij->i', step, step)), out=arc_length[1:])
        new = np.diff(arc_length, prepend=-1.0) > 0.0
        place = np.cumsum(new) - 1
        lap = None
        if closed:
            lap = float(arc_length[-1] + math.dist(path[0], path[-1]))
            if not arc_length[-1] < lap:
                # The last point is the first again, and so are those on top of it.
                last = place == place[-1]
                new &= ~last
                place[last] = 0
        reversal = None
        # The curvature of a corner is at least its turn over half the length of its sides.
        side = float(np.diff(arc_length).max()) if lap is None else lap
        if rounding > 0.0 or float(bend.max()) * side >= REVERSAL_ANGLE:
            reversal = turning_angle(points, closed=closed)[new] > REVERSAL_ANGLE
        return cls(arc_length[new], bend[new], lap, reversal, place)

    @property
    def closed(self) -> bool:
        """True if the path goes on from its last point to its first."""
        return self.lap is not None

    def largest_within(self, ahead: float, behind: float) -> Array:
        """Return the largest curvature from an arc length before each point to one after it.

        Parameters
        ----------
        ahead, behind : float
            Lengths to look at after and before each point [m], 0 or more.

        Returns
        -------
        ndarray, shape (m,)
            Largest curvatures [1/m].
        """
        if self.lap is not None:
            return arc_window_maximum(
                self.curvature, self.arc_length, ahead, behind, period=self.lap
            )
        # In blocks with what their windows reach: a third of the time, as searches stay short.
        largest = np.empty(len(self.curvature))
        starts = np.arange(0, len(largest), _BLOCK)
        ends = np.minimum(starts + _BLOCK, len(largest))
        lows = np.searchsorted(self.arc_length, self.arc_length[starts] - behind * WINDOW_EDGE)
        highs = np.searchsorted(self.arc_length, self.arc_length[ends - 1] + ahead * WINDOW_EDGE)
        for start, end, low, high in zip(starts, ends, lows, highs, strict=True):
            found = arc_window_maximum(
                self.curvature[low:high], self.arc_length[low:high], ahead, behind
            )
            largest[start:end] = found[start - low : end - low]
        return largest

    def at_points(self, values: Array) -> Array:
        """Return values at the distinct points for the points that the path was made of."""
        return values if self.place is None else np.asarray(values[self.place])


def _vector(name: str, values: ArrayLike) -> Array:
    """Return finite doubles in one row."""
    vector = np.asarray(values, dtype=np.float64)
    if vector.ndim != 1:
        raise ValueError(f'{name}: expected one row of numbers, but found shape {vector.shape}')
    _refuse(~np.isfinite(vector), vector, f'{name}: expected finite numbers')
    return vector


def _refuse(wrong: NDArray[np.bool_], values: Array, expected: str) -> None:
    """Refuse values, naming the first wrong one."""
    if wrong.any():
        at = int(wrong.argmax())
        raise ValueError(f'{expected}; found {values[at]} at point {at}')
