# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a planner goes by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
from fuzzycnc_ros.core.feedrate.planner.feeds import check_streamable
from fuzzycnc_ros.core.feedrate.schedulers.plain import Scheduler


@dataclass(frozen=True)
class PlannerSettings:
    """What a planner goes by.

    Attributes
    ----------
    scheduler : Scheduler
        Feed along the path; one that can take a path in parts.
    limits : MotionLimits
        Limits of path and axes.
    override : float
        Feed override, 0 or more; 0 holds the feed.
    period : float
        Time between two samples [s].
    window : float or None
        Length of the average [s]; None for what suits the limits, `default_window`.
    settle : float
        Rest at every exact stop within the path besides the programmed one [s].

    Raises
    ------
    ValueError
        If a number is out of its range or the scheduler needs the whole path.
    """

    scheduler: Scheduler
    limits: MotionLimits
    override: float = 1.0
    period: float = 1e-3
    window: float | None = None
    settle: float = 0.0

    def __post_init__(self) -> None:
        for name, unit in (('override', ''), ('settle', ' s')):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ValueError(f'{name}: expected 0{unit} or more, but found {value}')
        for name in ('period', 'window'):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise ValueError(f'{name}: expected a positive number of s, but found {value}')
        check_streamable(self.scheduler)
