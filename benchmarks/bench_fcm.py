# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzy c-means of 76 sensors with 1000 samples each into 5 clusters, against scikit-fuzzy.

Both run here, one after the other, on the same features with the same tolerance; the ratio of
their times per random start is what counts.  Needs scikit-fuzzy (`pip install scikit-fuzzy`,
and networkx where its import asks for it); without it only our own time is printed.
Run with `python benchmarks/bench_fcm.py`.
"""

import os

# One thread each, set before numpy starts its pool: algorithms are compared, not thread pools.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')

from statistics import median
from time import perf_counter

import numpy as np

from fuzzycnc_ros.core.fuzzy.clustering import FuzzyCMeans

SENSORS, SAMPLES, CLUSTERS = 76, 1000, 5
STARTS = 5
REPEATS = 7
RATIO_MIN = 2.0


def features() -> np.ndarray:
    """Return rises of sensors on a machine with five heated parts, scaled as for selection."""
    rng = np.random.default_rng(0)
    time = np.linspace(0.0, 1.0, SAMPLES)
    parts = np.array(
        [
            a * (1.0 - np.exp(-time / tau))
            for a, tau in zip(
                (20.0, 14.0, 10.0, 8.0, 4.0), (0.05, 0.1, 0.3, 0.6, 2.0), strict=True
            )
        ]
    )
    # Neighbouring parts share their heat, so the clusters overlap as on a real machine.
    place = rng.uniform(0.0, CLUSTERS - 1.0, SENSORS)
    share = np.exp(-2.0 * (place[:, np.newaxis] - np.arange(CLUSTERS)) ** 2)
    rise = share / share.sum(axis=1, keepdims=True) @ parts
    rise += 0.1 * rng.normal(size=rise.shape)
    return rise / np.abs(rise).max() / np.sqrt(SAMPLES)


def ours(points: np.ndarray) -> tuple[float, float]:
    """Return seconds per start and the objective."""
    begin = perf_counter()
    model = FuzzyCMeans(CLUSTERS, n_init=STARTS, tol=1e-6, random_state=0).fit(points)
    return (perf_counter() - begin) / STARTS, model.objective_


def theirs(points: np.ndarray) -> tuple[float, float]:
    """Return seconds per start and the objective of scikit-fuzzy."""
    from skfuzzy.cluster import cmeans

    begin = perf_counter()
    objective = min(
        cmeans(points.T, CLUSTERS, 2.0, 1e-6, 300, seed=seed)[4][-1] for seed in range(STARTS)
    )
    return (perf_counter() - begin) / STARTS, objective


def main() -> int:
    """Print both times and their ratio; fail if we are not fast enough."""
    points = features()
    own = [ours(points) for _ in range(REPEATS)]
    own_time = median(seconds for seconds, _ in own)
    print(f'fuzzycnc      {1e3 * own_time:7.2f} ms per start   J = {own[0][1]:.9e}')
    try:
        other = [theirs(points) for _ in range(REPEATS)]
    except ImportError as error:
        print(f'scikit-fuzzy  not compared: {error}; pip install scikit-fuzzy networkx')
        return 0
    other_time = median(seconds for seconds, _ in other)
    ratio = other_time / own_time
    print(f'scikit-fuzzy  {1e3 * other_time:7.2f} ms per start   J = {other[0][1]:.9e}')
    print(f'ratio         {ratio:7.1f} (at least {RATIO_MIN:g} expected)')
    return 0 if ratio >= RATIO_MIN else 1


if __name__ == '__main__':
    raise SystemExit(main())
