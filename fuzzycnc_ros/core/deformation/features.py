# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Process values of a primitive, and what the network is fed with in their place.

Rows x of process values: direction [deg], feed depth [mm],
type (1 arc, 2 line), stitch step [mm], thickness [mm].  Compensations s are in mm of offset per
50 mm of feed, X then Y.

The opposite direction has the negative compensation, so directions are folded into half a turn,
here and nowhere else.
"""

from collections.abc import Callable, Sequence
from math import radians
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array, check_matrix

PROCESS_VALUES = ('direction', 'depth', 'kind', 'step', 'thickness')
"""Columns of x."""

DEPTH_RATIO_MAX = 0.8
"""Largest depth over thickness [-]; beyond it the foot goes through the sheet."""

HALF_TURN = 180.0
"""Directions that differ by it have opposite compensations [deg]."""

FOLD_FROM = -30.0
"""Directions of paths are folded into the half turn from here on [deg]."""

COVERED_GAP = 30.0
"""Widest gap between directions of samples that always counts as covered [deg]."""

LAPPED = 45.0
"""Part of the half turn that is repeated beyond either end for the training [deg].

Without it, models of samples in all directions jump by 0.4 to 0.6 mm per 50 mm where the half turn
begins; with it by 0.05 to 0.24 (150 samples, data seeds 0 to 2 and a sheet of another kind).
"""

TURN_IN_RADIANS = 6.2832
"""Largest direction that can be meant in radians."""
FOLLOWED_BETTER = 0.02
"""Share of the compensations by which they follow directions better that are radians [-].

Chosen on data seeds 0 to 3 of the simulated sheet: there it is -0.29 or less for 20 to 150 honest
samples within 6 deg, and 0.03 to 0.15 for samples of all directions that were given in radians.
"""


Quantity = TypeVar('Quantity', float, Array)


class FeatureSet(NamedTuple):
    """Inputs of a network, computed from process values.

    Parameters
    ----------
    names : tuple of str
        Inputs by columns.
    rows : callable
        Process values (k, 5) to inputs (k, n).
    one : callable
        The same for one row, by plain arithmetic: arrays of six numbers cost ten times as much.
    loaded : bool
        Whether the network's output is the compensation per `load`.
    """

    names: tuple[str, ...]
    rows: Callable[[Array], Array]
    one: Callable[[Sequence[float]], Sequence[float]]
    loaded: bool


def load(depth: Quantity, step: Quantity, thickness: Quantity) -> Quantity:
    """Return depth / (h (h - depth) step) in 1/mm^2, to which drift per feed is about equal.

    The foot's force goes as depth over the thickness that remains and the compliance as 1/h;
    each stitch locks its share of the drag, so that twice as many stitches drift twice as far.
    """
    return depth / (thickness * (thickness - depth) * step)


def _physical(x: Array) -> Array:
    sine, cosine = portable.sin_cos(np.radians(x[:, 0]))
    depth, kind, step, thickness = x[:, 1], x[:, 2], x[:, 3], x[:, 4]
    return np.column_stack([cosine, sine, depth / thickness, 1.0 / thickness, kind, 1.0 / step])


def _physical_one(x: Sequence[float]) -> Sequence[float]:
    turn = radians(x[0])
    return portable.cos(turn), portable.sin(turn), x[1] / x[4], 1.0 / x[4], x[2], 1.0 / x[3]


def _logarithmic(x: Array) -> Array:
    inputs = _physical(x)
    inputs[:, 3], inputs[:, 5] = portable.log(x[:, 4]), portable.log(x[:, 3])
    return inputs


def _logarithmic_one(x: Sequence[float]) -> Sequence[float]:
    turn = radians(x[0])
    return (
        portable.cos(turn),
        portable.sin(turn),
        x[1] / x[4],
        portable.log(x[4]),
        x[2],
        portable.log(x[3]),
    )


def _directions(x: Array) -> Array:
    inputs = _logarithmic(x)
    values = np.column_stack([np.ones(len(x)), inputs[:, 2:]])
    return np.concatenate([inputs[:, :1] * values, inputs[:, 1:2] * values], axis=1)


def _directions_one(x: Sequence[float]) -> Sequence[float]:
    along, across, *others = _logarithmic_one(x)
    values = (1.0, *others)
    return [*(along * value for value in values), *(across * value for value in values)]


FEATURE_SETS = {
    'load': FeatureSet(
        ('cos', 'sin', 'depth_ratio', 'log_thickness', 'kind', 'log_step'),
        _logarithmic,
        _logarithmic_one,
        True,
    ),
    'directions': FeatureSet(
        tuple(
            f'{turn}{value}'
            for turn in ('cos', 'sin')
            for value in ('', '_depth_ratio', '_log_thickness', '_kind', '_log_step')
        ),
        _directions,
        _directions_one,
        True,
    ),
    'physical': FeatureSet(
        ('cos', 'sin', 'depth_ratio', 'inverse_thickness', 'kind', 'inverse_step'),
        _physical,
        _physical_one,
        False,
    ),
    'thickness': FeatureSet(PROCESS_VALUES, lambda x: x, lambda x: x, False),
    'paper': FeatureSet(PROCESS_VALUES[:4], lambda x: x[:, :4], lambda x: x[:4], False),
}
"""Feature sets: 'paper' has the four published inputs, 'thickness' adds the thickness.

