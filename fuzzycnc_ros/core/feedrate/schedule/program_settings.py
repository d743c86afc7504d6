# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Settings for the scheduling of a part program."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.schedule.feeds import desired_feed
from fuzzycnc_ros.core.feedrate.schedule.scheduler import Scheduler

AXIS_COUNT = 3
"""Axes of a part program: X, Y and Z."""


@dataclass(frozen=True, kw_only=True)
class ProgramSettings:
    """Settings for the scheduling of a part program.

    Parameters
    ----------
    scheduler : Scheduler
        Rule that chooses the feed.
    limits : MotionLimits
        Limits of the path and of X, Y and Z; times are those of a motion that keeps them.
    machine_constant : float
        Contour error over normal acceleration [s^2]; serves the expected contour errors.
    curvature_max : float, optional
        Curvature from which a bend counts as no sharper [1/m].  Absent, that whose radius is the
        scheduler's tolerance, where it knows one: such a bend may be rounded off.
    blend : float
        Largest distance of the path from a corner that it rounds [m]; 0 stops at each corner.
    own_corners : bool
        Where the program says how far its corners may be rounded off (G64 P, G61), that counts
        instead of `blend`.
    override : float
        Factor of the feed, above 0.  Above 1 it lifts the bound of the program, not the feed
        that keeps the tolerance.
    feed : float, optional
        Upper bound of the feed instead of the program's feeds [m/s].
    settle : float
        Rest at each exact stop [s].
    feed_step : float
        Neighbouring blocks share a feed where theirs differ by no more than this share, so that
        few feed words are written [-].
    window : float, optional
        Time over which acceleration is averaged where jerk is limited [s]; chosen if absent.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    scheduler: Scheduler
    limits: MotionLimits
    machine_constant: float = 2.1517e-4
    curvature_max: float | None = None
    blend: float = 0.0
    own_corners: bool = True
    override: float = 1.0
    feed: float | None = None
    settle: float = 0.0
    feed_step: float = 0.05
    window: float | None = None

    def __post_init__(self) -> None:
        for name, zero in (
            ('machine_constant', False),
            ('curvature_max', False),
            ('override', False),
            ('feed', False),
            ('window', False),
            ('blend', True),
            ('settle', True),
            ('feed_step', True),
        ):
            value = getattr(self, name)
            if value is None:
                continue
            if not isfinite(value) or value < 0.0 or (value == 0.0 and not zero):
                wanted = '0 or more' if zero else 'above 0'
                raise ValueError(f'{name}: expected a number {wanted} but found {value}')

    def rounding(self, own: float | None) -> float:
        """Return how far corners are rounded off where the program says `own`, or None [m]."""
        return own if own is not None and self.own_corners else self.blend

    @property
    def sharpest(self) -> float:
        """Curvature from which a bend counts as no sharper [1/m]; infinite for none."""
        if self.curvature_max is not None:
            return self.curvature_max
        tolerance = getattr(self.scheduler, 'tolerance', None)
        return inf if tolerance is None else 1.0 / float(tolerance)

    def bound(self, feed: Array) -> Array:
        """Return the upper bounds of programmed feeds [m/s]."""
        return feed if self.feed is None else np.full_like(feed, self.feed)

    def wanted(self, ratio: Array, bound: Array) -> Array:
        """Return the feeds that a scheduler's ratios and the program's bounds ask for [m/s].

        Parameters
        ----------
        ratio : ndarray
            The scheduler's ratios.
        bound : ndarray
            Upper bounds of the feed in the same places [m/s].

        Returns
        -------
        ndarray
            Feeds, the override counted in.
        """
        scheduled = self.scheduler.feed_max * ratio
        return desired_feed(self.scheduler, scheduled, bound, self.override)

    def reachable(self, tangent: Array) -> Array:
        """Return the feeds that the velocity limits admit, shape (m,) [m/s].

        Parameters
        ----------
        tangent : ndarray, shape (m, d)
            Largest share of each axis in the way of each piece [-].
        """
        velocity = self.limits.table(tangent.shape[1])[0]
        with np.errstate(divide='ignore'):
            axes = (velocity[1:] / tangent).min(axis=1)
        return np.asarray(np.minimum(axes, velocity[0]))
