# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Straight lines of a trial on a sheet: what identifies a model, in few stitches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.compensation import REFERENCE_LENGTH

APART = 8e-3
"""Least distance between lines [m]: the drag of one must not move another, nor a match find it."""

DENSITIES = (0.67, 1.5)
"""Further stitch steps, as shares of the usual one."""

_GRID = 4e-3
_ALONG = 21


@dataclass(frozen=True)
class TrialLine:
    """A line of the trial.

    Parameters
    ----------
    direction : float
        Direction [rad].
    step : float
        Stitch step [m].
    """

    direction: float
    step: float


def trial_plan(directions: int, step: float) -> list[TrialLine]:
    """Return the lines of a trial in the order of stitching.

    Directions lie evenly over half a turn, and every third one is stitched the other way: both
    ways tell the same, if the sheet is alike both ways.  Two directions are stitched with other
    steps, and the first two once more at the end, which shows whether order matters.

    Parameters
    ----------
    directions : int
        How many directions; 3 at least.
    step : float
        Usual stitch step [m].

    Examples
    --------
    >>> len(trial_plan(8, 3e-3))
    14
    """
    turn = np.pi * np.arange(directions) / directions
    ways = turn + np.where(np.arange(directions) % 3 == 2, np.pi, 0.0)
    # Neighbours in time are no neighbours in direction, so that order and direction do not mix.
    stride = next(k for k in (5, 3, 7, 1) if np.gcd(k, directions) == 1)
    order = [stride * k % directions for k in range(directions)]
    lines = [TrialLine(float(ways[k]), step) for k in order]
    for k in (0, directions // 2):
        lines += [TrialLine(float(turn[k]), share * step) for share in DENSITIES]
    return [*lines, *lines[:2]]


def trial_runs(plan: Sequence[TrialLine], size: tuple[float, float], margin: float) -> list[Array]:
    """Return the stitches of the lines, shape (k, 2) [m] each, placed apart on a sheet.

    Parameters
    ----------
    plan : sequence of TrialLine
        The lines.
    size : tuple of float
        The sheet [m].
    margin : float
        Distance from its edges [m].

    Raises
    ------
    ValueError
        If they do not fit.
    """
    share = np.linspace(-0.5, 0.5, _ALONG)[:, np.newaxis]
    placed: dict[int, Array] = {}
    taken = np.empty((0, 2))
    # Alike directions beside one another leave most room.
    for number in sorted(range(len(plan)), key=lambda n: plan[n].direction % np.pi):
        line = plan[number]
        count = max(round(REFERENCE_LENGTH / line.step), 1)
        sine, cosine = portable.sin(line.direction), portable.cos(line.direction)
        reach = count * line.step * np.array([cosine, sine])
        low = margin + 0.5 * np.abs(reach)
        high = np.array(size) - low
        middle = _free(low, high, share * reach, taken)
        if middle is None:
            raise ValueError(
                f'size: expected room for {len(plan)} lines of {1e3 * REFERENCE_LENGTH:g} mm, '
                f'{1e3 * APART:g} mm apart, but found it for {len(placed)} on '
                f'{1e3 * size[0]:g} x {1e3 * size[1]:g} mm; take a larger sheet or fewer '
                'directions'
            )
        at = np.arange(count + 1)[:, np.newaxis] / count - 0.5
        placed[number] = middle + at * reach
        taken = np.concatenate([taken, middle + share * reach])
    runs = [placed[number] for number in range(len(plan))]
    everything = np.concatenate(runs)
    centre = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
    return [run - centre + 0.5 * np.array(size) for run in runs]


def _free(low: Array, high: Array, line: Array, taken: Array) -> Array | None:
    """Return the first middle of a line at which it is apart from all others, if there is one."""
    if (low > high + 1e-12).any():
        return None
    for x in np.arange(low[0], high[0] + 1e-9, _GRID):
        for y in np.arange(low[1], high[1] + 1e-9, _GRID):
            middle = np.array([x, y])
            if not len(taken):
                return middle
            apart = (middle + line)[:, np.newaxis] - taken
            if (apart * apart).sum(axis=-1).min() >= APART * APART:
                return middle
    return None
