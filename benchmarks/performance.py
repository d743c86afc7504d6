# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One table: this package beside libraries that do the same work, in one run.

Each row is done by both, in turn, on the same input; the ratio of their times is what counts, and
how far apart their results are.  A library that is not installed is named and left out:
`pip install toppra geomdl splinepy scikit-fuzzy networkx scikit-learn` brings all of them, rclpy
comes with ROS.  It takes about a minute; figures mean something on an idle host only, whose load
is printed.  Run with `make bench`, or with `python benchmarks/performance.py`.
"""

import os

# One thread each, set before numpy starts its pool: algorithms are compared, not thread pools.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

import platform
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

REPEATS = 5
EXECUTOR_ROUNDS = 3
CURVE_POINTS = 100_000
PIECES = 1000
ACCELERATION, VELOCITY = 4.0, 0.25

HEAD = ('work', 'unit', 'fuzzycnc', 'other', 'ratio', 'results')


@dataclass(frozen=True)
class Found:
    """What both took, in the unit of the row, and how their results compare."""

    own: float
    other: float
    results: str


@dataclass(frozen=True)
class Row:
    """Work that another library does as well.

    Parameters
    ----------
    work : str
        What is done.
    library : str
        Who else does it.
    unit : str
        Unit of both figures; with `/s` more is better.
    measure : callable
        Does it; raises `ImportError` where the library is absent.
    """

    work: str
    library: str
    unit: str
    measure: Callable[[], Found]

    def cells(self) -> tuple[str, ...]:
        """Measure, and return the cells of the table's row."""
        work = f'{self.work}, beside {self.library}'
        try:
            found = self.measure()
        except ImportError as error:
            return work, self.unit, '', '', '', f'not compared: {error}'
        better = found.own / found.other if '/s' in self.unit else found.other / found.own
        figures = (digits(found.own), digits(found.other), digits(better))
        return work, self.unit, *figures, found.results


def in_turn(
    own: Callable[[], Any], other: Callable[[], Any], repeats: int = REPEATS
) -> tuple[float, float]:
    """Return the median seconds of both, called in turn."""
    seconds = []
    for _ in range(repeats):
        pair = []
        for call in (own, other):
            begin = perf_counter()
            call()
            pair.append(perf_counter() - begin)
        seconds.append(pair)
    return median(one for one, _ in seconds), median(other for _, other in seconds)


def executor() -> Found:
    """Two processes that answer each other: round trips per second."""
    from bench_executor import ping_pong

    trips = [[ping_pong(kind) for kind in ('lean', 'rclpy')] for _ in range(EXECUTOR_ROUNDS)]
    own, other = (median(column) for column in zip(*trips, strict=True))
    return Found(own, other, 'the same messages in the same order')


def motion() -> Found:
    """Find the fastest motion along the butterfly within limits of both axes [ms]."""
    import toppra
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint
    from toppra.interpolator import AbstractGeometricPath

    from fuzzycnc_ros.core.feedrate.motion.limits import MotionLimits
    from fuzzycnc_ros.core.feedrate.motion.trajectory import limit_motion
    from fuzzycnc_ros.core.feedrate.path.curves import butterfly
    from fuzzycnc_ros.core.feedrate.path.path_geometry import PathGeometry

    curve = butterfly()
    grid = np.linspace(0.0, 1.0, PIECES + 1)
    first, second = curve.derivative(grid), curve.derivative(grid, 2)
    square = (first**2).sum(axis=1, keepdims=True)
    bend = (second - first * (first * second).sum(axis=1, keepdims=True) / square) / square
    geometry = PathGeometry.from_samples(curve.point(grid), first, bend)
    limits = MotionLimits(velocity=(VELOCITY,) * 2, acceleration=(ACCELERATION,) * 2)

    class Path(AbstractGeometricPath):
        """The curve, as TOPP-RA wants it."""

        dof = 2
        path_interval = np.array([0.0, 1.0])
        waypoints = None

        def __call__(self, path_positions: np.ndarray, order: int = 0) -> np.ndarray:
            return (
                curve.derivative(path_positions, order) if order else curve.point(path_positions)
            )

    toppra.setup_logging('ERROR')
    both = np.outer(np.ones(2), [-1.0, 1.0])

    def theirs() -> float:
        search = TOPPRA(
            [
                JointVelocityConstraint(VELOCITY * both),
                JointAccelerationConstraint(ACCELERATION * both),
            ],
            Path(),
            gridpoints=grid,
            solver_wrapper='seidel',
        )
        speed = search.compute_parameterization(0.0, 0.0)[1]
        return float((2.0 * np.diff(grid) / (speed[1:] + speed[:-1])).sum())

    def ours() -> float:
        return limit_motion(geometry, 10.0, limits).duration

    own, other = in_turn(ours, theirs)
    return Found(1e3 * own, 1e3 * other, f'{ours():.3f} s and {theirs():.3f} s of motion')