'directions' are products of the direction and the values of 'load', of which opposite primitives
have the negatives.
"""


def feature_set(name: str) -> FeatureSet:
    """Return a feature set by its name.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if name not in FEATURE_SETS:
        raise ValueError(
            f'features: expected one of {", ".join(FEATURE_SETS)}, but found {name!r}'
        )
    return FEATURE_SETS[name]


def check_process_values(x: ArrayLike) -> Array:
    """Return rows of process values as a matrix.

    Parameters
    ----------
    x : array_like, shape (k, 5)
        Process values, see the module's docstring for the units.

    Raises
    ------
    ValueError
        If it has another shape or holds a value that no primitive can have; the message names
        the first such row.
    """
    rows = check_matrix(x, 'x')
    if rows.shape[1] != len(PROCESS_VALUES):
        raise ValueError(
            f'x: expected {len(PROCESS_VALUES)} columns ({", ".join(PROCESS_VALUES)}), '
            f'but found {rows.shape[1]}'
        )
    _, depth, kind, step, thickness = rows.T
    _refuse('thickness', thickness <= 0.0, thickness, 'more than 0 mm')
    _refuse('depth', depth <= 0.0, depth, 'more than 0 mm')
    _refuse('step', step <= 0.0, step, 'more than 0 mm')
    _refuse('kind', (kind != 1.0) & (kind != 2.0), kind, '1 (arc) or 2 (line)')
    ratio = depth / thickness
    _refuse(
        'depth / thickness',
        ratio > DEPTH_RATIO_MAX,
        ratio,
        f'at most {DEPTH_RATIO_MAX:g} (the foot goes through the sheet)',
    )
    return rows


def half_turns(direction: Array, begin: float) -> Array:
    """Return how many half turns directions [deg] lie beyond the one that begins at `begin`."""
    return np.asarray(np.floor((direction - begin) / HALF_TURN))


def opposite_sign(turns: Array) -> Array:
    """Return -1 for odd numbers of half turns, whose compensations are the negative, else 1."""
    return np.where(turns % 2.0, -1.0, 1.0)


def folded(x: Array, begin: float = FOLD_FROM) -> tuple[Array, Array]:
    """Return process values with their directions in the half turn from `begin` on, and signs.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    begin : float
        Where the half turn begins [deg].

    Returns
    -------
    rows : ndarray, shape (k, 5)
        The same primitives or their opposites.
    sign : ndarray, shape (k,)
        -1 for opposites, whose compensations are the negative.

    Examples
    --------
    >>> rows, sign = folded(np.array([[190.0, 6.0, 2.0, 3.0, 15.0]]))
    >>> rows[0, 0].item(), sign.tolist()
    (10.0, [-1.0])
    """
    turns = half_turns(x[:, 0], begin)
    rows = x.copy()
    rows[:, 0] -= HALF_TURN * turns
    return rows, opposite_sign(turns)


