# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of NURBS curves, beside geomdl and splinepy in one run.

All take the butterfly at equal steps of its parameter, on one thread; the ratio of the times per
point is what counts, and that the points agree.  Then the time of curvature from samples, beside
evaluation.  Needs geomdl and splinepy (`pip install geomdl splinepy`); one that is missing is
not compared.  Run with `python benchmarks/bench_nurbs.py`.
"""

import os

# One thread each, set before numpy starts its pool: algorithms are compared, not thread pools.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

from collections.abc import Callable, Sequence
from time import perf_counter

import numpy as np

from fuzzycnc_ros.core.feedrate.path.curves import butterfly
from fuzzycnc_ros.core.feedrate.path.sampled_path import curvature

POINTS = (2_000, 100_000, 1_000_000)
POINTS_GEOMDL = 100_000
PASSES = 7
RATIO_GEOMDL_MIN = 200.0
RATIO_SPLINEPY_MIN = 1.0
AGREEMENT = 1e-14  # of the points, relative to the size of the curve

Evaluate = Callable[[np.ndarray], np.ndarray]


def geomdl_curve() -> Evaluate:
    """Return the evaluation of geomdl [m]."""
    from geomdl import NURBS

    ours = butterfly()
    curve = NURBS.Curve()
    curve.degree = ours.degree
    curve.ctrlptsw = np.column_stack(
        [ours.control * ours.weight[:, np.newaxis], ours.weight]
    ).tolist()
    curve.knotvector = ours.knot.tolist()

    def evaluate(u: np.ndarray) -> np.ndarray:
        # Its sampling at equal steps is faster than `evaluate_list` with the same parameters.
        curve.sample_size = len(u)
        curve.evaluate()
        return np.array(curve.evalpts)

    return evaluate


def splinepy_curve() -> Evaluate:
    """Return the evaluation of splinepy [m]."""
    import splinepy

    ours = butterfly()
    curve = splinepy.NURBS(
        degrees=[ours.degree],
        knot_vectors=[ours.knot.tolist()],
        control_points=ours.control.copy(),
        weights=ours.weight[:, np.newaxis].copy(),
    )
    return lambda u: np.asarray(curve.evaluate(u[:, np.newaxis], nthreads=1))


def seconds_per_point(tasks: list[tuple[Evaluate, np.ndarray]]) -> list[float]:
    """Return the fastest of several passes of each task, taken in turn [s per point]."""
    passes = []
    for _ in range(PASSES):
        times = []
        for evaluate, u in tasks:
            begin = perf_counter()
            evaluate(u)
            times.append((perf_counter() - begin) / len(u))
        passes.append(times)
    return [min(times) for times in zip(*passes, strict=True)]


def compare(
    name: str, make: Callable[[], Evaluate], ratio_min: float, counts: Sequence[int]
) -> bool:
    """Print the ratio to another library for numbers of points; return whether it is met."""
    try:
        theirs = make()
    except ImportError as error:
        print(f'{name}: not compared: {error}; pip install {name}')
        return True
    ours = butterfly().point
    size = float(np.ptp(butterfly().control))
    fine = True
    for count in counts:
        u = np.linspace(0.0, 1.0, count)
        apart = float(np.abs(ours(u) - theirs(u)).max()) / size
        own, other = seconds_per_point([(ours, u), (theirs, u)])
        print(
            f'{name}, {count} points: fuzzycnc {1e6 * own:.4f} us, {name} {1e6 * other:.4f} us a '
            f'point, ratio {other / own:.2f} (at least {ratio_min:g} expected), apart {apart:.1e}'
        )
        fine &= other / own >= ratio_min and apart <= AGREEMENT
    return fine


def main() -> int:
    """Print times and ratios; fail if a ratio is too low or the points differ."""
    fine = compare('geomdl', geomdl_curve, RATIO_GEOMDL_MIN, (POINTS_GEOMDL,))
    fine &= compare('splinepy', splinepy_curve, RATIO_SPLINEPY_MIN, POINTS)
    curve = butterfly()
    for count in POINTS:
        u = np.linspace(0.0, 1.0, count)
        sampled = curve.sample(count)
        exact, three_points = seconds_per_point(
            [(curve.curvature, u), (lambda _, path=sampled: curvature(path), u)]
        )
        print(
            f'curvature, {count} points: exact {1e6 * exact:.4f} us, '
            f'from three points {1e6 * three_points:.4f} us a point'
        )
    return 0 if fine else 1


if __name__ == '__main__':
    raise SystemExit(main())
