# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Limits shared out so that the average over a window in time of a motion keeps them.

An average of length tau of accelerations up to a changes by at most 2 a / tau per second.  It
also mixes places up to tau apart, so every limit is first replaced by the smallest within tau:
the average then obeys the limits of the place it leads to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry

_CHUNK = 8192
"""Pieces whose bounds are held at a time."""
AVERAGE_EDGE = 1.0 + 1e-9
"""Pieces at the very edge of a window count, which rounding may move: factor."""


@dataclass(frozen=True)
class Shares:
    """Largest squared speed, acceleration and jerk along the path in each piece, each (m,)."""

    cap: Array
    rise: Array
    jolt: Array


def share_limits(geometry: PathGeometry, square: Array, table: Array) -> Shares:
    """Share the limits out so that all parts of an axis' acceleration and jerk fit at once.

    Of an acceleration, 0.7 may go to the curve, the rest to the change of speed.  Of a jerk, half
    may go to the change of the curve, then 0.3 of the rest to the curve while the speed changes.
    What a part leaves unused goes to the next.

    Parameters
    ----------
    geometry : PathGeometry
        Path of m pieces.
    square : array, shape (m, 2)
        Squared desired speeds at both ends of each [m^2/s^2].
    table : array, shape (3, d + 1)
        Limits as `MotionLimits.table` gives them.
    """
    found = np.empty((3, len(square)))
    for begin in range(0, len(square), _CHUNK):
        chosen = slice(begin, begin + _CHUNK)
        found[:, chosen] = _shares(
            geometry.part(begin, begin + _CHUNK), square[chosen].min(axis=1), table
        )
    return Shares(*found)


def _shares(geometry: PathGeometry, cap: Array, table: Array) -> Array:
    velocity, acceleration, jerk = table
    own, side, twist = (np.maximum(bound, 1e-12) for bound in geometry.bounds())
    for bound in (
        (velocity / own) ** 2,
        0.7 * acceleration / side,
        (0.5 * jerk / twist) ** (2.0 / 3.0),
    ):
        cap = np.minimum(cap, bound.min(axis=1))
    square, speed = cap[:, np.newaxis], np.sqrt(cap)[:, np.newaxis]
    left = jerk - twist * square * speed
    turning = 3.0 * side * speed
    rise = np.minimum((acceleration - side * square) / own, 0.3 * left / turning).min(axis=1)
    jolt = ((left - turning * rise[:, np.newaxis]) / own).min(axis=1)
    return np.stack([cap, rise, jolt])


def windows(
    time: Array, stop: NDArray[np.bool_], window: float, begin: int, end: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which pieces come within a window in time of pieces `begin` to `end`.

    Parameters
    ----------
    time : array, shape (m + 1,)
        When a motion that is nowhere slower passes the nodes [s].
    stop : array of bool, shape (m + 1,)
        Nodes across which windows do not reach.
    window : float
        Length [s].
    begin, end : int
        Pieces from `begin` up to, without, `end`.

    Returns
    -------
    low, high : array of int, shape (end - begin,)
        Pieces from `low` up to, without, `high`.
    """
    reach = window * AVERAGE_EDGE
    low = np.searchsorted(time, time[begin:end] - reach, 'right') - 1
    high = np.searchsorted(time, time[begin + 1 : end + 1] + reach, 'left')
    inner = np.flatnonzero(stop[1:-1]) + 1
    fence = np.concatenate([[0], inner, [len(time) - 1]])
    span = np.searchsorted(inner, np.arange(begin, end), 'right')
    return np.maximum(low, fence[span]), np.minimum(high, fence[span + 1])


def range_minimum(values: Array, low: NDArray[np.intp], high: NDArray[np.intp]) -> Array:
    """Return the smallest of `values[low[k]:high[k]]` for every k; no range may be empty."""
    found = np.empty(len(low))
    level = np.frexp(high - low)[1] - 1  # largest power of two within the range
    table = values
    for power in range(int(level.max()) + 1):
        if power:
            half = 1 << (power - 1)
            table = np.minimum(table[:-half], table[half:])
        chosen = np.flatnonzero(level == power)
        found[chosen] = np.minimum(table[low[chosen]], table[high[chosen] - (1 << power)])
    return found
