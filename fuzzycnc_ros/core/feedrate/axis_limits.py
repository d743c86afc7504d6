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

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.path_geometry import PathGeometry

_GROUP = 16384
"""Segments swept at a time, unless one span is longer."""
_CHUNK = 2048
"""Segments whose pairs of bands are held at a time."""
_FLAT = 1e-9
"""Share of w1 in a band below which the band bounds w0 alone."""


@dataclass(frozen=True)
class _Bands:
    """Bands of every segment, shape (m, bands), and the largest w0 they leave, shape (m,)."""

    slope: Array
    width: Array
    most: Array


def node_minimum(segment: Array) -> Array:
    """Return the smaller value of the segments on both sides of each node, shape (m + 1,)."""
    return np.asarray(np.minimum(np.append(segment, np.inf), np.append(np.inf, segment)))


def fastest_speed(geometry: PathGeometry, wanted: Array, limits: MotionLimits) -> Array:
    """Return the fastest squared speeds at the nodes, shape (m + 1,) [m^2/s^2].

    Parameters
    ----------
    geometry : PathGeometry
        The path.
    wanted : array, shape (m + 1,)
        Squared desired speeds; those of the ends are the squared speeds there [m^2/s^2].
    limits : MotionLimits
        Limits of velocity and acceleration; those of jerk have no effect.
    """
    table = limits.table(geometry.axes)
    found = np.array(wanted, dtype=float)
    found[geometry.stop] = 0.0
    fence = np.concatenate([[0], np.flatnonzero(geometry.stop), [len(found) - 1]])
    begin = 0
    while begin < len(fence) - 1:  # spans between stops know nothing of each other
        end = int(np.searchsorted(fence, fence[begin] + _GROUP, 'right')) - 1
        end = max(end, begin + 1)
        first, last = int(fence[begin]), int(fence[end])
        part = slice(first, last + 1)
        found[part] = _fastest(geometry.part(first, last), found[part], table)
        begin = end
    return found


def _fastest(geometry: PathGeometry, cap: Array, table: Array) -> Array:
    """Return the fastest squared speeds of some spans, all swept side by side."""
    own, side, _ = geometry.bounds()
    bands = _bands(geometry, table[1], own[:, 0], side[:, 0])
    fastest = (table[0] / np.maximum(own, 1e-12)).min(axis=1)
    cap = np.minimum(cap, node_minimum(fastest**2))
    cap[:-1] = np.minimum(cap[:-1], bands.most)
    # Backward: w0 as large as some w1 allows, which matters for bands that fall with w0.
    falls = bands.slope < 0.0
    over = np.where(falls, -bands.slope, 1.0)
    offset = np.where(falls, bands.width / over, np.inf)
    gain = np.where(falls, 1.0 / over, 0.0)
    first = np.append(0, np.flatnonzero(geometry.stop))
    size = np.diff(np.append(first, len(cap) - 1))
    order = np.argsort(-size, kind='stable')
    first, size = first[order], size[order]
    steps = [first[: np.searchsorted(-size, -k, 'left')] + k for k in range(int(size[0]))]
    for k in reversed(steps):
        allowed = (offset[k] + gain[k] * cap[k + 1, np.newaxis]).min(axis=1)
        cap[k] = np.minimum(cap[k], allowed)
    for k in steps:
        allowed = (bands.width[k] - bands.slope[k] * cap[k, np.newaxis]).min(axis=1)
        cap[k + 1] = np.minimum(cap[k + 1], np.maximum(allowed, 0.0))
    return cap


def _bands(geometry: PathGeometry, bound: Array, own: Array, side: Array) -> _Bands:
    """Return the bands that the limits of acceleration leave, those of the path and the axes.

    `own` and `side` are the bounds of |p'| and of its derivative, each (m,).
    """
    half = 0.5 / np.diff(geometry.node)
    before, after = [], []
    if np.isfinite(bound[0]):
        # Along the path: |p'| times the change of speed, and what its parameter strays from s.
        for sign, share in ((1.0, 0.0), (1.0, 1.0), (-1.0, 0.0), (-1.0, 1.0)):
            before.append((-sign * own * half + (1.0 - share) * side) / bound[0])
            after.append((sign * own * half + share * side) / bound[0])
    tangent, bend = geometry.derivative(1), geometry.derivative(2)
    # Lines have one coefficient, all but for the rounding of positions in second differences.
    rounding = 64.0 * np.finfo(float).eps * np.abs(geometry.coefficient).max() * 80.0 * half**2
    straight = (np.abs(bend) <= rounding[:, np.newaxis, np.newaxis]).all()
    coefficients = 1 if straight else 5
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
    return _Bands(slope, width, np.minimum(most, _largest(slope, width)))


def _largest(slope: Array, width: Array) -> Array:
    """Return the largest w0 that leaves some w1 of at least half of it.

    Without the half, a segment longer than the stopping distance would be entered so fast that
    nothing but a stop at its end obeys the limits.
    """
    found = np.full(len(slope), np.inf)
    for begin in range(0, len(slope), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        g, c = slope[part], np.where(np.isfinite(width[part]), width[part], 1e150)
        apart = g[:, :, np.newaxis] - g[:, np.newaxis, :]
        sums = c[:, :, np.newaxis] + c[:, np.newaxis, :]
        usable = apart > 0.0
        pair = np.where(usable, sums / np.where(usable, apart, 1.0), np.inf).min(axis=(1, 2))
        steep = g + 0.5
        usable = steep > 0.0
        single = np.where(usable, c / np.where(usable, steep, 1.0), np.inf).min(axis=1)
        found[part] = np.minimum(pair, single)
    return found
