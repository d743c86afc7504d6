# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What braking into a bend adds to the contour error, and speeding up out of it takes away."""

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.sampled_path import WINDOW_EDGE, SampledPath

APPROACH = 1.9
"""Time over which a machine sees how the speed changes, over the root of its constant C."""

SHARE_MIN, SHARE_MAX = 0.5, 4.0
"""Bounds of the share.

The lower one is that of a path left from rest; the upper one is reached where a tight arc follows
a line: with 1.5 such arcs of 0.5 mm leave twice a tolerance of 10 um.
"""


def approach_share(path: SampledPath, speed: Array, time: float, length: float) -> Array:
    """Return the contour error over that of the normal acceleration alone, (v' + v) / 2v.

    Parameters
    ----------
    path : SampledPath
        Path of m points.
    speed : ndarray, shape (m,)
        Speed v at its points [m/s], positive.
    time : float
        The speed v' is that of the place which lies `time * v` behind [s], positive.
    length : float
        But no farther behind than this, nor before the first point there [m].

    Returns
    -------
    ndarray, shape (m,)
        Shares, `SHARE_MIN` to `SHARE_MAX`; 1 where the speed stays the same.

    Notes
    -----
    A machine follows with the mean of its reference over the recent past, weighted by its
    impulse response.  In moments m2, m3 of that about its mean delay, the position is the
    delayed reference plus m2/2 times its acceleration, less m3/6 times its jerk.  At a constant
    normal acceleration k v^2 the jerk points inwards by k v dv/dt, so that the error is

        m2/2 k v^2 (1 - m3 / (3 m2) dv/ds),  C = m2/2:

    what brakes before a bend still pulls when the path has turned.  The slope dv/ds is taken
    over the way of twice the time m3 / (3 m2), over which the machine sees it.
    """
    behind = path.arc_length - time * speed
    if path.lap is None:
        # A part of a path knows no more than the points within `length`.
        first = np.searchsorted(path.arc_length, path.arc_length - length * WINDOW_EDGE)
        np.maximum(behind, path.arc_length[first], out=behind)
    earlier = np.interp(behind, path.arc_length, speed, period=path.lap)
    return np.clip(0.5 * (earlier / speed + 1.0), SHARE_MIN, SHARE_MAX)


def gentle(path: SampledPath, speed: Array, slope: float) -> Array:
    """Return the speeds lowered so far that they fall by no more than a slope along the path.

    What brakes at v dv/ds = -slope v comes to a slow place with the lag of that place, times a
    constant, however fast it was before; steeper braking still lags by what it was.

    Parameters
    ----------
    path : SampledPath
        Path of m points.
    speed : ndarray, shape (m,)
        Speeds [m/s].
    slope : float
        Largest fall of the speed along the path [1/s], positive.

    Returns
    -------
    ndarray, shape (m,)
        Speeds [m/s], not above those given.
    """
    arc, wanted = path.arc_length, speed
    if path.lap is not None:  # the second round tells the first what comes behind its end
        arc, wanted = np.append(arc, arc + path.lap), np.append(wanted, wanted)
    drop = slope * (arc - arc[0])
    least = np.minimum.accumulate((wanted + drop)[::-1])[::-1] - drop
    return np.asarray(np.minimum(speed, least[: len(speed)]))
