# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Scheduling of a million points: curvature, feed, and the pass that limits path acceleration.

One run prints what each scheduler takes from points to speeds, and the parts of it.  The pass
within the limits of every axis works on curved pieces instead of points, and is timed beside
it on the butterfly's pieces.  Run with `python benchmarks/bench_scheduling.py`.
"""

import os

# One thread each, set before numpy starts its pool: algorithms are compared, not thread pools.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

from collections.abc import Callable
from statistics import median
from time import perf_counter

import numpy as np

from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits, reachable_speed
from fuzzycnc_ros.core.feedrate.motion.trajectory import limit_motion
from fuzzycnc_ros.core.feedrate.path.curves import butterfly
from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry
from fuzzycnc_ros.core.feedrate.path.sampled_path import SampledPath
from fuzzycnc_ros.core.feedrate.schedule.tolerance_feed import ToleranceFeed
from fuzzycnc_ros.papers.feedrate import FuzzyScheduler

POINTS, PIECES, REPEATS = 1_000_000, 20_000, 5
RATE_MIN = 1.5e6
PATH_ACCELERATION = 1.5


def seconds(function: Callable[[], object]) -> float:
    """Return the median time of a call."""
    times = []
    for _ in range(REPEATS):
        begin = perf_counter()
        function()
        times.append(perf_counter() - begin)
    return median(times)


def main() -> int:
    """Print points per second; fail if they are not enough."""
    curve = butterfly(0.875)
    points = curve.point(np.linspace(0.0, 1.0, POINTS))
    path = SampledPath.from_points(points)
    print(f'curvature           {1e6 * seconds(lambda: SampledPath.from_points(points)):8.0f} us')
    enough = True
    for scheduler in (
        FuzzyScheduler(feed_max=0.05),
        ToleranceFeed(feed_max=0.2, tolerance=5e-5, machine_constant=2.15e-4),
    ):

        def schedule(scheduler=scheduler) -> np.ndarray:
            found = SampledPath.from_points(points)
            return reachable_speed(found.arc_length, scheduler.feed(found), PATH_ACCELERATION)

        feed = scheduler.feed(path)
        parts = {
            'feed': lambda scheduler=scheduler: scheduler.feed(path),
            'pass': lambda feed=feed: reachable_speed(path.arc_length, feed, PATH_ACCELERATION),
        }
        for name, part in parts.items():
            print(f'{type(scheduler).__name__:<19} {1e6 * seconds(part):8.0f} us  {name}')
        rate = POINTS / seconds(schedule)
        enough &= rate >= RATE_MIN
        print(
            f'{type(scheduler).__name__:<19} {rate / 1e6:8.2f} million points/s in all '
            f'(at least {RATE_MIN / 1e6:g} expected)'
        )
    at = np.linspace(0.0, 1.0, PIECES + 1)
    point, first, second = curve.point(at), curve.derivative(at), curve.derivative(at, 2)
    square = (first**2).sum(axis=1, keepdims=True)
    bend = (second - first * (first * second).sum(axis=1, keepdims=True) / square) / square
    geometry = PathGeometry.from_samples(point, first, bend)
    limits = MotionLimits(path_velocity=0.25, path_acceleration=1.5, acceleration=(4.0, 4.0))
    rate = PIECES / seconds(lambda: limit_motion(geometry, 0.2, limits))
    print(f'limits of the axes  {rate / 1e6:8.2f} million pieces/s')
    return 0 if enough else 1


if __name__ == '__main__':
    raise SystemExit(main())
