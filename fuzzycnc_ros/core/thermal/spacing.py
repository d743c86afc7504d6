# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Spacing of readings in time: how far apart they usually are, and their means on an even grid."""

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.run import GAP_MAX, REFERENCE_SAMPLES

BRIDGED_MAX = 3.0
"""Longest step over the usual one across which readings are interpolated [-]; a longer one is a
gap, in which nothing was measured."""

REFERENCE_INTERVAL = 60.0
"""Faster readings are averaged to samples of this interval for the reference [s]."""


def reference_rows(time: Array) -> int:
    """Return how many first rows make the first three samples of at least one minute."""
    step = float(np.median(np.diff(time)))
    # Half a row of slack, so that noise in the times does not add one.
    inside = time - time[0] < REFERENCE_SAMPLES * max(step, REFERENCE_INTERVAL) - 0.5 * step
    return max(REFERENCE_SAMPLES, int(np.sum(inside)))


def usual_step(time: Array, longest: float) -> float:
    """Return the step between readings within which half of the time passes [s].

    Readings that come in bursts have many short steps, and most of the time passes in the few
    long ones.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing times of the readings [s].
    longest : float
        Steps above this are gaps, and do not count [s].
    """
    steps = np.sort(np.diff(time))
    steps = steps[: max(1, int(np.searchsorted(steps, longest, side='right')))]
    passed = np.cumsum(steps)
    return float(steps[np.searchsorted(passed, 0.5 * passed[-1])])


def sample_interval(time: Array) -> float:
    """Return the interval of samples that each get readings, and lose none of them [s].

    That is the step of readings that come one by one, and the time from burst to burst of those
    that come in bursts.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing times of the readings [s].
    """
    steps = np.diff(time)
    usual = usual_step(time, max(GAP_MAX, BRIDGED_MAX * float(np.median(steps))))
    first = time[1:][steps > 0.5 * usual]
    return float(np.median(np.diff(first))) if len(first) > 1 else usual


def block_means(time: Array, values: Array, interval: float, block: int, count: int) -> Array:
    """Return the mean of readings over each block of an even grid.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing times of the readings [s], the first one 0.
    values : ndarray, shape (n, w)
        Readings; NaN where one is missing.
    interval : float
        Length of a block [s].
    block : int
        Points of the grid in a block.
    count : int
        Number of blocks.

    Returns
    -------
    ndarray, shape (count, w)
        A block with a reading has a mean; one whose readings all are missing is NaN, and so is
        one without any in a gap.

    Notes
    -----
    Readings are first interpolated linearly on the grid, so that uneven ones weigh as long as
    they lasted.  Across a gap, which is longer than three usual steps, nothing is interpolated:
    the points next to its ends have the readings there, the others have none.
    """
    fine = interval / block
    grid = np.arange(count * block, dtype=np.float64) * fine
    nearest = np.rint(time / fine).astype(np.int64)
    inside = nearest < len(grid)
    rows = np.bincount(nearest[inside] // block, minlength=count)
    longest = BRIDGED_MAX * max(interval, float(np.median(np.diff(time))))
    longest = min(longest, BRIDGED_MAX * usual_step(time, longest))
    means = np.full((count, values.shape[1]), np.nan)
    for column, readings in enumerate(values.T):
        there = np.isfinite(readings)
        if not there.any():
            continue
        at = nearest[there & inside]
        number = np.bincount(at, minlength=len(grid))
        total = np.bincount(at, weights=readings[there & inside], minlength=len(grid))
        points = _interpolated(grid, time[there], readings[there], longest)
        alone = np.isnan(points) & (number > 0)
        points[alone] = total[alone] / number[alone]
        known = np.isfinite(points).reshape(count, block)
        mean = np.where(known, points.reshape(count, block), 0.0).sum(axis=1)
        own = number.reshape(count, block).sum(axis=1)
        held = known.any(axis=1) & ((own > 0) | (rows == 0))
        means[held, column] = mean[held] / known.sum(axis=1)[held]
    return means


def _interpolated(grid: Array, time: Array, values: Array, longest: float) -> Array:
    """Return values on a grid, NaN before the first, behind the last and in gaps."""
    points = np.asarray(np.interp(grid, time, values, left=np.nan, right=np.nan))
    if len(time) > 1:
        after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
        points[time[after] - time[after - 1] > longest] = np.nan
    return points
