# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Smoothing of feeds along a path [lin2021]."""

import numpy as np
from scipy.ndimage import minimum_filter1d

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.limits import reachable_speed


def reach(length: int, causal: bool = False) -> tuple[int, int]:
    """Return how many points before and after its own an average of `length` points takes."""
    before = length - 1 if causal else length // 2
    return before, length - 1 - before


def moving_average(
    values: Array, length: int, *, causal: bool = False, closed: bool = False
) -> Array:
    """Return the moving average; at the ends of the mean of the points present.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Values at the points of a path.
    length : int
        Points averaged, at least 1; 1 leaves the values as they are.
    causal : bool
        Whether to average over the points up to each one instead of about it.
    closed : bool
        Whether the path closes, so that the average runs across its start.

    Returns
    -------
    ndarray, shape (n,)
        Averages, in the unit of the values.

    Examples
    --------
    >>> moving_average(np.array([0.0, 0.0, 3.0, 0.0]), 3).tolist()
    [0.0, 1.0, 1.0, 1.5]
    """
    _check_length(length)
    before, after = reach(length, causal)
    kernel = np.ones(length)
    if closed:
        around = np.take(values, np.arange(-before, len(values) + after), mode='wrap')
        return np.asarray(np.convolve(around, kernel, mode='valid') / length)
    total = np.convolve(values, kernel)[after : after + len(values)]
    place = np.arange(len(values))
    present = np.minimum(place, before) + np.minimum(place[::-1], after) + 1
    return np.asarray(total / present)


def erode(values: Array, length: int, *, closed: bool = False) -> Array:
    """Return the smallest value among `length` points about each.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Values at the points of a path.
    length : int
        Points of the window, at least 1.
    closed : bool
        Whether the path closes.

    Returns
    -------
    ndarray, shape (n,)
        Minima, in the unit of the values.
    """
    _check_length(length)
    if closed:
        return np.asarray(minimum_filter1d(values, length, mode='wrap', origin=_origin(length)))
    return np.asarray(
        minimum_filter1d(values, length, mode='constant', cval=np.inf, origin=_origin(length))
    )


def erode_average(values: Array, length: int, *, closed: bool = False) -> Array:
    """Return the moving average of the eroded values, which nowhere exceeds the values.

    Each average takes only minima over windows that hold the point itself.  Parameters and
    returns are those of `moving_average`.

    Examples
    --------
    >>> erode_average(np.array([3.0, 3.0, 3.0, 0.0]), 3).tolist()
    [3.0, 2.0, 1.0, 0.0]
    """
    return moving_average(erode(values, length, closed=closed), length, closed=closed)


def limit_acceleration(speed: Array, arc_length: Array, acceleration: float) -> Array:
    """Return the largest speeds that change by no more than a path acceleration, ends free.

    Parameters
    ----------
    speed : ndarray, shape (n,)
        Speeds wanted [m/s], not exceeded anywhere.
    arc_length : ndarray, shape (n,)
        Arc length of the points [m], not decreasing.
    acceleration : float
        Largest magnitude of the acceleration along the path [m/s^2], positive.

    Returns
    -------
    ndarray, shape (n,)
        Speeds [m/s].
    """
    return reachable_speed(
        arc_length, speed, acceleration, start=float(speed[0]), end=float(speed[-1])
    )


def _origin(length: int) -> int:
    """Return the shift that mirrors the window of an even length against that of the average."""
    return 0 if length % 2 else -1


def _check_length(length: int) -> None:
    """Refuse an average over no points."""
    if length < 1:
        raise ValueError(
            f'length: expected at least 1 point, which leaves the values as they are, '
            f'but found {length}'
        )