def evaluation(library: str) -> Found:
    """Points of a NURBS curve [us each]."""
    import bench_nurbs

    ours = bench_nurbs.butterfly().point
    theirs = getattr(bench_nurbs, f'{library}_curve')()
    u = np.linspace(0.0, 1.0, CURVE_POINTS)
    apart = float(np.abs(ours(u) - theirs(u)).max())
    own, other = bench_nurbs.seconds_per_point([(ours, u), (theirs, u)])
    return Found(1e6 * own, 1e6 * other, f'{apart:.0e} m apart')


def clustering() -> Found:
    """Fuzzy c-means [ms a start]."""
    import bench_fcm

    points = bench_fcm.features()
    _, least = bench_fcm.ours(points)
    _, other_least = bench_fcm.theirs(points)
    own, other = in_turn(lambda: bench_fcm.ours(points), lambda: bench_fcm.theirs(points))
    starts = bench_fcm.STARTS
    return Found(
        1e3 * own / starts,
        1e3 * other / starts,
        f'objectives {abs(least / other_least - 1):.0e} apart',
    )


def inference() -> Found:
    """Mamdani inference [us a pair]."""
    import bench_mamdani

    system = bench_mamdani.FuzzyScheduler(feed_max=1.0).system
    infer = bench_mamdani.their_inference(system)
    rng = np.random.default_rng(0)
    many, few = bench_mamdani.PAIRS, bench_mamdani.THEIR_PAIRS
    pairs = rng.uniform(0.0, 3000.0, many), rng.uniform(0.0, 1.0, many)
    part = pairs[0][:few], pairs[1][:few]
    apart = float(np.abs(infer(*part) - system(*part)).max())
    own, other = in_turn(lambda: system(*pairs), lambda: infer(*part), 3)
    return Found(1e6 * own / many, 1e6 * other / few, f'{apart:.0e} apart')


def network() -> Found:
    """Training of a network of 30 hidden nodes to the training error of the other [ms]."""
    import bench_networks

    run = bench_networks.record_grinder(['E1'])['E1']
    rise = run.rise(run.temperature[0])
    inputs, target = bench_networks.network_data(rise, run.displacement[:, 0])
    wanted = bench_networks.theirs('lbfgs', True, inputs, target, 1000)[1]

    def ours(cap: int) -> tuple[float, float]:
        return bench_networks.ours(inputs, target, cap)

    def theirs(cap: int) -> tuple[float, float]:
        return bench_networks.theirs('lbfgs', True, inputs, target, cap)

    own = bench_networks.time_to(wanted, ours, bench_networks.OUR_CAPS, REPEATS)
    other = bench_networks.time_to(wanted, theirs, bench_networks.LBFGS_CAPS, REPEATS)
    return Found(1e3 * own[1], 1e3 * other[1], f'errors {own[2]:.4f} and {other[2]:.4f} um')


ROWS = (
    Row('Empty loop of two nodes', "rclpy's executor", 'round trips/s', executor),
    Row('Fastest motion on 1000 pieces within limits of axes', 'toppra', 'ms', motion),
    Row('100,000 points of a NURBS curve', 'geomdl', 'us a point', lambda: evaluation('geomdl')),
    Row(
        '100,000 points of a NURBS curve', 'splinepy', 'us a point', lambda: evaluation('splinepy')
    ),
    Row('Fuzzy c-means of 76 sensors', 'scikit-fuzzy', 'ms a start', clustering),
    Row('Mamdani inference', 'scikit-fuzzy', 'us a pair', inference),
    Row('Training of a 3-30-1 network', 'scikit-learn', 'ms', network),
)


def digits(value: float) -> str:
    """Return a figure with three digits that count, and no exponent."""
    return f'{value:,.0f}' if value >= 100.0 else f'{value:#.3g}'


def line(cells: tuple[str, ...]) -> str:
    """Return a row of the table."""
    return f'| {" | ".join(cells)} |'


def main() -> None:
    """Print the table."""
    load = os.getloadavg()[0]
    cores = f'{os.cpu_count()} cores, load {load:.2f} before the run'
    print(f'{platform.machine()}, Python {platform.python_version()}, {cores}', end='\n\n')
    print(line(HEAD))
    print(line(('---', '---', '---:', '---:', '---:', '---')))
    for row in ROWS:
        print(line(row.cells()), flush=True)


if __name__ == '__main__':
    main()
