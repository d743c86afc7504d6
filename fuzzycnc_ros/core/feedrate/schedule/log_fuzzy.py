# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzy scheduler of the feed with dimensionless logarithmic inputs, which keeps a tolerance."""

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.path.windows import window_maximum
from fuzzycnc_ros.core.feedrate.schedule.approach import APPROACH, approach_share, gentle
from fuzzycnc_ros.core.feedrate.schedule.fuzzy import (
    CURVATURE_SETS,
    RATIO_SETS,
    VARIATION_SETS,
)
from fuzzycnc_ros.core.feedrate.schedule.plain import (
    CURVATURE_FLOOR,
    WHOLE_PATH,
    Reach,
    Scheduler,
)
from fuzzycnc_ros.core.fuzzy.mamdani import Mamdani, memberships, tabulated

GAP_MIN = 0.3  # least one between the centres of the logarithmic sets [decades]


@dataclass(frozen=True, kw_only=True, repr=False)
class LogFuzzyScheduler(Scheduler):
    """Fuzzy feed that keeps a contour tolerance, method sheet 002 section 7.

    The first input is log10(curvature feed_max^2 C / tolerance): how many decades of contour
    error full feed would leave above the tolerance, with what the approach to each point adds.
    The output is the logarithm of the ratio.  All of them are free of units, so that a path and
    its enlargement get the same ratios.

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
        Curvature for which the sets are spread [1/m], positive; None for the largest of the
        path.  Needed where a path is scheduled in parts; above it the feed goes on falling with
        the root of the curvature.
    braking : int
        Sets by which the feed is lowered where the curvature is about to rise by two gaps of the
        first input's sets, 0 to 6; 0 leaves the second input without effect.
    braking_points : int
        How many points before and after the second input sees, at least 1.
    defuzzifier : str
        `mean`: of the levels of all rules, weighted by the product of their memberships, so
        that the rules follow curvature^-1/2; `centroid`, which ripples about it.
    exact : bool
        Whether to infer each point's centroid instead of looking it up in a table.

    Notes
    -----
    The sheet takes the centroid, knows no approach and designs for the tolerance over 1.3.  So,
    with a margin of 1.25, the errors of its five shapes, 2000 points each, lie between 0.88 and
    1.04 times the tolerance; with the approach, whose time and margin were chosen on other
    curves, between 0.97 and 1.00, in 6 % less time.  Without the guard they reach 1.24.

    Examples
    --------
    >>> circle = np.full(3, 500.0), np.array([0.0, 0.01, 0.02])
    >>> scheduler = LogFuzzyScheduler(feed_max=0.2, tolerance=5e-5, machine_constant=2.15e-4)
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
    braking: int = 0
    braking_points: int = 4
    defuzzifier: str = 'mean'
    exact: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_positive('tolerance', 'machine_constant')
        if self.curvature_max is not None:
            self._check_positive('curvature_max')
        self._check_points('braking_points')
        self._check_choice('defuzzifier', ('mean', 'centroid'))
        for name, low, high in (
            ('margin', 1.0, inf),
            ('approach_time', 0.0, inf),
            ('approach_slope', 0.0, inf),
            ('guard_length', 0.0, inf),
            ('guard_time', 0.0, inf),
            ('guard_step', 0.0, 1.0),
            ('braking', 0, len(RATIO_SETS) - 1),
        ):
            value = getattr(self, name)
            if value is not None and (not low <= value <= high or value == inf):
                raise ValueError(
                    f'LogFuzzyScheduler: {name}: expected a number from {low} to {high}, '
                    f'but found {value}'
                )

    @property
    def system(self) -> Mamdani:
        """Rules from the two inputs to the logarithm of the ratio, all over the gap of the sets.

        Each set of the first input lowers the output by half a gap: v ~ curvature^-1/2.
        """
        levels = len(RATIO_SETS) - 1
        last = len(VARIATION_SETS) - 1
        rules = tuple(
            tuple(
                max(levels - row - (self.braking * column + last // 2) // last, 0)
                for column in range(last + 1)
            )
            for row in range(len(CURVATURE_SETS))
        )
        return Mamdani(
            tuple(float(i) for i in range(len(CURVATURE_SETS))),
            tuple(0.5 * i for i in range(len(VARIATION_SETS))),
            tuple(0.5 * (i - levels) for i in range(len(RATIO_SETS))),
            rules,
        )

    @property
    def reach(self) -> Reach:
        """Guard, approach and the second input; all of it if the path spreads the sets."""
        if self.curvature_max is None:
            return WHOLE_PATH
        points = (1 if self.guard_step else 0) + (self.braking_points if self.braking else 0)
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
        """How far behind a point the approach to it can begin [m]."""
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
        full = self.feed_max**2 * self.machine_constant * self.margin / self.tolerance
        return np.asarray(np.log10(full * np.maximum(curvature, CURVATURE_FLOOR)))

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
        return np.maximum(near, own ** (1.0 - self.guard_step) * largest**self.guard_step)

    def _ratio(self, path: SampledPath) -> Array:
        near = self._near(path)
        excess = self.excess(self._beside(path, near))
        rise = np.zeros(len(excess))
        if self.braking:
            points = self.braking_points
            rise = window_maximum(excess, points, points, closed=path.closed) - excess
        if self._approach_time:
            speed = self.feed_max * 10.0 ** (-0.5 * np.maximum(self.excess(near), 0.0))
            if path.programmed is not None:
                speed = np.minimum(speed, path.programmed)
            reach = self._approach_time, self._approach_length
            excess += np.log10(approach_share(path, speed, *reach))
        worst = excess.max()
        if self.curvature_max is not None:
            worst = self.excess(np.array(self.curvature_max))
        # A little room, so that the sharpest point does not saturate
        gap = max(GAP_MIN, 1.02 * float(worst) / (len(CURVATURE_SETS) - 1))
        decades = gap * self._infer(excess / gap, rise / gap)
        # Beyond the last set, which only a given `curvature_max` leaves, the law goes on.
        decades -= 0.5 * np.maximum(excess - gap * (len(CURVATURE_SETS) - 1), 0.0)
        ratio: Array = 10.0**decades
        if self._approach_slope:
            return gentle(path, ratio, self._approach_slope / self.feed_max)
        return ratio

    def _infer(self, excess: Array, rise: Array) -> Array:
        """Return the levels of the output; they and the inputs are over the gap of the sets."""
        system = self.system
        if self.defuzzifier == 'centroid':
            return (system if self.exact else tabulated(system))(excess, rise)
        level = np.array(system.output)[np.array(system.rules)]
        if not self.braking:
            return np.asarray(np.interp(excess, system.first, level[:, 0]))
        row, column = memberships(excess, system.first), memberships(rise, system.second)
        return np.asarray((row * (level @ column)).sum(axis=0))
