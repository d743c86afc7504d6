# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The part of a track's measured deviation that the next run will have again.

A sheet gives way smoothly along a side, and alike from run to run.  Noise of the measurement does
neither, and single stitches that were found in the wrong place lie off their neighbours.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.training import beyond_chance, robust_deviation

AS_MEASURED = 0
"""Reach of a smoothing that does nothing [stitches]."""

REACHES = (AS_MEASURED, 2, 4, 8, 16, 32, 64)
"""Reaches that are tried, to either side [stitches]."""

STRAY = 6.0
"""Distance from the neighbours, in robust standard deviations, that is an outlier [-]."""

STRAY_MIN = 0.25e-3
"""Least such distance [m]: a sheet bends by as much at a corner, without any noise."""

STRAY_SHARE_MAX = 0.2
"""Largest share of outliers [-]; beyond it they are taken for the noise."""

CHANCE = 0.01
"""Chance at which deviations without any cause are taken for a deformation."""

CORNER = np.radians(20.0)
"""Turn of the nominal track that ends a side, if neighbouring steps turn by a third of it."""

_PARTS = 5
"""Parts of a single run of which each stitch is in one: every fifth is held out."""
_BLOCK = 8
"""Stitches in a row whose errors count as one: neighbours are not independent."""
_BLOCK_MIN, _BLOCKS_MIN = 2, 6
"""Blocks of a short track are shorter: three, one of them where the track begins, tell little."""
_NEIGHBOURS = 4
_ROUNDS = 8
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class BelievedDeviation:
    """The deviation that will come again, and how that was told.

    Attributes
    ----------
    deviation : ndarray, shape (n + 1, 2)
        Nominal less stitched [m]; 0 where none is better than any.
    outlier : ndarray of bool, shape (runs, n + 1)
        Stitches that were left out.
    reach : int
        Stitches to either side over which was smoothed; `AS_MEASURED` for none.
    error, error_none : float
        Mean distance from held-out stitches [m]: of the deviation, and of none.
    """

    deviation: Array
    outlier: NDArray[np.bool_]
    reach: int
    error: float
    error_none: float

    @property
    def corrects(self) -> bool:
        """True if any deviation differs from zero."""
        return bool(self.deviation.any())


def believed_deviation(
    nominal: Array, stitched: Array, primitive: NDArray[np.int64]
) -> BelievedDeviation:
    """Return the deviation of a track that the next run will have again.

    Stitches far off their neighbours are left out.  The rest is smoothed along each side by local
    lines over as many stitches as predict held-out ones best: whole runs where there are several,
    else every fifth stitch.  If that is not better than no deviation beyond chance, there is none.

    Parameters
    ----------
    nominal : ndarray, shape (n + 1, 2)
        Nominal points [m].
    stitched : ndarray, shape (runs, n + 1, 2)
        Stitches of runs with the same offsets [m].
    primitive : ndarray of int, shape (n,)
        Primitive of each step: a side ends with it, and at corners.
    """
    found = nominal - stitched
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(nominal, axis=0).T)))
    side = _sides(nominal, primitive)
    outlier = np.stack([_outliers(run, way, side) for run in found])
    held_out = _held_out(outlier)
    longest = int(np.bincount(side).max())
    reaches = [reach for reach in REACHES if reach < max(longest, 3)]
    errors = {
        reach: _held_out_errors(found, outlier, held_out, way, side, reach) for reach in reaches
    }
    known = ~outlier
    none = np.hypot(found[..., 0], found[..., 1])
    best = min(reaches, key=lambda reach: float(errors[reach][known].mean()))
    blocks = np.arange(len(nominal)) // min(_BLOCK, max(len(nominal) // _BLOCKS_MIN, _BLOCK_MIN))
    masks = (known & (blocks == block) for block in range(int(blocks[-1]) + 1))
    # Shares, since a deviation that grows along the track differs more between blocks than chance.
    gains = np.array([
        (none[mask] - errors[best][mask]).sum() / max((none + errors[best])[mask].sum(), _TINY)
        for mask in masks
        if mask.any()
    ])  # fmt: skip
    deviation = np.zeros_like(nominal)
    if len(gains) > 2 and beyond_chance(gains, CHANCE):  # two blocks tell nothing
        deviation = _smoothed(*_mean(found, outlier), way, side, best)
    return BelievedDeviation(
        deviation, outlier, best, float(errors[best][known].mean()), float(none[known].mean())
    )


