# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Feed v = sqrt(tolerance / (margin C curvature)), which keeps a contour tolerance.

What braking into a bend adds to the contour error, and speeding up out of it takes away, counts
as curvature (`approach_share`).
"""

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.sampled_path import WINDOW_EDGE, SampledPath
from fuzzycnc_ros.core.feedrate.path.windows import window_maximum
from fuzzycnc_ros.core.feedrate.schedule.scheduler import (
    CURVATURE_FLOOR,
    WHOLE_PATH,
    Reach,
    Scheduler,
)

APPROACH = 1.9
"""Time over which a machine sees how the speed changes, over the root of its constant C."""

SHARE_MIN, SHARE_MAX = 0.5, 4.0
"""Bounds of the share.

The lower one is that of a path left from rest; the upper one is reached where a tight arc follows
a line: with 1.5 such arcs of 0.5 mm leave twice a tolerance of 10 um.
"""


@dataclass(frozen=True, kw_only=True, repr=False)
class ToleranceFeed(Scheduler):
    """Feed v = sqrt(tolerance / (margin C curvature)), with a guard and an approach to bends.

    A machine whose contour error is C times its normal acceleration keeps the tolerance by it. The
    law comes from a fuzzy scheduler (docs/explanation/methods/feedrate.md) whose inputs have no
    units: log10(curvature feed_max^2 C / tolerance), how many decades of contour error full feed
    would leave above the tolerance, against the logarithm of the ratio.  Weighted by their
    memberships, its rules lie on this straight line (`benchmarks/fuzzy_worth_feedrate.py`), so
    that none are left.  A path and its enlargement get the same ratios.

    Parameters
    ----------
    tolerance : float
        Largest contour error wanted [m], positive.
    machine_constant : float
        Contour error over normal acceleration, C [s^2], positive.
    margin : float
        The feed is designed for the tolerance over this number, at least 1.
    approach_time : float or None
        Time over which the machine sees how the speed changes [s], which adds to the contour
        error before a bend and takes from it after; 0 for none, None for 1.9 sqrt(C).
    approach_slope : float or None
        Largest fall of the speed along the path [1/s], so that what brakes into a tight bend has
        caught up before it; 0 for any, None for 1 / sqrt(C).
    guard_length : float
        Each point takes the largest curvature up to this arc length before and after it [m], 0
        for none: peaks narrower than the machine's reaction are met in full.
    guard_time : float
        But no farther than the feed at the sharpest point goes in this time [s]: about four
        times that of the machine's reaction.
    guard_step : float
        Each point also takes the curvature this part of the way to its neighbours, 0 to 1: what
        may lie between samples.  The logarithm of the curvature is taken as linear there.
    curvature_max : float or None
        Curvature that the guard reckons with at most [1/m], positive; None for the largest of the
        path.  Needed where a path is scheduled in parts; the law holds above it too.

    Notes
    -----
    The fuzzy form takes centroids, which ripple about the law by up to 5 %, knows no approach and
    designs for the tolerance over 1.3.  So, with a margin of 1.25, the errors of its five shapes,
    2000 points each, lie between 0.88 and 1.04 times the tolerance; with the approach, whose time
    and margin were chosen on other curves, between 0.97 and 1.00, in 6 % less time.  Without the
    guard they reach 1.24.

    Examples
    --------
    >>> circle = np.full(3, 500.0), np.array([0.0, 0.01, 0.02])
    >>> scheduler = ToleranceFeed(feed_max=0.2, tolerance=5e-5, machine_constant=2.15e-4)
    >>> feed = 0.2 * scheduler.ratio(*circle)
    >>> (1e6 * scheduler.margin * 2.15e-4 * 500.0 * feed**2).round().tolist()
    [50.0, 50.0, 50.0]
    """

    tolerance: float
    machine_constant: float
    margin: float = 1.05
    approach_time: float | None = None
    approach_slope: float | None = None
    guard_length: float = 60e-6
    guard_time: float = 0.1
    guard_step: float = 0.5
    curvature_max: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_positive('tolerance', 'machine_constant')
        if self.curvature_max is not None:
            self._check_positive('curvature_max')
        for name, low, high in (
            ('margin', 1.0, inf),
            ('approach_time', 0.0, inf),
            ('approach_slope', 0.0, inf),
            ('guard_length', 0.0, inf),
            ('guard_time', 0.0, inf),
            ('guard_step', 0.0, 1.0),
        ):
            value = getattr(self, name)
            if value is not None and (not low <= value <= high or value == inf):
                raise ValueError(
                    f'ToleranceFeed: {name}: expected a number from {low} to {high}, '
                    f'but found {value}'
                )

    @property
    def reach(self) -> Reach:
        """Guard and approach; the whole path if its largest curvature bounds the guard."""
        if self.curvature_max is None:
            return WHOLE_PATH
        points = 1 if self.guard_step else 0
        behind = self.guard_length + self._approach_length
        ahead = self.guard_length
        if self._approach_slope:  # from there full feed may fall to nothing
            ahead += self.feed_max / self._approach_slope
        return Reach(points, points, behind, ahead)

    @property
    def _approach_time(self) -> float:
        """Time over which the machine sees how the speed changes [s]."""
        if self.approach_time is None:
            return APPROACH * sqrt(self.machine_constant)
        return self.approach_time

    @property
    def _approach_slope(self) -> float:
        """Largest fall of the speed along the path [1/s]; 0 for any."""
        if self.approach_slope is None:
            return 1.0 / sqrt(self.machine_constant)
        return self.approach_slope

    @property
    def _approach_length(self) -> float:
        """Largest distance behind a point at which the approach to it can begin [m]."""
        return self._approach_time * self.feed_max

    def excess(self, curvature: Array) -> Array:
        """Return the decades of contour error above the design tolerance at full feed.

        Parameters
        ----------
        curvature : ndarray
            Curvature [1/m]; below 1e-9 1/m it counts as that.

        Returns
        -------
        ndarray
            Decades in the shape of the curvature.
        """
        full = self.feed_max * self.feed_max * self.machine_constant * self.margin / self.tolerance
        return np.asarray(portable.log10(full * np.maximum(curvature, CURVATURE_FLOOR)))

    def guarded(self, path: SampledPath) -> Array:
        """Return the curvature that each point is scheduled for.

        Parameters
        ----------
        path : SampledPath
            Path of m points.

        Returns
        -------
        ndarray, shape (m,)
            Curvature [1/m], at least 1e-9 1/m and at least that of the path.
        """
        return self._beside(path, self._near(path))

    def _near(self, path: SampledPath) -> Array:
        """Return the largest curvature within the guard's length [1/m]."""
        own = np.maximum(path.curvature, CURVATURE_FLOOR)
        sharpest = self.curvature_max or float(own.max())
        slowest = sqrt(self.tolerance / (self.machine_constant * sharpest))
        length = min(self.guard_length, self.guard_time * min(slowest, self.feed_max))
        return np.maximum(own, path.largest_within(length, length)) if length else own

    def _beside(self, path: SampledPath, near: Array) -> Array:
        """Return the larger of that and of what may lie between samples [1/m]."""
        if not self.guard_step:
            return near
        own = np.maximum(path.curvature, CURVATURE_FLOOR)
        largest = window_maximum(own, 1, 1, closed=path.closed)
        return np.maximum(near, own * portable.power(largest / own, self.guard_step))

    def _ratio(self, path: SampledPath) -> Array:
        near = self._near(path)
        excess = self.excess(self._beside(path, near))
        if self._approach_time:
            speed = self.feed_max * _share(self.excess(near))
            if path.programmed is not None:
                speed = np.minimum(speed, path.programmed)
            reach = self._approach_time, self._approach_length
            excess += portable.log10(approach_share(path, speed, *reach))
        return self._gentle(path, _share(excess))

    def _gentle(self, path: SampledPath, ratio: Array) -> Array:
        """Return the ratios lowered so far that the speed falls by no more than the slope.

        What brakes at v dv/ds = -slope v comes to a slow place with the lag of that place, times a
        constant, however fast it was before; steeper braking still lags by what it was.
        """
        if not self._approach_slope:
            return ratio
        arc, wanted = path.arc_length, ratio
        if path.lap is not None:  # the second round tells the first what comes behind its end
            arc, wanted = np.append(arc, arc + path.lap), np.append(wanted, wanted)
        drop = self._approach_slope / self.feed_max * (arc - arc[0])
        least = np.minimum.accumulate((wanted + drop)[::-1])[::-1] - drop
        return np.asarray(np.minimum(ratio, least[: len(ratio)]))


_LN10 = portable.log(10.0)


def _share(excess: Array) -> Array:
    """Return the ratio for an excess in decades: v ~ curvature^-1/2, full feed without any."""
    return portable.exp(-0.5 * _LN10 * np.maximum(excess, 0.0))


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
