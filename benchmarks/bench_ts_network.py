# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The T-S fuzzy neural network on the simulated foam: training, single calls, batches.

Training is set against scikit-learn's MLPRegressor on the same features and the same held-out
samples, three splits of each of two data seeds.  The comparison is at equal error: of several
sizes and penalties of the MLP the fastest counts whose held-out error is no more than 5 % above
ours, and the most accurate one if none is.  Run with `python benchmarks/bench_ts_network.py`.
"""

import os
import sys
from pathlib import Path

# One thread each, set before numpy starts its pool: algorithms are compared, not thread pools.
os.environ |= dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1')
sys.path.insert(0, str(Path(__file__).parents[1] / 'test' / 'support'))

import warnings
from collections.abc import Callable
from statistics import median
from time import perf_counter

import numpy as np
from foam_splits import grouped_split

from fuzzycnc_ros.core.deformation.features import FEATURE_SETS, load
from fuzzycnc_ros.core.deformation.model import DeformationModel
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.training import equal_rows
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples

SEEDS, SPLITS = (1, 2), 3
HELD_OUT = 32
MLPS = [
    (solver, hidden, alpha)
    for solver in ('lbfgs', 'adam')
    for hidden in ((16,), (32, 32))
    for alpha in (1e-2, 1.0)
]
EQUAL = 1.05
TRAINING_MAX, CALL_MAX, BATCH_MIN, ERROR_MAX = 3.0, 50e-6, 500_000, 0.45

Predictor = Callable[[np.ndarray], np.ndarray]
Trainer = Callable[[np.ndarray, np.ndarray], Predictor]


def judge(train: Trainer) -> tuple[float, float]:
    """Return the median seconds of a training and the mean held-out error [mm per 50 mm]."""
    seconds, errors = [], []
    for seed in SEEDS:
        x, s = foam_samples(seed)
        for split in range(SPLITS):
            out = grouped_split(equal_rows(x), HELD_OUT, np.random.default_rng([seed, split]))
            begin = perf_counter()
            predict = train(x[~out], s[~out])
            seconds.append(perf_counter() - begin)
            errors.append(float(np.sqrt(np.mean((predict(x[out]) - s[out]) ** 2))))
    return median(seconds), float(np.mean(errors))


def ours(x: np.ndarray, s: np.ndarray) -> Predictor:
    """Train the default network, its penalty chosen by cross-validation."""
    return TSFuzzyNetwork().fit(x, s).predict


def ours_given_ridge(x: np.ndarray, s: np.ndarray) -> Predictor:
    """Train the default network with a given penalty: an MLP's is given, too."""
    return TSFuzzyNetwork(ridge=0.03).fit(x, s).predict


def mlp(solver: str, hidden: tuple[int, ...], alpha: float) -> Trainer:
    """Return the training of an MLP on the features and the target of our network."""
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    def train(x: np.ndarray, s: np.ndarray) -> Predictor:
        rows = FEATURE_SETS['load'].rows

        def weight(x: np.ndarray) -> np.ndarray:
            return load(*x[:, [1, 3, 4]].T)[:, np.newaxis]

        target = StandardScaler().fit(s / weight(x))
        model = make_pipeline(
            StandardScaler(),
            MLPRegressor(
                hidden_layer_sizes=hidden,
                solver=solver,
                alpha=alpha,
                max_iter=2000,
                random_state=0,
            ),
        ).fit(rows(x), target.transform(s / weight(x)))
        return lambda x: target.inverse_transform(model.predict(rows(x))) * weight(x)

    return train


def call_time(model: DeformationModel, rows: list[list[float]]) -> float:
    """Return the median seconds of a single call."""
    times = []
    for row in rows * 20:
        begin = perf_counter()
        model.predict_one(row)
        times.append(perf_counter() - begin)
    return median(times)


def batch_rate(model: DeformationModel, x: np.ndarray) -> float:
    """Return the samples per second of a batch of about 100,000, the fastest of nine."""
    many = np.tile(x, (100_000 // len(x), 1))
    times = []
    for _ in range(9):
        begin = perf_counter()
        model.predict(many)
        times.append(perf_counter() - begin)
    return len(many) / min(times)


def main() -> int:
    """Print times, ratios and errors; fail if we are not fast or not good enough."""
    seconds, error = judge(ours)
    print(f'fuzzycnc, ridge by cross-validation  {1e3 * seconds:7.0f} ms  {error:.3f} mm')
    fine = seconds <= TRAINING_MAX and error <= ERROR_MAX
    seconds, error = judge(ours_given_ridge)
    print(f'fuzzycnc, ridge given                {1e3 * seconds:7.0f} ms  {error:.3f} mm')
    others = []
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # some do not converge; their error says it
        for setting in MLPS:
            others.append(judge(mlp(*setting)))
            name = f'MLPRegressor {setting[0]} {setting[1]} alpha {setting[2]:g}'
            print(f'{name:36} {1e3 * others[-1][0]:7.0f} ms  {others[-1][1]:.3f} mm')
    equal = [time for time, other in others if other <= EQUAL * error]
    if equal:
        print(f'ratio at equal error: {min(equal) / seconds:.1f} times our time')
    else:
        best = min(others, key=lambda pair: pair[1])
        print(
            f'no MLPRegressor is as accurate; the best needs {best[0] / seconds:.1f} times our '
            f'time for {best[1] / error:.2f} times our error'
        )
    x, s = foam_samples(SEEDS[0])
    for consequent in ('nts', 'sts'):
        model = TSFuzzyNetwork(consequent, ridge=0.03).fit(x, s).model_
        call, rate = call_time(model, x.tolist()), batch_rate(model, x)
        print(f'{consequent}: call {1e6 * call:.1f} us, batch {1e-6 * rate:.2f} M samples/s')
        fine &= call <= CALL_MAX and rate >= BATCH_MIN
    return 0 if fine else 1


if __name__ == '__main__':
    raise SystemExit(main())
