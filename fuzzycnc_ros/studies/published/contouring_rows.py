# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of the tables 10 to 12 of [lin2021]: three shapes under four schedulers, driven here."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.feedrate.path.curves import butterfly, infinity, trident
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.schedule.scheduler import Scheduler
from fuzzycnc_ros.papers.feedrate import (
    ChordErrorFeed,
    FuzzyScheduler,
    JerkLimitedFeed,
    LookAheadFeed,
)
from fuzzycnc_ros.simulation.motion.contour import Contour
from fuzzycnc_ros.simulation.motion.contouring import ContouringRun, simulate_contouring

CURVES = {'infinity': infinity(0.65), 'trident': trident(2.3), 'butterfly': butterfly(0.875)}
"""Shapes in the sizes that were cut."""

METHODS: dict[str, type[Scheduler]] = {
    'Luan': LookAheadFeed,
    'Yeh-Hsu': ChordErrorFeed,
    'Giannelli': JerkLimitedFeed,
    'fuzzy': FuzzyScheduler,
}
"""Schedulers by the names of the tables."""


class ContouringRow(NamedTuple):
    """A published row: shape, method, feed [mm/min], largest error [mm], time [s]."""

    shape: str
    method: str
    feed: float
    error_max: float
    duration: float

    def driven(self) -> ContouringRun:
        """Return the run of the same rule at the same feed on the simulated machine."""
        scheduler = METHODS[self.method](feed_max=self.feed / 60e3)
        return drive(self.shape, scheduler.feed(sampled(self.shape)[2]))


ROWS = (
    ContouringRow('infinity', 'Luan', 300, 0.097, 62),
    ContouringRow('infinity', 'Yeh-Hsu', 300, 0.052, 122),
    ContouringRow('infinity', 'Giannelli', 300, 0.012, 907),
    ContouringRow('infinity', 'fuzzy', 300, 0.056, 62),
    ContouringRow('trident', 'Luan', 300, 0.071, 46),
    ContouringRow('trident', 'Yeh-Hsu', 300, 0.022, 127),
    ContouringRow('trident', 'Giannelli', 150, 0.006, 599),
    ContouringRow('trident', 'fuzzy', 300, 0.042, 45),
    ContouringRow('trident', 'fuzzy', 150, 0.022, 92),
    ContouringRow('butterfly', 'Luan', 300, 0.09, 73),
    ContouringRow('butterfly', 'Yeh-Hsu', 185, 0.061, 120),
    ContouringRow('butterfly', 'Giannelli', 58, 0.028, 729),
    ContouringRow('butterfly', 'fuzzy', 300, 0.061, 67),
    ContouringRow('butterfly', 'fuzzy', 185, 0.042, 109),
    ContouringRow('butterfly', 'fuzzy', 58, 0.024, 360),
)
"""Rows of tables 10 to 12."""


@cache
def sampled(shape: str, count: int = 2000) -> tuple[Contour, Array, SampledPath]:
    """Return contour, arc lengths and path of points at equal steps of the parameter."""
    point = CURVES[shape].point
    part = np.linspace(0.0, 1.0, count)
    contour = Contour.curve(point)
    return contour, contour.arc_length(part), SampledPath.from_points(point(part))


def drive(shape: str, feed: ArrayLike, count: int = 2000) -> ContouringRun:
    """Return what the simulated machine makes of feeds at the points of a shape [m/s]."""
    contour, arc_length, _ = sampled(shape, count)
    return simulate_contouring(contour, arc_length, feed)