def folded_samples(x: Array, s: Array) -> tuple[Array, Array]:
    """Return samples with their directions in one half turn, which ends in their widest gap.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values of any direction.
    s : ndarray, shape (k, r)
        Their compensations.
    """
    rows, sign = folded(x)
    low, _ = direction_range(rows[:, 0])
    rows, again = folded(rows, low - _ROUNDING)
    return rows, s * (sign * again)[:, np.newaxis]


def direction_range(direction: Array) -> tuple[float, float]:
    """Return the least and largest direction of samples, at most half a turn apart [deg].

    Parameters
    ----------
    direction : ndarray, shape (k,)
        Directions [deg].

    Returns
    -------
    low, high : float
        All directions from `FOLD_FROM` on where no gap stands out: none is wider than
        `COVERED_GAP`, or than another one.
    """
    ordered = np.sort(direction - HALF_TURN * half_turns(direction, FOLD_FROM))
    gaps = np.diff(ordered, append=ordered[0] + HALF_TURN)
    widest = int(gaps.argmax())
    others = np.delete(gaps, widest).max(initial=0.0)
    if gaps[widest] <= max(COVERED_GAP, others) + _ROUNDING:
        return FOLD_FROM, FOLD_FROM + HALF_TURN
    low = float(ordered[(widest + 1) % len(ordered)])
    return low, low + HALF_TURN - float(gaps[widest])


def lapped(x: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Return which samples a training takes, so that both ends of the half turn agree.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values of `folded_samples`.

    Returns
    -------
    taken : ndarray of int, shape (m,)
        The samples, then again those near an end if all directions are covered.
    rows : ndarray, shape (m, 5)
        Their process values; those of the repeated ones lie beyond the other end.
    sign : ndarray, shape (m,)
        -1 for the repeated ones, else 1.
    """
    low, high = direction_range(x[:, 0])
    every = np.arange(len(x))
    if high - low < HALF_TURN:
        return every, x, np.ones(len(x))
    first = np.flatnonzero(x[:, 0] < low + LAPPED)
    last = np.flatnonzero(x[:, 0] >= high - LAPPED)
    taken = np.concatenate([every, first, last])
    moved = np.repeat([0.0, HALF_TURN, -HALF_TURN], [len(every), len(first), len(last)])
    rows = x[taken]
    rows[:, 0] += moved
    return taken, rows, np.where(moved == 0.0, 1.0, -1.0)


_ROUNDING = 1e-6  # of directions [deg]


def direction_doubts(x: Array, s: Array) -> tuple[str, ...]:
    """Return what is strange about the directions of samples, though it can be."""
    if not looks_like_radians(x, s):
        return ()
    return (
        'the compensations follow the directions as radians; they are taken as degrees: '
        'multiply them by 57.29578 if they are radians',
    )


def looks_like_radians(x: Array, s: Array) -> bool:
    """Return whether the directions of process values look like radians.

    A foot drags the sheet along its way, so the directions of the compensations follow those of
    the tool.  What follows them better as radians than as degrees is suspected.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    s : ndarray, shape (k, r)
        Compensations that were needed.
    """
    direction = x[:, 0]
    if np.abs(direction).max() > TURN_IN_RADIANS or s.shape[1] != 2:
        return False
    size = np.hypot(*s.T)
    as_radians, as_degrees = (
        float(np.hypot(*_turned_back(s, angle).sum(axis=0)))
        for angle in (direction, np.radians(direction))
    )
    return bool(as_radians - as_degrees > FOLLOWED_BETTER * size.sum())


def _turned_back(s: Array, angle: Array) -> Array:
    """Return vectors, shape (k, 2), turned back by angles [rad]."""
    sine, cosine = portable.sin_cos(angle)
    return np.stack([cosine * s[:, 0] + sine * s[:, 1], cosine * s[:, 1] - sine * s[:, 0]], axis=1)


def _refuse(name: str, wrong: Array, values: Array, expected: str) -> None:
    if np.any(wrong):
        at = int(np.argmax(wrong))
        raise ValueError(f'x, row {at}: expected {name} {expected}, but found {values[at]:g}')
