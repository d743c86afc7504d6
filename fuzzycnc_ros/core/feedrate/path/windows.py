# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Largest value in a window along a path [lin2021].

A window is given in points, as published, or in arc length, which does not depend on how densely
a path is sampled; it looks ahead, behind or both ways, and goes on over the seam of a closed path.
"""

import math
import operator

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d

from fuzzycnc_ros.core.arrays import Array

_Index = NDArray[np.intp]

# Points a block, so that its maxima over powers of two stay in the cache.
_BLOCK = 8192


def window_maximum(
    value: ArrayLike, ahead: int, behind: int = 0, *, closed: bool = False
) -> Array:
    """Return the largest value from `behind` points before each point to `ahead` after it.

    Parameters
    ----------
    value : array_like, shape (n,)
        Values at the points, n >= 1.
    ahead, behind : int
        Points to look at after and before each, 0 or more; the published window of 30 points is
        29 ahead, for it counts the point itself.
    closed : bool
        Whether the window goes on from the last point to the first; if not, it ends there.

    Returns
    -------
    ndarray, shape (n,)
        Largest values, in the unit of `value`.

    Raises
    ------
    ValueError
        If `value` is not of that shape or holds NaN, or a count is negative or no integer.

    Examples
    --------
    >>> window_maximum([3.0, 0.0, 1.0, 2.0, 0.0], ahead=1).tolist()
    [3.0, 1.0, 2.0, 2.0, 0.0]
    >>> window_maximum([3.0, 0.0, 1.0, 2.0, 0.0], ahead=1, closed=True).tolist()
    [3.0, 1.0, 2.0, 2.0, 3.0]
    """
    array = _checked(value)
    count = len(array)
    # More than all points either way changes nothing, and the filter would pad for it.
    ahead, behind = (min(_count(*item), count) for item in (('ahead', ahead), ('behind', behind)))
    size = ahead + behind + 1
    return np.asarray(
        maximum_filter1d(
            array,
            size,
            mode='wrap' if closed else 'constant',
            cval=-math.inf,
            origin=behind - size // 2,
        )
    )


def arc_window_maximum(
    value: ArrayLike,
    arc_length: ArrayLike,
    ahead: float,
    behind: float = 0.0,
    *,
    period: float | None = None,
) -> Array:
    """Return the largest value from an arc length before each point to one after it.

    Parameters
    ----------
    value : array_like, shape (n,)
        Values at the points, n >= 1.
    arc_length : array_like, shape (n,)
        Arc length of the points [m], never falling.
    ahead, behind : float
        Lengths to look at after and before each point [m], 0 or more; a point at the very edge
        counts.
    period : float, optional
        Length of a closed path [m], on which the window goes on over the seam; by default the
        path is open and the window ends with it.

    Returns
    -------
    ndarray, shape (n,)
        Largest values, in the unit of `value`.

    Raises
    ------
    ValueError
        If an array is not of that shape, `value` holds NaN, `arc_length` falls or is not finite,
        a length is negative or not a number, or `period` is shorter than the path.

    Examples
    --------
    >>> arc_window_maximum([3.0, 0.0, 1.0, 2.0], [0.0, 0.1, 0.3, 0.4], ahead=0.2).tolist()
    [3.0, 1.0, 2.0, 2.0]
    """
    array = _checked(value)
    arc = np.asarray(arc_length, dtype=np.float64)
    if arc.shape != array.shape:
        raise ValueError(f'expected arc_length of shape {array.shape} but found {arc.shape}')
    if not (np.isfinite(arc).all() and np.all(np.diff(arc) >= 0.0)):
        raise ValueError('expected arc_length to be finite and never to fall but found it does')
    for name, length in (('ahead', ahead), ('behind', behind)):
        if not length >= 0.0:
            raise ValueError(f'expected {name} of 0 m or more but found {length!r}')
    # So that rounding of the arc length does not decide about a point at the edge.
    ahead, behind = ahead * (1.0 + 1e-9), behind * (1.0 + 1e-9)
    if period is None:
        return _maximum_within(array, arc, arc, ahead, behind)
    if not (math.isfinite(period) and period >= arc[-1] - arc[0]):
        raise ValueError(
            f'expected a period of at least the length of the path, {arc[-1] - arc[0]:g} m, '
            f'but found {period!r}'
        )
    earlier, later = arc - period, arc + period
    begin = int(np.searchsorted(earlier, arc[0] - behind, side='left'))
    end = int(np.searchsorted(later, arc[-1] + ahead, side='right'))
    return _maximum_within(
        np.concatenate([array[begin:], array, array[:end]]),
        np.concatenate([earlier[begin:], arc, later[:end]]),
        arc,
        ahead,
        behind,
    )


def _checked(value: ArrayLike) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim != 1 or not array.size:
        raise ValueError(f'expected values of shape (n,), n >= 1, but found shape {array.shape}')
    if np.isnan(array).any():
        raise ValueError(f'expected numbers but found NaN at index {np.isnan(array).argmax()}')
    return array


def _count(name: str, value: int) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if number < 0:
        raise ValueError(f'expected {name} as an integer of 0 or more but found {value!r}')
    return number


def _maximum_within(value: Array, around: Array, arc: Array, ahead: float, behind: float) -> Array:
    """Return the largest of the values at `around` within reach of each place of `arc`.

    Block by block; one is at least as long as the windows, lest long ones be read over and over.
    """
    found = np.empty(len(arc))
    begin, size = 0, _BLOCK
    while begin < len(arc):
        low, high = arc[begin : begin + size] - behind, arc[begin : begin + size] + ahead
        near = slice(
            np.searchsorted(around, low[0], side='left'),
            np.searchsorted(around, high[-1], side='right'),
        )
        first = np.searchsorted(around[near], low, side='left')
        last = np.searchsorted(around[near], high, side='right')
        found[begin : begin + size] = _of_powers(value[near], first, last)
        begin += size
        size = max(_BLOCK, int((last - first).max()))
    return found


def _of_powers(array: Array, first: _Index, last: _Index) -> Array:
    """Return max(array[first:last]) of each range from maxima over powers of two of points."""
    # Two windows of the largest power of two that fits cover each range.
    level = np.frexp((last - first).astype(np.float64))[1] - 1
    found = np.empty(len(first))
    longest = array
    for power in range(int(level.max()) + 1):
        if power:
            half = 1 << (power - 1)
            longest = np.maximum(longest[:-half], longest[half:])
        at = np.flatnonzero(level == power)
        found[at] = np.maximum(longest[first[at]], longest[last[at] - (1 << power)])
    return found
