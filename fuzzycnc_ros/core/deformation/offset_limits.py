# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Limits that offsets of a path keep, whatever asked for them, and flags that tell of them."""

from enum import IntFlag

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.arrays import Array


class StepFlag(IntFlag):
    """What happened to a step; 0 if it was compensated in full."""

    OUTSIDE_DOMAIN = 1
    """The gate refused its process values."""
    RIGHT_TURN = 2
    """An arc that turns right, which the models were not trained on."""
    ZERO_LENGTH = 4
    """The point was given twice; nothing was added."""
    RATE_LIMITED = 8
    """The model's output was cut at its largest rate."""
    OFFSET_LIMITED = 16
    """The offset was cut at its largest length."""
    PROGRESS_LIMITED = 32
    """The offset was held back so that the tool goes on along the path."""
    CLIPPED = 64
    """The offset was cut at the edge of the area."""
    NO_PROGRESS = 128
    """At the edge of the area the tool goes on by less than the least progress."""


def limit_offsets(
    nominal: Array,
    wanted: ArrayLike,
    *,
    offset_max: float = 15e-3,
    progress_min: float = 0.2,
    size: tuple[float, float] | None = None,
) -> tuple[Array, NDArray[np.int64]]:
    """Return offsets within their limits (method sheet 000 section 6.4).

    Parameters
    ----------
    nominal : ndarray, shape (n + 1, 2)
        Nominal points [m].
    wanted : array_like, shape (n + 1, 2)
        Offsets [m].
    offset_max : float
        Largest length of an offset [m].
    progress_min : float
        Least progress of a commanded step along its nominal direction, as a share of the
        nominal step [-]; an offset that would take more is held back towards the last one.
    size : tuple of float, optional
        Clamped area from the origin [m]; commanded points are cut at its edge.  This comes
        last: at the edge a step may make less progress, which its flag then says.

    Returns
    -------
    offset : ndarray, shape (n + 1, 2)
        Offsets [m].
    flag : ndarray of int, shape (n,)
        Limits that were at work on each step, `StepFlag`.
    """
    target = np.array(wanted, float)
    reach = np.hypot(*target.T)
    over = reach > offset_max
    target[over] *= (offset_max / reach[over])[:, None]
    flag = np.where(over[1:], StepFlag.OFFSET_LIMITED, 0).astype(np.int64)
    offset = target.copy()
    if size is not None:
        offset[0] = np.clip(nominal[0] + target[0], 0.0, size) - nominal[0]
    feed = np.diff(nominal, axis=0)
    square = (feed**2).sum(axis=1)
    for n, step in enumerate(feed):
        if square[n] == 0.0:
            offset[n + 1] = offset[n]
            continue
        change = target[n + 1] - offset[n]
        gained = change @ step / square[n]  # as a share of the nominal step
        if gained < progress_min - 1.0:
            flag[n] |= StepFlag.PROGRESS_LIMITED
            change = change * ((progress_min - 1.0) / gained)
        offset[n + 1] = offset[n] + change
        if size is None:
            continue
        point = nominal[n + 1] + offset[n + 1]
        inside = np.clip(point, 0.0, size)
        if (inside == point).all():
            continue
        flag[n] |= StepFlag.CLIPPED
        offset[n + 1] = inside - nominal[n + 1]
        if (offset[n + 1] - offset[n]) @ step / square[n] < progress_min - 1.0 - 1e-9:
            flag[n] |= StepFlag.NO_PROGRESS
    return offset, flag