def _sides(nominal: Array, primitive: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the side of each point, shape (n + 1,); a corner ends the side before it."""
    feed = np.diff(nominal, axis=0)
    heading = feed[:, 0] + 1j * feed[:, 1]
    turn = np.abs(np.angle(heading[1:] * heading[:-1].conj()))
    corner = turn > max(CORNER, 3.0 * float(np.median(turn))) if len(turn) else np.zeros(0, bool)
    ends = corner | (np.diff(primitive) != 0)
    return np.concatenate([[0, 0], np.cumsum(ends)]).astype(np.int64)


def _outliers(deviation: Array, way: Array, side: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the stitches of a run that lie far off their neighbours, shape (n + 1,)."""
    around = _windows(side, _NEIGHBOURS)
    rows = np.where(around >= 0, around, 0)
    values = np.where((around >= 0)[..., np.newaxis], deviation[rows], np.nan)
    out = _far(np.hypot(*(deviation - np.nanmedian(values, axis=1)).T), np.zeros(len(way), bool))
    for _ in range(_ROUNDS):
        others = _smoothed(deviation, ~out, way, side, _NEIGHBOURS, itself=False)
        now = _far(np.hypot(*(deviation - others).T), out)
        if (now == out).all():
            break
        out = now
    return out if out.mean() <= STRAY_SHARE_MAX else np.zeros(len(way), bool)


def _far(distance: Array, out: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which distances are beyond what those that are not out have."""
    if out.all():
        return out
    return np.asarray(distance > max(STRAY * robust_deviation(distance[~out]), STRAY_MIN))


def _held_out(outlier: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """Return masks of held-out stitches, whole runs if there are several."""
    runs, points = outlier.shape
    if runs > 1:
        return [
            np.repeat(np.arange(runs) == run, points).reshape(runs, points) for run in range(runs)
        ]
    return [(np.arange(points) % _PARTS == part)[np.newaxis] for part in range(_PARTS)]


def _held_out_errors(
    found: Array,
    outlier: NDArray[np.bool_],
    held_out: list[NDArray[np.bool_]],
    way: Array,
    side: NDArray[np.int64],
    reach: int,
) -> Array:
    """Return how far held-out stitches lie from what the others say, shape (runs, n + 1) [m]."""
    errors = np.empty(outlier.shape)
    for part in held_out:
        mean, known = _mean(found, outlier | part)
        said = _smoothed(mean, known, way, side, reach)
        errors[part] = np.hypot(*(found - said)[part].T)
    return errors


def _mean(found: Array, out: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the mean of the runs at each point, and where there is one."""
    count = (~out).sum(axis=0)
    total = np.where(out[..., np.newaxis], 0.0, found).sum(axis=0)
    return total / np.maximum(count, 1)[:, np.newaxis], count > 0


def _windows(side: NDArray[np.int64], reach: int) -> NDArray[np.int64]:
    """Return the points around each on its side, shape (n + 1, 2 reach + 1); -1 for none."""
    place = np.arange(len(side))[:, np.newaxis] + np.arange(-reach, reach + 1)
    valid = (place >= 0) & (place < len(side))
    valid &= side[np.clip(place, 0, len(side) - 1)] == side[:, np.newaxis]
    return np.where(valid, place, -1)


def _smoothed(
    values: Array,
    known: NDArray[np.bool_],
    way: Array,
    side: NDArray[np.int64],
    reach: int,
    *,
    itself: bool = True,
) -> Array:
    """Return local lines through known values, shape (n + 1, 2).

    What is as measured stays, and is filled in where it is not known.  Points that no known one is
    near get the median of their side, or 0 if nothing of it is known.
    """
    around = _windows(side, max(reach, 2))
    rows = np.where(around >= 0, around, 0)
    weight = np.where(around >= 0, known[rows], 0.0)
    if not itself:
        weight[:, around.shape[1] // 2] = 0.0
    apart = way[rows] - way[:, np.newaxis]
    size = np.max(np.where(around >= 0, np.abs(apart), 0.0), axis=1, keepdims=True)
    weight = (
        weight * (1.0 - np.minimum(np.abs(apart) / np.maximum(1.1 * size, _TINY), 1.0) ** 3) ** 3
    )
    total, first, second = (
        (weight * apart**power).sum(axis=1)[:, np.newaxis] for power in range(3)
    )
    near = np.einsum('ij,ijk->ik', weight, values[rows])
    slope = np.einsum('ij,ijk->ik', weight * apart, values[rows])
    spread = total * second - first**2
    flat = spread <= 1e-6 * total * size**2 * np.maximum(total, _TINY)
    with np.errstate(divide='ignore', invalid='ignore'):
        line = np.where(flat, near / total, (second * near - first * slope) / spread)
    empty = total[:, 0] <= _TINY
    for number in np.unique(side[empty]):
        of_side = known & (side == number)
        line[empty & (side == number)] = (
            np.median(values[of_side], axis=0) if of_side.any() else 0.0
        )
    if reach == AS_MEASURED and itself:
        line = np.where(known[:, np.newaxis], values, line)
    return np.asarray(line)
