# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Readings at one interval from readings at another, or at none."""

from collections.abc import Iterator

import numpy as np

from fuzzycnc_ros.core.arrays import Array


def even_blocks(
    time: Array, values: Array, interval: float, jitter_max: float
) -> tuple[Array, Array] | None:
    """Return readings in even blocks of one interval each.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing times of the readings [s].
    values : ndarray, shape (n, w)
        Readings; NaN where one is missing.
    interval : float
        Length of a block [s].
    jitter_max : float
        Deviation of a reading from the even grid that is ignored, as a fraction of a step [-].

    Returns
    -------
    time : ndarray, shape (blocks,)
        Time of the last reading of each block [s].
    values : ndarray, shape (blocks, block, w)
        Readings of each block.

    Or None if the readings already are one per interval.

    Notes
    -----
    Readings off the even grid are interpolated linearly onto it.  Columns with gaps are not, as
    each gap would swallow its neighbours: their readings move to the nearest grid point.
    """
    step = float(np.median(np.diff(time)))
    block = max(1, round(interval / step))
    step = interval / block
    # Half a jitter of slack keeps a last reading that came a little early.
    count = int(np.floor((time[-1] - time[0]) / step + 0.5 * jitter_max)) + 1
    grid = time[0] + np.arange(count) * step
    on_grid = count == len(time) and float(np.abs(time - grid).max()) <= jitter_max * step
    if on_grid and block == 1:
        return None
    blocks = count // block
    grid = grid[: blocks * block]
    even = values[: len(grid)] if on_grid else _moved(time, values, grid)
    return grid[block - 1 :: block], even.reshape(blocks, block, values.shape[1])


def mean_of_measured(values: Array) -> Array:
    """Return the mean over axis 1 of what is not NaN, NaN where nothing is."""
    measured = np.isfinite(values)
    count = measured.sum(axis=1)
    total = np.where(measured, values, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def mean_of_most(values: Array) -> Array:
    """Return the mean over axis 1 of what is not NaN, NaN unless that is more than half."""
    enough = 2 * np.isfinite(values).sum(axis=1) > values.shape[1]
    return np.where(enough, mean_of_measured(values), np.nan)


def gaps_of(values: Array) -> Iterator[tuple[int, int, int]]:
    """Yield column, first and last row of each stretch of NaN in values (n, w)."""
    for column, readings in enumerate(values.T):
        lost = np.concatenate([[False], np.isnan(readings), [False]])
        edges = np.flatnonzero(lost[1:] != lost[:-1])
        for first, end in edges.reshape(-1, 2):
            yield column, int(first), int(end) - 1


def bridged(time: Array, values: Array, longest: float, free: float, begin: int) -> Array:
    """Return readings whose short gaps are filled.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing times of the readings [s].
    values : ndarray, shape (n, w)
        Readings; NaN where one is missing.
    longest : float
        Longest time between two readings that is bridged [s].
    free : float
        Time up to which nothing depends on the values [s]: gaps that end by then are bridged
        however long they are.
    begin : int
        Number of first samples whose mean the readings are meant against.

    Returns
    -------
    ndarray, shape (n, w)
        A straight line from the last reading before a gap to the first one behind it; at the end
        the last reading is held.  What lacks of the first samples takes the mean of those that
        are there, so that this mean stays as it is; a column without any of them keeps its gaps.
        `values` itself where nothing was filled.
    """
    filled = values
    for column, first, last in gaps_of(values):
        before, behind = max(first - 1, 0), min(last + 1, len(time) - 1)
        head = values[:begin, column]
        too_long = time[behind] - time[before] > longest and time[behind] > free
        if too_long or np.isnan(head).all():
            continue
        if filled is values:
            filled = values.copy()
        own = filled[:, column]
        if first < begin:
            own[first : last + 1] = np.nanmean(head)
            first = min(begin, last + 1)
        rows, before = slice(first, last + 1), first - 1
        if last + 1 == len(time):
            own[rows] = own[before]
        else:
            own[rows] = np.interp(time[rows], time[[before, behind]], own[[before, behind]])
    return filled


def _moved(time: Array, values: Array, grid: Array) -> Array:
    """Return the columns on the grid points, shape (len(grid), w)."""
    moved = np.full((len(grid), values.shape[1]), np.nan)
    if len(grid) < 2:
        return moved
    nearest = np.rint((time - grid[0]) / (grid[1] - grid[0])).astype(np.int64)
    nearest = np.clip(nearest, 0, len(grid) - 1)
    for column, readings in enumerate(values.T):
        measured = np.isfinite(readings)
        if measured.all():
            moved[:, column] = np.interp(grid, time, readings)
        else:
            moved[nearest[measured], column] = readings[measured]
    return moved
