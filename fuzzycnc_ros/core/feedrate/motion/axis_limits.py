# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fastest speeds along a path within limits of velocity and acceleration of every axis.

Along a segment of length h let the squared speed w run straight from w0 to w1.  The acceleration
of an axis is then p' (w1 - w0) / 2h + p'' w, a polynomial whose Bernstein coefficients are linear
in w0 and w1.  Keeping each within the limit keeps the whole segment within it, and leaves bands

    -c <= w1 + g w0 <= c

per segment.  Sweeping them backward and forward is the reachability analysis of Pham and Pham
(2018, TOPP-RA), with bands that hold between grid points too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry

_NO_BAND = 1e150
"""Width of a band that bounds nothing, so that sums of two stay finite."""
_FLAT = 1e-9
"""Share of w1 in a band below which the band bounds w0 alone."""


@dataclass(frozen=True)
class Bands:
    """Bands of every segment, shape (m, bands), and what bounds its ends, shape (m,).

    `most` is the largest w0 that the bands leave, `fastest` the largest w within the velocities.
    """

    slope: Array
    width: Array
    most: Array
    fastest: Array

    def __len__(self) -> int:
        return len(self.most)

    def part(self, begin: int, end: int) -> Bands:
        """Return the bands of the segments from `begin` up to, without, `end`."""
        chosen = slice(begin, end)
        return Bands(
            self.slope[chosen], self.width[chosen], self.most[chosen], self.fastest[chosen]
        )

    def joined(self, other: Bands) -> Bands:
        """Return the bands of these segments and of those behind them."""
        count = max(self.slope.shape[1], other.slope.shape[1])
        slope, width = (
            np.concatenate(
                [
                    np.pad(rows, ((0, 0), (0, count - rows.shape[1])), constant_values=void)
                    for rows in pair
                ]
            )
            for pair, void in (
                ((self.slope, other.slope), 0.0),
                ((self.width, other.width), np.inf),
            )
        )
        return Bands(
            slope,
            width,
            np.concatenate([self.most, other.most]),
            np.concatenate([self.fastest, other.fastest]),
        )

    def backward(self) -> tuple[Array, Array]:
        """Return offset and gain of w0 <= offset + gain w1, which bands that fall with w0 set."""
        falls = self.slope < 0.0
        over = np.where(falls, -self.slope, 1.0)
        return np.where(falls, self.width / over, np.inf), np.where(falls, 1.0 / over, 0.0)


def brake_spans(bands: Bands, cap: Array, stop: NDArray[np.bool_]) -> None:
    """Lower squared speeds at the nodes to those from which braking leads to the next.

    Spans between stops, nodes of shape (m + 1,), are swept side by side.
    """
    offset, gain = bands.backward()
    for k in reversed(_steps(stop)):
        allowed = (offset[k] + gain[k] * cap[k + 1, np.newaxis]).min(axis=1)
        cap[k] = np.minimum(cap[k], allowed)


def rise_spans(bands: Bands, cap: Array, stop: NDArray[np.bool_]) -> None:
    """Lower squared speeds at the nodes to those that can be had from the one before."""
    for k in _steps(stop):
        allowed = (bands.width[k] - bands.slope[k] * cap[k, np.newaxis]).min(axis=1)
        cap[k + 1] = np.minimum(cap[k + 1], np.maximum(allowed, 0.0))


def _steps(stop: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Return the first segments of all spans, then the second ones, and so on."""
    first = np.append(0, 1 + np.flatnonzero(stop[1:-1]))
    size = np.diff(np.append(first, len(stop) - 1))
    order = np.argsort(-size, kind='stable')
    first, size = first[order], size[order]
    return [first[: np.searchsorted(-size, -k, 'left')] + k for k in range(int(size[0]))]


def acceleration_bands(geometry: PathGeometry, table: Array) -> Bands:
    """Return the bands that the limits of acceleration leave, those of the path and the axes."""
    own, side, _ = geometry.bounds()
    velocity, bound = table[0], table[1]
    fastest = np.square((velocity / np.maximum(own, 1e-12)).min(axis=1))
    half = 0.5 / np.diff(geometry.node)
    before, after = [], []
    if np.isfinite(bound[0]):
        # Along the path: |p'| times the change of speed, and what its parameter strays from s.
        rise, stray = own[:, 0] * half, side[:, 0]
        for sign, share in ((1.0, 0.0), (1.0, 1.0), (-1.0, 0.0), (-1.0, 1.0)):
            before.append((-sign * rise + (1.0 - share) * stray) / bound[0])
            after.append((sign * rise + share * stray) / bound[0])
    tangent, bend = geometry.derivative(1), geometry.derivative(2)
    # Lines have one coefficient, all but for the rounding of positions in second differences.
    largest = np.abs(geometry.coefficient).max(axis=(1, 2))
    rounding = 64.0 * np.finfo(float).eps * largest * 80.0 * (half * half)
    straight = (np.abs(bend) <= rounding[:, np.newaxis, np.newaxis]).all(axis=(1, 2))
    tangent[straight] = tangent[straight, :1]
    bend[straight] = 0.0
    coefficients = 1 if straight.all() else 5
    for axis in np.flatnonzero(np.isfinite(bound[1:])):
        for k in range(coefficients):
            rise = tangent[:, k, axis] * half
            low = (4 - k) / 4.0 * bend[:, k, axis] if k < 4 else 0.0
            high = k / 4.0 * bend[:, k - 1, axis] if k > 0 else 0.0
            before.append((low - rise) / bound[1 + axis])
            after.append((high + rise) / bound[1 + axis])
    first, second = np.column_stack(before), np.column_stack(after)
    flip = np.where(second < 0.0, -1.0, 1.0)
    first, second = first * flip, second * flip
    alone = second <= _FLAT * np.abs(first)
    alone |= second <= 0.0
    divisor = np.where(alone, 1.0, second)
    slope = np.where(alone, 0.0, first / divisor)
    width = np.where(alone, np.inf, 1.0 / divisor)
    with np.errstate(divide='ignore'):
        most = np.where(alone, 1.0 / np.abs(first), np.inf).min(axis=1)
    return Bands(slope, width, np.minimum(most, _largest(slope, width)), fastest)


def _largest(slope: Array, width: Array) -> Array:
    """Return the largest w0 that leaves some w1 of at least half of it.

    Without the half, a segment longer than the stopping distance would be entered so fast that
    nothing but a stop at its end obeys the limits.
    """
    wide = np.where(np.isfinite(width), width, _NO_BAND)
    steep = slope + 0.5
    usable = steep > 0.0
    found = np.where(usable, wide / np.where(usable, steep, 1.0), np.inf).min(axis=1)
    # Where the lowest upper edge c - g w0 meets the highest lower edge -c - g w0.  Their distance
    # is concave in w0, so that Newton's steps come down to it from any w0 beyond.
    at: NDArray[np.intp] = np.arange(len(slope))
    upper, lower = slope.argmax(axis=1), slope.argmin(axis=1)  # these two far beyond
    first = True
    while len(at):
        g, c, row = slope[at], wide[at], np.arange(len(at))
        apart = g[row, upper] - g[row, lower]
        crossing = apart > 0.0
        meet = (c[row, upper] + c[row, lower]) / np.where(crossing, apart, 1.0)
        nearer = crossing & (meet < found[at])
        found[at[nearer]] = meet[nearer]
        if not first:
            at, g, c = at[nearer], g[nearer], c[nearer]
        first = False
        falling = g * found[at, np.newaxis]
        upper, lower = (c - falling).argmin(axis=1), (c + falling).argmin(axis=1)
    return np.asarray(found)
